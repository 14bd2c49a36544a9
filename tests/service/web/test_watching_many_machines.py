"""Many machines on the page: what is live, what failed, what loses samples, and the alarms of a period."""

import re
from datetime import timedelta

import httpx
import numpy as np
import pytest
from playwright.sync_api import expect
from sqlalchemy import select, update

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent, AlarmRule
from residuum.service.security.access import new_key
from residuum.service.storage import tables
from residuum.service.storage.rows import row_checks
from residuum.service.store import FoundAtMachine, Outcome

SIZES = [(1440, 900), (390, 844)]
RECORD = Record({"y": np.random.default_rng(3).normal(size=200)}, {"y": "m/s²"}, 1e-3)


def finding(rms, reason=None):
    verdict = "faulty" if rms > 1 else "healthy"
    return Finding(
        "bearing", verdict, None, {"rms": rms}, {"rms": 1.0}, {"rms": "m/s²"}, {}, reason
    )


@pytest.fixture
def machines(run_service, no_machines):
    """A service whose pipeline says of machines and sources what the test puts there."""

    class Told(no_machines):
        machines, sources = {}, {}

        def status(self):
            return {"machines": self.machines, "sources": self.sources}

        def alarm_rule(self, _asset):
            return AlarmRule()

    service = run_service(Told)
    yield service, Told
    service.stop()


RUNNING = {
    "state": "running",
    "progress": 1.0,
    "doing": "judging windows",
    "scoring_errors": 0,
    "simulated": False,
}


def test_the_navigation_holds_any_number_of_machines(machines, open_page, uncut):
    service, told = machines
    names = [f"hall-2.a-press-with-a-long-name-{number}" for number in range(12)]
    for shown in (4, 10, 12):
        told.machines = dict.fromkeys(names[:shown], RUNNING)
        for size in SIZES:
            page = open_page(service.url, size=size)
            choice = page.get_by_label("Machine", exact=True)
            expect(choice.locator("option")).to_have_count(shown + 1)
            for element in (page.locator("#nav a").last, choice):
                expect(element).to_be_in_viewport(ratio=1)
            assert page.evaluate(
                "document.querySelector('#nav').scrollWidth <= document.querySelector('#nav').clientWidth"
            )
            uncut(page)
    choice.select_option(label="Hall 2.a press with a long name 9")
    expect(page.locator("h1")).to_have_text("Hall 2.a press with a long name 9")
    expect(choice).to_have_value(re.compile("name-9$"))


def test_live_is_a_machine_whose_windows_are_judged_now(machines, open_page):
    service, told = machines
    for name in ("press", "fan", "axis"):
        service.services.store.add_window(name, RECORD, finding(0.4))
        service.services.store.add_window(name, RECORD, finding(0.5))
    told.machines = {
        "press": RUNNING,
        "fan": RUNNING | {"state": "waiting", "doing": "waiting for data: bus off"},
        "new": RUNNING,
    }
    judged = service.services.store.asset("axis").last_finding.at
    page = open_page(service.url)
    page.clock.set_fixed_time(judged)  # however long the page takes to load
    page.reload()
    expect(page.locator("#connection")).to_have_text("connected")
    for name in ("Press", "Axis"):  # one by a bus, one by HTTP
        expect(page.locator(".machine", has_text=name).locator(".live")).to_have_text("live")
    for name in ("Fan", "New"):
        expect(page.locator(".machine", has_text=name)).to_be_visible()
        expect(page.locator(".machine", has_text=name).locator(".live")).to_have_count(0)
    expect(page.locator(".machine", has_text="Fan")).to_contain_text("Waiting for data: bus off.")
    page.goto(f"{service.url}/#/machines/press")
    expect(page.locator(".facts .live")).to_have_text("live")
    page.clock.set_fixed_time(judged + timedelta(minutes=2))  # and no window in that time
    expect(page.locator(".facts .live")).to_have_count(0)


@pytest.mark.parametrize("size", SIZES)
def test_a_machine_that_failed_is_red_with_the_reason_and_the_way_on(
    machines, open_page, legible, size
):
    service, told = machines
    service.services.store.add_window("press", RECORD, finding(0.4))
    failed = {
        "state": "failed",
        "progress": 0.0,
        "doing": "training failed: no such file: windows.py",
        "way_on": "train it anew",
    }
    told.machines = {"press": RUNNING | failed, "fan": RUNNING | {"scoring_errors": 3}}
    page = open_page(service.url, size=size)
    card = page.locator(".machine", has_text="Press")
    expect(card).to_have_attribute("data-tone", "faulty")
    expect(card.locator(".badge")).to_have_text("Failed")
    expect(card).to_contain_text("Training failed: no such file: windows.py.")
    expect(card).to_contain_text("Train it anew.")
    expect(page.locator(".tally")).to_contain_text("1 failed")
    expect(page.locator(".machine", has_text="Fan")).to_contain_text(
        "3 windows could not be judged; the service's log says more."
    )
    legible(page)
    card.get_by_role("link", name="Press", exact=True).click()
    expect(page.locator(".says-large")).to_have_text("Training failed: no such file: windows.py.")
    expect(page.locator(".title .badge")).to_have_text("Failed")
    way_on = page.get_by_role("link", name="Change it or train it again")
    expect(way_on).to_have_attribute("href", "#/watch?machine=press")


def test_a_source_that_loses_samples_says_how_many_it_lost_lately(machines, open_page, legible):
    service, told = machines
    losing = {
        "quality": "losing",
        "lost_lately": 12,
        "lost_within_seconds": 60.0,
        "counters": {"lost": 669},
    }
    told.sources = {
        "press can": losing,
        "fan can": {"quality": "good", "lost_lately": 0, "lost_within_seconds": 60.0},
    }
    page = open_page(service.url)
    expect(page.locator("tr", has_text="press can")).to_contain_text("Lost 12 in the last 1 min")
    expect(page.locator("tr", has_text="press can")).not_to_contain_text("Good")
    expect(page.locator("tr", has_text="fan can")).to_contain_text("Good")
    legible(page)


def test_a_parameter_keeps_its_letters(machines, open_page):
    service, _ = machines
    says = "k_e 1.2 N·m/rad, healthy 1 to 1.1"
    cause = {
        "kind": "parameter",
        "name": "k_e",
        "place": "",
        "probability": 0.9,
        "indistinguishable_from": [],
        "says": says,
    }
    faulty = Finding(
        "bearing",
        "faulty",
        None,
        {"x": 2.0},
        {"x": 1.0},
        {},
        {"causes": [cause], "parameters": {}},
        says,
    )
    service.services.store.add_window("press", RECORD, faulty)
    page = open_page(f"{service.url}/#/machines/press")
    expect(page.locator(".says-large")).to_have_text(f"{says}.")
    expect(page.get_by_role("listitem").filter(has_text="90 %")).to_have_text(f"90 %: k_e. {says}.")


def set_back(service, by):
    """Let all that was found so far lie further in the past."""
    with service.services.store._database.write() as connection:
        for table in (tables.findings, tables.alarm_journal):
            for number, at in connection.execute(select(table.c.id, table.c.at)).all():
                connection.execute(
                    update(table).where(table.c.id == number).values(at=at - by, checksum=None)
                )
        row_checks.seal_rows_of_old(connection, "0009")


@pytest.fixture
def with_alarms(machines):
    """A fan that was faulty two days ago, then a press that was twice, and is."""
    service, _ = machines
    store = service.services.store
    for rms in (3.0, 0.5):
        store.add_window("fan", RECORD, finding(rms, f"RMS {rms} of the fan"))
    store.operate_alarm(
        store.alarms().items[0].id, AlarmEvent.ACKNOWLEDGE, "eva", "bearing ordered"
    )
    set_back(service, timedelta(days=2))
    for rms in (1.5, 0.5, 2.5):
        store.add_window("press", RECORD, finding(rms, f"RMS {rms} of the press"))
    return service


def key(page, name):
    return page.locator(f"[data-key={name}]")


def rows(page):
    return page.locator("section", has=page.get_by_role("heading", name="History")).locator(
        "tbody tr"
    )


@pytest.mark.parametrize("size", SIZES)
def test_the_history_of_alarms_is_filtered_ordered_and_cut_to_a_period(
    with_alarms, open_page, legible, size
):
    page = open_page(f"{with_alarms.url}/#/alarms", size=size)
    expect(rows(page)).to_have_count(3)
    expect(rows(page).first).to_contain_text("RMS 2.5 of the press")
    expect(rows(page).last).to_contain_text("by eva")
    expect(rows(page).last).to_contain_text("bearing ordered")
    legible(page)
    key(page, "order").select_option("urgent")
    expect(rows(page).first).to_contain_text("still there")
    # gone again, and nobody has seen it
    expect(rows(page).nth(1)).to_contain_text("RMS 1.5 of the press")
    key(page, "order").select_option("")
    key(page, "state").select_option("cleared")
    expect(rows(page)).to_have_count(2)
    key(page, "state").select_option("")
    key(page, "asset").select_option("fan")
    expect(rows(page)).to_have_count(1)
    key(page, "period").select_option("hour")
    expect(page.get_by_text("No alarm was raised in this period.")).to_be_visible()
    page.reload()  # the address keeps the choice
    expect(page.get_by_text("No alarm was raised in this period.")).to_be_visible()
    key(page, "asset").select_option("")
    expect(rows(page)).to_have_count(2)
    with_alarms.services.store.add_window("late", RECORD, finding(4.0))
    expect(rows(page)).to_have_count(3)


def test_the_trend_of_a_machine_is_cut_to_a_period(with_alarms, open_page):
    with_alarms.services.store.add_window("fan", RECORD, finding(0.6))
    page = open_page(f"{with_alarms.url}/#/machines/fan")
    points = "document.querySelector('[aria-label=\"Indicator over time\"]')?.data?.[0].y.length"
    page.wait_for_function(f"() => {points} === 3")
    page.get_by_label("Period", exact=True).select_option("hour")
    page.wait_for_function(f"() => {points} === 1")
    page.get_by_label("Period", exact=True).select_option("week")
    page.wait_for_function(f"() => {points} === 3")
    page.get_by_role("link", name="History").click()
    expect(rows(page)).to_have_count(1)


LANES = "document.querySelector('[aria-label=\"Indicator over time\"]')?.data?.filter((trace) => trace.yaxis === 'y2')"


@pytest.mark.parametrize("size", SIZES)
def test_alarms_and_what_was_found_stand_below_the_trend_on_its_axis(
    with_alarms, open_page, legible, size
):
    store = with_alarms.services.store
    store.add_model_version("press", "baseline", b"-", "trained on 40 windows", "eva")
    page = open_page(f"{with_alarms.url}/#/machines/press", size=size)
    page.wait_for_function(f"() => {LANES}?.length === 2")
    # one alarm that went and one that stands: a bar each, from when it was raised, parted by a null
    bars = page.evaluate(f"() => {LANES}[0]")
    assert [at is None for at in bars["x"]] == [False, False, True] * 2
    assert bars["x"][0] < bars["x"][1] and set(bars["y"]) == {"Alarms", None}
    assert "still there" in bars["text"][0] and "gone after" in bars["text"][3]
    newest = store.asset("press").last_finding
    store.confirm(
        "press", newest.id, FoundAtMachine(Outcome.CONFIRMED, part="seal", who="eva"), "eva"
    )
    page.wait_for_function(f"() => {LANES}?.length === 3")
    found = page.evaluate(f"() => {LANES}[1]")
    assert found["y"] == ["Found"] and "it was so, seal (eva)" in found["text"][0]
    trained = page.evaluate(f"() => {LANES}[2]")
    assert trained["y"] == ["Models"] and "trained on 40 windows" in trained["text"][0]
    legible(page)


def test_of_a_long_period_no_fault_is_thinned_away(with_alarms):
    service = with_alarms
    for number in range(40):
        service.services.store.add_window("mill", RECORD, finding(2.0 if number == 17 else 0.5))
    asked = {"limit": 5, "from": "2020-01-01"}
    answer = httpx.get(
        f"{service.url}/api/v1/assets/mill/indicators", params=asked, timeout=60
    ).json()
    assert (
        len(answer["at"]) == 5
        and answer["verdicts"].count("faulty") == 1
        and 2.0 in answer["indicators"]["rms"]
    )


def test_docs_interface_and_settings_are_linked_from_every_page(
    run_service, no_machines, open_page, legible
):
    service = run_service(no_machines, mqtt="")
    page = open_page(service.url)
    expect(page.get_by_role("link", name="Documentation")).to_have_attribute("href", "/docs/")
    page.get_by_role("link", name="API", exact=True).click()
    page.get_by_text(re.compile(r"^alarms \(\d+\)$")).click()
    expect(page.get_by_role("row", name=re.compile("GET .api.v1.alarms.history"))).to_be_visible()
    expect(page.get_by_role("link", name="/openapi.json")).to_have_attribute(
        "href", "/openapi.json"
    )
    legible(page)
    page.get_by_role("link", name="Settings").click()
    expect(
        page.get_by_role("row", name=re.compile(rf"^port {service.port} TCP port"))
    ).to_be_visible()
    expect(page.get_by_role("row", name=re.compile(r"^keep_days 30 \(default\)"))).to_be_visible()
    for size in SIZES:
        page.set_viewport_size({"width": size[0], "height": size[1]})
        legible(page)


def test_no_setting_tells_a_password(run_service, no_machines):
    hooks = ["https://hooks.example/services/secret-token"]
    service = run_service(no_machines, mqtt="mqtt://eva:secret@127.0.0.1:1/plant", webhooks=hooks)
    told = httpx.get(f"{service.url}/api/v1/settings", timeout=60)
    assert "secret" not in told.text
    values = {row["name"]: row["value"] for row in told.json()["items"]}
    assert values["mqtt"] == "mqtt://eva:***@127.0.0.1:1/plant" and values["webhooks"] == [
        "https://hooks.example/…"
    ]


def test_the_settings_page_tells_of_receivers_that_take_nothing(
    run_service, no_machines, open_page, legible, free_port
):
    receivers = [{"kind": "slack", "name": "shift", "url": f"http://127.0.0.1:{free_port()}/x"}]
    service = run_service(no_machines, receivers=receivers)
    record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
    service.services.store.add_window("press", record, Finding("bearing", "faulty", reason="-"))
    page = open_page(service.url + "/#/settings")
    row = page.get_by_role("row", name=re.compile("^shift takes no notification, tried last at"))
    for _ in range(200):
        if row.count():
            break
        page.wait_for_timeout(100)
        page.reload()
        expect(page.get_by_role("row", name=re.compile("^receivers kind slack"))).to_be_visible()
    expect(row).to_be_visible()
    legible(page)


@pytest.fixture
def guarded(run_service, no_machines, tmp_path):
    """A service with keys, and a key a role."""
    keys = {role: new_key() for role in ("monitor", "viewer", "operator")}
    (tmp_path / "keys").write_text(
        "".join(f"eva-{role} {role} {digest}\n" for role, (_, digest) in keys.items())
    )
    service = run_service(no_machines, api_keys=tmp_path / "keys")
    service.services.store.add_window("press", RECORD, finding(1.4))
    yield service, {role: key for role, (key, _) in keys.items()}
    service.stop()


def enter(page, key):
    page.get_by_label("This service asks for a key").fill(key)
    page.get_by_role("button", name="Continue").click()


@pytest.mark.parametrize("size", SIZES)
def test_a_wrong_key_and_a_missing_role_are_told(guarded, open_page, legible, size):
    service, keys = guarded
    page = open_page(service.url, size=size, expected=["401", "403"])
    expect(page.locator("#key-refused")).to_have_count(0)
    enter(page, "wrong-key")
    expect(page.locator("#key-refused")).to_have_text("API key: is not known. Enter another key.")
    expect(page.locator("#connection")).to_have_text("no key, no events")
    legible(page)
    enter(page, keys["monitor"])
    expect(page.locator("#key-refused")).to_contain_text(
        "role monitor may not do this; it needs the role viewer"
    )
    enter(page, keys["viewer"])
    page.get_by_role("button", name="Acknowledge the alarm of press").click()
    expect(page.locator(".notice")).to_contain_text(
        "role viewer may not do this; it needs the role operator"
    )
    legible(page)


def test_a_comment_goes_with_either_button(guarded, open_page):
    service, keys = guarded
    page = open_page(service.url, expected=["401"])
    enter(page, keys["operator"])
    page.get_by_text("Comment …").click()
    page.get_by_label("Comment on the alarm of press").fill("bearing ordered")
    page.get_by_role("button", name="Shelve 1 h the alarm of press").click()
    expect(page.locator(".alarm")).to_contain_text(re.compile("shelved until .*: bearing ordered"))
    page.get_by_role("button", name="Unshelve the alarm of press").click()
    page.get_by_text("Comment …").click()
    page.get_by_label("Comment on the alarm of press").fill("bearing changed")
    page.get_by_role("button", name="Acknowledge the alarm of press").click()
    expect(page.locator(".alarm")).to_contain_text("acknowledged by eva-operator: bearing changed")


def test_a_comment_that_is_begun_while_the_alarm_is_being_acknowledged_is_kept(
    with_alarms, open_page
):
    page = open_page(f"{with_alarms.url}/#/machines/press")
    held = []

    def hold(route):
        held.append(route)

    page.route("**/acknowledge", hold)
    page.get_by_role("button", name="Acknowledge the alarm of press").click()
    page.get_by_text("Comment …").click()
    page.get_by_label("Comment on the alarm of press").fill("waits for")
    for _ in range(600):
        if held:
            break
        page.wait_for_timeout(100)
    with page.expect_response("**/acknowledge"):
        held[0].continue_()
    # acknowledged and drawn again, the form is still there with what was typed
    with_alarms.services.store.add_window("press", RECORD, finding(1.7, "RMS 1.7 of the press"))
    expect(page.locator(".alarm")).to_contain_text(re.compile("acknowledged by .*"))
    expect(page.locator("main")).to_contain_text("RMS 1.7 of the press")
    expect(page.get_by_label("Comment on the alarm of press")).to_have_value("waits for")


def test_an_acknowledged_alarm_is_shelved_for_a_while_with_its_reason_suppressed_and_brought_back(
    with_alarms, open_page, legible
):
    page = open_page(f"{with_alarms.url}/#/machines/press")
    page.get_by_role("button", name="Acknowledge the alarm of press").click()
    page.get_by_text("Comment …").click()
    page.get_by_label("Comment on the alarm of press").fill("waits for the seal")
    page.get_by_label("How long the alarm of press is shelved").select_option("480")
    page.get_by_role("button", name="Shelve for").click()
    expect(page.locator(".alarm")).to_contain_text("shelved until")
    shelved = with_alarms.services.store.alarms(asset="press").items[0]
    assert timedelta(hours=7.9) < shelved.shelved_until - shelved.raised_at < timedelta(hours=8.5)
    page.get_by_role("button", name="Unshelve the alarm of press").click()
    for verb, back in (("Suppress", "Release"), ("Take out of service", "Return to service")):
        page.get_by_text("Comment …").click()
        legible(page)
        page.get_by_role("button", name=verb).click()
        page.get_by_role("button", name=f"{back} the alarm of press").click()
    expect(page.get_by_text("Comment …")).to_be_visible()
    comments = [entry.comment for entry in with_alarms.services.store.alarm_journal(shelved.id)]
    assert "waits for the seal" in comments
