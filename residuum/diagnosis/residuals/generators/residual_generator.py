"""Residual generator: from measured u, y to the primary, the robust and the whitened residual,
sample by sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.noise_model import NoiseModel
from residuum.diagnosis.systems import FirFilter, left_coprime
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.state_space import StateSpace

BoolArray = npt.NDArray[np.bool_]
_SETTLED = 1e-3  # of the observer's start, after which its error is called gone


class ResidualSignals(NamedTuple):
    """What the generator makes of a block, every array of shape (n,).

    `valid` is False while a memory fills (after the start and after a gap); the other arrays are
    zero there.
    """

    # e = M y − N u [output unit]
    primary: FloatArray
    # r = Q e
    robust: FloatArray
    # whitened e as normal scores: independent standard normals while healthy
    scores: FloatArray
    # whitened N u: what a gain that is lost by 100 % takes away from the scores
    gain_template: FloatArray
    # whitened u in units of the scores: the regressor of the model error
    white_input: FloatArray
    valid: BoolArray


@dataclass(frozen=True, eq=False)
class ResidualGenerator:
    """The filters (1.49) r = Q (M y − N u) of one input and one output, in implementation form.

    Parameters
    ----------
    taps : array, shape (m,), or None
        Impulse response of N from lag 0 (a stable model: M = 1); None = the observer is used.
    observer : StateSpace or None
        [M, −N] with inputs [y; u] (an unstable or long-memory model).
    Q : StateSpace
        Post-filter.
    noise : NoiseModel
        Of the healthy primary residual.
    input_mean, output_mean : float
        Operating point, taken off u and y before everything else.
    sample_time : float
        Sample time [s].
    """

    taps: FloatArray | None
    observer: StateSpace | None
    Q: StateSpace
    noise: NoiseModel
    sample_time: float
    input_mean: float = 0.0
    output_mean: float = 0.0

    def __post_init__(self) -> None:
        if (self.taps is None) == (self.observer is None):
            raise BadInput("ResidualGenerator: needs either taps or an observer")
        if not self.Q.is_stable or (self.observer is not None and not self.observer.is_stable):
            raise BadInput("ResidualGenerator: Q and the observer must be stable")

    @property
    def warm_up(self) -> int:
        """Samples after a start or a gap that are not judged: the memory of model and whitening
        filter.
        """
        return self._memory + len(self.noise.ar) - 1

    @property
    def _memory(self) -> int:
        if self.taps is not None:
            return len(self.taps) - 1
        poles = self.observer.poles if self.observer is not None else np.zeros(0)
        slowest = float(np.max(np.abs(poles), initial=0.0))
        return int(np.ceil(np.log(_SETTLED) / np.log(slowest))) if slowest > 0 else 1

    def stream(self) -> ResidualStream:
        """A fresh recursion from rest."""
        return ResidualStream(self)

    def run(self, u: npt.ArrayLike, y: npt.ArrayLike) -> ResidualSignals:
        """All of a record at once: exactly what a stream gives block by block."""
        return self.stream().process(u, y)


def generator_of(
    model: IdentifiedModel, Q: StateSpace, noise: NoiseModel, operating_point: tuple[float, float]
) -> ResidualGenerator:
    """The generator of an identified model: its impulse response where it has died out, an observer
    where it has not.
    """
    input_mean, output_mean = operating_point
    if model.is_parametric and not _has_died_out(model):
        factors = left_coprime(StateSpace.from_transfer_function(model.transfer_function()))
        return ResidualGenerator(
            None, factors.observer.modal, Q.modal, noise, model.sample_time, input_mean, output_mean
        )
    return ResidualGenerator(
        model_taps(model), None, Q.modal, noise, model.sample_time, input_mean, output_mean
    )


def model_taps(model: IdentifiedModel) -> FloatArray:
    """Impulse response from lag 0, shape (delay + m,)."""
    return np.concatenate([np.zeros(model.delay), model.impulse_response])


def _has_died_out(model: IdentifiedModel) -> bool:
    g = model.impulse_response
    return bool(
        model.transfer_function().is_stable
        and np.linalg.norm(g[-len(g) // 10 :]) < 1e-3 * np.linalg.norm(g)
    )


class ResidualStream:
    """The running recursion of a generator; `state` saves it and `resume` continues it without a
    jump.
    """

    def __init__(self, generator: ResidualGenerator) -> None:
        self.generator = generator
        noise = generator.noise
        ar = noise.ar / noise.sigma
        self._model = FirFilter(generator.taps) if generator.taps is not None else None
        self._whiteners = {
            "residual": FirFilter(ar),
            "template": FirFilter(ar),
            "input": FirFilter(ar * noise.score_slope),
        }
        self._states: dict[str, FloatArray] = {}
        self.seen = 0
        self.gaps = 0
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next `warm_up` samples fill the memory."""
        observer = self.generator.observer
        order = observer.order if observer is not None else 0
        self._states = {
            "Q": np.zeros(self.generator.Q.order),
            "observer": np.zeros(order),
            "prediction": np.zeros(order),
        }
        for filter in (*self._whiteners.values(), *([self._model] if self._model else [])):
            filter.reset()
        self.seen = 0

    def process(self, u: npt.ArrayLike, y: npt.ArrayLike) -> ResidualSignals:
        """Residuals of the next block, u and y of shape (n,); a missing sample (NaN) re-initialises
        the recursion.

        Raises
        ------
        BadInput
            u and y differ in length.
        """
        u, y = np.atleast_1d(np.asarray(u, dtype=float)), np.atleast_1d(np.asarray(y, dtype=float))
        if u.shape != y.shape or u.ndim != 1:
            raise BadInput(
                f"residual stream: u has shape {u.shape}, y {y.shape}; both must be (n,)"
            )
        missing = np.isnan(u) | np.isnan(y)
        if not missing.any():
            return self._advance(u, y)
        # stretches with and without missing samples in turn
        parts = []
        edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(int)))
        cuts = [0, *edges.tolist(), len(u)]
        for start, stop in pairwise(cuts):
            if start == stop:
                continue
            if missing[start]:
                self.gaps += 1
                self.reset()
                parts.append(_nothing(stop - start))
            else:
                parts.append(self._advance(u[start:stop], y[start:stop]))
        return ResidualSignals(*(np.concatenate(signals) for signals in zip(*parts, strict=True)))

    def _advance(self, u: FloatArray, y: FloatArray) -> ResidualSignals:
        generator = self.generator
        du, dy = u - generator.input_mean, y - generator.output_mean
        primary, prediction = self._primary(du, dy)
        index = self.seen + np.arange(len(u))
        self.seen += len(u)
        # until the memory is full the model's output lacks its past: zero, so that neither Q nor
        # the whitening filters ring on from it
        started = index >= generator._memory
        primary = np.where(started, primary, 0.0)
        prediction = np.where(started, prediction, 0.0)
        robust, self._states["Q"] = generator.Q.simulate(primary[:, None], self._states["Q"])
        white = self._whiteners["residual"].process(primary)
        valid = index >= generator.warm_up
        return ResidualSignals(
            primary,
            robust[:, 0],
            np.where(valid, generator.noise.normal_scores(white), 0.0),
            np.where(valid, self._whiteners["template"].process(prediction), 0.0),
            self._whiteners["input"].process(du),
            valid,
        )

    def _primary(self, u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """M y − N u and N u."""
        if self._model is not None:
            prediction = self._model.process(u)
            return y - prediction, prediction
        observer = self.generator.observer
        if observer is None:
            raise BadInput("residual stream: the generator has neither taps nor an observer")
        # the observer is linear in [y; u]: once more with y = 0, it gives −N u
        primary, self._states["observer"] = observer.simulate(
            np.column_stack([y, u]), self._states["observer"]
        )
        alone, self._states["prediction"] = observer.simulate(
            np.column_stack([np.zeros_like(u), u]), self._states["prediction"]
        )
        return primary[:, 0], -alone[:, 0]

    @property
    def state(self) -> dict[str, Any]:
        """Everything the recursion remembers, as arrays and numbers."""
        filters = {
            f"whitener-{name}": filter.history.copy() for name, filter in self._whiteners.items()
        }
        model = {"model": self._model.history.copy()} if self._model is not None else {}
        return {
            **filters,
            **model,
            **{name: x.copy() for name, x in self._states.items()},
            "seen": self.seen,
            "gaps": self.gaps,
        }

    def resume(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`; BadInput when it is of another generator."""
        mine = self.state
        if mine.keys() != state.keys() or any(
            np.shape(mine[name]) != np.shape(state[name]) for name in mine
        ):
            raise BadInput(
                "residual stream: the saved state is of another design; start anew without it"
            )
        for name, filter in self._whiteners.items():
            filter.history = np.array(state[f"whitener-{name}"], dtype=float)
        if self._model is not None:
            self._model.history = np.array(state["model"], dtype=float)
        self._states = {name: np.array(state[name], dtype=float) for name in self._states}
        self.seen, self.gaps = int(state["seen"]), int(state["gaps"])


def _nothing(n: int) -> ResidualSignals:
    zero = np.zeros(n)
    return ResidualSignals(zero, zero, zero, zero, zero, np.zeros(n, dtype=bool))
