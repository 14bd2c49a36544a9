"""A simulated device takes an order at its next look, however much waits on its bus before it."""

import uuid

import pytest

from residuum.service.fieldbus.can.can_bus import open_bus
from residuum.service.fieldbus.can.can_source import COMMAND
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.settings import MAPS
from residuum.service.simulated.device import Device
from residuum.service.simulated.wiring import wiring_of
from residuum.simulation import MACHINES


def test_an_order_behind_thousands_of_frames_is_taken_at_once():
    channel, wiring = f"virtual:{uuid.uuid4()}", wiring_of("gate-actuator")
    machine = MACHINES[wiring.machine](seed=0)
    device = Device(machine, wiring, channel, None, 1.0, pytest.fail)
    layouts, other = read_dbc(MAPS / wiring.dbc), open_bus(channel)
    number, fault = next(iter(layouts[COMMAND].choices["fault"].items()))
    still = {name: [0.0] * 5000 for name in layouts["drive"].units}
    other.send_many(layouts["drive"].frame_id, layouts["drive"].encode(range(5000), still))
    other.send_many(
        layouts[COMMAND].frame_id, layouts[COMMAND].encode([0], {"fault": [number], "size": [0.5]})
    )
    device._take_orders()
    assert machine.active_faults == {fault: 0.5}
    other.close()
    device._bus.close()
