"""Every route × the role below the one that it asks for × odd names × every field of its body: refused; and no text is a path.

All roles, in a process of their own: `python -m benchmarks.role_walk`.
"""

import sys
import threading

import httpx
import pytest

from benchmarks.role_walk import MACHINE, NAMES, ROLES, VERBS, forbidden, path_bodies, routes
from residuum.service.app import create_app
from residuum.service.security.access import new_key
from residuum.service.settings import load_settings


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    return create_app(load_settings(data=tmp_path_factory.mktemp("document"))).openapi()


@pytest.fixture(scope="module")
def plant(tmp_path_factory, run_service):
    keys = {role: new_key() for role in ROLES}
    file = tmp_path_factory.mktemp("keys") / "keys"
    file.write_text("\n".join(f"{role} {role} {digest}" for role, (_, digest) in keys.items()))
    service = run_service(host="0.0.0.0", api_keys=file, rate_limit=1e6)
    with httpx.Client(base_url=service.url, timeout=60) as client:
        yield (
            client,
            {
                role: {"X-API-Key": key, "Content-Type": "application/json"}
                for role, (key, _) in keys.items()
            },
        )


def test_nobody_does_what_asks_for_a_higher_role_however_things_are_called(plant, document):
    client, keys = plant
    asked = list(forbidden(document, all_roles=False))
    assert len(asked) > len(routes(document)) + 100
    for role, method, path, body in asked:
        status = client.request(method, path, headers=keys[role], content=body).status_code
        assert status == 403, (role, method, path, body, status)


@pytest.mark.parametrize("name", VERBS)
def test_an_asset_that_is_called_like_a_verb_is_no_operator_s(plant, name):
    client, keys = plant
    path = f"/api/v1/assets/{name}"
    assert client.put(path, headers=keys["operator"], json={"title": "mine"}).status_code == 403
    assert (
        client.put(path, headers=keys["engineer"], json={"title": "theirs"}).json()["title"]
        == "theirs"
    )
    # may, and there is none
    assert client.post(f"/api/v1/alarms/1/{name}", headers=keys["operator"]).status_code == 404


def test_health_of_an_asset_is_not_the_service_s(plant):
    client, keys = plant
    assert client.get("/api/v1/assets/health/live", headers=keys["monitor"]).status_code == 403
    assert (
        "health" in NAMES
        and client.get("/api/v1/health/live", headers=keys["monitor"]).status_code == 200
    )


_opened, _watching = set(), threading.Event()


def _note(event, arguments):
    if event == "open" and _watching.is_set() and isinstance(arguments[0], str):
        _opened.add(arguments[0])


def test_no_text_of_a_body_is_read_as_a_path(plant, document, tmp_path):
    """A second opinion's model was: any file that the service can read told its first line in the refusal."""
    client, keys = plant
    secret = tmp_path / "secret.yaml"
    secret.write_text("name: secret\n")
    sys.addaudithook(_note)
    asked = list(path_bodies(document, str(secret)))
    assert len(asked) > 60
    _watching.set()
    try:
        for method, path, body in asked:
            answer = client.request(method, path, headers=keys["engineer"], content=body)
            assert answer.status_code < 500, (method, path, body, answer.text)
    finally:
        _watching.clear()
    assert str(secret) not in _opened
    refused = client.put(
        "/api/v1/assets/a-machine/machine",
        headers=keys["engineer"],
        json=MACHINE | {"second": {"model": str(secret)}},
    )
    assert refused.status_code == 404, refused.text
