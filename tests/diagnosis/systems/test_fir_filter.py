"""The filter with a memory: against the plain convolution, at every number of taps and however the input is cut."""

import numpy as np
import pytest

from residuum.diagnosis.systems import FirFilter


@pytest.mark.parametrize("m", [1, 2, 7, 8, 9, 17, 200])
def test_is_the_convolution_and_blind_to_blocks(m):
    rng = np.random.default_rng(m)
    taps, v = rng.standard_normal(m), rng.standard_normal(5000)
    whole = FirFilter(taps).process(v)
    np.testing.assert_allclose(whole, np.convolve(v, taps)[:5000], atol=1e-12)
    filter = FirFilter(taps)
    cut = [filter.process(part) for part in np.split(v, [1, 2, 10, 11, 1500, 1501, 4000])]
    assert np.array_equal(np.concatenate(cut), whole)


def test_what_is_far_too_large_spoils_no_sample_before_it():
    v = np.ones(3000)
    v[2000] = 1e300
    assert np.array_equal(
        FirFilter(np.full(100, 0.5)).process(v)[:2000],
        FirFilter(np.full(100, 0.5)).process(np.ones(2000)),
    )
