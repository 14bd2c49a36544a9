"""What training leaves: the healthy model, how its values and errors scatter, and what hypotheses
gain in healthy windows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.array_types import FloatArray
from residuum.diagnosis.learning.stored import load_stored, save_stored
from residuum.diagnosis.model_based.hypotheses import Hypothesis, hypotheses
from residuum.diagnosis.model_based.policy import FIT_STEPS, STILL, VISIBLE_POWER, WIDE
from residuum.diagnosis.model_based.variant import Variant, edited, shifted
from residuum.diagnosis.model_based.window_fit import (
    Fit,
    Scatter,
    Whitening,
    WindowFitter,
    information_on_size,
    log_power,
)
from residuum.identification.errors import BadInput
from residuum.identification.physics import (
    EffectUse,
    Experiment,
    PhysicalModel,
    read_model,
    write_model,
)
from residuum.identification.physics.fmu.permission import ARRAY as FMU
from residuum.identification.physics.fmu.permission import check_allowed
from residuum.identification.unseen_blocks.structure import HeldValue

if TYPE_CHECKING:
    from residuum.identification.physics.fmu.watched_model import WatchedFmu

# Files of other versions are refused, not converted: their healthy records teach a baseline anew.
_VERSION = 6


# The kind of a run, told by what was not estimated: its inputs, and the channels recorded beside the
# model's.


@dataclass(frozen=True, eq=False)
class KindOfRun:
    """Features of a window: of every input its mean, its standard deviation and the RMS of its
    steps, of other channels the mean.

    Attributes
    ----------
    beside : tuple of str
        Channels that the model does not use.
    centre, spread : array, shape (features,)
        Over healthy windows; the spread is infinite for what never moved, which then says nothing.
    """

    beside: tuple[str, ...]
    centre: FloatArray
    spread: FloatArray

    @classmethod
    def of(cls, windows: Sequence[Experiment]) -> KindOfRun:
        """Learned from healthy windows."""
        beside = tuple(name for name in windows[0].spare if all(name in e.spare for e in windows))
        F = np.array([_raw(e, beside) for e in windows])
        # what hardly moves from run to run would else be divided by its noise
        spread = np.maximum(F.std(axis=0), STILL * np.max(np.abs(F), axis=0, initial=0.0))
        return cls(beside, F.mean(axis=0), np.where(spread > 0.0, spread, np.inf))

    def features(self, e: Experiment) -> FloatArray:
        """1 and the features in healthy spreads, shape (1 + features,); usual (0) for a channel
        that was not recorded.
        """
        return np.concatenate(
            [[1.0], np.nan_to_num((_raw(e, self.beside) - self.centre) / self.spread)]
        )


def _raw(e: Experiment, beside: Sequence[str]) -> FloatArray:
    means = [float(e.spare[name].values.mean()) if name in e.spare else np.nan for name in beside]
    return np.concatenate(
        [
            e.U.mean(axis=0),
            e.U.std(axis=0),
            np.sqrt(np.mean(np.diff(e.U, axis=0) ** 2, axis=0)),
            means,
        ]
    )


@dataclass(frozen=True, eq=False)
class Usual:
    """What a hypothesis shows in healthy windows: its mean gain [nat], and its sizes there, shape
    (windows, sizes).
    """

    gain: float
    sizes: FloatArray

    @property
    def variance(self) -> FloatArray | float:
        """Variance of its sizes from window to window, shape (sizes,); 0 where too few are known."""
        return self.sizes.var(axis=0, ddof=1) if len(self.sizes) > 2 else 0.0


@dataclass(frozen=True, eq=False)
class Baseline:
    """A trained model-based diagnoser.

    Attributes
    ----------
    asked : PhysicalModel
        The user's.
    model : PhysicalModel
        With its healthy values and the effects `mended` (labels) that every healthy window lacks
        beside it.
    kind : KindOfRun
    values, errors, offsets : Scatter
        Of the free values, of the logarithms of error power, and of the offset that each output
        seems to have.
    usual : mapping of hypothesis to Usual
    information : array, shape (values,)
        Least of a healthy window on each value.
    typical : array, shape (values,)
        Its median.
    input_spans, spans : array
        Smallest span of each input and output.
    apart : tuple of int
        Healthy windows that stand apart from the others.
    doubted : tuple of HeldValue
        Values that the user's model holds, each of which explains as much as the effects `mended`.
    """

    asked: PhysicalModel
    model: PhysicalModel
    mended: tuple[str, ...]
    kind: KindOfRun
    whitening: Whitening
    values: Scatter
    errors: Scatter
    offsets: Scatter
    usual: Mapping[str, Usual]
    information: FloatArray
    typical: FloatArray
    input_spans: FloatArray
    spans: FloatArray
    measured: npt.NDArray[np.bool_]
    hold: FloatArray
    sample_time: float
    seconds: float
    windows: int
    apart: tuple[int, ...]
    sources: Sequence[str]
    doubted: tuple[HeldValue, ...] = ()

    @property
    def free(self) -> tuple[str, ...]:
        """Values that windows are asked for."""
        return tuple(self.model.free)

    @cached_property
    def hypotheses(self) -> list[Hypothesis]:
        """What may happen to the machine; values that healthy windows left open may change, too."""
        return hypotheses(
            self.model, [*self.free, *(name for name in self.asked.free if name not in self.free)]
        )

    @property
    def stand_ins(self) -> tuple[EffectUse, ...]:
        """Effects that the user's model lacks."""
        return tuple(use for use in self.model.effects if use.label in self.mended)

    def fitter(self, window: Experiment, features: FloatArray) -> WindowFitter:
        """The fitter of a window: healthy values and size of errors as the window's features lead
        to expect.
        """
        (mean, covariance), log = self.values.at(features), self.errors.at(features)[0]
        known = self.model.all_parameters
        # far from the runs seen the mean may leave what a value can be
        mean = np.clip(
            mean, [known[n].lower for n in self.free], [known[n].upper for n in self.free]
        )
        # errors are as large as is usual for such a run: the second half of the logarithms is of
        # whitened errors
        whitening = replace(
            self.whitening, sigma=self.whitening.sigma * np.exp(log[len(log) // 2 :])
        )
        model = self.model.with_values(dict(zip(self.free, mean.tolist(), strict=True)))
        return WindowFitter(model, window, mean, covariance, whitening, self.values.freedom)

    def error_excess(self, features: FloatArray, fit: Fit) -> FloatArray:
        """How far error power lies above the usual [standard deviations], of errors as they are and
        whitened, (2 · outputs,).
        """
        log, covariance = self.errors.at(features)
        measured = np.tile(self.measured, 2)
        return np.where(measured, (log_power(fit) - log) / np.sqrt(np.diag(covariance)), 0.0)

    def offsets_in(
        self, fitter: WindowFitter, healthy: Fit | None
    ) -> tuple[FloatArray, FloatArray]:
        """The offset of each output that explains a window best beside values in their healthy
        scatter, and its information. Each has shape (outputs,). Begun where the healthy model's fit
        ended.
        """
        offsets, offset_info = np.zeros((2, len(self.model.outputs)))
        for o in np.flatnonzero(self.measured):
            moved = Variant(
                self.model, sizes=(0.0,), lower=(-np.inf,), reading=edited(int(o), shifted)
            )
            fit = fitter.fit(moved, FIT_STEPS, beside=healthy)
            if fit is not None:
                offsets[o], offset_info[o] = fit.own[0], information_on_size(fit, fitter.covariance)
        return offsets, offset_info

    def usual_gain(self, hypothesis: Hypothesis) -> float:
        """[nat] Mean gain of a hypothesis in healthy windows."""
        known = self.usual.get(hypothesis.label)
        return known.gain if known else 0.0

    def smallest_visible(self, level: float) -> dict[str, float]:
        """The least change of each value that one usual window shows with probability 0.9, at this
        chance of a false alarm; infinite where it shows none.
        """
        if not self.free:
            return {}
        # beyond the smallest normal number: what a window tells of a value that it does not tell
        with np.errstate(divide="ignore"):
            unknown = np.where(self.typical > 1e-300, 1.0 / self.typical, np.inf)
        std = np.sqrt(np.diag(self.values.S) + unknown)
        reach = stats.t.isf(
            min(0.5, level / (6.0 * len(self.free))), self.values.freedom
        ) + stats.norm.ppf(VISIBLE_POWER)
        return dict(zip(self.free, (reach * std).tolist(), strict=True))

    def save(self, path: str | Path, kind: str, settings: Mapping[str, Any]) -> None:
        """Store the baseline and a diagnoser's settings in a file."""
        model, asked, fmu = _stored_models(self.model, self.asked)
        meta = {
            "model": model,
            "asked": asked,
            "fmu": None if fmu is None else fmu.said,
            "absent": [name for name, signal in self.model.inputs.items() if signal.absent],
            "mended": list(self.mended),
            "beside": list(self.kind.beside),
            "usual": {
                label: {"gain": u.gain, "sizes": u.sizes.tolist()}
                for label, u in self.usual.items()
            },
            "freedom": [self.values.freedom, self.errors.freedom, self.offsets.freedom],
            "sample_time": self.sample_time,
            "seconds": self.seconds,
            "windows": self.windows,
            "apart": list(self.apart),
            "sources": list(self.sources),
            "doubted": [asdict(value) for value in self.doubted],
            "settings": dict(settings),
        }
        scatters = {"values": self.values, "errors": self.errors, "offsets": self.offsets}
        arrays = {
            f"{name}_{part}": getattr(scatter, part)
            for name, scatter in scatters.items()
            for part in ("B", "S", "M")
        }
        arrays |= {
            part: getattr(self.whitening, part)
            for part in ("filters", "sigma", "inflation", "steps", "most_steps")
        }
        arrays |= {"centre": self.kind.centre, "spread": self.kind.spread}
        if fmu is not None:
            arrays[FMU] = np.frombuffer(fmu.content, dtype=np.uint8)
        own = ("information", "typical", "input_spans", "spans", "measured", "hold")
        save_stored(
            path, kind, _VERSION, meta, arrays | {name: getattr(self, name) for name in own}
        )

    @classmethod
    def load(cls, path: str | Path, kind: str) -> tuple[Baseline, dict[str, Any]]:
        """The baseline and settings that `save` stored; BadInput for another file."""
        stored = load_stored(path, kind)
        if stored.version != _VERSION:
            raise BadInput(
                f"{path}: was trained by another version of Residuum; train it again with its"
                " healthy records"
            )
        meta, arrays = stored.meta, stored.arrays
        if FMU in arrays:
            check_allowed(str(path))
        try:
            return _read(meta, arrays, str(path)), dict(meta["settings"])
        except (KeyError, TypeError, ValueError) as error:
            # what an FMU is refused for is said in its own words
            if FMU in arrays and isinstance(error, BadInput):
                raise
            raise BadInput(f"{path}: is not a model-based baseline: {error}") from None


def _read(meta: Mapping[str, Any], arrays: Mapping[str, FloatArray], source: str) -> Baseline:
    read = read_model if FMU not in arrays else _fmu_reader(meta, arrays[FMU], source)
    asked, model = (
        with_absent(read(meta[name], source), meta["absent"]) for name in ("asked", "model")
    )
    values, errors, offsets = (
        Scatter(arrays[f"{name}_B"], arrays[f"{name}_S"], arrays[f"{name}_M"], float(freedom))
        for name, freedom in zip(("values", "errors", "offsets"), meta["freedom"], strict=True)
    )
    usual = {
        label: Usual(float(u["gain"]), np.array(u["sizes"], dtype=float))
        for label, u in meta["usual"].items()
    }
    return Baseline(
        asked,
        model,
        tuple(meta["mended"]),
        KindOfRun(tuple(meta["beside"]), arrays["centre"], arrays["spread"]),
        Whitening(
            arrays["filters"],
            arrays["sigma"],
            arrays["inflation"],
            arrays["steps"],
            arrays["most_steps"],
        ),
        values,
        errors,
        offsets,
        usual,
        arrays["information"],
        arrays["typical"],
        arrays["input_spans"],
        arrays["spans"],
        arrays["measured"].astype(bool),
        arrays["hold"],
        float(meta["sample_time"]),
        float(meta["seconds"]),
        int(meta["windows"]),
        tuple(int(k) for k in meta["apart"]),
        list(meta["sources"]),
        # a baseline that was stored before such values were sought has none
        tuple(_doubted(row) for row in meta.get("doubted", ())),
    )


def _doubted(row: Mapping[str, Any]) -> HeldValue:
    """A held value as it was stored."""
    groups = {name: tuple(row[name]) for name in ("indistinguishable_from", "as_much_as")}
    return HeldValue(**{**row, **groups})


def _stored_models(
    model: PhysicalModel, asked: PhysicalModel
) -> tuple[str, str, WatchedFmu | None]:
    """Texts of both models, and the FMU that they are of."""
    if model.foreign is None:
        return write_model(model), write_model(asked), None
    # loads what compiles, for FMUs alone
    from residuum.identification.physics.fmu.watched_model import (  # noqa: PLC0415
        WatchedFmu,
        written,
    )

    return written(model), written(asked), WatchedFmu.of(model.foreign)


def _fmu_reader(
    meta: Mapping[str, Any], content: FloatArray, source: str
) -> Callable[[str, str], PhysicalModel]:
    """What makes models of their texts and the FMU that is stored beside them."""
    # loads what compiles, for FMUs alone
    from residuum.identification.physics.fmu.watched_model import WatchedFmu  # noqa: PLC0415

    return WatchedFmu.read(content.tobytes(), meta["fmu"], source).model


def wide_prior(values: FloatArray) -> FloatArray:
    """Covariance, shape (values, values), of the wide prior for values that a window is asked for by
    itself.
    """
    return np.diag((WIDE * np.maximum(np.abs(values), 1e-12)) ** 2)


def own_estimate(
    model: PhysicalModel,
    window: Experiment,
    mean: FloatArray,
    whitening: Whitening,
    begin: Fit | None = None,
) -> Fit | None:
    """The window's own values of the healthy model, all of them free; the lower of the descents
    from their mean and from a fit to begin with.
    """
    # a prior this wide that is known exactly (no Student tail): it only keeps open values finite
    fitter = WindowFitter(model, window, mean, wide_prior(mean), whitening, 1e6)
    fits = [
        fitter.fit(Variant(model), 2 * FIT_STEPS, start)
        for start in ([None] if begin is None else [None, begin])
    ]
    return min(
        (fit for fit in fits if fit is not None),
        key=lambda fit: float(np.mean(fit.power)),
        default=None,
    )


def with_absent(model: PhysicalModel, absent: Sequence[str]) -> PhysicalModel:
    """The model with these optional inputs marked as not recorded."""
    inputs = {name: replace(signal, absent=name in absent) for name, signal in model.inputs.items()}
    return replace(model, inputs=MappingProxyType(inputs))
