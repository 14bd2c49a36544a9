"""The interface as a whole: its document, events over the wire, health, metrics, and thousands of odd requests."""

import contextlib
import json
import re
import threading
import time

import httpx
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis.errors import Unsatisfiable

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record

FEW = settings(
    max_examples=5,
    deadline=None,
    derandomize=True,
    database=None,
    phases=(Phase.explicit, Phase.generate),
    suppress_health_check=list(HealthCheck),
)


@pytest.fixture(scope="module")
def service(run_service):
    return run_service()


def store(service, asset="press", verdict="healthy"):
    record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
    return service.services.store.add_window(
        asset, record, Finding("bearing", verdict, reason="because")
    )


def test_the_document_describes_every_route(service):
    document = httpx.get(f"{service.url}/openapi.json", timeout=60).json()
    assert document["openapi"].startswith("3.1")
    for path, methods in document["paths"].items():
        assert path.startswith("/api/v1/")
        for method, operation in methods.items():
            assert operation.get("description"), f"{method} {path} says nothing"
            for parameter in operation.get("parameters", []):
                assert parameter.get("description"), (
                    f"{method} {path}: {parameter['name']} says nothing"
                )


def read_events(url, count, **headers):
    found = []
    with httpx.stream("GET", f"{url}/api/v1/events", headers=headers, timeout=60) as stream:
        event = {}
        for line in stream.iter_lines():
            if line.startswith(":"):
                continue
            if line:
                name, _, value = line.partition(": ")
                event[name] = value
            elif event:
                found.append(event)
                event = {}
                if len(found) == count:
                    return found
    return found


def test_events_resume_where_the_connection_broke(service):
    answers = []
    listener = threading.Thread(
        target=lambda: answers.extend(read_events(service.url, 2, **{"Last-Event-ID": "before-1"}))
    )
    listener.start()
    end = time.monotonic() + 60
    while not service.services.events._wake:
        assert listener.is_alive() and time.monotonic() < end, "the listener did not come"
        time.sleep(0.01)
    store(service, verdict="faulty")
    listener.join(60)
    assert [event["event"] for event in answers] == ["reset", "finding"]
    assert json.loads(answers[1]["data"])["verdict"] == "faulty"
    for number in range(3):
        store(service, asset=f"press-{number}")
    missed = read_events(service.url, 4, **{"Last-Event-ID": answers[1]["id"]})
    assert [event["event"] for event in missed] == ["alarm", "finding", "finding", "finding"]


def test_methods_that_a_stranger_makes_up_do_not_fill_the_metrics(service):
    with httpx.Client(base_url=service.url, timeout=60) as client:
        for number in range(20):
            assert client.request(f"MADEUP{number}", "/").status_code == 405
        text = client.get("/metrics").text
    assert "MADEUP" not in text and 'method="other"' in text


def test_health_and_metrics(service):
    store(service)
    with httpx.Client(base_url=service.url, timeout=60) as client:
        assert client.get("/health/live").json()["status"] == "live"
        assert client.get("/health/ready").json()["status"] == "ready"
        client.get("/api/v1/assets/none")
        text = client.get("/metrics").text
    assert 'residuum_findings_total{asset="press",verdict="healthy"}' in text
    assert re.search(r'route="[^"]*/assets/\{asset\}",status="404"', text)


def test_no_request_however_odd_breaks_the_service(service):
    store(service, verdict="faulty")
    schema = schemathesis.openapi.from_url(f"{service.url}/openapi.json").exclude(
        path_regex="/events$"
    )
    tried = 0

    def holds(case):
        nonlocal tried
        tried += 1
        answer = case.call(timeout=60)
        assert answer.status_code < 500, (case.method, case.formatted_path, answer.content)
        if answer.status_code >= 400:
            assert answer.headers["content-type"] == ["application/problem+json"], (
                case.method,
                case.formatted_path,
            )

    for operation in schema.get_all_operations():
        for mode in (schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE):
            with contextlib.suppress(Unsatisfiable):  # a route without parameters has no odd ones
                FEW(given(operation.ok().as_strategy(generation_mode=mode))(holds))()
    assert tried > 300
