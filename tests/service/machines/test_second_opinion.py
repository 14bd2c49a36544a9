"""A second opinion stands beside the finding that decides, and changes neither verdict nor alarms."""

import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.service.fieldbus.settings import (
    MachineSettings,
    SecondOpinion,
    SourceSettings,
    WindowSettings,
)
from residuum.service.machines.baselines import what_is_trained, with_second_opinion

CAUSE = {"kind": "sensor", "name": "offset", "place": "y", "probability": 0.9}


def machine(second):
    return MachineSettings(
        asset="plant",
        diagnoser="robust-residual",
        window=WindowSettings(cut="sliding"),
        sources=[SourceSettings(kind="modbus", port=1, map="process_plant.yaml")],
        second=second,
    )


def test_a_disagreement_is_told_and_the_first_one_decides():
    first = Finding("robust-residual", "healthy", reason="within")
    second = Finding(
        "model-based",
        "faulty",
        "sensor-offset",
        {"deviation": 9.0},
        {"deviation": 4.0},
        evidence={"causes": [CAUSE]},
    )
    both = with_second_opinion(first, second)
    assert both.verdict == "healthy" and both.fault_class is None
    told = both.to_json()["evidence"]["second_opinion"]
    assert not told["agrees"] and told["verdict"] == "faulty" and told["causes"] == [CAUSE]
    assert with_second_opinion(first, Finding("model-based", "healthy")).evidence["second_opinion"][
        "agrees"
    ]


def test_its_baseline_has_a_name_of_its_own(run_service):
    store = run_service().services.store
    settings = machine(SecondOpinion(model="process"))
    assert what_is_trained(store, settings, second=False)[:2] == ("robust-residual", "plant")
    assert what_is_trained(store, settings, second=True) == (
        "model-based",
        "plant.second",
        "process",
    )
    with pytest.raises(BadInput, match="has no second opinion"):
        what_is_trained(store, machine(None), second=True)
