"""A record seen through a model: inputs and outputs in the model's order and units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.kept_loops import njit
from residuum.nearest_names import known_names

if TYPE_CHECKING:
    from residuum.identification.physics.model import PhysicalModel

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
PART = "(part "
"""How the name of a part of a record goes on."""
SHORTEST_PART = 50
"""Samples between two holes of an input, at least, for a record to be cut there."""


@dataclass(frozen=True, eq=False)
class Spare:
    """A column of a record that the model does not use: `values` (n,) complete, and their
    `unit`.
    """

    values: Array
    unit: str


@dataclass(frozen=True, eq=False)
class Experiment:
    """One record in the model's terms.

    Attributes
    ----------
    U : array, shape (n, inputs)
        Complete (a gap in an input is refused).
    Y : array, shape (n, outputs)
        NaN where a sample is missing; a whole column of NaN for an output that the record lacks.
    hold : array, shape (inputs,)
        1 where the input moves linearly between samples, 0 where it is held over the sample.
    sample_time, t0 : float
        [s].
    block : int
        Statistics of residuals are taken over means of so many samples (`means`); the simulation is
        not affected.
    known : mapping of state to value
        Initial values that are known from what went before, and not estimated.
    spare : mapping of column to Spare
        What else was recorded, sample by sample as U is.
    clocks : tuple of bool
        Which inputs are the time since the record's begin, whatever the timing of the others;
        empty: none.
    """

    U: Array
    Y: Array
    hold: Array
    sample_time: float
    t0: float = 0.0
    source: str = ""
    block: int = 1
    known: Mapping[str, float] = field(default_factory=dict)
    spare: Mapping[str, Spare] = field(default_factory=dict)
    clocks: tuple[bool, ...] = ()

    @property
    def n(self) -> int:
        """Number of samples."""
        return int(self.U.shape[0])

    @property
    def measured(self) -> npt.NDArray[np.bool_]:
        """Which outputs the record has, shape (outputs,)."""
        return ~np.all(np.isnan(self.Y), axis=0)

    def turned(self, which: npt.NDArray[np.bool_]) -> Experiment:
        """These of the inputs at the other timing: those that were held move evenly, and those that
        moved are held.
        """
        # A clock moves evenly whatever the record says of its inputs.
        clocks = np.array(self.clocks or (False,) * len(self.hold), dtype=bool)
        return replace(self, hold=np.where(which & ~clocks, 1.0 - self.hold, self.hold))

    def follows(self, other: Experiment) -> bool:
        """Whether this one's first sample is the next after the other's last, in the same
        record.
        """
        end = other.t0 + other.n * other.sample_time
        return (
            self.source == other.source
            and self.t0 > other.t0
            # Half a sample: times of windows are sums of steps, which round.
            and abs(self.t0 - end) < 0.5 * self.sample_time
        )

    def means(self, values: Array) -> Array:
        """`block_means` over this experiment's blocks."""
        return block_means(values, self.block)

    def window(self, start: int, stop: int) -> Experiment:
        """Samples start … stop − 1."""
        # Known is what stood at the record's begin, not at the window's.
        known = self.known if start == 0 else {}
        spare = {name: replace(s, values=s.values[start:stop]) for name, s in self.spare.items()}
        t0 = self.t0 + start * self.sample_time
        return replace(
            self, U=self.U[start:stop], Y=self.Y[start:stop], t0=t0, known=known, spare=spare
        )


def match(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    hold: Mapping[str, str] | str = "auto",
) -> tuple[PhysicalModel, list[Experiment]]:
    """The records as experiments of the model, and the model with the optional inputs that they
    lack marked absent.

    Parameters
    ----------
    mapping : mapping of model name to column
        For columns that are not named as the model's inputs and outputs are.
    hold : "auto", "zero-order", "linear", or a mapping of input to one of these
        How inputs move between samples. "auto": linear for a signal whose steps are mostly small
        (under 2 % of its span) or that moves at nearly every sample with under 5 % of its power
        above three quarters of the Nyquist frequency; held otherwise.

    Raises
    ------
    BadRecord
        A required input is absent or has missing samples, a mapped name or column does not exist,
        no output is there.
    BadUnit
        A column's unit cannot be converted to the model's.
    """
    columns = _columns(model, mapping or {})
    optional = [
        name
        for name, signal in model.inputs.items()
        if signal.default is not None and not signal.is_clock
    ]
    # Absent in one record means absent in all: the structure is one for all experiments.
    lacking = [name for name in optional if not all(columns[name] in r.names for r in records)]
    inputs = {
        name: replace(signal, absent=name in lacking) for name, signal in model.inputs.items()
    }
    model = replace(model, inputs=MappingProxyType(inputs))
    return model, [_experiment(model, record, columns, hold) for record in records]


def measured_parts(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None = None
) -> list[Record]:
    """The records, those with holes in an input cut there: every part is an experiment with first
    states of its own.

    A hole is where an input was not measured: what the machine did meanwhile nobody knows, and no
    simulation goes on after it. Where what is left between the holes is shorter than
    `SHORTEST_PART` samples (an input that is there at every other sample only), the record stays as
    it is, and `match` refuses it.
    """
    inputs = [(mapping or {}).get(name, name) for name in model.inputs]
    parts = []
    for record in records:
        parts += _between_holes(record, [name for name in inputs if name in record.names])
    return parts


def _between_holes(record: Record, inputs: Sequence[str]) -> list[Record]:
    lacking = np.zeros(record.n, dtype=bool)
    for name in inputs:
        lacking |= record.missing(name)
    if not lacking.any():
        return [record]
    # Where "missing" changes: each pair of edges bounds a part without holes.
    edges = np.flatnonzero(np.diff(np.concatenate([[True], lacking, [True]]).astype(np.int8)))
    parts = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    # An input that is there at every other sample only leaves no parts: `match` refuses it.
    if not parts or min(stop - start for start, stop in parts) < SHORTEST_PART:
        return [record]
    named = [
        (record.window(start, stop), number) for number, (start, stop) in enumerate(parts, start=1)
    ]
    return [
        replace(part, source=f"{record.source} {PART}{k}: {part.t0:.6g} to {part.time[-1]:.6g} s)")
        for part, k in named
    ]


def _columns(model: PhysicalModel, mapping: Mapping[str, str]) -> dict[str, str]:
    known = [*model.inputs, *model.outputs]
    for name in mapping:
        if name not in known:
            raise BadRecord(
                f"map {name}={mapping[name]}: the model has no input or output {name!r};"
                f" {known_names(name, known, 'there are')}"
            )
    return {name: mapping.get(name, name) for name in known}


def _experiment(
    model: PhysicalModel, record: Record, columns: Mapping[str, str], hold: Mapping[str, str] | str
) -> Experiment:
    U = _inputs(model, record, columns)
    Y = _outputs(model, record, columns)
    clocks = [signal.is_clock for signal in model.inputs.values()]
    wanted = [hold if isinstance(hold, str) else hold.get(name, "auto") for name in model.inputs]
    linear = np.array(
        [clocks[k] or moves_evenly(how, U[:, k]) for k, how in enumerate(wanted)], dtype=float
    )
    return Experiment(
        U,
        Y,
        linear,
        record.sample_time,
        record.t0,
        record.source,
        spare=_spare(record, set(columns.values())),
        clocks=tuple(clocks),
    )


def _inputs(model: PhysicalModel, record: Record, columns: Mapping[str, str]) -> Array:
    """Values of the model's inputs, shape (n, inputs): those that are absent stay 0, for the
    equations have their default in place of them.
    """
    U = np.zeros((record.n, len(model.inputs)))
    for k, signal in enumerate(model.inputs.values()):
        if signal.is_clock:
            U[:, k] = record.sample_time * np.arange(record.n)
        elif not signal.absent:
            U[:, k] = _input(record, columns[signal.name], signal.name, signal.unit)
    return U


def _outputs(model: PhysicalModel, record: Record, columns: Mapping[str, str]) -> Array:
    """Readings of the model's outputs, shape (n, outputs), a column of NaN for one that the record
    lacks; BadRecord where it has none at all.
    """
    Y = np.full((record.n, len(model.outputs)), np.nan)
    for k, output in enumerate(model.outputs.values()):
        column = columns[output.name]
        if column not in (output.name, *record.names):
            hint = known_names(column, record.names, "the columns are")
            raise BadRecord(
                f"{_named(record)}: output {output.name!r} is mapped to {column!r}, which is not"
                f" there; {hint}"
            )
        if column in record.names:
            Y[:, k] = record.in_unit(column, output.unit)
    if np.all(np.isnan(Y)):
        hint = f"outputs are {', '.join(model.outputs)}; columns are {', '.join(record.names)}"
        way = ("map", {"OUTPUT": "COLUMN"})
        raise BadRecord(
            f"record {record.source!r}: has no output of model {model.name!r} ({hint})",
            way_on=[way],
        )
    return Y


def _spare(record: Record, used: set[str]) -> dict[str, Spare]:
    """Complete columns that change and that the model does not use."""
    spare = {}
    for name in record.names:
        values = np.asarray(record.channels[name], dtype=float)
        if (
            name not in used
            # It must be possible to name it in an expression.
            and name.isidentifier()
            and np.all(np.isfinite(values))
            and np.ptp(values) > 0
        ):
            spare[name] = Spare(values, record.units.get(name, ""))
    return spare


def _input(record: Record, column: str, name: str, unit: str) -> Array:
    if column not in record.names:
        hint = known_names(column, record.names, "the columns are")
        lacking = "is missing" if column == name else f"is mapped to {column!r}, which is not there"
        raise BadRecord(
            f"{_named(record)}: input {name!r} {lacking}; {hint}",
            way_on=[("map", {name: "COLUMN"})],
        )
    gaps = np.flatnonzero(record.missing(column))
    if gaps.size:
        where = (
            f"{_named(record)}: input {column!r} has no value at sample {int(gaps[0])}; inputs must"
            " be complete"
        )
        raise _incomplete(record.missing(column), where)
    return record.in_unit(column, unit)


def _incomplete(missing: npt.NDArray[np.bool_], says: str) -> BadRecord:
    """The refusal of an input without these samples: one that is recorded at a lower rate gets
    lines between its samples.
    """
    apart = np.diff(np.flatnonzero(~missing))
    # Mostly every n-th sample is there: a column recorded at a lower rate.
    if apart.size and (step := int(np.median(apart))) > 1:
        way = ("resample", True, "where the record is read, to have those between")
        return BadRecord(f"{says}, it has one every {step} samples", way_on=[way])
    return BadRecord(
        f"{says}: cut the record there, record.window(start, stop), and give the parts as a list"
    )


def _named(record: Record) -> str:
    return f"record {record.source!r}" if record.source else "record"


def moves_evenly(how: str, u: Array) -> bool:
    """Whether an input moves from sample to sample rather than being held, as `match` takes it."""
    if how in ("linear", "zero-order"):
        return how == "linear"
    if how != "auto":
        raise BadRecord(f"hold {how!r}: must be auto, linear or zero-order")
    steps = np.abs(np.diff(u))
    moving = steps[steps > 0]
    span = float(np.ptp(u))
    # Mostly small steps: a sampled motion. Large ones: a command that is switched.
    if moving.size == 0 or np.median(moving) < 0.02 * span:
        return moving.size > 0
    return moving.size > 0.9 * steps.size and _power_above(0.75, u) < 0.05


def _power_above(fraction: float, u: Array) -> float:
    """Share of a signal's power above this fraction of the Nyquist frequency."""
    spectrum = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(u.size))) ** 2
    return float(np.sum(spectrum[int(fraction * spectrum.size) :]) / np.sum(spectrum))


def block_means(values: Array, block: int) -> Array:
    """Means along axis 0 of consecutive blocks of samples: one that lacks a sample is missing, the
    last, incomplete one is left out.
    """
    return means_in_blocks(values, np.array([0, len(values)]), [block])[0]


def means_in_blocks(
    values: Array, starts: Integers, blocks: Sequence[int]
) -> tuple[Array, Integers]:
    """Means along axis 0 of several pieces. Piece k is values[starts[k]] … values[starts[k + 1] −
    1], in blocks of blocks[k]. Also where those of each piece start and the last ones end.
    """
    if all(block == 1 for block in blocks):
        return values, starts
    sizes = np.array(blocks, dtype=np.int64)
    block_starts = np.concatenate([[0], np.cumsum(np.diff(starts) // sizes)])
    rows = np.ascontiguousarray(values).reshape(len(values), -1)
    means = np.zeros((block_starts[-1], rows.shape[1]))
    _add_means(rows, starts, sizes, block_starts, means)
    return means.reshape(-1, *values.shape[1:]), block_starts


@njit(error_model="numpy")
def _add_means(rows, starts, blocks, block_starts, means):  # type: ignore[no-untyped-def]
    for k in range(blocks.shape[0]):
        for j in range(block_starts[k + 1] - block_starts[k]):
            for i in range(blocks[k]):
                for c in range(rows.shape[1]):
                    means[block_starts[k] + j, c] += rows[starts[k] + j * blocks[k] + i, c]
            for c in range(rows.shape[1]):
                means[block_starts[k] + j, c] /= blocks[k]
