"""What one movement of the gate actuator shows of its teeth: the source's F₁ and F₂, and features
in shaft angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len
from scipy.signal import butter, hilbert, sosfiltfilt

from residuum.diagnosis.gate.actuator_model import ActuatorConstants, AdaptedModel, adapt
from residuum.diagnosis.gate.movements import (
    Direction,
    Movement,
    PositionProfile,
    flat_part,
    position_profile,
)
from residuum.diagnosis.gate.operating_events import slow_residual
from residuum.diagnosis.vibration.rotation import POINTS_OF_A_TURN, ShaftPattern, shaft_pattern
from residuum.diagnosis.vibration.vibration_indicators import (
    autoregressive_whitener,
    matched_filter,
    pulse_templates,
)

# Residual evaluation of the gate actuator: band-pass, envelope, spectrum modulus, F₁ and F₂
# (Valceschini, section 7.5.2).

BAND = (0.5, 10.0)  # Hz
ENVELOPE_HARMONICS = 3
_NEIGHBOURHOOD = 0.05  # of each harmonic, either side
_ZERO_PADDING = 8


@dataclass(frozen=True, eq=False)
class EnvelopeSpectrum:
    """Modulus θ(f) of the envelope's amplitude spectrum.

    `frequency` [Hz] and `modulus` (unit of the residual), shape (n,); the mean of the envelope is
    taken off. The grid is finer than 1/duration (zero padding), because F₂ sums over a
    neighbourhood that is narrower than one bin of a ten-second record.
    """

    frequency: Signal
    modulus: Signal
    resolution: float

    def at(self, frequency: float) -> float:
        """θ(f), interpolated on the fine grid."""
        return float(np.interp(frequency, self.frequency, self.modulus))

    def around(self, frequency: float, relative: float = _NEIGHBOURHOOD) -> float:
        """Sum of θ over f(1 ± relative), in bins of 1/duration so that zero padding does not change
        it.
        """
        inside = np.abs(self.frequency - frequency) <= relative * frequency
        fine = self.frequency[1] - self.frequency[0]
        return float(np.sum(self.modulus[inside]) * fine / self.resolution)


def residual_envelope(
    residual: Signal, sample_time: float, band: tuple[float, float] = BAND
) -> Signal:
    """|analytic signal| of the residual band-passed to `band` [Hz] (Butterworth of order 2, forward
    and backward), shape (n,).

    The filter runs over the whole movement, before the flat part is cut out, so its transient stays
    in the ramps.
    """
    sos = butter(2, band, btype="bandpass", fs=1.0 / sample_time, output="sos")
    narrow = np.asarray(
        sosfiltfilt(sos, residual, padlen=min(residual.shape[0] - 1, round(1.0 / sample_time)))
    )
    length = next_fast_len(narrow.shape[0])
    return np.abs(np.asarray(hilbert(narrow, length)))[: narrow.shape[0]]


def envelope_spectrum(envelope: Signal, sample_time: float) -> EnvelopeSpectrum:
    """θ(f) of an envelope, scaled so that a sine of amplitude a shows as a.

    >>> t = np.arange(0, 10, 0.01)
    >>> spectrum = envelope_spectrum(2.0 + 0.5 * np.cos(2 * np.pi * 1.55 * t), 0.01)
    >>> abs(spectrum.at(1.55) - 0.5) < 0.02
    True
    """
    n = envelope.shape[0]
    length = next_fast_len(_ZERO_PADDING * n, real=True)
    modulus = np.abs(np.fft.rfft(envelope - np.mean(envelope), length)) * (2.0 / n)
    return EnvelopeSpectrum(
        np.asarray(np.fft.rfftfreq(length, sample_time)),
        np.asarray(modulus, dtype=float),
        1.0 / (n * sample_time),
    )


def fault_indicators(
    spectrum: EnvelopeSpectrum, fault_frequency: float, harmonics: int = ENVELOPE_HARMONICS
) -> tuple[float, float]:
    """F₁ = Σₖ θ(k f) and F₂ = Σₖ Σ_{0.95 k f ≤ j ≤ 1.05 k f} θ(j) of (7.6), k = 1 … harmonics, f
    the fault frequency [Hz].
    """
    orders = [k * fault_frequency for k in range(1, harmonics + 1)]
    return sum(map(spectrum.at, orders)), sum(map(spectrum.around, orders))


Signal = npt.NDArray[np.float64]
RATE = 500.0  # Hz; over seven samples a motor turn, 320 a shaft turn
FEWEST_TURNS = 5
SOURCE_FEATURES = ("F1", "F2")
_SETTLING = 0.3  # s after the ramp, six time constants
_WHITENER_ORDER = 50  # a tenth of a second
_AVERAGED_TURNS = (
    14  # over more, noise is gone and healthy tooth errors stay: they are fixed in the gear
)
_CLIP = 4.0  # robust deviations; pulses must not shape the whitener that is to find them
FEATURES = (
    *SOURCE_FEATURES,
    "low_peak",
    "low_rms",
    "low_crest",
    "high_peak",
    "high_crest",
    "single_pulse",
    "periodic_pulse",
    "level",
)


@dataclass(frozen=True, eq=False)
class MovementFeatures:
    """Features of one movement with what they were taken from.

    Attributes
    ----------
    values : mapping of name to float
        F1, F2 : (7.6) of the residual in axial speed [mm/s]. low_peak, low_rms : largest envelope
        and RMS of the typical shaft turn of the residual in the orders between eccentricity and the
        pinion's mesh, 2–13 [rad/s]; high_peak the same between the meshes of pinion and gear,
        15–43; low_crest, high_crest : peak over RMS; single_pulse : largest matched-filter output
        at one place, in standard deviations; periodic_pulse : the same of the typical turn, scaled
        by √turns of at most 14; level : robust deviation of the residual [rad/s].
    fault_frequency : float
        Turns a second of the shaft, from the measured speed [Hz].
    pulse_position : float
        Where single_pulse is, as a fraction of the travel from the closed gate.
    profile : PositionProfile
        The pulse statistic over the whole way.
    """

    values: dict[str, float]
    model: AdaptedModel
    spectrum: EnvelopeSpectrum
    pattern: ShaftPattern
    fault_frequency: float
    motor_speed: float
    turns: int
    slow_residual: float
    pulse_position: float
    profile: PositionProfile

    def vector(self) -> Signal:
        """Natural logarithms of the features in the order of FEATURES, shape (n_features,).

        Logarithms, because tolerances between exemplars act as factors, and because a fault twice
        as large then is a step and not a stretch.
        """
        return np.log([self.values[name] for name in FEATURES])

    def source_vector(self) -> Signal:
        """(F₁, F₂) of (7.6) [mm/s], shape (2,)."""
        return np.array([self.values[name] for name in SOURCE_FEATURES])


def whole_turns(movement: Movement, constants: ActuatorConstants) -> float:
    """Turns of the shaft in the flat part of the movement, after it has settled."""
    run = _settled(movement)
    return float(
        np.sum(movement.speed[run]) * movement.sample_time / (2 * np.pi * constants.gear_teeth)
    )


def movement_features(
    movement: Movement, constants: ActuatorConstants, model: AdaptedModel | None = None
) -> MovementFeatures:
    """Features of one movement; `model` None adapts the model to this movement itself.

    The movement needs FEWEST_TURNS turns of the shaft at flat voltage (see `whole_turns`).
    """
    reduced = movement.reduced(RATE)
    Ts = reduced.sample_time
    adapted = adapt([reduced], constants) if model is None else model
    residual = adapted.residual(reduced)
    run = _settled(reduced)
    motor_speed = float(np.mean(reduced.speed[run]))
    frequency = constants.fault_frequency(motor_speed)
    axial = 1e3 * constants.tau * residual
    spectrum = envelope_spectrum(residual_envelope(axial, Ts)[run], Ts)
    F1, F2 = fault_indicators(spectrum, frequency)
    turns = reduced.motor_angle[run] / (2 * np.pi * constants.gear_teeth)
    pattern = shaft_pattern(residual[run], turns)
    low = pattern.band(2, constants.pinion_teeth - 1)
    high = pattern.band(constants.pinion_teeth + 1, constants.gear_teeth - 1)
    level = _robust_deviation(residual[run])
    # pulses as long as a pitch of the gear, and as half a pitch and a pitch of the pinion, take [s]
    gear, pinion = constants.gear_teeth * frequency, constants.pinion_teeth * frequency
    durations = [1.0 / gear, 0.5 / pinion, 1.0 / pinion]
    templates = pulse_templates(durations, adapted.time_constant, Ts)
    pulses = _pulses(residual[run], turns, templates, level)
    values = {
        "F1": F1,
        "F2": F2,
        "low_peak": _peak(low),
        "low_rms": _rms(low.real),
        "low_crest": _peak(low) / _rms(low.real),
        "high_peak": _peak(high),
        "high_crest": _peak(high) / _rms(high.real),
        "single_pulse": pulses.single,
        "periodic_pulse": pulses.periodic,
        "level": level,
    }
    positions = _positions(reduced)[run]
    place = float(positions[int(np.argmax(pulses.at_sample))])
    profile = position_profile(pulses.at_sample, positions)
    slow = slow_residual(residual[run], Ts)
    return MovementFeatures(
        values,
        adapted,
        spectrum,
        pattern,
        frequency,
        motor_speed,
        pattern.turns.shape[0],
        slow,
        place,
        profile,
    )


def _settled(movement: Movement) -> slice:
    flat, _ = flat_part(movement)
    return slice(flat.start + round(_SETTLING / movement.sample_time), flat.stop)


@dataclass(frozen=True, eq=False)
class _Pulses:
    """Largest single and periodic pulse over all templates, and at each sample the largest single
    one, shape (n,).
    """

    single: float
    periodic: float
    at_sample: Signal


def _pulses(residual: Signal, turns: Signal, templates: Sequence[Signal], level: float) -> _Pulses:
    centred = residual - np.median(residual)
    clipped = np.clip(centred, -_CLIP * level, _CLIP * level)
    whitener = autoregressive_whitener(clipped, _WHITENER_ORDER)
    periodic = 0.0
    largest = np.zeros_like(residual)
    for template in templates:
        z, _ = matched_filter(centred, whitener, template)
        pattern = shaft_pattern(z, turns)
        averaged = min(pattern.turns.shape[0], _AVERAGED_TURNS)
        # an average over so many turns scatters by 1/√turns of one: back in standard deviations
        periodic = max(periodic, _peak(pattern.typical) * float(np.sqrt(averaged)))
        # a single pulse is what its place on the shaft does not show turn by turn
        whole = turns - turns[0] < pattern.turns.shape[0]
        place = (turns[whole] - turns[0]) % 1.0 * POINTS_OF_A_TURN
        closed = np.append(pattern.typical, pattern.typical[0])
        shared = np.interp(place, np.arange(POINTS_OF_A_TURN + 1), closed)
        largest[whole] = np.maximum(largest[whole], np.abs(z[whole] - shared))
    return _Pulses(float(np.max(largest)), periodic, largest)


def _positions(movement: Movement) -> Signal:
    """Travel at each sample as a fraction of the way, counted from the closed gate, shape (n,)."""
    fraction = movement.motor_angle / movement.motor_angle[-1]
    return fraction if movement.direction is Direction.OPENING else 1.0 - fraction


def _robust_deviation(x: Signal) -> float:
    return 1.4826 * float(np.median(np.abs(x - np.median(x)))) + np.finfo(float).tiny


def _peak(x: Signal | npt.NDArray[np.complex128]) -> float:
    return float(np.max(np.abs(x)))


def _rms(x: Signal) -> float:
    return float(np.sqrt(np.mean(x**2))) + np.finfo(float).tiny
