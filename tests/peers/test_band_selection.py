"""Other merits of a band than kurtosis: where they find the resonance, and what they find new."""

import numpy as np
import pytest

from benchmarks.peers.band_selection import MERITS, choose_band, separation
from residuum.diagnosis.vibration.moving_lines import impact_train
from residuum.diagnosis.vibration.spectra import kurtogram
from residuum.identification.errors import BadInput


def bands_found(snr_db, knocks, merit, seeds=6):
    fs, hits = 12800, 0
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 7])
        x = rng.standard_normal(2 * fs) + 10 ** (snr_db / 20) * impact_train(
            2 * fs, fs, 107.0, resonance=3150, seed=seed
        )
        for _ in range(knocks):
            at, k = rng.integers(0, x.size - 400), np.arange(400) / fs
            f = rng.uniform(800, 5500)
            x[at : at + 400] += 20 * np.exp(-0.3 * f * k) * np.sin(2 * np.pi * f * k)
        best = choose_band(x, fs, merit=merit)[0]
        hits += best.level > 0 and best.low <= 3150 <= best.high
    return hits / seeds


def test_protrugram_finds_the_resonance_at_low_snr_and_beside_knocks_where_kurtosis_fails():
    assert (
        bands_found(0, 0, "protrugram")
        == bands_found(-10, 0, "protrugram")
        == bands_found(-14, 0, "protrugram")
        == 1
    )
    assert bands_found(0, 3, "protrugram") >= 5 / 6 > bands_found(0, 3, "kurtosis")


def test_separation_from_healthy_kurtograms_finds_what_is_new_not_what_is_loud():
    fs = 12800
    rng = np.random.default_rng(3)

    def machine(fault, seed):
        loud = 3 * impact_train(2 * fs, fs, 12.0, resonance=600, seed=seed)
        return (
            rng.standard_normal(2 * fs)
            + loud
            + fault * impact_train(2 * fs, fs, 107.0, resonance=4300, seed=seed)
        )

    healthy = [kurtogram(machine(0.0, seed), fs, 4, segments=16, method="fft") for seed in range(5)]
    current = kurtogram(machine(0.5, 9), fs, 4, segments=16, method="fft")
    new = next(current.in_order(separation(current, healthy)))
    assert new.low - 150 <= 4300 <= new.high + 150
    assert abs(current.best.centre - 4300) > 1000
    with pytest.raises(BadInput, match="three or more"):
        separation(current, healthy[:1])


def test_merits_are_named():
    with pytest.raises(BadInput, match=", ".join(MERITS)):
        choose_band(np.zeros(4096), 1000, merit="crest")
