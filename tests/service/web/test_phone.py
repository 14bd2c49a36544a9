"""On a phone nothing is cut: the navigation wraps, long names and bus addresses break, long lists are folded."""

import numpy as np
import pytest
from playwright.sync_api import expect

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record

PHONE = (390, 844)
BUS = "udp_multicast:239.174.163.202:43113/0, described by gripping_pliers_of_the_assembly_line.dbc"
TABS = {"": "239.174", "watch": "name of the machine", "workbench": "simulated drive", "identify": "simulated process",
        "control": "simulated process", "effects": "Viscous friction", "failure-modes": "broken shaft",
        "machines/press": "Indicator"}  # fmt: skip


@pytest.fixture(scope="module")
def service(run_service, no_machines):
    class OneBus(no_machines):
        """A pipeline that reads a bus with a long address."""

        def status(self):
            return {
                "machines": {},
                "sources": {
                    BUS: {"quality": "good", "counters": {"frames_with_a_wrong_checksum": 12}}
                },
            }

    service = run_service(OneBus)
    indicators = {"largest_amplitude_of_the_residuals_envelope_in_its_band": 3.0}
    limits = dict.fromkeys(indicators, 2.0)
    finding = Finding(
        "bearing",
        "faulty",
        "outer-race",
        indicators=indicators,
        thresholds=limits,
        reason="a long reason " * 20,
    )
    record = Record({"y": np.zeros(50)}, {"y": "V"}, 0.1)
    service.services.store.add_window("press", record, finding)
    service.services.store.add_record(
        "a-very-long-name-of-a-record-that-a-logger-has-made-up-2026-11-27.csv", record
    )
    return service


@pytest.mark.parametrize("tab", TABS)
def test_no_text_of_a_tab_is_cut_on_a_phone(service, open_page, uncut, tab):
    page = open_page(f"{service.url}/#/{tab}", size=PHONE)
    expect(page.locator("main").get_by_text(TABS[tab]).first).to_be_attached()
    expect(page.get_by_role("link", name="Failure modes")).to_be_in_viewport(ratio=1)
    uncut(page)


def test_the_catalogue_is_folded_on_a_phone_until_few_are_left(service, open_page, uncut):
    page = open_page(f"{service.url}/#/effects", size=PHONE)
    expect(page.locator(".effect")).not_to_have_count(0)
    expect(page.locator(".effect[open]")).to_have_count(0)
    page.get_by_text("Coulomb friction", exact=True).click()
    expect(
        page.get_by_label("Signature of Coulomb friction: torque [N·m] over velocity [rad/s]")
    ).to_be_visible()
    page.get_by_label("search").fill("stribeck")
    expect(
        page.get_by_label("Signature of Stribeck friction: torque [N·m] over velocity [rad/s]")
    ).to_be_visible()
    uncut(page)
    wide = open_page(f"{service.url}/#/effects")
    expect(wide.locator(".effect[open]")).not_to_have_count(0)
    expect(wide.locator(".effect:not([open])")).to_have_count(0)
