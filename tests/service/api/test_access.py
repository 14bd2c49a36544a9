"""Every route × every role, no key, a wrong key, and a key of another site: the expected status."""

import httpx
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.app import create_app
from residuum.service.machines.pipeline import Pipeline
from residuum.service.security.access import new_key
from residuum.service.settings import BadSettings, load_settings

ROLES = ("monitor", "viewer", "operator", "engineer", "admin")
# Written out, apart from the code: what each route asks for. Reading asks for a viewer; all other routes for an engineer.
OPERATOR = {
    f"/api/v1/alarms/{{alarm}}/{verb}" for verb in ("acknowledge", "reset", "shelve", "unshelve")
} | {"/api/v1/assets/{asset}/findings/{finding}/confirmations"}
OPEN = {"/api/v1/health/live", "/api/v1/health/ready"}
OF_A_SITE = tuple(
    f"/api/v1/{noun}"
    for noun in (
        "assets",
        "alarms",
        "confirmations",
        "score",
        "diagnosers",
        "effects",
        "health",
        "events",
        "status",
        "sources",
    )
)


def needed(method, path):
    if path in OPEN or path == "/api/v1/metrics":
        return "monitor"
    return "viewer" if method == "GET" else "operator" if path in OPERATOR else "engineer"


@pytest.fixture(scope="module")
def plant(tmp_path_factory, run_service):
    keys = {name: new_key() for name in (*ROLES, "hall-1", "hall-2")}
    file = tmp_path_factory.mktemp("keys") / "keys"
    lines = [f"{name} {name} {digest}" for name, (_, digest) in keys.items() if name in ROLES]
    lines += [
        f"{site}-engineer engineer {keys[site][1]} {site},elsewhere"
        for site in ("hall-1", "hall-2")
    ]
    file.write_text("\n".join(lines))
    service = run_service(host="0.0.0.0", api_keys=file, rate_limit=1e6)
    for asset in ("hall-1.press", "hall-2.press", "HALL-1.press", "hall-10.press", "hall-1"):
        record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
        service.services.store.add_window(asset, record, Finding("bearing", "faulty", reason="-"))
    with httpx.Client(base_url=service.url, timeout=60) as client:
        client.running = service
        yield client, {name: {"X-API-Key": key} for name, (key, _) in keys.items()}


def routes(tmp_path):
    document = create_app(load_settings(data=tmp_path)).openapi()
    return [
        (method.upper(), path) for path, methods in document["paths"].items() for method in methods
    ]


NAMES = {
    "asset": "hall-1.press",
    "alarm": "99999",
    "window": "1",
    "diagnoser": "none",
    "machine": "m",
}


def ask(client, method, path, headers):
    for name, value in NAMES.items():
        path = path.replace(f"{{{name}}}", value)
    while "{" in path:
        path = path[: path.index("{")] + "1" + path[path.index("}") + 1 :]
    if path.endswith("/events"):
        with client.stream(method, path, headers=headers) as answer:
            return answer.status_code
    return client.request(
        method, path, headers=headers, json={} if method in ("POST", "PUT") else None
    ).status_code


def test_every_route_with_every_role_without_a_key_and_with_a_wrong_one(plant, tmp_path):
    client, keys = plant
    found = routes(tmp_path)
    assert len(found) > 50
    for method, path in found:
        for headers in (
            {},
            {"X-API-Key": "guess"},
            {"Authorization": "Bearer guess"},
            {"Authorization": "Basic Z3Vlc3M6"},
        ):
            assert ask(client, method, path, headers) == 401 or path in OPEN, (
                method,
                path,
                headers,
            )
        for role in ROLES:
            status = ask(client, method, path, keys[role])
            allowed = ROLES.index(role) >= ROLES.index(needed(method, path))
            assert (status == 403) != allowed and status != 401 and status < 500, (
                method,
                path,
                role,
                status,
            )


def test_a_key_of_one_site_reaches_nothing_of_another(plant, tmp_path):
    client, keys = plant
    for method, path in routes(tmp_path):
        own = ask(client, method, path, keys["hall-1"])
        other = ask(client, method, path, keys["hall-2"])
        if "{asset}" in path:
            assert own != 403 and other == 403, (method, path, own, other)
        elif path.startswith(OF_A_SITE) and path != "/api/v1/alarms/rates":
            assert own != 403 and other != 403, (method, path, own, other)
        else:
            assert own == other == 403, (method, path, own, other)


def test_lists_and_alarms_are_cut_down_to_the_site(plant):
    client, keys = plant

    def names(path, key, name):
        return {
            each[name] for each in client.get(f"/api/v1/{path}", headers=keys[key]).json()["items"]
        }

    assert names("assets", "hall-1", "id") == {"hall-1", "hall-1.press"} and names(
        "assets", "hall-2", "id"
    ) == {"hall-2.press"}
    assert (
        names("alarms", "hall-1", "asset") == {"hall-1", "hall-1.press"}
        and len(names("alarms", "viewer", "asset")) == 5
    )
    (theirs,) = client.get("/api/v1/alarms", headers=keys["hall-2"]).json()["items"]
    for verb, method in (("", "GET"), ("/acknowledge", "POST"), ("/suppress", "POST")):
        assert (
            client.request(
                method, f"/api/v1/alarms/{theirs['id']}{verb}", headers=keys["hall-1"]
            ).status_code
            == 404
        )
    assert (
        client.post(
            f"/api/v1/alarms/{theirs['id']}/acknowledge", headers=keys["hall-2"]
        ).status_code
        == 200
    )
    answer = client.post("/api/v1/score/bearing?baseline=hall-2.press", headers=keys["hall-1"])
    assert (
        answer.status_code == 403
        and "limited to machines of elsewhere, hall-1" in answer.json()["detail"]
    )


def test_live_events_and_states_are_cut_down_to_the_site(plant):
    client, keys = plant
    services = client.running.services
    here, there = {"state": "running"}, ("hall-2.press", "HALL-1.press", "hall-10.press")
    with client.stream("GET", "/api/v1/events", headers=keys["hall-1"]) as mine:
        for asset in (*there, "hall-1.press"):
            services.events.publish("pipeline", {"machine": asset, **here})
            services.events.publish("alarm", {"asset": asset, "id": 1})
        services.events.publish("job", {"id": "j", "asset": "hall-1.press"})
        services.events.publish("model", {"model": "hall-1.press"})
        services.events.publish("alarm", {"asset": "hall-1", "id": 2})
        told = []
        for line in mine.iter_lines():
            told += [line.removeprefix("data: ")] if line.startswith("data: ") else []
            if '"id":2' in line:
                break
    assert told == [
        '{"machine":"hall-1.press","state":"running"}',
        '{"asset":"hall-1.press","id":1}',
        '{"asset":"hall-1","id":2}',
    ]


def test_states_of_machines_and_sources_are_cut_down_to_the_site(tmp_path, run_service):
    class Halls(Pipeline):
        def status(self):
            names = ("hall-1.press", "hall-2.press")
            return {
                "machines": {name: {} for name in names},
                "sources": {f"{name} bus": {"machine": name} for name in names},
            }

    key, digest = new_key()
    (tmp_path / "keys").write_text(f"eva viewer {digest} hall-1")
    service = run_service(Halls, host="0.0.0.0", api_keys=tmp_path / "keys")
    with httpx.Client(base_url=service.url, timeout=60, headers={"X-API-Key": key}) as client:
        status = client.get("/api/v1/status").json()
        assert status["machines"] == {"hall-1.press": {}}
        assert status["sources"] == {"hall-1.press bus": {"machine": "hall-1.press"}}
        assert [each["name"] for each in client.get("/api/v1/sources").json()["items"]] == [
            "hall-1.press bus"
        ]


def test_a_malformed_site_is_refused(tmp_path):
    (tmp_path / "keys").write_text(f"eva viewer {'0' * 64} hall/1")
    with pytest.raises(BadSettings, match="line 1: 'hall/1': a site is"):
        create_app(load_settings(data=tmp_path, api_keys=tmp_path / "keys"))


def test_metrics_ask_for_a_key_that_may_read_nothing_else(plant):
    client, keys = plant
    for headers in ({}, {"X-API-Key": "guess"}):
        answer = client.get("/metrics", headers=headers)
        assert answer.status_code == 401 and "residuum_" not in answer.text
    for role in ROLES:
        answer = client.get(
            "/metrics", headers={"Authorization": f"Bearer {keys[role]['X-API-Key']}"}
        )
        assert answer.status_code == 200 and "residuum_findings_total" in answer.text
    assert client.get("/metrics", headers=keys["hall-1"]).status_code == 403
    assert client.get("/api/v1/assets", headers=keys["monitor"]).status_code == 403
