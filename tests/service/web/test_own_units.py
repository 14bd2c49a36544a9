"""A unit of a user's own, `ticks` of an encoder, from the model file to the page: record, effect, baseline, finding, chart."""

import json

import httpx
import numpy as np
import pytest
from playwright.sync_api import expect

from residuum.identification.physics import load_model
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service.cli import ANSWER_IS_NO, DONE, run

MODEL = """
name: winch
inputs: {voltage: V}
states: {n: {unit: ticks/s}}
parameters: {T: {value: 0.3, unit: s, lower: 0.01}, G: {value: 30, unit: ticks/s/V, lower: 1}}
balances:
  drum: {kind: torque, storage: T * der(n), terms: {motor: G * voltage, loss: -n}, velocity: n}
outputs: {speed: {value: n, unit: ticks/s}}
"""
FRICTION, HEALTHY = 40.0, 8


def winch(seed, friction=0.0, n=1500, step=0.01, inner=10):
    """`T n' = G u − n − friction·sign n`, T = .25 s, G = 45 ticks/s/V, read with half a tick a second of noise."""
    rng = np.random.default_rng(seed)
    voltage = np.repeat(rng.uniform(-6, 6, n // 50), 50)
    speed, read = 0.0, np.empty(n)
    for k, u in enumerate(voltage):
        read[k] = speed
        for _ in range(inner):
            drive = 45.0 * u - speed
            if speed == 0.0 and abs(drive) <= friction:
                continue
            way = np.sign(speed) or np.sign(drive)
            after = speed + step / inner / 0.25 * (drive - friction * way)
            speed = 0.0 if after * way < 0 else after
    units = {"voltage": "V", "speed": "ticks/s"}
    return Record({"voltage": voltage, "speed": read + rng.normal(0.0, 0.5, n)}, units, step)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("winch")
    (folder / "winch.yaml").write_text(MODEL)
    for k in range(HEALTHY):
        write_record(winch(k), folder / f"healthy{k}.csv")
    write_record(winch(50, FRICTION), folder / "dry.csv")
    return folder


def told(arguments, capsys, status=DONE):
    assert run([*map(str, arguments), "--json"]) == status
    return json.loads(capsys.readouterr().out)


def test_ticks_go_from_the_model_file_to_the_page(folder, capsys, run_service, open_page):
    model, dry, base = folder / "winch.yaml", folder / "dry.csv", folder / "winch.base"
    compared = told(["compare", model, dry], capsys)
    assert compared["outputs"]["speed"]["unit"] == "ticks/s" == compared["balances"]["drum"]["unit"]

    explained = told(
        ["explain", model, dry, "--effects", "coulomb-friction,quadratic-drag"], capsys
    )
    first = explained["candidates"][0]
    assert (first["effect"], first["error_unit"]) == ("coulomb-friction", "ticks/s")
    assert first["parameters"]["tau_c"]["unit"] == "ticks/s"
    assert first["parameters"]["tau_c"]["value"] == pytest.approx(FRICTION, rel=0.02)

    told(
        ["improve", model, dry, "--add", "coulomb-friction", "--out", folder / "better.yaml"],
        capsys,
    )
    assert (
        load_model(folder / "better.yaml").all_parameters["coulomb-friction@drum.tau_c"].unit
        == "ticks/s"
    )

    healthy = [folder / f"healthy{k}.csv" for k in range(HEALTHY)]
    trained = told(["train", "model-based", *healthy, "--model", model, "--out", base], capsys)
    assert trained["parameters"]["G"]["unit"] == "ticks/s/V"
    cause = told(["score", "model-based", dry, "--baseline", base], capsys, ANSWER_IS_NO)["causes"][
        0
    ]
    assert cause["value"]["unit"] == "ticks/s"

    service = run_service()
    query = {"name": "winch", "kind": "baseline", "diagnoser": "model-based"}
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:
        assert client.post("/models", params=query, content=base.read_bytes()).status_code == 201
        sent = {
            "params": {"diagnoser": "model-based"},
            "content": dry.read_bytes(),
            "headers": {"content-type": "text/csv"},
        }
        stored = client.post("/assets/winch/windows", **sent)
    assert stored.status_code == 201 and stored.json()["window"]["units"]["speed"] == "ticks/s"

    page = open_page(f"{service.url}/#/machines/winch")
    expect(page.locator(".badge", has_text="Faulty")).to_be_visible()
    expect(page.locator(".says-large")).to_contain_text("ticks/s")
    expect(page.get_by_text("friction of the drum").first).to_contain_text("ticks/s")
    page.get_by_label("Channel").select_option("speed")
    expect(
        page.locator(".chart .main-svg").filter(has_text="speed [ticks/s]").first
    ).to_be_visible()
