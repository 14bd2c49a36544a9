"""A residual generator from an identified plant, and what it says of records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from residuum.diagnosis.residuals.residual_design import ResidualDesign
from residuum.diagnosis.residuals.residual_detection import Detection, detect
from residuum.identification.record import Record as MeasuredRecord
from residuum.library.answers.residual import design_json, design_text, run_json, run_text
from residuum.library.picture import Curve, Panel, Picture, axis
from residuum.library.plant import Plant, plant_of
from residuum.library.questions import asks
from residuum.library.questions.residual import DesignResidual, RunResidual, residual_for
from residuum.library.reading import as_records
from residuum.library.result import Result, Row

Records = MeasuredRecord | str | PathLike[str] | Sequence[MeasuredRecord | str | PathLike[str]]
# Frequencies of the post-filter's gain that are drawn.
_FREQUENCIES = 300


@dataclass(frozen=True, eq=False, repr=False)
class ResidualRun(Result):
    """What a residual generator says of one record: is there a fault, since when, of which kind and
    size?

    Attributes
    ----------
    design : ResidualDesign
    record : Record
    found : Detection
        Residual, statistic and threshold at every sample, and the fault's estimate.

    Examples
    --------
    >>> import residuum as rs
    >>> healthy = rs.simulate("process-plant", seed=1)
    >>> made = rs.residual(rs.identify(healthy, input="u", output="y", order=40), healthy)
    >>> len(made.run(healthy).found.alarm) == healthy.n
    True
    """

    design: ResidualDesign
    record: MeasuredRecord
    found: Detection

    def _answer(self) -> dict[str, Any]:
        return run_json(self.design, self.record, self.found)

    def __str__(self) -> str:
        return run_text(self.design, self.record, self.found)

    def _rows(self) -> Sequence[Row]:
        samples = zip(
            self.record.time, self._residual, self.found.statistic, self.found.alarm, strict=True
        )
        return [
            {"time": float(t), "residual": float(r), "statistic": float(s), "alarm": bool(a)}
            for t, r, s, a in samples
        ]

    def _picture(self) -> Picture:
        time, unit = self.record.time, self.design.model.output_unit
        level = np.broadcast_to(np.asarray(self.found.threshold.level, dtype=float), time.shape)
        judged = [Curve("statistic", time, self.found.statistic), Curve("threshold", time, level)]
        return Picture(
            [
                Panel(
                    "residual",
                    "time [s]",
                    axis("residual", unit),
                    [Curve("residual", time, self._residual)],
                ),
                Panel(
                    "statistic", "time [s]", axis("statistic", self.found.threshold.unit), judged
                ),
            ]
        )

    @property
    def _residual(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Missing where it cannot be judged."""
        return np.where(self.found.signals.valid, self.found.signals.robust, np.nan)


@dataclass(frozen=True, eq=False, repr=False)
class Residual(Result):
    """A residual generator of a plant with the noise of its healthy records: what it lets through,
    and how it is run.

    Attributes
    ----------
    design : ResidualDesign
    healthy : tuple of Record

    Examples
    --------
    >>> import residuum as rs
    >>> healthy = rs.simulate("process-plant", seed=1)
    >>> made = rs.residual(rs.identify(healthy, input="u", output="y", order=40), healthy)
    >>> run = made.run(rs.simulate("process-plant", seed=2))
    >>> made.to_dict()["stable"], run.to_dict()["threshold_kind"]
    (True, 'posterior')
    """

    design: ResidualDesign
    healthy: tuple[MeasuredRecord, ...]

    @asks(RunResidual)
    def run(self, record: MeasuredRecord | str | PathLike[str], **given: Any) -> ResidualRun:
        """What the residual says of a record.

        Parameters
        ----------
        record : Record or file

        Returns
        -------
        ResidualRun

        Raises
        ------
        BadInput
            A record that does not fit the model; a threshold that the design has not.

        Examples
        --------
        See `Residual`.
        """
        asked = RunResidual.of(given)
        (known,) = as_records(record)
        return judged(self.design, known, asked)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the file `path` that `residuum residual run` reads.

        Parameters
        ----------
        path : str or path

        Raises
        ------
        BadInput
            The folder of `path` does not exist.

        Examples
        --------
        See `Residual`.
        """
        self.design.save(Path(path))

    def _answer(self) -> dict[str, Any]:
        return design_json(self.design, self.healthy, identified=None, file=None)

    def __str__(self) -> str:
        return design_text(self.design)

    def _rows(self) -> Sequence[Row]:
        return [
            {"quantity": name, "value": value}
            for name, value in self._answer().items()
            # Numbers alone: names, lists and objects of the answer have no row.
            if isinstance(value, float)
        ]

    def _picture(self) -> Picture:
        # Three decades up to π/Ts, as a plant's response is drawn.
        omega = np.geomspace(1e-3, 1.0, _FREQUENCIES) * np.pi / self.design.model.sample_time
        gain = np.abs(self.design.post_filter.Q.frequency_response(omega)).reshape(_FREQUENCIES)
        return Picture(
            [Panel("post-filter", "frequency [rad/s]", "|Q|", [Curve("|Q|", omega, gain)], "log")]
        )


def judged(design: ResidualDesign, record: MeasuredRecord, asked: RunResidual) -> ResidualRun:
    """What a design says of a record."""
    return ResidualRun(design, record, detect(design, record, **asked.model_dump()))


@asks(DesignResidual)
def residual(
    plant: Plant | str | PathLike[str], healthy: Records | None = None, **given: Any
) -> Residual:
    """A residual generator from an identified plant, its noise learned from healthy records.

    Parameters
    ----------
    plant : Plant or file
        Of one input and one output.
    healthy : Record, file, or a list of these
        None: those that the plant was identified from, as long as it holds them; without any the
        noise is as the model says.

    Returns
    -------
    Residual

    Raises
    ------
    BadInput
        Records that do not fit the model, or are too short for its memory.

    Examples
    --------
    See `Residual`.
    """
    asked, known = DesignResidual.of(given), plant_of(plant)
    records = known.estimation if healthy is None else tuple(as_records(healthy))
    return Residual(residual_for(known.identified, records, asked), records)
