"""Machine: the base of the virtual machines, with their hidden effects, faults and operating
events.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

import numpy as np

from residuum.nearest_names import known_names
from residuum.simulation.signals import Array, Signals

SIZES = ("small", "medium", "large")
Kind = TypeVar("Kind")
_ROUNDING = 1e-6  # samples; keeps 0.1 + 0.2 seconds at 10 Hz from losing the third sample


class BadSetting(ValueError):
    """A virtual machine was asked for an effect, fault, event or setting that it does not have; one
    line says which.
    """


@dataclass(frozen=True)
class Effect:
    """A physical effect that the nominal model of a machine leaves out.

    Parameters
    ----------
    parameters : mapping of name to float
        The default parameters. The first one is the effect's size.
    units : mapping of name to unit
    sizes : (small, medium, large)
        Three values of the first parameter; `medium` is its default.
    meaning : str
        The equation in words.
    """

    parameters: Mapping[str, float]
    units: Mapping[str, str]
    sizes: tuple[float, float, float]
    meaning: str

    def sized(self, size: str) -> dict[str, float]:
        """The default parameters with the first one `small`, `medium` or `large`.

        >>> Effect({"c": 2.0}, {"c": "N"}, (1.0, 2.0, 4.0), "a force").sized("large")
        {'c': 4.0}
        """
        if size not in SIZES:
            raise BadSetting(f"effect size {size!r}: {known_names(size, SIZES, 'must be one of')}")
        first = next(iter(self.parameters))
        return {**self.parameters, first: self.sizes[SIZES.index(size)]}


@dataclass(frozen=True)
class Fault:
    """A damage that can be switched on and off while the machine runs, or an operating event that
    is no damage.
    """

    default_size: float
    unit: str
    meaning: str
    largest: float = field(default=np.inf)


class Machine(ABC):
    """A virtual machine that lives on: each `advance` continues where the last one stopped.

    Parameters
    ----------
    seed : int
        Seed of every random thing that changes from run to run: noise, disturbances, start values.
    effects : mapping of effect id to its parameters, or to `small`, `medium`, `large`
        Hidden physics; parameters that are not given take their defaults.
    faults : mapping of fault id to size
        Damage present from the start (None = default size).
    exemplar : int
        Which specimen of the machine: tolerances of its constants are drawn from this number alone.
        0 is the nominal one.

    Raises
    ------
    BadSetting
        Unknown effect, parameter, fault or event; a size that is not finite, not positive or above
        the largest.
    """

    name: ClassVar[str]
    effects: ClassVar[Mapping[str, Effect]] = MappingProxyType({})
    faults: ClassVar[Mapping[str, Fault]] = MappingProxyType({})
    events: ClassVar[Mapping[str, Fault]] = MappingProxyType({})
    units: ClassVar[Mapping[str, str]]
    record_duration: ClassVar[float] = 60.0  # s, of a record when nobody says how long
    sample_time: float

    def __init__(
        self,
        seed: int = 0,
        effects: Mapping[str, Mapping[str, float] | str] | None = None,
        faults: Mapping[str, float | None] | None = None,
        exemplar: int = 0,
    ) -> None:
        if seed < 0 or exemplar < 0:
            raise BadSetting(
                f"{self.name}: seed {seed} and exemplar {exemplar} must not be negative"
            )
        self.seed, self.exemplar = seed, exemplar
        self.active_effects = {
            id: self._effect_parameters(id, given) for id, given in (effects or {}).items()
        }
        self.active_faults: dict[str, float] = {}
        self._pending: dict[str, float] = {}
        self._rng = np.random.default_rng([seed, 1])
        self._samples = 0
        self._time = 0.0
        for id, size in (faults or {}).items():
            self.set_fault(id, size)

    @property
    def time(self) -> float:
        """How long the machine has run [s]."""
        return self._time

    def set_fault(self, id: str, size: float | None = None) -> None:
        """Damage the machine from now on; `size` None takes the default size of the fault."""
        fault = _known(self.faults, id, f"{self.name}: fault")
        self.active_faults[id] = _size(fault, size, f"{self.name}: fault {id!r}")

    def clear_fault(self, id: str) -> None:
        """Repair the fault `id`."""
        _known(self.faults, id, f"{self.name}: fault")
        self.active_faults.pop(id, None)

    def trigger(self, id: str, size: float | None = None) -> None:
        """Let an operating event happen once (machines say when)."""
        event = _known(self.events, id, f"{self.name}: event")
        self._pending[id] = _size(event, size, f"{self.name}: event {id!r}")

    def advance(self, duration: float) -> dict[str, Signals]:
        """Run `duration` seconds on and return what each recorder saw in that time (it may be no
        sample).
        """
        n = self._count(duration, 1.0 / self.sample_time, self._samples)
        t0 = self._samples * self.sample_time
        channels = self._run(n) if n else {name: np.empty(0) for name in self.units}
        self._samples += n
        self._time += duration
        return {"signals": Signals(self.sample_time, channels, self.units, t0)}

    def simulate(self, duration: float) -> Signals:
        """One aligned record of the next `duration` seconds, as it would stand in a file.

        Raises BadSetting when the duration holds fewer than two samples.
        """
        if self._count(duration, 1.0 / self.sample_time, self._samples) < 2:
            raise BadSetting(
                f"{self.name}: duration {duration:g} s holds fewer than two samples of"
                f" {self.sample_time:g} s"
            )
        return self.advance(duration)["signals"]

    @property
    def truth(self) -> dict[str, Any]:
        """What is hidden in the data: effects, faults and the true constants."""
        return {
            "machine": self.name,
            "seed": self.seed,
            "exemplar": self.exemplar,
            "effects": {id: dict(parameters) for id, parameters in self.active_effects.items()},
            "faults": dict(self.active_faults),
            "constants": self._constants(),
        }

    @abstractmethod
    def _run(self, n: int) -> dict[str, Array]:
        """The next `n` samples of every channel."""

    def _constants(self) -> dict[str, float]:
        """The true constants of this specimen, for `truth`."""
        return {}

    def _count(self, duration: float, rate: float, done: int) -> int:
        """How many samples at `rate` fall into the next `duration` seconds."""
        if not (np.isfinite(duration) and duration > 0):
            raise BadSetting(
                f"{self.name}: duration is {duration!r}; must be a positive number of seconds"
            )
        return max(int(np.floor((self._time + duration) * rate + _ROUNDING)) - done, 0)

    def _effect_parameters(self, id: str, given: Mapping[str, float] | str) -> dict[str, float]:
        effect = _known(self.effects, id, f"{self.name}: effect")
        if isinstance(given, str):
            return effect.sized(given)
        for parameter, value in given.items():
            if parameter not in effect.parameters:
                known = known_names(parameter, effect.parameters)
                raise BadSetting(
                    f"{self.name}: effect {id!r} has no parameter {parameter!r}; {known}"
                )
            if not np.isfinite(value):
                raise BadSetting(
                    f"{self.name}: effect {id!r}, parameter {parameter!r} is {value!r}; must be"
                    " finite"
                )
        return {**effect.parameters, **given}

    def _tolerance(self, count: int) -> Array:
        """Standard normal draws, cut at ±2, that belong to this exemplar; zeros for exemplar 0."""
        draws = np.random.default_rng([self.exemplar, 7]).standard_normal(count)
        return np.clip(draws, -2.0, 2.0) if self.exemplar else np.zeros(count)


def _known(listed: Mapping[str, Kind], id: str, role: str) -> Kind:
    if id not in listed:
        raise BadSetting(f"{role} {id!r} is not known; {known_names(id, listed)}")
    return listed[id]


def _size(fault: Fault, size: float | None, where: str) -> float:
    size = fault.default_size if size is None else float(size)
    if not (np.isfinite(size) and 0 < size <= fault.largest):
        limit = "" if np.isinf(fault.largest) else f" and at most {fault.largest:g}"
        raise BadSetting(
            f"{where}: size is {size:g}; must be positive{limit} [{fault.unit or '-'}]"
        )
    return size
