"""Maps of two places, smooth tables and tables in files: beside SciPy's interpolators, and a turbine from the literature."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

import residuum as rs
from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, Simulator, read_model
from residuum.identification.physics.files.expression import evaluate, parse
from residuum.identification.physics.files.model_file import write_model

TURBINE = """
name: wind turbine
inputs: {wind: m/s, pitch: deg, generator: N*m}
states: {w: {unit: rad/s}}
parameters: {J: {value: 4.4e7, unit: kg*m**2, lower: 1e6}, R: {value: 63, unit: m, fixed: true}}
constants: {rho: 1.225 kg/m**3, pi: 3.141592653589793}
let:
  lambda: w * R / max(wind, 1)
  power: 0.5 * rho * pi * R**2 * wind**3 * table(lambda, pitch, cp.csv)
balances:
  rotor: {kind: torque, storage: J * der(w), terms: {wind: power / max(w, 0.1), generator: -generator}, velocity: w}
outputs: {speed: {value: w, unit: rad/s}}
"""
LAMBDA, PITCH = np.linspace(2.0, 14.0, 9), np.array([0.0, 4.0, 8.0, 14.0, 20.0])


def power_coefficient(tip_speed, pitch):
    """S. Heier, *Grid Integration of Wind Energy Conversion Systems*, 1998."""
    i = 1.0 / (1.0 / (tip_speed + 0.08 * pitch) - 0.035 / (pitch**3 + 1.0))
    return 0.5176 * (116.0 / i - 0.4 * pitch - 5.0) * np.exp(-21.0 / i) + 0.0068 * tip_speed


CP = power_coefficient(LAMBDA[:, None], PITCH[None, :])


@pytest.fixture
def turbine(tmp_path):
    rows = [["lambda", *PITCH], *([a, *row] for a, row in zip(LAMBDA, CP, strict=True))]
    (tmp_path / "cp.csv").write_text(
        "# lambda down, pitch across\n" + "\n".join(",".join(map(str, r)) for r in rows)
    )
    (tmp_path / "turbine.yaml").write_text(TURBINE)
    return tmp_path / "turbine.yaml"


def weather(n=600, seed=0):
    rng = np.random.default_rng(seed)
    wind = np.repeat(rng.uniform(7.0, 12.0, n // 20), 20)
    pitch = np.repeat(rng.uniform(0.0, 10.0, n // 20), 20)
    return np.column_stack([wind, pitch, np.repeat(rng.uniform(0.5e6, 2.5e6, n // 30), 30)])


def spun(U, drag=0.0, h=0.5):
    """By SciPy, each sample of held inputs by itself."""
    cp = RegularGridInterpolator((LAMBDA, PITCH), CP)

    def rate(t, w, wind, pitch, generator):
        place = np.clip([w[0] * 63 / wind, pitch], [LAMBDA[0], PITCH[0]], [LAMBDA[-1], PITCH[-1]])
        aero = 0.5 * 1.225 * np.pi * 63**2 * wind**3 * cp(place)[0] / max(w[0], 0.1)
        return [(aero - generator - drag * w[0] ** 2) / 4.4e7]

    w, seen = 1.0, []
    for u in U:
        seen.append(w)
        w = solve_ivp(rate, (0.0, h), [w], args=tuple(u), rtol=1e-9, atol=1e-10).y[0, -1]
    return np.array(seen)


def test_a_map_in_a_file_is_simulated_as_scipy_has_it(turbine):
    U, model = weather(300), rs.model(turbine).physical
    e = Experiment(U, np.full((300, 1), np.nan), np.zeros(3), 0.5)
    assert np.abs(Simulator(model).run(e, {"w": 1.0}, substeps=8).Y[:, 0] - spun(U)).max() < 1e-5
    again = read_model(write_model(model))  # a text by itself
    assert np.array_equal(
        Simulator(again).run(e, {"w": 1.0}).Y, Simulator(model).run(e, {"w": 1.0}).Y
    )


def test_a_map_s_values_and_places_have_exact_slopes():
    text = """
name: map
inputs: {a: "", b: ""}
states: {x: {unit: ""}}
parameters: {T: {value: 2, unit: s}, z: {value: 0.5}}
balances: {one: {kind: signal, storage: T * der(x), terms: {map: MAP, s: SMOOTH}}}
outputs: {x: {value: x}}
initial: {x: 0.5}
""".replace("MAP", '"table(x + a, b, [0, 1, 3], [0, 2], [[0, 1], [z, 2], [z, -1]])"').replace(
        "SMOOTH", '"table(x, [-1, 0, 1, 2], [1, z, -z, -2], cubic)"'
    )
    model, rng = read_model(text), np.random.default_rng(0)
    e = Experiment(rng.uniform(0.2, 1.8, (80, 2)), np.full((80, 1), np.nan), np.zeros(2), 0.1)
    run = Simulator(model).run(e, slopes=("z", "T"), substeps=2)
    for k, name in enumerate(("z", "T")):
        up, down = (
            Simulator(model).run(e, values={name: model.values[name] + s * 1e-6}, substeps=2).Y
            for s in (1, -1)
        )
        assert np.abs(run.dY[:, :, k] - (up - down) / 2e-6).max() < 1e-6


def test_a_smooth_table_is_fritsch_and_carlson_s():
    places, values = [0.0, 1.0, 1.5, 4.0, 5.0], [0.0, 0.2, 3.0, 3.1, -2.0]
    tree, known = (
        parse(f"table(x, {places}, {values}, cubic)").tree,
        PchipInterpolator(places, values),
    )
    for x in np.linspace(0.0, 5.0, 53):
        assert evaluate(tree, {"x": x}) == pytest.approx(float(known(x)), abs=1e-12)
    assert evaluate(tree, {"x": -3.0}) == 0.0 and evaluate(tree, {"x": 9.0}) == pytest.approx(-2.0)


def test_a_record_that_leaves_a_table_is_told(turbine):
    U = weather(300)
    U[100:130, 1] = 25.0
    names = {"wind": "m/s", "pitch": "deg", "generator": "N*m"}
    record = rs.Record(
        {**dict(zip(names, U.T, strict=True)), "speed": spun(U)}, {**names, "speed": "rad/s"}, 0.5
    )
    told = rs.model(turbine).estimate(record, hold="zero-order", anyway=True).to_dict()["warnings"]
    (line,) = (line for line in told if "leads pitch" in line)
    assert "to 25, which is there from 0 to 20" in line and "10 %" in line


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("table(wind, gone.csv)", "'gone.csv': cannot be read"),
        ("table(wind, [0, 1], [0, 1], square)", "'cubic'"),
        ("table(wind, pitch, [0, 1], [0, 1], [[0, 1]])", "2 places and 1 values"),
        ("table(wind, cp.csv)", "is expected after the values|is not expected|number, a name"),
    ],
)
def test_refusals_say_what_and_where(table, says, turbine):
    turbine.write_text(TURBINE.replace("table(lambda, pitch, cp.csv)", table))
    with pytest.raises(BadModel, match=r"line 9, column \d+: .*(" + says + ")"):
        rs.model(turbine)


def test_a_text_without_a_folder_says_so():
    with pytest.raises(BadModel, match="write the values as lists"):
        read_model(TURBINE)
