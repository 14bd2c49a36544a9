"""A fleet's files: the same results however many workers, kills and beginnings; refusals are results."""

import contextlib
import json
import os
import subprocess
import sys
import time
import urllib.request
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import quote

import pytest

from benchmarks import fleet as fleet_benchmark
from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record_formats import read_record
from residuum.library.questions.identify import Identify
from residuum.service.cli import run
from residuum.service.fleet import fleet
from residuum.service.fleet.fleet import Reidentify, Rescore, answers_of, open_executor, run_fleet
from residuum.service.machines.baselines import choose_method
from residuum.service.storage import DiskStore
from residuum.service.work.worker_pool import WorkerPool


def silent(*_):
    """Progress that nobody wants to know."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return fleet_benchmark.write_fleet(tmp_path_factory.mktemp("fleet"), 60, 1024)


@pytest.fixture(scope="module")
def serial(files):
    return fleet_benchmark.serial(files)


def test_killed_workers_change_nothing():
    found = fleet_benchmark.campaign(jobs=150, kills=3, samples=512, workers=2)
    assert found["workers killed"] == 3 and found["equal to serial, to the byte"]
    assert found["refused (damaged files)"] == 1


def test_an_unfinished_run_is_gone_on_with_from_where_it_was(files, serial, tmp_path):
    results = tmp_path / "results.jsonl"
    lines = serial.splitlines(keepends=True)
    results.write_bytes(b"".join(lines[20:45]) + lines[50][:17])
    done = []
    with open_executor(1, None) as pool:
        run_fleet(
            files,
            fleet_benchmark.WORK,
            pool,
            results,
            workers=1,
            tell=lambda count, _: done.append(count),
        )
    assert done[0] == 25 and done[-1] == 60 and results.read_bytes() == serial


@pytest.mark.parametrize("text", ["time [s],y [V]\n0,1\n", "my only copy", '{"file": 1}\n'])
def test_a_file_that_is_no_results_file_is_left_alone(text, files, tmp_path):
    mine = tmp_path / "mine.csv"
    mine.write_text(text)
    with ThreadPoolExecutor(1) as executor, pytest.raises(BadInput, match=r"holds (no )?results"):
        run_fleet(files, fleet_benchmark.WORK, executor, mine, workers=1, tell=silent)
    assert mine.read_text() == text


def test_results_of_other_records_alone_are_not_written_over(files, tmp_path):
    results = tmp_path / "results.jsonl"
    with ThreadPoolExecutor(1) as executor:
        run_fleet(files[:2], fleet_benchmark.WORK, executor, results, workers=1, tell=silent)
        theirs = results.read_bytes()
        with pytest.raises(BadInput, match="holds results of other records; give another name"):
            run_fleet(files[2:4], fleet_benchmark.WORK, executor, results, workers=1, tell=silent)
        assert results.read_bytes() == theirs
        work = fleet_benchmark.WORK
        assert run_fleet(files[1:3], work, executor, results, workers=1, tell=silent) == 1
    assert [answer["file"] for answer in answers_of(results)] == files[1:3]


def test_results_of_other_work_are_not_taken_for_ones_own(files, serial, tmp_path):
    results, baseline = tmp_path / "results.jsonl", tmp_path / "baseline"
    results.write_bytes(serial)
    baseline.write_bytes(b"another")
    other = (
        Rescore("robust-residual", None),
        Rescore("bearing", str(baseline)),
        Reidentify(Identify(method="arx", input="speed", output="acceleration", order=2, delay=1)),
    )
    for work in other:
        with (
            ThreadPoolExecutor(1) as executor,
            pytest.raises(BadInput, match="results of another diagnoser"),
        ):
            run_fleet(files, work, executor, results, workers=1, tell=silent)
    assert results.read_bytes() == serial


def end_if_it_is_the_bad_one(file):
    if file == "bad":
        os._exit(9)
    return {"length": len(file)}


def test_a_file_that_ends_every_worker_is_refused_and_the_others_are_done(monkeypatch, tmp_path):
    monkeypatch.setattr("residuum.service.fleet.fleet._ATTEMPTS", 1)
    pool = WorkerPool(1)
    run_fleet(
        ["one", "bad", "three"],
        end_if_it_is_the_bad_one,
        pool,
        tmp_path / "r",
        workers=1,
        tell=silent,
    )
    pool.terminate()
    found = list(answers_of(tmp_path / "r"))
    assert [each.get("length") for each in found] == [3, None, 5]
    assert "ended its worker" in found[1]["refused"]


def test_a_dask_cluster_gives_the_same(files, serial, tmp_path):
    distributed = pytest.importorskip(
        "distributed", reason="the extra 'fleet' is not installed: no cluster was tried"
    )
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as cluster:
        results = tmp_path / "results.jsonl"
        with open_executor(1, cluster.scheduler_address) as executor:
            run_fleet(files, fleet_benchmark.WORK, executor, results, workers=1, tell=silent)
    assert results.read_bytes() == serial


def test_the_commands(files, tmp_path, capsys):
    folder = os.path.dirname(files[0])
    assert (
        run(
            ["rescore", "bearing", folder, "--out", str(tmp_path / "r"), "--workers", "1", "--json"]
        )
        == 0
    )
    summary = json.loads(capsys.readouterr().out)
    assert (summary["files"], summary["refused"]) == (60, 1)
    assert summary["healthy"] + summary["faulty"] + summary["not-assessable"] == 59
    command = [
        "reidentify",
        folder,
        "--input",
        "speed",
        "--output",
        "acceleration",
        "--order",
        "5",
        "--workers",
        "1",
    ]
    assert run([*command, "--out", str(tmp_path / "m"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == 60
    for wrong, says in (
        (["rescore", "bearing", str(tmp_path / "none"), "--out", "r"], "is not a folder"),
        (["rescore", "nothing", folder, "--out", "r"], "known are"),
        (["rescore", "bearing", folder, "--out", "/no/such/r"], "does not exist"),
        (
            ["reidentify", folder, "--input", "a", "--output", "b", "--method", "x", "--out", "r"],
            "known are",
        ),
    ):
        assert run(wrong) == 2 and says in capsys.readouterr().err


def results_of(capsys, out, *arguments):
    assert (
        run(
            [
                "rescore",
                "bearing",
                *map(str, arguments),
                "--out",
                str(out),
                "--workers",
                "1",
                "--json",
            ]
        )
        == 0
    )
    capsys.readouterr()
    return [json.loads(line) for line in out.read_text().splitlines()]


@pytest.mark.parametrize("kind", ["file", "zip"])
def test_a_bucket_gives_what_the_folder_gives_and_is_gone_on_with(
    kind, files, serial, tmp_path, capsys
):
    pytest.importorskip("fsspec", reason="the extra 'fleet' is not installed: no bucket was tried")
    url = f"file://{os.path.dirname(files[0])}"
    if kind == "zip":
        with zipfile.ZipFile(tmp_path / "fleet.zip", "w") as archive:
            for file in files:
                archive.write(file, f"plant/{os.path.basename(file)}")
        url = f"zip://plant::file://{tmp_path / 'fleet.zip'}"
    found = results_of(capsys, tmp_path / "r", url)
    expected = [json.loads(line) for line in serial.splitlines()]
    for mine, theirs in zip(found, expected, strict=True):
        assert os.path.basename(mine["file"]) == os.path.basename(theirs["file"]) and set(
            mine
        ) == set(theirs)
        assert mine.get("finding") == theirs.get("finding")
    (refused,) = (each for each in found if "refused" in each)
    assert refused["refused"].startswith(f"{refused['file']}: ")
    whole = (tmp_path / "r").read_bytes()
    (tmp_path / "r").write_bytes(whole[: len(whole) // 3])
    assert results_of(capsys, tmp_path / "r", url) == found


@pytest.fixture
def s3(free_port, monkeypatch):
    """A server of the S3 protocol, which the environment names: (its address, what stops it)."""
    pytest.importorskip("s3fs", reason="the extra 'fleet' is not installed: no S3 bucket was tried")
    pytest.importorskip("moto", reason="moto is not installed: no S3 bucket was tried")
    address = f"http://127.0.0.1:{(port := free_port())}"
    names = {
        "AWS_ACCESS_KEY_ID": "a",
        "AWS_SECRET_ACCESS_KEY": "b",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_MAX_ATTEMPTS": "1",
    }
    for name, value in (names | {"AWS_ENDPOINT_URL": address}).items():
        monkeypatch.setenv(name, value)
    command = [sys.executable, "-m", "moto.server", "-p", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            wait_for_answer(address, server)
            yield address, server.kill
        finally:
            server.kill()


def wait_for_answer(address, server):
    end = time.monotonic() + 300
    while True:
        with contextlib.suppress(OSError):
            urllib.request.urlopen(address, timeout=60).close()
            return
        assert server.poll() is None and time.monotonic() < end, (
            "the server of the S3 protocol did not start"
        )
        time.sleep(0.1)


def put(address, place, content=b""):
    kind = {"Content-Type": "application/octet-stream"}  # without one it is read as a form
    request = urllib.request.Request(f"{address}/{quote(place)}", content, kind, method="PUT")
    urllib.request.urlopen(request, timeout=300).close()


def rescore(out, place):
    """The command in a process of its own: the S3 client's threads and warnings are not those of this one."""
    command = [
        sys.executable,
        "-c",
        "from residuum.service.cli import main; main()",
        "rescore",
        "bearing",
        place,
    ]
    command += ["--out", out, "--workers", "1", "--json"]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=900)


def test_an_s3_bucket_gives_what_the_folder_gives_and_is_gone_on_with(s3, files, serial, tmp_path):
    address, stop = s3
    put(address, "plant")
    some = files[:20]
    for file in some:
        put(address, f"plant/Halle 1/ä/{os.path.basename(file)}", Path(file).read_bytes())
    results = tmp_path / "r"
    done = rescore(results, "s3://plant/Halle 1")
    assert done.returncode == 0 and json.loads(done.stdout)["files"] == len(some), done.stderr
    whole = results.read_bytes()
    for mine, theirs in zip(
        map(json.loads, whole.splitlines()), map(json.loads, serial.splitlines()[:20]), strict=True
    ):
        assert mine["file"] == f"plant/Halle 1/ä/{os.path.basename(theirs['file'])}"
        assert mine.get("finding") == theirs.get("finding") and ("refused" in mine) == (
            "refused" in theirs
        )
    results.write_bytes(whole[: len(whole) // 3])
    assert rescore(results, "s3://plant").returncode == 0 and results.read_bytes() == whole
    stop()
    refused = rescore(tmp_path / "none", "s3://plant")
    assert refused.returncode == 2 and "s3://plant: cannot be listed" in refused.stderr, (
        refused.stderr
    )
    assert refused.stderr.strip().count("\n") == 0


def test_a_bucket_that_goes_away_ends_the_run_and_refuses_no_file(tmp_path):
    fsspec = pytest.importorskip(
        "fsspec", reason="the extra 'fleet' is not installed: no bucket was tried"
    )
    fleet._file_system.cache_clear()

    class Away(fsspec.AbstractFileSystem):
        def open(self, *_, **__):
            raise KeyError("an error of a library's own")

    fsspec.register_implementation("away", Away, clobber=True)
    work = Rescore("bearing", None, fleet.Bucket("away://bucket"))
    done = json.dumps({"file": "a.csv", "by": work.mark("a.csv"), "refused": "-"}) + "\n"
    (tmp_path / "r").write_text(done)
    with (
        ThreadPoolExecutor(1) as executor,
        pytest.raises(BadInput, match=r"b\.csv: cannot be reached: KeyError .* to go on"),
    ):
        run_fleet(["a.csv", "b.csv"], work, executor, tmp_path / "r", workers=1, tell=silent)
    assert (tmp_path / "r").read_text() == done


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_the_windows_of_a_database_are_judged_again_as_their_files_are(
    kind, files, serial, tmp_path, capsys, request
):
    url = (
        f"sqlite:///{tmp_path / 'residuum.db'}"
        if kind == "sqlite"
        else request.getfixturevalue("new_postgresql_database")()
    )
    store = DiskStore(tmp_path, url)
    sound = [json.loads(line) for line in serial.splitlines() if b"refused" not in line][:20]
    for number, each in enumerate(sound):
        store.add_window(
            f"press-{number % 2}",
            read_record(each["file"]),
            Finding("bearing", "healthy", reason="-"),
        )
    store.close()
    found = results_of(capsys, tmp_path / "r", url, "--data", tmp_path)
    assert [each["file"] for each in found] == [
        f"press-{k}/{number + 1}" for k in (0, 1) for number in range(k, 20, 2)
    ]
    for each in found:
        assert each["finding"] == sound[int(each["file"].split("/")[1]) - 1]["finding"]
    next(Path(tmp_path).glob("blocks/*/*")).unlink()
    again = results_of(capsys, tmp_path / "s", url, "--data", tmp_path)
    assert sum("refused" in each for each in again) == 1


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_each_machine_of_a_database_is_judged_by_its_own_diagnoser(kind, tmp_path, capsys, request):
    url = (
        f"sqlite:///{tmp_path / 'residuum.db'}"
        if kind == "sqlite"
        else request.getfixturevalue("new_postgresql_database")()
    )
    store, bearing, gate = (
        DiskStore(tmp_path, url),
        Bearing.examples()[0],
        GateActuator.examples()[0],
    )
    trained = GateActuator().fit(gate.training, gate.labels).with_settings(method="source")
    trained.save(tmp_path / "gate.base")
    store.add_model_version("gate", "baseline", b"an older one, never loaded")
    store.add_model_version("gate", "baseline", (tmp_path / "gate.base").read_bytes())
    as_is = {"fan": (Bearing(), bearing.faulty[0]), "gate": (trained, gate.faulty[0])}
    for asset, (judge, record) in as_is.items():
        store.add_window(asset, record, judge.score(record))
    store.ensure_asset("silent")
    choose_method(store, "gate", "source", "somebody")
    store.close()
    out = tmp_path / "own"
    assert (
        run(
            [
                "rescore",
                "own",
                url,
                "--data",
                str(tmp_path),
                "--out",
                str(out),
                "--workers",
                "1",
                "--json",
            ]
        )
        == 0
    )
    found = {
        json.loads(line)["file"].split("/")[0]: json.loads(line)
        for line in out.read_text().splitlines()
    }
    capsys.readouterr()
    assert set(found) == {"fan", "gate"}
    for asset, (judge, record) in as_is.items():
        expected = judge.score(record)
        told = found[asset]["finding"]
        assert (told["diagnoser"], told["verdict"], told["class"]) == (
            judge.name,
            expected.verdict,
            expected.fault_class,
        )
        assert told["thresholds"] == pytest.approx(dict(expected.thresholds))
    store = DiskStore(tmp_path, url)
    store.add_model_version("gate", "baseline", (tmp_path / "gate.base").read_bytes())
    store.close()
    assert run(["rescore", "own", url, "--data", str(tmp_path), "--out", str(out)]) == 2, (
        "another baseline is other work"
    )
    assert "another diagnoser, baseline or method" in capsys.readouterr().err


def test_what_holds_no_fleet_is_refused(tmp_path, capsys):
    (tmp_path / "old.db").touch()
    for wrong, says in (
        ((f"sqlite:///{tmp_path / 'none.db'}", "--data", str(tmp_path)), "no such database"),
        (
            (f"sqlite:///{tmp_path / 'old.db'}", "--data", str(tmp_path)),
            "no database of this version",
        ),
        ((f"sqlite:///{tmp_path / 'old.db'}",), "--data"),
        (("phlogiston://bucket",), "cannot be listed"),
        ((f"file://{tmp_path}/empty",), "holds no record"),
    ):
        assert run(["rescore", "bearing", *wrong, "--out", str(tmp_path / "r")]) == 2
        message = capsys.readouterr().err
        assert says in message and message.count("\n") == 1
    assert not (tmp_path / "none.db").exists()
    for arguments, says in (
        ((str(tmp_path),), "is no database"),
        (("sqlite:///x", "--baseline", "b"), "each has its own"),
    ):
        assert (
            run(["rescore", "own", *arguments, "--out", str(tmp_path / "r")]) == 2
            and says in capsys.readouterr().err
        )


def test_a_file_name_that_is_no_text_is_refused_before_the_work_begins(tmp_path, capsys):
    (Path(os.fsdecode(os.fsencode(tmp_path) + b"/press-\xff.csv"))).write_text(
        "time [s],y [V]\n0,1\n"
    )
    assert run(["rescore", "bearing", str(tmp_path), "--out", str(tmp_path / "r")]) == 2
    assert "not UTF-8" in capsys.readouterr().err and not (tmp_path / "r").exists()


def test_a_reidentified_model_is_the_identified_one(tmp_path):
    assert run(["simulate", "process", "--out", str(tmp_path / "a.csv"), "--duration", "60"]) == 0
    work = Reidentify(Identify(method="arx", input="u", output="y", order=2, delay=1))
    assert len(work(str(tmp_path / "a.csv"))["model"]["impulse_response"]) > 5
    assert "refused" in work(str(tmp_path / "absent.csv"))


def test_files_of_an_older_format_are_records_of_a_folder(tmp_path):
    for name in ("new.mf4", "OLD.MDF", "notes.md"):
        (tmp_path / name).write_bytes(b"")
    assert [Path(item).name for item in fleet.Folder(str(tmp_path)).items()] == [
        "OLD.MDF",
        "new.mf4",
    ]
