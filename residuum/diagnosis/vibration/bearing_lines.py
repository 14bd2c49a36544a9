"""Rolling bearings: the frequencies of their faults, and whether a fault's lines stand out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import cos, radians
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
from scipy import fft
from scipy.ndimage import maximum_filter1d, median_filter

from residuum.array_types import AnyArray
from residuum.diagnosis.vibration.sensor_health import strongest_line
from residuum.diagnosis.vibration.spectra import PaddedSpectrum
from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names

# Fault frequencies of a rolling bearing: from its geometry, as multiples of shaft speed, or in
# hertz.

CLASS_OF = MappingProxyType(
    {"bpfi": "inner-race", "bpfo": "outer-race", "bsf": "ball", "ftf": "cage"}
)


@dataclass(frozen=True)
class BearingFrequencies:
    """Frequencies [Hz] at which faults of a bearing strike, and the shaft's where it is known.

    `lines` maps `bpfi`, `bpfo`, `bsf`, `ftf` (any of them) to hertz; `bsf` is the ball's own
    rotation: a spot on it strikes both races, so its impacts come at twice that.
    """

    lines: Mapping[str, float]
    shaft: float | None = None

    @classmethod
    def from_orders(cls, orders: Mapping[str, float], shaft: float) -> BearingFrequencies:
        """From multiples of the shaft frequency [Hz]."""
        _check(orders, "orders")
        if not shaft > 0:
            raise BadInput(f"shaft frequency is {shaft!r} Hz; must be positive")
        return cls({name: order * shaft for name, order in orders.items()}, shaft)

    @classmethod
    def from_hertz(
        cls, hertz: Mapping[str, float], shaft: float | None = None
    ) -> BearingFrequencies:
        """From hertz; an entry `shaft` is the shaft's own frequency.

        When it is not known but BPFI, BPFO and FTF are, it follows: BPFO = N FTF gives N, BPFI = N
        (f_shaft − FTF) the shaft.

        >>> hertz = {"bpfi": 162.1, "bpfo": 107.3, "ftf": 11.92}
        >>> round(BearingFrequencies.from_hertz(hertz).shaft, 1)
        29.9
        """
        lines = {name: value for name, value in hertz.items() if name != "shaft"}
        _check(lines, "hertz")
        shaft = hertz.get("shaft", shaft)
        if shaft is None and {"bpfi", "bpfo", "ftf"} <= lines.keys():
            balls = round(lines["bpfo"] / lines["ftf"])
            if balls and abs(lines["bpfo"] / lines["ftf"] / balls - 1) < 0.01:
                shaft = lines["bpfi"] / balls + lines["ftf"]
        return cls(lines, shaft)


def orders_from_geometry(
    balls: int, ball_diameter: float, pitch_diameter: float, contact_angle: float = 0.0
) -> dict[str, float]:
    """Fault frequencies as multiples of shaft speed, inner ring turning, outer ring at rest, no
    slip.

    With r = (d / D) cos φ: BPFO = N/2 (1 − r), BPFI = N/2 (1 + r), BSF = D/(2d) (1 − r²), FTF = (1
    − r)/2.

    Parameters
    ----------
    balls : N
    ball_diameter, pitch_diameter : d, D in one unit, 0 < d < D
    contact_angle : φ [°]

    Examples
    --------
    A 6205-2RS of a well-known test rig:

    >>> {name: round(order, 3) for name, order in orders_from_geometry(9, 0.3126, 1.537).items()}
    {'bpfi': 5.415, 'bpfo': 3.585, 'bsf': 2.357, 'ftf': 0.398}
    """
    if balls < 1 or not 0 < ball_diameter < pitch_diameter:
        raise BadInput(
            f"bearing: {balls} balls of {ball_diameter:g} on {pitch_diameter:g}; needs N ≥ 1 and 0"
            " < d < D"
        )
    r = ball_diameter / pitch_diameter * cos(radians(contact_angle))
    return {
        "bpfi": balls / 2 * (1 + r),
        "bpfo": balls / 2 * (1 - r),
        "bsf": pitch_diameter / (2 * ball_diameter) * (1 - r * r),
        "ftf": (1 - r) / 2,
    }


def _check(lines: Mapping[str, float], subject: str) -> None:
    for name, value in lines.items():
        if name not in CLASS_OF:
            raise BadInput(f"{subject}: {name!r} is no fault line; {known_names(name, CLASS_OF)}")
        if not 0 < value < float("inf"):
            raise BadInput(f"{subject}: {name} is {value!r}; must be a positive number")
    if not lines:
        raise BadInput(f"{subject}: names no fault line; known are {', '.join(CLASS_OF)}")


# Do the lines of a bearing fault stand out of the squared-envelope spectrum, and by more than
# lines elsewhere do?
# Textbook tests hold a line against the noise floor beside it. On a real machine that is not
# enough: shaft harmonics, gears, the electric supply and a rig's own modulations make *some* line
# significant near almost any frequency. So each fault frequency is also held against control
# frequencies: the same statistic, with the same search tolerance and the same choice of the best
# band, at all the frequencies between that no fault of this bearing and no shaft harmonic
# explains; lines of the fault itself are cut out of the spectrum before.

LINES_OF_A_FAMILY = 4
SLIP = 0.02  # of the fault frequency: slip of the balls and error of the stated speed
# of the slowest line a segment: over longer ones slip smears lines faster than the spectrum
# sharpens
_PERIODS = 140
_PERIODS_OF_CAGE = 60
_FEWEST_PERIODS = 8
_GRID = 0.00125  # of the frequency
_FLOOR_CELLS = 15  # resolution cells each side behind the local floor
_DEEPEST = 3
_MOST_SEGMENTS = 128
# lines of a segment's spectrum that share a median: a gear's line is one of them, a resonance spans
# many
_FLAT_LINES = 48
_FEWEST_FLATTENED = 2  # parts: narrower bands hold few resonances that could outweigh each other
_WORTH_CLEANING = 2.0  # deciles: below, a family cannot have spoilt its own controls
_BANDS_CLEANED = 4
_TONAL = 0.25  # of a band's power in one line: what beats with it is a modulation of no impact
# times the floor: a line that no noise makes, so that cutting it favours no healthy machine
_STRONG = 20.0
_FEWEST_CONTROLS = 50
_SIDEBANDS = 5
# where the harmonics of a fault's lines make a control frequency look alive
_RELATED = (0.5, 1.0, 2.0)
# a spot on a ball strikes both races
_VARIANTS = {"bpfi": (1.0,), "bpfo": (1.0,), "bsf": (2.0, 1.0), "ftf": (1.0,)}


@dataclass(frozen=True)
class LineEvidence:
    """What the envelope says of one fault.

    Attributes
    ----------
    prominence : float
        How far the line family stands above the control frequencies: 0 at their median, 1 at their
        upper decile.
    depth : float
        Modulation depth √Σ (amplitude at k f / mean of the squared envelope)² above the floor, over
        the harmonics [-].
    frequency : float
        Where within the tolerance the family fits best [Hz].
    expected : float
        The fault frequency [Hz].
    low, high : float
        Band of the vibration in which it is seen best [Hz].
    """

    prominence: float
    depth: float
    frequency: float
    expected: float
    low: float
    high: float


def line_evidence(
    x: npt.ArrayLike, sampling_rate: float, frequencies: BearingFrequencies
) -> dict[str, LineEvidence]:
    r"""Evidence for each line family of a bearing.

    In each band of a binary and ternary division of 0 … fs/2 (the wider ones once more with a
    flattened spectrum, in which neither gears nor one resonance prevail) the squared envelope is
    averaged over half-overlapping segments into a spectrum P(α), normalised by the squared mean.
    With the local median floor N(α) the family at f scores

    .. math::
        T(f) = \sum_{k=1}^{4} \ln (1 + P(k f) / N(k f)),

    maximised over ±2 %. The logarithm lets several moderate harmonics count for more than one
    strong stray line; shaft harmonics are cut down to the floor. T is standardised a band by its
    median and upper decile over control frequencies, and the best band is taken, for faults and
    controls alike.

    Parameters
    ----------
    x : array, shape (n,), no missing samples
    sampling_rate : float [Hz]
    frequencies : BearingFrequencies

    Returns
    -------
    dict
        `bpfi`, `bpfo`, `bsf`, `ftf` as far as given. A family whose fundamental cannot be resolved
        in the record (fewer than 8 periods) is left out.

    Raises
    ------
    BadInput
        The envelope cannot reach the lines at this sampling rate.
    """
    signal: AnyArray = np.asarray(x)
    signal = signal - signal.mean()
    cage = {name: f for name, f in frequencies.lines.items() if name == "ftf"}
    non_cage = {name: f for name, f in frequencies.lines.items() if name != "ftf"}
    by_line: dict[str, LineEvidence] = {}
    # the cage, ten times slower, needs a finer spectrum
    for lines, periods in ((non_cage, _PERIODS), (cage, _PERIODS_OF_CAGE)):
        resolved = {
            name: f
            for name, f in lines.items()
            if signal.shape[0] * f >= _FEWEST_PERIODS * sampling_rate
        }
        if resolved:
            evidence = _evidence(signal, sampling_rate, resolved, frequencies, periods)
            if beating := [
                name for name, line in evidence.items() if _beats(signal, sampling_rate, line)
            ]:
                flat = _evidence(signal, sampling_rate, resolved, frequencies, periods, tonal=True)
                evidence |= {
                    name: min(evidence[name], flat[name], key=lambda line: line.prominence)
                    for name in beating
                }
            by_line |= evidence
    return by_line


def _beats(x: AnyArray, rate: float, line: LineEvidence) -> bool:
    """Whether a family that stands out does so in a band that one line fills."""
    return (
        line.prominence > _WORTH_CLEANING
        and strongest_line(x, rate, line.low, line.high)[1] > _TONAL
    )


def _evidence(
    x: AnyArray,
    rate: float,
    lines: Mapping[str, float],
    frequencies: BearingFrequencies,
    periods: int,
    tonal: bool = False,
) -> dict[str, LineEvidence]:
    centres = {name: [variant * f for variant in _VARIANTS[name]] for name, f in lines.items()}
    all_centres = [f for variants in centres.values() for f in variants]
    slowest, fastest = min(all_centres), max(all_centres)
    if fastest * (1 + SLIP) > rate / 8:
        raise BadInput(
            f"bearing: lines up to {fastest:.4g} Hz need a sampling rate above {8 * fastest:.4g}"
            f" Hz; it is {rate:g} Hz"
        )
    # a prime length costs ten times more
    length = fft.prev_fast_len(min(x.shape[0], int(periods / slowest * rate)), real=True)
    grid = np.exp(np.arange(np.log(slowest / 2), np.log(min(2 * fastest, rate / 8)), _GRID))
    control = _is_control(grid, frequencies)
    if control.sum() < _FEWEST_CONTROLS:
        raise BadInput(
            "bearing: the fault lines leave too few frequencies between them to compare with; are"
            " they right?"
        )
    bands, flattened = _bands(rate, fastest)
    if tonal:
        bands, flattened = [], bands
    reach = LINES_OF_A_FAMILY * float(grid[-1])
    spectra = averaged_spectra(x, rate, bands, length, reach, flattened)
    bands += flattened
    floored = [
        _Floored.of(spectrum, rate / length, high - low, frequencies.shaft)
        for spectrum, (low, high) in zip(spectra, bands, strict=True)
    ]
    searched = SearchedBands.of(grid, control, bands, floored, frequencies)
    return {name: searched.evidence(variants) for name, variants in centres.items()}


def _bands(
    rate: float, fastest: float
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """(bands that can carry lines up to `fastest`, those of them wide enough to be flattened)."""
    bands = [
        band
        for band in division(rate)
        if band == (0.0, rate / 2) or band[1] - band[0] >= 2 * fastest
    ]
    return bands, [
        band for band in bands if band[1] - band[0] >= rate / 2 / _FEWEST_FLATTENED * (1 - 1e-9)
    ]


def _prominence(scores: AnyArray, of_controls: AnyArray, control: AnyArray) -> AnyArray:
    """Scores maximised over the tolerance, in deciles above the median of the control frequencies,
    a band a row.
    """
    window = 2 * round(SLIP / _GRID) + 1
    T = maximum_filter1d(scores, window, axis=1)
    T_controls = T if of_controls is scores else maximum_filter1d(of_controls, window, axis=1)
    middle, decile = np.quantile(T_controls[:, control], [0.5, 0.9], axis=1)
    # where the controls hardly scatter a decile would make any line prominent: half a nat at least
    return np.asarray((T - middle[:, None]) / np.maximum(decile - middle, 0.5)[:, None])


@dataclass(frozen=True, eq=False)
class SearchedBands:
    """What every band shows at every frequency of a grid.

    Attributes
    ----------
    grid : array, shape (frequencies,)
        Geometric [Hz].
    control : array of bool, shape (frequencies,)
        Which of them nothing known explains.
    bands : list of (low, high) [Hz]
    floored : list of _Floored, one a band
    scores, depths, prominence : array, shape (bands, frequencies)
        T(f), the modulation depth, and T(f) in deciles of the controls.
    frequencies : BearingFrequencies
    """

    grid: AnyArray
    control: AnyArray
    bands: list[tuple[float, float]]
    floored: list[_Floored]
    scores: AnyArray
    depths: AnyArray
    prominence: AnyArray
    frequencies: BearingFrequencies

    @classmethod
    def of(
        cls,
        grid: AnyArray,
        control: AnyArray,
        bands: list[tuple[float, float]],
        floored: list[_Floored],
        frequencies: BearingFrequencies,
    ) -> SearchedBands:
        """What the floored spectra of the bands show of every family of lines."""
        families = [floor.families(grid) for floor in floored]
        scores = np.array([T for T, _ in families])
        depths = np.array([depth for _, depth in families])
        prominence = _prominence(scores, scores, control)
        return cls(grid, control, bands, floored, scores, depths, prominence, frequencies)

    def evidence(self, centres: list[float]) -> LineEvidence:
        """The best band of a family, and the best variant of its fundamental [Hz].

        Looking at two variants for one part finds chance lines twice as often. The scores of chance
        fall from one half at the median (0 deciles) to a tenth at 1 decile, by a factor of five a
        decile: that is what so many looks cost.
        """
        prominence = self._cleaned(centres)
        looks = float(np.log(len(centres)) / np.log(5.0))
        candidates = []
        for centre in centres:
            j = self._index(centre)
            band = int(prominence[:, j].argmax())
            at = self._strongest(band, centre)
            candidates.append(
                LineEvidence(
                    float(prominence[band, j]) - looks,
                    float(self.depths[band, at]),
                    float(self.grid[at]),
                    centre,
                    *self.bands[band],
                )
            )
        return max(candidates, key=lambda evidence: evidence.prominence)

    def _cleaned(self, centres: list[float]) -> AnyArray:
        """The prominence of a family in its best bands against controls that do not contain its own
        lines.

        The harmonics of a strong fault and their sidebands are lines of many control frequencies
        too: the stronger the fault, the less it would stand out from them.
        """
        prominence = self.prominence.copy()
        largest = max(prominence[:, self._index(f)].max() for f in centres)
        if largest <= _WORTH_CLEANING:
            return prominence
        sides = [self.frequencies.shaft, self.frequencies.lines.get("ftf")]
        for f in centres:
            j = self._index(f)
            for band in np.argsort(-prominence[:, j])[:_BANDS_CLEANED]:
                own = float(self.grid[self._strongest(band, f)])
                floored = self.floored[band].without(own, [side for side in sides if side])
                scores, _ = floored.families(self.grid)
                again = _prominence(self.scores[band : band + 1], scores[None, :], self.control)
                prominence[band, j] = max(prominence[band, j], again[0, j])
        return prominence

    def _index(self, f: float) -> int:
        return int(np.abs(self.grid - f).argmin())

    def _strongest(self, band: int, f: float) -> int:
        """Where within the tolerance about f the family scores best in a band."""
        near = np.flatnonzero(np.abs(self.grid / f - 1) <= SLIP)
        return int(near[self.scores[band, near].argmax()])


def division(rate: float) -> list[tuple[float, float]]:
    """Bands [Hz] that the lines are looked for in: 0 … fs/2 in 1, 2, 3, 4, 6 and 8 equal parts."""
    parts = sorted(
        {1 << level for level in range(_DEEPEST + 1)}
        | {3 << level for level in range(_DEEPEST - 1)}
    )
    return [(k * rate / 2 / n, (k + 1) * rate / 2 / n) for n in parts for k in range(n)]


def averaged_spectra(
    x: AnyArray,
    rate: float,
    bands: list[tuple[float, float]],
    length: int,
    reach: float,
    flattened: Sequence[tuple[float, float]] = (),
) -> list[tuple[float, AnyArray]]:
    """Squared-envelope power spectra, normalised by the squared mean: (line spacing [Hz], powers
    from 0 to `reach`) a band.

    Hann window, half overlap (of longer records 128 segments evenly spread), twice the lines that
    the segment resolves; a full modulation has power 1. After those of `bands` come those of the
    bands `flattened`, in which gears, shafts and the supply have no lines and no resonance
    outweighs the others.
    """
    step = max(1, length // 2, (x.shape[0] - length) // _MOST_SEGMENTS)
    starts = range(0, x.shape[0] - length + 1, step)
    count = int(2 * length * reach / rate) + 2  # lines up to `reach`
    sums: list[AnyArray] = []
    for start in starts:
        spectrum = PaddedSpectrum.of(x[start : start + length], rate)
        flat = replace(spectrum, lines=_flat(spectrum.lines)) if flattened else spectrum
        looked_at = [(spectrum, *band) for band in bands] + [(flat, *band) for band in flattened]
        powers = [
            _normalised_power(part.envelope(low, high).values, count)
            for part, low, high in looked_at
        ]
        sums = (
            powers
            if not sums
            else [total + power for total, power in zip(sums, powers, strict=True)]
        )
    return [(rate / (2 * length), total / len(starts)) for total in sums]


def _flat(spectrum: AnyArray) -> AnyArray:
    """A spectrum over its local median amplitude, with what stands more than three times above it
    cut down to that.
    """
    amplitude = np.abs(spectrum)
    blocks = amplitude.shape[0] // _FLAT_LINES
    if blocks < 2:
        return spectrum
    medians = np.median(amplitude[: blocks * _FLAT_LINES].reshape(blocks, _FLAT_LINES), axis=1)
    floor = np.interp(
        np.arange(amplitude.shape[0]), (np.arange(blocks) + 0.5) * _FLAT_LINES, medians
    )
    usual = np.maximum(
        np.maximum(floor, amplitude / 3), 1e-12 * float(amplitude.max()) + np.finfo(float).tiny
    )
    return np.asarray(spectrum / usual.astype(amplitude.dtype))


def _normalised_power(envelope: AnyArray, lines: int) -> AnyArray:
    """|DFT of Hann-windowed (|c|² / mean − 1)|², two lines a resolution cell, the first `lines` of
    them.
    """
    square = envelope * envelope
    mean = square.mean()
    if not mean > 0:
        return np.zeros(min(lines, envelope.shape[0]))
    window = _hann(envelope.shape[0])
    lowest = fft.rfft((square / mean - 1) * window, 2 * envelope.shape[0])[:lines]
    return np.asarray((lowest.real**2 + lowest.imag**2) * (2 / window.sum()) ** 2)


@lru_cache(maxsize=64)
def _hann(n: int) -> AnyArray:
    window = np.hanning(n)
    window.flags.writeable = False
    return window


@dataclass(frozen=True, eq=False)
class _Floored:
    """One band's spectrum beside its local floor: line spacing, resolution cell, band width [Hz], P
    − N, and P/N.
    """

    df: float
    cell: float
    width: float
    above: AnyArray
    ratio: AnyArray

    @classmethod
    def of(
        cls, spectrum: tuple[float, AnyArray], cell: float, width: float, shaft: float | None
    ) -> _Floored:
        df, P = spectrum
        half = max(1, int(_FLOOR_CELLS * cell / df))
        floor = np.maximum(median_filter(P, 2 * half + 1, mode="nearest") / np.log(2), 1e-12)
        ratio = P / floor
        ratio[: int(1.5 * cell / df) + 1] = 0.0
        if shaft:
            near = _near_shaft(ratio.shape[0], df, cell, shaft)
            ratio[near] = np.minimum(ratio[near], 1.0)
        return cls(df, cell, width, np.maximum(P - floor, 0.0), ratio)

    def without(self, f: float, sides: list[float]) -> _Floored:
        """The same with the strong ones of f's harmonics and of five sidebands each side of them
        cut down to the floor.

        A short load zone makes many sidebands.
        """
        ratio, harmonics = self.ratio.copy(), np.arange(f, self.ratio.shape[0] * self.df, f)
        for offset in (
            0.0,
            *(k * side for side in sides for k in range(-_SIDEBANDS, _SIDEBANDS + 1) if k),
        ):
            lines = harmonics + offset
            _cut(ratio, self.df, self.cell, lines[lines > 0], _STRONG)
        return replace(self, ratio=ratio)

    def families(self, grid: AnyArray) -> tuple[AnyArray, AnyArray]:
        """T(f) and the modulation depth at every frequency of the grid.

        A squared envelope holds nothing beyond the width of its band, where a line and its floor
        are both rounding: harmonics from there on count as noise does on average, ln 2.
        """
        T, depth = np.zeros_like(grid), np.zeros_like(grid)
        for k in range(1, LINES_OF_A_FAMILY + 1):
            index = np.rint(k * grid / self.df).astype(int)
            inside = (index < self.ratio.shape[0]) & (
                k * grid < self.width - _FLOOR_CELLS * self.cell
            )
            index = np.minimum(index, self.ratio.shape[0] - 1)
            T += np.where(inside, np.log1p(self.ratio[index]), np.log(2))
            depth += np.where(inside, self.above[index], 0.0)
        return T, np.sqrt(depth)


def _cut(ratio: AnyArray, df: float, cell: float, lines: AnyArray, above: float) -> None:
    """No line at these frequencies that stood `above` times the floor, or more, stands out any
    more.
    """
    for line in lines:
        around = _around(line, df, cell)
        if ratio[around].max(initial=0.0) > above:
            ratio[around] = np.minimum(ratio[around], 1.0)


def _around(line: float, df: float, cell: float) -> slice:
    reach = max(1.2 * cell, 0.003 * line)
    return slice(max(0, int((line - reach) / df)), int((line + reach) / df) + 2)


@lru_cache(maxsize=16)
def _near_shaft(lines: int, df: float, cell: float, shaft: float) -> AnyArray:
    """Which lines of a spectrum stand at harmonics of the shaft, shape (lines,)."""
    near = np.zeros(lines, dtype=bool)
    for harmonic in np.arange(shaft, lines * df, shaft):
        near[_around(harmonic, df, cell)] = True
    near.flags.writeable = False
    return near


def _is_control(grid: AnyArray, frequencies: BearingFrequencies) -> AnyArray:
    """Frequencies of the grid that neither a fault, its sidebands, nor the shaft explains."""
    control = np.ones(grid.shape, dtype=bool)
    explained = [
        related * variant * f
        for name, f in frequencies.lines.items()
        for variant in _VARIANTS[name]
        for related in _RELATED
    ]
    if frequencies.shaft:
        explained += [
            f + k * frequencies.shaft
            for name, f in frequencies.lines.items()
            if name != "ftf"
            for k in (-2, -1, 1, 2)
        ]
        for harmonic in np.arange(frequencies.shaft, grid[-1], frequencies.shaft):
            control &= np.abs(grid / harmonic - 1) > SLIP
    for f in explained:
        control &= np.abs(grid - f) > 1.7 * SLIP * f
    return control
