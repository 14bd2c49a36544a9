"""The full-order design: its generalised plant against the loop's own equations, and, where slycot is installed, its norm."""

import numpy as np
import pytest

from benchmarks.peers.full_order import (
    NotAvailable,
    _to_continuous,
    _to_discrete,
    full_order_design,
    generalised_plant,
)
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates import h_infinity_norm
from residuum.robust_control.loop import Loop, Weights, frequency_grid
from residuum.robust_control.synthesis.constrained_structure import PIDN
from residuum.robust_control.synthesis.structured_synthesis import synthesise

TS = 0.05
PLANT = TransferFunction([2.0], [1.0, 1.2, 1.0]).discretise(TS)
W_S = TransferFunction([0.5, 0.5], [1.0, 0.001]).discretise(TS, "bilinear")
W_T = TransferFunction([0.3, 0.3], [0.01, 1.0]).discretise(TS, "bilinear")


def test_the_generalised_plant_gives_the_weighted_signals():
    omega = np.geomspace(0.01, np.pi / TS, 20)
    G, S, T = (system.frequency_response(omega) for system in (PLANT, W_S, W_T))
    zero = np.zeros_like(G)
    expected = np.array([[S, -S * G], [zero, T * G], [zero + 1, -G]]).transpose(2, 0, 1)
    np.testing.assert_allclose(
        generalised_plant(PLANT, W_S, W_T).response(np.exp(1j * omega * TS)), expected, atol=1e-8
    )


def test_the_bilinear_map_keeps_the_norm_and_is_undone():
    general = generalised_plant(PLANT, W_S, W_T)
    back = _to_discrete(_to_continuous(general))
    for there, here in zip(
        (back.A, back.B, back.C, back.D), (general.A, general.B, general.C, general.D), strict=True
    ):
        np.testing.assert_allclose(there, here, atol=1e-9)
    assert h_infinity_norm(back)[0] == pytest.approx(h_infinity_norm(general)[0], rel=1e-6)


def test_no_structure_beats_the_full_order():
    pytest.importorskip("slycot")
    full = full_order_design(PLANT, W_S, W_T)
    omega = frequency_grid([PLANT], points=300, lowest=1e-4)
    weights = Weights(np.abs(W_S.frequency_response(omega)), np.abs(W_T.frequency_response(omega)))
    structured = synthesise(Loop([PLANT], omega), weights, PIDN(TS))
    assert full.is_bound and full.norm <= structured.certified * (1 + 1e-4)


def test_what_cannot_be_had_is_said(tmp_path):
    without = tmp_path / "python"
    without.write_text("#!/bin/sh\nexit 3\n", encoding="utf-8")
    without.chmod(0o755)
    with pytest.raises(NotAvailable, match="slycot is not installed"):
        full_order_design(PLANT, W_S, W_T, python=str(without))
    endless = tmp_path / "endless"
    endless.write_text("#!/bin/sh\nexec sleep 60\n", encoding="utf-8")
    endless.chmod(0o755)
    with pytest.raises(NotAvailable, match="took longer than"):
        full_order_design(PLANT, W_S, W_T, python=str(endless), timeout=0.2)
    with pytest.raises(NotAvailable, match="at most 60"):
        full_order_design(TransferFunction([1.0], np.r_[1.0, np.zeros(90)], TS), W_S, W_T)
    with pytest.raises(BadInput, match="one sample time"):
        full_order_design(PLANT, W_S, TransferFunction([1.0], [1.0], 0.1))
