"""Choosing and setting up a diagnoser on the command line."""

from typing import Annotated, Any

import typer

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.identification.errors import BadInput

DiagnoserName = Annotated[str, typer.Argument(metavar="DIAGNOSER", help=f"One of {', '.join(DIAGNOSERS)}.")]
SpeedRpm = Annotated[float | None, typer.Option(help="bearing: shaft speed [rpm], when the record has no speed channel.")]
Orders = Annotated[str | None, typer.Option(metavar="bpfi=5.4,…", help="bearing: fault frequencies in multiples of shaft speed.")]
Hertz = Annotated[str | None, typer.Option(metavar="bpfi=118.9,…", help="bearing: fault frequencies [Hz].")]
Method = Annotated[
    str | None,
    typer.Option(metavar="source|default", help="gate-actuator, robust-residual: what decides; every finding shows both."),
]


def diagnoser_class(name: str) -> type[Diagnoser]:
    """The class of this name; BadInput lists the names there are."""
    if name not in DIAGNOSERS:
        raise BadInput(f"diagnoser {name!r}: there is none of this name; known are {', '.join(DIAGNOSERS)}")
    return DIAGNOSERS[name]


def diagnoser_settings(speed_rpm: float | None, orders: str | None, hertz: str | None, method: str | None) -> dict[str, Any]:
    """The settings given for a diagnoser, by name; only those that were given."""
    given: dict[str, Any] = {
        "speed_rpm": speed_rpm,
        "orders": _frequencies("--orders", orders),
        "hertz": _frequencies("--hertz", hertz),
    }
    given["method"] = method
    return {name: value for name, value in given.items() if value is not None}


def new_diagnoser(name: str, settings: dict[str, Any]) -> Diagnoser:
    """An untrained diagnoser; settings that only a bearing has are refused for the others."""
    of_bearing = [setting for setting in settings if setting != "method"]
    if of_bearing and name != "bearing":
        raise BadInput(f"option --{of_bearing[0].replace('_', '-')}: only the bearing diagnoser has it, not {name!r}")
    return diagnoser_class(name)().with_settings(**settings)


def _frequencies(option: str, text: str | None) -> dict[str, float] | None:
    if text is None:
        return None
    found: dict[str, float] = {}
    for item in text.split(","):
        name, _, number = item.partition("=")
        try:
            found[name.strip().lower()] = float(number)
        except ValueError:
            raise BadInput(f"option {option} {item!r}: must be name=number") from None
    return found
