"""The `identify` object of several inputs or outputs, and its short report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from residuum.identification.kernel_based.multivariable import MultivariableModel
from residuum.identification.record import Record


def multivariable_json(model: MultivariableModel, estimation: Sequence[Record], held_out: Sequence[Record]) -> dict[str, Any]:
    """Every path's static gain with its deviation, each output's fit, and the relative gain array of a square plant."""
    gains = model.frequency_response([0.0])[0].real
    std = [[float(np.sqrt(max(path.frequency_covariance(0.0)[0, 0, 0], 0.0))) for path in row] for row in model.models]
    square = gains.shape[0] == gains.shape[1] and abs(np.linalg.det(gains)) > 0
    return {
        "method": "kernel",
        "inputs": [{"name": path.input_name, "unit": path.input_unit} for path in model.models[0]],
        "outputs": [{"name": row[0].output_name, "unit": row[0].output_unit} for row in model.models],
        "sample_time": model.models[0][0].sample_time,
        "order": model.models[0][0].order,
        "static_gain": gains,
        "static_gain_std": std,
        "relative_gains": gains * np.linalg.inv(gains).T if square else None,
        "noise_variance": [row[0].noise_variance for row in model.models],
        "impulse_responses": [[path.impulse_response for path in row] for row in model.models],
        "fit_percent": [_fits(model, record) for record in estimation],
        "held_out_fit_percent": [_fits(model, record) for record in held_out],
        "file": None,
    }


def _fits(model: MultivariableModel, record: Record) -> dict[str, float]:
    """100 (1 − ‖y − ŷ‖/‖y − mean‖) of each output, where every input's past is known."""
    memory = max(path.delay + path.order for row in model.models for path in row)
    simulated = model.simulate(record)
    fits = {}
    for name, predicted in simulated.items():
        y = record[name][memory:]
        error = y - predicted[memory:]
        good = np.isfinite(error)
        fits[name] = float(100 * (1 - np.linalg.norm(error[good]) / np.linalg.norm(y[good] - np.mean(y[good]))))
    return fits


def multivariable_text(result: dict[str, Any]) -> str:
    """The short human report."""
    inputs, outputs = ([each["name"] for each in result[name]] for name in ("inputs", "outputs"))
    lines = [f"kernel: {', '.join(inputs)} → {', '.join(outputs)}, {result['order']} coefficients a path"]
    for i, output in enumerate(outputs):
        gains = ", ".join(
            f"{name} {result['static_gain'][i][j]:.4g} ± {result['static_gain_std'][i][j]:.2g}" for j, name in enumerate(inputs)
        )
        fits = ", ".join(f"{fit[output]:.2f} %" for fit in result["fit_percent"])
        lines.append(f"  {output}: static gain of {gains}; fit {fits}")
    if result["relative_gains"] is not None:
        rows = "; ".join(", ".join(f"{value:.3g}" for value in row) for row in result["relative_gains"])
        lines.append(f"  relative gains (rows: outputs) {rows}")
    return "\n".join([*lines, *([f"  written to {result['file']}"] if result["file"] else [])])
