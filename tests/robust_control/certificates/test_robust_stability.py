"""Small-gain tests against perturbed loops, µ against closed forms, disk margins against the perturbed loop itself."""

import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates.disk_margin import disk_margin
from residuum.robust_control.certificates.robust_stability import UNCERTAINTIES, loop_responses, robust_stability
from residuum.robust_control.loop import characteristic
from residuum.robust_control.synthesis.controller_structure import PIDN

TS = 0.05
PLANT = TransferFunction([2.0], [1.0, 0.4, 1.0]).discretise(TS)
CONTROLLER = PIDN(TS).transfer_function(np.array([0.3, 0.1, 0.4, 0.3]))
PERTURBED = {
    "additive": lambda G, D: G + D,
    "input-multiplicative": lambda G, D: G * (1 + D),
    "output-multiplicative": lambda G, D: (1 + D) * G,
    "inverse-additive": lambda G, D: G / (1 + D * G),
    "inverse-input-multiplicative": lambda G, D: G / (1 + D),
    "inverse-output-multiplicative": lambda G, D: G / (1 + D),
}


@pytest.mark.parametrize("kind", PERTURBED)
def test_the_smallest_destabilising_perturbation_has_size_one_over_the_peak(kind):
    """−1 is reached by a Δ of size 1/peak at that frequency; with 0.9/peak every frequency stays further away."""
    found = robust_stability(kind, PLANT, CONTROLLER)
    omega, G, K, _ = loop_responses(PLANT, CONTROLLER)
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 721))

    def distance(size, k):
        return np.abs(1 + PERTURBED[kind](G[k], size / found.peak * turn[:, None]) * K[k]) / (1 + np.abs(G[k] * K[k]))

    border = distance(1.0, [np.argmin(np.abs(omega - found.frequency))]).min()
    assert border < 0.02
    assert distance(0.9, slice(None, None, 10)).min() > 2 * border


def test_coprime_perturbations_are_judged_by_the_normalised_factors():
    found = robust_stability("left-coprime", PLANT, CONTROLLER)
    _, G, K, _ = loop_responses(PLANT, CONTROLLER)
    D = 1 / np.sqrt(1 + np.abs(G) ** 2)
    N = G * D
    radius = np.abs(D + N * K) / np.sqrt(1 + np.abs(K) ** 2)  # least √(|Δ_n|² + |Δ_d|²) with D + Δ_d + (N + Δ_n)K = 0
    assert 1 / found.peak == pytest.approx(radius.min(), rel=1e-9)
    assert robust_stability("right-coprime", PLANT, CONTROLLER).peak == pytest.approx(found.peak)


def test_a_weight_scales_the_test_and_an_unstable_loop_never_passes():
    small = TransferFunction([1e-3], [1.0], TS)
    assert robust_stability("additive", PLANT, CONTROLLER, small).holds
    wild = TransferFunction([50.0], [1.0], TS)
    assert all(not robust_stability(kind, PLANT, wild, small).holds for kind in UNCERTAINTIES)
    with pytest.raises(BadInput, match="must be one of additive"):
        robust_stability("parametric", PLANT, CONTROLLER)


@pytest.mark.parametrize("skew", [-1.0, 0.0, 1.0])
def test_gain_and_phase_inside_the_disk_margin_keep_the_loop_stable_and_the_border_is_near(skew):
    margin = disk_margin(PLANT, CONTROLLER, skew=skew)

    def largest_pole(gain):
        scaled = TransferFunction(gain * CONTROLLER.num, CONTROLLER.den, TS)
        return np.abs(np.roots(characteristic(PLANT, scaled))).max()

    high = min(margin.gain_high, 1e3)
    assert all(largest_pole(gain) < 1 for gain in np.linspace(max(margin.gain_low, 0.01) * 1.001, high * 0.999, 20))
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
