"""Linear models of several inputs and outputs, as an answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.kernel_based.multivariable import (
    MultivariableModel,
    identify_multivariable,
    multivariable_text,
)
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.record import Record
from residuum.library.picture import Curve, Panel, Picture, axis
from residuum.library.questions.identify import LAGS, Identify
from residuum.library.result import Result, Row
from residuum.library.whole_file import write_whole

_BAND = 1.96
"""Standard deviations of a 95 % band."""


@dataclass(frozen=True, eq=False, repr=False)
class MultivariablePlant(Result):
    """Linear models from every input to every output, which know how far to trust them.

    Attributes
    ----------
    identified : MultivariableModel
        `identified.models[i][j]` leads from input j to output i.
    estimation, held_out : tuple of Record
        What it was identified from, and what the records' split notes kept.

    Examples
    --------
    >>> import numpy as np, residuum as rs
    >>> u, w = np.random.default_rng(0).normal(size=(2, 300))
    >>> y = np.r_[0.0, 0.5 * u[:-1] + 0.2 * w[:-1]]
    >>> record = rs.from_arrays({"u": u, "w": w, "y": y}, units={"u": "V", "w": "V", "y": "K"}, sample_time=1.0)
    >>> plant = rs.identify(record, input=["u", "w"], output="y", order=5)
    >>> [[round(gain, 2) for gain in row] for row in plant.to_dict()["static_gain"]]
    [[0.5, 0.2]]
    """

    identified: MultivariableModel
    estimation: tuple[Record, ...] = ()
    held_out: tuple[Record, ...] = ()

    def text(self) -> str:
        """The JSON text that `save` writes."""
        return multivariable_text(self.identified)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the JSON file `path` that `residuum residual` and `residuum control` read.

        Parameters
        ----------
        path : str or path
        """
        write_whole(Path(path), self.text())

    def _answer(self) -> dict[str, Any]:
        """Every path's static gain with its deviation, each output's fit, and the relative gain
        array of a square plant.
        """
        model = self.identified
        gains = model.frequency_response([0.0])[0].real
        std = [
            [float(np.sqrt(max(path.frequency_covariance(0.0)[0, 0, 0], 0.0))) for path in row]
            for row in model.models
        ]
        square = gains.shape[0] == gains.shape[1] and abs(np.linalg.det(gains)) > 0
        return {
            "method": "kernel",
            "inputs": [
                {"name": path.input_name, "unit": path.input_unit} for path in model.models[0]
            ],
            "outputs": [
                {"name": row[0].output_name, "unit": row[0].output_unit} for row in model.models
            ],
            "sample_time": model.models[0][0].sample_time,
            "order": model.models[0][0].order,
            "static_gain": gains,
            "static_gain_std": std,
            "relative_gains": gains * np.linalg.inv(gains).T if square else None,
            "noise_variance": [row[0].noise_variance for row in model.models],
            "impulse_responses": [[path.impulse_response for path in row] for row in model.models],
            "fit_percent": [_fits(model, record) for record in self.estimation],
            "held_out_fit_percent": [_fits(model, record) for record in self.held_out],
            "file": None,
        }

    def __str__(self) -> str:
        return self.report(self._answer())

    def report(self, result: dict[str, Any]) -> str:
        """The short human report of an answer of `to_dict`, which may name the model's file.

        Parameters
        ----------
        result : dict
            As `to_dict` gives it.
        """
        inputs, outputs = (
            [channel["name"] for channel in result[name]] for name in ("inputs", "outputs")
        )
        lines = [
            f"kernel: {', '.join(inputs)} → {', '.join(outputs)}, {result['order']} coefficients a"
            " path"
        ]
        for i, output in enumerate(outputs):
            gains = ", ".join(
                f"{name} {result['static_gain'][i][j]:.4g} ± {result['static_gain_std'][i][j]:.2g}"
                for j, name in enumerate(inputs)
            )
            fits = ", ".join(f"{fit[output]:.2f} %" for fit in result["fit_percent"])
            lines.append(f"  {output}: static gain of {gains}; fit {fits}")
        if result["relative_gains"] is not None:
            rows = "; ".join(
                ", ".join(f"{value:.3g}" for value in row) for row in result["relative_gains"]
            )
            lines.append(f"  relative gains (rows: outputs) {rows}")
        return "\n".join([*lines, *([f"  written to {result['file']}"] if result["file"] else [])])

    def _paths(self) -> list[IdentifiedModel]:
        return [path for row in self.identified.models for path in row]

    def _rows(self) -> Sequence[Row]:
        answer = self._answer()
        gains, spreads = (np.ravel(answer[name]) for name in ("static_gain", "static_gain_std"))
        return [
            {
                "input": path.input_name,
                "output": path.output_name,
                "static_gain": float(gain),
                "std": float(std),
            }
            for path, gain, std in zip(self._paths(), gains, spreads, strict=True)
        ]

    def _picture(self) -> Picture:
        return Picture([response_panel(path) for path in self._paths()])


def response_panel(model: IdentifiedModel) -> Panel:
    """The impulse response of a model with its 95 % band."""
    times = model.sample_time * (model.delay + np.arange(model.order))
    g, spread = model.impulse_response, _BAND * model.std
    title = f"impulse response, {model.input_name} → {model.output_name}"
    return Panel(
        title,
        "time [s]",
        axis("g", gain_unit(model)),
        [Curve("impulse response", times, g, g - spread, g + spread)],
    )


def gain_unit(model: IdentifiedModel) -> str:
    """Output unit over input unit; empty where neither channel has one."""
    return (
        f"{model.output_unit or '1'}/{model.input_unit or '1'}"
        if model.output_unit or model.input_unit
        else ""
    )


def multivariable_plant(
    estimation: Sequence[Record], held_out: Sequence[Record], asked: Identify
) -> MultivariablePlant:
    """One kernel model of every path."""
    model = identify_multivariable(
        estimation, asked.inputs, asked.outputs, kernel=asked.kernel, order=LAGS if asked.order is None else asked.order,
        delay=1 if asked.delay is None else asked.delay, noise_variance=asked.noise_variance, offset=asked.offset,
    )  # fmt: skip
    return MultivariablePlant(model, tuple(estimation), tuple(held_out))


def _fits(model: MultivariableModel, record: Record) -> dict[str, float]:
    """100 (1 − ‖y − ŷ‖/‖y − mean‖) of each output, where every input's past is known."""
    memory = max(path.delay + path.order for row in model.models for path in row)
    simulated = model.simulate(record)
    fits = {}
    for name, predicted in simulated.items():
        y = record[name][memory:]
        error = y - predicted[memory:]
        good = np.isfinite(error)
        fits[name] = float(
            100 * (1 - np.linalg.norm(error[good]) / np.linalg.norm(y[good] - np.mean(y[good])))
        )
    return fits
