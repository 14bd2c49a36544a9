"""Records of virtual machines, with hidden effects and faults."""

from __future__ import annotations

import inspect
import json
from typing import Any

from residuum.identification.errors import BadInput
from residuum.library.answers.plain import to_plain
from residuum.library.questions import asks
from residuum.library.questions.simulate import Simulate
from residuum.library.record import Record
from residuum.nearest_names import known_names
from residuum.simulation import MACHINES, BadSetting, Machine, Signals

# Of a record that is simulated: it is held in memory as a whole, some 0.4 GB a channel.
_MOST_SAMPLES = 50_000_000
# What every machine takes. A question has fields for these; all others are the machine's own
# settings.
_COMMON = ("self", "seed", "effects", "faults", "exemplar")


@asks(Simulate)
def simulate(machine: str, **given: Any) -> Record:
    """A record of a virtual machine: something to try the library on, with a truth that is known.

    Settings of the machine that are no field of the question may be given by their names, too.

    Parameters
    ----------
    machine : str
        `gate-drive`, `oven`, `linear-axis`, `oscillator`, `two-tanks`, `process-plant`,
        `gate-actuator` or `gripping-pliers`.

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
    >>> hidden = {"coulomb-friction": "large"}
    >>> record = rs.simulate("gate-drive", effects=hidden, duration=2.0, seed=1)
    >>> record.names, record.units["speed"]
    (('voltage', 'speed', 'current'), 'rad/s')
    """
    # A keyword that is no field of the question is a setting of the machine, `--set` of the
    # command.
    own = {name: given.pop(name) for name in list(given) if name not in Simulate.model_fields}
    if own:
        given["settings"] = {**(given.get("settings") or {}), **own}
    record, _ = simulated(machine, Simulate.of(given))
    return record


def simulated(machine: str, asked: Simulate) -> tuple[Record, dict[str, Any]]:
    """The record, and the truth that is hidden in it (effects, faults and constants as plain JSON
    values).
    """
    if machine not in MACHINES:
        raise BadInput(
            f"machine {machine!r}: there is none of this name; {known_names(machine, MACHINES)}"
        )
    settings = _settings(MACHINES[machine], asked.of_the_machine)
    try:
        built = MACHINES[machine](
            asked.seed, asked.effects, asked.faults, asked.exemplar, **settings
        )
        # Before the simulation: an event comes at the next occasion of the machine.
        for id, size in asked.events.items():
            built.trigger(id, size)
        signals = built.simulate(_length(built, asked.duration))
    # Simulators share no code with what they test, exceptions included.
    except BadSetting as refused:
        raise BadInput(str(refused)) from None
    truth: dict[str, Any] = to_plain(built.truth)
    # A record to be tried on must not tell what is hidden in it, unless that is asked for.
    return _record(machine, signals, asked.seed, truth if asked.reveal else None), truth


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
    # `bool` takes every text for true, `false` too.
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
