"""A finding's category of NE 107, and what it states, follow from its verdict and its likeliest cause."""

import pytest

from residuum.diagnosis.finding import Finding


def faulty(*kinds, fault_class=None, **evidence):
    causes = [
        {"kind": kind, "name": f"{kind}-x", "place": "shaft", "probability": 0.6} for kind in kinds
    ]
    return Finding("d", "faulty", fault_class, evidence={"causes": causes} | evidence)


@pytest.mark.parametrize(
    ("finding", "category", "stated"),
    [
        (Finding("d", "healthy"), "good", ("healthy", None)),
        (Finding.not_assessable("d", "-"), "function-check", ("not-assessable", None)),
        (Finding.recorded("d"), "function-check", ("not-assessable", None)),
        (faulty("sensor", "effect"), "failure", ("sensor-x of shaft", 0.6)),
        (faulty("actuator"), "failure", ("actuator-x of shaft", 0.6)),
        (faulty("effect", "sensor"), "maintenance-required", ("effect-x of shaft", 0.6)),
        (faulty("parameter"), "maintenance-required", ("parameter-x of shaft", 0.6)),
        (faulty("disturbance"), "out-of-specification", ("disturbance-x of shaft", 0.6)),
        (faulty("unknown"), "out-of-specification", ("unknown-x of shaft", 0.6)),
        (faulty(fault_class="rack"), "maintenance-required", ("rack", None)),
        (
            faulty(fault_class="rack", probabilities={"rack": 0.7}),
            "maintenance-required",
            ("rack", 0.7),
        ),
        (faulty(), "maintenance-required", ("faulty", None)),
    ],
)
def test_category_and_statement(finding, category, stated):
    assert (finding.ne107, finding.statement) == (category, stated)
    assert finding.to_json()["ne107"] == category
