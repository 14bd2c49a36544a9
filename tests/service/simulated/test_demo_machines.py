"""The demo's three machines: silent while healthy, and every fault found as soon as it is switched on, through the bus coding."""

import pytest

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.service.fieldbus.settings import WindowSettings
from residuum.service.simulated.demo import DIAGNOSER_OF, simulated_windows
from residuum.service.simulated.wiring import wiring_of
from residuum.simulation import MACHINES

WINDOWS = {
    "gate-actuator": WindowSettings(cut="movement"),
    "gripping-pliers": WindowSettings(cut="round"),
    "process-plant": WindowSettings(cut="sliding", length=30, step=5),
}
SOON = {"gate-actuator": 1, "gripping-pliers": 2, "process-plant": 6}
"""Windows within which a fault must be found: the first movement, two rounds, 60 s."""
IN_TEN_MINUTES = {"gate-actuator": 33, "gripping-pliers": 295, "process-plant": 115}
FAULTS = [
    (machine, fault) for machine in WINDOWS for fault in MACHINES[wiring_of(machine).machine].faults
]


@pytest.fixture
def verdicts(demo_baseline):
    """Gives what the demo's diagnoser says of a machine's next windows."""

    def told(device, machine, count):
        diagnoser = DIAGNOSERS[DIAGNOSER_OF[device]].load(demo_baseline(device))
        found = simulated_windows(machine, wiring_of(device), WINDOWS[device], count)
        return [diagnoser.score(window).verdict.value for window in found]

    return told


@pytest.mark.parametrize("device", WINDOWS)
def test_ten_healthy_minutes_raise_no_alarm(verdicts, device):
    machine = MACHINES[wiring_of(device).machine](seed=2024)
    found = verdicts(device, machine, IN_TEN_MINUTES[device])
    assert machine.time >= 590
    assert set(found) == {"healthy"}


@pytest.mark.parametrize(("device", "fault"), FAULTS)
def test_a_fault_of_default_size_is_found_at_once_and_gone_after_repair(verdicts, device, fault):
    machine = MACHINES[wiring_of(device).machine](seed=77, faults={fault: None})
    assert "faulty" in verdicts(device, machine, SOON[device])
    machine.clear_fault(fault)
    assert set(verdicts(device, machine, SOON[device])) == {"healthy"}
