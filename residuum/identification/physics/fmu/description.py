"""What an FMU says of itself, and whether it can run here; nothing of it is loaded."""

from __future__ import annotations

import math
import platform
import re
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from residuum.identification.errors import BadModel, in_one_line

ENDING = ".fmu"
_ARCHITECTURE = {"x86_64": "x86_64", "AMD64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
_SYSTEM = {
    "Linux": ("linux", "linux"),
    "Darwin": ("darwin", "darwin"),
    "Windows": ("windows", "win"),
}
"""System → its name in folders of FMI 3 and of FMI 2."""


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU: its name, value reference and unit."""

    name: str
    reference: int
    unit: str


@dataclass(frozen=True)
class Settable(Variable):
    """A parameter that may be set before a simulation: what the FMU says of it."""

    start: float
    lower: float
    upper: float
    nominal: float | None
    meaning: str


@dataclass(frozen=True)
class Way:
    """A way of running an FMU: the `identifier` of its library, whether an instance's state can be
    kept and brought back, and whether it gives directional derivatives.
    """

    identifier: str
    keeps_state: bool
    differentiates: bool


@dataclass(frozen=True)
class Description:
    """An FMU's description: real variables by what they are for, and the ways in which it can be
    run.

    `states` and `derivatives` are in one order; `events` counts event indicators. `exchange` and
    `simulation` are its ways of model exchange and co-simulation, None where it has no such way.
    `parameters` are those that may be set, fixed and tunable; `unsettable` says of each other
    variable what it is.
    """

    path: str
    name: str
    version: int
    guid: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    derivatives: tuple[Variable, ...]
    events: int
    exchange: Way | None
    simulation: Way | None
    parameters: Mapping[str, Settable] = field(default_factory=dict)
    unsettable: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_exchangeable(self) -> bool:
        """Whether rates can be asked of it at any point: it has model exchange, states, and no
        events to follow.
        """
        return self.exchange is not None and bool(self.states) and not self.events


def is_fmu(name: str | Path) -> bool:
    """Whether a model's name is that of an FMU."""
    return str(name).lower().endswith(ENDING)


def fmpy() -> Any:
    """The library that reads and loads FMUs."""
    try:
        return import_module("fmpy")
    except ImportError:
        raise BadModel("an FMU needs the extra `fmi`: pip install 'residuum[fmi]'") from None


def describe(path: str | Path) -> Description:
    """The description of an FMU that can run here.

    Raises
    ------
    BadModel
        No such file, not an FMU, FMI 1, without a library for this platform (those that it has are
        named), no output.
    """
    path = str(path)
    library = fmpy()
    if not Path(path).is_file():
        raise BadModel(f"model {path!r}: no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            held = archive.namelist()
        read = library.read_model_description(path, validate=False)
    except Exception as error:
        raise BadModel(f"model {path!r}: is not an FMU ({in_one_line(error)})") from None
    version = int(read.fmiVersion.split(".")[0])
    if version not in (2, 3):
        raise BadModel(f"model {path!r}: is of FMI {read.fmiVersion}; 2.0 and 3.0 are run")
    _check_platform(path, version, held)
    described = _description(path, version, read)
    if not described.outputs:
        raise BadModel(f"model {path!r}: has no real output; there is nothing to compare")
    return described


def _check_platform(path: str, version: int, held: Iterable[str]) -> None:
    system = platform.system()
    machine = _ARCHITECTURE.get(platform.machine(), platform.machine())
    of_three, of_two = _SYSTEM.get(system, (system.lower(), system.lower()))
    folder = f"{machine}-{of_three}" if version == 3 else f"{of_two}64"
    platforms = _platforms(held)
    # linux64 of FMI 2 is x86-64: on another processor that folder does not help.
    if folder in platforms and (version == 3 or machine == "x86_64"):
        return
    has = "sources only" if _has_sources(held) else "no library"
    if platforms:
        has = f"libraries for {', '.join(platforms)}"
    remedy = "compile it with its sources, or export it" if _has_sources(held) else "export it"
    raise BadModel(
        f"model {path!r}: has {has}, none for {folder}, which this platform needs; {remedy} for"
        f" {folder}"
    )


def _platforms(held: Iterable[str]) -> list[str]:
    """Folders of `binaries/` that hold a file."""
    paths = [name.split("/") for name in held if name.startswith("binaries/")]
    # an entry of a folder itself ends with a slash: its last part is empty
    return sorted({path[1] for path in paths if len(path) > 2 and path[-1]})


def _has_sources(held: Iterable[str]) -> bool:
    return any(name.startswith("sources/") for name in held)


def _description(path: str, version: int, read: Any) -> Description:
    reals = [v for v in read.modelVariables if _is_real_scalar(v)]
    # In the order of the FMU's own vectors of states and derivatives.
    derivatives = [d.variable for d in read.derivatives if d.variable.derivative is not None]
    return Description(
        path,
        read.modelName,
        version,
        read.guid if version == 2 else read.instantiationToken,
        tuple(_variable(v) for v in reals if v.causality == "input"),
        tuple(_variable(v) for v in reals if v.causality == "output"),
        tuple(_variable(d.derivative) for d in derivatives),
        tuple(_variable(d) for d in derivatives),
        _count_of_events(version, read),
        _way(read.modelExchange),
        _way(read.coSimulation),
        {p.name: p for v in reals if (p := _settable(v)) is not None},
        {v.name: _kind(v) for v in read.modelVariables if _settable(v) is None},
    )


def _is_real_scalar(variable: Any) -> bool:
    """Whether a variable is a number: FMI 2 says `Real`, FMI 3 `Float64`, which may be an array."""
    return variable.type in ("Real", "Float64") and not getattr(variable, "dimensions", None)


def _count_of_events(version: int, read: Any) -> int:
    """Number of event indicators: FMI 2 says it, FMI 3 lists them."""
    if version == 2:
        return int(getattr(read, "numberOfEventIndicators", 0) or 0)
    return len(getattr(read, "eventIndicators", ()))


def _way(kind: Any) -> Way | None:
    return kind and Way(
        kind.modelIdentifier,
        bool(kind.canGetAndSetFMUstate),
        bool(kind.providesDirectionalDerivative),
    )


def _settable(variable: Any) -> Settable | None:
    """A real parameter with a start value that is fixed or tunable; None for any other variable."""
    if (
        not _is_real_scalar(variable)
        or variable.causality != "parameter"
        or variable.variability not in ("fixed", "tunable")
        or variable.start is None
    ):
        return None
    of_type = getattr(variable, "declaredType", None)

    def number(key: str, otherwise: float | None) -> Any:
        # Bounds, too.
        text = getattr(variable, key, None) or getattr(of_type, key, None)
        return otherwise if text is None else float(text)

    return Settable(
        **asdict(_variable(variable)),
        start=float(variable.start),
        lower=number("min", -math.inf),
        upper=number("max", math.inf),
        nominal=number("nominal", None),
        meaning=variable.description or "",
    )


def _kind(variable: Any) -> str:
    """What a variable is in FMI's words: `output`, `constant local`, `fixed Integer parameter`."""
    kind = [
        "" if variable.variability in (None, "continuous", "discrete") else variable.variability,
        "" if variable.type in ("Real", "Float64") else variable.type,
        "array" if getattr(variable, "dimensions", None) else "",
        variable.causality or "local",
    ]
    return " ".join(word for word in kind if word)


def _variable(variable: Any) -> Variable:
    declared = getattr(variable, "declaredType", None)
    # A unit may stand at the variable or at its declared type.
    unit = variable.unit or (declared.unit if declared is not None else None) or ""
    return Variable(variable.name, int(variable.valueReference), unit)


def unit_of(variable: Variable) -> str:
    """A unit as we write it from one as Modelica writes it: `N.m`, `m/s2`.

    >>> [unit_of(Variable("a", 1, written)) for written in ("m/s2", "N.m", "1")]
    ['m/s**2', 'N*m', '']
    """
    unit = re.sub(
        r"(?<=[A-Za-z])(-?\d+)", r"**\1", variable.unit.strip().replace(".", "*").replace("·", "*")
    )
    return {"1": "", "-": ""}.get(unit, unit)
