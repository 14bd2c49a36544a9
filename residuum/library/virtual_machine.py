"""Records of virtual machines, with hidden effects and faults."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from typing import Any

from residuum.identification.errors import BadInput
from residuum.library.answers.plain import to_plain
from residuum.library.record import Record
from residuum.nearest_names import known_names
from residuum.simulation import MACHINES, BadSetting, Machine, Signals

_MOST_SAMPLES = 50_000_000
_COMMON = ("self", "seed", "effects", "faults", "exemplar")


def simulate(
    machine: str,
    *,
    effects: Mapping[str, Mapping[str, float] | str] | list[str] | None = None,
    faults: Mapping[str, float | None] | list[str] | None = None,
    events: Mapping[str, float | None] | None = None,
    duration: float | None = None,
    seed: int = 0,
    exemplar: int = 0,
    reveal: bool = False,
    **settings: Any,
) -> Record:
    """A record of a virtual machine: something to try the library on, with a truth that is known.

    Parameters
    ----------
    machine : str
        `gate-drive`, `oven`, `linear-axis`, `oscillator`, `two-tanks`, `process-plant`,
        `gate-actuator` or `gripping-pliers`.
    effects : mapping of effect id to parameters, or to `small`, `medium`, `large`; or a list of ids
        Physics that the built-in model of the machine does not have.
    faults, events : mapping of id to size (None: the usual one)
        Damage from the start; an operating event at the next occasion.
    duration : float
        Length of the record [s]; each machine has its own default.
    seed, exemplar : int
        Of noise, disturbances and start values; which specimen (0: the nominal one).
    reveal : bool
        Write the truth into the record's notes.
    settings
        Of the machine: `profile`, `rate` [Hz], `noise_color` (0 … 1), …

    Returns
    -------
    Record

    Raises
    ------
    BadInput
        A machine, effect, fault, event or setting that there is not.

    Examples
    --------
    >>> import residuum as rs
    >>> record = rs.simulate("gate-drive", effects={"coulomb-friction": "large"}, duration=2.0, seed=1)
    >>> record.names, record.units["speed"]
    (('voltage', 'speed', 'current'), 'rad/s')
    """
    return simulated(machine, effects, faults, events, duration, seed, exemplar, reveal, settings)[
        0
    ]


def simulated(
    machine: str,
    effects: Mapping[str, Mapping[str, float] | str] | list[str] | None,
    faults: Mapping[str, float | None] | list[str] | None,
    events: Mapping[str, float | None] | None,
    duration: float | None,
    seed: int,
    exemplar: int,
    reveal: bool,
    settings: Mapping[str, Any],
) -> tuple[Record, dict[str, Any]]:
    """The record, and the truth that is hidden in it (effects, faults and constants as plain JSON
    values).
    """
    if machine not in MACHINES:
        raise BadInput(
            f"machine {machine!r}: there is none of this name; {known_names(machine, MACHINES)}"
        )
    given = _settings(MACHINES[machine], dict(settings))
    hidden = {id: {} for id in effects} if isinstance(effects, list) else dict(effects or {})
    damage = dict.fromkeys(faults) if isinstance(faults, list) else dict(faults or {})
    try:
        built = MACHINES[machine](seed, hidden, damage, exemplar, **given)
        for id, size in (events or {}).items():
            built.trigger(id, size)
        signals = built.simulate(_length(built, duration))
    except BadSetting as refused:
        raise BadInput(str(refused)) from None
    truth: dict[str, Any] = to_plain(built.truth)
    return _record(machine, signals, seed, truth if reveal else None), truth


def _length(machine: Machine, duration: float | None) -> float:
    duration = machine.record_duration if duration is None else duration
    if duration / machine.sample_time > _MOST_SAMPLES:
        raise BadInput(
            f"duration {duration:g} s: is {duration / machine.sample_time:.3g} samples; at most"
            f" {_MOST_SAMPLES:.0e}"
        )
    return duration


def _settings(machine: type[Machine], given: dict[str, Any]) -> dict[str, Any]:
    """The machine's own settings, text turned into the type of their default value."""
    known = {
        name: p.default
        for name, p in inspect.signature(machine.__init__).parameters.items()
        if name not in _COMMON
    }
    for name, value in given.items():
        if name not in known:
            raise BadInput(f"{machine.name}: has no setting {name!r}; {known_names(name, known)}")
        given[name] = _typed(value, known[name], f"{machine.name}: setting {name!r}")
    return given


def _typed(value: Any, like: Any, setting: str) -> Any:
    if isinstance(like, bool):
        if str(value).lower() not in ("true", "false"):
            raise BadInput(f"{setting} is {value!r}; must be true or false")
        return str(value).lower() == "true"
    if isinstance(like, str):
        return value
    try:
        return float(value)
    except (TypeError, ValueError):
        raise BadInput(f"{setting}: {value!r} is not a number") from None


def _record(machine: str, signals: Signals, seed: int, truth: Any) -> Record:
    notes = [f"simulated {machine}, seed {seed}", *signals.notes]
    if truth is not None:
        notes.append(f"truth: {json.dumps(truth, separators=(',', ':'), ensure_ascii=False)}")
    return Record(
        signals.channels,
        signals.units,
        signals.sample_time,
        signals.t0,
        tuple(notes),
        source=f"simulated {machine}",
    )
