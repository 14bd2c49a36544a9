"""Regions of the gate actuator's trained classifier around a stored movement."""

import httpx
import numpy as np
import pytest

from residuum.diagnosis.diagnosers.gate_actuator import GateActuator


@pytest.fixture(scope="module")
def service(run_service):
    service = run_service()
    trained, healthy = GateActuator.examples()
    judge = GateActuator().fit(trained.training, trained.labels)
    store = service.services.store
    for name, judge_of in (("gate", judge), ("new-gate", GateActuator().fit(healthy.training))):
        file = service.services.settings.data / f"{name}.baseline"
        judge_of.save(file)
        store.add_model_version(name, "baseline", file.read_bytes())
        for record in (trained.healthy[0], trained.faulty[0]):
            store.add_window(name, record, judge_of.score(record))
    return service


@pytest.fixture
def regions(service):
    with httpx.Client(base_url=service.url, timeout=60) as client:

        def regions(asset, window, **query):
            return client.get(
                f"/api/v1/assets/{asset}/windows/{window}/decision-regions", params=query
            )

        yield regions


def at(found, x, y):
    """The class at a place of the plane."""
    column, row = (
        np.argmin(np.abs(np.array(found["x"]) - x)),
        np.argmin(np.abs(np.array(found["y"]) - y)),
    )
    return found["classes"][found["region"][row][column]]


def test_each_movement_lies_in_the_region_of_its_class(service, regions):
    windows = service.services.store.findings("gate", limit=2).items
    for stored in windows:
        here, expected = stored.finding.indicators, stored.finding.fault_class or "healthy"
        for x, y in (("F1", "F2"), ("F2", "F1"), ("low_peak", "single_pulse")):
            found = regions(
                "gate", stored.window, x=x, y=y, x_to=2 * here[x], y_to=2 * here[y]
            ).json()
            assert at(found, here[x], here[y]) == expected, (x, y)
            assert (
                np.shape(found["region"]) == (len(found["y"]), len(found["x"]))
                and found["x"][-1] > 2 * here[x]
            )
    assert {stored.finding.fault_class for stored in windows} == {None, "pinion-or-gear"}
    wide = regions("gate", windows[0].window, x="F1", y="F2", x_to=100, y_to=100).json()
    assert len({each for row in wide["region"] for each in row}) > 1


def test_what_has_no_regions_says_so(service, regions):
    window = service.services.store.findings("new-gate", limit=1).items[0].window
    assert regions("new-gate", window, x="F1", y="F2").json()["features"] == []
    window = service.services.store.findings("gate", limit=1).items[0].window
    assert "F1" in regions("gate", window).json()["features"]
    refused = regions("gate", window, x="F1", y="warmth")
    assert refused.status_code == 422 and "single_pulse" in refused.json()["detail"]
