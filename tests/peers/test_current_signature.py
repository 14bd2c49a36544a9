"""Sequence currents of three phases: what they see of a winding, and what they do not mind."""

import numpy as np
import pytest
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from benchmarks.peers.current_signature import current_signature
from residuum.identification.errors import BadInput


def three_phases(negative, frequency=59.7, n=400, angle=0.3):
    """Currents [A] with a negative-sequence share (complex) and a fifth harmonic, sampled at 1 kHz."""
    t = np.arange(n) / 1000.0
    a = np.exp(2j * np.pi / 3)
    phasors = 2.0 * np.exp(1j * angle) * np.array([1, a**2, a]) + 2.0 * np.exp(
        1j * angle
    ) * negative * np.array([1, a, a**2])
    rotating = np.exp(2j * np.pi * frequency * t)[:, None]
    return np.real(phasors * rotating) + 0.1 * np.real(np.exp(1j * 5 * angle) * rotating**5)


def test_current_signature_sees_the_unbalance_and_not_the_load_frequency_or_moment():
    same = current_signature(three_phases(0.05j), 1e-3, 60.0)
    elsewhen = current_signature(three_phases(0.05j, frequency=60.4, angle=2.0), 1e-3, 60.0)
    np.testing.assert_allclose(elsewhen, same, atol=1e-3)
    assert np.abs(current_signature(three_phases(0.05), 1e-3, 60.0) - same).max() > 0.03
    with pytest.raises(BadInput, match="at least 3 are needed"):
        current_signature(three_phases(0.05, n=30), 1e-3, 60.0)


def test_real_shorts_are_told_better_from_sequence_currents_than_by_chance():
    from benchmarks.three_phase_currents import FILE, leave_one_repeat_out, recordings, signature

    if not FILE.is_file():
        pytest.skip("skipped: no real recordings here")
    currents, labels, repeats = recordings()
    features = [
        np.array([signature(window) for window in np.split(record, 2)]) for record in currents
    ]
    said = leave_one_repeat_out(
        LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto"), features, labels, repeats
    )
    assert np.mean(np.array(said) == np.array(labels)) > 0.8
