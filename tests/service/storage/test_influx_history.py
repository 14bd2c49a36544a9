"""Records from a real InfluxDB, as a plant's history has them, and refused."""

import subprocess
import time
from contextlib import closing
from urllib.error import URLError
from urllib.parse import urlencode
from urllib.request import urlopen

import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import BadRecord
from residuum.identification.record_formats.histories import HistoryReader, windows_of
from residuum.identification.record_formats.history import HistoryAway
from residuum.service.cli import DONE, run
from tests.service.conftest import _free_port, find_program, not_here

N, START = 500, 1_772_323_200  # 2026-03-01 00:00 UTC
SPEED = 100.0 + np.random.default_rng(0).normal(size=N)


def asked(base, statement):
    with urlopen(f"{base}/query?{urlencode({'q': statement})}", data=b"") as answer:
        return answer.read().decode()


@pytest.fixture(scope="module")
def influx(tmp_path_factory):
    """The address of a database `plant` with the measurements `pumps` and `words`."""
    program = find_program("influxd")
    if program is None:
        not_here("influxd", "records from InfluxDB")
    folder, port, rpc = tmp_path_factory.mktemp("influx"), _free_port(), _free_port()
    settings = folder / "influx.conf"
    settings.write_text(
        f'reporting-disabled = true\nbind-address = "127.0.0.1:{rpc}"\n'
        f'[meta]\ndir = "{folder}/meta"\n[data]\ndir = "{folder}/data"\nwal-dir = "{folder}/wal"\n'
        f'[http]\nbind-address = "127.0.0.1:{port}"\nlog-enabled = false\n'
    )
    server = subprocess.Popen(
        [program, "-config", str(settings)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    base = f"http://127.0.0.1:{port}"
    end = time.monotonic() + 120
    while True:
        try:
            urlopen(f"{base}/ping", timeout=5).close()
            break
        except (URLError, OSError):
            assert server.poll() is None and time.monotonic() < end
            time.sleep(0.1)
    # what fails in a statement is told in an answer of 200: a server that has just begun may be
    # too busy to make one
    while "plant" not in asked(base, "SHOW DATABASES"):
        asked(base, "CREATE DATABASE plant")
        assert server.poll() is None and time.monotonic() < end
    lines = [
        f"pumps,site=north speed\\ [rpm]={float(SPEED[k])!r},on={'true' if k % 2 else 'false'},"
        f'mode="run"{f",oil={40 + k}i" if k % 10 == 0 else ""} {START + k}'
        for k in range(N)
    ]
    lines += [f"pumps,site=south speed\\ [rpm]=1 {START}", f'words note="hello" {START}']
    written = urlopen(f"{base}/write?db=plant&precision=s", data="\n".join(lines).encode())
    written.close()
    yield f"influx://127.0.0.1:{port}/plant"
    server.terminate()
    server.wait()


def test_fields_are_a_record_with_the_units_of_their_names(influx):
    record = rs.read(f"{influx}/pumps?site=north")
    assert set(record.names) == {"speed", "on", "oil"} and record.units["speed"] == "rpm"
    assert (record.n, record.sample_time, record.t0) == (N, 1.0, float(START))
    np.testing.assert_array_equal(record["speed"], SPEED)
    np.testing.assert_array_equal(record["on"][:3], [0, 1, 0])
    np.testing.assert_array_equal(record["oil"][::10], 40 + np.arange(0, N, 10))
    assert np.isnan(record["oil"][1])


def test_a_span_holds_its_start_and_not_its_end(influx):
    record = rs.read(
        f"{influx}/pumps?site=north&tags=speed&start=2026-03-01T00:01&end=2026-03-01T00:02"
    )
    assert (record.n, record.t0) == (60, START + 60.0)


def test_a_command_reads_it_as_a_file(influx, tmp_path, capsys):
    words = ["identify", f"{influx}/pumps?site=north&tags=speed", "--output", "speed"]
    out = tmp_path / "model.json"
    assert run([*words, "--method", "ar", "--order", "2", "--out", str(out)]) == DONE


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("pumps", "rows of several sources .site=north; site=south.; say which, as &site=north"),
        ("pump", "no measurement 'pump'; did you mean 'pumps'"),
        ("pumps?tags=sped", "no field of numbers 'sped'; did you mean 'speed'"),
        ("words", "has no field of numbers; there are note"),
        ("pumps?site=north&start=2027-01-01", "no rows in that time"),
        ("pumps?site=west", "no rows in that time"),
        ("pumps?site=n'orth", "no rows in that time"),
        ("pumps?window=60", "asks for several records; leave it out, or give"),
    ],
)
def test_what_is_not_there_is_refused(influx, asked, says):
    with pytest.raises(BadRecord, match=says):
        rs.read(f"{influx}/{asked}")


def test_windows_of_each_source_are_those_of_the_whole_record(influx):
    names = windows_of(f"{influx}/pumps?each=site&tags=speed&window=200")
    assert [name.partition("site=")[2][:5] for name in names] == ["north"] * 3 + ["south"] * 3
    with closing(HistoryReader(f"{influx}/pumps")) as reader:
        parts = [reader.read(name)["speed"] for name in names[:3]]
        np.testing.assert_array_equal(np.concatenate(parts), SPEED)
        with pytest.raises(BadRecord, match="no rows in that time"):
            reader.read(names[4])
    with pytest.raises(BadRecord, match="no tag 'place' to part rows by; there are site"):
        windows_of(f"{influx}/pumps?each=place&window=200")


def _write(influx, line):
    base, _, database = influx.replace("influx://", "http://").rpartition("/")
    urlopen(f"{base}/write?db={database}&precision=s", data=line.encode()).close()


def test_the_fields_of_a_measurement_are_asked_for_once_until_closed(influx):
    _write(influx, "\n".join(f"fans n={k} {START + k}" for k in range(10)))
    (name,) = windows_of(f"{influx}/fans?window=300")
    with closing(HistoryReader(f"{influx}/fans")) as reader:
        assert list(reader.read(name).names) == ["n"]
        _write(influx, "\n".join(f"fans late={k} {START + k}" for k in range(10)))
        assert list(reader.read(name).names) == ["n"]
        reader.close()
        assert set(reader.read(name).names) == {"n", "late"}


def test_a_database_that_is_not_there_and_a_server_that_is_away_are_told(influx, free_port):
    with pytest.raises(BadRecord, match="database not found: plants"):
        rs.read(f"{influx}s/pumps")
    with pytest.raises(HistoryAway, match=r"(?!.*secret).*refused"):
        rs.read(f"influx://me:secret@127.0.0.1:{free_port()}/plant/pumps")
