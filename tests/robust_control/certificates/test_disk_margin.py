"""Disk margins against the perturbed loop itself."""

import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates import disk_margin, loop_responses
from residuum.robust_control.loop import characteristic
from residuum.robust_control.synthesis.constrained_structure import PIDN

TS = 0.05
PLANT = TransferFunction([2.0], [1.0, 0.4, 1.0]).discretise(TS)
CONTROLLER = PIDN(TS).transfer_function(np.array([0.3, 0.1, 0.4, 0.3]))


@pytest.mark.parametrize("skew", [-1.0, 0.0, 1.0])
def test_gain_and_phase_inside_the_disk_margin_keep_the_loop_stable_and_the_border_is_near(skew):
    margin = disk_margin(PLANT, CONTROLLER, skew=skew)

    def largest_pole(gain):
        scaled = TransferFunction(gain * CONTROLLER.num, CONTROLLER.den, TS)
        return np.abs(np.roots(characteristic(PLANT, scaled))).max()

    high = min(margin.gain_high, 1e3)
    assert all(
        largest_pole(gain) < 1
        for gain in np.linspace(max(margin.gain_low, 0.01) * 1.001, high * 0.999, 20)
    )
    omega, G, K, _ = loop_responses(PLANT, CONTROLLER)
    edge = margin.alpha * np.exp(1j * np.linspace(0, 2 * np.pi, 2001))
    f = (1 + (1 - skew) / 2 * edge) / (1 - (1 + skew) / 2 * edge)
    k = np.argmin(np.abs(omega - margin.frequency))
    L = G * K
    assert np.abs(1 + f * L[k]).min() < 0.01 * (1 + np.abs(L[k]))
    crossings = np.flatnonzero(np.diff(np.sign(np.abs(L) - 1)))
    classical = np.abs(np.angle(-L[crossings])).min()
    assert 0 < margin.phase <= classical + 0.01


def test_no_margin_without_stability():
    with pytest.raises(BadInput, match="not stable"):
        disk_margin(PLANT, TransferFunction([50.0], [1.0], TS))
