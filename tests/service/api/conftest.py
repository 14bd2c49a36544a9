"""A client of a running service."""

import httpx
import pytest


@pytest.fixture(scope="module")
def client(run_service):
    with httpx.Client(base_url=run_service().url, timeout=60) as client:
        yield client


@pytest.fixture
def refused(client):
    """Send a request that must be refused: a problem document, one line, no fault of ours; gives (status, detail)."""

    def send(method, path, **request):
        answer = client.request(method, path, **request)
        assert 400 <= answer.status_code < 500, answer.text
        assert answer.headers["content-type"] == "application/problem+json"
        problem = answer.json()
        assert problem["status"] == answer.status_code and "\n" not in problem["detail"]
        return answer.status_code, problem["detail"]

    return send
