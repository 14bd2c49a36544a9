"""What `model.explain(record)` gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from residuum.identification.discrepancy.explain import Explanation as Explained
from residuum.identification.residual_analysis.locate import Axis
from residuum.identification.residual_analysis.term_curves import (
    binned,
    effect_curves,
    joined,
    telling,
)
from residuum.identification.unseen_blocks.verdict import Candidate
from residuum.library.answers.explanation import explanation_json, explanation_text
from residuum.library.answers.plain import sizes_text
from residuum.library.comparison import Comparison
from residuum.library.picture import Bars, Curve, Panel, Picture, axis
from residuum.library.result import Result, Row

if TYPE_CHECKING:
    import pandas

# Candidates whose probabilities are drawn.
_SHOWN = 8
# Candidates whose curves are drawn beside one another.
_COMPARED = 3
# Bins of the signal that the missing term is drawn over.
_BINS = 40


def _physical(axes: Sequence[Axis]) -> Sequence[Axis]:
    """The axes of which effects are functions, where there are any: an input goes along with most
    of them.
    """
    return [axis for axis in axes if axis.kind not in ("input", "time", "other")] or axes


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
    >>> hidden = {"coulomb-friction": "large"}
    >>> record = rs.simulate("gate-drive", effects=hidden, duration=20.0, seed=1)
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
        """The verdict's candidate (effect, balance, probability, parameters with standard deviation
        and unit), or None.
        """
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
            ""
            if self.best is None
            else (
                f": {self.best.effect} in {self.best.balance}, probability"
                f" {self.best.probability:.2f}"
            )
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
                "indistinguishable_from": list(c.rivals),
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
                "error": (
                    f"{row['error_before']:.3g} → {row['error_after']:.3g} {row['error_unit']}"
                ),
                "not to be told from": row["indistinguishable_from"],
            }
            for row in self._rows()
        ]

    def _picture(self) -> Picture:
        return Picture([*self._bars(), *self._by_block(), *self._over_what_is_missing()])

    def _bars(self) -> list[Panel]:
        """How probable each candidate of the first step is, and how much error it leaves."""
        shown = [c for c in self.found.candidates if c.step == 0][:_SHOWN]
        names = [f"{c.effect} in {c.balance}" for c in shown]
        texts = [f"{c.probability:.2f}" for c in shown]
        probable = Panel(
            "probability",
            "",
            "probability",
            Bars(names, [c.probability for c in shown], texts, 1.0),
        )
        # Without a candidate there is no error that one would leave.
        if not shown:
            return [probable]
        errors = [f"{c.error_before:.3g} → {c.error_after:.3g} {c.error_unit}" for c in shown]
        # An error of zero, where a model meets its record exactly, has no share that is left.
        left = [
            100.0 * c.error_after / c.error_before if c.error_before > 0 else 100.0 for c in shown
        ]
        return [
            probable,
            Panel(
                "error that is left",
                "",
                "per cent of the error before",
                Bars(names, left, errors, 100.0),
            ),
        ]

    def _by_block(self) -> list[Panel]:
        """The error of each output block by block, on blocks that no fit has seen."""
        blocks = self.found.blocks
        several = max(blocks.records) > 0  # their times begin anew
        at = (
            np.arange(len(blocks.times)) + 0.5
            if several
            else np.array([(begin + end) / 2 for begin, end in blocks.times])
        )
        # The verdict's candidates come first.
        leading = [c.key for c in self.found.candidates if c.key in blocks.candidates][:_COMPARED]
        panels = []
        for o, (output, unit) in enumerate(zip(blocks.outputs, blocks.units, strict=True)):
            curves = [Curve("the model as it is", at, blocks.before[:, o])]
            curves += [
                Curve(f"with {key.effect}", at, blocks.candidates[key][:, o]) for key in leading
            ]
            if len(self.found.accepted) > 1:
                curves.append(Curve("with all that was found", at, blocks.after[:, o]))
            x = "block, records one after the other" if several else "time [s]"
            panels.append(
                Panel(f"error of {output} on unseen blocks", x, axis("RMS error", unit), curves)
            )
        return panels

    def _over_what_is_missing(self) -> list[Panel]:
        """The term that the first candidate's balance lacks, over the signal that tells most of it,
        and what candidates add.
        """
        compared = self.comparison.found
        missing = [smoothed.missing for smoothed in compared.smoothed]
        candidates = [c for c in self.found.candidates if c.step == 0 and c.balance in missing[0]]
        if not candidates:
            return []
        balance = candidates[0].balance
        terms = [by_balance[balance] for by_balance in missing]
        # the records one after the other, as the axes are joined
        term = np.concatenate([smoothed.value for smoothed in terms])
        std = np.concatenate([smoothed.std for smoothed in terms])
        # The axis over which the term is most of a function; inputs go along with most of them.
        over = telling(_physical(joined(compared.axes)), term, _BINS)
        shown, band = binned(over.values, term, _BINS), 2.0 * binned(over.values, std, _BINS).mean
        curves = [
            Curve(
                "missing, ± 2 standard deviations",
                shown.at,
                shown.mean,
                shown.mean - band,
                shown.mean + band,
            )
        ]
        for candidate in [c for c in candidates if c.balance == balance][:_COMPARED]:
            curves += self._added_by(candidate, over)
        x, y = axis(over.name, over.unit), axis("missing term", terms[0].unit)
        return [Panel(f"what {balance} lacks", x, y, curves)]

    def _added_by(self, candidate: Candidate, over: Axis) -> list[Curve]:
        """What a candidate adds to its balance along a signal, where it is a function of that."""
        compared = self.comparison.found
        values = {name: quantity.value for name, quantity in candidate.parameters.items()}
        every = effect_curves(compared.model, compared.experiments, candidate.key, values)
        return [
            Curve(candidate.effect, curve.at, curve.mean)
            for along, curve in every
            if along.name == over.name
        ]
