"""The control page: from a stored model to a controller on the target, by clicking and by keyboard."""

import json
import math

import numpy as np
import pytest
from playwright.sync_api import expect
from scipy.signal import lfilter

from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model_file import save_identified
from residuum.identification.record import Record

LONG_WORK = 120_000  # milliseconds: a design on a busy machine
SIZES = {"desk": (1280, 800), "phone": (390, 844)}
CENTRE_OF_MARKER = """([chart, index]) => { const box = document.querySelector(`[aria-label="${chart}"]`)
  .querySelectorAll('.points path')[index].getBoundingClientRect(); return [box.x + box.width / 2, box.y + box.height / 2]; }"""


def identified_plant():
    rng = np.random.default_rng(5)
    u = rng.normal(size=1500)
    y = lfilter([0, 0.3], [1, -0.7], u) + 0.02 * rng.normal(size=1500)
    return identify_impulse_response(
        Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 0.1), "u", "y", order=30, delay=1
    )


@pytest.fixture(scope="module")
def service(run_service, no_machines, tmp_path_factory):
    service = run_service(no_machines)
    file = tmp_path_factory.mktemp("models") / "plant.json"
    save_identified(identified_plant(), file)
    for name in ("cold-plant", "plant"):
        service.services.store.add_model_version(name, "identified", file.read_bytes())
    return service


def test_a_controller_is_designed_chosen_on_the_front_and_taken_to_the_target(service, open_page):
    page = open_page(f"{service.url}/#/control")
    page.locator(".choice", has_text="plant, version 1").last.get_by_role("checkbox").check()
    page.get_by_label("aim").select_option("robust")
    page.get_by_label("structure").select_option("pi")
    page.get_by_label("limits, upper").fill("2.5")
    page.get_by_role("button", name="Design", exact=True).click()
    expect(page.get_by_text("No plant within the uncertainty is destabilised")).to_be_visible(
        timeout=LONG_WORK
    )
    for chart in (
        "Pareto front",
        "Step responses of drawn plants",
        "Constraints of the design",
        "Open loop with its range",
    ):
        expect(page.get_by_label(chart).locator(".main-svg").first).to_be_visible()
    drawn = page.evaluate(
        "document.querySelector('[aria-label=\"Step responses of drawn plants\"]').data.map((t) => t.yaxis)"
    )
    assert drawn.count("y2") == 2 and len(drawn) == 4  # y above, u below it
    expect(page.get_by_label("Step responses of drawn plants").locator(".y2title")).to_have_text(
        "u [V / m]"
    )
    controllers = page.get_by_label("controller", exact=True)
    first = controllers.input_value()
    others = [
        index
        for index, text in enumerate(controllers.locator("option").all_inner_texts())
        if text != first
    ]
    page.get_by_label("Pareto front").scroll_into_view_if_needed()
    page.mouse.click(*page.evaluate(CENTRE_OF_MARKER, ["Pareto front", others[0]]))
    expect(controllers).not_to_have_value(first)
    assert f"point={others[0]}" in page.url
    with page.expect_download() as saved:
        page.get_by_role("button", name="Download controller.st").click()
    assert "FUNCTION_BLOCK RobustController" in saved.value.path().read_text(encoding="utf-8")
    with page.expect_download() as saved:
        page.get_by_role("button", name="Download controller.json").click()
    file = json.loads(saved.value.path().read_text(encoding="utf-8"))
    shown = page.locator("table td.number").first.inner_text()
    assert (
        math.isclose(float(shown), file["numerator"][0] / file["denominator"][0])
        and "2.5" in file["difference_equation"]
    )
    chosen = controllers.input_value()
    again = open_page(page.url)
    expect(again.get_by_label("controller", exact=True)).to_have_value(chosen, timeout=LONG_WORK)


def test_a_model_file_of_the_command_line_is_dropped_and_designed_for(service, open_page, tmp_path):
    save_identified(identified_plant(), tmp_path / "my plant (2).json")
    (tmp_path / "wrong.json").write_text("{}", encoding="utf-8")
    page = open_page(f"{service.url}/#/control", expected=["422"])
    page.locator("#model-file").set_input_files(tmp_path / "wrong.json")
    expect(page.locator(".notice")).to_be_visible()
    page.locator("#model-file").set_input_files(tmp_path / "my plant (2).json")
    expect(page.get_by_role("checkbox", name="my-plant-2-, version 1")).to_be_checked()


def test_inputs_of_the_source_are_on_the_page_with_its_defaults(service, open_page):
    page = open_page(f"{service.url}/#/control?aim=robust")
    page.locator(".choice", has_text="plant, version 1").last.get_by_role("checkbox").check()
    page.get_by_text("More options").click()
    fields = {"epsilon": "0.1", "zeta": "0.2", "weight order": "1", "points": "100"}
    for name, before in {
        "epsilon": "0.05",
        "zeta": "0.05",
        "weight order": "2",
        "points": "600",
    }.items():
        expect(page.get_by_label(name)).to_have_value(before)
        page.get_by_label(name).fill(fields[name])
    page.get_by_label("rule").select_option("worst-case")
    page.get_by_label("high gain [dB]").fill("-20")
    with page.expect_request("**/control-designs/views") as sent:
        page.get_by_role("button", name="Design", exact=True).click()
    asked = sent.value.post_data_json
    assert {key: asked[key] for key in ("epsilon", "zeta", "rule", "weight_order", "points", "low_gain")} == {
        "epsilon": 0.1, "zeta": 0.2, "rule": "worst-case", "weight_order": 1, "points": 100, "low_gain": 120
    }  # fmt: skip
    assert asked["high_gain"] == -20 and "epsilon=0.1" in page.url


def test_an_impossible_wish_is_refused_with_its_reason(service, open_page):
    page = open_page(f"{service.url}/#/control?models=plant@1&structure=pi&settling=0.3")
    expect(page.get_by_text("No such controller")).to_be_visible(timeout=LONG_WORK)
    expect(page.locator(".says-large")).to_contain_text("No controller 'pi' meets it")
    page.get_by_label("settling time [s]").fill("40")
    page.get_by_label("settling time [s]").press("Enter")
    expect(page.get_by_text("No plant within the uncertainty is destabilised")).to_be_visible(
        timeout=LONG_WORK
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_the_design_fits_and_can_be_read(service, open_page, legible, size, scheme):
    page = open_page(
        f"{service.url}/#/control?models=plant@1,cold-plant@1&structure=pi",
        size=size,
        scheme=scheme,
    )
    expect(page.get_by_label("Open loop with its range").locator(".main-svg").first).to_be_visible(
        timeout=LONG_WORK
    )
    page.get_by_text("Show structured text").click()
    legible(page)
