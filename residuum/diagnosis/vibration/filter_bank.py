"""The ⅓-binary tree of quasi-analytic filters behind the fast kurtogram, in polyphase form.

Antoni's tree splits a band in two with p(n) e^{jπn/4} and p(n) e^{j3πn/4}, keeping every second
sample, and in three with p₃(n) e^{jπn/6}, p₃(n) e^{jπn/2}, p₃(n) e^{j5πn/6}, keeping every third; p
and p₃ are real low-pass filters. Here each node is carried at its own centre frequency (band −¼ … ¼
of its rate), where the same filters are real ones after a shift by ±⅛ (or 0, ±⅙) of the rate. Seen
at the kept samples these shifts are ±1, ±j (or sixth roots of one), so both halves, or all three
thirds, come out of one pass over the taps: a quarter of the arithmetic of the direct form, and the
same envelopes to rounding. Only samples that the filter fully covers are kept, so no node starts
with a transient. The moments of the envelope are summed on the way, by time segment and in double
precision, because the thirds are needed for nothing else.

Reference: J. Antoni, Fast computation of the kurtogram for the detection of transient faults, MSSP
21 (2007) 108–124.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.signal import firwin

from residuum.array_types import AnyArray
from residuum.kept_loops import njit

# real and imaginary part, apart: the inner loops then run over contiguous numbers
Node = tuple[AnyArray, AnyArray]

TAPS = 17  # p and p₃ of the paper
TAPS_OF_THIRDS = 25
# Of the Nyquist frequency: the paper's 1/8 + ε of the rate. ε is small, because the 0.4 often seen
# in published code lets the bands at 0 and fs/2 pass both signs of frequency, which biases their
# kurtosis on plain noise by six standard deviations.
_CUT_OFF = 0.26
_RELAXED = {"contract", "nsz", "arcp", "reassoc"}


def half_band_filter(dtype: npt.DTypeLike = np.float64) -> AnyArray:
    """p(n), shape (17,): the low-pass that keeps half a node's band."""
    return np.asarray(firwin(TAPS, _CUT_OFF), dtype=dtype)


def third_band_filter(dtype: npt.DTypeLike = np.float64) -> AnyArray:
    """p₃(n), shape (25,): the low-pass that keeps a third of a node's band."""
    return np.asarray(firwin(TAPS_OF_THIRDS, 2 / 3 * _CUT_OFF), dtype=dtype)


def to_centre(x: AnyArray) -> Node:
    """A real signal shifted by −¼ of its rate: x(m) (−j)^m, each part of shape (n,)."""
    real, imag = np.zeros_like(x), np.zeros_like(x)
    real[0::4], real[2::4] = x[0::4], -x[2::4]
    imag[1::4], imag[3::4] = -x[1::4], x[3::4]
    return real, imag


def halves(node: Node, segments: int = 1) -> tuple[Node, Node, AnyArray]:
    """Split a node in two at half its rate.

    Parameters
    ----------
    node : parts of shape (n,), n ≥ 17
    segments : int
        Equal stretches of time over which the moments are summed.

    Returns
    -------
    lower, upper : nodes of (n − 17) // 2 + 1 samples
    moments : array, shape (2, segments, 2)
        Σ|c|² and Σ|c|⁴ of the lower and upper half in each segment.
    """
    real, imag = node
    lr, li, hr, hi, moments = _halves(real, imag, half_band_filter(real.dtype), segments)
    return (lr, li), (hr, hi), moments


def moments_of_thirds(node: Node, segments: int = 1) -> AnyArray:
    """Σ|c|² and Σ|c|⁴ of the lower, middle and upper third of a node (n ≥ 25), shape (3, segments,
    2).
    """
    real, imag = node
    return np.asarray(_moments_of_thirds(real, imag, third_band_filter(real.dtype), segments))


def length_of_half(n: int) -> int:
    """Samples of each half of a node of n samples."""
    return (n - TAPS) // 2 + 1


def length_of_third(n: int) -> int:
    """Samples of each third of a node of n samples."""
    return (n - TAPS_OF_THIRDS) // 3 + 1


@njit(fastmath=_RELAXED)
def _rotated(
    real: AnyArray, imag: AnyArray, first: int, count: int, out_r: AnyArray, out_i: AnyArray
) -> None:
    """y(first + 2q) j^q for q = 0 … count−1."""
    for q in range(0, count, 4):
        out_r[q], out_i[q] = real[first + 2 * q], imag[first + 2 * q]
    for q in range(1, count, 4):
        out_r[q], out_i[q] = -imag[first + 2 * q], real[first + 2 * q]
    for q in range(2, count, 4):
        out_r[q], out_i[q] = -real[first + 2 * q], -imag[first + 2 * q]
    for q in range(3, count, 4):
        out_r[q], out_i[q] = imag[first + 2 * q], -real[first + 2 * q]


@njit(fastmath=_RELAXED)
def _add_moments(
    real: AnyArray, imag: AnyArray, start: int, m: int, count: int, out: AnyArray
) -> None:
    """Add Σ|c|², Σ|c|⁴ of outputs start … start+m−1 (of count) to the segments they fall in."""
    segments = out.shape[0]
    for segment in range(start * segments // count, (start + m - 1) * segments // count + 1):
        first = max(start, -(-segment * count // segments)) - start
        last = min(start + m, -(-(segment + 1) * count // segments)) - start
        second, fourth = 0.0, 0.0
        for k in range(first, last):
            power = float(real[k] * real[k] + imag[k] * imag[k])
            second += power
            fourth += power * power
        out[segment, 0] += second
        out[segment, 1] += fourth


@njit(fastmath=_RELAXED)
def _halves(
    yr: AnyArray, yi: AnyArray, p: AnyArray, segments: int
) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray, AnyArray]:
    """Even taps act on u(q) = y(2q) j^q, odd ones on w(q) = y(2q+1) j^q e^{jπ/4}; the halves differ
    in signs only.
    """
    count = (yr.shape[0] - 17) // 2 + 1
    lr, li, hr, hi = (
        np.empty(count, p.dtype),
        np.empty(count, p.dtype),
        np.empty(count, p.dtype),
        np.empty(count, p.dtype),
    )
    moments = np.zeros((2, segments, 2))
    ur, ui, wr, wi = (
        np.empty(1032, p.dtype),
        np.empty(1032, p.dtype),
        np.empty(1032, p.dtype),
        np.empty(1032, p.dtype),
    )
    root = yr.dtype.type(0.7071067811865476)
    for start in range(0, count, 1024):  # multiples of 4, so that j^q starts every block at 1
        m = min(1024, count - start)
        _rotated(yr, yi, 2 * start, m + 8, ur, ui)
        _rotated(yr, yi, 2 * start + 1, m + 7, wr, wi)
        for k in range(m):
            # even taps 2i: a with i even, b with i odd; odd taps 2i + 1: c with i even, d with i
            # odd
            ar = (
                p[0] * ur[k + 8]
                + p[4] * ur[k + 6]
                + p[8] * ur[k + 4]
                + p[12] * ur[k + 2]
                + p[16] * ur[k]
            )
            ai = (
                p[0] * ui[k + 8]
                + p[4] * ui[k + 6]
                + p[8] * ui[k + 4]
                + p[12] * ui[k + 2]
                + p[16] * ui[k]
            )
            br = p[2] * ur[k + 7] + p[6] * ur[k + 5] + p[10] * ur[k + 3] + p[14] * ur[k + 1]
            bi = p[2] * ui[k + 7] + p[6] * ui[k + 5] + p[10] * ui[k + 3] + p[14] * ui[k + 1]
            cr = p[1] * wr[k + 7] + p[5] * wr[k + 5] + p[9] * wr[k + 3] + p[13] * wr[k + 1]
            ci = p[1] * wi[k + 7] + p[5] * wi[k + 5] + p[9] * wi[k + 3] + p[13] * wi[k + 1]
            dr = p[3] * wr[k + 6] + p[7] * wr[k + 4] + p[11] * wr[k + 2] + p[15] * wr[k]
            di = p[3] * wi[k + 6] + p[7] * wi[k + 4] + p[11] * wi[k + 2] + p[15] * wi[k]
            lr[start + k] = ar + br + root * ((cr + dr) - (ci + di))
            li[start + k] = ai + bi + root * ((cr + dr) + (ci + di))
            hr[start + k] = ar - br - root * ((cr - dr) + (ci - di))
            hi[start + k] = ai - bi + root * ((cr - dr) - (ci - di))
        for k in range(start + 1, start + m, 2):
            hr[k], hi[k] = -hr[k], -hi[k]
        _add_moments(lr[start:], li[start:], start, m, count, moments[0])
        _add_moments(hr[start:], hi[start:], start, m, count, moments[1])
    return lr, li, hr, hi, moments


@njit(fastmath=_RELAXED)
def _sums_by_phase(
    y: AnyArray, first: int, p: AnyArray, m: int, v: AnyArray, even: AnyArray, odd: AnyArray
) -> None:
    """Σ p₃(n) y(first + 3k + 24 − n) over the taps n ≡ r (mod 6) in even[r] and n ≡ r + 3 in
    odd[r], r = 0, 1, 2.
    """
    for r in range(3):
        for k in range(m + 8):
            v[r, k] = y[first + 3 * k + r]
    for k in range(m):
        even[0, k] = (
            p[0] * v[0, k + 8]
            + p[6] * v[0, k + 6]
            + p[12] * v[0, k + 4]
            + p[18] * v[0, k + 2]
            + p[24] * v[0, k]
        )
        odd[0, k] = (
            p[3] * v[0, k + 7] + p[9] * v[0, k + 5] + p[15] * v[0, k + 3] + p[21] * v[0, k + 1]
        )
        even[1, k] = (
            p[1] * v[2, k + 7] + p[7] * v[2, k + 5] + p[13] * v[2, k + 3] + p[19] * v[2, k + 1]
        )
        odd[1, k] = p[4] * v[2, k + 6] + p[10] * v[2, k + 4] + p[16] * v[2, k + 2] + p[22] * v[2, k]
        even[2, k] = (
            p[2] * v[1, k + 7] + p[8] * v[1, k + 5] + p[14] * v[1, k + 3] + p[20] * v[1, k + 1]
        )
        odd[2, k] = p[5] * v[1, k + 6] + p[11] * v[1, k + 4] + p[17] * v[1, k + 2] + p[23] * v[1, k]


@njit(fastmath=_RELAXED)
def _moments_of_thirds(yr: AnyArray, yi: AnyArray, p: AnyArray, segments: int) -> AnyArray:
    """Σ_r e^{∓jπr/3} over the sums by phase; taps n and n + 3 meet opposite signs in the outer
    thirds.
    """
    count = (yr.shape[0] - 25) // 3 + 1
    moments = np.zeros((3, segments, 2))
    v, c = np.empty((3, 1032), p.dtype), np.empty((6, 1024), p.dtype)
    er, fr, ei, fi = (
        np.empty((3, 1024), p.dtype),
        np.empty((3, 1024), p.dtype),
        np.empty((3, 1024), p.dtype),
        np.empty((3, 1024), p.dtype),
    )
    half, root = yr.dtype.type(0.5), yr.dtype.type(0.8660254037844386)
    for start in range(0, count, 1024):
        m = min(1024, count - start)
        _sums_by_phase(yr, 3 * start, p, m, v, er, fr)
        _sums_by_phase(yi, 3 * start, p, m, v, ei, fi)
        for k in range(m):
            c[2, k] = er[0, k] + fr[0, k] + er[1, k] + fr[1, k] + er[2, k] + fr[2, k]
            c[3, k] = ei[0, k] + fi[0, k] + ei[1, k] + fi[1, k] + ei[2, k] + fi[2, k]
            br, bi = er[1, k] - fr[1, k], ei[1, k] - fi[1, k]
            dr, di = er[2, k] - fr[2, k], ei[2, k] - fi[2, k]
            cos_r, cos_i = (
                er[0, k] - fr[0, k] + half * (br - dr),
                ei[0, k] - fi[0, k] + half * (bi - di),
            )
            sin_r, sin_i = root * (br + dr), root * (bi + di)
            c[0, k], c[1, k] = cos_r + sin_i, cos_i - sin_r
            c[4, k], c[5, k] = cos_r - sin_i, cos_i + sin_r
        for third in range(3):
            _add_moments(c[2 * third], c[2 * third + 1], start, m, count, moments[third])
    return moments
