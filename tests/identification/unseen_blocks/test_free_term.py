"""The formula suggested for a free term follows its curve and names the functions that made it."""

import numpy as np
import pytest

from residuum.identification.unseen_blocks.free_term import nearest_formula


def test_the_functions_that_made_the_curve_are_found():
    at = np.linspace(-200.0, 200.0, 25)
    noise = 2e-4 * np.random.default_rng(0).standard_normal(25)
    found = nearest_formula(at, -0.02 * np.sign(at) - 3e-4 * at + noise)
    assert "sign(z)" in found.formula
    assert found.largest == 200.0
    assert found.share > 0.99
    coefficients = {
        part.split("·", 1)[1]: float(part.split("·", 1)[0]) for part in found.formula.split(" ")
    }
    assert coefficients["sign(z)"] == pytest.approx(-0.02, rel=0.05)
    assert coefficients["z"] == pytest.approx(-0.06, rel=0.05)


def test_a_flat_curve_has_no_formula():
    assert nearest_formula(np.linspace(-1.0, 1.0, 9), np.full(9, 0.3)) is None
