"""What engineers write into a model: tables, cases, constants, names for formulas; beside plain Python, or refused."""

import math
from itertools import pairwise

import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import BadModel, NotIdentifiable
from residuum.identification.physics import Experiment, Simulator, read_model
from residuum.identification.physics.files.expression import evaluate, parse
from residuum.identification.physics.files.model_file import write_model

TANK = """
name: pumped tank
inputs: {speed: 1/s}
states: {h: {unit: m}}
parameters: {A: {value: 2.0, unit: m**2}, c: {value: 0.1, unit: m**2, lower: 0}, top: {value: 0.9, unit: m**3/s, lower: 0}}
constants: {g: 9.81 m/s**2, low: 0.1 m}
let:
  v: sqrt(2 * g * max(h, 0))
  outflow: c * v
balances:
  tank:
    kind: volume
    storage: A * der(h)
    terms:
      pump: table(speed, [0, 10, 25, 50], [0, 0.1, 0.4, top])
      valve: where(speed > 5 or h < -low, -outflow, -0.5 * outflow)
    level: h
outputs: {level: {value: h, unit: m}, angle: {value: "atan2(h, low)"}}
initial: {h: 0.5}
"""


def driven(n=400):
    return np.repeat(np.random.default_rng(0).uniform(-5.0, 60.0, n // 20), 20)[:, None]


def run(model, U, slopes=()):
    experiment = Experiment(U, np.full((len(U), 2), np.nan), np.zeros(2), 0.1)
    return Simulator(model).run(experiment, slopes=slopes)


def reference(U, top=0.9, c=0.1, steps=200):
    """By the midpoint rule, in plain Python."""

    def rate(h, speed):
        out = c * math.sqrt(2 * 9.81 * max(h, 0.0)) * (1.0 if speed > 5 else 0.5)
        return (np.interp(speed, [0, 10, 25, 50], [0, 0.1, 0.4, top]) - out) / 2.0

    h, step, seen = 0.5, 0.1 / steps, []
    for (speed,) in U:
        seen.append((h, math.atan2(h, 0.1)))
        for _ in range(steps):
            h += step * rate(h + 0.5 * step * rate(h, speed), speed)
    return np.array(seen)


def test_tables_cases_and_names_for_formulas_are_simulated_as_they_are_meant():
    U = driven()
    assert np.abs(run(read_model(TANK), U).Y - reference(U)).max() < 1e-5


def test_a_value_of_a_table_has_exact_slopes_and_is_estimated():
    model, U = read_model(TANK), driven()
    moved = run(model, U, slopes=("top", "c"))
    for k, name in enumerate(("top", "c")):
        h = 1e-6 * model.values[name]
        up, down = (
            run(model.with_values({name: model.values[name] + s * h}), U).Y for s in (1, -1)
        )
        assert moved.dY[:, :, k] == pytest.approx((up - down) / (2 * h), abs=1e-4)
    y = reference(U, top=1.2, c=0.12)[:, 0] + 0.002 * np.random.default_rng(1).standard_normal(
        len(U)
    )
    record = rs.Record({"speed": U[:, 0], "level": y}, {"speed": "1/s", "level": "m"}, 0.1)
    found = rs.Model(model).estimate(record).parameters
    assert found["top"]["value"] == pytest.approx(1.2, rel=0.01) and found["c"][
        "value"
    ] == pytest.approx(0.12, rel=0.01)


def test_a_written_model_is_the_same():
    model, U = read_model(TANK), driven(60)
    again = read_model(write_model(model))
    assert again.parameters["g"].fixed and again.parameters["g"].unit == "m/s**2"
    assert np.array_equal(run(again, U).Y, run(model, U).Y)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("table(x, [0, 1, 3], [0, 10, -10])", 5.0),
        ("table(9, [0, 1, 3], [0, 10, -10])", -10.0),
        ("where(x > 0.4 and not x > 1, 2, 3)", 2.0),
        ("where((x + 1) * 2 < 2 or (x == 0.5), 2, 3)", 2.0),
        ("where((x > 1 or x < -1), 2, 3)", 3.0),
        ("mod(-7, 3) + floor(-x) + hypot(3, 4)", 6.0),
    ],
)
def test_an_expression_has_the_value_that_is_meant(text, value):
    assert evaluate(parse(text).tree, {"x": 0.5}) == value


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[0, 10, 25, 50]", "[0, 25, 10, 50]", "must be numbers that rise"),
        ("[0, 10, 25, 50]", "[0, 10, c, 50]", "must be numbers that rise"),
        ("[0, 10, 25, 50]", "[0, 10, 50]", "3 places and 4 values"),
        ("speed > 5 or h < -low", "speed", "a condition compares two values"),
        ("speed > 5 or h < -low", "speed > h", "unit clash: '>'"),
        ("-0.5 * outflow", "-0.5 * h", "unit clash: 'where()'"),
        ("[0, 0.1, 0.4, top]", "[0, 0.1, h, top]", "unit clash: 'table()'"),
        ("v: sqrt(2 * g * max(h, 0))", "v: sqrt(2 * g * v)", "'v' is defined by itself"),
        ("low: 0.1 m}", "low: 0.1 m, h: 1 m}", "'h' is declared in states already"),
        ("low: 0.1 m}", "low: much m}", "constant 'low'"),
        (
            'angle: {value: "atan2(h, low)"}',
            'angle: {value: "(h > low) * 2"}',
            "'>' is not expected|is missing",
        ),
    ],
)
def test_refusals_say_what_and_where(old, new, says):
    assert old in TANK
    with pytest.raises(
        BadModel, match=r"line \d+, column \d+: .*(" + says.replace("()", r"\(\)") + ")"
    ):
        read_model(TANK.replace(old, new))


def nested(levels, start=0.1):
    """A model whose definitions name each other so often that its text, written out, would have 5^levels names."""
    let = {"f_0": f"q + {start} * k * u"} | {
        f"f_{n}": f"where(f_{n - 1} > 1, 1.1 * sqrt(f_{n - 1}), f_{n - 1} + 0.1 * f_{n - 1} * f_{n - 1})"
        for n in range(1, levels + 1)
    }
    lines = "\n".join(f"  {name}: {text}" for name, text in let.items())
    return f"""
name: nested
inputs: {{u: "1"}}
states: {{q: {{unit: "1"}}}}
parameters: {{T: {{value: 2.0, unit: s, lower: 0.01}}, k: {{value: 1.5}}}}
let:
{lines}
balances: {{store: {{kind: signal, storage: T * der(q), terms: {{in: u, out: -f_{levels}}}}}}}
outputs: {{a: {{value: f_{levels} * q}}, b: {{value: q}}}}
initial: {{q: 0.2}}
"""


def nested_reference(levels, U, k=1.5, start=0.1):
    def f(q, u):
        value = q + start * k * u
        for _ in range(levels):
            value = 1.1 * math.sqrt(value) if value > 1 else value + 0.1 * value * value
        return value

    def rate(q, u):
        return (u - f(q, u)) / 2.0

    q, steps, seen = 0.2, 400, []
    for (u,) in U:
        seen.append((f(q, u) * q, q))
        for _ in range(steps):
            q += 0.1 / steps * rate(q + 0.05 / steps * rate(q, u), u)
    return np.array(seen)


def test_definitions_that_name_each_other_need_not_be_written_out():
    """Written out, they have a hundred thousand characters, and SymPy would look at each."""
    U = driven(100) / 60.0
    model = read_model(nested(6))
    moved = run(model, U, slopes=("k", "T"))
    assert np.abs(moved.Y - nested_reference(6, U)).max() < 1e-5
    h = 1e-5
    higher, lower = (run(model.with_values({"k": 1.5 + d}), U).Y for d in (h, -h))
    slopes = (higher - lower) / (2.0 * h)
    assert np.abs(moved.dY[:, :, 0] - slopes).max() < 1e-5 * np.abs(slopes).max()


def test_a_written_model_keeps_what_its_long_texts_name():
    U, text = driven(40) / 60.0, write_model(read_model(nested(6)))
    again = read_model(text)
    assert len(text) < 20_000 and write_model(again) == text
    assert np.array_equal(run(again, U).Y, run(read_model(nested(6)), U).Y)


def test_models_that_differ_in_a_definition_alone_differ():
    U = driven(40) / 60.0
    other = run(read_model(nested(6, start=0.3)), U).Y
    assert np.abs(other - nested_reference(6, U, start=0.3)).max() < 1e-5
    assert np.abs(other - run(read_model(nested(6)), U).Y).max() > 1e-3


def test_a_part_whose_text_would_be_too_long_is_refused(tmp_path):
    (tmp_path / "inner.yaml").write_text(nested(6), encoding="utf-8")
    outer = tmp_path / "outer.yaml"
    outer.write_text(
        'name: outer\nuse: {a: inner.yaml}\noutputs: {y: {value: a_b, unit: "1"}}\n',
        encoding="utf-8",
    )
    with pytest.raises(BadModel, match=r"inner.yaml, line \d+, column \d+: too long for a part"):
        rs.model(outer)


REACTOR = """
name: emptying vessel of gas
inputs: {u: "1"}
states: {p: {unit: bar, start: 3}}
parameters: {T: {value: 5, unit: s, lower: 0.1}}
constants: {bar: 1 bar}
balances: {gas: {kind: signal, storage: T * der(p), terms: {in: u * bar, out: -p}}}
outputs: {y: {value: log(p / bar)}}
"""


def test_a_state_begins_its_estimation_where_its_file_says():
    """A logarithm of 0 is no number: no descent leaves it."""
    model = read_model(REACTOR)
    t, true = 0.1 * np.arange(200), 4.0
    y = np.log(1.0 + (true - 1.0) * np.exp(-t / 7.0))
    record = rs.Record({"u": np.ones(200), "y": y}, {"u": "1", "y": "1"}, 0.1)
    found = rs.Model(model).estimate(record)
    assert found.parameters["T"]["value"] == pytest.approx(7.0, rel=1e-3)
    assert read_model(write_model(model)).states["p"].start == 3.0
    with pytest.raises(NotIdentifiable, match="diverges"):
        rs.model(REACTOR.replace(", start: 3", "")).estimate(record)


def test_definitions_that_grow_without_end_are_refused():
    with pytest.raises(
        BadModel, match=r"line \d+, column \d+: with its definitions .* make a state"
    ):
        read_model(nested(12))


def test_the_cases_of_a_table_cover_every_place():
    """The straight pieces meet at the knots."""
    places, values = [0.0, 1.0, 4.0], [2.0, 3.0, 0.0]
    written = parse(f"table(x, {places}, {values})").tree
    for (left, right), (a, b) in zip(pairwise(places), pairwise(values), strict=True):
        assert evaluate(written, {"x": left}) == a and evaluate(written, {"x": right}) == b
        assert evaluate(written, {"x": (left + right) / 2}) == pytest.approx((a + b) / 2)


LONG = """
name: many losses
inputs: {{F: N}}
states: {{v: {{unit: m/s}}}}
parameters: {{c: {{value: 1, unit: N*s/m}}, m: {{value: 1, unit: kg}}}}
balances:
  b: {{kind: force, storage: m * der(v), terms: {{drive: F, losses: {text}}}, velocity: v}}
outputs: {{v: {{value: v, unit: m/s}}}}
"""


def test_a_long_row_of_terms_is_refused_with_a_way_on_that_works():
    text = "-c * v" + " - c * v" * 199
    model = read_model(LONG.format(text=text))
    assert Simulator(model).x0().shape == (1,)
    with pytest.raises(BadModel, match=r"more than 200 terms .* in a row; put parts of them in"):
        read_model(LONG.format(text=text + " - c * v"))
    read_model(LONG.format(text=f"({text}) - (c * v)"))
    with pytest.raises(BadModel, match=r"in 2[0-9][0-9] levels"):
        read_model(LONG.format(text=f"({text})" + " - c * v" * 30))
