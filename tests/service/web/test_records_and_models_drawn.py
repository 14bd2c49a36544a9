"""What the workbench and the pages of linear models draw: records, joint answers, errors over decades, models side by side."""

import json

import numpy as np
import pytest
from playwright.sync_api import expect
from scipy.signal import lfilter

from residuum.identification.record import Record

SIZES = [(1440, 900), (390, 844)]
LONG = 600_000  # milliseconds: identifications on a busy machine


@pytest.fixture(scope="module")
def service(run_service, no_machines):
    """A service with one record of a plant of second order: poles at .9 e^(±.5j), a zero at -.5."""
    service = run_service(no_machines)
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([-1.0, 1.0], size=300), 4)
    a = np.poly([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j)]).real
    y = lfilter([0, 0.1, 0.05], a, u) + 0.02 * rng.normal(size=u.size)
    spike = np.zeros(u.size)
    spike[777] = 40.0
    channels = {"u": u, "y": y, "spike": spike} | {f"more_{k}": u for k in range(5)}
    service.services.store.add_record(
        "plant.csv", Record(channels, dict.fromkeys(channels, "V"), 0.1)
    )
    return service


def data(page, label):
    """The traces of a chart, once they are drawn."""
    chart = f"document.querySelector('[aria-label=\"{label}\"]')"
    page.wait_for_function(f"() => {chart}?.data?.length")
    return page.evaluate(f"JSON.stringify({chart}.data)"), page.evaluate(
        f"JSON.stringify({chart}.layout)"
    )


@pytest.mark.parametrize("size", SIZES)
def test_the_record_that_was_chosen_is_drawn_with_every_peak(service, open_page, legible, size):
    page = open_page(f"{service.url}/#/workbench", size=size)
    page.locator("[data-key=record-1]").check()
    strip = "spike of record 1"
    traces, _ = data(page, strip)
    assert max(value for value in json.loads(traces)[0]["y"] if value is not None) == 40.0
    expect(page.get_by_label("more_4 of record 1")).to_have_count(0)
    page.locator("[data-key=more-channels]").click()
    expect(page.get_by_label("more_4 of record 1").locator(".main-svg").first).to_be_visible()
    legible(page)
    with page.expect_response("**/records/1/signal?*from=77*") as zoomed:
        page.evaluate(f"Plotly.relayout(document.querySelector('[aria-label=\"{strip}\"]'), "
                      "{'xaxis.range[0]': 77, 'xaxis.range[1]': 78})")  # fmt: skip
    assert zoomed.value.json()["reduced"] is False
    page.locator("[data-key=record-1]").uncheck()
    expect(page.get_by_label(strip)).to_have_count(0)


def candidate(effect, balance, probability):
    return {
        "effect": effect, "balance": balance, "probability": probability, "indistinguishable_from": [], "rivals": [],
        "output": "speed", "parameters": {"c": {"value": 0.5, "std": 0.01, "unit": "N*m"}},
        "error_before": 3.0, "error_after": 0.5, "error_unit": "rad/s", "held_out": True, "within_bounds": True, "share": None,
    }  # fmt: skip


EXPLANATION = {
    "verdict": "missing-effect", "candidates": [candidate("inductance", "winding", 0.97)],
    "also_missing": [candidate("coulomb-friction", "shaft", 0.93), candidate("backlash", "shaft", 0.02)],
    "probability_nothing_missing": 0.0, "probability_unknown_effect": 0.01, "undetectable": [], "unexplained_share": 0.0,
    "missing_term": None, "next_experiment": [], "estimated_values": [], "held_values": [], "timing": [], "drifting": False,
    "blocks": None,
}  # fmt: skip


def finished(result):
    return json.dumps(
        {
            "id": "j",
            "kind": "k",
            "state": "done",
            "progress": 1.0,
            "doing": "",
            "result": result,
            "error": None,
        }
    )


@pytest.mark.parametrize("size", SIZES)
def test_every_effect_of_a_joint_answer_has_a_row(service, open_page, legible, size):
    page = open_page(service.url, size=size)
    as_json = {"content_type": "application/json"}
    page.route(
        "**/models/gate-drive/explain",
        lambda route: route.fulfill(body=finished(EXPLANATION), **as_json),
    )
    nothing = {"points": {"terms": [], "axes": []}}
    page.route(
        "**/models/gate-drive/views", lambda route: route.fulfill(body=finished(nothing), **as_json)
    )
    page.goto(f"{service.url}/#/workbench?records=1&model=gate-drive&step=why")
    rows = page.locator("tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.nth(1)).to_contain_text("Coulomb friction besides the first")
    expect(page.locator(".says-large")).to_contain_text(
        "Besides it Coulomb friction in shaft, 93 %."
    )
    legible(page)
    rows.nth(1).get_by_role("button", name="Add Coulomb friction to shaft").click()
    expect(page.get_by_text("Coulomb friction is added to shaft")).to_be_visible()


@pytest.mark.parametrize(("last", "kind"), [(0.004, "log"), (2.0, "linear")])
@pytest.mark.parametrize("size", SIZES)
def test_errors_that_span_decades_are_drawn_over_factors(service, open_page, size, last, kind):
    page = open_page(service.url, size=size)
    effect = {
        "effect": "inductance", "title": "Inductance", "target": "winding", "equation": "L der(i)", "parameters": [],
        "provenance": {"as_given": {"speed": 10.0}, "re_estimated": {"speed": 9.0}, "with_effect": {"speed": last}},
    }  # fmt: skip

    def described(route):
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"effects": [effect]})

    page.route("**/models/gate-drive/description*", described)
    page.route("**/models/gate-drive/views", lambda route: None)  # the overlay is not looked at
    page.goto(f"{service.url}/#/workbench?records=1&model=gate-drive&step=add")
    traces, layout = data(page, "Error after every effect")
    drawn = json.loads(layout)
    assert drawn["xaxis" if size[0] < 500 else "yaxis"].get("type", "linear") == kind
    shares = json.loads(traces)[0]["customdata"]
    assert shares[-1] == pytest.approx(10 * last)
    low, high = drawn["xaxis" if size[0] < 500 else "yaxis"]["range"]
    of = np.log10 if kind == "log" else lambda value: value
    assert of(min(shares)) - low > 0.02 * (high - low)  # the shortest bar can be seen


@pytest.mark.parametrize("size", SIZES)
def test_models_are_compared_and_tell_their_residuals_poles_and_zeros(
    service, open_page, legible, size
):
    page = open_page(f"{service.url}/#/identify", size=size)
    page.locator("[data-key=input]").select_option("u")
    page.locator("[data-key=output]").select_option("y")
    page.locator("[data-key=method]").select_option("arx")
    page.locator("[data-key=order]").fill("1, 2")
    page.get_by_text("More options").first.click()
    page.locator("[data-key=also-kernel]").check()
    page.locator("[data-key=order]").press("Enter")
    rows = page.locator(
        "section", has=page.get_by_role("heading", name="Models side by side")
    ).locator("tbody tr")
    expect(rows).to_have_count(4, timeout=LONG)
    expect(
        page.get_by_label("Poles and zeros").or_(
            page.get_by_text("has no poles or zeros of its own")
        )
    ).to_be_visible(timeout=LONG)
    assert len(json.loads(data(page, "Bode diagrams of the models")[0])) == 8
    page.get_by_role("button", name="Show ARX, order 2").click()
    expect(page.get_by_role("button", name="Show ARX, order 2")).to_have_text("Shown below")
    page.wait_for_function(
        "() => document.querySelector('[aria-label=\"Poles and zeros\"]')?.data?.[0].x.length === 2"
    )
    poles = json.loads(data(page, "Poles and zeros")[0])[0]
    assert sorted(np.abs(np.array(poles["x"]) + 1j * np.array(poles["y"]))) == pytest.approx(
        [0.9, 0.9], abs=0.05
    )
    traces, layout = data(page, "Residual and past input")
    edges = [shape["y0"] for shape in json.loads(layout)["shapes"]]
    assert len(json.loads(traces)[0]["y"]) >= 10 and edges[0] == -edges[1] > 0
    expect(page.get_by_text("dashed: 99 % band of each lag").first).to_be_visible()
    legible(page)
