"""Findings and windows as Parquet files, and a machine's month as a page: over HTTP and by the command, from a real store."""

import io
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.api import results
from residuum.service.cli import BAD_INPUT, DONE, run
from residuum.service.results.month_report import month_report
from residuum.service.results.parquet_tables import month_of, span_of, write_windows
from residuum.service.results.report_page import report_page
from residuum.service.storage import DiskStore
from residuum.service.storage.database import Database, newest_revision
from residuum.service.storage.retention import Retention

parquet = pytest.importorskip(
    "pyarrow.parquet", reason="the extra 'parquet' is not installed: Parquet was not tried"
)

BEGIN = datetime(2026, 10, 31, 23, 0, tzinfo=UTC)
HOSTILE = "<script>alert(1)</script>"
ROUTE = "/api/v1/assets/press"


def record(number):
    return Record(
        {"speed": [float(number), np.nan, 2.5], "on": [0.0, 1.0, 1.0]},
        {"speed": "ticks/s", "on": ""},
        0.5,
        t0=number,
    )


def finding(number):
    """Faulty every fifth time, not assessable every seventh."""
    verdict = "faulty" if number % 5 == 0 else "not-assessable" if number % 7 == 0 else "healthy"
    said = {"value": 0.2 + 0.001 * number, "unit": "N·m", "healthy": {"low": 0.19, "high": 0.21}}
    cause = {"name": "coulomb-friction", "place": "shaft", "says": f"friction {HOSTILE} {number}"}
    evidence = {"parameters": {"tau_c": said}, "causes": [cause] if verdict == "faulty" else []}
    indicators = {"deviation": float(number)}
    reason = "standing still" if verdict == "not-assessable" else f"no. {number}"
    return Finding(
        "model-based",
        verdict,
        None,
        indicators,
        {"deviation": 50.0},
        {"deviation": "σ"},
        evidence,
        reason,
    )


def fill(store, monkeypatch, count=100, every=timedelta(hours=12)):
    """A window every twelve hours from an hour before November."""
    for number in range(count):
        monkeypatch.setattr(
            "residuum.service.storage.disk_store._now", lambda at=BEGIN + number * every: at
        )
        store.add_window("press", record(number), finding(number))
    monkeypatch.undo()


@pytest.fixture
def filled(tmp_path, monkeypatch):
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'residuum.db'}")
    fill(store, monkeypatch)
    yield store, tmp_path
    store.close()


def test_a_span_of_time_is_written_as_it_was_stored(filled, tmp_path, capsys):
    _, data = filled
    asked = [
        "results",
        "parquet",
        "press",
        "--from",
        "2026-11-01",
        "--to",
        "2026-11-11T12:00+01:00",
        "--out",
        str(tmp_path),
    ]
    assert run([*asked, "--data", str(data), "--json"]) == DONE
    told = json.loads(capsys.readouterr().out)
    found = parquet.read_table(told["findings"]["file"]).to_pylist()
    assert [row["window"] for row in found] == [number + 1 for number in range(1, 21)] and told[
        "findings"
    ]["rows"] == 20
    fifth = found[4]
    assert (fifth["verdict"], fifth["at"]) == ("faulty", BEGIN + timedelta(hours=60))
    assert dict(fifth["indicators"]) == {"deviation": 5.0} and dict(fifth["units"]) == {
        "deviation": "σ"
    }
    assert json.loads(fifth["evidence"])["causes"][0]["place"] == "shaft"
    rows = parquet.read_table(told["windows"]["file"]).to_pylist()
    assert len(rows) == 40 and {row["unit"] for row in rows} == {"ticks/s", ""}
    speed = next(row for row in rows if row["window"] == 6 and row["channel"] == "speed")
    np.testing.assert_array_equal(speed["values"], [5.0, np.nan, 2.5])
    assert (speed["sample_time"], speed["t0"], speed["received_at"]) == (
        0.5,
        5.0,
        BEGIN + timedelta(hours=60),
    )


def test_a_signal_that_was_let_go_is_null_and_its_row_stays(filled, tmp_path):
    store, _ = filled
    store.retain(Retention(np.inf, 0, np.inf, 10**6))
    assert (
        write_windows(store, "press", span_of("2026-11-01", "2026-11-02"), tmp_path / "w.parquet")
        == 4
    )
    assert parquet.read_table(tmp_path / "w.parquet").column("values").to_pylist().count(None) >= 2


def test_an_empty_span_and_one_that_is_too_large(filled, tmp_path):
    store, _ = filled
    assert (
        write_windows(store, "press", span_of("2020-01-01", "2020-01-02"), tmp_path / "w.parquet")
        == 0
    )
    assert parquet.read_table(tmp_path / "w.parquet").num_rows == 0
    with pytest.raises(BadInput, match="shorter span"):
        write_windows(store, "press", month_of("2026-11"), tmp_path / "w.parquet", most_bytes=100)


def test_a_month_counts_what_happened_in_it_also_from_hours(filled):
    store, _ = filled
    before = month_report(store, "press", "2026-11")
    assert (
        before.verdicts == {"healthy": 41, "faulty": 12, "not-assessable": 7}
        and len(before.days) == 30
    )
    (name, fault), *others = before.faults.items()
    assert (name, fault.windows, others) == ("coulomb-friction of shaft", 12, [])
    assert before.reasons == [("standing still", 7)]
    raised = [
        entry
        for alarm, entries in before.alarms
        if alarm.kind == "machine"
        for entry in entries
        if entry.event == "raise"
    ]
    assert raised and all(
        month_of("2026-11").begin <= entry.at < month_of("2026-11").end for entry in raised
    )
    assert before.indicators["deviation"].value == [float(n) for n in range(1, 61)]
    assert before.parameters["tau_c"].high[0] == 0.21 and before.parameters["tau_c"].unit == "N·m"
    store.retain(Retention(np.inf, 2**40, np.inf, 60))
    after = month_report(store, "press", "2026-11")
    assert after.verdicts == before.verdicts and len(after.indicators["deviation"].value) == 60
    december = month_report(store, "press", "2026-12").indicators["deviation"]
    store.retain(Retention(np.inf, 2**40, np.inf, 1))  # all but the newest are hours now
    folded = month_report(store, "press", "2026-11").indicators["deviation"]
    assert folded.unit == december.unit == "σ" and folded.high == [50.0] * 60
    assert len(list(after.faults.values())) == 1 and after.faults[name].windows < 12


def test_the_page_says_it_and_stands_alone(filled, tmp_path, capsys):
    store, data = filled
    out = tmp_path / "november.html"
    assert (
        run(
            [
                "results",
                "report",
                "press",
                "--month",
                "2026-11",
                "--out",
                str(out),
                "--data",
                str(data),
                "--json",
            ]
        )
        == DONE
    )
    assert json.loads(capsys.readouterr().out)["windows"] == {
        "healthy": 41,
        "faulty": 12,
        "not-assessable": 7,
    }
    page = out.read_text(encoding="utf-8")
    assert (
        "60 windows were judged by model-based: 12 faulty (20.0 %)" in page
        and "coulomb-friction of shaft" in page
    )
    assert (
        "<script" not in page
        and "&lt;script&gt;" in page
        and "http" not in page.replace("http://www.w3.org/2000/svg", "")
    )
    assert page.count("<polygon") == 0 and "tau_c [N·m]" in page and "healthy band" in page
    empty = report_page(month_report(store, "press", "2025-01"))
    assert "No window was judged in this month" in empty


def test_they_are_given_over_http_and_bad_requests_are_refused(
    run_service, monkeypatch, refused_by
):
    service = run_service()
    fill(service.services.store, monkeypatch, count=10)
    with httpx.Client(base_url=service.url, timeout=60) as client:
        answer = client.get(
            f"{ROUTE}/findings.parquet", params={"from": "2026-11-01", "to": "2026-11-03"}
        )
        assert (
            answer.status_code == 200
            and parquet.read_table(io.BytesIO(answer.content)).num_rows == 4
        )
        answer = client.get(
            f"{ROUTE}/windows.parquet", params={"from": "2026-11-01", "to": "2026-11-03"}
        )
        assert parquet.read_table(io.BytesIO(answer.content)).num_rows == 8
        page = client.get(f"{ROUTE}/report", params={"month": "2026-11"})
        assert (
            page.headers["content-type"].startswith("text/html")
            and "9 windows were judged" in page.text
        )
        for path, query, says in (
            (
                "findings.parquet",
                {"from": "2026-11-03", "to": "2026-11-01"},
                "the end must lie after",
            ),
            ("findings.parquet", {"from": "yesterday", "to": "2026-11-01"}, "must be a time like"),
            (
                "findings.parquet",
                {"from": "0001-01-01T00:00+10:00", "to": "2026-11-01"},
                "must be a time like",
            ),
            (
                "findings.parquet",
                {"from": "2026-11-01", "to": "9999-12-31T23:00-10:00"},
                "must be a time like",
            ),
            ("report", {"month": "November"}, "must be YYYY-MM"),
            ("report", {"month": "9999-12"}, "must be YYYY-MM"),
            ("report", {"month": "0000-01"}, "must be YYYY-MM"),
            ("report", {"month": "2026-1"}, "must be YYYY-MM"),
            ("report", {"month": "2026-11\n"}, "must be YYYY-MM"),
        ):
            assert says in refused_by(client.get(f"{ROUTE}/{path}", params=query), 422)
        other = client.get(
            "/api/v1/assets/nobody/findings.parquet",
            params={"from": "2026-11-01", "to": "2026-11-03"},
        )
        refused_by(other, 404)


def test_files_and_pages_are_written_one_at_a_time_below_the_data_folder(
    run_service, monkeypatch, tmp_path
):
    (tmp_path / "data" / "downloads" / "of-a-crash").mkdir(parents=True)
    service = run_service(data=tmp_path / "data")
    assert not (tmp_path / "data" / "downloads").exists()
    fill(service.services.store, monkeypatch, count=3)
    at_once, most, places = [], [], []

    def slowly(made):
        def one(*given):
            at_once.append(1)
            most.append(len(at_once))
            places.extend(each for each in given if isinstance(each, Path))
            threading.Event().wait(0.1)
            at_once.pop()
            return made(*given)

        return one

    monkeypatch.setattr(results, "write_findings", slowly(results.write_findings))
    monkeypatch.setattr(results, "month_report", slowly(results.month_report))
    span = {"from": "2026-11-01", "to": "2026-11-03"}
    asked = [("findings.parquet", span)] * 3 + [("report", {"month": "2026-11"})] * 2
    with (
        httpx.Client(base_url=service.url, timeout=60) as client,
        ThreadPoolExecutor(len(asked)) as together,
    ):
        answers = list(
            together.map(lambda each: client.get(f"{ROUTE}/{each[0]}", params=each[1]), asked)
        )
    assert [answer.status_code for answer in answers] == [200] * 5 and most == [1] * 5
    assert len(places) == 3 and all(place.is_relative_to(tmp_path / "data") for place in places)


@pytest.fixture
def refused_by():
    def check(answer, status):
        assert (
            answer.status_code == status
            and answer.headers["content-type"] == "application/problem+json"
        ), answer.text
        return answer.json()["detail"]

    return check


def test_the_command_refuses_what_is_not_there(tmp_path, filled, capsys):
    _, data = filled
    span = ["--from", "2026-11-01", "--to", "2026-11-02", "--out", str(tmp_path / "out")]
    assert run(["results", "parquet", "nobody", *span, "--data", str(data)]) == BAD_INPUT
    assert (
        "there is none of this name" in capsys.readouterr().err and not (tmp_path / "out").exists()
    )
    assert (
        run(["results", "parquet", "press", *span, "--data", str(tmp_path / "empty")]) == BAD_INPUT
    )
    assert "nothing was stored yet" in capsys.readouterr().err


def test_the_database_of_an_older_service_is_refused_and_stays_as_it_is(tmp_path, capsys):
    database = Database(f"sqlite:///{tmp_path / 'residuum.db'}")
    database.migrate()
    database.migrate("-1")
    older = database.revision()
    span = ["--from", "2026-11-01", "--to", "2026-11-02", "--out", str(tmp_path / "out")]
    month = ["--month", "2026-11", "--out", str(tmp_path / "november.html")]
    for asked in (["parquet", "press", *span], ["report", "press", *month]):
        assert run(["results", *asked, "--data", str(tmp_path)]) == BAD_INPUT
        assert "is no database of this version" in capsys.readouterr().err
    assert database.revision() == older != newest_revision() and not (tmp_path / "out").exists()
    database.close()
