"""Records from tables of a real PostgreSQL server, as a plant's history has them: wide and long, with gaps, and refused."""

import json
import subprocess
import sys
import time
from contextlib import closing
from urllib.parse import unquote_plus

import httpx
import numpy as np
import psycopg
import pytest
from sqlalchemy import make_url

import residuum as rs
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.identification.errors import BadRecord
from residuum.identification.record_formats.histories import HistoryReader, windows_of
from residuum.identification.record_formats.history import HistoryAway
from residuum.service.cli import BAD_INPUT, DONE, run

N, START = 400, 1_772_323_200.0  # 2026-03-01 00:00 UTC
SPEED = np.round(100.0 + np.random.default_rng(0).normal(size=N), 6)
TORQUE = np.round(np.random.default_rng(1).normal(size=N), 6)


@pytest.fixture(scope="module")
def plant(new_postgresql_database):
    """A database with the same signals in a wide and in a long table; gives its address without a table."""
    url = make_url(new_postgresql_database())
    address = f"timescale://{url.username}@{url.host}:{url.port}/{url.database}"
    connect = {"host": url.host, "port": url.port, "user": url.username, "dbname": url.database}
    with psycopg.connect(**connect) as connection:
        connection.execute(
            'CREATE TABLE wide (time timestamptz, site text, "speed [rpm]" real, torque numeric, on_ bool)'
        )
        connection.execute("COMMENT ON COLUMN wide.torque IS 'N*m'")
        connection.execute(
            "CREATE TABLE long (ts timestamp, tag text, value double precision, unit text)"
        )
        wide, long = [], []
        for k in range(N):
            at = f"2026-03-01 {k // 3600:02d}:{k // 60 % 60:02d}:{k % 60:02d}"
            wide.append(
                (
                    at + "+00",
                    "north",
                    float(SPEED[k]),
                    None if k == 7 else float(TORQUE[k]),
                    k % 2 == 0,
                )
            )
            long.append((at, "speed", float(SPEED[k]), "rpm"))
            if k % 10 == 0:
                long.append((at, "oil temperature", 40.0 + k, "degC"))
        with connection.cursor() as cursor:
            cursor.executemany("INSERT INTO wide VALUES (%s, %s, %s, %s, %s)", wide[::-1])
            cursor.executemany("INSERT INTO long VALUES (%s, %s, %s, %s)", long)
            cursor.execute("CREATE TABLE words (ts timestamp, note jsonb)")
            for k, unit in enumerate(("bar", "kPa")):
                cursor.execute(
                    "INSERT INTO long VALUES (%s, 'pressure', 1, %s)",
                    (f"2026-03-02 00:00:0{k}", unit),
                )
            cursor.execute(
                "INSERT INTO wide VALUES ('infinity', 'north', 1, 1, true), ('2026-03-01', 'south', 1, 1, true)"
            )
    return address


def test_a_wide_table_is_a_record_in_order_of_time(plant):
    record = rs.read(f"{plant}/wide?site=north")
    assert record.names == ("speed", "torque", "on_") or list(record.names) == [
        "speed",
        "torque",
        "on_",
    ]
    assert (record.n, record.sample_time, record.t0) == (N, 1.0, START)
    assert (record.units["speed"], record.units["torque"]) == ("rpm", "N*m")
    np.testing.assert_allclose(record["speed"], SPEED, rtol=1e-6)
    assert np.isnan(record["torque"][7])
    np.testing.assert_array_equal(np.delete(record["torque"], 7), np.delete(TORQUE, 7))
    np.testing.assert_array_equal(record["on_"][:4], [1, 0, 1, 0])


def test_a_span_holds_its_start_and_not_its_end(plant):
    record = rs.read(
        f"{plant}/wide?site=north&tags=torque&start=2026-03-01T01:01:00%2B01:00&end=2026-03-01T00:02"
    )
    assert (list(record.names), record.n, record.t0) == (["torque"], 60, START + 60)
    np.testing.assert_array_equal(record["torque"], TORQUE[60:120])


def test_a_long_table_gives_each_tag_at_its_own_instants(plant):
    record = rs.read(f"{plant}/long?tags=speed,oil temperature")
    assert (record.n, record.sample_time, record.t0) == (N, 1.0, START)
    np.testing.assert_array_equal(record["speed"], SPEED)
    assert record.units["speed"] == "rpm"
    oil = record["oil temperature"]
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(oil)), np.arange(0, N, 10))
    assert any("oil temperature: measured at 40 of 400" in note for note in record.notes)


def test_commands_take_an_address_as_a_record(plant, tmp_path, capsys):
    model = tmp_path / "flywheel.yaml"
    model.write_text(
        "name: flywheel\ninputs: {torque: N*m}\nstates: {w: {unit: rad/s}}\n"
        "parameters: {J: {value: 0.07, unit: kg*m**2}, d: {value: 0.01, unit: N*m*s/rad}}\n"
        "balances: {shaft: {kind: torque, storage: J * der(w), terms: {drive: torque, drag: -d * w}}}\n"
        "outputs: {speed: {value: w, unit: rad/s}}\n"
    )
    address = f"{plant}/wide?site=north&start=2026-03-01T00:01"
    assert run(["compare", str(model), address, "--json"]) == DONE
    assert '"speed"' in capsys.readouterr().out
    assert run(["compare", str(model), f"{plant}/wides"]) == BAD_INPUT
    assert "no table 'wides'; did you mean 'wide'?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("wide?site=north&tags=sped", "no column of numbers 'sped'; did you mean 'speed'?"),
        ("wide?sight=north", "no column 'sight' to choose rows by; did you mean 'site'?"),
        (
            "wide",
            r"rows are told apart by 'site'; name the tags, \?tags=a,b: there are north, south",
        ),
        ("wide?site=west", "no rows in that time"),
        ("wide?site=north&start=soon", "start is 'soon'; must be a date or an instant"),
        ("long?tags=sped", "no rows of tag 'sped' in that time; did you mean 'speed'?"),
        ("long", "name the tags, .*: there are oil temperature, pressure, speed"),
        ("", "must name a database and a table"),
        ("long?tag=tag", "name the tags, .*: there are oil temperature, pressure, speed"),
        ("long?tags=pressure", r"tag 'pressure' is in 'bar' and in 'kPa'|'kPa' and in 'bar'"),
        ("words", "has no column of numbers; there are ts, note"),
        ("wide?site=north&time=when", "no column 'when' for the time"),
    ],
)
def test_a_refusal_is_one_line_with_a_way_on(plant, table, says):
    with pytest.raises(BadRecord, match=says) as refused:
        rs.read(f"{plant}/{table}")
    assert "\n" not in str(refused.value)


def test_no_message_repeats_a_password(plant):
    scheme, rest = plant.split("://")
    user, place = rest.split("@")
    with pytest.raises(BadRecord, match=f"{scheme}://{user}@.*no table 'none'") as refused:
        rs.read(f"{scheme}://{user}:hush-hush@{place}/none")
    assert "hush-hush" not in str(refused.value)
    nobody = f"{scheme}://{user}:hush-hush@127.0.0.1:1/plant/wide"
    with pytest.raises(BadRecord, match="onnect") as refused:
        rs.read(nobody)
    assert "hush-hush" not in str(refused.value) and "\n" not in str(refused.value)


def test_the_connection_cannot_write_and_a_name_is_no_statement(plant):
    with pytest.raises(BadRecord, match="no table"):
        rs.read(f"{plant}/wide;DROP TABLE wide")
    with pytest.raises(BadRecord, match="no column of numbers"):
        rs.read(f"{plant}/wide?site=north&tags=speed%22;DROP")
    with pytest.raises(BadRecord, match="no rows in that time"):
        rs.read(f"{plant}/wide?site=north' OR true --")
    assert rs.read(f"{plant}/wide?site=north").n == N


def test_windows_of_a_history_are_scored_as_the_same_record_cut(plant, tmp_path):
    address = f"{plant}/wide?site=north&tags=torque&start=2026-03-01&end=2026-03-01T00:06&window=90"
    names = windows_of(address)
    assert len(names) == 4 and all("window" not in name for name in names)
    whole = rs.read(address.removesuffix("&window=90"))
    with closing(HistoryReader(address)) as reader:
        parts = [reader.read(name) for name in names]
    for k, (name, part) in enumerate(zip(names, parts, strict=True)):
        assert part.t0 == START + 90 * k and part.source == name
        np.testing.assert_array_equal(part["torque"], whole["torque"][90 * k : 90 * (k + 1)])


def test_each_value_of_a_column_has_windows_of_its_own(plant):
    names = windows_of(f"{plant}/wide?each=site&tags=torque&window=300")
    assert [name.partition("site=")[2][:5] for name in names] == [
        "north",
        "north",
        "south",
        "south",
    ]
    assert "end=2026-03-01T00%3A06%3A39.000001Z" in names[1].replace(":", "%3A")


def _end_connections(plant):
    """What a server that begins anew does to those that are connected."""
    with psycopg.connect(plant.replace("timescale", "postgresql"), autocommit=True) as admin:
        admin.execute(
            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity"
            " WHERE datname = current_database() AND pid <> pg_backend_pid()"
        )


def test_a_server_that_closed_the_connection_is_asked_anew(plant):
    (name, *_) = windows_of(f"{plant}/wide?site=north&window=300")
    with closing(HistoryReader(plant + "/wide")) as reader:
        first = reader.read(name)
        _end_connections(plant)
        np.testing.assert_array_equal(reader.read(name)["torque"], first["torque"])


def test_the_columns_of_a_table_are_asked_for_once_a_connection(plant):
    (name, *_) = windows_of(f"{plant}/wide?site=north&tags=torque&window=300")
    with (
        closing(HistoryReader(plant + "/wide")) as reader,
        psycopg.connect(plant.replace("timescale", "postgresql"), autocommit=True) as admin,
    ):
        assert reader.read(name).units["torque"] == "N*m"
        admin.execute("COMMENT ON COLUMN wide.torque IS 'mN*m'")
        try:
            assert reader.read(name).units["torque"] == "N*m"
            reader.close()
            assert reader.read(name).units["torque"] == "mN*m"
        finally:
            admin.execute("COMMENT ON COLUMN wide.torque IS 'N*m'")


def test_a_history_that_is_away_refuses_no_window(plant):
    (name, *_) = windows_of(f"{plant}/wide?site=north&window=300")
    away = HistoryReader("timescale://me:secret@127.0.0.1:9/nowhere/wide")
    with pytest.raises(HistoryAway, match=r"wide: (?!.*secret)"):
        away.read(name)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("window=no", "window is 'no'; must be a number of seconds above 0"),
        ("site=north", "say how long a window is, in seconds: &window=600"),
        ("window=1e-6", "windows; at most 10000000"),
        ("window=60&each=place", "no column 'place' to part rows by; there are"),
    ],
)
def test_windows_that_cannot_be_cut_are_refused(plant, asked, says):
    with pytest.raises(BadRecord, match=says):
        windows_of(f"{plant}/wide?{asked}")


def test_windows_are_not_one_record(plant):
    with pytest.raises(BadRecord, match="asks for several records; leave it out, or give"):
        rs.read(f"{plant}/wide?window=60")


def test_a_history_is_scored_and_gone_on_with(plant, tmp_path, capsys):
    """By two workers; what an interrupted run left is not done again."""
    address = f"{plant}/wide?site=north&tags=torque&window=50"
    out = tmp_path / "scored.jsonl"
    words = ["reidentify", address, "--output", "torque", "--method", "ar", "--order", "2"]
    words += ["--out", str(out), "--workers", "2"]
    assert run(words) == DONE
    lines = out.read_bytes().splitlines(keepends=True)
    assert len(lines) == 8
    out.write_bytes(b"".join(lines[3:5]) + lines[6][:30])
    assert run(words) == DONE
    assert out.read_bytes().splitlines(keepends=True) == lines


MACHINES = {"pump 1": 0.8, "pump/2": 0.9, "never trained": 0.5}


@pytest.fixture(scope="module")
def fleet(plant, tmp_path_factory):
    """A table of three machines and a folder with the baselines of two: (its address, the folder)."""
    n = 12_000
    with psycopg.connect(plant.replace("timescale", "postgresql"), autocommit=True) as admin:
        admin.execute("CREATE TABLE fleet (time timestamp, machine text, u float8, y float8)")
        with admin.cursor().copy("COPY fleet FROM STDIN") as copy:
            for seed, (machine, pole) in enumerate(MACHINES.items()):
                rng = np.random.default_rng(seed)
                u, y = np.sign(rng.normal(size=n)), np.zeros(n)
                for k in range(1, n):
                    y[k] = pole * y[k - 1] + u[k - 1] + 0.02 * rng.normal()
                y[8000:] += 5.0  # a fault, and below it what an instrument writes for an overload
                y[8321] = 9.9e37
                for k in range(n):
                    stamp = np.datetime64(int(START) + k, "s")
                    copy.write_row((str(stamp), machine, float(u[k]), float(y[k])))
        admin.execute("CREATE INDEX ON fleet (machine, time)")
    folder = tmp_path_factory.mktemp("baselines")
    for machine in list(MACHINES)[:2]:
        words = [f"{plant}/fleet?tags=u,y&machine={machine}&end=2026-03-01T00:30", "--out"]
        file = folder / f"{machine.replace('/', '%2F')}.baseline"
        assert run(["train", "robust-residual", *words, str(file)]) == DONE
    return f"{plant}/fleet?tags=u,y&each=machine", folder


def _rescored(address, folder, out):
    words = ["rescore", "robust-residual", address, "--baseline", str(folder)]
    words += ["--out", str(out), "--workers", "2", "--json"]
    return [sys.executable, "-m", "residuum", *words]


def test_a_fleet_is_judged_by_each_machines_baseline_and_gone_on_with_when_killed(fleet, tmp_path):
    address, folder = fleet
    out = tmp_path / "scored.jsonl"
    command = _rescored(f"{address}&window=200", folder, out)
    end = time.monotonic() + 300
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as begun:
        while not (out.exists() and out.stat().st_size):
            assert begun.poll() is None and time.monotonic() < end, begun.stderr.read()
            time.sleep(0.01)
        begun.kill()
    left = out.read_bytes().splitlines(keepends=True)
    assert 0 < len(left) < 120
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    answers = [json.loads(line) for line in out.read_text().splitlines()]
    assert json.loads(done.stdout)["files"] == len(answers) == 120
    assert set(left) <= set(out.read_bytes().splitlines(keepends=True))
    names = windows_of(f"{address}&window=200", ["pump 1", "pump/2"])
    assert [answer["file"] for answer in answers] == list(names)
    judges = [RobustResidual.load(file) for file in sorted(folder.iterdir())]
    for place, answer in enumerate(answers):
        expected = judges[place // 60].score(rs.read(answer["file"])).to_json()
        assert answer["finding"] == json.loads(json.dumps(expected))
    assert {answer["finding"]["verdict"] for answer in answers[42:60]} == {"faulty"}


def test_a_machine_that_is_trained_later_joins_the_results(fleet, tmp_path, capsys):
    address, folder = fleet
    first, *others = sorted(folder.iterdir())
    mine, out = tmp_path / "mine", tmp_path / "scored.jsonl"
    mine.mkdir()
    words = _rescored(f"{address}&window=1000", mine, out)[3:]
    assert run(words) == BAD_INPUT
    assert "holds no MACHINE.baseline" in capsys.readouterr().err
    (mine / first.name).write_bytes(first.read_bytes())
    assert run(words) == DONE
    before = out.read_bytes()
    for file in others:
        (mine / file.name).write_bytes(file.read_bytes())
    assert run(words) == DONE
    assert out.read_bytes().startswith(before) and len(out.read_bytes().splitlines()) == 24
    one_machine = address.replace("each=machine", "machine=pump 1")
    assert run(_rescored(f"{one_machine}&window=60", mine, out)[3:]) == BAD_INPUT
    assert "is a folder; only windows of a history tell" in capsys.readouterr().err


COLUMNS = """\
streams:
  signals:
    sample_time: 1
    time: {column: time, form: seconds}
    channels: {u: {column: u}, y: {column: y}}
"""


@pytest.fixture
def watched(run_service, tmp_path):
    """A service that watches a pump without a baseline; its address."""
    service = run_service(growing_files=tmp_path)
    machine = {
        "diagnoser": "robust-residual",
        "window": {"cut": "sliding", "length": 200, "step": 200},
        "sources": [{"kind": "file", "channel": "file:pump.csv", "map": "columns.yaml"}],
        "maps": {"columns.yaml": COLUMNS},
    }
    answer = httpx.put(f"{service.url}/api/v1/assets/pump/machine", json=machine, timeout=60)
    assert answer.status_code == 200, answer.text
    return service.url


def test_a_machine_is_trained_from_its_history_and_lends_it_to_the_service_alone(
    fleet, watched, capsys
):
    address = fleet[0].replace("each=machine", "machine=pump 1")
    span = ["--healthy", "2026-03-01T00:00..2026-03-01T02:00"]
    words = ["watch", "train", "pump", "--url", watched, "--json", "--from"]
    assert run([*words, address, *span]) == DONE
    told = json.loads(capsys.readouterr().out)
    assert told["windows"] == 36 and told["alarms"] <= 1
    assert "36 of 36 windows" in told["from"][0] and "machine=pump 1" in unquote_plus(
        told["from"][0]
    )
    asked = f"{address}&start=2026-03-01&end=2026-03-01T02:00&window=200"
    trained = RobustResidual().fit([rs.read(window) for window in windows_of(asked)])
    assert told["learned"] == json.loads(json.dumps(trained.learned()))
    api = f"{watched}/api/v1"
    assert httpx.get(f"{api}/records", timeout=60).json()["items"] == []
    assert httpx.get(f"{api}/assets/pump/machine", timeout=60).json()["baseline"] is True


def test_what_cannot_be_trained_from_is_refused_and_leaves_nothing(
    fleet, watched, tmp_path, capsys
):
    address = fleet[0].replace("each=machine", "machine=pump 1")
    record = tmp_path / "healthy.npz"
    rs.read(f"{address}&end=2026-03-01T00:10").save(record)
    words = ["watch", "train", "pump", "--url", watched]
    for more, says in (
        (["--from", str(record)], "body, records: 1 are given; at least 5 are needed"),
        (["--from", address, "--healthy", "2026-04..2026-03"], "ends before it begins"),
        (["--from", address, "--healthy", "spring"], "must be BEGIN..END"),
        (["--from", address, "--healthy", "2027-03..2027-04"], "no rows"),
        (["--from", f"{address}&start=2026-03-01", "--healthy", "2026-03..2026-03"], "says start"),
        (["--from", fleet[0], "--healthy", "2026-03..2026-03"], "windows of several machines"),
        (["--from", str(record), "--healthy", "2026-03..2026-03"], "--from names none"),
        (["--healthy", "2026-03..2026-03"], "it is missing"),
        (["--from", str(record), "--from", str(tmp_path / "absent.npz")], "no such file"),
        (["--from", str(record), "--leave-out", "3"], "are taken in their place"),
    ):
        assert run([*words, *more]) == BAD_INPUT
        assert says in capsys.readouterr().err
    api = f"{watched}/api/v1"
    assert httpx.get(f"{api}/records", timeout=60).json()["items"] == []
    assert httpx.get(f"{api}/assets/pump/machine", timeout=60).json()["baseline"] is False


def test_windows_that_a_machine_cuts_by_what_it_does_are_not_guessed(
    fleet, run_service, tmp_path, capsys
):
    service = run_service(growing_files=tmp_path)
    moving = COLUMNS.replace("y: {column: y}", "y: {column: y}, phase: {column: phase}")
    machine = {
        "diagnoser": "robust-residual",
        "window": {"cut": "movement"},
        "sources": [{"kind": "file", "channel": "file:gate.csv", "map": "columns.yaml"}],
        "maps": {"columns.yaml": moving},
    }
    answer = httpx.put(f"{service.url}/api/v1/assets/gate/machine", json=machine, timeout=60)
    assert answer.status_code == 200, answer.text
    address = fleet[0].replace("each=machine", "machine=pump 1")
    words = ["watch", "train", "gate", "--url", service.url, "--from"]
    span = ["--healthy", "2026-03-01T00:00..2026-03-01T02:00"]
    assert run([*words, address, *span]) == BAD_INPUT
    assert "are cut by movement, which a history does not tell" in capsys.readouterr().err
    assert run([*words, f"{address}&window=200", *span]) == DONE


def test_windows_are_made_when_asked_for_and_found_by_their_addresses(plant):
    windows = windows_of(f"{plant}/wide?each=site&tags=torque&window=0.1")
    assert len(windows) > 3_000_000 // 400 and windows[-1] == windows[len(windows) - 1]
    for place in (0, 5, len(windows) - 1):
        assert windows.place_of(windows[place]) == place
    other = windows[5].replace("torque", "speed")
    for name in (
        other,
        windows[5] + "&start=2026-03-01",
        "a.csv",
        windows[0].replace("north", "x"),
    ):
        assert name not in windows


def test_a_window_is_read_by_an_index_of_times_without_a_zone(fleet, plant):
    address, _ = fleet
    (name, *_) = windows_of(f"{address}&window=60", ["pump 1"])
    end = time.monotonic() + 60
    with psycopg.connect(plant.replace("timescale", "postgresql"), autocommit=True) as admin:
        admin.execute("ANALYZE fleet")
        scans = "SELECT seq_scan, idx_scan FROM pg_stat_user_tables WHERE relname = 'fleet'"
        before = admin.execute(scans).fetchone()
        # what was counted is told when a connection ends
        with closing(HistoryReader(address)) as reader:
            assert reader.read(name).n == 60
        while (after := admin.execute(scans).fetchone())[1] == before[1]:
            assert time.monotonic() < end, "no index was used"
            time.sleep(0.1)
        assert after[0] == before[0]
