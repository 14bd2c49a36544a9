"""Grafana's dashboards ask the service for addresses that it answers, and for columns that are there. Grafana is not run."""

import json
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import numpy as np
import pytest
import yaml

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record

GRAFANA = Path(__file__).parents[2] / "deploy" / "grafana"
BOARDS = {
    path.stem: json.loads(path.read_text()) for path in (GRAFANA / "dashboards").glob("*.json")
}
OURS = {name: board for name, board in BOARDS.items() if name != "service"}
STEP, N, TONE = 1e-3, 4000, 50.0


@pytest.fixture(scope="module")
def service(run_service):
    service = run_service()
    t = STEP * np.arange(N)
    for number in range(40):
        record = Record({"y": (1.0 + number) * np.sin(2 * np.pi * TONE * t)}, {"y": "m/s²"}, STEP)
        verdict = "faulty" if number == 39 else "healthy"
        kind = "wear" if verdict == "faulty" else None
        finding = Finding(
            "bearing",
            verdict,
            kind,
            {"rms": float(number)},
            {"rms": 38.5},
            {"rms": "m/s²"},
            {},
            "worn",
        )
        service.services.store.add_window("press", record, finding)
    return service


@pytest.fixture(scope="module")
def client(service):
    with httpx.Client(base_url=service.url, timeout=60) as client:
        yield client


def span():
    now = datetime.now(UTC)
    ends = {"from": now - timedelta(hours=1), "to": now + timedelta(hours=1)}
    return {name: f"{moment:%Y-%m-%dT%H:%M:%S.000Z}" for name, moment in ends.items()}


def filled_in(url):
    """An address as Grafana asks it, with variables as it writes them."""
    there = {
        "machine": "press",
        "window": "7",
        **{f"__{name}:date:iso": moment for name, moment in span().items()},
    }
    return re.sub(r"\$\{([^}]*)\}", lambda found: there[found[1]], url)


def queries():
    for name, board in OURS.items():
        for variable in board["templating"]["list"]:
            yield f"{name}, {variable['name']}", variable["query"]["infinityQuery"]
        for panel in board["panels"]:
            for target in panel["targets"]:
                yield f"{name}, {panel['title']}", target


def chosen(row, selector):
    for word in selector.split("."):
        row = row[word]
    return row


@pytest.mark.parametrize(
    ("what", "query"), list(queries()), ids=lambda each: each if isinstance(each, str) else ""
)
def test_every_query_is_answered_with_the_columns_that_it_names(client, what, query):
    answer = client.get(filled_in(query["url"]))
    assert answer.status_code == 200, (what, answer.text)
    rows = answer.json()[query["root_selector"]]
    kinds = {"string": (str, int, type(None)), "number": (int, float), "timestamp": (str,)}
    for column in query["columns"]:
        values = [chosen(row, column["selector"]) for row in rows]
        assert values and all(isinstance(value, kinds[column["type"]]) for value in values), (
            what,
            column,
        )
        if column["type"] == "timestamp":
            assert all(datetime.fromisoformat(value).tzinfo for value in values)


def test_boards_and_sources_name_each_other():
    sources = yaml.safe_load(
        (GRAFANA / "provisioning" / "datasources" / "residuum.yaml").read_text()
    )["datasources"]
    known = {source["uid"]: source["type"] for source in sources}
    for board in OURS.values():
        for panel in board["panels"]:
            for named in (
                panel["datasource"],
                *(target["datasource"] for target in panel["targets"]),
            ):
                assert known[named["uid"]] == named["type"]
    links = re.findall(r"/d/([\w-]+)", json.dumps(OURS["plant"]))
    assert links and set(links) <= {board["uid"] for board in BOARDS.values()}


def test_tables_keep_the_extremes_and_the_tone(client):
    rows = client.get(
        "/api/v1/assets/press/tables/indicators", params={**span(), "points": 10}
    ).json()["items"]
    assert (
        len(rows) <= 10
        and {row["value"] for row in rows} >= {0.0, 39.0}
        and {row["threshold"] for row in rows} == {38.5}
    )
    wave = client.get("/api/v1/assets/press/tables/waveform", params={"points": 100}).json()[
        "items"
    ]
    assert (
        len(wave) <= 100
        and max(row["value"] for row in wave) == pytest.approx(40.0, rel=1e-3)
        and wave[0]["unit"] == "m/s²"
    )
    spectrum = client.get("/api/v1/assets/press/tables/spectrum", params={"window": 3}).json()[
        "items"
    ]
    highest = max(spectrum, key=lambda row: row["amplitude"])
    assert highest["frequency"] == pytest.approx(TONE, abs=0.5) and highest[
        "amplitude"
    ] == pytest.approx(3.0, rel=0.02)
    findings = client.get("/api/v1/assets/press/tables/findings", params=span()).json()["items"]
    assert len(findings) == 40 and (findings[-1]["verdict"], findings[-1]["class"]) == (
        "faulty",
        "wear",
    )


def test_a_table_of_what_is_not_there_is_refused(client):
    waveform, spectrum = "press/tables/waveform", "press/tables/spectrum"
    for path, query in (
        ("nobody/tables/waveform", {}),
        (waveform, {"channel": "z"}),
        (spectrum, {"window": 999}),
    ):
        answer = client.get(f"/api/v1/assets/{path}", params=query)
        assert (
            answer.status_code == 404
            and answer.headers["content-type"] == "application/problem+json"
        )
