"""An effect of a user's own is everywhere where the catalogue is."""

import json

import numpy as np
import pytest

import residuum as rs
from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.effects.base import Contribution, Effect, Parameter
from residuum.identification.physics.effects.example_models import axis_example
from residuum.service.cli import DONE, run


class CubicDrag(Effect):
    id = "cubic-drag"
    title = "Cubic drag"
    equation = "−c·v³"
    reference = "made up for a test"
    acts_on = ("torque", "force")
    needs = ("velocity",)
    sizes = ("c",)

    def parameters(self, site):
        return (
            Parameter(
                "c", 0.0, site.per("velocity", 3), lower=0.0, meaning="drag per velocity cubed"
            ),
        )

    def contribution(self, scene):
        return Contribution(term=-scene.p["c"] * scene["velocity"] ** 3)

    def starts(self, conditions):
        return [{"c": 0.1 * conditions.magnitude / conditions.largest("velocity") ** 3}]

    def examples(self):
        return [axis_example()]


@pytest.fixture
def catalogue():
    yield rs.effects
    EFFECTS._added.clear()
    EFFECTS._fingerprints.clear()


def pushed(model):
    rng = np.random.default_rng(3)
    force = np.repeat(rng.uniform(-300.0, 300.0, 40), 50)
    record = rs.from_arrays({"force": force}, units={"force": "N"}, sample_time=0.01)
    out = model.simulate(record)
    noisy = {name: out[name] + 1e-3 * rng.standard_normal(record.n) for name in out.names}
    return rs.from_arrays(
        {"force": force, **noisy}, units={"force": "N", **model.outputs}, sample_time=0.01
    )


def test_an_added_effect_is_listed_named_sized_and_written(catalogue, capsys, tmp_path):
    before = len(catalogue)
    catalogue.add(CubicDrag)
    assert len(catalogue) == before + 1 and "cubic-drag" in catalogue
    assert run(["effects", "--json"]) == DONE
    assert "cubic-drag" in [
        entry["effect"] for entry in json.loads(capsys.readouterr().out)["effects"]
    ]
    truth = rs.model("linear-axis").with_values(M=95.0).with_effect("cubic-drag", "axis", c=60.0)
    record = pushed(truth)
    why = rs.model("linear-axis").explain(
        record, effects=["cubic-drag", "viscous-friction", "linear-spring"]
    )
    assert why.best.effect == "cubic-drag" and why.best.parameters["c"].value == pytest.approx(
        60.0, rel=0.05
    )
    truth.save(tmp_path / "axis.yaml")
    assert rs.model(tmp_path / "axis.yaml").effects == ("cubic-drag@axis",)


def test_another_equation_under_the_same_id_is_another_kernel(catalogue):
    force = rs.from_arrays({"force": np.full(200, 100.0)}, units={"force": "N"}, sample_time=0.01)

    def last():
        model = (
            rs.model("linear-axis").with_values(M=95.0).with_effect("cubic-drag", "axis", c=60.0)
        )
        return float(model.simulate(force)["velocity"][-1])

    catalogue.add(CubicDrag)
    cubic = last()

    class Linear(CubicDrag):
        def contribution(self, scene):
            return Contribution(term=-scene.p["c"] * scene["velocity"] * sp.S.One)

    catalogue.add(Linear)
    assert last() != pytest.approx(cubic, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"id": "backlash"}, "the catalogue has one of this id"),
        ({"id": "Cubic Drag"}, "must be small letters, digits and '-'"),
    ],
)
def test_a_bad_effect_is_refused(catalogue, change, says):
    with pytest.raises(rs.BadModel, match=says):
        catalogue.add(type("Bad", (CubicDrag,), change))
    with pytest.raises(rs.BadModel, match="must be an Effect"):
        catalogue.add("cubic-drag")
