"""Kurtogram, envelope, indicators and band choice: against direct formulas, and on impacts of known resonance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import fft, signal

from residuum.diagnosis.vibration import filter_bank
from residuum.diagnosis.vibration.spectra import band_envelope, kurtogram
from residuum.diagnosis.vibration.vibration_indicators import indicators
from residuum.identification.errors import BadInput


def direct_kurtogram(x, deepest):
    """Antoni's tree as his paper writes it: complex filters on the analytic branch, then every second (third) sample."""
    n, n3 = np.arange(17), np.arange(25)
    p, p3 = filter_bank.half_band_filter(), filter_bank.third_band_filter()
    found = {}

    def kurtosis(c):
        power = np.abs(c) ** 2
        return np.mean(power**2) / np.mean(power) ** 2 - 2

    def split(c, level, index):
        for third in range(3):
            part = np.convolve(c, p3 * np.exp(1j * np.pi * n3 * (2 * third + 1) / 6), "valid")[::3]
            found[round(level + np.log2(3), 6), 3 * index + third] = kurtosis(part)
        lower = np.convolve(c, p * np.exp(1j * np.pi * n / 4), "valid")[::2]
        upper = np.convolve(c, p * np.exp(3j * np.pi * n / 4), "valid")[::2]
        upper = upper * (-1.0) ** np.arange(upper.size)  # decimation put the upper half upside down
        for half, child in ((0, lower), (1, upper)):
            found[level + 1, 2 * index + half] = kurtosis(child)
            if level + 1 < deepest:
                split(child, level + 1, 2 * index + half)

    split(x - x.mean(), 0, 0)
    return found


def test_polyphase_tree_equals_the_direct_form():
    rng = np.random.default_rng(0)
    x = rng.standard_normal(6007) ** 3
    k = kurtogram(x, 2.0, 4)
    direct = direct_kurtogram(x, 4)
    indices = np.rint(k.centre / k.width - 0.5).astype(int)
    rows = zip(k.level, indices, k.kurtosis, strict=True)
    pairs = [
        (direct[round(float(level), 6), index], value) for level, index, value in rows if level > 0
    ]
    assert len(pairs) == len(direct) == k.level.size - 1
    assert max(abs(a - b) for a, b in pairs) < 1e-9
    assert np.abs(kurtogram(x.astype(np.float32), 2.0, 4).kurtosis / k.kurtosis - 1).max() < 1e-3


def test_moments_by_segment_sum_to_the_whole_and_tell_when():
    x = np.random.default_rng(1).standard_normal(12800)
    x[9000:9020] += 30
    parts, whole = kurtogram(x, 12800, 3, segments=8), kurtogram(x, 12800, 3)
    assert np.allclose(parts.moments.sum(axis=1), whole.moments[:, 0])
    assert (np.argmax(parts.power[:7], axis=1) == 5).all()


def test_kurtogram_refuses_what_it_cannot_use():
    with pytest.raises(BadInput, match="missing or infinite"):
        kurtogram([np.nan] * 200, 1.0)
    with pytest.raises(BadInput, match="at least 128"):
        kurtogram([1.0], 1.0)
    with pytest.raises(BadInput, match="allows 1 … "):
        kurtogram(np.arange(500.0), 1.0, 9)


@pytest.mark.parametrize("n", [4096, 4093])  # a power of two, a prime
def test_envelope_equals_hilbert_of_the_band(n):
    x = np.random.default_rng(2).standard_normal(n)
    ours = band_envelope(x, 1000.0, 100.0, 200.0, decimate=False)
    X, f = np.fft.rfft(x), np.fft.rfftfreq(n, 1e-3)
    direct = np.abs(signal.hilbert(np.fft.irfft(np.where((f >= 100) & (f < 200), X, 0), n)))
    inner = slice(n // 8, -n // 8)  # a prime length is padded, which only the ends see
    assert np.abs(ours.values[inner] - direct[inner]).max() < (1e-10 if n == 4096 else 0.1)
    assert ours.values.std() == pytest.approx(direct.std(), rel=1e-10 if n == 4096 else 0.01)
    decimated = band_envelope(x, 1000.0, 100.0, 200.0)
    assert decimated.values.size < n / 4
    assert np.mean(decimated.values**2) == pytest.approx(
        np.mean(ours.values**2), rel=1e-6 if n == 4096 else 0.01
    )


@given(st.integers(2, 300), st.floats(1e-3, 1e3), st.integers(0, 50))
@settings(max_examples=40, deadline=None)
def test_indicators_equal_the_formulas_and_scale(n, gain, seed):
    x = np.random.default_rng(seed).standard_normal(n)
    found, scaled, shifted = indicators(x), indicators(gain * x), indicators(np.roll(x, n // 3))
    centred = x - x.mean()
    assert found.kurtosis == pytest.approx(np.mean(centred**4) / np.mean(centred**2) ** 2, rel=1e-9)
    assert found.rms == pytest.approx(np.sqrt(np.mean(x**2)), rel=1e-12)
    assert found.impulsiveness == pytest.approx(np.abs(x).max() / np.abs(x).mean(), rel=1e-12)
    assert scaled.rms == pytest.approx(gain * found.rms, rel=1e-9)
    assert (scaled.kurtosis, shifted.kurtosis) == pytest.approx(
        (found.kurtosis, found.kurtosis), rel=1e-9
    )


def test_indicators_of_constant_and_single_samples_are_values():
    assert np.isnan(indicators([0.1] * 50).kurtosis) and np.isnan(indicators([0.0]).crest)
    assert indicators([0.0, 0.0, 7.0]).crest == pytest.approx(np.sqrt(3))


def long_signal(n):
    """Impulsive at 0.06 fs, and 120 dB weaker at 0.44 fs: what a recorder's own filter leaves near half the rate."""
    rng = np.random.default_rng(8)
    x = 1e-6 * rng.standard_normal(n) ** 3
    return x + signal.sosfilt(signal.butter(8, 0.3, output="sos"), rng.standard_normal(n) ** 3)


@pytest.mark.parametrize("n", [1 << 18, 300_007])
def test_long_signals_agree_with_the_direct_formula(n):
    """Long ones go another way: matrix transform, bands in single precision; weak bands keep their own digits."""
    x = long_signal(n)
    k = kurtogram(x, 1.0, 4, method="fft")
    padded = next(
        n_ for n_ in range(n, 2 * n) if n_ % 192 == 0 and n_ // 192 == fft.next_fast_len(n_ // 192)
    )
    spectrum = np.fft.rfft(x - x.mean(), padded)[: padded // 2]
    for level, row in ((4.0, 0), (4.0, 14), (1 + np.log2(3), 5)):
        bands = round(2**level)
        band = spectrum.reshape(bands, -1)[row]
        power = np.abs(np.fft.ifft(band)[: n * band.size // padded]) ** 2
        found = k.kurtosis[k.level == level][row]
        assert found == pytest.approx(
            np.mean(power**2) / np.mean(power) ** 2 - 2, rel=1e-6, abs=1e-6
        )
    segmented = kurtogram(x, 1.0, 4, segments=4, method="fft").moments.sum(axis=1)
    assert np.allclose(segmented, k.moments[:, 0], rtol=1e-9)


def test_long_envelope_agrees_with_hilbert_of_the_band():
    n = 1 << 18
    x = long_signal(n)
    X, f = np.fft.rfft(x), np.fft.rfftfreq(n)
    direct = np.abs(signal.hilbert(np.fft.irfft(np.where((f >= 0.1) & (f < 0.2), X, 0), n)))
    ours = band_envelope(x, 1.0, 0.1, 0.2, decimate=False)
    assert np.abs(ours.values - direct).max() < 1e-11 * direct.max()
    single = band_envelope(x.astype(np.float32), 1.0, 0.1, 0.2, decimate=False)
    assert (
        single.values.dtype == np.float32
        and np.abs(single.values - direct).max() < 1e-4 * direct.max()
    )
