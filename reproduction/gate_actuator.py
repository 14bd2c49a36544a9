"""Fig. 78, 85–87 and Table 7: the gate actuator's criticality matrix, residual, features and classifier."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from sklearn.pipeline import Pipeline

from reproduction.check import Check, at_least, at_most, near
from reproduction.criticality import criticality
from reproduction.gate_movements import CLASSES, CONDITIONS, CONSTANTS, GRADE_9, Observed, observe
from reproduction.gate_validation import cross_validation, object_wise_validation
from reproduction.item import Item
from residuum.diagnosis.gate.actuator_model import adapt
from residuum.diagnosis.gate.classifier_plane import decision_regions
from residuum.diagnosis.gate.movement_features import (
    RATE,
    MovementFeatures,
    envelope_spectrum,
    fault_indicators,
    residual_envelope,
)
from residuum.diagnosis.gate.movements import Direction
from residuum.diagnosis.learning.diagnoser_validation import Validation
from residuum.diagnosis.residuals.fault_isolation import (
    HEALTHY,
    PINION_OR_GEAR,
    RACK,
    source_classifier,
)

EXEMPLARS, SHORT_EXEMPLARS = 10, 4
COLOURS = {HEALTHY: "#2e7d4f", PINION_OR_GEAR: "#b3541e", RACK: "#5b7fa6"}
SOURCE_TABLE = np.array([[130, 1, 2], [0, 89, 4], [1, 2, 31]])
SOURCE_ALL = 96.15  # %
TRIED = (0, 1)  # exemplars with gears of other errors
FINER, COARSER = 0.5 * GRADE_9, 1.0
NEAR, NEAR_ROW = 2.5, 10.0  # points, of all and of one row: what is called agreement
_WHOLE_BAND = (0.5, 10.0)  # Hz


def items(short: bool) -> list[Item]:
    """Fig. 78 (FMECA), 85 (model), 86 (spectra), 87 (features), Table 7, and the two validations."""
    exemplars = SHORT_EXEMPLARS if short else EXEMPLARS
    observed = [
        one
        for exemplar in range(exemplars)
        for fault in CONDITIONS
        for one in observe(exemplar, fault)
    ]
    X = np.array([one.features.source_vector() for one in observed])
    why = _why_not_the_rack(observed, X)
    return [
        criticality(),
        _evaluation(),
        _model(observed),
        _spectra(observed),
        _plane(observed, X, why),
        _trained_on_all(observed, X),
        cross_validation(observed, X),
        object_wise_validation(observed, X),
    ]


def _model(observed: Sequence[Observed]) -> Item:
    openings = [
        one.movement for one in observed if one.exemplar == 0 and one.fault is None and _opens(one)
    ]
    identified, fresh = openings[0], openings[1]
    model = adapt([identified], CONSTANTS)
    measured, simulated = (
        1e3 * CONSTANTS.tau * speed for speed in (fresh.speed, model.simulate(fresh))
    )
    error = measured - simulated
    fit = 100 * (1 - np.linalg.norm(error) / np.linalg.norm(measured - measured.mean()))
    rms = float(np.sqrt(np.mean(error**2)))
    rows = [
        ("μ [rad/(V·s)]", "T [s]", "d [s]", "fit", "RMS error [mm/s]", "largest speed [mm/s]"),
        (
            f"{model.gain:.2f}",
            f"{model.time_constant:.4f}",
            f"{model.delay:.4f}",
            f"{fit:.2f} %",
            f"{rms:.2f}",
            f"{measured.max():.1f}",
        ),
    ]
    figure = go.Figure(layout={"xaxis_title": "t [s]", "yaxis_title": "axial speed [mm/s]"})
    t = np.arange(fresh.n) * fresh.sample_time
    figure.add_scatter(x=t, y=measured, name="computed v^c", line={"width": 1})
    figure.add_scatter(x=t, y=simulated, name="simulated v̂_d", line={"width": 1})
    speed = float(np.median(fresh.speed[fresh.speed > 0.9 * fresh.speed.max()]))
    checks = [
        at_least(
            "fit on an opening that was not identified on", fit, 90.0, "%", source="good simulation"
        ),
        near("μ over the data sheet's 1/K", 1.0, model.gain / CONSTANTS.gain, 0.15),
        near("speed at constant voltage", 4100.0, speed * 60 / (2 * np.pi), 0.05, "rpm"),
        at_least(
            "input-output delay d",
            1e3 * model.delay,
            0.5,
            "ms",
            source="present, no number printed",
        ),
    ]
    source = "good simulation (no number printed), with an input-output delay"
    reason = (
        "the simulated drive has no delay but a counting window of 2 ms in its encoder and the winding's "
        "L/R; tried: the search finds "
        f"{1e3 * model.delay:.2f} ms beside T = {1e3 * model.time_constant:.1f} ms"
    )
    return Item("Fig. 85", "Axial speed, opening", source, checks, reason, rows, [figure])


def _evaluation() -> Item:
    """The residual evaluation on a tone whose amplitude swings by a known part at a known frequency."""
    t = np.arange(0.0, 20.0, 1 / RATE)
    tone = (1.0 + 0.5 * np.cos(2 * np.pi * 1.55 * t)) * np.cos(2 * np.pi * 4.0 * t) + 0.5 * np.cos(
        2 * np.pi * 40.0 * t
    )
    run = slice(round(2 * RATE), round(18 * RATE))
    spectrum = envelope_spectrum(residual_envelope(tone, 1 / RATE)[run], 1 / RATE)
    F1, F2 = fault_indicators(spectrum, 1.55)
    beat = float(np.interp(36.0, spectrum.frequency, spectrum.modulus))
    at = [np.interp(k * 1.55, spectrum.frequency, spectrum.modulus) for k in (1, 2, 3)]
    inside = sum(
        float(spectrum.modulus[np.abs(spectrum.frequency / (k * 1.55) - 1) <= 0.05].sum())
        for k in (1, 2, 3)
    )
    fine = float(spectrum.frequency[1]) * 16.0
    checks = [
        near("θ at the swing's frequency over the swing", 0.5, float(at[0]), 0.1),
        at_most(
            "θ at 36 Hz, where a tone of 40 Hz would beat", beat, 0.05, source="band-pass 0.5–10 Hz"
        ),
        near("F₁ over the sum of θ at three harmonics", 1.0, F1 / float(sum(at)), 0.01),
        near("F₂ over the sum of θ in the three neighbourhoods", 1.0, F2 / (inside * fine), 0.05),
    ]
    source = "band-pass 0.5–10 Hz, envelope, spectrum at constant speed, F₁ and F₂ of (7.6)"
    return Item("Fig. 84", "Residual, evaluation, decision", source, checks)


def _opens(one: Observed) -> bool:
    return one.movement.direction is Direction.OPENING


def _spectra(observed: Sequence[Observed]) -> Item:
    rows = [
        (
            "condition",
            "f_fault [Hz]",
            "θ(f_fault) [mm/s]",
            "θ(f_fault) / median θ, 0.5–10 Hz",
            "mean θ, 0.5–10 Hz [mm/s]",
        )
    ]
    figure = go.Figure(layout={"xaxis_title": "f [Hz]", "yaxis_title": "θ(f) [mm/s]"})
    line, level = {}, {}
    for fault in CONDITIONS:
        found = [one.features for one in observed if one.fault == fault]
        at = np.median([features.spectrum.at(features.fault_frequency) for features in found])
        line[fault] = float(np.median([_prominence(features) for features in found]))
        level[fault] = float(np.median([_in_band(features).mean() for features in found]))
        frequency = np.median([features.fault_frequency for features in found])
        rows.append(
            (
                fault or HEALTHY,
                f"{frequency:.2f}",
                f"{at:.3f}",
                f"{line[fault]:.1f}",
                f"{level[fault]:.4f}",
            )
        )
        spectrum = found[0].spectrum
        shown = spectrum.frequency <= _WHOLE_BAND[1]
        figure.add_scatter(
            x=spectrum.frequency[shown], y=spectrum.modulus[shown], name=fault or HEALTHY
        )
    visible = {fault: line[fault] / line[None] for fault in CONDITIONS if fault}
    checks = [
        near("fault frequency", 1.55, float(frequency), 0.05, "Hz"),
        at_least(
            "prominence of θ(f_fault) over healthy, gear notch",
            visible["gear-notch"],
            1.5,
            source="visible",
        ),
        at_least(
            "prominence of θ(f_fault) over healthy, pinion tooth",
            visible["pinion-tooth"],
            1.5,
            source="visible",
        ),
        at_most(
            "prominence of θ(f_fault) over healthy, rack tooth",
            visible["rack-tooth"],
            1.5,
            source="not visible",
        ),
        at_least(
            "mean θ over healthy, rack tooth",
            level["rack-tooth"] / level[None],
            1.1,
            source="a general increase",
        ),
    ]
    source = "1.55 Hz visible for gear and pinion; for the rack not, but a general increase"
    return Item(
        "Fig. 86", "Spectrum of the residual's envelope", source, checks, "", rows, [figure]
    )


def _in_band(features: MovementFeatures) -> np.ndarray:
    low, high = _WHOLE_BAND
    return features.spectrum.modulus[
        (features.spectrum.frequency >= low) & (features.spectrum.frequency <= high)
    ]


def _prominence(features: MovementFeatures) -> float:
    return features.spectrum.at(features.fault_frequency) / float(np.median(_in_band(features)))


def _plane(observed: Sequence[Observed], X: np.ndarray, why: str) -> Item:
    labels = np.array([one.label for one in observed])
    rows = [
        (
            "class",
            "movements",
            "median F₁ [mm/s]",
            "median F₂ [mm/s]",
            "fit of the linear boundaries",
        )
    ]
    estimator = source_classifier().fit(X, labels)
    hit = {
        label: float(np.mean(estimator.predict(X[labels == label]) == label)) for label in CLASSES
    }
    for label in CLASSES:
        F1, F2 = np.median(X[labels == label], axis=0)
        rows.append(
            (
                label,
                str(int((labels == label).sum())),
                f"{F1:.3f}",
                f"{F2:.3f}",
                f"{100 * hit[label]:.1f} %",
            )
        )
    checks = [
        at_least(
            f"held by the linear boundaries, {label}",
            100 * hit[label],
            80.0,
            "%",
            source="well isolated",
        )
        for label in CLASSES
    ]
    checks.append(
        near(
            "F₁ of (7.6) over the sum of θ at three harmonics",
            1.0,
            float(np.median([_F1(one) for one in observed])),
            0.05,
        )
    )
    return Item(
        "Fig. 87",
        "Plane of F₁ and F₂",
        "three classes, well isolated by linear boundaries",
        checks,
        why,
        rows,
        [_boundaries(estimator, X, labels)],
    )


def _F1(one: Observed) -> float:
    spectrum, f = one.features.spectrum, one.features.fault_frequency
    return float(
        one.features.source_vector()[0]
        / sum(np.interp(k * f, spectrum.frequency, spectrum.modulus) for k in (1, 2, 3))
    )


def _why_not_the_rack(observed: Sequence[Observed], X: np.ndarray) -> str:
    """What the rack's pulse is in the residual, what harder boundaries find of it, and boundaries in gears of other errors."""
    median = {
        fault: float(
            np.median([x[0] for x, one in zip(X, observed, strict=True) if one.fault == fault])
        )
        for fault in CONDITIONS
    }
    labels = np.array([one.label for one in observed])
    tried = "; ".join(
        f"{errors / GRADE_9:.2g} times as large {_found_with(errors)}"
        for errors in (FINER, COARSER)
    )
    return (
        f"the rack's tooth comes once a movement: median F₁ is {median['rack-tooth']:.3f} mm/s with it "
        f"missing, {median[None]:.3f} healthy, "
        f"{median['pinion-tooth']:.3f} with a pinion tooth missing. So it stands out, but near the origin of a plane that pinion "
        "and gear have scaled, where a margin as soft as C = 1 gives it away; the source does not print its C. Tried: "
        f"boundaries with C = 10 find {_found(X, labels, 10.0)}, with C = 100 {_found(X, labels, 100.0)}. Gears' own errors lie "
        "at the frequencies of F₁ and F₂; these hold ISO 1328-1 grade 9, those of the bench are not described. "
        f"Tried: with errors of {len(TRIED)} exemplars {tried}"
    )


def _found_with(tooth_errors: float) -> str:
    """What the source's classifier finds of each class in gears of other errors."""
    observed = [
        one
        for exemplar in TRIED
        for fault in CONDITIONS
        for one in observe(exemplar, fault, tooth_errors)
    ]
    X, labels = (
        np.array([one.features.source_vector() for one in observed]),
        np.array([one.label for one in observed]),
    )
    return _found(X, labels)


def _found(X: np.ndarray, labels: np.ndarray, C: float = 1.0) -> str:
    """The share of each class on its side of linear boundaries with slack of weight C."""
    predicted = source_classifier().set_params(svc__C=C).fit(X, labels).predict(X)
    return ", ".join(
        f"{label} {100 * np.mean(predicted[labels == label] == label):.0f} %" for label in CLASSES
    )


def _boundaries(estimator: Pipeline, X: np.ndarray, labels: np.ndarray) -> go.Figure:
    regions = decision_regions(estimator, X)
    codes = np.array([CLASSES.index(label) for label in regions.classes])[regions.region]
    scale = [[k / 2, COLOURS[label]] for k, label in enumerate(CLASSES)]
    figure = go.Figure(layout={"xaxis_title": "F₁ [mm/s]", "yaxis_title": "F₂ [mm/s]"})
    figure.add_heatmap(
        x=regions.x,
        y=regions.y,
        z=codes,
        colorscale=scale,
        zmin=0,
        zmax=2,
        opacity=0.25,
        showscale=False,
        hoverinfo="skip",
    )
    for label in CLASSES:
        F1, F2 = X[labels == label].T
        figure.add_scatter(x=F1, y=F2, mode="markers", name=label, marker={"color": COLOURS[label]})
    return figure


def _trained_on_all(observed: Sequence[Observed], X: np.ndarray) -> Item:
    labels = np.array([one.label for one in observed])
    validation = Validation(
        labels,
        source_classifier().fit(X, labels).predict(X),
        np.array([one.exemplar for one in observed]),
    )
    rows = [
        (
            "estimated",
            *(f"{label}: source" for label in CLASSES),
            *(f"{label}: ours" for label in CLASSES),
        )
    ]
    ours = validation.confusion(CLASSES)
    for label, source_row, row in zip(CLASSES, SOURCE_TABLE, ours, strict=True):
        rows.append((label, *map(str, source_row), *map(str, row)))
    found = [100 * table.diagonal() / table.sum(axis=0) for table in (SOURCE_TABLE, ours)]
    accuracy = 100 * validation.accuracy
    checks = [
        Check(
            "accuracy",
            f"{SOURCE_ALL} %",
            f"{accuracy:.2f} %",
            abs(accuracy - SOURCE_ALL) < NEAR,
            f"{accuracy - SOURCE_ALL:+.1f} points",
        )
    ]
    checks += [
        Check(
            f"{label} found",
            f"{source_share:.1f} %",
            f"{share:.1f} %",
            abs(share - source_share) <= NEAR_ROW,
            f"{share - source_share:+.1f} points, {NEAR_ROW:g} allowed",
        )
        for label, source_share, share in zip(CLASSES, *found, strict=True)
    ]
    source = (
        "96.15 % of 260 trained and judged on all data (the lost entry of the table restored as 1)"
    )
    reason = "what is missed is the rack, row by row in the table; cause and trials as in Fig. 87"
    return Item("Table 7", "Confusion, trained on all data", source, checks, reason, rows)
