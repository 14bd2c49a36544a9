"""How a diagnoser does on objects that it was not trained on, for the console and the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from residuum.diagnosis.learning.diagnoser_validation import (
    Fit,
    bootstrap_632_plus,
    validate_object_wise,
)
from residuum.identification.record import Record


def validated(
    how: str, fit: Fit, records: Sequence[Record], labels: Sequence[str], objects: Sequence[str]
) -> dict[str, Any]:
    """The `validation` object: `object-wise` with its confusion, or the `bootstrap` with its
    parts.
    """
    if how == "bootstrap":
        return {
            "how": how,
            "objects": len(set(objects)),
            **asdict(bootstrap_632_plus(fit, records, labels, objects)),
        }
    validation = validate_object_wise(fit, records, labels, objects)
    # A class that was only predicted has a column of the confusion, too.
    classes = sorted({*validation.truth.tolist(), *validation.predicted.tolist()})
    return {
        "how": how,
        "objects": len(set(objects)),
        "accuracy": validation.accuracy,
        "balanced_accuracy": validation.balanced_accuracy,
        "classes": classes,
        "confusion": validation.confusion(classes).tolist(),
    }


def validation_says(validation: Mapping[str, Any] | None) -> list[str]:
    """The same in a line for people."""
    if validation is None:
        return []
    if validation["how"] == "bootstrap":
        return [
            f"  error on new objects {100 * validation['error']:.3g} % (.632+ bootstrap of"
            f" {validation['objects']} objects, {validation['samples']} samples;"
            f" {100 * validation['apparent']:.3g} % of the records trained on)"
        ]
    return [
        f"  {100 * validation['accuracy']:.3g} % right on {validation['objects']} objects left out"
        f" in turn, {100 * validation['balanced_accuracy']:.3g} % balanced over the classes"
    ]
