"""The plant's and a machine's page, as people use them: by mouse, by keyboard, in two browsers, across a restart."""

import re
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import expect

import residuum.service.web
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.security.access import new_key
from residuum.service.storage.retention import Retention
from residuum.service.store import NotFound

SIZES = {"desk": (1280, 800), "phone": (390, 844)}
HOSTILE = "<img src=x onerror=alert(1)><script>alert(2)</script>"


def window(seed=0, spike=None):
    """Two channels, a second at 2 kHz; `spike` puts one high sample into the first."""
    rng = np.random.default_rng(seed)
    t = np.arange(20_000) / 10_000
    vibration = np.sin(2 * np.pi * 300 * t) + 0.1 * rng.normal(size=t.size)
    if spike is not None:
        vibration[7777] = spike
    return Record(
        {"acceleration": vibration, "speed": 1480 + rng.normal(size=t.size)},
        {"acceleration": "m/s²", "speed": "rpm"},
        1e-4,
    )


def finding(rms=0.5, fault_class=None, reason=None):
    """Faulty when the RMS is above 1 m/s²."""
    verdict = "faulty" if rms > 1 else "healthy"
    said = reason or f"RMS is {rms} m/s², threshold 1 m/s²."
    indicators, units = {"rms": rms, "kurtosis": 3.1}, {"rms": "m/s²"}
    return Finding(
        "bearing",
        verdict,
        fault_class,
        indicators,
        {"rms": 1.0, "kurtosis": 4.5},
        units,
        {"band": [1000, 2000]},
        said,
    )


class SwitchableMachines:
    """A pipeline whose machine has one fault, and one source that lost frames."""

    def __init__(self, *_parts):
        self.size = None

    async def start(self):
        pass

    async def stop(self):
        pass

    def status(self):
        source = {
            "machine": "press",
            "quality": "stale",
            "frames_per_second": 400.0,
            "samples_per_second": 12800.0,
        }
        source |= {
            "last_seen_seconds": 3.0,
            "counters": {"lost": 7, "timeouts": 0},
            "last_trouble": "bus off",
        }
        training = {
            "state": "training",
            "progress": 0.25,
            "doing": "movement 5 of 20",
            "diagnoser": "gate-actuator",
        }
        return {
            "machines": {
                "gate": training,
                "press": {"state": "running", "progress": 1.0, "simulated": True},
            },
            "sources": {"press udp:1": source},
        }

    def alarm_rule(self, _asset):
        return AlarmRule()

    def faults(self, machine):
        if machine != "press":
            raise NotFound(f"machine {machine!r}: there is none of this name")
        bearing = {
            "id": "plier-bearing",
            "default_size": 1.5,
            "unit": "mm",
            "meaning": "a spalled bearing",
        }
        return {
            "machine": machine,
            "faults": [bearing | {"on": self.size is not None, "size": self.size}],
        }

    async def switch_fault(self, machine, fault, size):
        self.size = size or None


@pytest.fixture(scope="module")
def service(run_service):
    service = run_service(SwitchableMachines)
    service.services.store.add_window("fan", window(), finding())
    for number in range(3):
        service.services.store.add_window(
            "press",
            window(number, spike=40.0 if number == 2 else None),
            finding([0.4, 0.5, 0.6][number]),
        )
    return service


def store(service, asset, *arguments, **named):
    return service.services.store.add_window(asset, window(9), finding(*arguments, **named))


def test_the_plant_follows_what_happens(service, open_page):
    page = open_page(service.url)
    press = page.locator(".machine", has_text="Press")
    last = service.services.store.asset("press").last_finding.finding
    expect(press).to_contain_text(last.reason)
    expect(page.locator(".machine", has_text="Gate")).to_contain_text("25 % movement 5 of 20")
    expect(page.locator("table")).to_contain_text("7 lost")
    expect(page.locator("table")).to_contain_text("Stale")
    store(service, "press", 1.7, fault_class="plier-bearing")
    expect(press).to_contain_text("Faulty")
    expect(press).to_contain_text("1.7 m/s² above 1 m/s²")
    expect(page.locator(".alarm")).to_contain_text("Unacknowledged")
    store(service, "late", 0.3)
    expect(page.locator(".machine", has_text="Late")).to_contain_text("Healthy")
    store(service, "press", 0.5)
    expect(page.locator(".alarm")).to_contain_text("Returned, unacknowledged")
    page.locator(".alarm").get_by_role("button", name="Acknowledge").click()
    expect(page.get_by_text("No alarms.")).to_be_visible()


def test_an_alarm_is_acknowledged_by_keyboard_and_another_browser_sees_it(service, open_page):
    store(service, "press", 1.4)
    first, second = open_page(service.url), open_page(f"{service.url}/#/machines/press")
    expect(second.locator(".alarm")).to_contain_text("Unacknowledged")
    expect(first.locator(".alarm")).to_contain_text("Unacknowledged")
    for _ in range(60):
        first.keyboard.press("Tab")
        if first.evaluate("document.activeElement.textContent") == "Acknowledge":
            break
    first.keyboard.press("Enter")
    for page in (first, second):
        expect(page.locator(".alarm")).to_contain_text("acknowledged by local")
    store(service, "press", 0.5)
    expect(first.get_by_text("No alarms.")).to_be_visible()


def test_a_machine_shows_why_and_its_signals(service, open_page):
    page = open_page(f"{service.url}/#/machines/press")
    expect(page.locator("h1")).to_have_text("Press")
    expect(page.locator("table").first).to_contain_text("rms")
    charts = page.locator(".chart .main-svg")
    expect(charts.first).to_be_visible()
    page.locator(".picker button").last.click()
    expect(page.locator(".picker button").last).to_have_attribute("aria-pressed", "true")
    expect(page.get_by_label("follow the latest")).not_to_be_checked()
    expect(page.get_by_text("20,000 samples at 10,000 Hz, 2 s")).to_be_visible()
    with page.expect_response(re.compile(r"/signal\?channel=speed$")):
        page.get_by_label("Channel", exact=True).select_option("speed")
    expect(page.locator("[aria-label=Signal] .ytitle")).to_contain_text("speed [rpm]")
    expect(page.locator("[aria-label='Amplitude spectrum'] .xtitle")).to_have_text("frequency [Hz]")
    before = page.locator(".picker button").count()
    store(service, "press", 0.8)
    expect(page.locator(".picker button")).to_have_count(before + 1)
    expect(page.locator(".picker button[aria-pressed=true]")).to_have_count(1)


def test_a_list_that_gets_longer_stays_where_it_was_scrolled_to(service, open_page):
    for number in range(20):
        store(service, "conveyor", 0.5 + 0.01 * number)
    page = open_page(f"{service.url}/#/machines/conveyor")
    picker = page.locator(".picker")
    expect(picker.locator("button")).to_have_count(20)
    picker.evaluate(
        "(list) => new Promise((seen) => { list.onscroll = seen; list.scrollTop = 100; })"
    )
    store(service, "conveyor", 0.8)
    expect(picker.locator("button")).to_have_count(21)
    assert picker.evaluate("(list) => list.scrollTop") == 100


def test_a_window_has_more_pictures_than_its_spectrum(service, open_page):
    page = open_page(f"{service.url}/#/machines/press")
    for picture, axis in (("Envelope spectrum", "envelope [m/s²]"), ("Kurtogram", "level")):
        page.get_by_label("Picture", exact=True).select_option(label=picture)
        expect(page.locator(f"[aria-label='{picture}'] .ytitle")).to_have_text(axis)
    plane = page.get_by_label("Feature plane")
    expect(plane.locator(".xtitle")).to_have_text("rms [m/s²]")
    expect(plane.locator(".ytitle")).to_have_text("kurtosis")


def test_the_gates_plane_shows_its_classifiers_regions_around_the_last_movement(
    run_service, open_page
):
    service = run_service()
    example = GateActuator.examples()[0]
    judge = GateActuator().fit(example.training, example.labels)
    file = service.services.settings.data / "gate.baseline"
    judge.save(file)
    service.services.store.add_model_version("gate", "baseline", file.read_bytes())
    for record in (example.healthy[0], example.faulty[0]):
        service.services.store.add_window("gate", record, judge.score(record))
    page = open_page(f"{service.url}/#/machines/gate")
    plane = page.get_by_label("Feature plane")
    expect(plane.locator(".annotation-text", has_text="pinion or gear")).to_be_visible()
    expect(plane.locator(".annotation-text", has_text="healthy")).to_be_visible()
    expect(plane.locator(".xtitle")).to_have_text("F1 [mm/s]")
    expect(plane.locator(".legendtext", has_text="last window")).to_be_visible()
    page.get_by_label("Indicator across").select_option("low_peak")
    expect(
        page.get_by_text("cut through the classifier's regions at the last movement")
    ).to_be_visible()
    page.get_by_label("Indicator up").select_option("notch_match")
    expect(page.get_by_text("shaded: beyond a threshold")).to_be_visible()


def test_quadrants_are_shown_as_boxes(service, open_page):
    for k in range(5):
        values = {f"rms_q{q}": 0.2 * q + 0.01 * k for q in (1, 2, 3, 4)}
        said = Finding(
            "gripping-pliers",
            "healthy",
            None,
            values,
            dict.fromkeys(values, 1.0),
            dict.fromkeys(values, "m/s²"),
            {},
            None,
        )
        service.services.store.add_window("pliers", window(k), said)
    page = open_page(f"{service.url}/#/machines/pliers")
    boxes = page.get_by_label("Quadrant boxes")
    expect(boxes.locator(".ytitle")).to_have_text("rms [m/s²]")
    expect(boxes.locator("g.trace.boxes")).to_have_count(4)


def test_a_press_is_not_lost_when_the_list_changes_before_the_release(service, open_page):
    store(service, "press", 1.4)
    page = open_page(service.url)
    button = page.locator(".alarm").get_by_role("button", name="Acknowledge the alarm of press")
    expect(button).to_be_visible()
    button.hover()
    page.mouse.down()
    store(service, "press", 2.5)
    # the page has drawn what came
    expect(page.locator(".machine", has_text="Press")).to_contain_text("2.5 m/s² above")
    page.mouse.up()
    expect(page.locator(".alarm")).to_contain_text("acknowledged by local")
    store(service, "press", 0.5)
    expect(page.get_by_text("No alarms.")).to_be_visible()


def test_what_happens_while_the_state_is_read_is_not_forgotten(service, open_page):
    """The list of alarms is answered, then an alarm is acknowledged and the page told so, and only then the answer arrives."""
    store(service, "press", 1.4)
    page = open_page(service.url)
    alarm = page.locator(".alarm")
    expect(alarm).to_contain_text("Unacknowledged")
    expect(page.locator("#connection")).to_have_text("connected")
    answered = []

    def late(route):
        answer = route.fetch()
        if (
            not answered
            and answer.json()["items"]
            and page.locator("#connection").inner_text() == "connected"
        ):
            answered.append(True)
            number = answer.json()["items"][0]["id"]
            httpx.post(
                f"{service.url}/api/v1/alarms/{number}/acknowledge", json={}, timeout=60
            ).raise_for_status()
            expect(alarm).to_contain_text("acknowledged by local")
        route.fulfill(response=answer)

    page.route(re.compile("/api/v1/alarms[?]"), late)
    # a machine that the page does not know: it reads all anew; again where it was not live just
    # then
    for k in range(20):
        with page.expect_response(re.compile("/api/v1/alarms[?]")):
            store(service, f"new-{service.port}-{k}", 0.3)
        expect(page.locator(".machine", has_text=f"New {service.port} {k}")).to_contain_text(
            "Healthy"
        )
        if answered:
            break
        expect(page.locator("#connection")).to_have_text("connected")
    assert answered
    expect(alarm).to_contain_text("acknowledged by local")
    store(service, "press", 0.5)
    expect(page.get_by_text("No alarms.")).to_be_visible()


def test_an_alarm_is_acknowledged_with_a_comment(service, open_page):
    store(service, "press", 1.6)
    page = open_page(f"{service.url}/#/machines/press")
    page.get_by_text("Comment …").click()
    page.get_by_label("Comment on the alarm of press").fill(f"bearing ordered {HOSTILE}")
    page.keyboard.press("Enter")
    expect(page.locator(".alarm")).to_contain_text(
        f"acknowledged by local: bearing ordered {HOSTILE}"
    )
    store(service, "press", 0.5)
    expect(page.get_by_text("No alarms.")).to_be_visible()


def test_a_signal_that_was_let_go_is_said_to_be_gone(run_service, open_page):
    service = run_service()
    first = store(service, "press", 0.5)
    store(service, "press", 0.6)
    service.services.store.retain(Retention(0.0, 0))
    page = open_page(f"{service.url}/#/machines/press")
    page.locator(f"[data-key=window-{first}]").click()
    expect(page.get_by_text("by the retention rule; what was found is kept.")).to_be_visible()
    expect(page.get_by_label("Signal", exact=True)).to_be_hidden()


def test_no_peak_is_lost_and_zooming_asks_for_more(service, open_page):
    page = open_page(f"{service.url}/#/machines/press")
    spiked = service.services.store.windows("press").items[-3].id
    page.locator(f"[data-key=window-{spiked}]").click()
    expect(page.get_by_text(f"Window {spiked}:")).to_be_visible()
    chart = "document.querySelector('[aria-label=Signal]')"
    highest = f"Math.max(...({chart}.data?.[0].y ?? []))"
    page.wait_for_function(f"() => {highest} === 40")
    with page.expect_response(re.compile("from=0.77.*to=0.78")) as zoomed:
        page.evaluate(
            "Plotly.relayout(document.querySelector('[aria-label=Signal]'), {'xaxis.range[0]': 0.77, 'xaxis.range[1]': 0.78})"
        )
    assert zoomed.value.json()["reduced"] is False
    page.wait_for_function(f"() => {chart}.data[0].x.length < 200 && {highest} === 40")


def test_a_fault_is_switched_on_and_off(service, open_page):
    page = open_page(f"{service.url}/#/machines/press")
    size = page.get_by_label("size")
    expect(size).to_have_value("1.5")
    size.fill("2")
    page.get_by_role("button", name="Switch on").click()
    expect(page.get_by_text("is on, 2 mm")).to_be_visible()
    page.get_by_role("button", name="Switch off").click()
    expect(page.get_by_role("button", name="Switch on")).to_be_visible()


def test_the_page_comes_back_after_a_restart_of_the_service(run_service, open_page):
    service = run_service()
    store(service, "press", 0.5)
    page = open_page(service.url, expected=["Failed to load resource", "ERR_"])
    expect(page.locator("#connection")).to_have_text("connected")
    service.stop()
    expect(page.locator("#connection")).to_contain_text("connection lost")
    service.start()
    store(service, "press", 1.9)
    expect(page.locator("#connection")).to_have_text("connected")
    expect(page.locator(".machine")).to_contain_text("1.9 m/s² above")


def test_a_connection_that_died_in_silence_is_made_anew(service, open_page):
    page = open_page(service.url)
    page.clock.install()
    page.reload()
    expect(page.locator("#connection")).to_have_text("connected")
    page.clock.fast_forward(50_000)  # and not a word in that time
    expect(page.locator("#connection")).to_contain_text("connection lost")
    page.clock.fast_forward(2_000)
    expect(page.locator("#connection")).to_have_text("connected")


def test_hostile_names_are_shown_as_text(run_service, open_page, fits):
    service = run_service()
    long = f"{HOSTILE} 😈 \u202e gnp.exe " + "W" * 10_000
    said = Finding(
        "bearing",
        "faulty",
        HOSTILE[:60],
        {HOSTILE: 2.0},
        {HOSTILE: 1.0},
        {HOSTILE: HOSTILE},
        {HOSTILE: HOSTILE},
        long,
    )
    service.services.store.ensure_asset("press", HOSTILE)
    service.services.store.add_window("press", window(), said)
    for size in SIZES.values():
        for path in ("/", "/#/machines/press"):
            page = open_page(service.url + path, size=size)
            expect(page.get_by_text(HOSTILE).first).to_be_visible()
            if path != "/":
                expect(page.locator(".main-svg").first).to_be_visible()
            assert page.evaluate("document.querySelectorAll('img[src=x], main script').length") == 0
            fits(page)


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_and_can_be_read(service, open_page, legible, size, scheme):
    store(service, "press", 1.3, fault_class="plier-bearing")
    for path in ("/", "/#/machines/press", "/#/machines/unknown"):
        page = open_page(service.url + path, size=size, scheme=scheme)
        expect(page.locator("h1")).to_be_visible()
        if path.endswith("press"):
            expect(
                page.locator("[aria-label='Amplitude spectrum'] .main-svg").first
            ).to_be_visible()
        assert page.evaluate("document.documentElement.dataset.theme") == scheme
        legible(page)


def test_times_are_the_viewers_and_the_decimal_point_is_the_languages(service, open_page):
    page = open_page(f"{service.url}/#/machines/fan", locale="de-DE", timezone_id="Asia/Tokyo")
    expect(page.locator("table").first).to_contain_text("0,5 m/s²")
    at = service.services.store.asset("fan").last_finding.at
    expected = f"{(at.hour + 9) % 24:02d}:{at.minute:02d}:{at.second:02d}"
    expect(page.locator(".picker button").first).to_contain_text(expected)


def test_a_service_with_keys_asks_for_one(run_service, open_page, tmp_path):
    key, digest = new_key()
    (tmp_path / "keys").write_text(f"eva operator {digest}")
    service = run_service(api_keys=tmp_path / "keys")
    store(service, "press", 1.3)
    page = open_page(service.url, expected=["401"])
    page.get_by_label("This service asks for a key").fill(key)
    page.get_by_role("button", name="Continue").click()
    page.get_by_role("button", name="Acknowledge").click()
    expect(page.locator(".alarm")).to_contain_text("acknowledged by eva")


def test_our_own_part_of_the_page_is_small_on_the_wire(service):
    folder = Path(residuum.service.web.__file__).parent / "assets"
    files = [path for path in folder.rglob("*") if path.is_file()]
    sizes = []
    with httpx.Client(
        base_url=service.url, headers={"Accept-Encoding": "gzip"}, timeout=60
    ) as client:
        sizes.append(int(client.get("/").headers["content-length"]))
        for path in files:
            answer = client.get(f"/web/{path.relative_to(folder)}")
            assert (
                answer.content == path.read_bytes() and answer.headers["content-encoding"] == "gzip"
            )
            sizes.append(int(answer.headers["content-length"]))
            again = client.get(
                f"/web/{path.relative_to(folder)}",
                headers={"If-None-Match": answer.headers["etag"]},
            )
            assert again.status_code == 304
        plain = client.get("/web/js/main.js", headers={"Accept-Encoding": "identity"})
    assert (
        "content-encoding" not in plain.headers
        and plain.content == (folder / "js" / "main.js").read_bytes()
    )
    assert len(files) > 30 and sum(sizes) <= 150_000


def test_both_methods_are_shown_with_every_finding_and_either_may_decide(run_service, open_page):
    service = run_service()
    case = RobustResidual.examples()[0]
    judge = RobustResidual().fit(case.training)
    file = service.services.settings.data / "plant.baseline"
    judge.save(file)
    stored = service.services.store
    stored.add_model_version("plant", "baseline", file.read_bytes())
    source = judge.with_settings(method="source")
    overlooked = next(record for record in case.faulty if source.score(record).verdict == "healthy")
    stored.add_window("plant", case.healthy[0], judge.score(case.healthy[0]))
    stored.add_window("plant", overlooked, judge.score(overlooked))
    both = "Default method: Faulty (decides) · Source's method: Healthy"
    page = open_page(service.url)
    expect(page.locator(".machine", has_text="Plant")).to_contain_text(both)
    page.goto(f"{service.url}/#/machines/plant")
    expect(page.locator(".facts")).to_contain_text("Faulty (decides)")
    windows = page.locator("section", has=page.get_by_role("heading", name="Windows", exact=True))
    expect(windows.locator(".methods")).to_have_text(both)
    windows.locator(".picker button").last.click()
    expect(windows.locator(".methods")).to_contain_text(
        "Default method: Healthy (decides) · Source's method: Healthy"
    )
    page.get_by_label("what decides").select_option("source")
    expect(
        page.get_by_role("status").filter(
            has_text="the source's method decides from the next window on"
        )
    ).to_be_visible()
    channels = {name: overlooked[name].tolist() for name in overlooked.names}
    sent = {
        "sample_time": overlooked.sample_time,
        "t0": 0.0,
        "channels": channels,
        "units": dict(overlooked.units),
    }
    httpx.post(
        f"{service.url}/api/v1/assets/plant/windows", json=sent, timeout=60
    ).raise_for_status()
    expect(page.locator(".facts")).to_contain_text("Healthy (decides)")
    page.reload()
    expect(page.get_by_label("what decides")).to_have_value("source")


def test_a_machine_with_one_method_offers_no_choice(service, open_page):
    page = open_page(f"{service.url}/#/machines/press")
    expect(page.locator("h1")).to_have_text("Press")
    expect(page.locator(".picker button").first).to_be_visible()
    expect(page.get_by_label("what decides")).to_have_count(0)
