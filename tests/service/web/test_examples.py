"""Where a page begins empty it offers an example; each is walked to its end by clicking, on a service that knows nothing."""

import json

import pytest
from playwright.sync_api import expect

LONG_WORK = 240_000  # milliseconds: an analysis on a busy machine


@pytest.fixture
def begin_example(run_service, no_machines, open_page, legible):
    """Open a page of an empty service, and press the one button that its hint offers."""

    def begin(name, pattern="", route=None):
        page = open_page(f"{run_service(no_machines).url}/#/{name}")
        if route:
            page.route(pattern, route)
        expect(page.get_by_role("note")).to_contain_text("or try a simulated")
        legible(page)
        page.get_by_role("button", name="Try the example").click()
        return page

    return begin


def ask_for_few(route):
    """Only some effects of the catalogue, for time's sake."""
    route.continue_(
        post_data=json.dumps(
            route.request.post_data_json | {"effects": ["coulomb-friction", "viscous-friction"]}
        )
    )


def test_the_workbench_leads_from_an_example_to_a_mended_model(begin_example):
    page = begin_example("workbench", "**/explain", ask_for_few)
    for step in (
        "Compare",
        "Where does it fail?",
        "Why does it fail?",
        "Add Coulomb friction to shaft",
        "Add and estimate",
    ):
        page.get_by_role("button", name=step, exact=True).click(timeout=LONG_WORK)
    expect(page.get_by_text("The error fell by: speed 9")).to_be_visible(timeout=LONG_WORK)
    page.get_by_role("tab", name="Record and model").click()
    expect(
        page.locator(".choice", has_text="simulated gate-drive").get_by_role(
            "checkbox", checked=True
        )
    ).to_be_visible()
    expect(page.get_by_role("note")).to_have_count(0)


def test_identify_leads_from_an_example_to_a_model_with_its_uncertainty(begin_example):
    page = begin_example("identify")
    expect(page.get_by_text("stored as example, version 1")).to_be_visible(timeout=LONG_WORK)
    expect(
        page.get_by_label("Uncertainty weight").locator(".legendtext", has_text="|W_T|")
    ).to_be_visible(timeout=LONG_WORK)
    expect(page.locator("[data-key=record]")).to_contain_text("simulated process")


def test_control_leads_from_an_example_to_a_controller(begin_example):
    page = begin_example("control")
    expect(page.get_by_text("No plant within the uncertainty is destabilised")).to_be_visible(
        timeout=LONG_WORK
    )
    expect(page.get_by_role("checkbox", name="example, version 1")).to_be_checked()
    expect(page.get_by_role("button", name="Download controller.st")).to_be_visible()


def test_a_plant_without_machines_leads_to_watching_one_or_to_the_example(
    run_service, no_machines, open_page
):
    page = open_page(f"{run_service(no_machines).url}/")
    page.locator("main").get_by_role("link", name="Watch a machine").click()
    expect(page.get_by_text("The next step shows what its signals read now.")).to_be_visible()
    page.go_back()
    page.get_by_role("link", name="try the workbench's example").click()
    expect(page.get_by_role("button", name="Try the example")).to_be_visible()
