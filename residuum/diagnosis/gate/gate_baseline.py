"""What a trained gate-actuator diagnoser knows: limits of healthy features, classifiers, usual
travel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.model_selection import StratifiedGroupKFold
from sklearn.pipeline import Pipeline

from residuum.array_types import ComplexArray
from residuum.diagnosis.gate.actuator_model import ActuatorConstants, NotchMatch, Signal
from residuum.diagnosis.gate.movement_features import FEATURES, MovementFeatures
from residuum.diagnosis.gate.operating_events import Happened, manual_push
from residuum.diagnosis.learning.stored import load_stored, save_stored
from residuum.diagnosis.residuals.fault_isolation import (
    HEALTHY,
    PINION_OR_GEAR,
    RACK,
    UNKNOWN,
    RayDistances,
    isolation_classifier,
    source_classifier,
)
from residuum.diagnosis.thresholds.tails import UpperTail
from residuum.identification.errors import NotIdentifiable

# Gears whose healthy tooth errors are on record: what is new in a turn of one of them says more
# than the turn itself.

# places a turn at which two patterns are laid over each other: a fortieth of the finest order's
# period
_GRID = 4096
_COARSE_GRID = (
    512  # enough to choose the nearest among many: twelve places a period of the finest order
)
_SAME_TRAINED = 0.15  # share of a pattern's power that a pattern of the same gear may leave
_SAME = 0.3  # the same when a notch may have come
_CANDIDATES = 2
_ROUNDS = 3  # of laying over and taking the notch out


@dataclass(frozen=True)
class KnownTurn:
    """A turn explained by a known gear: its match with a *new* notch, and the share of its power
    that stays unexplained.
    """

    match: float
    unexplained: float


@dataclass(frozen=True, eq=False)
class KnownGears:
    r"""Healthy patterns by which a gear is recognised, and what has come since.

    Tooth errors are fixed in a gear, so its turns repeat within 1 % of their power while those of
    two gears share at most 45 %. A turn X is compared with each known pattern R, turned by ψ and
    scaled by a (wear), and one notch g:

    .. math:: \min_{R, a, \psi, g} \sum_k |X_k - a R_k e^{-j k \psi} - g_k|^2 / P_k

    P_k is the power of healthy tooth errors (`NotchMatch`). When less than 30 % stays unexplained
    it is that gear, and the matched filter looks at X − a R e^{−jkψ} alone: 1.2 at most in a
    healthy gear, six and more with a notch of 0.8.

    Fails for a notch that was there when the pattern was learned: it counts as part of the gear.

    Attributes
    ----------
    patterns : array, shape (n_patterns, gear_teeth − 1), complex
        R_k of the orders 1 … gear_teeth − 1; opening and closing give one each.
    movements : array, shape (n_patterns,)
        Healthy movements behind each.
    """

    patterns: ComplexArray
    movements: npt.NDArray[np.int64]

    @classmethod
    def of(cls, typical_turns: Sequence[Signal], notch: NotchMatch) -> KnownGears:
        """Group healthy typical turns, each of shape (POINTS,), by gear: a turn joins the pattern
        that explains it.
        """
        patterns: list[ComplexArray] = []
        movements: list[int] = []
        for turn in typical_turns:
            X = notch.spectrum(turn)
            laid = _laid_over(np.array(patterns), X, notch.power) if patterns else None
            nearest = int(np.argmin(laid.left)) if laid is not None else 0
            if laid is None or laid.left[nearest] > _SAME_TRAINED:
                patterns.append(X)
                movements.append(1)
            else:
                n, back = movements[nearest], np.exp(1j * notch.orders * laid.angle[nearest])
                patterns[nearest] = (n * patterns[nearest] + X * back) / (n + 1)
                movements[nearest] = n + 1
        return cls(
            np.array(patterns).reshape(len(patterns), len(notch.orders)),
            np.array(movements, dtype=np.int64),
        )

    def joined(self, added: KnownGears) -> KnownGears:
        """These patterns and the others'."""
        return KnownGears(
            np.vstack([self.patterns, added.patterns]), np.append(self.movements, added.movements)
        )

    def recognise(
        self, typical_turn: Signal, notch: NotchMatch, motor_speed: float, time_constant: float
    ) -> KnownTurn | None:
        """The known gear that explains the turn best, or None; ω_M [rad/s], T [s]."""
        if len(self.patterns) == 0:
            return None
        X = notch.spectrum(typical_turn)
        nearest = np.argsort(_laid_over(self.patterns, X, notch.power, _COARSE_GRID).left)[
            :_CANDIDATES
        ]
        candidates = [
            _explained(self.patterns[k], X, notch, motor_speed, time_constant) for k in nearest
        ]
        best = min(candidates, key=lambda known: known.unexplained)
        return best if best.unexplained < _SAME else None


def _explained(
    R: ComplexArray, X: ComplexArray, notch: NotchMatch, motor_speed: float, T: float
) -> KnownTurn:
    """Lay R over X and take the largest notch out of what is left, a few times over."""
    bump, match, new = np.zeros_like(X), 0.0, X
    for _ in range(_ROUNDS):
        laid = _laid_over(R[None], X - bump, notch.power)
        new = X - laid.scale[0] * R * np.exp(-1j * notch.orders * laid.angle[0])
        match, bump = notch.largest_bump(new, motor_speed, T)
    return KnownTurn(match, _power(new - bump, notch.power) / _power(X, notch.power))


@dataclass(frozen=True, eq=False)
class _LaidOver:
    """For each pattern: the angle and scale that bring it nearest to X, and the share of X's power
    that it leaves.
    """

    angle: Signal
    scale: Signal
    left: Signal


def _laid_over(R: ComplexArray, X: ComplexArray, power: Signal, grid: int = _GRID) -> _LaidOver:
    correlation = np.zeros((len(R), grid), dtype=complex)
    correlation[:, 1 : len(X) + 1] = X * np.conj(R) / power
    overlap = grid * np.real(np.fft.ifft(correlation))
    best = np.argmax(overlap, axis=1)
    own = np.sum(np.abs(R) ** 2 / power, axis=1)
    reached = overlap[np.arange(len(R)), best]
    return _LaidOver(
        2.0 * np.pi * best / grid, reached / own, 1.0 - reached**2 / (own * _power(X, power))
    )


def _power(X: ComplexArray, power: Signal) -> float:
    return float(np.sum(np.abs(X) ** 2 / power)) + np.finfo(float).tiny


# Which fault a movement shows: class probabilities, and `unknown` for what fits no class.

_OUTSIDE = (
    1.5  # times the distance of the furthest held-out movement of a class is outside that class
)
_FOLDS = 5
_FEWEST = 3  # movements a class


@dataclass(frozen=True)
class Isolation:
    """How probable any fault is, and each class's probability and distance."""

    fault_probability: float
    probabilities: Mapping[str, float]
    distances: Mapping[str, float]
    fits_none: bool


@dataclass(frozen=True)
class MovementClassifier:
    """Logistic regression on log-features with an open set of classes.

    A movement fits none when it is half as far again from every class as the furthest held-out
    movement of that class; held out means of exemplars that were not trained, when `groups` name
    the exemplars.

    Attributes
    ----------
    pipeline : Pipeline
        Gives P(class | features).
    rays : RayDistances
    distance_limits : mapping of class to float
    """

    pipeline: Pipeline
    rays: RayDistances
    distance_limits: Mapping[str, float]

    @classmethod
    def fit(cls, X: Matrix, y: Sequence[str], groups: Sequence[object]) -> MovementClassifier:
        """Train on log-features X (n, n_features), classes y, and the exemplar (or any group) of
        each movement.
        """
        labels = np.asarray(y)
        _refuse_few(labels)
        folds = list(_folds(labels, groups).split(X, labels, groups))
        own = _held_out_distances(X, labels, folds)
        limits = {
            str(label): _OUTSIDE * float(np.max(own[labels == label]))
            for label in np.unique(labels)
        }
        return cls(
            isolation_classifier().fit(X, labels),
            RayDistances(origin=HEALTHY).fit(X, labels),
            limits,
        )

    def isolate(self, x: Matrix) -> Isolation:
        """Isolate the fault in the log-features of one movement, shape (n_features,)."""
        classes = [str(label) for label in self.rays.classes_]
        distances = dict(zip(classes, map(float, self.rays.transform(x[None])[0]), strict=True))
        probabilities = dict(
            zip(classes, map(float, self.pipeline.predict_proba(x[None])[0]), strict=True)
        )
        fits_none = all(distances[label] > limit for label, limit in self.distance_limits.items())
        return Isolation(1.0 - probabilities[HEALTHY], probabilities, distances, fits_none)


def _held_out_distances(
    X: Matrix, labels: npt.NDArray[Any], folds: Sequence[tuple[Matrix, Matrix]]
) -> Matrix:
    """Distance of each movement to its own class when that class was learned without it, shape
    (n,).
    """
    own = np.empty(len(labels))
    for train, test in folds:
        rays = RayDistances(origin=HEALTHY).fit(X[train], labels[train])
        own[test] = rays.transform(X[test])[
            np.arange(len(test)), np.searchsorted(rays.classes_, labels[test])
        ]
    return own


def _refuse_few(labels: npt.NDArray[Any]) -> None:
    for label in sorted({HEALTHY, *map(str, labels)}):
        count = int(np.count_nonzero(labels == label))
        if count < _FEWEST:
            raise NotIdentifiable(
                f"class {label!r} has {count} movements to train on; at least {_FEWEST} are needed"
            )


def _folds(labels: npt.NDArray[Any], groups: Sequence[object]) -> StratifiedGroupKFold:
    """As many folds as every class has groups, at most five."""
    counts = [
        len({group for group, label in zip(groups, labels, strict=True) if label == kind})
        for kind in set(labels)
    ]
    return StratifiedGroupKFold(max(2, min(_FOLDS, *counts)))


Matrix = npt.NDArray[np.float64]
_VERSION = 4
_LEAST_CHANGE = 1.3
_LEAST_PUSHED_SPEED = 0.0075
GEAR, PINION = "gear", "pinion"
NOTCH = "notch_match"
_OF_EVERY_TURN = (NOTCH, "high_crest", "periodic_pulse")
_OF_CONTACT_LOSS = _FIXED_IN_A_GEAR = ("high_crest", "periodic_pulse")
# Chosen on 1500 healthy gears and some with default faults, none of them in
# benchmarks/results/gate_actuator.md: by their exponential tails 3 in 100 000 healthy movements
# pass each of these limits, and 1 in 10 000 gears looks like a notch. The largest of the 1500 were
# 5.0, 17.9 and 7.6; a missing pinion tooth has a periodic pulse of 50 and more, a missing rack
# tooth a single one of 17 and more, so that strict limits cost nothing.
# if the tails were normal
FALSE_ALARM_RATES = {"high_crest": 1e-6, "periodic_pulse": 1e-6, "single_pulse": 1e-6}
# Tooth errors are fixed in a gear: one whose errors look like a notch alarms at every movement. So
# gears were drawn, and what few trained gears leave open raises a limit by √(1 + c/gears): c is the
# first number for a notch's match, whose power spectrum all orders share, and the second for the
# distance of a peak from its median.
LEAST_NOTCH_LIMIT = 5.45
_FEW_GEARS_MATCH, _FEW_GEARS_PEAK = 1.7, 17.0
_NOTCH_MARGIN = (
    1.1  # over the largest healthy match in training, for teeth that are not as random as assumed
)
# A known gear's match with a new notch stays below 1.2 while healthy, 2.2 half worn; a notch of 0.4
# reaches it.
NEW_NOTCH_LIMIT = 3.0
_PUSH_RATE = 5e-4


@dataclass(frozen=True)
class Judgement:
    """What is said of one movement; `fault_class` None is healthy.

    `isolation` is None when only healthy movements were trained. `likely_part` is a hint within
    pinion-or-gear: a tooth that is gone loses contact and excites orders above the pinion's mesh, a
    notch that spreads two teeth does not.
    """

    fault_class: str | None
    isolation: Isolation | None
    likely_part: str | None = None


@dataclass(frozen=True)
class SourceJudgement:
    """The class of the linear support vector machine on F₁ and F₂ (None: healthy), and its decision
    function.
    """

    fault_class: str | None
    decision: Matrix


@dataclass(frozen=True)
class TrainingMovement:
    """Features of one movement to train on, its class, its exemplar and its travel (motor angle
    [rad]).
    """

    features: MovementFeatures
    label: str
    exemplar: object
    travel: float


@dataclass(frozen=True)
class GateBaseline:
    """Everything learned from training movements.

    `features` and `slow` hold the healthy features and the healthy slow residual; `classifier` and
    `source` are None when only healthy movements were given. `notch` holds the pattern of healthy
    teeth, `notch_limit` the upper limit of its match with a notch for a gear never seen, `gears`
    the healthy patterns of those seen, `exemplars` how many actuators were healthy.
    `shortest_travel` [rad] and `rate` [Hz].
    """

    constants: ActuatorConstants
    rate: float
    shortest_travel: float
    features: UpperTail
    slow: UpperTail
    notch: NotchMatch
    notch_limit: float
    classifier: MovementClassifier | None
    source: Pipeline | None
    gears: KnownGears
    exemplars: int

    @classmethod
    def of(
        cls, movements: Sequence[TrainingMovement], constants: ActuatorConstants, rate: float
    ) -> GateBaseline:
        """Learn from movements; NotIdentifiable when a class has fewer than three."""
        taught = [movement for movement in movements if movement.label == HEALTHY]
        healthy = [movement.features for movement in taught]
        if len(healthy) < 3:
            raise NotIdentifiable(
                f"gate-actuator: {len(healthy)} healthy movements to train on; at least 3 are"
                " needed"
            )
        classifier, source = _trained_classifiers(movements)
        turns = [features.pattern.typical for features in healthy]
        notch = NotchMatch.of(turns, constants.gear_teeth)
        return cls(
            constants,
            rate,
            min(movement.travel for movement in movements),
            UpperTail.of([features.vector() for features in healthy]),
            UpperTail.of(np.log([features.slow_residual for features in healthy])),
            notch,
            _notch_limit(taught, constants.gear_teeth),
            classifier,
            source,
            KnownGears.of(turns, notch),
            len({movement.exemplar for movement in taught}),
        )

    def after(self, before: GateBaseline) -> GateBaseline:
        """This baseline of one gate with what only many gates teach, from the baseline it had
        before: classes, tooth errors.
        """
        gears = before.gears.joined(self.gears)
        return replace(
            self,
            notch=before.notch,
            notch_limit=before.notch_limit,
            classifier=before.classifier,
            source=before.source,
            gears=gears,
        )

    def known(self, features: MovementFeatures) -> KnownTurn | None:
        """The turn as a known gear explains it, or None for a gear never seen."""
        return self.gears.recognise(
            features.pattern.typical, self.notch, features.motor_speed, features.model.time_constant
        )

    def feature_limits(self, known: KnownTurn | None = None) -> dict[str, float]:
        """Upper limit of each judged feature."""
        limits = {NOTCH: self.notch_limit if known is None else NEW_NOTCH_LIMIT}
        for name, rate in FALSE_ALARM_RATES.items():
            k = FEATURES.index(name)
            centre = float(self.features.centre[k])
            reach = float(self.features.limit(rate)[k]) - centre
            if name in _FIXED_IN_A_GEAR:
                reach *= np.sqrt(1.0 + _FEW_GEARS_PEAK / self.exemplars)
            limits[name] = float(np.exp(centre + max(reach, np.log(_LEAST_CHANGE))))
        return limits

    def indicators(
        self, features: MovementFeatures, known: KnownTurn | None = None
    ) -> dict[str, float]:
        """The features, and the match with a notch: of the typical turn, or of what is new in that
        of a known gear.
        """
        return features.values | {
            NOTCH: _match(self.notch, features) if known is None else known.match
        }

    def pushed(self, features: MovementFeatures) -> Happened | None:
        """The event when somebody pushed the gate, or None.

        The limit of the slow residual is never below 0.75 % of the motor speed. A missing pinion
        tooth disturbs the slow residual too, but comes once a turn, which no hand does.
        """
        limit = max(
            float(np.exp(self.slow.limit(_PUSH_RATE))), _LEAST_PUSHED_SPEED * features.motor_speed
        )
        once_a_turn = features.values["periodic_pulse"] > self.feature_limits()["periodic_pulse"]
        return None if once_a_turn else manual_push(features.slow_residual, limit)

    def judge(self, features: MovementFeatures) -> Judgement:
        """Detect by the healthy limits; the one that is passed names the class by physics.

        What comes once a turn is pinion or gear, whatever else it disturbs; a pulse at one place
        alone is the rack. What fits no trained class is `unknown`, an alarm of its own. The
        classifier's probabilities do not alarm: of 4000 healthy movements of exemplars never
        trained 2 % had odds above three to one.
        """
        beyond = self._beyond(features)
        isolation = None if self.classifier is None else self.classifier.isolate(features.vector())
        if isolation is not None and isolation.fits_none:
            return Judgement(UNKNOWN, isolation)
        if max(beyond[name] for name in _OF_EVERY_TURN) > 1.0:
            part = PINION if max(beyond[name] for name in _OF_CONTACT_LOSS) > 1.0 else GEAR
            return Judgement(PINION_OR_GEAR, isolation, part)
        if max(beyond.values()) > 1.0:
            return Judgement(RACK, isolation)
        return Judgement(None, isolation)

    def judge_by_source(self, features: MovementFeatures) -> SourceJudgement | None:
        """What the source's classifier says of F₁ and F₂; None when only healthy movements were
        trained.
        """
        if self.source is None:
            return None
        point = features.source_vector()[None]
        predicted = str(self.source.predict(point)[0])
        return SourceJudgement(
            None if predicted == HEALTHY else predicted,
            np.ravel(self.source.decision_function(point)),
        )

    def _beyond(self, features: MovementFeatures) -> dict[str, float]:
        """Each judged feature as a multiple of its limit."""
        known = self.known(features)
        shown = self.indicators(features, known)
        return {name: shown[name] / limit for name, limit in self.feature_limits(known).items()}

    def save(self, path: str | Path, kind: str, method: str = "default") -> None:
        """Store as `kind`, with the method that decides."""
        meta: dict[str, Any] = {
            "constants": asdict(self.constants),
            "rate": self.rate,
            "shortest_travel": self.shortest_travel,
            "healthy": self.features.n,
            "notch_limit": self.notch_limit,
            "exemplars": self.exemplars,
            "method": method,
        }
        arrays: dict[str, npt.ArrayLike] = {
            "centre": self.features.centre,
            "scatter": self.features.scatter,
            "slow": [self.slow.centre, self.slow.scatter],
            "notch_power": self.notch.power,
            "gears_real": self.gears.patterns.real,
            "gears_imaginary": self.gears.patterns.imag,
            "gears_movements": self.gears.movements,
        }
        estimators: dict[str, Any] = {}
        if self.classifier is not None and self.source is not None:
            rays = self.classifier.rays
            meta["classes"] = [str(label) for label in rays.classes_]
            meta["distance_limits"] = dict(self.classifier.distance_limits)
            arrays |= {"ray_means": rays.means_, "ray_precision": rays.precision_}
            estimators = {"isolation": self.classifier.pipeline, "source": self.source}
        save_stored(path, kind, _VERSION, meta, arrays, estimators)

    @classmethod
    def load(cls, path: str | Path, kind: str) -> tuple[GateBaseline, str]:
        """What `save` stored, and the method that decides; BadInput when the file is another."""
        stored = load_stored(path, kind)
        meta, arrays, n = stored.meta, stored.arrays, int(stored.meta["healthy"])
        classifier = source = None
        if "classes" in meta:
            rays = RayDistances.of(
                np.array(meta["classes"]), arrays["ray_means"], arrays["ray_precision"], HEALTHY
            )
            classifier = MovementClassifier(
                stored.estimators["isolation"], rays, meta["distance_limits"]
            )
            source = stored.estimators["source"]
        loaded = cls(
            ActuatorConstants(**meta["constants"]),
            float(meta["rate"]),
            float(meta["shortest_travel"]),
            UpperTail(arrays["centre"], arrays["scatter"], n),
            UpperTail(arrays["slow"][0], arrays["slow"][1], n),
            NotchMatch(arrays["notch_power"], int(meta["constants"]["gear_teeth"])),
            float(meta["notch_limit"]),
            classifier,
            source,
            _stored_gears(arrays, len(arrays["notch_power"])),
            # a file of version 3 does not say; its limits stay nearly as they were
            int(meta.get("exemplars", n)),
        )
        return loaded, str(meta.get("method", "default"))


def _trained_classifiers(
    movements: Sequence[TrainingMovement],
) -> tuple[MovementClassifier | None, Pipeline | None]:
    """The classifier of all features and the source's of F₁ and F₂; None where all movements are
    of one class.
    """
    labels = [movement.label for movement in movements]
    if len(set(labels)) == 1:
        return None, None
    X = np.array([movement.features.vector() for movement in movements])
    exemplars = [movement.exemplar for movement in movements]
    F = np.array([movement.features.source_vector() for movement in movements])
    return MovementClassifier.fit(X, labels, exemplars), source_classifier().fit(F, labels)


def _stored_gears(arrays: Mapping[str, npt.NDArray[Any]], orders: int) -> KnownGears:
    """The known gears of a file; none in one of version 2."""
    if "gears_real" not in arrays:
        return KnownGears(np.zeros((0, orders), dtype=complex), np.zeros(0, dtype=np.int64))
    return KnownGears(
        arrays["gears_real"] + 1j * arrays["gears_imaginary"], arrays["gears_movements"]
    )


def _match(notch: NotchMatch, features: MovementFeatures) -> float:
    return notch.statistic(
        features.pattern.typical, features.motor_speed, features.model.time_constant
    )


def _notch_limit(healthy: Sequence[TrainingMovement], gear_teeth: int) -> float:
    """For a gear never seen: higher when the tooth errors were learned from few exemplars."""
    exemplars = len({movement.exemplar for movement in healthy})
    few = LEAST_NOTCH_LIMIT * float(np.sqrt(1.0 + _FEW_GEARS_MATCH / exemplars))
    return max(few, _NOTCH_MARGIN * max(_held_out_matches(healthy, gear_teeth)))


def _held_out_matches(healthy: Sequence[TrainingMovement], gear_teeth: int) -> list[float]:
    """Each healthy movement's match, by the tooth errors of the other exemplars (of all, if there
    is one alone).
    """
    matches = []
    for exemplar in {movement.exemplar for movement in healthy}:
        own = [movement.features for movement in healthy if movement.exemplar == exemplar]
        peers = [movement.features for movement in healthy if movement.exemplar != exemplar] or own
        notch = NotchMatch.of([features.pattern.typical for features in peers], gear_teeth)
        matches += [_match(notch, features) for features in own]
    return matches
