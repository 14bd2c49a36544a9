"""The documentation under /docs/: its pages run their own scripts and no other, and a missing site says how to build it."""

import asyncio
import base64
import hashlib

import httpx
import pytest
from starlette.applications import Starlette

from residuum.service.web import documentation_routes

SCRIPT = "document.title = 'ours'"


def get(site, path):
    async def ask():
        transport = httpx.ASGITransport(Starlette(routes=documentation_routes(site)))
        async with httpx.AsyncClient(transport=transport, base_url="http://here") as client:
            return await client.get(path)

    return asyncio.run(ask())


@pytest.fixture
def site(tmp_path):
    (tmp_path / "index.html").write_text(
        f"<html><script>{SCRIPT}</script><script src='a.js'></script></html>"
    )
    (tmp_path / "a.js").write_text("1")
    return tmp_path


def test_a_page_may_run_its_own_scripts_and_nothing_from_outside(site):
    answer = get(site, "/docs/")
    policy = answer.headers["content-security-policy"]
    digest = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
    assert answer.status_code == 200 and f"script-src 'self' 'sha256-{digest}';" in policy
    assert "http" not in policy and "default-src 'none'" in policy
    assert get(site, "/docs/a.js").status_code == 200
    assert get(site, "/docs").headers["location"].endswith("/docs/")
    assert get(site, "/docs/%2e%2e/secret").status_code == 404


def test_a_site_that_was_not_built_says_how_to_build_it(tmp_path):
    for path in ("/docs", "/docs/", "/docs/reference/effects.html"):
        answer = get(tmp_path, path)
        assert answer.status_code == 404 and "make docs" in answer.text


def test_the_interface_describes_itself_beside_it_and_every_page_has_one_policy(run_service):
    with httpx.Client(base_url=run_service().url, timeout=60) as client:
        assert client.get("/openapi.json").json()["openapi"].startswith("3.1")
        for path in ("/docs/", "/"):
            assert len(client.get(path).headers.get_list("content-security-policy")) == 1
