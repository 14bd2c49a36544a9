"""Plants that integrate: identified from the summed input, G(z) = G'(z) · z/(z − 1).

y(t) = G'(q) U(t) + level + ramp + noise,   U(t) = Σ_{s ≤ t} (u(s) − mean u)

G' is stable, any method finds it, and the noise keeps its own colour, which differences of the
output would not leave it. The input at which the plant stands still is unknown: its error adds a
ramp, so that U and y are taken from their straight lines.

Fails for a plant that does not integrate: then G' has a zero at one, and `integrator_test` says
nothing of the kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.record import Record


def summed_input(records: Sequence[Record], input: str, output: str) -> list[Record]:
    """The records with the input summed, and both channels about their straight lines.

    Raises BadRecord where an input sample is missing: the sum behind it is unknown.
    """
    return [_summed(record, input, output) for record in records]


def _summed(record: Record, input: str, output: str) -> Record:
    u, y = (np.asarray(record[name], dtype=float) for name in (input, output))
    missing = np.flatnonzero(np.isnan(u))
    if missing.size:
        where = record.source or "record"
        raise BadRecord(
            f"{where}, channel {input!r}: sample {int(missing[0])} is missing; an integrating plant"
            " sums every sample of its input: leave the record's part with holes out"
        )
    channels = {input: from_straight_line(np.cumsum(u - u.mean())), output: from_straight_line(y)}
    units = {name: record.units[name] for name in (input, output)}
    return Record(channels, units, record.sample_time, source=record.source)


def from_straight_line(values: FloatArray) -> FloatArray:
    """`values` (n,) less their least-squares straight line; missing samples stay missing."""
    known = np.isfinite(values)
    if known.sum() < 2:
        return values
    time = np.linspace(-1.0, 1.0, len(values))
    lines = np.stack([np.ones(len(values)), time], axis=1)
    fitted, *_ = np.linalg.lstsq(lines[known], values[known], rcond=None)
    return np.asarray(values - lines @ fitted)


def integrated(summed: IdentifiedModel) -> IdentifiedModel:
    """The model from u of one from the summed input: a pole at one more, impulse responses
    summed.
    """
    system = summed.transfer_function()
    total = np.tri(summed.order)
    longer, longer_covariance = summed.longer_response, summed.longer_covariance
    if longer is not None and longer_covariance is not None:
        all_of_it = np.tri(summed.reach)
        longer, longer_covariance = np.cumsum(longer), all_of_it @ longer_covariance @ all_of_it.T
    return replace(
        summed,
        method=f"{summed.method}-integrator",
        impulse_response=np.cumsum(summed.impulse_response),
        covariance=total @ summed.covariance @ total.T,
        longer_response=longer,
        longer_covariance=longer_covariance,
        numerator=np.append(system.num, 0.0),
        denominator=np.convolve(system.den, [1.0, -1.0]),
        parameter_covariance=None,
        noise_numerator=summed.noise_numerator,
        pointwise_std=None,
        bands=None,
        offset=0.0,
        integrates=True,
    )
