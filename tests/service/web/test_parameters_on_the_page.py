"""A machine's page shows causes, a second opinion that disagrees, and parameters as control charts with the time to a limit."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from playwright.sync_api import expect

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.storage import disk_store

FRICTION = {
    "kind": "effect",
    "name": "coulomb-friction",
    "place": "shaft",
    "probability": 0.93,
    "indistinguishable_from": ["load-friction@shaft"],
    "says": "friction of the shaft 0.031 ± 0.002 N·m, healthy 0.018 to 0.022",
}
LUGRE = FRICTION | {"name": "lugre", "probability": 0.07, "indistinguishable_from": []}
BARELY = FRICTION | {"name": "backlash", "probability": 4e-4, "indistinguishable_from": []}
"""Rounded to what the page shows it is 0 %."""
SECOND = {
    "diagnoser": "model-based",
    "verdict": "healthy",
    "reason": "within the limit",
    "causes": [BARELY],
}
MISSING = {"effect": "quadratic-drag", "place": "shaft", "parameters": {}}


@pytest.fixture(scope="module")
def worn_fan(run_service):
    service = run_service()
    rng, begin = np.random.default_rng(3), datetime.now(UTC) - timedelta(minutes=30)
    for k in range(30):
        record = Record({"speed": rng.standard_normal(100)}, {"speed": "rad/s"}, 0.01, t0=float(k))
        value = {"value": 1.0 + 0.02 * k + 0.02 * rng.standard_normal(), "std": 0.02, "unit": "ohm"}
        faulty = k > 25
        evidence = {
            "parameters": {"R": value | {"healthy": {"low": 0.9, "high": 1.3}}},
            "causes": [FRICTION, LUGRE, BARELY] if faulty else [],
            "missing_physics": [MISSING],
            "second_opinion": SECOND,
        }
        finding = Finding(
            "model-based",
            "faulty" if faulty else "healthy",
            "effect" if faulty else None,
            reason="a test",
            evidence=evidence,
        )
        # windows come evenly, however busy this computer is
        with pytest.MonkeyPatch.context() as clock:
            clock.setattr(
                disk_store, "_now", lambda moment=begin + k * timedelta(minutes=1): moment
            )
            service.services.store.add_window("fan", record, finding)
    return service


@pytest.mark.parametrize("size", [(1280, 900), (390, 844)])
def test_causes_and_parameters_of_a_machine(worn_fan, open_page, legible, size):
    page = open_page(f"{worn_fan.url}/#/machines/fan", size=size)
    expect(page.get_by_text("93 %: Coulomb friction of shaft")).to_be_visible()
    expect(page.get_by_text("7 %: LuGre friction of shaft")).to_be_visible()
    expect(page.get_by_text("acklash")).to_have_count(0)
    expect(
        page.get_by_text("It disagrees: model-based says faulty, model-based says healthy")
    ).to_be_visible()
    expect(page.get_by_text("Healthy windows show Quadratic drag of shaft too")).to_be_visible()
    page.locator("[data-key=follow-parameters]").click()
    expect(page.get_by_text("It drifts slowly since")).to_be_visible()
    page.locator("[data-key=limit-R]").fill("3")
    page.locator("[data-key=set-R]").click()
    expect(page.get_by_text("will be reached in")).to_be_visible()
    with page.expect_download() as saved:
        page.get_by_role("button", name="CSV").click()
    assert saved.value.path().read_text().startswith("time,window,verdict,value,std\n")
    legible(page)


def test_an_alarm_leads_to_its_window_and_on_to_the_workbench(worn_fan, open_page, legible):
    page = open_page(f"{worn_fan.url}/#/machines/fan")
    page.get_by_role("link", name="See window 30").click()
    expect(page).to_have_url(f"{worn_fan.url}/#/machines/fan?window=30")
    expect(page.get_by_text("Window 30: 100 samples")).to_be_visible()
    expect(page.get_by_text("In window 30:")).to_be_visible()
    expect(
        page.get_by_text("This window cannot tell it from Load-dependent friction of the shaft.")
    ).to_be_visible()
    legible(page)
    page.locator("[data-key=window-20]").click()
    # the chosen one, not the last one
    expect(page.get_by_text("Window 20 shows nothing that needs a cause.")).to_be_visible()
    page.locator("[data-key=explain-window]").click()
    expect(
        page.get_by_text("fan has no model yet: choose one under Watch a machine")
    ).to_be_visible()
