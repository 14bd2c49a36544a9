"""What `model.compare(record)` gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from residuum.identification.residual_analysis.compare import Comparison as Compared
from residuum.library.answers.comparison import comparison_json, comparison_text, region_json
from residuum.library.picture import Curve, Panel, Picture, axis
from residuum.library.result import Result, Row, data_frame

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """A model held against records: how large its error is, whether it is structured, and where it
    lies.

    Attributes
    ----------
    model : str
        Name of the model.
    records : tuple of str
        Names of the records.
    found : Comparison
        The full numbers: `found.simulation`, `found.smoothed`, `found.axes`, …

    Examples
    --------
    >>> import residuum as rs
    >>> record = rs.simulate("linear-axis", duration=2.0, seed=1)
    >>> comparison = rs.model("linear-axis").compare(record)
    >>> sorted(comparison.to_dict())
    ['balances', 'model', 'not_recorded', 'outputs', 'records', 'structured_error', 'warnings', 'where']
    """

    model: str
    records: tuple[str, ...]
    found: Compared

    @property
    def structured(self) -> bool:
        """Whether the error is more than noise: something predicts it."""
        return self.found.present

    @property
    def table(self) -> pandas.DataFrame:
        """One row an output: unit, RMS error, fit [%], bias, noise floor; MissingPackage when
        pandas is not installed.
        """
        return self.to_pandas()

    @property
    def where(self) -> pandas.DataFrame:
        """Where the error lies, the worst place first; MissingPackage when pandas is not
        installed.
        """
        return data_frame([region_json(region) for region in self.found.where])

    def _answer(self) -> dict[str, Any]:
        return comparison_json(self.model, list(self.records), self.found)

    def __str__(self) -> str:
        return comparison_text(self.found)

    def _rows(self) -> Sequence[Row]:
        return [
            {
                "output": name,
                "unit": output.unit,
                "rmse": output.rmse,
                "fit_percent": output.fit_percent,
                "bias": output.bias,
                "noise_floor": output.noise_floor,
            }
            for name, output in self.found.outputs.items()
        ]

    def _picture(self) -> Picture:
        experiment, predicted = self.found.experiments[0], self.found.simulation.predicted[0]
        time = experiment.t0 + experiment.sample_time * np.arange(experiment.n)
        outputs = [
            output
            for output in self.found.model.outputs.values()
            if output.name in self.found.outputs
        ]
        names = list(self.found.model.outputs)
        panels = []
        for output in outputs:
            # Columns of a simulation follow the model's outputs, of which not all are in every
            # record.
            k = names.index(output.name)
            curves = [
                Curve("measured", time, experiment.Y[:, k]),
                Curve("model", time, predicted[:, k]),
            ]
            panels.append(Panel(output.name, "time [s]", axis(output.name, output.unit), curves))
            error = [Curve("error", time, experiment.Y[:, k] - predicted[:, k])]
            panels.append(
                Panel(f"error of {output.name}", "time [s]", axis("error", output.unit), error)
            )
        return Picture(panels)
