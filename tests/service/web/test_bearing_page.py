"""The bearing page: a vibration record is uploaded, and judged by its speed and the multiples at which the parts knock."""

import httpx
import pytest
from playwright.sync_api import expect

from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.identification.record_formats import write_record


@pytest.fixture(scope="module")
def service(run_service, no_machines):
    return run_service(no_machines)


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
def test_a_bearing_is_scored_from_an_uploaded_record(service, open_page, legible, tmp_path, size):
    case = Bearing.examples()[0]
    write_record(case.faulty[0], tmp_path / "bearing.npz")
    page = open_page(service.url, size=size)
    page.get_by_role("link", name="Bearing").click()
    page.get_by_label("Upload a vibration record").set_input_files(tmp_path / "bearing.npz")
    expect(page.locator("[data-key=record]").locator("option:checked")).to_contain_text(
        "bearing.npz"
    )
    page.get_by_label("shaft speed [rpm]").fill("1800")
    for line, order in {
        "inner race, BPFI": 5.4152,
        "outer race, BPFO": 3.5848,
        "ball, BSF": 2.357,
        "cage, FTF": 0.398,
    }.items():
        page.get_by_label(line).fill(str(order))
    page.get_by_role("button", name="Score").click()
    expect(page.locator("main .title .badge")).to_have_text("Faulty: inner race")
    expect(page.get_by_role("heading", name="Indicators")).to_be_visible()
    expect(page.locator(".chart .main-svg").first).to_be_visible()
    legible(page)
    page.reload()  # the address keeps the question
    expect(page.locator("main .title .badge")).to_have_text("Faulty: inner race")


def test_a_record_that_is_not_there_is_refused_in_one_line(service):
    answer = httpx.post(f"{service.url}/api/v1/records/999/score/bearing", timeout=60)
    assert answer.status_code == 404 and "record 999" in answer.json()["detail"]
    answer = httpx.post(f"{service.url}/api/v1/records/x/score/bearing", timeout=60)
    assert answer.status_code == 404 and "'x'" in answer.json()["detail"]
