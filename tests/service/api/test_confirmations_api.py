"""What was found at machines: told, kept, audited, listed, counted as by hand, and learned from only where somebody says so."""

import math
import random
from datetime import UTC, datetime, timedelta

import httpx
import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.machines.baselines import healthy_windows
from residuum.service.security.access import new_key
from residuum.service.storage import DiskStore
from residuum.service.store import FoundAtMachine, Outcome

RECORD = Record({"y": np.zeros(4)}, {"y": "V"}, 1.0)
FRICTION = "coulomb-friction of shaft"


def faulty(probability, name="coulomb-friction"):
    cause = {"name": name, "place": "shaft", "probability": probability, "says": "more friction"}
    return Finding("model-based", "faulty", evidence={"causes": [cause]}, reason="-")


@pytest.fixture
def service(run_service, tmp_path):
    return run_service(data=tmp_path)


@pytest.fixture
def store(service):
    return service.services.store


@pytest.fixture
def client(service):
    with httpx.Client(base_url=service.url, timeout=60) as client:
        yield client


def told(client, finding, status=201, asset="press", **found):
    path = f"/api/v1/assets/{asset}/findings/{finding}/confirmations"
    answer = client.post(path, json=found)
    assert answer.status_code == status, answer.text
    return answer.json()


def listed(client, **query):
    items = client.get("/api/v1/confirmations", params=query).raise_for_status().json()["items"]
    return [each["finding"] for each in items]


def test_what_was_found_is_kept_shown_audited_and_the_latest_counts(client, store):
    store.add_window("press", RECORD, faulty(0.8))
    asked = {
        "part": "bearing 6204",
        "order": "4711",
        "who": "Eva",
        "found_at": "2026-03-01T10:00",
        "note": "dry",
    }
    first = told(client, 1, outcome="confirmed", **asked)
    assert (first["said"], first["probability"], first["by"]) == (FRICTION, 0.8, "local")
    assert first["found_at"] == "2026-03-01T10:00:00Z"
    assert {name: first[name] for name in ("part", "order", "who", "note")} == {
        name: asked[name] for name in ("part", "order", "who", "note")
    }
    told(client, 1, outcome="corrected", cause="viscous-friction of shaft")
    shown = client.get("/api/v1/assets/press/findings").json()["items"][0]["confirmation"]
    assert (shown["outcome"], shown["cause"], shown["who"]) == (
        "corrected",
        "viscous-friction of shaft",
        "local",
    )
    for path in ("assets/press/windows/1", "assets/press", "assets"):
        answer = client.get(f"/api/v1/{path}").json()
        found = answer.get("items", [answer])[0]
        finding = found.get("finding") or found["last_finding"]
        assert finding["confirmation"] == shown, path
    trail = client.get("/api/v1/audit").json()["items"]
    assert [entry["action"] for entry in trail[:2]] == ["finding corrected", "finding confirmed"]
    assert trail[1]["subject"] == "finding 1" and trail[1]["detail"]["order_number"] == "4711"
    assert client.get("/api/v1/confirmations/reliability").json()["outcomes"] == {"corrected": 1}


def test_the_list_is_filtered_by_machine_period_and_diagnosis(client, store, monkeypatch):
    begin = datetime(2026, 3, 1, tzinfo=UTC)
    for number, (asset, name) in enumerate([("press", "a"), ("press", "b"), ("fan", "a")]):
        at = begin + timedelta(days=number)
        monkeypatch.setattr("residuum.service.storage.disk_store._now", lambda at=at: at)
        store.add_window(asset, RECORD, faulty(0.5, name))
    monkeypatch.undo()
    told(client, 1, outcome="confirmed")
    told(client, 2, outcome="corrected", cause="a of shaft")
    told(client, 3, outcome="refuted", asset="fan")
    assert listed(client) == [3, 2, 1] and listed(client, limit=1) == [3]
    assert listed(client, asset="press") == [2, 1]
    assert listed(client, diagnosis="b of shaft") == [2]
    assert listed(client, diagnosis="a of shaft") == [3, 2, 1]
    assert listed(client, **{"from": "2026-03-02", "to": "2026-03-03"}) == [2]


@pytest.mark.parametrize(
    ("found", "says"),
    [
        ({"outcome": "corrected"}, "needs what it was instead"),
        ({"outcome": "corrected", "cause": FRICTION}, "say 'confirmed'"),
        ({"outcome": "confirmed", "cause": "a crack"}, "say 'corrected'"),
        ({"outcome": "refuted", "cause": "a crack"}, "say 'corrected'"),
        ({"outcome": "confirmed", "healthy": True}, "only the window of a refuted fault"),
        ({"outcome": "confirmed", "found_at": "2999-01-01"}, "lies in the future"),
        ({"outcome": "perhaps"}, "outcome"),
    ],
)
def test_what_contradicts_itself_is_refused_and_not_kept(client, store, found, says):
    store.add_window("press", RECORD, faulty(0.8))
    assert says in told(client, 1, 422, **found)["detail"]
    assert listed(client) == []


def test_what_says_nothing_or_is_not_there_cannot_be_confirmed(client, store):
    store.add_window("press", RECORD, Finding.not_assessable("model-based", "standing still"))
    says = told(client, 1, 422, outcome="confirmed")["detail"]
    assert "could not be judged" in says
    assert "has no finding 7" in told(client, 7, 404, outcome="confirmed")["detail"]
    store.ensure_asset("fan")
    assert "has no finding 1" in told(client, 1, 404, asset="fan", outcome="confirmed")["detail"]


def exact_interval(events, trials):
    """The Clopper–Pearson interval, by bisection of sums of binomial probabilities."""

    def at_most(k, p):
        return math.fsum(
            math.comb(trials, i) * p**i * (1 - p) ** (trials - i) for i in range(k + 1)
        )

    def solve(holds):
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if holds(middle) else (low, middle)
        return low

    low = 0.0 if events == 0 else solve(lambda p: 1 - at_most(events - 1, p) < 0.025)
    high = 1.0 if events == trials else solve(lambda p: at_most(events, p) > 0.025)
    return low, high


def test_the_reliability_is_that_counted_by_hand(client, store):
    rng = random.Random(5)
    answered = []
    for number in range(1, 121):
        probability = rng.random()
        store.add_window("press", RECORD, faulty(probability))
        if number % 6 == 0:
            continue  # nobody told
        right = rng.random() < probability
        other = (
            {"outcome": "corrected", "cause": "a crack"} if number % 2 else {"outcome": "refuted"}
        )
        told(client, number, **({"outcome": "confirmed"} if right else other))
        answered.append((probability, right))
    store.add_window("press", RECORD, Finding("bearing", "faulty", "ball", reason="-"))
    told(client, 121, outcome="confirmed")
    counted = client.get("/api/v1/confirmations/reliability", params={"asset": "press"}).json()
    assert (counted["answered"], counted["without_probability"]) == (101, 1)
    assert len(answered) == 100 and len(counted["bins"]) == 10
    error = 0.0
    for each in counted["bins"]:
        inside = [(p, right) for p, right in answered if each["low"] <= p < each["high"]]
        found = sum(right for _, right in inside)
        assert (each["n"], each["found"]) == (len(inside), found)
        mean = math.fsum(p for p, _ in inside) / len(inside)
        assert each["said"] == pytest.approx(mean) and each["share"] == found / len(inside)
        interval = exact_interval(found, len(inside))
        assert (each["low_95"], each["high_95"]) == pytest.approx(interval, abs=1e-9)
        assert each["agrees"] == (interval[0] <= mean <= interval[1])
        error += len(inside) * abs(mean - found / len(inside)) / len(answered)
    assert counted["calibration_error"] == pytest.approx(error)
    month = datetime.now(UTC).strftime("%Y-%m")
    page = client.get("/api/v1/assets/press/report", params={"month": month}).text
    first = counted["bins"][0]
    assert "Of 121 faulty windows of this month 101 were answered" in page
    assert (
        f"<title>said {first['said']:.2f}, true {first['share']:.2f} of {first['n']}</title>"
        in page
    )
    assert page.count("<title>said ") == 20, "a point a tenth, of the machine and of the plant"


def test_only_a_window_that_somebody_calls_healthy_is_learned_from(tmp_path):
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'residuum.db'}")

    def add(finding, level):
        record = Record({"y": np.full(4, level)}, {"y": "V"}, 1.0)
        return store.add_window("press", record, finding)

    def learned():
        return [float(record["y"][0]) for record in healthy_windows(store, "press")]

    for level in range(9):
        add(Finding("bearing", "healthy", reason="-"), level)
    add(faulty(0.7), 50)
    add(faulty(0.7), 60)
    before = learned()
    assert before == list(range(9))
    store.confirm("press", 10, FoundAtMachine(Outcome.REFUTED))
    assert learned() == before, "nothing is learned by itself"
    store.confirm("press", 10, FoundAtMachine(Outcome.REFUTED, healthy=True))
    assert learned() == [*before, 50]
    store.confirm("press", 3, FoundAtMachine(Outcome.CORRECTED, cause="a crack"))
    assert learned() == [0, 1, 3, 4, 5, 6, 7, 8, 50], "in that healthy one somebody found a crack"
    store.confirm("press", 10, FoundAtMachine(Outcome.CONFIRMED))
    assert learned() == [0, 1, 3, 4, 5, 6, 7, 8], "the latest counts"
    store.close()


def test_a_key_of_a_site_tells_and_sees_its_machines_alone(tmp_path, run_service):
    keys = {role: new_key() for role in ("viewer", "operator")}
    lines = [
        f"anna operator {keys['operator'][1]} hall-1",
        f"vera viewer {keys['viewer'][1]}",
    ]
    (tmp_path / "keys").write_text("\n".join(lines))
    service = run_service(data=tmp_path / "data", api_keys=tmp_path / "keys")
    with httpx.Client(base_url=service.url, timeout=60) as client:
        store = service.services.store
        for asset in ("hall-1.press", "hall-2.press"):
            store.add_window(asset, RECORD, faulty(0.9))
        anna, vera = ({"X-API-Key": keys[role][0]} for role in ("operator", "viewer"))

        def tell(headers, asset, finding):
            path = f"/api/v1/assets/{asset}/findings/{finding}/confirmations"
            return client.post(path, headers=headers, json={"outcome": "confirmed"}).status_code

        assert tell(anna, "hall-1.press", 1) == 201 and tell(anna, "hall-2.press", 2) == 403
        assert tell(vera, "hall-1.press", 1) == 403
        store.confirm("hall-2.press", 2, FoundAtMachine(Outcome.REFUTED), "bert")
        seen = client.get("/api/v1/confirmations", headers=anna).json()["items"]
        assert [(each["asset"], each["by"]) for each in seen] == [("hall-1.press", "anna")]
        counted = client.get("/api/v1/confirmations/reliability", headers=anna).json()
        assert counted["answered"] == 1
        month = datetime.now(UTC).strftime("%Y-%m")
        path = f"/api/v1/assets/hall-1.press/report?month={month}"
        assert "the plant until then (1)" in client.get(path, headers=anna).text
        assert "the plant until then (2)" in client.get(path, headers=vera).text
