"""Windows from a gateway to a service: whatever is killed or cut off, each is stored, once, those of a machine in their order.

A campaign of a thousand windows is `python -m benchmarks.gateway`.
"""

import hashlib
import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from benchmarks.gateway import Plant, campaign, window
from benchmarks.partition import machine
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats import read_record
from residuum.service.cli import DONE, run
from residuum.service.machines.baselines import choose_method
from residuum.service.settings import BadSettings, load_settings
from residuum.service.storage import DiskStore
from residuum.service.window_queue.gateway import Gateway, Sending
from residuum.service.window_queue.set_aside import SetAside
from residuum.service.window_queue.spool import Spool

PATIENCE = 300


def wait_for(condition, what):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, what()
        time.sleep(0.02)


@pytest.fixture(scope="module")
def service(run_service):
    return run_service()


@pytest.fixture
def start_gateway(tmp_path):
    """Starts gateways whose spools are in this folder."""
    started = []

    def start(url, **options):
        gateway = Gateway(
            Spool(tmp_path / "spool", 2**30), SetAside(tmp_path), Sending(url, **options)
        )
        gateway.start()
        started.append(gateway)
        return gateway

    yield start
    for gateway in started:
        gateway.stop()


class Answering:
    """A server that answers each window as it is told: by asset a list of (status, content type), the last for ever."""

    def __init__(self, **answers):
        came = self.came = []

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                self.rfile.read(int(self.headers["Content-Length"]))
                asset = self.path.split("/")[4]
                came.append((asset, self.headers["Idempotency-Key"], self.headers["X-API-Key"]))
                status, kind = answers[asset][0]
                if len(answers[asset]) > 1:
                    answers[asset].pop(0)
                body = json.dumps({"detail": f"{asset} is {status}"}).encode()
                self.send_response(status)
                self.send_header("Content-Type", kind)
                if status == 201:
                    self.send_header("Location", f"/api/v1/assets/{asset}/windows/1")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                """Nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self):
        self._server.shutdown()
        self._server.server_close()


PROBLEM, TEXT = "application/problem+json", "text/plain"
STORED = (201, "application/json")


@pytest.fixture
def answering():
    servers = []

    def start(**answers):
        servers.append(Answering(**answers))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


def test_kills_and_cuts_lose_nothing_and_store_nothing_twice():
    disturbances = (Plant.kill_service, Plant.kill_gateway, Plant.cut)
    found = campaign(24, 6, disturbances=disturbances)
    assert sum(found["disturbances"].values()) >= 2
    assert found["on the gateway's disk"] >= 20
    assert [found[name] for name in ("lost", "twice", "astray", "set aside")] == [0, 0, 0, 0]


def test_a_refused_window_is_set_aside_holds_up_nothing_and_can_be_sent_again(
    service, start_gateway, tmp_path, monkeypatch, capsys
):
    def command(*arguments):
        run(["set-aside", "--data", str(tmp_path), *arguments])
        return capsys.readouterr()

    monkeypatch.setenv("RESIDUUM_SERVICE_URL", service.url)
    gateway = start_gateway(service.url)
    unknown = machine("aside-1").model_copy(update={"diagnoser": "phlogiston"})
    for of, number in ((unknown, 0), (machine("aside-1"), 1)):
        gateway.handle(of, window(number), None, None)
    wait_for(lambda: gateway.status()["waiting"] == 0, gateway.status)
    assert (gateway.status()["refused"], gateway.status()["stored"]) == (1, 1)
    aside = SetAside(tmp_path)
    (refused,) = aside.newest()
    assert refused.machine == "aside-1" and "phlogiston" in refused.reason
    request = aside.request(refused.name).replace(b"phlogiston", b"bearing")
    aside.put("mended", "aside-1", request, "as if an update had mended it")
    again = json.loads(command("--again", "--json").out.splitlines()[-1])
    (mended,) = (each["name"] for each in again["windows"] if each["key"] == "mended")
    assert again["stored"] == [mended]
    assert [each.name for each in aside.newest()] == [refused.name]
    assert refused.reason in command(refused.name, "--to", str(tmp_path / "taken.npz")).out
    taken = read_record(tmp_path / "taken.npz")
    np.testing.assert_array_equal(taken["acceleration"], window(0)["acceleration"])
    assert "none of this name is set aside" in command("other").err
    kept = service.services.store.windows("aside-1").items
    assert [each.t0 for each in kept] == [0.0, 1.0]


def test_what_is_stored_is_the_window_to_the_bit(service, start_gateway):
    record = Record(
        {
            "acceleration": np.array([0.1, np.nan] * 200, np.float32),
            "b": np.array([1e-300, -0.0] * 200),
        },
        {"acceleration": "m/s²", "b": "V"},
        1e-4,
        t0=7.5,
    )
    gateway, store = start_gateway(service.url), service.services.store
    gateway.handle(machine("bits"), record, None, None)
    wait_for(lambda: gateway.status()["stored"] == 1, gateway.status)
    (stored,) = store.windows("bits").items
    back = store.window_record("bits", stored.id)
    assert (stored.t0, back.sample_time, dict(back.units)) == (7.5, 1e-4, dict(record.units))
    for name in record.names:
        assert back[name].dtype == record[name].dtype
        np.testing.assert_array_equal(back[name], record[name])


def test_a_window_that_its_diagnoser_cannot_judge_is_kept_as_not_assessable(service, start_gateway):
    gateway, store = start_gateway(service.url), service.services.store
    other = Record({"temperature": [1.0, 2.0]}, {"temperature": "K"}, 1.0)
    gateway.handle(machine("strange"), other, None, None)
    wait_for(lambda: gateway.status()["stored"] == 1, gateway.status)
    (stored,) = store.windows("strange").items
    assert store.finding_of(stored.id).finding.verdict.value == "not-assessable"


def test_the_chosen_method_decides_whatever_the_gateway_says_and_a_baseline_has_a_name(
    service, start_gateway, tmp_path
):
    case, store = RobustResidual.examples()[0], service.services.store
    RobustResidual().fit(case.training).save(tmp_path / "trained")
    store.add_model_version("common", "baseline", (tmp_path / "trained").read_bytes())
    gateway = start_gateway(service.url)
    said = {"diagnoser": "robust-residual", "method": "default", "baseline": "common"}
    for asset in ("plant", "other"):
        store.ensure_asset(asset, diagnoser="robust-residual")
    choose_method(store, "plant", "source", "somebody")
    for asset in ("plant", "other"):
        gateway.handle(machine(asset).model_copy(update=said), case.faulty[0], None, None)
    wait_for(lambda: gateway.status()["waiting"] == 0, gateway.status)
    found = {a: store.finding_of(store.windows(a).items[0].id).finding for a in ("plant", "other")}
    methods = {asset: finding.evidence["method"] for asset, finding in found.items()}
    assert methods == {"plant": "source", "other": "default"}


def test_a_machine_whose_windows_wait_holds_up_no_other_and_each_is_sent_again_by_its_key(
    answering, start_gateway
):
    # each asks for patience in its own way: none of them is about the window
    waits = [
        (503, PROBLEM),
        (429, PROBLEM),
        (401, PROBLEM),
        (403, PROBLEM),
        (404, TEXT),
        (302, TEXT),
    ]
    server = answering(away=[*waits, STORED], here=[STORED])
    gateway = start_gateway(server.url)
    for number in range(3):
        gateway.handle(machine("away"), window(number), None, None)
        gateway.handle(machine("here"), window(number), None, None)
    wait_for(
        lambda: gateway.status()["stored"] == 6, lambda: (gateway.status(), gateway.troubles())
    )
    keys = {asset: [key for a, key, _ in server.came if a == asset] for asset in ("away", "here")}
    assert len(keys["here"]) == 3 and len(set(keys["away"])) == 3
    assert keys["away"][: len(waits) + 1] == [keys["away"][0]] * (len(waits) + 1)
    assert gateway.status()["refused"] == 0 and gateway.troubles() == {}


def test_faults_of_the_service_set_one_window_aside_in_the_end(answering, start_gateway, tmp_path):
    server = answering(press=[*[(500, PROBLEM)] * 5, STORED], large=[(413, TEXT), STORED])
    gateway = start_gateway(server.url)
    for asset in ("press", "large"):
        for number in range(2):
            gateway.handle(machine(asset), window(number), None, None)
    wait_for(lambda: gateway.status()["waiting"] == 0, gateway.status)
    assert gateway.status() == {"stored": 2, "refused": 2, "waiting": 0, "dropped": 0}
    told = {refusal.machine: refusal.reason for refusal in SetAside(tmp_path).newest()}
    assert told["press"] == "5 times, status 500: press is 500" and "413" in told["large"]


def test_windows_wait_until_their_key_lets_them_in(run_service, start_gateway, tmp_path):
    (tmp_path / "keys").write_text(f"hall engineer {hashlib.sha256(b'right').hexdigest()}\n")
    service = run_service(api_keys=tmp_path / "keys")
    (tmp_path / "key").write_text("wrong\n")
    gateway = start_gateway(service.url, key_file=tmp_path / "key")
    gateway.handle(machine("press"), window(0), None, None)
    wait_for(lambda: "status 401" in gateway.troubles().get("press", ""), gateway.troubles)
    # no header can hold it
    (tmp_path / "key").write_text("ключ\n")
    wait_for(lambda: "is no API key" in gateway.troubles().get("press", ""), gateway.troubles)
    (tmp_path / "key").unlink()
    wait_for(lambda: "cannot be read" in gateway.troubles().get("press", ""), gateway.troubles)
    (tmp_path / "key").write_text("right\n")
    wait_for(lambda: gateway.status()["stored"] == 1, gateway.troubles)


def test_a_spool_keeps_its_windows_over_a_crash_and_lets_the_oldest_go_when_it_is_full(tmp_path):
    spool = Spool(tmp_path, 1000)
    keys = [spool.put(bytes([number]) * 300, "press-1") for number in range(5)]
    assert (spool.dropped, len(spool), spool.oldest("press-1")) == (2, 3, keys[2])
    (tmp_path / "unfinished.part").write_bytes(b"half")
    again = Spool(tmp_path, 1000)
    assert again.oldest("press-1") == keys[2] and again.read(keys[3]) == b"\x03" * 300
    assert len(list(tmp_path.iterdir())) == 3
    assert again.remove(keys[2]) and not again.remove(keys[2]) and again.read(keys[2]) is None
    new = again.put(b"new", "hall-1.press_2")
    for each in (again, Spool(tmp_path, 1000)):
        assert each.machines() == ["press-1", "hall-1.press_2"]
        assert (each.oldest("press-1"), each.oldest("hall-1.press_2")) == (keys[3], new)
    assert again.remove(new) and again.machines() == ["press-1"]
    assert again.oldest("hall-1.press_2") is None
    (tmp_path / "000000000001-key-press.window").write_bytes(b"of an older version")
    with pytest.raises(BadInput, match="let that version send them"):
        Spool(tmp_path, 1000)


def test_what_is_set_aside_is_bounded_and_counted(tmp_path, monkeypatch):
    monkeypatch.setattr("residuum.service.window_queue.set_aside._MOST", 3)
    aside = SetAside(tmp_path)
    assert (aside.count, aside.newest()) == (0, [])
    for number in range(5):
        aside.put(f"../key {number}", "press", b"x", "why")
    assert (aside.count, [each.key for each in aside.newest()]) == (
        5,
        [f"../key {number}" for number in (4, 3, 2)],
    )
    assert {file.parent for file in tmp_path.rglob("*.request")} == {tmp_path / "set-aside"}


def test_what_a_gateway_lacks_and_what_is_no_more_is_told_with_a_way_on(
    capsys, monkeypatch, tmp_path
):
    def refusal(*words):
        assert run([*words]) == 2
        return capsys.readouterr().err

    assert "setting machines" in refusal("gateway", "--data", str(tmp_path))
    assert "service_url" in refusal("scorer", "--part", "1/2")
    one = json.dumps([machine("press").model_dump(mode="json")])
    monkeypatch.setenv("RESIDUUM_MACHINES", one)
    assert "needs the service" in refusal("gateway", "--data", str(tmp_path))
    monkeypatch.setenv("RESIDUUM_MQTT", "mqtt://127.0.0.1:1")
    assert "no more over the broker" in refusal("gateway", "--data", str(tmp_path))
    monkeypatch.setenv("RESIDUUM_SERVICE_URL", "http://127.0.0.1:1")
    monkeypatch.setenv("RESIDUUM_SERVICE_KEY_FILE", str(tmp_path / "none"))
    assert "service_key_file" in refusal("gateway", "--data", str(tmp_path))


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"service_key_file": "key"}, "are for service_url"),
        ({"service_url": "https://eva:secret@plant/"}, "without a user"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings, says):
    with pytest.raises(BadSettings, match=says):
        load_settings(**settings)


def test_the_doctor_says_whether_the_service_lets_a_gateway_in(
    service, tmp_path, monkeypatch, capsys
):
    DiskStore(tmp_path / "data", f"sqlite:///{tmp_path / 'data' / 'residuum.db'}").close()

    def told():
        status = run(["doctor", "--data", str(tmp_path / "data"), "--json"])
        checks = json.loads(capsys.readouterr().out.splitlines()[-1])["checks"]
        return status, next(check for check in checks if check["name"] == "service")

    monkeypatch.setenv("RESIDUUM_SERVICE_URL", service.url)
    status, check = told()
    assert (status, check["ok"], check["remark"]) == (DONE, True, "")
    SetAside(tmp_path / "data").put("key", "press", b"x", "why it is")
    assert "1 windows were set aside" in told()[1]["remark"]
    monkeypatch.setenv("RESIDUUM_SERVICE_URL", "http://127.0.0.1:1")
    assert not told()[1]["ok"]
