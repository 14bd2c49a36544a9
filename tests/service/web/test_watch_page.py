"""The guided way of the tutorial, by clicking: a stranger's fan is described, recorded, modelled, trained and watched."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import expect

_device = Path(__file__).parents[1] / "fieldbus" / "small_device.py"
_spec = importlib.util.spec_from_file_location("small_device", _device)
_module = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_module)
SmallDevice = _module.SmallDevice
RIG = Path(__file__).parents[3] / "docs" / "tutorials" / "fan_rig"
SPEED = 10.0
LONG = 1_200_000  # milliseconds that estimating and training may take on a busy machine


@pytest.fixture
def fan_rig(free_port, free_channel):
    """The tutorial's rig in a process of its own; gives the process and its CAN channel."""
    channel = free_channel()
    address = channel.removeprefix("udp_multicast:").removesuffix("/0")
    command = [
        sys.executable,
        RIG / "fan_rig.py",
        "--can",
        address,
        "--modbus",
        str(free_port()),
        "--speed",
        str(SPEED),
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as rig:
        assert rig.stdout.readline() == "The fan turns.\n"
        yield rig, channel
        rig.stdin.close()
        rig.terminate()


def order(rig, text):
    rig.stdin.write(text + "\n")
    rig.stdin.flush()


def key(page, name):
    return page.locator(f"[data-key={name}]")


def answered(page, what):
    """Wait for a job's answer, `what` it is to show; a job that failed fails the test at once, with the page's own words."""
    failed = page.get_by_role("button", name="Try again")
    expect(what.or_(failed).first).to_be_visible(timeout=LONG)
    assert not failed.is_visible(), page.get_by_role("tabpanel").inner_text()


def test_the_guided_way_of_the_tutorial_by_clicking(run_service, open_page, legible, fan_rig):
    rig, channel = fan_rig
    service = run_service()
    page = open_page(f"{service.url}/")
    page.get_by_role("link", name="Watch a machine").first.click()

    key(page, "name").fill("fan")
    key(page, "channel").fill(channel)
    key(page, "length").fill("5")
    key(page, "map-file").set_input_files(RIG / "fan.dbc")
    expect(page.get_by_role("cell", name="n_fan")).to_be_visible()
    legible(page)
    key(page, "watch-machine").click()

    expect(page.get_by_role("row", name=re.compile(r"n_fan.*rpm"))).to_be_visible()
    legible(page)
    key(page, "next").click()

    expect(page.get_by_text("windows are recorded.")).to_be_visible()
    expect(key(page, "next")).to_be_enabled(timeout=LONG)
    expect(page.locator("[data-key^=healthy-]")).not_to_have_count(0)
    legible(page)
    page.locator("[data-key^=healthy-]").last.uncheck()
    expect(page.get_by_text(re.compile(r"^1\d of 20 windows"))).to_be_visible(timeout=LONG)
    key(page, "next").click()

    page.get_by_text("Upload or write a model file").click()
    key(page, "model-file").set_input_files(RIG / "fan.yaml")
    key(page, "store-model").click()
    for name, bus in (("voltage", "u_mot"), ("speed", "n_fan"), ("current", "i_mot")):
        expect(key(page, f"map-{name}")).to_have_value(bus)
    legible(page)
    key(page, "use-model").click()

    answered(page, page.get_by_text("Structured error"))
    legible(page)
    key(page, "improve").click()
    answered(page, page.get_by_text(re.compile("Quadratic drag of the shaft added")))
    legible(page)
    key(page, "use-improved").click()

    key(page, "train").click()
    answered(page, page.get_by_text(re.compile(r"Trained on \d+ windows; 0 of them")))
    legible(page)
    key(page, "next").click()

    expect(page.locator(".badge", has_text="Healthy")).to_be_visible(timeout=LONG)
    order(rig, "rub 0.01")
    expect(page.locator(".badge", has_text="Faulty")).to_be_visible(timeout=LONG)
    expect(page.locator(".alarm").first).to_be_visible()
    expect(page.locator(".says-large")).to_contain_text("shaft")
    legible(page)
    page.set_viewport_size({"width": 390, "height": 844})
    legible(page)
    key(page, "machine-page").click()
    expect(page.get_by_role("heading", name="Fan")).to_be_visible()


def test_a_diagnoser_with_two_methods_is_trained_with_the_one_that_is_chosen(
    run_service, open_page, legible, free_port
):
    service = run_service()
    source = {
        "kind": "modbus",
        "host": "127.0.0.1",
        "port": free_port(),
        "map": "process_plant.yaml",
    }
    settings = {
        "diagnoser": "robust-residual",
        "window": {"cut": "sliding", "length": 60, "step": 60},
        "sources": [source],
    }
    put = httpx.put(f"{service.url}/api/v1/assets/plant/machine", json=settings, timeout=60)
    assert put.status_code == 200, put.text
    page = open_page(f"{service.url}/#/watch?machine=plant&step=train", expected=("409",))
    key(page, "method").select_option("source")
    # it is not a setting of this diagnoser
    expect(page.get_by_label("false alarms a day that you accept")).to_have_count(0)
    expect(page.get_by_label("what decides")).to_have_value("source")
    legible(page)
    with page.expect_request(re.compile("/assets/plant/training$")) as sent:
        key(page, "train").click()
    assert sent.value.post_data_json == {"leave_out": [], "method": "source"}


def test_a_device_that_is_off_or_lacks_a_register_is_told_where_the_values_are(
    run_service, open_page, legible, free_port
):
    service, port = run_service(), free_port()
    page = open_page(f"{service.url}/#/watch")
    describe(page, "off", port, "name;register;type;unit\nspeed;40001;uint16;rpm\n")
    expect(
        page.get_by_text(f"Nothing has come yet from 127.0.0.1:{port}: nobody answers")
    ).to_be_visible()
    expect(page.get_by_text("It is changed under Source.")).to_be_visible()
    with SmallDevice(holding={0: 7}) as device:
        key(page, "tab-source").click()
        table = "name;register;type;unit\nspeed;40001;uint16;rpm\nload;40009;uint16;\n"
        describe(page, "lacking", device.port, table)
        expect(
            page.get_by_text("No value for load: signals: exception 2 for holding registers 8")
        ).to_be_visible()
        legible(page)
        page.goto(f"{service.url}/#/watch?machine=lacking&step=model")
        key(page, "model").select_option("gate-drive")
        key(page, "map-voltage").select_option("load")
        key(page, "use-model").click()
        expect(
            page.get_by_text(
                "load has no unit, and voltage is in V: write the unit into the description"
            )
        ).to_have_count(1)


def describe(page, name, port, table):
    key(page, "name").fill(name)
    key(page, "kind").select_option("modbus")
    key(page, "port").fill(str(port))
    file = {"name": "registers.csv", "mimeType": "text/csv", "buffer": table.encode()}
    key(page, "map-file").set_input_files(file)
    expect(page.get_by_role("cell", name="speed")).to_be_visible()
    key(page, "watch-machine").click()
