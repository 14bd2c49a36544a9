"""The ways of a record and of a window, as the pages draw them, are those that they take."""

import contextlib
import re
import sys
import threading
import time
from pathlib import Path

import numpy as np

import residuum
from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service.cli import run as run_command
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings, WindowSettings

ROOT = Path(residuum.__file__).parent
PAGES = Path(__file__).parents[2] / "docs/explanation"


@contextlib.contextmanager
def entered():
    """The functions of the package in the order in which they are first entered, in any thread."""
    order = {}

    def note(frame, event, _):
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(str(ROOT)):
            place = Path(code.co_filename).relative_to(ROOT).with_suffix("")
            module = ".".join(part for part in place.parts if part != "__init__")
            order.setdefault(f"{module}.{code.co_qualname}", len(order))

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield order
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


def drawn(page):
    """The functions that a page's table names, a step each."""
    text = (PAGES / page).read_text(encoding="utf-8")
    return re.findall(r"^\| \d+ \| `([\w.]+)`", text, re.MULTILINE)


def test_the_way_of_a_record_is_the_one_that_its_page_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run_command(["simulate", "oscillator", "--out", "record.csv", "--seed", "1"]) == 0
    with entered() as order:
        run_command(["explain", "oscillator", "record.csv", "--effects", "cubic-spring"])
    capsys.readouterr()
    steps = drawn("way-of-a-record.md")
    assert len(steps) > 10
    assert [step for step in steps if step not in order] == []
    assert sorted(steps, key=order.get) == steps


def test_the_way_of_a_window_is_the_one_that_its_page_draws(run_service, free_channel, tmp_path):
    example = DIAGNOSERS["bearing"].examples()[0]
    trained = DIAGNOSERS["bearing"]().fit(example.training, example.labels)
    trained.save(tmp_path / "baseline.zip")
    channel = free_channel()
    watched = MachineSettings(
        asset="rig",
        diagnoser="bearing",
        window=WindowSettings(cut="sliding", length=0.5, step=0.5),
        sources=[SourceSettings(kind="can", channel=channel, map="vibration_logger.dbc")],
    )
    noise = np.random.default_rng(0).normal(size=24_000)
    write_record(
        Record({"acceleration": noise}, {"acceleration": "g"}, 1 / 12000), tmp_path / "a.npz"
    )
    with entered() as order:
        service = run_service(machines=[watched.model_dump()])
        baseline = (tmp_path / "baseline.zip").read_bytes()
        service.services.store.add_model_version("rig", "baseline", baseline)
        wait_for(
            lambda: service.services.pipeline.status()["machines"]["rig"]["state"] == "waiting"
        )
        order.clear()
        to_bus = ["--to", f"can:{channel}", "--bus-map", "vibration_logger.dbc", "--speed", "2"]
        assert run_command(["replay", str(tmp_path / "a.npz"), *to_bus]) == 0
        wait_for(lambda: len(service.services.store.findings("rig").items) > 1)
    steps = drawn("way-of-a-window.md")
    assert len(steps) > 10
    assert [step for step in steps if step not in order] == []
    assert sorted(steps, key=order.get) == steps


def wait_for(condition):
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.1)
