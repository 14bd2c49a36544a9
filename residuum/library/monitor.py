"""Monitor: a diagnoser of one machine with scikit-learn's conventions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, OutlierMixin
from sklearn.exceptions import NotFittedError

from residuum.diagnosis.diagnosers import DIAGNOSERS, diagnoser_class, untrained
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.finding import Finding as Judged
from residuum.diagnosis.finding import Verdict
from residuum.diagnosis.residuals.generators.physical_prediction import PREDICTION, with_prediction
from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.physics import PhysicalModel
from residuum.identification.physics.fmu.permission import fmus_allowed
from residuum.identification.record import Record as MeasuredRecord
from residuum.library.finding import Finding
from residuum.library.model import Mapped, Model, Records
from residuum.library.reading import as_records
from residuum.library.result import data_frame

if TYPE_CHECKING:
    import pandas

MODEL_BASED = "model-based"
"""The diagnoser that a model asks for, where there is one."""
# A faulty output decides, whatever the others say; one that cannot be judged is not healthy.
_WORST_FIRST = (Verdict.FAULTY, Verdict.NOT_ASSESSABLE, Verdict.HEALTHY)


class NotFitted(BadInput, NotFittedError):
    """A monitor was asked to judge before it was given healthy records."""


class Monitor(OutlierMixin, BaseEstimator):
    """A watch over one machine: fitted on healthy records, it judges windows. Follows
    scikit-learn's conventions for outliers.

    A sample is a `Record` (a window); X is a list of them. `get_params`, `set_params` and
    `sklearn.base.clone` work; what is fitted ends with an underscore.

    Parameters
    ----------
    source : Model or str
        What watches: a model of the machine, or the id of a diagnoser (`robust-residual`,
        `bearing`, …).
    diagnoser : str or None
        With a model, the diagnoser that judges it; None: `model-based` where there is one, else the
        robust residual of what the model's prediction leaves over.
    map : mapping of name to column
        For columns that are not named as the model or the diagnoser names them.
    settings : mapping or None
        Of the diagnoser: `{"speed_rpm": 1500.0}`, …

    Attributes
    ----------
    diagnoser_ : Diagnoser
        The trained diagnoser.

    Examples
    --------
    >>> import residuum as rs
    >>> healthy = [rs.simulate("process-plant", seed=seed) for seed in (1, 2)]
    >>> monitor = rs.monitor("robust-residual").fit(healthy)
    >>> faulty = rs.simulate("process-plant", faults={"sensor-offset": None}, seed=4)
    >>> monitor.predict([rs.simulate("process-plant", seed=3), faulty]).tolist()
    [1, -1]
    """

    def __init__(
        self,
        source: Model | str = "robust-residual",
        diagnoser: str | None = None,
        map: Mapped = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        # As given and unchecked: scikit-learn copies an estimator by the keywords that it was made
        # with.
        self.source, self.diagnoser, self.map, self.settings = source, diagnoser, map, settings

    def fit(self, X: Records, y: Sequence[str] | None = None) -> Self:
        """Learn from the healthy records `X`, or from records with one label each in `y`
        (`healthy`, or a fault class).

        Parameters
        ----------
        X : Record, file, or a list of these
        y : sequence of str, or None
            A label a record; None: all are healthy.

        Returns
        -------
        Monitor
            Itself.

        Raises
        ------
        BadInput
            Records that do not fit, an unknown diagnoser or setting, labels of another number than
            records.

        Examples
        --------
        See `Monitor`.

        >>> import residuum as rs
        >>> rs.monitor("robust-residual").fit(rs.simulate("process-plant", seed=1)).diagnoser_.name
        'robust-residual'
        """
        trained = self._untrained().fit(
            self._records(X), None if y is None else [str(label) for label in y]
        )
        # The underscore behind the name is scikit-learn's mark of what `fit` has learned.
        self.diagnoser_: Diagnoser | PhysicalResidual = trained
        return self

    # another meaning than scikit-learn's, as issued
    def score(self, window: MeasuredRecord | str | PathLike[str]) -> Finding:
        """The finding of one window.

        Parameters
        ----------
        window : Record or file

        Returns
        -------
        Finding

        Raises
        ------
        NotFitted
            Before `fit`.
        BadRecord
            A channel that was learned is missing.

        Examples
        --------
        >>> import residuum as rs
        >>> healthy = [rs.simulate("process-plant", seed=seed) for seed in (1, 2)]
        >>> monitor = rs.monitor("robust-residual").fit(healthy)
        >>> faulty = rs.simulate("process-plant", faults={"sensor-offset": None}, seed=4)
        >>> windows = [rs.simulate("process-plant", seed=3), faulty]
        >>> monitor.score(windows[1]).fault_class
        'sensor-offset'
        """
        (record,) = self._records(window)
        return Finding(self._trained().score(record))

    def findings(self, X: Records) -> list[Finding]:
        """The finding of every window of `X` (a record, a file, or a list of these).

        Parameters
        ----------
        X : Record, file, or a list of these
            Windows.

        Returns
        -------
        list of Finding

        Examples
        --------
        >>> import residuum as rs
        >>> healthy = [rs.simulate("process-plant", seed=seed) for seed in (1, 2)]
        >>> monitor = rs.monitor("robust-residual").fit(healthy)
        >>> faulty = rs.simulate("process-plant", faults={"sensor-offset": None}, seed=4)
        >>> windows = [rs.simulate("process-plant", seed=3), faulty]
        >>> [finding.verdict for finding in monitor.findings(windows)]
        ['healthy', 'faulty']
        """
        trained = self._trained()
        return [Finding(trained.score(record)) for record in self._records(X)]

    def predict(self, X: Records) -> npt.NDArray[np.int64]:
        """1 for a healthy window of `X`, −1 for a faulty one, 0 for one that cannot be judged;
        shape (windows,).

        Parameters
        ----------
        X : Record, file, or a list of these
            Windows.

        Returns
        -------
        array of int, shape (windows,)

        Examples
        --------
        See `Monitor`.

        >>> import residuum as rs
        >>> healthy = [rs.simulate("process-plant", seed=seed) for seed in (1, 2)]
        >>> monitor = rs.monitor("robust-residual").fit(healthy)
        >>> faulty = rs.simulate("process-plant", faults={"sensor-offset": None}, seed=4)
        >>> windows = [rs.simulate("process-plant", seed=3), faulty]
        >>> monitor.predict(windows).tolist()
        [1, -1]
        """
        # 1 and −1 are scikit-learn's; it has no word for a window that cannot be judged.
        says = {Verdict.HEALTHY: 1, Verdict.FAULTY: -1, Verdict.NOT_ASSESSABLE: 0}
        return np.array(
            [says[finding.found.verdict] for finding in self.findings(X)], dtype=np.int64
        )

    def score_samples(self, X: Records) -> npt.NDArray[np.float64]:
        """How normal each window of `X` is, the higher the more: minus its largest indicator over
        that one's threshold.

        Shape (windows,); below −1 an indicator is above its threshold, NaN for a window that cannot
        be judged.

        Parameters
        ----------
        X : Record, file, or a list of these
            Windows.

        Returns
        -------
        array, shape (windows,)

        Examples
        --------
        >>> import residuum as rs
        >>> healthy = [rs.simulate("process-plant", seed=seed) for seed in (1, 2)]
        >>> monitor = rs.monitor("robust-residual").fit(healthy)
        >>> faulty = rs.simulate("process-plant", faults={"sensor-offset": None}, seed=4)
        >>> windows = [rs.simulate("process-plant", seed=3), faulty]
        >>> (monitor.score_samples(windows) < -1).tolist()
        [False, True]
        """
        return np.array([-_largest(finding.found) for finding in self.findings(X)])

    def decision_function(self, X: Records) -> npt.NDArray[np.float64]:
        """`score_samples` + 1 of the windows `X`: negative where an indicator is above its
        threshold; shape (windows,).

        Parameters
        ----------
        X : Record, file, or a list of these
            Windows.

        Returns
        -------
        array, shape (windows,)

        Examples
        --------
        >>> import residuum as rs
        >>> healthy = [rs.simulate("process-plant", seed=seed) for seed in (1, 2)]
        >>> monitor = rs.monitor("robust-residual").fit(healthy)
        >>> faulty = rs.simulate("process-plant", faults={"sensor-offset": None}, seed=4)
        >>> windows = [rs.simulate("process-plant", seed=3), faulty]
        >>> (monitor.decision_function(windows) < 0).tolist()
        [False, True]
        """
        # At its threshold an indicator is 1 of it: below 0 is an outlier, as scikit-learn has it.
        return self.score_samples(X) + 1.0

    def indicators(self, X: Records) -> pandas.DataFrame:
        """The indicators of every window of `X`, a row a window: features of the residual for a
        method of your own.

        Raises MissingPackage when pandas is not installed.

        Parameters
        ----------
        X : Record, file, or a list of these
            Windows.

        Returns
        -------
        pandas.DataFrame
            A row a window, a column an indicator.

        Examples
        --------
        >>> import residuum as rs
        >>> healthy = [rs.simulate("process-plant", seed=seed) for seed in (1, 2)]
        >>> monitor = rs.monitor("robust-residual").fit(healthy)
        >>> faulty = rs.simulate("process-plant", faults={"sensor-offset": None}, seed=4)
        >>> windows = [rs.simulate("process-plant", seed=3), faulty]
        >>> len(monitor.indicators(windows))
        2
        """
        return data_frame([dict(finding.found.indicators) for finding in self.findings(X)])

    def save(self, path: str | PathLike[str]) -> None:
        """Store the trained diagnoser in the file `path`, as `residuum train --out` does.

        Parameters
        ----------
        path : str or path

        Raises
        ------
        NotFitted
            Before `fit`.
        BadInput
            A diagnoser that has no file.

        Examples
        --------
        See `load_monitor`.

        >>> import residuum as rs
        >>> rs.monitor("robust-residual").save("baseline.zip")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
            ...
        residuum.library.monitor.NotFitted: ...
        """
        trained = self._trained()
        if isinstance(trained, PhysicalResidual):
            raise BadInput(
                f"monitor: the diagnoser {trained.name!r} has no file; choose one that `residuum"
                " train` knows"
            )
        trained.save(Path(path))

    def __sklearn_is_fitted__(self) -> bool:
        """Whether `fit` was called."""
        return hasattr(self, "diagnoser_")

    def _untrained(self) -> Diagnoser | PhysicalResidual:
        settings = dict(self.settings or {})
        if isinstance(self.source, Model):
            name = self.diagnoser or (MODEL_BASED if MODEL_BASED in DIAGNOSERS else "")
            if name:
                return untrained(diagnoser_class(name), model=self.source.watched, **settings)
            return PhysicalResidual(self.source.physical, **settings)
        return untrained(diagnoser_class(self.diagnoser or self.source), **settings)

    def _records(self, X: Records) -> list[MeasuredRecord]:
        """The windows, their columns named as the model names them."""
        names = {column: name for name, column in (self.map or {}).items()}
        return [record.rename(names) for record in as_records(X)]

    def _trained(self) -> Diagnoser | PhysicalResidual:
        if not hasattr(self, "diagnoser_"):
            raise NotFitted("monitor: is not fitted; give it healthy records with fit() first")
        return self.diagnoser_


def monitor(
    source: Model | str,
    *,
    diagnoser: str | None = None,
    map: Mapped = None,
    **settings: Any,
) -> Monitor:
    """A watch over one machine, to be fitted on healthy records.

    Parameters
    ----------
    source : Model or str
        A model of the machine, or the id of a diagnoser: `robust-residual`, `bearing`,
        `gate-actuator`, `gripping-pliers`.
    diagnoser : str
        With a model: the diagnoser that judges it (default: `model-based` where there is one).
    map : mapping of name to column
    settings
        Of the diagnoser, as `speed_rpm=1500.0`.

    Returns
    -------
    Monitor

    Raises
    ------
    BadInput
        At `fit`: an unknown diagnoser or setting.

    Examples
    --------
    See `Monitor`.

    >>> import residuum as rs
    >>> rs.monitor(rs.model("gate-drive"), map={"speed": "n_motor"})
    Monitor(map={'speed': 'n_motor'}, source=<residuum Model 'gate-drive': voltage → speed, current>)
    """
    return Monitor(source, diagnoser, map, settings or None)


def load_monitor(diagnoser: str, path: str | PathLike[str], *, allow_fmus: bool = False) -> Monitor:
    """The monitor whose trained diagnoser `Monitor.save` or `residuum train --out` stored.

    Parameters
    ----------
    diagnoser : str
        Its id.
    path : str or path
    allow_fmus : bool
        Read a baseline that holds an FMU, too, whose native code then runs in this process. Say it
        of files whose author you trust.

    Returns
    -------
    Monitor

    Raises
    ------
    BadInput
        An unknown diagnoser; not the file of one of this kind.
    Forbidden
        It holds an FMU, and `allow_fmus` was not said.

    Examples
    --------
    >>> import residuum as rs, tempfile, pathlib
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "baseline.zip"
    >>> rs.monitor("robust-residual").fit(rs.simulate("process-plant", seed=1)).save(file)
    >>> rs.load_monitor("robust-residual", file).score(rs.simulate("process-plant", seed=2)).verdict
    'healthy'
    """
    loaded = Monitor(diagnoser)
    with fmus_allowed(allow_fmus):
        loaded.diagnoser_ = diagnoser_class(diagnoser).load(Path(path))
    return loaded


def _largest(finding: Judged) -> float:
    # Any number would pass for a judgement.
    if finding.verdict is Verdict.NOT_ASSESSABLE:
        return math.nan
    # A threshold of 0 has no multiple.
    over = [
        v / finding.thresholds[n]
        for n, v in finding.indicators.items()
        if finding.thresholds.get(n, 0.0) > 0.0
    ]
    return max(over, default=math.nan)


class PhysicalResidual:
    """One robust residual an output, from the model's prediction to the measurement; the worst
    finding is the answer.

    Parameters
    ----------
    model : PhysicalModel
    settings
        Of `RobustResidual`: `order`, `gamma`, `false_alarms_per_day`.
    """

    name = "physical-residual"

    def __init__(self, model: PhysicalModel, **settings: Any) -> None:
        self.model, self.settings = model, settings
        self._watches: dict[str, RobustResidual] = {}

    def fit(self, records: Sequence[MeasuredRecord], labels: Sequence[str] | None = None) -> Self:
        """Learn each output's residual from healthy records.

        Raises
        ------
        BadRecord
            No output of the model is in every record.
        """
        # An output that some record lacks has no healthy noise to be learned from there.
        measured = [
            name for name in self.model.outputs if all(name in record.names for record in records)
        ]
        if not measured:
            raise BadRecord(
                f"model {self.model.name!r}: no output of it is in every record; it has"
                f" {', '.join(self.model.outputs)}"
            )
        for name in measured:
            watch = RobustResidual(input=PREDICTION, output=name, **self.settings)
            self._watches[name] = watch.fit(
                [self._beside(record, name) for record in records], labels
            )
        return self

    def score(self, record: MeasuredRecord) -> Judged:
        """Judge one window by every output; indicators are named `glr@output`."""
        findings = {
            name: watch.score(self._beside(record, name)) for name, watch in self._watches.items()
        }
        # Of equal verdicts the one whose residual is largest.
        name, worst = min(findings.items(), key=lambda item: _order(item[1]))
        return replace(
            worst,
            diagnoser=self.name,
            indicators=_joined({n: f.indicators for n, f in findings.items()}),
            thresholds=_joined({n: f.thresholds for n, f in findings.items()}),
            units=_joined({n: f.units for n, f in findings.items()}),
            evidence=dict(worst.evidence) | {"output": name},
            reason=None if worst.reason is None else f"{name}: {worst.reason}",
        )

    def _beside(self, record: MeasuredRecord, output: str) -> MeasuredRecord:
        return with_prediction(self.model, record, output)


def _order(finding: Judged) -> tuple[int, float]:
    return _WORST_FIRST.index(finding.verdict), -finding.indicators.get("glr", 0.0)


def _joined(parts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {f"{key}@{name}": value for name, part in parts.items() for key, value in part.items()}
