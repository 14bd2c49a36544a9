"""Every effect of the catalogue passes the same tests on its own examples."""

import numpy as np
import pytest

from residuum.identification.physics import (
    Experiment,
    Simulator,
    balance_variables,
    conditions_at,
    load_model,
    read_model,
    write_model,
)
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.effects.base import Conditions
from residuum.identification.physics.effects.electric import BrushDrop, ResistanceHeating, SupplySag
from residuum.identification.physics.effects.friction import Friction, LuGre
from residuum.identification.physics.effects.hydraulic import Drain, Orifice
from residuum.identification.physics.effects.load import (
    Cogging,
    ConstantLoad,
    PositionLoad,
    ToothRipple,
)
from residuum.identification.physics.effects.spring import (
    BoucWen,
    CubicSpring,
    Hysteresis,
    LinearSpring,
)
from residuum.identification.physics.effects.thermal import ConstantHeat, HeatLoss, SecondHeatStore
from residuum.identification.physics.effects.transmission import EndStop
from residuum.identification.units import parse_unit


def opposes(name):
    """Takes power out, or lets it flow downhill: never of the sign of the variable."""
    return lambda term, variables, values: np.all(term * variables[name] <= 0.0)


def stays_within(largest, tolerance=1e-12):
    """Never beyond a bound that its parameters give."""
    return lambda term, variables, values: np.all(np.abs(term) <= largest(values) * (1 + tolerance))


def amplitude(values):
    return np.hypot(values["a"], values["b"])


def constant(term, variables, values):
    return np.ptp(term) == 0.0


def never_fills(term, variables, values):
    """Never adds liquid to a tank that holds some."""
    return np.all(term[variables["level"] >= 0.0] <= 0.0)


def pulls_back(term, variables, values):
    rest = -values["tau_0"] / values["k"] if values["k"] else 0.0
    return np.all(term * (variables["position"] - rest) <= 1e-9 * np.max(np.abs(term)))


def pulls_back_when_hardening(term, variables, values):
    """Without asymmetry it pulls towards its rest position when hardening, away when softening."""
    d = variables["position"] - values["q_0"]
    return np.all((term + values["k_2"] * d**2) * np.sign(values["k_3"]) * d <= 0.0)


def cools(term, variables, values):
    """Heat flows from the hotter to the colder side."""
    surroundings = variables["ambient"] if "ambient" in variables else values["T_a"]
    return np.all(term * (variables["temperature"] - surroundings) <= 0.0)


def pushes_inwards(term, variables, values):
    """Pushes inwards beyond the ends, does nothing between them."""
    q = variables["position"]
    inwards = np.all(term[q > values["q_max"]] <= 0.0) and np.all(term[q < values["q_min"]] >= 0.0)
    return inwards and np.all(term[(q < values["q_max"]) & (q > values["q_min"])] == 0.0)


def saturation(values):
    """A/(β + γ), where it saturates at all."""
    lost = values["beta"] + values["gamma"]
    return values["A"] / lost if lost > 0.0 else np.inf


LAWS = {
    BrushDrop: opposes("current"),
    ResistanceHeating: opposes("current"),
    SupplySag: opposes("supply_terms"),
    Friction: opposes("velocity"),
    LuGre: stays_within(lambda values: values["tau_c"] + values["tau_s"], 1e-6),
    Drain: never_fills,
    Orifice: lambda term, variables, values: np.all(
        term * (variables["level"] - values["h_0"]) <= 0.0
    ),
    BoucWen: stays_within(saturation, 1e-6),
    Cogging: stays_within(lambda values: amplitude(values) + np.hypot(values["a2"], values["b2"])),
    ConstantLoad: constant,
    CubicSpring: pulls_back_when_hardening,
    Hysteresis: stays_within(lambda values: values["f_c"], 1e-6),
    LinearSpring: pulls_back,
    PositionLoad: stays_within(amplitude),
    ToothRipple: stays_within(amplitude),
    ConstantHeat: constant,
    HeatLoss: cools,
    SecondHeatStore: lambda term, variables, values: np.all(
        term * (variables["temperature"] - variables["T_2"]) <= 0.0
    ),
    EndStop: pushes_inwards,
}
"""By class; a class without a law of its own obeys that of its nearest base, and any term is finite.

A new effect that stands on no base with a law adds a line here, where its term has a sign or a bound.
"""


def obeys_physics(effect, term, variables, values):
    law = next((LAWS[kind] for kind in type(effect).__mro__ if kind in LAWS), None)
    return bool(np.all(np.isfinite(term)) and (law is None or law(term, variables, values)))


def excitation(example):
    n = round(example.duration / example.sample_time)
    t = np.arange(n) / n
    if example.profile == "steps":
        return example.amplitude * (np.sin(2 * np.pi * 3.3 * t) > 0)
    return (
        example.amplitude
        * np.sin(2 * np.pi * 4 * t)
        * np.clip(2 * np.sin(2 * np.pi * t * 1.5), -1, 1)
    )


def placed(effect, example):
    """The example's model, its experiment, a place that the effect fits, and the operating conditions there."""
    model = read_model(example.model)
    U = excitation(example)[:, None]
    hold = np.ones(1) if example.profile == "sweep" else np.zeros(1)
    experiment = Experiment(
        U, np.full((len(U), len(model.outputs)), np.nan), hold, example.sample_time
    )
    places = [*model.balances, *model.inputs, *model.outputs]
    target = next(place for place in places if effect.fits(model.site(place, effect)))
    run = Simulator(model).run(experiment)
    return model, experiment, target, conditions_at(model, effect, target, experiment, run.X)


CASES = [
    pytest.param(e, x, id=f"{i}-{k}")
    for i, e in EFFECTS.items()
    for k, x in enumerate(e.examples())
]


@pytest.mark.parametrize(("effect", "example"), CASES)
def test_effect_in_its_examples(effect, example):
    model, experiment, target, conditions = placed(effect, example)
    base = Simulator(model).run(experiment)
    starts = effect.starts(conditions)
    assert starts
    with_it = model.with_effect(effect.id, target, starts[0])
    use = with_it.effects[0]
    run = Simulator(with_it).run(experiment)
    assert run.finite
    assert not np.allclose(run.Y, base.Y, rtol=1e-6, atol=1e-12), "the effect changes nothing"
    if target in model.balances:
        variables = balance_variables(
            Simulator(with_it), with_it.balances[target], experiment, run.X
        )
        values = {name: parameter.value for name, parameter in use.parameters.items()}
        assert obeys_physics(effect, variables[f"term:{effect.id}"], variables, values), (
            "the term is not finite, or has the wrong sign or size: see LAWS"
        )
    for start in starts:
        assert set(start) == set(use.parameters)
    if effect.vanishes:
        none = model.with_effect(
            effect.id, target, {**starts[0], **dict.fromkeys(effect.sizes, 0.0)}
        )
        np.testing.assert_allclose(Simulator(none).run(experiment).Y, base.Y, rtol=1e-9, atol=1e-12)
    assert read_model(write_model(with_it)) == with_it
    for parameter in use.parameters.values():
        parse_unit(parameter.unit)
        assert parameter.meaning


@pytest.mark.parametrize(("effect", "example"), CASES)
def test_sensitivities_are_the_derivatives_of_the_outputs(effect, example):
    """Central differences agree where the effect is smooth along the trajectory; set-valued friction in the bulk of samples."""
    model, experiment, target, conditions = placed(effect, example)
    start = effect.starts(conditions)[0]
    with_it = model.with_effect(
        effect.id, target, {name: 0.97 * value for name, value in start.items()}
    )
    simulator = Simulator(with_it)
    steps = simulator.substeps(experiment, simulator.x0(), simulator.p())
    names = [
        name
        for name in with_it.all_parameters
        if "@" in name and not with_it.all_parameters[name].fixed
    ]
    exact = simulator.run(experiment, slopes=names, substeps=steps).dY
    for column, name in enumerate(names):
        value = with_it.values[name]
        step = 1e-6 * (abs(value) or 1e-3)
        up, down = (
            simulator.run(experiment, values={name: value + s}, substeps=steps).Y
            for s in (step, -step)
        )
        numeric = (up - down) / (2 * step)
        error = np.abs(exact[:, :, column] - numeric)
        scale = np.max(np.abs(exact[:, :, column])) or 1.0
        if effect.id == "output-quantisation":
            continue
        assert np.isfinite(scale), f"{name}: a slope is no number; smooth the term at its zeros"
        assert np.quantile(error, 0.95) <= 1e-3 * scale, (name, np.quantile(error, 0.95), scale)


@pytest.mark.parametrize(("effect", "example"), CASES)
def test_an_own_state_may_begin_away_from_where_it_settles(effect, example):
    """A first value of an effect's own state is how far it is off; slopes by it are the derivatives of the outputs."""
    model, experiment, target, conditions = placed(effect, example)
    simulator = Simulator(model.with_effect(effect.id, target, effect.starts(conditions)[0]))
    steps = simulator.substeps(experiment, simulator.x0(), simulator.p())
    for state in simulator.kernel.deviating:
        k, column = simulator.states.index(state), [f"initial:{state}"]
        settled = simulator.run(experiment, slopes=column, substeps=steps)
        off = 1e-4 * max(abs(settled.X[0, k]), 1.0)
        begun, before = (simulator.run(experiment, {state: s}, substeps=steps) for s in (off, -off))
        assert begun.X[0, k] == pytest.approx(settled.X[0, k] + off)
        slopes = (begun.Y - before.Y) / (2 * off)
        np.testing.assert_allclose(settled.dY[:, :, 0], slopes, atol=1e-3 * np.max(np.abs(slopes)))


def test_an_elasticity_has_first_values_where_nothing_rings():
    """A record of a machine at standstill leaves no error whose resonance could be read off."""
    still = Conditions(sample_time=0.01, duration=4.0, magnitude=1.0, missing=np.zeros(400))
    starts = EFFECTS["elastic-transmission"].starts(still)
    assert starts and all(np.isfinite(value) for start in starts for value in start.values())


@pytest.mark.parametrize(
    "id", ["directional-friction", "stribeck-friction", "backlash", "tooth-ripple"]
)
def test_a_general_effect_gives_values_of_the_one_that_it_generalises(id):
    """At equal sides a directional friction is the plain one; names are those of the simpler effect's parameters."""
    effect, plain = EFFECTS[id], EFFECTS[EFFECTS[id].generalises]
    model, _, target, conditions = placed(effect, effect.examples()[0])
    values = effect.specialised(effect.starts(conditions)[0], conditions)
    assert set(values) <= {
        parameter.name for parameter in plain.parameters(model.site(target, plain))
    }
    if id == "directional-friction":
        assert effect.specialised({"tau_plus": 2.0, "tau_minus": 1.0}, conditions) == {"tau_c": 1.5}


@pytest.mark.parametrize(
    "pair",
    [
        (("load-friction", "shaft"), ("supply-sag", "winding")),
        (("load-friction", "shaft"), ("brush-drop", "winding")),
        (("brush-drop", "winding"), ("input-dead-zone", "voltage")),
        (("supply-sag", "winding"), ("output-absolute", "current")),
        (("output-quantisation", "speed"), ("output-absolute", "speed")),
    ],
    ids=lambda pair: "+".join(id for id, _ in pair),
)
def test_effects_of_a_current_that_flows_by_cases_go_together(pair):
    """A current that brushes, sag or a dead zone define by cases has a size, a sign and slopes as any other real number."""
    model = load_model("gate-drive")
    t = np.arange(2000) * 1e-3
    U = (12.0 * np.sin(2 * np.pi * 1.5 * t))[:, None]
    experiment = Experiment(U, np.full((len(U), 2), np.nan), np.ones(1), 1e-3)
    X = Simulator(model).run(experiment).X
    for id, target in pair:
        conditions = conditions_at(model, EFFECTS[id], target, experiment, X)
        model = model.with_effect(id, target, dict(EFFECTS[id].starts(conditions)[0]))
    simulator = Simulator(model)
    names = [
        name
        for name in ("R", "K", *model.all_parameters)
        if name in model.free and not name.startswith("output-quantisation")
    ]
    exact = simulator.run(experiment, slopes=names, substeps=4).dY
    for column, name in enumerate(names):
        step = 1e-6 * (abs(model.values[name]) or 1e-3)
        up, down = (
            simulator.run(experiment, values={name: model.values[name] + s}, substeps=4).Y
            for s in (step, -step)
        )
        error = np.abs(exact[:, :, column] - (up - down) / (2 * step))
        if any(id == "output-quantisation" for id, _ in pair):
            error = error[:, 1:]  # the differences of what is read in steps are steps
        assert np.quantile(error, 0.95) <= 1e-3 * np.max(np.abs(exact[:, :, column])), name


@pytest.mark.parametrize("name", sorted(EFFECTS))
@pytest.mark.parametrize("size", [0.0, 1e-310, 1e-120])
def test_first_values_are_numbers_where_nothing_moves(name, size):
    """A simulation of a machine at rest leaves next to nothing of a position, and its cube underflows."""
    roles = (
        "position",
        "velocity",
        "current",
        "temperature",
        "ambient",
        "level",
        "signal",
        "supply",
    )
    still = {role: size * np.linspace(0.0, 1.0, 400) for role in roles}
    at_rest = Conditions(
        sample_time=0.01, duration=4.0, magnitude=1.0, variables=still, missing=np.zeros(400)
    )
    assert all(
        np.isfinite(value) for start in EFFECTS[name].starts(at_rest) for value in start.values()
    )
