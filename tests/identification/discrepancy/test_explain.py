"""Explain and improve on records whose missing physics is known; the machines share no code with the models."""

import numpy as np
import pytest

from residuum.identification.discrepancy.explain import explain
from residuum.identification.discrepancy.improve import improve
from residuum.identification.discrepancy.kept_aside import split
from residuum.identification.errors import BadModel, BadRecord
from residuum.identification.physics import Simulator, load_model, match, read_model, write_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.free_term import linear_response
from residuum.simulation import MACHINES

TANK = """
name: rain barrel
inputs:      {tap: V}
states:      {x: {unit: m}}
parameters:  {A: {value: 0.5, unit: m**2, fixed: true}, g: {value: 0.9e-3, unit: m**3/s/V, lower: 0}}
balances:
  barrel:    {kind: volume, storage: A * der(x), terms: {tap: g * tap}, level: x}
outputs:     {depth: {value: x, unit: m}}
"""


PLATE = """
name: plate
inputs:      {u: V}
states:      {x: {unit: degC}}
parameters:  {C: {value: 100, unit: J/K, fixed: true}, P: {value: 5, unit: W/V, lower: 0}, h: {value: 1, unit: W/K, lower: 0},
              T_a: {value: 20, unit: degC, fixed: true}}
balances:
  plate:     {kind: heat, storage: C * der(x), terms: {lamp: P * u, loss: -h * (x - T_a)}, temperature: x, ambient: T_a}
outputs:     {T: {value: x, unit: degC}}
"""


def drive(effects=None, seed=3, duration=15.0, rate=200.0, **settings):
    machine = MACHINES["gate-drive"](seed=seed, effects=effects, rate=rate, **settings)
    s = machine.simulate(duration)
    return Record(s.channels, s.units, s.sample_time, notes=s.notes, source="drive.csv")


@pytest.fixture(scope="module")
def rubbing():
    return drive({"coulomb-friction": {"tau_c": 0.02}})


@pytest.fixture(scope="module")
def rubbing_explained(rubbing):
    return explain(load_model("gate-drive"), [rubbing])


def test_hidden_friction_is_named_and_measured(rubbing_explained):
    assert rubbing_explained.verdict == "missing-effect"
    first = rubbing_explained.candidates[0]
    assert (first.effect, first.balance) == ("coulomb-friction", "shaft")
    tau_c = first.parameters["tau_c"]
    assert tau_c.value == pytest.approx(0.02, abs=max(4 * tau_c.std, 2e-4))
    assert tau_c.unit == "N*m"
    assert first.error_after < 0.5 * first.error_before
    assert first.within_bounds


def test_probabilities_share_one(rubbing_explained):
    first_step = [c.probability for c in rubbing_explained.candidates if c.step == 0]
    assert all(p >= 0 for p in first_step)
    total = (
        sum(first_step) + rubbing_explained.probability_none + rubbing_explained.probability_unknown
    )
    assert total == pytest.approx(1.0, abs=1e-6)


def test_what_would_have_been_seen_is_smaller_than_what_was_hidden_elsewhere(rubbing_explained):
    """The inductance-free drive at this noise shows a load of a few mN·m; the bound must say so, in its unit."""
    found = {(u.effect, u.balance): u for u in rubbing_explained.undetectable}
    load = found["constant-load", "shaft"]
    assert load.unit == "N*m"
    assert 1e-5 < load.smallest_visible["tau_0"] < 0.02
    assert ("coulomb-friction", "shaft") not in found


@pytest.mark.parametrize("rho", [0.0, 0.95])
def test_a_complete_model_is_adequate_whatever_the_noise_colour(rho):
    explanation = explain(load_model("gate-drive"), [drive(noise_color=rho, seed=5)])
    assert explanation.verdict == "adequate"
    assert explanation.probability_none > 0.5


def test_physics_outside_the_catalogue_is_not_claimed():
    record = drive({"x-speed-resonance": "large"}, profile="rich", duration=20.0)
    explanation = explain(
        load_model("gate-drive"),
        [record],
        effects=["coulomb-friction", "input-offset", "constant-load"],
    )
    assert explanation.verdict == "unknown-effect"
    assert explanation.free.balance == "shaft"
    assert explanation.free.axis == "velocity"
    resonance = np.abs(
        explanation.free.at[
            np.argmax(np.abs(explanation.free.value - np.median(explanation.free.value)))
        ]
    )
    assert resonance == pytest.approx(210.0, abs=40.0)


def test_a_load_that_walks_at_random_is_not_taken_for_an_effect():
    """It has a mean, as a constant load and an off-centre spring have; only its wandering tells it apart."""
    walk = explain(
        load_model("gate-drive"), [drive({"x-random-walk-load": "medium"}, profile="rich", seed=1)]
    )
    assert walk.verdict != "missing-effect"


def test_a_constant_load_is_told_from_one_that_walks():
    constant = explain(
        load_model("gate-drive"), [drive({"constant-load": "medium"}, profile="rich", seed=1)]
    )
    assert (constant.verdict, constant.candidates[0].effect) == ("missing-effect", "constant-load")


def test_a_friction_with_three_parameters_is_followed_to_its_optimum():
    """Stopped half-way, its remaining error would invite a second effect that is not there."""
    explanation = explain(
        load_model("gate-drive"), [drive({"stribeck-friction": "medium"}, rate=500.0, seed=1)]
    )
    assert list(explanation.accepted) == [("stribeck-friction", "shaft")]
    found = explanation.candidates[0].parameters
    assert found["tau_c"].value == pytest.approx(0.02, rel=0.05)
    assert found["tau_s"].value == pytest.approx(0.03, rel=0.2)
    assert explanation.candidates[0].held_out


def test_a_supply_with_a_resistance_is_not_taken_for_friction_under_load():
    """It gives way by the same voltage for each ampere, at whatever voltage; a load friction of speed alone did nearly that."""
    explanation = explain(
        load_model("gate-drive"),
        [drive({"supply-sag": "medium"}, duration=30.0, rate=500.0, seed=31)],
    )
    sag = explanation.candidates[0]
    assert (explanation.verdict, sag.effect) == ("missing-effect", "supply-sag")
    values = {name: quantity.value for name, quantity in sag.parameters.items()}
    assert (values["p"], values["fed"]) == (0.0, 1.0)
    assert values["k"] * values["u_ref"] == pytest.approx(0.1, rel=0.1)  # ohm


def test_play_that_nothing_leads_to_is_reached_from_the_spring_that_fits_best():
    play = explain(
        load_model("gate-drive"),
        [drive({"backlash": "medium"}, duration=30.0, rate=500.0, profile="rich", seed=0)],
    )
    assert play.candidates[0].effect == "backlash"
    assert play.candidates[0].parameters["gap"].value == pytest.approx(1.5, rel=0.02)


def test_a_stop_that_nothing_leads_to_is_reached_where_the_measured_speed_says_that_the_gate_was():
    stopped = explain(
        load_model("gate-drive"), [drive({"end-stop": "medium"}, duration=30.0, rate=500.0, seed=0)]
    )
    assert stopped.candidates[0].effect == "end-stop"
    assert stopped.left["speed"][0] < 3.0  # it was thirty; the noise is .3


def oven(effect):
    machine = MACHINES["oven"](seed=0, effects={effect: "medium"}, configuration="lumped")
    s = machine.simulate(24 * 3600.0)
    return Record(s.channels, s.units, s.sample_time)


def test_a_second_store_and_a_power_law_are_found_behind_a_lagging_sensor():
    """The thermocouple's lag is less than a sample: it is timing, however much likelihood it wins."""
    store = explain(load_model("oven"), [oven("second-heat-store")])
    assert list(store.accepted) == [("second-heat-store", "chamber")]
    assert store.candidates[0].parameters["C_2"].value == pytest.approx(6e4, rel=0.2)
    law = explain(load_model("oven"), [oven("heater-nonlinearity")])
    assert list(law.accepted) == [("heater-nonlinearity", "chamber")]
    assert law.candidates[0].parameters["gamma"].value == pytest.approx(0.3, abs=0.05)


def test_a_large_store_that_the_start_shows_most_joins_though_one_place_holds_most_of_the_error():
    machine = MACHINES["oven"](
        seed=71, effects={"second-heat-store": "large"}, configuration="lumped"
    )
    signals = machine.simulate(48 * 3600.0)
    store = explain(
        load_model("oven"), [Record(signals.channels, signals.units, signals.sample_time)]
    )
    assert list(store.accepted) == [("second-heat-store", "chamber")]


def test_a_speed_that_is_read_without_its_sign_is_named_where_short_windows_are_fitted_by_a_standstill():
    signals = MACHINES["gate-drive"](seed=213, effects={"output-absolute": "small"}).simulate(15.0)
    told = explain(
        load_model("gate-drive"),
        [
            Record(
                {c: signals.channels[c] for c in ("voltage", "speed")},
                signals.units,
                signals.sample_time,
            )
        ],
    )
    assert [key.effect for key in told.accepted] == ["output-absolute"]
    assert told.left["speed"][0] == pytest.approx(0.3, rel=0.05)  # its noise


def test_a_plate_with_two_stores_of_heat_is_not_called_complete():
    """Nearly noiseless: integrated noise could swallow the whole error; the catalogue is kept from naming the second store."""
    n, h = 800, 2.0
    power = np.repeat(np.random.default_rng(2).uniform(0.0, 10.0, 20), n // 20)
    T, inner, seen = 20.0, 20.0, np.zeros(n)
    for k in range(n):
        seen[k] = T
        for _ in range(20):
            flow = 2.0 * (inner - T)
            inner += h / 20 * (power[k] * 8.0 - flow) / 60.0
            T += h / 20 * (flow - 1.5 * (T - 20.0)) / 90.0
    noise = 0.02 * np.random.default_rng(5).standard_normal(n)
    record = Record({"u": power, "T": seen + noise}, {"u": "V", "T": "degC"}, h)
    explanation = explain(read_model(PLATE), [record], effects=["door-opening", "radiation"])
    assert explanation.verdict == "unknown-effect"


def test_a_plate_in_a_draught_that_walks_at_random_is_not_called_complete():
    """Four steps of power in 800 samples: its slow error may be physics or a disturbance, but noise of a sensor it is not."""
    n, h = 800, 2.0
    rng = np.random.default_rng(4)
    power, draught = (
        np.repeat([2.0, 8.0, 4.0, 6.0], n // 4),
        np.cumsum(0.05 * rng.standard_normal(n)),
    )
    T, seen = 30.0, np.zeros(n)
    for k in range(n):
        seen[k] = T
        T += h * (8.0 * power[k] - 1.5 * (T - 20.0 - 5.0 * draught[k])) / 90.0
    record = Record(
        {"u": power, "T": seen + 0.02 * rng.standard_normal(n)}, {"u": "V", "T": "degC"}, h
    )
    explanation = explain(read_model(PLATE), [record])
    assert explanation.verdict == "unknown-effect"
    rms, unit, times = explanation.left["T"]
    assert unit == "degC"
    assert rms > 0.5
    assert times > 10.0


def test_a_model_of_ones_own_with_other_names():
    """A leaking barrel, integrated here with an explicit scheme a hundred times finer than the record."""
    n, h = 1500, 2.0
    rng = np.random.default_rng(4)
    tap = np.repeat(rng.uniform(0.0, 2.0, 30), n // 30)
    x, depth = 0.4, np.zeros(n)
    for k in range(n):
        depth[k] = x
        for _ in range(100):
            x += h / 100 * (1e-3 * tap[k] - 1.6e-3 * x) / 0.5
    record = Record(
        {"tap": tap, "depth": depth + 1e-3 * rng.standard_normal(n)}, {"tap": "V", "depth": "m"}, h
    )
    explanation = explain(read_model(TANK), [record])
    assert explanation.verdict == "missing-effect"
    assert "leak" in {
        explanation.candidates[0].effect,
        *explanation.candidates[0].indistinguishable_from,
    }


def test_linear_response_to_a_constant_is_the_kernels_own_derivative(rubbing):
    model, (experiment,) = match(load_model("gate-drive"), [rubbing])
    simulator = Simulator(model)
    x0, name = np.array([0.0, 5.0]), model.balances["shaft"].missing
    exact = simulator.run_vectors(experiment, x0, simulator.p(), slopes=[name], substeps=1).dY[
        :, :, 0
    ]
    response = linear_response(model, experiment, x0, 1).to("shaft", np.ones((experiment.n, 1)))[
        :, :, 0
    ]
    np.testing.assert_allclose(response, exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())


def test_auto_adds_the_effect_and_lowers_the_error_on_data_it_never_saw(rubbing):
    first, second = rubbing.window(0, 1700), rubbing.window(1700, rubbing.n)
    improvement = improve(load_model("gate-drive"), [first, second])
    assert [step.added for step in improvement.history] == [None, "coulomb-friction"]
    assert improvement.history[1].error < 0.5 * improvement.history[0].error
    assert improvement.verdict == "adequate"
    again = read_model(write_model(improvement.model))
    (use,) = again.effects
    assert use.provenance["error_after"] == pytest.approx(improvement.history[1].error)
    assert use.parameters["tau_c"].value == pytest.approx(0.02, rel=0.05)


def test_add_that_fits_several_places_must_say_which(rubbing):
    with pytest.raises(
        BadModel, match=r"'output-offset': fits speed, current; say which, as output-offset@speed"
    ):
        improve(load_model("gate-drive"), [rubbing], add=["output-offset"])


@pytest.mark.parametrize(("note", "share"), [("", 0.7), ("split: 0.5", 0.5)])
def test_one_record_is_split_where_its_note_says(note, share):
    record = Record({"y": np.arange(100.0)}, {"y": "m"}, 1.0, notes=(note,) if note else ())
    parts = split([record])
    assert parts.training[0].n == round(100 * share)
    assert parts.testing[0][1] == round(100 * share)


def test_a_machine_at_standstill_explains_nothing():
    still = {"voltage": np.zeros(2000), "speed": np.zeros(2000), "current": np.zeros(2000)}
    record = Record(
        still, {"voltage": "V", "speed": "rad/s", "current": "A"}, 0.01, source="still.csv"
    )
    with pytest.raises(BadRecord, match=r"still\.csv.*standstill explains nothing"):
        explain(load_model("gate-drive"), [record])


def read_in_steps(step, profile):
    """Voltage and speed of a drive that lacks nothing but fine steps of its speed sensor."""
    coarse = drive(
        {"output-quantisation": {"step": step}}, seed=41, duration=30.0, rate=500.0, profile=profile
    )
    return Record(
        {name: coarse.channels[name] for name in ("voltage", "speed")},
        coarse.units,
        coarse.sample_time,
    )


@pytest.mark.parametrize("step", [4.0, 15.0])
def test_a_coarse_reading_is_named_with_the_step_that_the_record_shows(step):
    """The step is read off the stairs; estimated, it ends in one of the error's many minima, and is not believed."""
    found = explain(load_model("gate-drive"), [read_in_steps(step, "rich")])
    assert found.verdict == "missing-effect"
    assert (found.candidates[0].effect, found.candidates[0].balance) == (
        "output-quantisation",
        "speed",
    )
    assert found.candidates[0].parameters["q"].value == step


def test_what_a_coarse_reading_hides_at_a_few_speeds_is_blamed_on_no_effect():
    """At each of them the speed is off by up to half a step, always the same: a supply's sag would fit that."""
    found = explain(load_model("gate-drive"), [read_in_steps(4.0, "duty-cycle")])
    assert found.verdict != "missing-effect"


def test_friction_in_one_direction_alone_is_one_effect():
    """Not Coulomb friction and a constant load, which do the same together."""
    found = explain(
        load_model("gate-drive"),
        [drive({"directional-friction": {"tau_c": 0.02, "asymmetry": 0.04}})],
    )
    assert list(found.accepted) == [("directional-friction", "shaft")]
    assert found.candidates[0].parameters["tau_plus"].value == pytest.approx(0.04, abs=5e-4)
    assert found.candidates[0].parameters["tau_minus"].value < 5e-4


def test_what_was_more_alone_is_the_plain_one_beside_another():
    """Alone, a friction of two directions stood for the load, too; beside the load both directions are alike."""
    found = explain(
        load_model("gate-drive"),
        [drive({"viscous-friction": "medium", "constant-load": "medium"}, profile="rich", seed=2)],
    )
    assert {key.effect for key in found.accepted} == {"viscous-friction", "constant-load"}


@pytest.mark.parametrize("samples", [2, 7, 39])
def test_too_few_samples_name_nothing(rubbing, samples):
    for judge in (explain, improve):
        with pytest.raises(BadRecord, match=f"'drive.csv': {samples} samples; at least 40"):
            judge(load_model("gate-drive"), [rubbing.window(0, samples)])
