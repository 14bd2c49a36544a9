"""Choosing and setting up a diagnoser on the command line."""

from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.diagnosis.diagnosers import DIAGNOSERS, diagnoser_class
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.identification.errors import BadInput

DiagnoserName = Annotated[
    str, typer.Argument(metavar="DIAGNOSER", help=f"One of {', '.join(DIAGNOSERS)}.")
]
SpeedRpm = Annotated[
    float | None,
    typer.Option(help="bearing: shaft speed [rpm], when the record has no speed channel."),
]
Orders = Annotated[
    str | None,
    typer.Option(
        metavar="bpfi=5.4,…", help="bearing: fault frequencies in multiples of shaft speed."
    ),
]
Hertz = Annotated[
    str | None, typer.Option(metavar="bpfi=118.9,…", help="bearing: fault frequencies [Hz].")
]
Method = Annotated[
    str | None,
    typer.Option(
        metavar="source|default",
        help="gate-actuator, robust-residual: the method that decides. Every finding shows both.",
    ),
]

ModelName = Annotated[
    str | None,
    typer.Option("--model", metavar="MODEL", help="model-based: a model file or a built-in model."),
]
FixUndetermined = Annotated[
    bool,
    typer.Option(
        "--fix-undetermined",
        help=(
            "model-based: keep the file's value of a parameter that the healthy records do not"
            " determine."
        ),
    ),
]
Baseline = Annotated[Path | None, typer.Option(help="A trained diagnoser, as `train` writes it.")]
FalseAlarms = Annotated[
    float | None, typer.Option(help="model-based: number of false alarms a day that is accepted.")
]


def model_settings(
    model: str | None, fix_undetermined: bool, false_alarms_per_day: float | None
) -> dict[str, Any]:
    """The settings given for `model-based`, as the diagnoser's keyword arguments; only those that
    were given.
    """
    given = {
        "model": model,
        "fix_undetermined": fix_undetermined or None,
        "false_alarms_per_day": false_alarms_per_day,
    }
    return {name: value for name, value in given.items() if value is not None}


def diagnoser_settings(
    speed_rpm: float | None, orders: str | None, hertz: str | None, method: str | None
) -> dict[str, Any]:
    """The settings given for a diagnoser, by name; only those that were given."""
    given: dict[str, Any] = {
        "speed_rpm": speed_rpm,
        "orders": _frequencies("--orders", orders),
        "hertz": _frequencies("--hertz", hertz),
    }
    given["method"] = method
    return {name: value for name, value in given.items() if value is not None}


def new_diagnoser(name: str, settings: dict[str, Any]) -> Diagnoser:
    """An untrained diagnoser; settings that only a bearing or a model has are refused for the
    others.
    """
    for setting in settings:
        owner = "model-based" if setting in _OF_MODELS else "bearing"
        if name != owner and setting != "method":
            raise BadInput(
                f"option --{setting.replace('_', '-')}: only the {owner} diagnoser has it, not"
                f" {name!r}"
            )
    of_class = {setting: value for setting, value in settings.items() if setting in _OF_MODELS}
    tuning = {setting: value for setting, value in settings.items() if setting not in _OF_MODELS}
    return diagnoser_class(name)(**of_class).with_settings(**tuning)


_OF_MODELS = ("model", "fix_undetermined", "false_alarms_per_day")


def _frequencies(option: str, text: str | None) -> dict[str, float] | None:
    if text is None:
        return None
    frequencies: dict[str, float] = {}
    for item in text.split(","):
        name, _, number = item.partition("=")
        try:
            frequencies[name.strip().lower()] = float(number)
        except ValueError:
            raise BadInput(f"option {option} {item!r}: must be name=number") from None
    return frequencies
