"""What training leaves: the model with its healthy values, its filter, what is usual in every size, and the limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.learning.stored import load_stored, save_stored
from residuum.diagnosis.model_based.beside import Beside
from residuum.diagnosis.model_based.detection import Calibration, Energies, Group, groups_of
from residuum.diagnosis.model_based.filtered_window import FilterNoise, TrackingFilter
from residuum.diagnosis.model_based.healthy_scatter import HealthyScatter
from residuum.diagnosis.model_based.hypotheses import Hypothesis, Signals
from residuum.diagnosis.model_based.left_open import LeftOpen
from residuum.diagnosis.model_based.usual_values import usual_values
from residuum.diagnosis.model_based.window_statistics import Colour
from residuum.identification.errors import BadInput
from residuum.identification.physics import PhysicalModel, read_model, write_model

Array = npt.NDArray[np.float64]

_VERSION = 5


@dataclass(frozen=True, eq=False)
class Usual:
    """What healthy windows were like, beside the innovations.

    Attributes
    ----------
    seconds : float
        Length of a healthy window.
    information : array, shape (m,)
        Least information of a healthy window on each size.
    spans : array, shape (outputs,)
        Smallest largest-minus-smallest reading of each output; `ranges` the largest.
    input_spans : array, shape (inputs,)
        Smallest span of each input.
    runs : array of int, shape (outputs,)
        Longest run of equal readings.
    low, high : array, shape (m,)
        95 % band of each size as one further healthy window would tell it by itself, in its unit, about the model's value.
    together_low, together_high : array, shape (free parameters,)
        The same of the parameters' values, all of them told at once.
    """

    seconds: float
    information: Array
    spans: Array
    ranges: Array
    input_spans: Array
    runs: Array
    low: Array
    high: Array
    together_low: Array
    together_high: Array


@dataclass(frozen=True, eq=False)
class Baseline:
    """A trained model-based diagnoser.

    Attributes
    ----------
    tracking : TrackingFilter
        Of the model with its healthy values; `stand_ins` are effects in it that the user's model file lacks (label → rise of the
        log-likelihood).
    free : tuple of str
        Values that windows are asked for.
    measured : array of bool
        Outputs that healthy windows had.
    """

    tracking: TrackingFilter
    free: tuple[str, ...]
    stand_ins: Mapping[str, float]
    hypotheses: Sequence[Hypothesis]
    colours: Sequence[Colour]
    scatter: HealthyScatter
    calibration: Calibration
    energies: Energies
    left_open: LeftOpen
    usual: Usual
    beside: Beside
    sample_time: float
    hold: Array
    measured: npt.NDArray[np.bool_]
    sources: Sequence[str]

    @cached_property
    def signals(self) -> Signals:
        """The signals of all hypotheses."""
        return Signals(self.tracking.model, self.hypotheses)

    @cached_property
    def groups(self) -> list[Group]:
        """The sizes of each hypothesis."""
        return groups_of([len(h.columns) for h in self.hypotheses])

    @property
    def free_sizes(self) -> list[int]:
        """Places of the free parameters among the sizes."""
        at = {c.acts_on: g.sizes[0] for g, h in zip(self.groups, self.hypotheses, strict=True) for c in h.columns[:1]}
        return [at[f"parameter:{name}"] for name in self.free]

    def usual_values(self, conditions: Array) -> tuple[dict[str, float], Array]:
        """Values that are usual under these conditions, and how far each size was moved, in its unit."""
        return usual_values(self.tracking.model, self.hypotheses, self.groups, self.scatter, conditions)

    def save(self, path: str | Path, kind: str, settings: Mapping[str, Any]) -> None:
        """Store it in a file."""
        t, s, c, e, o, u = self.tracking, self.scatter, self.calibration, self.energies, self.left_open, self.usual
        meta = {
            "model": write_model(t.model),
            "absent": [name for name, signal in t.model.inputs.items() if signal.absent],
            "substeps": t.substeps,
            "free": list(self.free),
            "stand_ins": dict(self.stand_ins),
            "hypotheses": [h.to_json() for h in self.hypotheses],
            "colours": [[list(colour.polynomial), colour.std] for colour in self.colours],
            "windows": [s.windows, e.windows],
            "beside": self.beside.to_json(),
            "seconds": u.seconds,
            "sample_time": self.sample_time,
            "sources": list(self.sources),
            "settings": dict(settings),
        }
        arrays = {
            "output_variance": t.noise.output_variance, "process": t.noise.process, "scales": t.scales,
            "scale": s.scale, "own": s.own, "moving": s.moving,
            "coefficients": s.coefficients, "doubt": s.doubt, "variance": s.variance, "tests": c.tests,
            "before": c.before, "shown": c.shown, "inflation": c.inflation, "freedom": c.freedom,
            "open": o.sizes, "open_absorbed": o.absorbed, "open_size": o.size,
            "left_out": c.left_out, "energy_mean": e.mean, "energy_std": e.std,
            "information": u.information, "spans": u.spans, "ranges": u.ranges, "input_spans": u.input_spans,
            "runs": u.runs, "low": u.low, "high": u.high,
            "together_low": u.together_low, "together_high": u.together_high, "hold": self.hold, "measured": self.measured,
        }  # fmt: skip
        save_stored(path, kind, _VERSION, meta, arrays)

    @classmethod
    def load(cls, path: str | Path, kind: str) -> tuple[Baseline, dict[str, Any]]:
        """What `save` stored, and the diagnoser's settings; BadInput for a file that is none or is damaged."""
        stored = load_stored(path, kind)
        try:
            return _restored(stored.meta, stored.arrays), dict(stored.meta["settings"])
        except (KeyError, ValueError, TypeError, IndexError) as error:
            raise BadInput(f"{path}: is not a {kind} baseline: {' '.join(str(error).split())[:120]}") from None


def _restored(meta: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Baseline:
    model = read_model(meta["model"], "baseline")
    model = with_absent(model, meta["absent"])
    noise = FilterNoise(arrays["output_variance"], arrays["process"])
    tracking = TrackingFilter(model, noise, arrays["scales"], int(meta["substeps"]))
    of, energy_windows = meta["windows"]
    usual = Usual(
        float(meta["seconds"]),
        *(arrays[n] for n in ("information", "spans", "ranges", "input_spans", "runs")),
        *(arrays[n] for n in ("low", "high", "together_low", "together_high")),
    )
    return Baseline(
        tracking,
        tuple(meta["free"]),
        dict(meta["stand_ins"]),
        [Hypothesis.from_json(h) for h in meta["hypotheses"]],
        [Colour(tuple(polynomial), std) for polynomial, std in meta["colours"]],
        HealthyScatter(
            arrays["scale"], arrays["own"], arrays["moving"], arrays["coefficients"], arrays["doubt"], arrays["variance"], int(of)
        ),
        Calibration(
            arrays["before"],
            arrays["shown"],
            arrays["inflation"],
            arrays["freedom"],
            arrays["tests"],
            arrays["left_out"],
        ),
        Energies(arrays["energy_mean"], arrays["energy_std"], int(energy_windows)),
        LeftOpen(arrays["open"].astype(np.int64), arrays["open_absorbed"], arrays["open_size"]),
        usual,
        Beside.from_json(meta["beside"]),
        float(meta["sample_time"]),
        arrays["hold"],
        arrays["measured"].astype(bool),
        list(meta["sources"]),
    )


def with_absent(model: PhysicalModel, absent: Sequence[str]) -> PhysicalModel:
    """The model with these optional inputs marked as not recorded."""
    inputs = {name: replace(signal, absent=name in absent) for name, signal in model.inputs.items()}
    return replace(model, inputs=MappingProxyType(inputs))
