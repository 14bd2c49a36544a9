"""Asking the service and the command what is asked of the library."""

import json
import re
import time

import numpy as np

from residuum.service.cli import DONE, run
from residuum.service.commands import as_option

OWN_TO_A_DOOR = (
    "file",
    "model_file",
    "identified",
    "stored",
    "record",
    "records",
    "models",
    "seconds",
)
"""Where each door puts files, what it calls records and models, and how long it took."""


AXIS = {"input": "force", "output": "velocity"}


OWN = """
effects:
  - id: own-drag
    acts_on: [force]
    term: -c * velocity
    parameters: {c: {value: 0, unit: N*s/m, lower: 0, size: true}}
"""


def sent(client, path):
    answer = client.post(
        "/api/v1/records", params={"filename": path.name}, content=path.read_bytes()
    )
    return answer.raise_for_status().json()["id"]


def printed(capsys, *arguments, status=DONE):
    capsys.readouterr()
    assert run([*map(str, arguments), "--json"]) == status
    return json.loads(capsys.readouterr().out)


def answered(client, path, asked):
    """What a job of the service found."""
    place = client.post(f"/api/v1/{path}", json=asked).raise_for_status().headers["location"]
    job = ended(client, place)
    assert job["state"] == "done", job
    return job["result"]


def ended(client, place):
    """A job at its end."""
    end = time.monotonic() + 300
    while (job := client.get(place).json())["state"] in ("queued", "running"):
        assert time.monotonic() < end, job
        time.sleep(0.02)
    return job


def shared(answer):
    """The part of an answer that is every door's, as JSON; a record is called differently by each."""
    text = re.sub(
        r"(record-\d+|position|weg)\.npz", "the record", json.dumps(answer, ensure_ascii=False)
    )
    return {name: value for name, value in json.loads(text).items() if name not in OWN_TO_A_DOOR}


def out_of(verb, folder):
    """The option by which a command is told where to write a model, of those that make one."""
    return ["--out", folder / "out.yaml"] if verb in ("estimate", "improve") else []


def options(asked):
    for name, value in asked.items():
        if value is True:
            yield f"--{name.replace('_', '-')}"
        elif value is False:
            yield from ["--no-offset"] * (name == "offset")
        elif name in ("input", "output", "unknown_input"):
            yield from (word for channel in np.ravel(value) for word in (as_option(name), channel))
        elif isinstance(value, dict):
            texts = {key: ":".join(map(str, np.ravel(part))) for key, part in value.items()}
            yield from (
                word for pair in texts.items() for word in (as_option(name), "=".join(pair))
            )
        elif name in ("effects", "faults", "events") and ":" in "".join(value):
            yield from (word for text in value for word in (as_option(name), text))
        elif name == "limits":
            yield from (as_option(name), *value)
        else:
            yield from (
                f"--{name.replace('_', '-')}",
                ",".join(value) if isinstance(value, list) else value,
            )
