"""Residual evaluation, shaft patterns, validation by objects, FMECA."""

import numpy as np
import pytest
from sklearn.neighbors import KNeighborsClassifier

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.gate.actuator_model import NotchMatch
from residuum.diagnosis.gate.classifier_plane import decision_regions
from residuum.diagnosis.gate.fmeca import Risk, coverage, criticality_matrix, load_fmeca
from residuum.diagnosis.gate.gate_baseline import LEAST_NOTCH_LIMIT, NEW_NOTCH_LIMIT, KnownGears
from residuum.diagnosis.gate.movement_features import (
    envelope_spectrum,
    fault_indicators,
    residual_envelope,
)
from residuum.diagnosis.learning.diagnoser_validation import (
    Validation,
    mixed_folds,
    object_wise,
    proportion_interval,
)
from residuum.diagnosis.residuals.fault_isolation import source_classifier
from residuum.diagnosis.thresholds.tails import UpperTail
from residuum.diagnosis.vibration.rotation import shaft_pattern
from residuum.diagnosis.vibration.vibration_indicators import (
    autoregressive_whitener,
    matched_filter,
    pulse_templates,
)
from residuum.identification.errors import BadInput


def test_indicators_sum_the_harmonics_that_modulate_the_residual():
    t = np.arange(0, 20, 0.002)
    f = 1.55
    modulation = 1 + 0.5 * np.cos(2 * np.pi * f * t)
    envelope = residual_envelope(modulation * np.sin(2 * np.pi * 4.0 * t), 0.002)
    F1, F2 = fault_indicators(envelope_spectrum(envelope[1000:-1000], 0.002), f)
    assert pytest.approx(0.5, abs=0.05) == F1
    assert F2 > F1
    steady, _ = fault_indicators(
        envelope_spectrum(residual_envelope(np.sin(2 * np.pi * 6 * t), 0.002)[1000:-1000], 0.002), f
    )
    assert steady < 0.02


def test_zero_padding_does_not_change_the_area_of_a_neighbourhood():
    rng = np.random.default_rng(1)
    spectra = [envelope_spectrum(rng.standard_normal(n), 0.01) for n in (4000, 4099)]
    areas = [
        np.mean([s.around(f, 0.2) / (0.4 * f / s.resolution) for f in np.arange(2, 40)])
        for s in spectra
    ]
    levels = [np.mean(s.modulus) for s in spectra]
    np.testing.assert_allclose(areas, levels, rtol=0.05)


def test_orders_do_not_smear_when_the_speed_changes():
    t = np.arange(0, 10, 0.002)
    turns = 1.0 * t + 0.05 * t**2
    orders = shaft_pattern(2.0 * np.cos(2 * np.pi * 7 * turns), turns).orders()
    assert orders[7] == pytest.approx(2.0, rel=0.01)
    assert np.delete(orders, 7).max() < 0.02


def test_an_event_in_one_turn_leaves_the_typical_turn_alone():
    turns = np.arange(0, 12, 0.004)
    x = np.where(np.abs(turns - 5.5) < 0.02, 50.0, 0.0)
    pattern = shaft_pattern(x, turns)
    assert np.abs(pattern.typical).max() == 0.0
    assert np.unravel_index(np.argmax(pattern.single), pattern.single.shape)[0] == 5


def test_matched_filter_finds_a_pulse_in_coloured_noise_and_is_standard_without():
    rng = np.random.default_rng(2)
    noise = np.zeros(5000)
    for k, e in enumerate(rng.standard_normal(5000)):
        noise[k] = 0.95 * noise[k - 1] + e
    template = pulse_templates([0.02], 0.05, 0.002)[0]
    whitener = autoregressive_whitener(noise, 20)
    z, deviation = matched_filter(noise, whitener, template)
    assert np.std(z) == pytest.approx(1.0, abs=0.1)
    hit = noise.copy()
    hit[3000 : 3000 + template.size] += 12 * deviation * template
    z, _ = matched_filter(hit, whitener, template)
    assert np.argmax(z) == pytest.approx(3000, abs=2) and z.max() == pytest.approx(12, abs=3)


def test_upper_tail_ignores_a_long_lower_tail():
    rng = np.random.default_rng(3)
    values = rng.standard_normal(3000)
    skewed = np.where(values < 0, 5 * values, values)
    limit = float(UpperTail.of(skewed).limit(1e-3))
    assert limit == pytest.approx(3.1, abs=0.25)
    assert limit < np.mean(skewed) + 3.1 * np.std(skewed)


def objects_that_differ():
    """Two classes, ten objects; each object has an offset that random folds can learn and a new object does not share."""
    rng = np.random.default_rng(4)
    objects = np.repeat(np.arange(10), 20)
    labels = np.tile(["healthy", "faulty"], 100)
    offset = rng.normal(0, 30, (10, 2))[objects]
    X = offset + np.where(labels == "faulty", 2.0, 0.0)[:, None] + rng.normal(0, 0.3, (200, 2))
    return X, labels, objects


def test_mixed_folds_flatter_what_object_wise_validation_shows():
    X, labels, objects = objects_that_differ()
    mixed = mixed_folds(KNeighborsClassifier(1), X, labels, objects)
    honest = object_wise(KNeighborsClassifier(1), X, labels, objects)
    assert mixed.accuracy > 0.95
    assert honest.accuracy < 0.8
    assert set(honest.predicted) <= {"healthy", "faulty"}


def test_interval_by_objects_is_wider_than_by_observations():
    objects = np.repeat(np.arange(12), 50)
    truth = np.full(600, "healthy")
    predicted = np.where(objects < 3, "rack", "healthy")  # three objects wholly wrong

    def right(a, b):
        return float(np.mean(a == b))

    low, high = Validation(truth, predicted, objects).interval(right)
    assert low < 0.6 and high > 0.9
    by_observation = proportion_interval(450, 600)
    assert high - low > 3 * (by_observation[1] - by_observation[0])


def test_object_wise_needs_two_objects():
    with pytest.raises(BadInput, match="one object"):
        object_wise(source_classifier(), np.ones((4, 2)), ["healthy", "rack"] * 2, [0] * 4)


def test_confusion_has_predictions_in_rows_as_the_source_prints_it():
    truth, predicted = (
        np.array(["healthy", "healthy", "rack"]),
        np.array(["healthy", "rack", "rack"]),
    )
    assert Validation(truth, predicted, np.arange(3)).confusion(["healthy", "rack"]).tolist() == [
        [1, 0],
        [1, 1],
    ]


def test_fmeca_places_the_six_modes_as_the_source_and_links_to_diagnosers_that_exist():
    modes = load_fmeca()
    cells = {
        cell: [mode.id for mode in found]
        for cell, found in criticality_matrix(modes).items()
        if found
    }
    assert cells == {
        ("D", "IV"): ["rack-tooth", "pinion-tooth"],
        ("C", "I"): ["broken-shaft"],
        ("C", "III"): ["nylon-gear"],
        ("B", "I"): ["motor-short-circuit"],
        ("B", "III"): ["corrupted-wheel"],
    }
    links = coverage(modes, {name: diagnoser.classes for name, diagnoser in DIAGNOSERS.items()})
    covered = {mode.id for mode in modes if links[mode.id]}
    assert covered == {"rack-tooth", "pinion-tooth", "nylon-gear"}
    assert {mode.id for mode in modes if mode.risk is not Risk.REDESIGN} == covered


def test_fmeca_refuses_what_it_cannot_keep(tmp_path):
    with pytest.raises(BadInput, match="no diagnoser 'gate-actuator' with class 'rack'"):
        coverage(load_fmeca(), {"gate-actuator": ("pinion-or-gear",)})
    path = tmp_path / "modes.yaml"
    path.write_text(
        "modes: [{id: a, component: b, failure: c, cause: d, effect: e, probability: Z, severity: I}]"
    )
    with pytest.raises(BadInput, match="probability 'Z'"):
        load_fmeca(path)
    path.write_text("nothing: here")
    with pytest.raises(BadInput, match="no list `modes`"):
        load_fmeca(path)


def random_turns(count, seed, worse=1.0):
    """Typical turns of healthy gears: random tooth errors with a falling spectrum, `worse` times as large."""
    rng = np.random.default_rng(seed)
    order = np.arange(1, 44)
    turns = []
    for _ in range(count):
        X = np.zeros(129, dtype=complex)
        X[1:44] = (
            (rng.standard_normal(43) + 1j * rng.standard_normal(43)) * worse * 40.0 / np.sqrt(order)
        )
        turns.append(np.fft.irfft(X, 256))
    return turns


def notch_of(size, place=0.3):
    """What a notch adds to the turn, its peak `size` standard deviations of healthy turns."""
    angle = (np.arange(256) / 256 - place) * 44.0  # pitches from the notch
    s = 1j * np.arange(129) * 430.0 / 44
    bump = np.fft.irfft(np.fft.rfft(np.exp(-0.5 * angle**2)) * s**2 / (1 + s * 0.05), 256)
    return size * np.std(random_turns(1, 3)[0]) * bump / np.abs(bump).max()


def again(turn, rng):
    """The same gear in another movement: from another angle, a little larger or smaller, and not quite the same."""
    spectrum = (
        np.fft.rfft(turn)
        * np.exp(1j * rng.uniform(0, 2 * np.pi) * np.arange(129))
        * rng.uniform(0.8, 1.3)
    )
    return np.fft.irfft(spectrum, 256) + 0.05 * np.std(turn) * rng.standard_normal(256)


def test_a_known_gear_is_recognised_and_a_notch_that_is_new_in_it_seen_early():
    rng = np.random.default_rng(7)
    match, seen = NotchMatch.of(random_turns(60, 0), 44), random_turns(12, 5)
    gears = KnownGears.of([again(turn, rng) for turn in seen for _ in range(3)], match)
    assert gears.movements.tolist() == [3] * 12
    healthy = [gears.recognise(again(turn, rng), match, 430.0, 0.05) for turn in seen]
    assert max(known.match for known in healthy) < 1.0 < NEW_NOTCH_LIMIT
    small = [again(turn, rng) + notch_of(1.5, rng.uniform(0.1, 0.9)) for turn in seen]
    assert min(gears.recognise(turn, match, 430.0, 0.05).match for turn in small) > NEW_NOTCH_LIMIT
    assert np.mean([match.statistic(turn, 430.0, 0.05) > LEAST_NOTCH_LIMIT for turn in small]) < 0.2
    assert [gears.recognise(turn, match, 430.0, 0.05) for turn in random_turns(30, 6)] == [
        None
    ] * 30


def test_a_notch_is_found_among_tooth_errors_and_a_gear_worse_all_round_is_none():
    match = NotchMatch.of(random_turns(60, 0), 44)
    healthy = np.array([match.statistic(turn, 430.0, 0.05) for turn in random_turns(300, 1)])
    worse = np.array(
        [match.statistic(turn, 430.0, 0.05) for turn in random_turns(100, 2, worse=1.5)]
    )
    notched = np.array(
        [match.statistic(turn + notch_of(10.0), 430.0, 0.05) for turn in random_turns(40, 4)]
    )
    assert 2.5 < np.median(healthy) < 3.5
    assert max(healthy.max(), worse.max()) < LEAST_NOTCH_LIMIT
    assert np.mean(notched > LEAST_NOTCH_LIMIT) >= 0.95


def test_decision_regions_are_what_the_classifier_says_at_each_place():
    rng = np.random.default_rng(5)
    X = np.concatenate([rng.normal(centre, 0.3, (40, 2)) for centre in ((0, 0), (3, 0), (0, 3))])
    labels = np.repeat(["healthy", "pinion-or-gear", "rack"], 40)
    classifier = source_classifier().fit(X, labels)
    regions = decision_regions(classifier, X, resolution=60)
    for row, column in ((5, 5), (5, 50), (50, 5), (30, 20)):
        said = classifier.predict([[regions.x[column], regions.y[row]]])[0]
        assert regions.classes[regions.region[row, column]] == said
    assert regions.x[0] < X[:, 0].min() and regions.y[-1] > X[:, 1].max()
    with pytest.raises(BadInput, match=r"must be \(n, 2\)"):
        decision_regions(classifier, np.ones((4, 3)))
