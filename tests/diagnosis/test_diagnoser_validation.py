"""Any diagnoser on objects not trained on: what it has learnt of all objects counts, what it knows of one does not."""

import numpy as np
import pytest

from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.learning.diagnoser_validation import (
    bootstrap_632_plus,
    validate_object_wise,
)
from residuum.identification.errors import BadInput
from residuum.identification.record import Record


class Remembers:
    """Calls a record by the label of the nearest it was trained on; `column` says what of the record it looks at."""

    def __init__(self, records, labels, column):
        self.known, self.labels, self.column = (
            [record[column][0] for record in records],
            labels,
            column,
        )

    def score(self, record):
        label = self.labels[int(np.argmin(np.abs(np.array(self.known) - record[self.column][0])))]
        verdict = Verdict.HEALTHY if label == "healthy" else Verdict.FAULTY
        return Finding("remembers", verdict, None if label == "healthy" else label, {}, {}, {}, {})


def world(column):
    """Ten objects of two labels; `level` tells the label, `serial` only the object."""
    records, labels, objects = [], [], []
    rng = np.random.default_rng(0)
    for item in range(10):
        label = "worn" if item % 2 else "healthy"
        for _ in range(4):
            values = {"level": 5.0 * item % 10 + rng.normal(), "serial": item + 0.01 * rng.normal()}
            records.append(
                Record(
                    {k: np.full(3, v) for k, v in values.items()}, {"level": "", "serial": ""}, 1.0
                )
            )
            labels.append(label)
            objects.append(str(item))

    def fit(kept):
        return Remembers([records[k] for k in kept], [labels[k] for k in kept], column)

    return fit, records, labels, objects


def test_what_is_true_of_all_objects_is_found_on_new_ones():
    fit, *rest = world("level")
    assert validate_object_wise(fit, *rest).accuracy > 0.9
    assert bootstrap_632_plus(fit, *rest).error < 0.1


def test_knowing_each_object_by_heart_helps_no_new_one():
    fit, *rest = world("serial")
    assert validate_object_wise(fit, *rest).accuracy < 0.3
    found = bootstrap_632_plus(fit, *rest)
    assert found.apparent == 0.0 and found.no_information == pytest.approx(0.5)
    assert (
        found.out_of_bag > 0.5
        and found.overfitting == pytest.approx(1.0)
        and found.error == pytest.approx(0.5)
    )


def test_one_object_is_refused():
    fit, records, labels, _ = world("level")
    for judged in (validate_object_wise, bootstrap_632_plus):
        with pytest.raises(BadInput, match="at least two are needed"):
            judged(fit, records, labels, ["one"] * len(records))
