"""Readings in which a sensor says that it has nothing to say: single rows far beside their
neighbours, spans that stand still.

A row is far beside where it lies off the median of the five rows about it by more than ten robust
spreads of the steps between rows and by more than half of the range of all other values; a step is
none, for the median follows it. Equal values that follow one another are one reading there, so that
a code which stands for several rows is seen, if it lies beyond the range of all other values and is
one that sensors write for none: a machine that is off reads 0 for as long. A value that comes again
among such rows is an error code (−127, 85, −999.9 …): no plant gives the very same number twice
where it should give none. A span stands still where it is several times longer than any usual run
of equal values, while the model moves by far more than a digit. A sensor held it where the reading
then jumps to where the machine went meanwhile, or where it is noisy and repeats no value otherwise;
a machine that sticks goes on from where it stands. A position, or a speed of none, needs one of
these to be named: friction, which the model may lack, lets a machine rest.

Codes, held spans and single rows far beside are left out of whatever is judged or estimated; a row
where the model itself jumps for a sample is told, and stays. Fails for a plant that jumps for
single samples of which its model knows nothing: a sentence says which rows were left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import NotIdentifiable, said
from residuum.identification.physics import Experiment, PhysicalModel, estimate, match
from residuum.identification.record import Record
from residuum.identification.units import compatible, convert

_ABOUT = 5
_SPREADS, _OF_RANGE = 10.0, 0.5
_MOST, _MOST_CODED = 0.05, 0.3
"""Part of all rows that spikes, and known error codes, may be: of more, they are no exceptions."""
_ENDS = tuple(
    whole * digit for whole in (32767, 32768, 65535) for digit in (1.0, 0.5, 0.125, 0.1, 0.01)
)
_MARKS = (127.0, 850.0, 999.0, 9999.0, 99999.0, 999.9, 9999.9, *_ENDS)
"""Sizes of values that are written for none: DS18B20, Pt100, loggers, and the ends of 16 bits in
usual scalings.
"""
POWER_ON = 85.0
_ZERO_CELSIUS = 273.15
_LONG, _TIMES, _DIGITS = 20, 5.0, 5.0
"""Rows, usual runs and least steps by which a still span stands out."""
_JUMP = 3.0
"""Usual large steps by which a reading that was held jumps on."""
_JUMPS_TOO = 0.2
"""Part of a reading's distance from its neighbours by which a model that jumps there, too, is
beside its own.
"""
_REPEATED, _NOISY = 0.01, 3.0
"""Part of a noisy reading's rows that may repeat the one before, and its usual second difference,
in least steps.
"""
_RESTS = 1e-6
"""Part of its size by which a simulation that rests may move."""
_FEWEST = 30
_ANYWHERE = 1e300
"""Beyond every reading."""
_SHOWN = 12


@dataclass(frozen=True, eq=False)
class OddReadings:
    """Of one output in one record: rows far beside (numbers from 0), those that are error codes,
    the codes, still spans, those among them that a sensor held, and the rows far beside that the
    model knows nothing of.
    """

    output: str
    unit: str
    source: str
    beside: npt.NDArray[np.intp]
    codes: tuple[float, ...]
    coded: npt.NDArray[np.intp]
    still: tuple[tuple[int, int], ...]
    distance: tuple[float, float]
    held: tuple[tuple[int, int], ...] = ()
    spikes: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @property
    def rows(self) -> list[int]:
        """All of them that are still among what is compared."""
        return [*np.setdiff1d(self.beside, self.left_out).tolist(), *_rows_of(self._merely_still)]

    @property
    def left_out(self) -> npt.NDArray[np.intp]:
        """Rows that no sensor measured."""
        return np.union1d(
            np.union1d(self.coded, self.spikes), np.array(_rows_of(self.held), dtype=np.intp)
        )

    @property
    def only_left_out(self) -> OddReadings:
        """Of these, what is left out."""
        return replace(self, beside=np.union1d(self.coded, self.spikes), still=self.held)

    @property
    def _merely_still(self) -> tuple[tuple[int, int], ...]:
        return tuple(span for span in self.still if span not in self.held)

    def says(self) -> list[str]:
        """A sentence of each kind."""
        texts = []
        where = f"{self.source}, {self.output}"
        if self.coded.size:
            values, leave_out = _values_and_way_on(self.codes)
            texts.append(
                f"{where}: {_told_rows(self.coded, '')} read {values} {self.unit}, an error code"
                f" beside their neighbours; they are left out here; {leave_out} leaves them out"
                " everywhere"
            )
        alone = np.setdiff1d(self.beside, self.coded)
        if alone.size:
            near, far = self.distance
            lie = f"lie {near:.3g} to {far:.3g}" if len(alone) > 1 else f"lies {near:.3g}"
            text = (
                f"{where}: {_told_rows(alone, 'single ')} {lie} {self.unit} beside the neighbours"
            )
            if np.isin(alone, self.spikes).all():
                texts.append(f"{text}, where the model does not jump; they are left out here")
            else:
                texts.append(
                    f"{text} and may make much of the error; where they mean no value,"
                    f" {said('missing', ['VALUE'])} says so"
                )
        if self.held:
            texts.append(
                f"{where}: stands still in samples {_spans(self.held)} while the model moves, as no"
                " machine at rest does: a sensor that held its last value; they are left out here"
            )
        if self._merely_still:
            spans = _spans(self._merely_still)
            texts.append(
                f"{where}: stands still in samples {spans} while the model moves: a sensor that"
                " held its last value?"
            )
        return texts


def _told_rows(rows: npt.NDArray[np.intp], kind: str) -> str:
    shown = ", ".join(map(str, rows[:_SHOWN])) + ", …" * (len(rows) > _SHOWN)
    many = "s" * (len(rows) > 1)
    return f"{len(rows)} {kind}sample{many} (number{many} {shown})"


def _values_and_way_on(codes: Sequence[float]) -> tuple[str, str]:
    """Error codes in words, and how is said of them that they mean no value."""
    values = [f"{code:.10g}" for code in codes]
    return " or ".join(values), said("missing", values)


def _rows_of(spans: Sequence[tuple[int, int]]) -> list[int]:
    return [row for first, last in spans for row in range(first, last + 1)]


def _spans(spans: Sequence[tuple[int, int]]) -> str:
    return ", ".join(f"{first} to {last}" for first, last in spans[:_SHOWN]) + ", …" * (
        len(spans) > _SHOWN
    )


def odd_readings(
    model: PhysicalModel, experiments: Sequence[Experiment], simulated: Sequence[FloatArray]
) -> list[OddReadings]:
    """What stands out of every measured output, beside `simulated` (n, outputs) an experiment."""
    readings = []
    for experiment, beside in zip(experiments, simulated, strict=True):
        for k, name in enumerate(model.outputs):
            odd = _odd_of_output(model, name, experiment, beside[:, k])
            if odd is not None:
                readings.append(odd)
    return readings


def _odd_of_output(
    model: PhysicalModel, name: str, experiment: Experiment, simulated: FloatArray
) -> OddReadings | None:
    """What stands out of one output, beside its simulation (n,); None where nothing does, or too
    few samples tell.
    """
    y = experiment.Y[:, list(model.outputs).index(name)]
    if np.isfinite(y).sum() < _FEWEST:
        return None
    unit = model.outputs[name].unit
    rows, codes, off = far_beside(y, unit)
    coded = rows[np.isin(y[rows], codes)]
    alone = off[~np.isin(rows, coded)]
    distance = (float(alone.min()), float(alone.max())) if alone.size else (0.0, 0.0)
    # spans are sought without the rows far beside: one in a span would break it
    single = np.where(np.isin(np.arange(len(y)), rows), np.nan, y)
    still = _still(single, simulated)
    noisy = _never_repeats(single, still)
    held = tuple(
        span
        for span in still
        # a speed of exactly 0 is what a machine at rest reads, however noisy it is else
        if (noisy and single[span[0]] != 0.0) or _jumps_on(single, simulated, span, still)
    )
    still = tuple(
        span for span in still if span in held or not _may_rest(model, name, single, span)
    )
    if not (rows.size or still):
        return None
    return OddReadings(
        output=name,
        unit=str(unit),
        source=experiment.source,
        beside=rows,
        codes=codes,
        coded=coded,
        still=still,
        distance=distance,
        held=held,
        spikes=np.setdiff1d(rows[~_jumps(simulated, rows, off)], coded),
    )


def without_odd(
    model: PhysicalModel, experiments: Sequence[Experiment]
) -> tuple[list[Experiment], list[OddReadings]]:
    """The experiments with error codes, held spans and single rows far beside missing, and what was
    left out.

    The model is simulated without any of them, and then says which rows it jumps at itself and
    which spans it moves in. A model that diverges tells no spans; whoever simulates it says so.
    """
    # first without a simulation, for codes and single rows have to be gone before one is made: no
    # spans, for the model is not known to move anywhere
    if not any(_may_be_odd(model, experiment) for experiment in experiments):
        return list(experiments), []
    unknown = [np.full_like(experiment.Y, np.nan) for experiment in experiments]
    without, readings = _left_out(model, experiments, unknown)
    try:
        simulated = estimate(model, without, free=()).predicted
    except NotIdentifiable:
        simulated = []
    if simulated:
        without, readings = _left_out(model, experiments, simulated)
    return without, [odd.only_left_out for odd in readings if odd.left_out.size]


def _may_be_odd(model: PhysicalModel, experiment: Experiment) -> bool:
    """Whether rows would be left out beside some simulation: most records have none, and are spared
    it.
    """
    # One that moves further than any reading, in every span.
    moving = np.where(np.arange(experiment.n) % 2, _ANYWHERE, -_ANYWHERE)
    return any(
        far_beside(y, str(output.unit))[0].size > 0 or len(_still(y, moving)) > 0
        for output, y in zip(model.outputs.values(), experiment.Y.T, strict=True)
        if np.isfinite(y).sum() >= _FEWEST
    )


def records_without_odd(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None = None
) -> tuple[list[Record], tuple[str, ...]]:
    """The records with error codes and held spans of the outputs missing, and a sentence of each
    kind that was left out.
    """
    matched, experiments = match(model, records, mapping)
    without, odd = without_odd(matched, experiments)
    columns = {(mapping or {}).get(name, name): k for k, name in enumerate(matched.outputs)}
    mended = []
    for record, was, now in zip(records, experiments, without, strict=True):
        out = np.isnan(now.Y) & np.isfinite(was.Y)
        lacking = {
            name: np.where(out[:, k], np.nan, record[name])
            for name, k in columns.items()
            if out[:, k].any()
        }
        mended.append(
            replace(record, channels={**record.channels, **lacking}) if lacking else record
        )
    says = (text for reading in odd for text in reading.says())
    return mended, (*says, *codes_of_inputs(model, records, mapping))


def codes_of_inputs(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None = None
) -> tuple[str, ...]:
    """A sentence of each input that holds error codes, in the record's own unit; they stay, for a
    simulation needs a value.

    A code lies beyond the range of all other values by half of it: the steps of an input are as
    large as its range.
    """
    says = []
    for record in records:
        for column in ((mapping or {}).get(name, name) for name in model.inputs):
            if column not in record.names:
                continue
            u = np.asarray(record[column], dtype=float)
            marked = np.isfinite(u) & is_mark(u)
            unmarked = u[np.isfinite(u) & ~marked]
            if not marked.any() or not unmarked.size:
                continue
            apart = _OF_RANGE * np.ptp(unmarked)
            rows = np.flatnonzero(
                marked & ((u < unmarked.min() - apart) | (u > unmarked.max() + apart))
            )
            if rows.size:
                values, leave_out = _values_and_way_on(sorted(set(u[rows].tolist())))
                says.append(
                    f"{record.source}, {column}: {_told_rows(rows, '')} read {values}"
                    f" {record.units.get(column, '')}, an error code beside all other values, and"
                    f" drive the model; nothing here is to be trusted before {leave_out} leaves"
                    " them out"
                )
    return tuple(says)


def _left_out(
    model: PhysicalModel, experiments: Sequence[Experiment], simulated: Sequence[FloatArray]
) -> tuple[list[Experiment], list[OddReadings]]:
    """The experiments without the rows that no sensor measured, and what was found."""
    mended, readings = [], []
    for experiment, beside in zip(experiments, simulated, strict=True):
        outliers = odd_readings(model, [experiment], [beside])
        Y = experiment.Y.copy()
        for odd in outliers:
            Y[odd.left_out, list(model.outputs).index(odd.output)] = np.nan
        mended.append(replace(experiment, Y=Y))
        readings += outliers
    return mended, readings


def far_beside(
    y: FloatArray, unit: str = ""
) -> tuple[npt.NDArray[np.intp], tuple[float, ...], FloatArray]:
    """Rows far beside the median of those about them, the values that come again among these, and
    how far each row is.

    >>> y = np.sin(np.arange(200) / 20)
    >>> y[[30, 90, 150]] = 85.0, -127.0, 85.0
    >>> rows, codes, _ = far_beside(y)
    >>> rows.tolist(), codes
    ([30, 90, 150], (85.0,))
    """
    known = np.flatnonzero(np.isfinite(y))
    every = y[known]
    # equal values that follow one another are one reading, or a code in several rows would be the
    # median of its own neighbourhood
    begins = np.r_[True, every[1:] != every[:-1]][: len(every)]
    values, lengths = every[begins], np.diff(np.flatnonzero(np.r_[begins, True]))
    if len(values) < _ABOUT:
        return known[:0], (), every[:0]
    off = _beside_neighbours(values)
    # 1.4826 = 1/Φ⁻¹(¾): a spread of the steps that outliers do not move
    far = off > _SPREADS * 1.4826 * float(np.median(np.abs(np.diff(values))))
    low, high = np.quantile(values[~far], [0.005, 0.995]) if not far.all() else (0.0, 0.0)
    apart = _OF_RANGE * float(high - low)
    # 85 °C is a thermometer's value before its first conversion only where a record begins with it
    first = np.arange(len(values)) == 0
    out = ((values < low - apart) | (values > high + apart)) & (
        is_mark(values) | (first & _is_power_on(values, unit))
    )
    large = far & (off > apart) & ((lengths == 1) | out)
    # no plant gives the very same number twice where it should give none
    read = Counter(np.repeat(values[large], lengths[large]).tolist())
    codes = tuple(sorted(value for value, count in read.items() if count > 1))
    # one near what the sensor should show is one, too
    coded = np.isin(values, codes) & (out | (far & (lengths == 1)))
    # of too many rows none is an exception: then it is the plant that jumps
    unusual = (large | coded) & ~(coded & out)
    if lengths[unusual].sum() > _MOST * len(every) or lengths[coded].sum() > _MOST_CODED * len(
        every
    ):
        return known[:0], (), every[:0]
    odd = np.repeat(large | coded, lengths)
    return known[odd], codes, np.repeat(off, lengths)[odd]


def is_mark(values: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether values are what sensors and their buses write for none, in kelvin too where a record
    in degC was.
    """
    near = [
        np.isclose(np.abs(values + shift), mark, rtol=1e-9)
        for mark in _MARKS
        for shift in (0.0, -_ZERO_CELSIUS)
    ]
    return np.asarray(np.any(near, axis=0))


def _jumps(
    simulated: FloatArray, rows: npt.NDArray[np.intp], off: FloatArray
) -> npt.NDArray[np.bool_]:
    """Whether a simulation lies at these rows as far beside its own neighbours as the reading, in
    part.
    """
    return np.asarray(_beside_neighbours(simulated)[rows] > _JUMPS_TOO * off)


def _beside_neighbours(values: FloatArray) -> FloatArray:
    """How far each value lies from the median of those about it."""
    # of a question alone: starting is for all
    from scipy.ndimage import median_filter  # noqa: PLC0415

    return np.abs(values - median_filter(values, _ABOUT, mode="mirror"))


def _never_repeats(y: FloatArray, still: Sequence[tuple[int, int]]) -> bool:
    """Whether a reading, outside its still spans, is noisy and repeats no value: then a value that
    stays is held.

    Counts of a smooth motion do not repeat either where it is fast; their second differences are of
    the size of a count.
    """
    y = y[~np.isin(np.arange(len(y)), _rows_of(still))]
    y = y[np.isfinite(y)]
    if len(y) < _FEWEST:
        return False
    repeated, digit = np.mean(np.diff(y) == 0), _digit(y)
    second_difference = np.median(np.abs(np.diff(y, 2)))
    return bool(repeated < _REPEATED and second_difference > _NOISY * digit > 0)


def _is_power_on(values: FloatArray, unit: str) -> npt.NDArray[np.bool_]:
    """Whether values are what a 1-wire thermometer reads before its first conversion, 85 °C, for as
    long as it takes.
    """
    temperature = bool(unit) and compatible(unit, "degC")
    return np.asarray(
        np.isclose(
            values, float(convert(POWER_ON, "degC", unit)) if temperature else np.inf, rtol=1e-9
        )
    )


def _may_rest(model: PhysicalModel, output: str, y: FloatArray, span: tuple[int, int]) -> bool:
    """Whether the machine itself may stand still there, as friction holds it: at any position, at a
    speed of none.
    """
    names = model.outputs[output].value.names
    moves = {
        role
        for balance in model.balances.values()
        for role, name in balance.variables.items()
        if name in names
    }
    rests = abs(float(y[span[0]])) <= _digit(y[np.isfinite(y)])
    return moves == {"position"} or ("velocity" in moves and rests)


def _jumps_on(
    y: FloatArray, simulated: FloatArray, span: tuple[int, int], still: Sequence[tuple[int, int]]
) -> bool:
    """Whether the reading after a span lies far from it, in usual steps of the machine and the
    model's as it sets out.
    """
    known = np.flatnonzero(np.isfinite(y))
    after = known[known > span[1]]
    if not after.size:  # it stands until the record ends: nothing tells a held sensor
        return False
    # usual steps without those out of still spans, which are what is asked
    follows = ~np.isin(known, _rows_of([(first, last + 1) for first, last in still]))
    usual = (
        float(np.quantile(np.abs(np.diff(y[known[follows]])), 0.99))
        if follows.sum() > _FEWEST
        else np.inf
    )
    # a machine that sticks sets out as fast as the model does there
    driven = np.abs(np.diff(simulated[max(span[1] - 1, 0) : after[0] + 2]))
    usual = max(usual, float(np.nanmax(driven, initial=0.0)))
    return bool(abs(float(y[after[0]] - y[span[0]])) > _JUMP * usual > 0)


def _still(y: FloatArray, simulated: FloatArray) -> tuple[tuple[int, int], ...]:
    """First and last row of spans that stand still while the model moves."""
    known = np.flatnonzero(np.isfinite(y))
    if len(known) < _FEWEST:
        return ()
    if not np.ptp(y[known]):  # it never moves: no digit of it is known
        return ((int(known[0]), int(known[-1])),) if _moves_at_all(simulated) else ()
    filled = y.copy()
    filled[np.isnan(y)] = np.interp(np.flatnonzero(np.isnan(y)), known, y[known])
    starts = np.flatnonzero(np.r_[True, filled[1:] != filled[:-1]])
    lengths = np.diff(np.r_[starts, len(filled)])
    digit = _digit(filled)
    if not digit:
        return ()
    long = max(_LONG, _TIMES * float(np.quantile(lengths, 0.9)))
    spans = []
    for first, length in zip(starts, lengths, strict=True):
        if length >= long and _moves_by(simulated[first : first + length], _DIGITS * digit):
            spans.append((int(first), int(first + length - 1)))
    return tuple(spans)


def _digit(y: FloatArray) -> float:
    """The least step of a reading; 0 where it makes none."""
    steps = np.abs(np.diff(y))
    return float(steps[steps > 0].min()) if (steps > 0).any() else 0.0


def _moves_at_all(simulated: FloatArray) -> bool:
    """Whether a simulation moves by more than rounding."""
    known = simulated[np.isfinite(simulated)]
    return bool(known.size > 0 and np.ptp(known) > _RESTS * np.abs(known).max())


def _moves_by(simulated: FloatArray, least: float) -> bool:
    """Whether a part of a simulation moves by more than this; not where nothing is known of it."""
    if not np.isfinite(simulated).any():
        return False
    return float(np.nanmax(simulated) - np.nanmin(simulated)) > least
