"""What `model.explain(record)` gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from residuum.identification.discrepancy.explanation import Explanation as Explained
from residuum.identification.unseen_blocks.candidate import Candidate
from residuum.library.answers.explanation import explanation_json, explanation_text
from residuum.library.answers.quantities import sizes_text
from residuum.library.comparison import Comparison
from residuum.library.picture import Bars, Panel, Picture
from residuum.library.result import Result, Row

if TYPE_CHECKING:
    import pandas

_SHOWN = 8


@dataclass(frozen=True, eq=False, repr=False)
class Explanation(Result):
    """Which physical effect a model lacks, and how sure that is.

    Attributes
    ----------
    comparison : Comparison
        The model held against the records, as it is.
    found : Explanation
        The full numbers: `found.undetectable`, `found.next_experiment`, `found.free`, …

    Examples
    --------
    >>> import residuum as rs
    >>> record = rs.simulate("gate-drive", effects={"coulomb-friction": "large"}, duration=20.0, seed=1)
    >>> why = rs.model("gate-drive").explain(record, effects=["coulomb-friction", "quadratic-drag"])
    >>> why.verdict, why.best.effect, why.best.balance
    ('missing-effect', 'coulomb-friction', 'shaft')
    """

    comparison: Comparison
    found: Explained

    @property
    def verdict(self) -> str:
        """`missing-effect`, `adequate` or `unknown-effect`."""
        return self.found.verdict

    @property
    def best(self) -> Candidate | None:
        """The verdict's candidate (effect, balance, probability, parameters with standard deviation and unit), or None."""
        return next(iter(self.found.candidates), None)

    @property
    def candidates(self) -> pandas.DataFrame:
        """One row an effect, the verdict's first; MissingPackage when pandas is not installed."""
        return self.to_pandas()

    def _answer(self) -> dict[str, Any]:
        return self.comparison._answer() | explanation_json(self.found)

    def __str__(self) -> str:
        return f"{self.comparison}\n\n{explanation_text(self.found)}"

    def __repr__(self) -> str:
        best = (
            "" if self.best is None else f": {self.best.effect} in {self.best.balance}, probability {self.best.probability:.2f}"
        )
        return f"<residuum Explanation: {self.verdict}{best}>"

    def _rows(self) -> Sequence[Row]:
        return [
            {
                "effect": c.effect,
                "balance": c.balance,
                "probability": c.probability,
                "parameters": sizes_text(c.parameters),
                "error_before": c.error_before,
                "error_after": c.error_after,
                "error_unit": c.error_unit,
                "indistinguishable_from": list(c.indistinguishable_from),
                "step": c.step,
            }
            for c in self.found.candidates
        ]

    def _shown_rows(self) -> Sequence[Row]:
        return [
            {
                "effect": f"{row['effect']} in {row['balance']}",
                "probability": row["probability"],
                "parameters": row["parameters"],
                "error": f"{row['error_before']:.3g} → {row['error_after']:.3g} {row['error_unit']}",
                "not to be told from": row["indistinguishable_from"],
            }
            for row in self._rows()
        ]

    def _picture(self) -> Picture:
        shown = [c for c in self.found.candidates if c.step == 0][:_SHOWN]
        names = [f"{c.effect} in {c.balance}" for c in shown]
        texts = [f"{c.probability:.2f}" for c in shown]
        probable = Panel("probability", "", "probability", Bars(names, [c.probability for c in shown], texts, 1.0))
        if not shown:
            return Picture([probable])
        errors = [f"{c.error_before:.3g} → {c.error_after:.3g} {c.error_unit}" for c in shown]
        left = [100.0 * c.error_after / c.error_before if c.error_before > 0 else 100.0 for c in shown]
        return Picture(
            [probable, Panel("error that is left", "", "per cent of the error before", Bars(names, left, errors, 100.0))]
        )
