"""Estimates of physical models by our descent and by SciPy's bounded least squares: the same residuals, slopes and bounds.

python -m benchmarks.descents
"""

import time
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.optimize import least_squares

import residuum as rs
from residuum.identification.physics.estimation import estimation

MACHINES = {
    "gate-drive": 20.0,
    "oscillator": 20.0,
    "two-tanks": 600.0,
    "oven": 600.0,
    "process": 600.0,
}
"""Machine → seconds of its record."""
ESTIMATION: Any = next(
    each
    for each in vars(estimation).values()
    if isinstance(each, type) and hasattr(each, "_descend")
)


class Residuals:
    """Residuals and slopes of an estimation, of all parameters and first states in one vector."""

    def __init__(self, of: Any, begin: Any) -> None:
        self._of, self._begin = of, begin
        self._q, self._s = len(of.names), len(of.state_index)
        self._at: tuple[bytes, Any] = (b"", None)

    def vector(self) -> np.ndarray:
        return np.concatenate(
            [self._begin.theta, *(x0[self._of.state_index] for x0 in self._begin.initial)]
        )

    def parted(self, x: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        initial = [x0.copy() for x0 in self._begin.initial]
        for k, x0 in enumerate(initial):
            x0[self._of.state_index] = x[self._q + k * self._s : self._q + (k + 1) * self._s]
        return x[: self._q], initial

    def both(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._at[0] != x.tobytes():
            theta, initial = self.parted(x)
            runs = self._of._runs(initial, self._of.p(theta), self._of.slopes)
            blocks = []
            for k, (r, slopes) in enumerate(self._of._weighted(runs)):
                J = np.zeros((r.size, len(x)))
                J[:, : self._q] = slopes[:, : self._q]
                J[:, self._q + k * self._s : self._q + (k + 1) * self._s] = slopes[:, self._q :]
                blocks.append((-r, J))
            self._at = (
                x.tobytes(),
                (np.concatenate([r for r, _ in blocks]), np.vstack([J for _, J in blocks])),
            )
        return self._at[1]


def by_scipy(self: Any, point: Any) -> tuple[Any, int, bool]:
    """In place of the estimation's own descent."""
    if not self.slopes:
        return point, 0, True
    residuals = Residuals(self, point)
    x = residuals.vector()
    free = np.full(len(x) - len(point.theta), np.inf)
    low, high = np.concatenate([self.lower, -free]), np.concatenate([self.upper, free])
    inside = np.clip(x, np.nextafter(low, np.inf), np.nextafter(high, -np.inf))
    found = least_squares(
        lambda x: residuals.both(x)[0], inside, lambda x: residuals.both(x)[1], bounds=(low, high), x_scale="jac",
        ftol=self.settings.tolerance, xtol=1e-14, gtol=1e-14, max_nfev=self.settings.iterations,
    )  # fmt: skip
    return self.point(residuals.parted(found.x)), found.nfev, found.status > 0


def main() -> None:
    print("| machine | ours [ms] | SciPy [ms] | RMS error, ours | SciPy |\n|---|---|---|---|---|")
    for machine, duration in MACHINES.items():
        record, cells = rs.simulate(machine, duration=duration, seed=1), []
        for descent in (ESTIMATION._descend, by_scipy):
            with patch.object(ESTIMATION, "_descend", descent):
                rs.model(machine).estimate(record)
                begin = time.process_time()
                model = rs.model(machine).estimate(record).model
                took = time.process_time() - begin
            outputs = model.compare(record).to_dict()["outputs"]
            cells.append(
                (f"{1e3 * took:.0f}", ", ".join(f"{each['rmse']:.8g}" for each in outputs.values()))
            )
        print(f"| {machine} | {cells[0][0]} | {cells[1][0]} | {cells[0][1]} | {cells[1][1]} |")


if __name__ == "__main__":
    main()
