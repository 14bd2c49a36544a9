"""What was found at the machine is told beside the finding, shown there, and hostile words stay words."""

import numpy as np
from playwright.sync_api import expect

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record

HOSTILE = "<img src=x onerror=alert(1)>"


def test_a_finding_is_confirmed_then_refuted_beside_its_window(run_service, open_page):
    service = run_service()
    store = service.services.store
    cause = {"name": "coulomb-friction", "place": "shaft", "probability": 0.8, "says": "more"}
    causes = [{**cause, "indistinguishable_from": []}]
    finding = Finding("bearing", "faulty", evidence={"causes": causes}, reason="-")
    record = Record({"y": np.zeros(400)}, {"y": "V"}, 1e-3)
    store.add_window("press", record, finding)
    page = open_page(f"{service.url}/#/machines/press?window=1")
    page.get_by_text("Tell what was found at the machine").click()
    form = page.locator("form.controls")
    expect(form).to_contain_text("of shaft, 80 %")
    expect(form.get_by_label("what it was")).to_be_hidden()
    expect(form.get_by_label("learn from this window")).to_be_hidden()
    form.get_by_label("part").fill("bearing 6204")
    form.get_by_label("order").fill("4711")
    form.get_by_label("note").fill(HOSTILE)
    form.get_by_role("button", name="Keep").click()
    found = page.locator(".found")
    expect(found).to_contain_text("It was so, bearing 6204, order 4711 (local")
    expect(found).to_contain_text(HOSTILE)
    page.get_by_text("Tell what was found at the machine").click()
    form.locator("select").select_option("refuted")
    form.get_by_label("learn from this window").check()
    form.get_by_role("button", name="Keep").click()
    expect(found).to_contain_text("There was no such thing")
    expect(found).to_contain_text("learned from as a healthy one")
    page.reload()
    expect(page.locator(".found")).to_contain_text("There was no such thing")
    (told,) = store.standing_confirmations()
    assert (told.outcome, told.healthy, told.cause) == ("refuted", True, None)
