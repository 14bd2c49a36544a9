"""A question's fields are in every door, with the same default, bounds and help; a field more is there with no other edit."""

import inspect
from importlib import import_module

import pytest
from typer.main import get_command

import residuum as rs
from residuum.identification.errors import BadInput
from residuum.library.questions import Question, asks, choices, field, help_of
from residuum.library.questions.compare import Compare
from residuum.library.questions.control_design import DesignController
from residuum.library.questions.estimate import Estimate
from residuum.library.questions.identify import Identify
from residuum.library.questions.missing_effect import Explain, Improve
from residuum.library.questions.residual import DesignResidual, RunResidual
from residuum.library.questions.simulate import Simulate
from residuum.library.questions.uncertainty import Uncertainty
from residuum.service.app import create_app
from residuum.service.commands import asked as options
from residuum.service.settings import Settings

DOORS = {
    Identify: ("identify", "identify", rs.identify),
    Estimate: ("estimate", "models/{model}/estimate", rs.Model.estimate),
    Compare: ("compare", "models/{model}/compare", rs.Model.compare),
    Explain: ("explain", "models/{model}/explain", rs.Model.explain),
    Improve: ("improve", "models/{model}/improve", rs.Model.improve),
    DesignController: ("control design", "control-designs", rs.control.design),
    DesignResidual: ("residual design", "residuals", rs.residual),
    RunResidual: ("residual run", "residuals", rs.Residual.run),
    Uncertainty: ("uncertainty", "models/{model}/uncertainty", rs.uncertainty),
    Simulate: ("simulate", "records/simulations", rs.simulate),
}
"""Question → command, route, function of the library."""


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    return create_app(Settings(data=tmp_path_factory.mktemp("data"))).openapi()


def body_of(described, path):
    if "get" in described["paths"][path]:
        keys = [
            key for key in described["paths"][path]["get"]["parameters"] if key["in"] == "query"
        ]
        return {
            "properties": {
                key["name"]: key["schema"] | {"description": key["description"]} for key in keys
            }
        }
    content = described["paths"][path]["post"]["requestBody"]["content"]["application/json"][
        "schema"
    ]
    return described["components"]["schemas"][content["$ref"].rsplit("/", 1)[1]]


@pytest.mark.parametrize("question", DOORS)
def test_a_field_is_an_option_a_key_and_a_keyword(question, described):
    command, path, function = DOORS[question]
    module, *verb = command.split()
    asked = get_command(import_module(f"residuum.service.commands.{module}").app)
    shown = {p.name: p for p in (asked.commands[verb[0]] if verb else asked).params}
    body, keywords = body_of(described, f"/api/v1/{path}"), inspect.signature(function).parameters
    for name, declared in question.model_fields.items():
        default = inspect.Parameter.empty if declared.is_required() else declared.default
        assert keywords[name].default == default
        assert " ".join(help_of(declared).split()) in " ".join(function.__doc__.split())
        assert shown[name].help.replace("\\[", "[").startswith(help_of(declared))
        if isinstance(default, bool) or (
            declared.default not in (None, {}) and not declared.is_required()
        ):
            assert str(shown[name].default) == str(default)
        key = body["properties"][name]
        assert key.get("default", None) == (None if declared.is_required() else default)
        assert key["description"] == declared.description and key.get("enum", []) == choices(
            declared
        )
        assert (name in body.get("required", ())) == declared.is_required()


@pytest.mark.parametrize("question", [Compare, Estimate])
def test_effects_of_ones_own_for_reading_a_model_are_the_commands_own(question, described):
    """Over HTTP and in Python a model is read before it is asked, and brings its own."""
    command, path, function = DOORS[question]
    shown = get_command(import_module(f"residuum.service.commands.{command}").app).params
    assert "catalogue" in [p.name for p in shown] and "catalogue" not in question.model_fields
    assert "catalogue" not in {
        **inspect.signature(function).parameters,
        **body_of(described, f"/api/v1/{path}")["properties"],
    }


class Weigh(Question):
    """A question of this test."""

    scale: str = field("grams", "What is weighed in.", choices=("grams", "ounces"))
    times: int = field(1, "How often.", ge=1, le=9)
    quick: bool = field(False, "Do not wait.")


def test_a_question_reads_and_refuses_alike_for_every_door():
    @asks(Weigh)
    def weigh(thing: str, *, progress: bool = False, **given: object) -> Weigh:
        """Weigh.

        Parameters
        ----------
        thing : str
        progress : bool
        """
        return Weigh.of(given)

    @options.asks(without=("quick",))
    def command(thing: str, asked: Weigh) -> Weigh:
        """Weigh."""
        return asked

    assert list(inspect.signature(weigh).parameters) == [
        "thing",
        "scale",
        "times",
        "quick",
        "progress",
    ]
    assert "times : int\n    How often. Must be ≥ 1 and ≤ 9." in weigh.__doc__
    assert list(inspect.signature(command).parameters) == ["thing", "scale", "times"]
    assert command(thing="salt", scale="ounces", times="3") == weigh(
        "salt", scale="ounces", times=3
    )
    with pytest.raises(
        BadInput, match=r"^scale 'gram': there is none of this name; did you mean 'grams'\?"
    ):
        weigh("salt", scale="gram")
    with pytest.raises(BadInput, match=r"^times 10: must be ≤ 9"):
        command(thing="salt", scale="grams", times="10")
    with pytest.raises(
        BadInput, match=r"^'scalee': there is none of this name; did you mean 'scale'\?"
    ):
        weigh("salt", scalee="grams")
