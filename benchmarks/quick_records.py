"""Records of simulated machines that the judge on unseen blocks answers in seconds, each with a few effects to choose from."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from benchmarks.watched_machines import PENDULUM, windows
from residuum.identification.discrepancy.explain import Explanation, answer_on_blocks
from residuum.identification.physics import PhysicalModel, load_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.record_search import searched
from residuum.identification.unseen_blocks.tried import Wanted
from residuum.simulation import MACHINES

DRIVE = ("coulomb-friction", "viscous-friction", "constant-load", "output-lag")
OVEN = ("ambient-loss", "radiation", "second-heat-store", "heater-nonlinearity", "output-lag")
ARM = ("coulomb-friction", "viscous-friction", "input-lag", "output-offset")


@dataclass(frozen=True)
class Quick:
    """A record, the model that lacks something (or nothing), and the ids of what may be named."""

    name: str
    ids: tuple[str, ...]
    make: Callable[[], tuple[PhysicalModel, Record]]

    def answer(self) -> Explanation:
        """What is said of it by errors on unseen blocks alone."""
        model, record = self.make()
        wanted = Wanted(self.ids)
        found = searched(model, [record], None, wanted)
        return answer_on_blocks(found, wanted, [record], None, time.perf_counter())


@dataclass(frozen=True)
class Simulated:
    """A machine of `residuum.simulation`."""

    machine: str
    seed: int
    seconds: float
    effects: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self) -> tuple[PhysicalModel, Record]:
        run = MACHINES[self.machine](
            seed=self.seed, effects=dict(self.effects), **self.settings
        ).simulate(self.seconds)
        return load_model(self.machine), Record(run.channels, run.units, run.sample_time)


def _drive(seed: int, effects: Mapping[str, str], **settings: Any) -> Simulated:
    return Simulated(
        "gate-drive", seed, 10.0, effects, {"rate": 100.0, "profile": "rich", **settings}
    )


RECORDS = (
    Quick(
        "tanks, leak",
        ("leak", "pump-nonlinearity"),
        Simulated("two-tanks", 3, 2000.0, {"leak": "medium"}),
    ),
    Quick(
        "oven, radiation",
        OVEN,
        Simulated("oven", 3, 86400.0, {"radiation": "medium"}, {"configuration": "lumped"}),
    ),
    Quick(
        "pendulum, friction and a lag",
        ARM,
        lambda: (PENDULUM.model(), windows(PENDULUM, 5, 0, 1)[0]),
    ),
    Quick("drive, nothing, coloured noise", DRIVE, _drive(6, {}, noise_color=0.9)),
    Quick(
        "drive, a resonance outside the catalogue",
        ("coulomb-friction", "constant-load"),
        _drive(7, {"x-speed-resonance": "large"}),
    ),
)
