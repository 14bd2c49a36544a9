"""Parameters of FMUs: known ones recovered however the FMU runs, as our own model of the same equations has them."""

import json

import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, Simulator, load_model, write_model
from residuum.identification.physics.simulate.differences import Step, central, chosen_step
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service.cli import BAD_INPUT, DONE, run
from tests.identification.physics.fmu_files import (
    exported,
    recompiled,
    rewritten,
    without_exchange,
)

fmpy = pytest.importorskip("fmpy")

DT, N = 0.01, 600
TRUE = {"M": 110.0, "viscous_friction_axis.d": 40.0}
UNITS = {"force": "N", "position": "m", "velocity": "m/s"}


@pytest.fixture(scope="module")
def sliding():
    """A rail's model with the values of its file: not those of the machine that was recorded."""
    return load_model("linear-axis").with_effect("viscous-friction", "axis", {"d": 25.0})


@pytest.fixture(scope="module")
def axis(sliding, tmp_path_factory):
    """That model as an FMU."""
    return exported(sliding, tmp_path_factory.mktemp("fmu") / "axis.fmu")


def recorded(model, values, n=N, start=(0.0, 0.0), **extra):
    rng = np.random.default_rng(4)
    U = np.repeat(rng.uniform(-90.0, 90.0, (n // 40, 1)), 40, axis=0)
    simulator = Simulator(model.with_values(values))
    blank = Experiment(U, np.full((n, 2), np.nan), np.zeros(1), DT)
    initial = dict(zip(simulator.states, start, strict=True))
    Y = simulator.run(blank, initial, substeps=20).Y + rng.normal(scale=[1e-4, 1e-3], size=(n, 2))
    return Record(
        {"force": U[:, 0], "position": Y[:, 0], "velocity": Y[:, 1]},
        UNITS,
        DT,
        source="rail",
        **extra,
    )


@pytest.fixture(scope="module")
def rail(sliding):
    return recorded(sliding, {"M": 110.0, "viscous-friction@axis.d": 40.0})


def without_state(description):
    """A description of an FMU that simulates itself, and cannot bring a state back."""
    return without_exchange(description).replace(
        b'canGetAndSetFMUstate="true"', b'canGetAndSetFMUstate="false"'
    )


def changed(axis, to, kind):
    """The FMU as it is, with its own solver alone, and the latter without states."""
    description = {"own solver": without_exchange, "reset": without_state}.get(kind)
    return axis if description is None else rewritten(axis, to / "changed.fmu", xml=description)


@pytest.mark.parametrize("kind", ["exchange", "own solver", "reset"])
def test_known_parameters_are_recovered_by_one_instance(kind, axis, rail, tmp_path, monkeypatch):
    instances = []
    for way in (fmpy.fmi2.FMU2Model, fmpy.fmi2.FMU2Slave):
        monkeypatch.setattr(way, "instantiate", counted(way.instantiate, instances))
    answer = rs.fmu(changed(axis, tmp_path, kind)).estimate(rail, free=list(TRUE))
    assert len(instances) <= 1  # one that another test made may serve
    for name, value in TRUE.items():
        estimated = answer.parameters[name]
        assert estimated["value"] == pytest.approx(value, rel=0.01)
        assert abs(estimated["value"] - value) < 4.0 * estimated["std"]
        assert answer.slopes[name]["by"] == "differences of simulations"
        assert answer.slopes[name]["error"] < 1e-3


def counted(function, calls):
    def called(*given, **named):
        calls.append(given)
        return function(*given, **named)

    return called


def test_it_agrees_with_our_own_model_and_its_exact_slopes(axis, sliding, rail):
    ours = rs.model(write_model(sliding)).estimate(rail, free=["M", "viscous-friction@axis.d"])
    theirs = rs.fmu(axis).estimate(rail, free=list(TRUE))
    for own, other in zip(ours.parameters.values(), theirs.parameters.values(), strict=True):
        assert other["value"] == pytest.approx(own["value"], rel=1e-4)
        assert other["std"] == pytest.approx(own["std"], rel=0.01)
        assert other["unit"] == own["unit"]


DERIVATIVES = """
    Model *m = c;
    (void)dv;
    for (size_t i = 0; i < n; ++i) {
        double y[2];
        for (int side = 0; side < 2; ++side) {
            double *v = (int)known[0] < RATES ? &m->x[known[0]] : (int)known[0] < OUTPUTS
                      ? &m->u[known[0] - INPUTS] : &m->p[known[0] - PARAMETERS], was = *v;
            double h = 1e-6 * (1.0 + fabs(was));
            *v = was + (side ? h : -h);
            fmi2GetReal(c, &unknown[i], 1, &y[side]);
            *v = was;
            if (side) du[i] = FACTOR * (y[1] - y[0]) / (2.0 * h);
        }
    }
    return k == 1 ? fmi2OK : fmi2Error;
"""


@pytest.mark.parametrize(
    ("factor", "by"),
    [("1.0", "directional derivatives"), ("2.0", "differences of simulations")],
)
def test_directional_derivatives_are_taken_where_they_are_right(factor, by, axis, rail, tmp_path):
    nothing = """
    (void)c; (void)unknown; (void)n; (void)known; (void)k; (void)dv; (void)du;
    return fmi2Error;
"""
    file = recompiled(
        axis,
        tmp_path / "derivatives.fmu",
        tmp_path,
        lambda source: source.replace(nothing, DERIVATIVES.replace("FACTOR", factor)),
        lambda description: description.replace(
            b"<ModelExchange ", b'<ModelExchange providesDirectionalDerivative="true" '
        ),
    )
    answer = rs.fmu(file).estimate(rail, free=list(TRUE))
    for name, value in TRUE.items():
        assert answer.slopes[name]["by"] == by
        assert answer.parameters[name]["value"] == pytest.approx(value, rel=0.01)


def test_a_rough_solver_gets_a_wide_step():
    def rough(value, noise):
        return np.sin(value + np.linspace(0.0, 6.0, 200))[:, None] + noise * np.sin(1e7 * value)

    smooth = chosen_step(lambda value: rough(value, 0.0), 2.0, 2.0, (-np.inf, np.inf))
    noisy = chosen_step(lambda value: rough(value, 1e-4), 2.0, 2.0, (-np.inf, np.inf))
    assert noisy.relative > smooth.relative
    assert noisy.error < 0.05
    # without noise a tiny step to one side is as good, and costs one simulation
    assert (smooth.one_sided, noisy.one_sided) == (True, False)
    assert smooth.error < 1e-4


def test_a_step_to_one_side_goes_down_where_there_is_no_room_above():
    tiny = Step(1e-6, 3.0, one_sided=True)
    tried = []

    def run(value):
        tried.append(value)
        return np.array([[value**2]])

    for upper in (9.0, 3.0):
        slope = tiny.slope(run, 3.0, np.array([[9.0]]), (0.0, upper))
        assert slope[0, 0] == pytest.approx(6.0, rel=1e-5)
    assert tried[0] > 3.0 > tried[1] and len(tried) == 2


def test_what_runs_away_has_no_slope_and_what_is_left_keeps_its_own():
    def runs_away(value):
        return np.array([[value**2, np.inf], [2.0 * value, -np.inf]])

    both = central(runs_away, 3.0, 1e-3, (-np.inf, np.inf))
    assert both[:, 0] == pytest.approx([6.0, 2.0], rel=1e-3)
    assert np.isnan(both[:, 1]).all()

    def ends(value):
        return np.array([[value if value <= 1.0 else np.inf]])

    assert np.isnan(central(ends, 1.0, 1e-3, (1.0, 9.0))).all()  # neither side is left
    assert central(ends, 1.0, 1e-3, (0.0, 9.0)) == pytest.approx(1.0)


def test_an_fmu_whose_reset_changes_nothing_is_refused(axis, rail, tmp_path):
    file = recompiled(
        axis,
        tmp_path / "worn.fmu",
        tmp_path,
        lambda source: source.replace(
            "fmi2Reset(fmi2Component c) { reset(c);",
            "fmi2Reset(fmi2Component c) { static double wear; reset(c);"
            " ((Model *)c)->x[1] = (wear = 1.7 - 1.3 * wear); ((Model *)c)->begun[1] = 1;",
        ),
        without_state,
    )
    with pytest.raises(BadInput, match=r"parameter 'M': its slope is another one at every step"):
        rs.fmu(file).estimate(rail, free=["M"])


def test_bounds_are_those_of_the_fmu(axis, rail, tmp_path):
    file = rewritten(
        axis,
        tmp_path / "bounded.fmu",
        xml=lambda text: text.replace(
            b'<Real start="95.0"', b'<Real min="90" max="100" start="95.0"'
        ),
    )
    answer = rs.fmu(file).estimate(rail, free=["M"])
    assert answer.parameters["M"]["value"] == 100.0
    assert answer.parameters["M"]["at_bound"] and not answer.converged


@pytest.mark.parametrize("kind", ["exchange", "own solver"])
def test_what_is_kept_for_validation_goes_on_where_the_record_was_parted(
    kind, axis, sliding, tmp_path
):
    parted = recorded(sliding, {"M": 110.0, "viscous-friction@axis.d": 40.0}, notes=("split: 0.6",))
    answer = rs.fmu(changed(axis, tmp_path, kind)).estimate(parted, free=list(TRUE))
    assert answer.held_out_rmse["velocity"] == pytest.approx(1e-3, rel=0.3)


def test_only_parameters_are_offered(axis, rail):
    model = rs.fmu(axis)
    assert set(model.parameters) == set(TRUE)
    with pytest.raises(BadInput, match=r"'viscous_friction_axis.c': .* did you mean 'viscous_fri"):
        model.estimate(rail, free=["viscous_friction_axis.c"])
    with pytest.raises(BadInput, match=r"'force': is of the kind 'input' .* there are M, viscous"):
        model.estimate(rail, free=["force"])
    with pytest.raises(BadInput, match=r"free: is missing: say which .* there are M, viscous"):
        model.estimate(rail)
    with pytest.raises(BadInput, match=r"method 'kalman': needs equations"):
        model.estimate(rail, free=["M"], method="kalman")


@pytest.fixture(scope="module")
def rubbing(sliding, tmp_path_factory):
    """The rail with dry friction that no model has, as a file."""
    model = sliding.with_effect("coulomb-friction", "axis", {"tau_c": 20.0})
    file = tmp_path_factory.mktemp("record") / "rail.csv"
    write_record(recorded(model, {"M": 110.0, "viscous-friction@axis.d": 40.0}, n=1200), file)
    return str(file)


def answer_of(capfd, *words):
    assert run([*words, "--json"]) == DONE
    return json.loads(capfd.readouterr().out)


def test_what_was_estimated_is_a_model_file(axis, rail, tmp_path, capfd):
    record, file = str(tmp_path / "rail.csv"), str(tmp_path / "fitted.yaml")
    write_record(rail, record)
    told = answer_of(
        capfd, "estimate", str(axis), record, "--free", f"{','.join(TRUE)}", "--out", file
    )
    assert told["model_file"] == file
    again = answer_of(capfd, "estimate", file, record, "--out", str(tmp_path / "again.yaml"))
    for name, value in told["parameters"].items():
        assert again["parameters"][name]["value"] == pytest.approx(value["value"], rel=1e-5)
    compared = answer_of(capfd, "compare", file, record)
    assert compared["outputs"]["velocity"]["rmse"] == pytest.approx(
        told["outputs"]["velocity"]["rmse"], rel=1e-3
    )


def test_an_effect_that_was_added_is_estimated_beside_the_parameters(
    axis, rubbing, tmp_path, capfd
):
    known, better, last = (str(tmp_path / f"{name}.yaml") for name in ("known", "better", "last"))
    rs.fmu(axis).with_values(**{"M": 112.0, "viscous_friction_axis.d": 41.0}).save(known)
    improved = answer_of(
        capfd, "improve", known, rubbing, "--add", "coulomb-friction@v", "--out", better
    )
    assert improved["history"][1]["error"] < 0.5 * improved["history"][0]["error"]
    free = ",".join([*TRUE, "coulomb-friction@v.tau_c"])
    told = answer_of(capfd, "estimate", better, rubbing, "--free", free, "--out", last)
    values = {name: entry["value"] for name, entry in told["parameters"].items()}
    assert values["M"] == pytest.approx(110.0, rel=0.01)
    assert values["viscous_friction_axis.d"] == pytest.approx(40.0, rel=0.03)
    assert values["coulomb-friction@v.tau_c"] * values["M"] == pytest.approx(20.0, rel=0.03)
    assert rs.fmu(last).effects == ("coulomb-friction@v",)


def test_an_effect_on_the_path_of_an_output_is_added_to_one_that_simulates_itself(
    axis, rail, tmp_path
):
    model = rs.fmu(changed(axis, tmp_path, "own solver")).with_values(
        **{"M": 110.0, "viscous_friction_axis.d": 40.0}
    )
    shifted = rail.channels | {"velocity": rail.channels["velocity"] + 0.05}
    record = Record(shifted, rail.units, DT, source="rail")
    better = model.improve(record, add="output-offset@velocity").model
    (offset,) = [p for name, p in better.parameters.items() if "output-offset" in name]
    assert abs(offset.value) == pytest.approx(0.05, rel=0.05)


def test_a_file_that_names_an_fmu_is_held_to_what_the_fmu_says(axis, rail, tmp_path, capfd):
    file = tmp_path / "named.yaml"
    write_record(rail, tmp_path / "rail.csv")
    for parameters, says in (
        ("{Mm: {value: 1}}", "line 2, column 14: parameters 'Mm': the FMU has no parameter"),
        ("{M: {value: 1, unit: g}}", "unit is 'g' in the file and 'kg' in the FMU"),
    ):
        file.write_text(f"fmu: {axis}\nparameters: {parameters}\n")
        assert run(["compare", str(file), str(tmp_path / "rail.csv")]) == BAD_INPUT
        assert says in capfd.readouterr().err
    file.write_text(f"fmu: {axis}\nparameters: {{M: {{value: 110, unit: kg}}}}\n")
    assert run(["export", str(file), "--to", "c", "--out", str(tmp_path / "x.c")]) == BAD_INPUT
    assert "named.yaml, line 1, column 1: fmu: the model is an FMU" in capfd.readouterr().err


def test_only_named_parameters_of_our_own_models_are_estimated(sliding, rail):
    model = rs.model(write_model(sliding))
    answer = model.estimate(rail, free="M")
    assert list(answer.parameters) == ["M"]
    assert answer.model.parameters["viscous-friction@axis.d"].value == 25.0
    with pytest.raises(BadInput, match=r"free 'm': .* did you mean 'M'"):
        model.estimate(rail, free=["m"])


def test_a_wrong_parameter_of_its_own_is_told_and_no_effect(axis, sliding):
    heavy = recorded(sliding, {"M": 110.0, "viscous-friction@axis.d": 25.0})
    found = rs.fmu(axis).explain(heavy, effects=["output-lag", "output-offset"])
    (held,) = found.to_dict()["held_values"]
    assert (held["name"], held["held"], held["unit"]) == ("M", 95.0, "kg")
    assert held["value"] == pytest.approx(110.0, rel=0.01)
    assert found.verdict == "adequate"


def test_improve_frees_its_own_parameters_beside_effects(axis, rubbing):
    improved = rs.fmu(axis).improve(
        rubbing, free=list(TRUE), effects=["coulomb-friction", "output-offset"]
    )
    values = improved.model.parameters
    assert improved.model.effects == ("coulomb-friction@v",)
    for name, truth in TRUE.items():
        assert values[name].value == pytest.approx(truth, rel=0.02)
    assert values["coulomb-friction@v.tau_c"].value == pytest.approx(20.0 / 110.0, rel=0.02)
    with pytest.raises(BadInput, match=r"'force': is of the kind 'input'"):
        rs.fmu(axis).improve(rubbing, free=["force"])
