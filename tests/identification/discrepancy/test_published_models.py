"""Models that engineers published go in as they stand; all of them in benchmarks."""

import numpy as np
import pytest

from benchmarks.published_equations import PLANTS
from benchmarks.published_models import AGREEMENT, FILES, difference, hidden_record, model_of
from residuum.identification.discrepancy.explain import explain
from residuum.identification.discrepancy.improve import improve
from residuum.identification.physics import Key, Simulator, candidates
from residuum.identification.unseen_blocks import following
from residuum.identification.unseen_blocks.data import matched


@pytest.mark.parametrize("name", ["battery-cell", "quadruple-tank"])
def test_a_published_model_simulates_as_its_equations_do(name):
    assert difference(name) < AGREEMENT


def test_each_file_is_read_and_may_lack_what_its_machine_hides():
    assert {path.stem for path in FILES.glob("*.yaml")} == set(PLANTS)
    for name, plant in PLANTS.items():
        assert Key(*plant.hidden.split("@")) in candidates(model_of(name))


def test_an_improved_model_is_judged_at_its_least_error_over_the_whole_record():
    """A tank integrates what its values err by: three standard deviations were called an unknown effect."""
    plant, record = PLANTS["pump-station"], hidden_record("pump-station")
    improved = improve(model_of("pump-station"), [record], effects=["overflow", "leak"])
    assert [use.label for use in improved.added] == [plant.hidden]
    assert improved.verdict == "adequate"
    values, (rim,) = improved.model.values, improved.added
    for name, truth in (("c", plant.size), ("h_max", 2.5)):
        std = rim.provenance[f"std_{name}"]
        assert abs(values[f"{rim.label}.{name}"] - truth) < 3.0 * std


def test_a_link_that_turns_over_is_begun_where_the_search_found_it():
    """From measured first angles, a hundredth beside, it ends in another turn: the effect that it has was refused."""
    plant, record = PLANTS["robot-joint"], hidden_record("robot-joint")
    improved = improve(model_of("robot-joint"), [record], effects=["viscous-friction"])
    assert [use.label for use in improved.added] == [plant.hidden] and not improved.refused
    assert improved.verdict == "adequate"
    (friction,) = improved.added
    assert abs(friction.parameters["d"].value - plant.size) < 3.0 * friction.provenance["std_d"]


def test_an_actuator_that_had_not_settled_when_the_record_began_has_its_lag():
    """Held to its command at first it was told too short, beside a lag of a sensor at the integrator's limit of stability."""
    plant, record = PLANTS["wind-turbine"], hidden_record("wind-turbine")
    improved = improve(model_of("wind-turbine"), [record], effects=["input-lag", "output-lag"])
    assert [use.label for use in improved.added] == [plant.hidden]
    assert improved.verdict == "adequate"
    (lag,) = improved.added
    assert abs(lag.parameters["tau"].value - plant.size) < 3.0 * lag.provenance["std_tau"]


def test_a_machine_that_no_filter_follows_is_searched_all_the_same(monkeypatch):
    """A walk of what the balances lack carried pressures below nothing: nothing was tried, it was an unknown effect."""
    model, record = model_of("fuel-cell"), hidden_record("fuel-cell", 3)
    effects = ["output-drift", "output-offset", "input-offset"]
    explained = explain(model, [record], effects=effects)
    assert explained.verdict == "missing-effect"
    assert [str(key) for key in explained.accepted] == [PLANTS["fuel-cell"].hidden]
    monkeypatch.setattr(following, "WALKS", ())
    data = matched(model, [record], None)
    along = following.followed(data.model, data)
    assert not any(lack.any() for lack in along.missing.values())
    (experiment,) = data.experiments
    simulator = Simulator(data.model)
    run = simulator.run_vectors(experiment, simulator.measured_start(experiment), simulator.p())
    np.testing.assert_allclose(along.X, run.X, rtol=1e-3)


def test_the_timing_of_an_input_is_asked_in_the_noise_that_is_left():
    """In that of what was missing a flow was taken to move evenly between samples: a rim seven standard deviations off."""
    plant, record = PLANTS["pump-station"], hidden_record("pump-station", 7)
    improved = improve(model_of("pump-station"), [record], effects=["overflow", "leak"])
    (rim,) = improved.added
    assert rim.label == plant.hidden and improved.verdict == "adequate"
    for name, truth in (("c", plant.size), ("h_max", 2.5)):
        assert abs(rim.parameters[name].value - truth) < 3.0 * rim.provenance[f"std_{name}"]


def test_a_friction_has_its_size_in_the_noise_that_is_left_with_it():
    """What a model without it leaves looks like noise of a colour, in which it was seven standard deviations off."""
    plant, record = PLANTS["robot-joint"], hidden_record("robot-joint", 5)
    improved = improve(model_of("robot-joint"), [record], effects=["viscous-friction"])
    (friction,) = improved.added
    assert friction.label == plant.hidden
    assert abs(friction.parameters["d"].value - plant.size) < 3.0 * friction.provenance["std_d"]
