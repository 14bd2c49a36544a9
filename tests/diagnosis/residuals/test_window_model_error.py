"""What the model error adds to a window, against the sums written out."""

import numpy as np
import pytest

from residuum.diagnosis.residuals.likelihood_ratio import (
    RAMP,
    STEP,
    TEMPLATE,
    mean_square,
    model_error,
)


@pytest.mark.parametrize("shape", [STEP, RAMP, TEMPLATE])
@pytest.mark.parametrize(("now", "count", "delay"), [(90, 1, 0), (90, 12, 3), (5, 30, 2)])
def test_equals_the_sums_written_out(shape, now, count, delay):
    rng = np.random.default_rng(7)
    m, size = 6, 100
    root, template, u = (
        rng.standard_normal((4, m)),
        rng.standard_normal(size),
        rng.standard_normal(size),
    )
    window = (now - count + 1 + np.arange(count)) % size
    p = {STEP: np.ones(count), RAMP: np.arange(1.0, count + 1.0), TEMPLATE: template[window]}[shape]
    phi = u[(window[:, None] - delay - np.arange(m)) % size]
    expected = 0.3 * p.sum() ** 2 + np.sum((root @ (p @ phi)) ** 2)
    assert model_error(template, u, now, count, delay, root, 0.3, np.inf, shape) == pytest.approx(
        expected, rel=1e-12
    )
    early = model_error(template, u, now, count, delay, root, 0.3, 0.5 * expected, shape)
    assert 0.5 * expected < early <= expected * (1 + 1e-12)
    if count <= 8:
        assert mean_square(u, now, count, delay, root) == pytest.approx(
            np.mean(np.sum((phi @ root.T) ** 2, axis=1)), rel=1e-12
        )
