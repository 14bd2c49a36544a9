"""Whether the weights of a plant of two inputs and two outputs lie above its true error where two of its paths outlast the order.

Paths of time constants 33, 20, 4.5 and 2 samples, 50 lags a path, variance ratio 25; true |E_ij| over |W_ij|, the largest of the
four elements, at 3000 frequencies that no fit has seen. With and without the longer responses that random models come from.

python -m benchmarks.multivariable_bound --records 6
"""

from __future__ import annotations

import argparse

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from residuum.identification.kernel_based.multivariable import identify_multivariable
from residuum.identification.record import Record
from residuum.robust_control.multivariable_control import MultivariableProblem

PATHS = (((0.3, 0.97), (0.2, 0.6)), ((-0.1, 0.8), (0.5, 0.95)))
"""Gain b and pole a of b z⁻¹/(1 − a z⁻¹), outputs by inputs."""
SAMPLES, ORDER, RATIO, UNSEEN = 3000, 50, 25.0, 3000


def record(seed: int) -> Record:
    """White inputs; white noise on each output."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((2, SAMPLES))
    y = np.stack(
        [
            sum(lfilter([0.0, b], [1.0, -a], one) for (b, a), one in zip(row, u, strict=True))
            for row in PATHS
        ]
    )
    y += rng.standard_normal(y.shape) * y.std(axis=1, keepdims=True) / np.sqrt(RATIO)
    return Record(
        {"u0": u[0], "u1": u[1], "y0": y[0], "y1": y[1]},
        dict.fromkeys(("u0", "u1", "y0", "y1"), ""),
        1.0,
    )


def ratios(problem: MultivariableProblem) -> npt.NDArray[np.float64]:
    """True |E_ij| over |W_ij| of a problem for this plant, outputs by inputs by unseen frequencies."""
    omega = np.exp(np.random.default_rng(1).uniform(np.log(1e-3), np.log(np.pi), UNSEEN))
    z = np.exp(1j * omega)
    G = np.array([[b / (z - a) for b, a in row] for row in PATHS])
    decoupled = np.einsum("pqw,qr->prw", G, problem.decoupler)
    found = np.empty(decoupled.shape)
    for i, loop in enumerate(problem.loops):
        own = loop.plant.frequency_response(omega)
        for j, weight in enumerate(loop.weights):
            error = np.abs((decoupled[i, j] - (own if i == j else 0.0)) / own)
            found[i, j] = error / np.abs(weight.frequency_response(omega))
    return found


def true_error_over_weight(data: Record, *, cover_cut: bool) -> tuple[float, list[int]]:
    """The largest over elements and frequencies, and the lengths of the responses that models were drawn from."""
    model = identify_multivariable(
        data, ["u0", "u1"], ["y0", "y1"], order=ORDER, cover_cut=cover_cut
    )
    worst = float(ratios(MultivariableProblem(model)).max())
    lengths = [ORDER if one is None else len(one.mean) // 2 for one in model.longer or (None, None)]
    return worst, lengths


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=6)
    given = parser.parse_args()
    print("| record | order alone | longer responses | their lengths |\n|---|---|---|---|")
    for seed in range(given.records):
        data = record(seed)
        alone, _ = true_error_over_weight(data, cover_cut=False)
        covered, lengths = true_error_over_weight(data, cover_cut=True)
        print(
            f"| {seed} | {alone:.2f} | {covered:.2f} | {', '.join(map(str, lengths))} |", flush=True
        )


if __name__ == "__main__":
    main()
