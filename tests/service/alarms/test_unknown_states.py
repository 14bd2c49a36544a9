"""A state that suppresses alarms is told by a signal that the machine has: any other is refused, or told where it shows late."""

import json

import httpx
import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.alarms.machine_states import suppressing_state
from residuum.service.cli import run
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.machines.adding import named, units_of_windows
from residuum.service.machines.machine_line import MachineLine
from residuum.service.storage import DiskStore

PLANT = {
    "diagnoser": "robust-residual",
    "window": {"cut": "sliding"},
    "sources": [{"kind": "modbus", "port": 1, "map": "process_plant.yaml"}],
}


def plant(signal, unit, **more):
    rule = {"suppress": [{"signal": signal, "unit": unit, "below": 0.1}]}
    return {"asset": "plant", "alarms": rule, **PLANT, **more}


def line_of(machine):
    return MachineLine(MachineSettings(**machine), lambda *_: lambda: None, lambda _: None)


def test_a_misspelled_signal_of_a_machine_s_own_rule_is_refused_with_those_it_has():
    (name, unit), *_ = line_of(plant("u", "")).units.items()
    assert name == "u"
    with pytest.raises(BadInput) as refused:
        line_of(plant("uu", unit))
    assert str(refused.value) == (
        "machine 'plant', alarms, suppress: no signal 'uu'; did you mean 'u'? there are u, y"
    )
    with pytest.raises(BadInput, match=r"'u' is in .*, which is not of the kind of kg"):
        line_of(plant("u", "kg"))


def test_a_signal_that_channels_rename_is_known_by_both_names_and_suppresses_by_both():
    channels = {"voltage": "u", "extra": "y"}
    for signal in ("u", "voltage"):
        machine = MachineSettings(**plant(signal, "", channels=channels))
        line = MachineLine(machine, lambda *_: lambda: None, lambda _: None)
        assert set(line.units) == {"voltage", "extra"}
        bus = Record({"u": np.zeros(4), "y": np.ones(4)}, {"u": "", "y": ""}, 1.0)
        rule = machine.alarm_rule(AlarmRule())
        assert suppressing_state(rule, named(bus, channels)) == "voltage below 0.1"
    with pytest.raises(BadInput, match="there are extra, voltage"):
        line_of(plant("current", "", channels=channels))


@pytest.mark.parametrize("channels", [{}, {"a": "b"}, {"a": "b", "c": "a"}, {"x": "b", "b": "b"}])
def test_units_of_windows_are_those_that_windows_have(channels):
    units = {"a": "V", "b": "A", "d": "rpm"}
    channels = {name: bus for name, bus in channels.items() if name != "b"}
    record = Record({name: np.zeros(2) for name in units}, units, 1.0)
    assert units_of_windows(channels, units) == dict(named(record, channels).units)


def test_what_shows_late_is_told_by_log_and_store_until_a_window_has_it(tmp_path, log_lines):
    rule = AlarmRule(suppress=[{"signal": "sped", "unit": "rpm", "below": 60}])
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'r.db'}", rule_of=lambda _asset: rule)

    def see(asset, name, unit="rpm"):
        record = Record({name: np.zeros(3)}, {name: unit}, 1.0)
        store.add_window(asset, record, Finding("bearing", "faulty", reason="-"))

    see("press", "speed")
    see("press", "speed")
    see("fan", "sped")
    why = "suppress: no signal 'sped'; did you mean 'speed'? there are speed"
    assert store.untold_states.now() == {"press": why}
    assert [(line["machine"], line["reason"]) for line in log_lines] == [("press", why)]
    see("press", "sped", "V")
    assert "'sped' is in V" in store.untold_states.now()["press"]
    see("press", "sped")
    assert store.untold_states.now() == {}
    store.close()


def test_health_tells_it_of_a_rule_of_the_service(run_service):
    rule = {"suppress": [{"signal": "sped", "unit": "rpm", "below": 60}]}
    service = run_service(alarms=rule)
    ready = f"{service.url}/api/v1/health/ready"
    assert httpx.get(ready, timeout=60).json()["alarms"] == {}
    record = Record({"speed": np.zeros(3)}, {"speed": "rpm"}, 1.0)
    service.services.store.add_window("press", record, Finding("bearing", "faulty", reason="-"))
    told = httpx.get(ready, timeout=60).json()
    assert told["status"] == "degraded" and "did you mean 'speed'?" in told["alarms"]["press"]


def test_doctor_refuses_a_machine_s_own_and_remarks_on_the_service_s(tmp_path, capsys):
    def told(settings):
        file = tmp_path / "residuum.yaml"
        file.write_text(json.dumps(settings))
        run(["doctor", "--data", str(tmp_path / "new"), "--settings", str(file), "--json"])
        checks = json.loads(capsys.readouterr().out)["checks"]
        return next(check for check in checks if check["name"] == "machine plant")

    own = told({"machines": [plant("uu", "")]})
    assert not own["ok"] and "no signal 'uu'; did you mean 'u'?" in own["says"]
    shared = {"alarms": plant("uu", "")["alarms"], "machines": [{"asset": "plant", **PLANT}]}
    assert "no signal 'uu'; did you mean 'u'?" in told(shared)["remark"]
