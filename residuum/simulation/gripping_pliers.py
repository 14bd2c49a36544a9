"""The gripping pliers of a blow-moulding machine: an accelerometer on the frame and the machine's
own signals.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from residuum.simulation.machine import BadSetting, Fault, Machine
from residuum.simulation.signals import Array, Signals

VIBRATION_RATE, MACHINE_RATE = 12800.0, 1000.0  # Hz
PLIERS = 4
_SYNC_PERIOD, _SYNC_WIDTH = 1.0, 0.02  # s
_PULSE, _LONG_PULSE = 0.02, 0.04  # of a round
_MESH_TEETH = 66  # mesh impacts a round of the pliers' drive


@dataclass(frozen=True)
class Mode:
    """A structural resonance between the pliers' frame and the accelerometer: frequency [Hz] and
    damping ratio [-].
    """

    frequency: float
    damping: float


FRAME = Mode(1530.0, 0.017)  # the ring that carries the cam: what a bearing excites
PANEL = Mode(610.0, 0.03)
BRACKET = Mode(3150.0, 0.015)


@dataclass(frozen=True)
class Bench:
    """What sets the vibration level, in m/s² at the accelerometer."""

    rounds_per_hour: float = 1800.0
    roller_radius: float = 0.015  # m, posterior bearing
    cam_radius: float = 0.150  # m
    noise: float = 0.33  # RMS of broadband noise
    mesh: float = 0.15  # amplitude of the drive's mesh
    clamp: float = 0.74  # peak of the mould clamps' impacts
    opening: float = 0.25  # peak when a plier's arms open at the entry of Q3
    bearing: float = 2.05  # peak of a damaged bearing's impact in Q3 at size 1
    depth: float = 0.48  # log-normal scatter of an impact: the flat meets the cam at varying depth
    unloaded: float = 0.6  # of the cam's load while no preform is held


LOAD = np.array([0.05, 0.05, 1.0, 1.0])  # spring load of a plier's bearing in Q1 … Q4
# transmission from the cam in Q1 … Q4 to the accelerometer
NEARNESS = np.array([0.40, 0.40, 1.00, 0.55])


class GrippingPliers(Machine):
    r"""Four pliers on one rotor at 1800 rounds an hour; one plier's posterior bearing can be
    damaged (P3's, as in the source).

    .. math::
        a(t) = \sum_{j} h_{frame}(t - t_j) A_j + \sum_k h_{panel, bracket, frame}(t - t_k) B_k +
        \text{mesh}(\psi) + w(t), \qquad h(t) = e^{-\zeta\omega t} \sin(\omega_d t)

    A damaged bearing rolls on the cam (radius 150 mm) with a roller of 15 mm: 5 turns a second, one
    impact a turn, with slip (1 %) and log-normal scatter of 0.48 (the flat meets the cam at varying
    depth), A = 2.05 m/s² × load × nearness. The springs load the bearing in Q3 and Q4, the
    accelerometer sits at Q3. Levels are those of Table 6 (Valceschini): the frame's ring decays in
    6 ms, so 2.5 impacts a round in Q3 and 2.5 of 55 % in Q4 raise the RMS of an envelope in 133 Hz
    from .0075 to .0165 g, and their scatter its kurtosis from 6 to some 100 (a scatter of 0.4 gives
    77). The healthy envelope is white noise of 0.33 m/s². Mould clamps strike at fixed places of
    every round and ring the panel and the bracket, and the frame half as much, which is the healthy
    kurtosis of 6.

    So the mode that a kurtogram finds, the growth of RMS and kurtosis, and Q3 before Q4 are
    settings of this simulator: a method that returns them proves that it reads a record rightly,
    not that real pliers behave so. What is not set: limits on healthy rounds, the place of another
    plier's damage, and what is found when mode, level and place are drawn at random.

    The rotor speed breathes by 0.1 %. Accelerometer and machine control have clocks of their own,
    each up to ±25 ppm off (together ±50 ppm), and the machine's clock reads up to ±0.2 s more at
    the start. Both see the synchronisation pulse, 20 ms wide, once a second of true time.

    `advance` gives `vibration` (12.8 kHz: acceleration, sync) and `machine` (1 kHz: indicator,
    speed, current, temperature, sync); `simulate` holds the machine's signals on the
    accelerometer's clock. The indicator rises each time a plier passes: the segment after the pulse
    of plier P1 — twice as long with `long_pulse` — has P3 in Q1.

    Parameters
    ----------
    preforms_after : float
        Time of the first preform [s]; before it the cam carries 60 % of its load.
    damaged_plier : int
        1 … 4, whose bearing the fault damages.
    long_pulse : bool
        Whether one plier's indicator pulse is longer, so that quadrants can be told apart.
    """

    name = "gripping-pliers"
    sample_time = 1.0 / VIBRATION_RATE
    units: ClassVar[Mapping[str, str]] = {
        "acceleration": "m/s²",
        "indicator": "",
        "speed": "rpm",
        "current": "A",
        "temperature": "°C",
        "sync": "",
    }
    faults: ClassVar[Mapping[str, Fault]] = {
        "plier-bearing": Fault(
            1.0,
            "",
            "posterior bearing of one plier (P3 unless set); 1 is material ground off one place of"
            " the roller",
        ),
    }

    def __init__(
        self,
        seed: int = 0,
        effects: Mapping[str, Mapping[str, float] | str] | None = None,
        faults: Mapping[str, float | None] | None = None,
        exemplar: int = 0,
        *,
        preforms_after: float = 0.0,
        damaged_plier: int = 3,
        long_pulse: bool = True,
        rounds_per_hour: float = 1800.0,
    ) -> None:
        if damaged_plier not in range(1, PLIERS + 1):
            raise BadSetting(
                f"gripping-pliers: damaged_plier is {damaged_plier!r}; must be 1, 2, 3 or 4"
            )
        if not 60.0 <= rounds_per_hour <= 6000.0:
            raise BadSetting(
                f"gripping-pliers: rounds_per_hour is {rounds_per_hour!r}; must be between 60 and"
                " 6000"
            )
        super().__init__(seed, effects, faults, exemplar)
        spread = self._tolerance(8)
        self.bench = Bench(
            rounds_per_hour=rounds_per_hour,
            noise=Bench.noise * (1 + 0.05 * spread[0]),
            clamp=Bench.clamp * (1 + 0.1 * spread[1]),
            mesh=Bench.mesh * (1 + 0.2 * spread[2]),
        )
        self._preforms_after, self._long_pulse, self._damaged = (
            preforms_after,
            long_pulse,
            damaged_plier,
        )
        self._modes = [
            _Ring(FRAME.frequency * (1 + 0.01 * spread[3]), FRAME.damping),
            _Ring(PANEL.frequency * (1 + 0.02 * spread[4]), PANEL.damping),
            _Ring(BRACKET.frequency * (1 + 0.02 * spread[5]), BRACKET.damping),
        ]
        clocks = np.random.default_rng([seed, 2])
        self._vibration_ppm, self._machine_ppm = clocks.uniform(-25e-6, 25e-6, 2)
        self._machine_t0 = float(np.round(clocks.uniform(-0.2, 0.2), 4))
        self._start = float(clocks.uniform(0.0, 1.0))
        self._machine_samples = 0
        self._machine_rng = np.random.default_rng([seed, 3])

    def advance(self, duration: float) -> dict[str, Signals]:
        """Run on; two recorders, each on its own clock."""
        m = self._count(duration, MACHINE_RATE, self._machine_samples)
        k = self._machine_samples + np.arange(m)
        self._machine_samples += m
        machine = self._machine(k / MACHINE_RATE * (1 + self._machine_ppm))
        t0 = self._samples / VIBRATION_RATE
        vibration = self._vibration(self._count(duration, VIBRATION_RATE, self._samples))
        self._time += duration
        return {
            "vibration": Signals(1 / VIBRATION_RATE, vibration, self._units_of(vibration), t0),
            "machine": Signals(
                1 / MACHINE_RATE,
                machine,
                self._units_of(machine),
                self._machine_t0 + (self._machine_samples - m) / MACHINE_RATE,
            ),
        }

    def simulate(self, duration: float) -> Signals:
        """One record on the accelerometer's clock; the machine's 1 kHz signals are held between
        their samples.
        """
        if self._count(duration, MACHINE_RATE, self._machine_samples) < 2:
            raise BadSetting(
                f"gripping-pliers: duration {duration:g} s holds fewer than two samples of both"
                " recorders"
            )
        t0 = self._samples / VIBRATION_RATE
        streams = self.advance(duration)
        vibration, machine = streams["vibration"], streams["machine"]
        first = self._machine_samples - machine.n
        t = vibration.time * (1 + self._vibration_ppm)
        held = np.floor(t / (1 + self._machine_ppm) * MACHINE_RATE).astype(int) - first
        held = np.clip(held, 0, machine.n - 1)
        channels = {
            name: machine[name][held] for name in ("indicator", "speed", "current", "temperature")
        }
        channels = {
            "acceleration": vibration["acceleration"],
            **channels,
            "sync": vibration["sync"],
        }
        return Signals(1 / VIBRATION_RATE, channels, self.units, t0)

    def _run(self, n: int) -> dict[str, Array]:
        return self._vibration(n)

    def _units_of(self, channels: Mapping[str, Array]) -> dict[str, str]:
        return {name: self.units[name] for name in channels}

    def _rounds(self, t: Array) -> Array:
        """Turned rounds ψ/2π of the rotor at true time t [s]; the speed breathes by 0.1 % every 7
        s.
        """
        f = self.bench.rounds_per_hour / 3600.0
        return self._start + f * (
            t + 0.001 * 7.0 / (2 * np.pi) * (1.0 - np.cos(2 * np.pi * t / 7.0))
        )

    def _load(self, t: Array) -> Array:
        return np.where(t < self._preforms_after, self.bench.unloaded, 1.0)

    def _machine(self, t: Array) -> dict[str, Array]:
        rounds = self._rounds(t)
        noise = self._machine_rng.standard_normal((len(t), 3))
        quarter = rounds * PLIERS
        within = (quarter % 1.0) / PLIERS
        first = np.floor(quarter) % PLIERS == 0
        indicator = (within < np.where(first & self._long_pulse, _LONG_PULSE, _PULSE)).astype(float)
        rpm = self.bench.rounds_per_hour / 60.0 * (1 + 0.001 * np.sin(2 * np.pi * t / 7.0))
        effort = 3.0 + 0.3 * self._load(t) * np.sin(2 * np.pi * quarter) + 0.08 * noise[:, 1]
        warm = 45.0 - 15.0 * np.exp(-t / 1800.0) + 0.1 * noise[:, 2]
        return {
            "indicator": indicator,
            "speed": np.round(rpm + 0.01 * noise[:, 0], 3),
            "current": np.round(effort, 2),
            "temperature": np.round(warm, 1),
            "sync": _sync(t),
        }

    def _vibration(self, n: int) -> dict[str, Array]:
        k = self._samples + np.arange(-1, n)
        self._samples += n
        t = k / VIBRATION_RATE * (1 + self._vibration_ppm)
        rounds = self._rounds(t)
        frame, panel, bracket = np.zeros(n), np.zeros(n), np.zeros(n)
        self._clamps(rounds, frame, panel, bracket)
        self._arms(t, rounds, frame, panel)
        if size := self.active_faults.get("plier-bearing"):
            self._bearing(size, t, rounds, frame, bracket)
        a = self.bench.noise * self._rng.standard_normal(n)
        angle = (
            2 * np.pi * _MESH_TEETH * self.bench.cam_radius / self.bench.roller_radius * rounds[1:]
        )
        a += self.bench.mesh * (
            np.sin(angle) + 0.5 * np.sin(2 * angle + 1.0) + 0.25 * np.sin(3 * angle + 2.0)
        )
        for ring, excitation in zip(self._modes, (frame, panel, bracket), strict=True):
            a += ring.respond(excitation)
        return {"acceleration": a, "sync": _sync(t[1:])}

    def _clamps(self, rounds: Array, frame: Array, panel: Array, bracket: Array) -> None:
        """The mould clamps close at the same place of every quadrant, 5 % stronger or weaker from
        one to the next.
        """
        at, count = _crossings(rounds * PLIERS - 0.62)
        strength = self.bench.clamp * self._scatter(4, count, 0.05)
        panel[at] += strength
        bracket[at] += 0.6 * strength
        frame[at] += 0.5 * strength

    def _arms(self, t: Array, rounds: Array, frame: Array, panel: Array) -> None:
        """A plier's arms open when it enters Q3."""
        at, count = _crossings(rounds * PLIERS - 0.08)
        strength = self.bench.opening * self._load(t[1:][at]) * self._scatter(5, count, 0.1)
        frame[at] += strength
        panel[at] += 0.5 * strength

    def _bearing(self, size: float, t: Array, rounds: Array, frame: Array, bracket: Array) -> None:
        """One impact each turn of the damaged plier's roller, as strong as its load there and as
        near as its quadrant is.
        """
        turns = rounds * self.bench.cam_radius / self.bench.roller_radius
        slipping = turns + 0.01 / (2 * np.pi) * np.sin(2 * np.pi * 0.37 * turns)
        at, count = _crossings(slipping)
        # P3's is the segment's own
        quadrant = (np.floor(rounds[1:][at] * PLIERS).astype(int) + 3 - self._damaged) % PLIERS
        strength = (
            self.bench.bearing * size * self._load(t[1:][at]) * LOAD[quadrant] * NEARNESS[quadrant]
        )
        strength = strength * np.exp(self.bench.depth * (self._scatter(6, count, 1.0) - 1))
        frame[at] += strength
        bracket[at] += 0.2 * strength

    def _scatter(self, kind: int, count: Array, spread: float) -> Array:
        """A factor about 1 for each numbered impact; the same one whatever the chunks in which time
        advances.
        """
        return np.array(
            [
                1 + spread * np.random.default_rng([self.seed, kind, int(c)]).standard_normal()
                for c in count
            ]
        )

    def _constants(self) -> dict[str, float]:
        return {
            "vibration_clock_ppm": 1e6 * float(self._vibration_ppm),
            "machine_clock_ppm": 1e6 * float(self._machine_ppm),
            "machine_clock_offset": self._machine_t0,
            "damaged_plier": float(self._damaged),
        }


class _Ring:
    """A damped mode as a two-pole filter whose impulse response is exp(−ζωt) sin(ω_d t), peak about
    1.
    """

    def __init__(self, frequency: float, damping: float) -> None:
        omega = 2 * np.pi * frequency / VIBRATION_RATE
        decay, omega_d = np.exp(-damping * omega), omega * np.sqrt(1 - damping**2)
        self._b = [0.0, decay * np.sin(omega_d)]
        self._a = [1.0, -2 * decay * np.cos(omega_d), decay**2]
        self._memory = np.zeros(2)

    def respond(self, excitation: Array) -> Array:
        response, self._memory = lfilter(self._b, self._a, excitation, zi=self._memory)
        return np.asarray(response)


def _crossings(count: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Where a rising count passes whole numbers: sample indices (of count[1:]) and the numbers
    passed.
    """
    whole = np.floor(count)
    at = np.flatnonzero(np.diff(whole) > 0)
    return at, whole[at + 1]


def _sync(t: Array) -> Array:
    return (t % _SYNC_PERIOD < _SYNC_WIDTH).astype(float)
