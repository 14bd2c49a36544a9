"""A question is answered alike by the library, the command line and the HTTP interface: three thin callers of one function."""

import json
import re
from contextvars import copy_context
from functools import partial

import numpy as np
import pytest

import residuum as rs
from residuum.library.questions.residual import DesignResidual
from residuum.service.cli import ANSWER_IS_NO, BAD_INPUT, DONE, run
from residuum.service.commands import as_option
from tests.service.api.doors import (
    AXIS,
    OWN,
    answered,
    ended,
    options,
    out_of,
    printed,
    sent,
    shared,
)

IDENTIFIED = {
    "kernel": {"order": 30, "delay": 1},
    "kernel of stable splines": {"kernel": "ss", "order": 30, "delay": 1},
    "kernel with a dead time to be found": {"order": 30},
    "kernel of an integrating plant": {"order": 30, "delay": 1, "integrator": True},
    "ridge": {"method": "ridge", "order": 20, "delay": 1},
    "elastic net": {"method": "elastic-net", "order": 20, "delay": 1},
    "fir": {"method": "fir", "order": 10, "delay": 1},
    "arx": {"method": "arx", "order": 2, "delay": 1},
    "armax": {"method": "armax", "order": 1, "delay": 1},
    "output error": {"method": "oe", "order": 1, "delay": 1},
    "Box-Jenkins": {"method": "bj", "order": 1, "delay": 1},
    "order by another criterion": {"method": "arx", "criterion": "aic"},
    "known noise": {"order": 30, "noise_variance": 1e-6},
    "no level": {"order": 30, "offset": False},
    "several inputs": {"input": ["force", "velocity"], "output": "position", "order": 5},
    "several outputs": {"output": ["velocity", "position"], "order": 5},
}
REFUSED = {
    "an unknown name": (
        {"method": "arxx"},
        "method",
        "'arxx': there is none of this name; did you mean 'arx'? known are ",
    ),
    "out of bounds": ({"order": 0}, "order", ": must be ≥ 1"),
    "another kind": ({"delay": "soon"}, "delay", "'soon': must be a whole number"),
    "a name that is none": (
        {"output": ""},
        "output",
        ": must be a channel's name, or a list of names",
    ),
    "a variance that is none": (
        {"noise_variance": "guess"},
        "noise_variance",
        "'guess': must be a number or one of ",
    ),
    "an input too many": (
        {"method": "ar"},
        "method",
        "'ar': models an output alone; leave the input out",
    ),
    "a field of another method": (
        {"noise_bound": 1.0},
        "noise_bound",
        ": is used by the uncertainty set-membership alone",
    ),
    "fields that exclude each other": (
        {"integrator": True, "uncertainty": "model-error"},
        "uncertainty",
        ": bounds errors that",
    ),
    "what no path alone has": (
        {"output": ["velocity", "position"], "check": True},
        "",
        "need the method kernel, ",
    ),
}
"""What is asked, which field is refused, and how it goes on."""
DESIGNED = {
    "a controller": {},
    "few plants": {
        "rule": "worst-case",
        "epsilon": 0.1,
        "zeta": 0.2,
        "weight_order": 1,
        "points": 80,
        "lowest": 0.05,
        "seed": 3,
    },
    "robust": {
        "aim": "robust",
        "low_gain": 60,
        "high_gain": -6,
        "critical_frequency": 0.02,
        "only": "high-gain",
    },
    "held in time": {"in_time": True, "overshoot": 0.05},
    "one wish": {"only": "settling-time", "slack": 0.2, "settling_time": 100},
    "parameters held": {
        "structure": "pidn",
        "fix": {"k_d": 0, "N_d": 1},
        "within": {"k_i": [0, 5000]},
    },
    "limits": {"limits": [-2.5, 2.5]},
}
NOT_DESIGNED = {
    "an unknown structure": (
        {"structure": "pidm"},
        "structure",
        "'pidm': there is none of this name; did you mean 'pid'",
    ),
    "too few plants": ({"epsilon": 0.001}, "epsilon", "must be ≥ 0.005"),
    "a wish of the other aim": ({"only": "high-gain"}, "only", "is a wish of the aim robust; say "),
    "limits turned round": ({"limits": [3, 2.5]}, "limits", "3 2.5: must have the lower one first"),
    "a text for a number": ({"fix": {"k_d": "none"}}, "fix.k_d", "'none': must be a number"),
}
WATCHED = {
    "a residual": ({}, {}),
    "an actuator's": (
        {"fault": "actuator", "gamma": 0.2, "rule": "worst-case", "weight_order": 1},
        {"threshold": "peak"},
    ),
    "a classical one": ({"method": "kalman"}, {"false_alarms_per_day": 5}),
    "another evaluation": ({}, {"evaluation": "rms", "false_alarms_per_day": 2}),
    "a bound of the noise": ({}, {"threshold": "source", "noise_bound": 0.5}),
}
"""What is asked of the design, and of its run."""
BOUNDED = {
    "an uncertainty": {},
    "an additive one": {"form": "additive", "seed": 3},
    "few models": {
        "rule": "worst-case",
        "epsilon": 0.1,
        "zeta": 0.2,
        "weight_order": 1,
        "points": 80,
        "lowest": 0.05,
    },
}
NOT_WATCHED = {
    "an unknown method": (
        {"method": "kalmann"},
        "method",
        "'kalmann': there is none of this name; did you mean 'kalman'",
    ),
    "no gain": ({"gamma": 0}, "gamma", ": must be > 0"),
    "an unknown threshold": (
        {"threshold": "peek"},
        "threshold",
        "'peek': there is none of this name; did you mean 'peak'",
    ),
    "an unknown evaluation": ({"evaluation": "rm"}, "evaluation", "did you mean 'rms'"),
}
ASKED_OF_MODEL = {
    "compare": ("compare", {}),
    "compare by other draws": ("compare", {"level": 0.05, "seed": 3}),
    "compare with a column of another name": ("compare", {"map": {"position": "weg"}}),
    "estimate": ("estimate", {}),
    "estimate by prediction": (
        "estimate",
        {"method": "prediction", "steps": 30, "hold": "zero-order", "anyway": True},
    ),
    "estimate by a Kalman filter": ("estimate", {"method": "kalman"}),
    "explain": ("explain", {"effects": ["viscous-friction", "linear-spring"]}),
    "explain by one effect or a curve": (
        "explain",
        {"effects": "linear-spring", "learned": True, "seconds": 600},
    ),
    "explain by an effect of one's own": (
        "explain",
        {"effects": ["own-drag", "linear-spring"], "catalogue": OWN},
    ),
    "improve": ("improve", {"add": ["viscous-friction@axis"]}),
    "improve by one effect": ("improve", {"add": "viscous-friction"}),
    "improve by what is found": (
        "improve",
        {"effects": ["viscous-friction", "linear-spring"], "auto": True, "seconds": 600},
    ),
    "improve by an effect of one's own": (
        "improve",
        {"add": ["own-drag", "viscous-friction"], "catalogue": OWN},
    ),
}


NOT_ASKED_OF_MODEL = {
    "a level that no draws hold": ("compare", {"level": 1e-4}, "level", "must be ≥ 0.002"),
    "no chance of an error": ("compare", {"level": 1}, "level", "must be ≤ 0.2"),
    "a seed that is none": ("compare", {"seed": -1}, "seed", "must be ≥ 0"),
    "effects in one name": (
        "improve",
        {"add": "viscous-friction@axis@shaft"},
        "add",
        "must be an effect, or effect@place",
    ),
    "effects that are named and found": (
        "improve",
        {"add": "backlash", "auto": True},
        "auto",
        ": is for a search; leave it out",
    ),
    "effects that are named and few": (
        "improve",
        {"add": "backlash", "effects": "lugre"},
        "effects",
        ": is for a search; leave",
    ),
    "no time": ("explain", {"seconds": 0}, "seconds", "must be > 0"),
}


@pytest.mark.parametrize("case", IDENTIFIED)
def test_identify(case, axis, client, capsys):
    (path, number), asked = axis["position"], AXIS | IDENTIFIED[case]
    told = shared(rs.identify(path, **asked).to_dict())
    assert shared(printed(capsys, "identify", path, *options(asked))) == told
    assert shared(answered(client, "identify", asked | {"records": [number]})) == told


@pytest.fixture
def refused_alike(refused, capsys):
    """Ask every door what it must refuse (Python, the command, a route): the rule is the same."""

    def ask(field, says, python, words, path, body):
        assert run(list(map(str, words))) == BAD_INPUT
        told = [(capsys.readouterr().err.removeprefix("residuum: ").rstrip(), as_option(field))]
        status, http = refused("POST", f"/api/v1/{path}", json=body)
        told.append((http, f'"{field}"'))
        with pytest.raises(rs.BadInput) as error:
            python()
        told.append((str(error.value), field))
        assert status == 422
        for text, name in told:
            assert text.startswith(name if field else "several") and says in text, text

    return ask


@pytest.mark.parametrize("case", REFUSED)
def test_a_refusal_says_the_same_in_the_words_of_each_door(case, axis, refused_alike):
    (path, number), (more, field, says) = axis["position"], REFUSED[case]
    asked = AXIS | more
    words, body = ["identify", path, *options(asked)], asked | {"records": [number]}
    refused_alike(field, says, partial(rs.identify, path, **asked), words, "identify", body)


@pytest.mark.parametrize("case", ASKED_OF_MODEL)
def test_what_is_asked_of_a_model(case, axis, client, capsys, tmp_path):
    verb, asked = ASKED_OF_MODEL[case]
    path, number = axis["weg" if "map" in asked else "position"]
    here = copy_context().run  # effects of one's own are known there alone
    told = shared(here(getattr(rs.model("linear-axis"), verb), path, **asked).to_dict())
    words = asked
    if "catalogue" in asked:
        words = asked | {"catalogue": tmp_path / "own.yaml"}
        words["catalogue"].write_text(OWN, encoding="utf-8")
        assert "own-drag" in json.dumps(told)
    assert (
        shared(
            here(
                printed, capsys, verb, "linear-axis", path, *options(words), *out_of(verb, tmp_path)
            )
        )
        == told
    )
    assert (
        shared(answered(client, f"models/linear-axis/{verb}", asked | {"records": [number]}))
        == told
    )


@pytest.mark.parametrize("case", NOT_ASKED_OF_MODEL)
def test_what_is_asked_of_a_model_is_refused_alike(case, axis, refused_alike, tmp_path):
    (path, number), (verb, asked, field, says) = axis["position"], NOT_ASKED_OF_MODEL[case]
    words, body = (
        [verb, "linear-axis", path, *options(asked), *out_of(verb, tmp_path)],
        asked | {"records": [number]},
    )
    ask = partial(getattr(rs.model("linear-axis"), verb), path, **asked)
    refused_alike(field, says, ask, words, f"models/linear-axis/{verb}", body)


OPTION = re.compile(r"(?<![-\w])--[a-z]")
SAID = {
    "error codes": (
        "compare",
        {},
        (
            "; `residuum inspect FILE --missing -127 --out FILE.mapping.yaml` leaves",
            "; POST /records?missing=-127 leaves",
            "; missing=['-127'] leaves",
        ),
    ),
    "error codes, estimated": (
        "estimate",
        {},
        ("--missing -127", "POST /records?missing=-127", "missing=['-127']"),
    ),
    "an output that is not recorded": (
        "compare",
        {},
        ("(map one: --map velocity=COLUMN)", "", "(map one: map={'velocity': 'COLUMN'})"),
    ),
    "a hole": (
        "identify",
        AXIS | {"output": "position", "method": "arx"},
        ("--method kernel", '"method": "kernel"', "method='kernel'"),
    ),
}
"""What is asked of a record with error codes and a hole, and the way on in the words of each door:
command, HTTP, Python.
"""


@pytest.mark.parametrize("case", SAID)
def test_a_way_on_is_said_in_the_words_of_each_door(case, axis, client, capsys, tmp_path):
    verb, asked, (option, key, keyword) = SAID[case]
    record = rs.read(axis["position"][0])
    position = record["position"].copy()
    position[[200, 500, 800]], position[1000] = -127.0, np.nan
    path = tmp_path / "codes.npz"
    channels = {**record.channels, "position": position}
    if "not recorded" in case:
        del channels["velocity"]
    units = {name: record.units[name] for name in channels}
    rs.from_arrays(channels, units=units, sample_time=record.sample_time).save(path)
    number = sent(client, path)
    ask = rs.identify if verb == "identify" else getattr(rs.model("linear-axis"), verb)
    words = [verb, *["linear-axis"] * (verb != "identify"), path, *options(asked)]
    route = verb if verb == "identify" else f"models/linear-axis/{verb}"
    told = []
    for as_json in ([], ["--json"]):
        capsys.readouterr()
        run([*map(str, words), *map(str, out_of(verb, tmp_path)), *as_json])
        told.append("".join(capsys.readouterr()))
    place = client.post(f"/api/v1/{route}", json=asked | {"records": [number]}).headers["location"]
    http = json.dumps(ended(client, place), ensure_ascii=False)
    try:
        answer = ask(path, **asked)
        python = [str(answer), json.dumps(answer.to_dict(), ensure_ascii=False)]
    except rs.BadInput as refused:
        python = [str(refused)]
    assert option in told[0] and OPTION.search(told[1])
    assert json.dumps(key)[1:-1] in http and any(keyword in text for text in python)
    assert not any(map(OPTION.search, [http, *python]))


@pytest.mark.parametrize("case", DESIGNED)
def test_a_controller(case, plant_file, client, capsys, tmp_path):
    asked = {"structure": "pi"} | DESIGNED[case]
    told = shared(rs.control.design(plant_file, **asked).to_dict())
    out = ["--out", tmp_path / "controller.json"]
    assert shared(printed(capsys, "control", "design", plant_file, *options(asked), *out)) == told
    assert shared(answered(client, "control-designs", {"models": ["axis"]} | asked)) == told
    if case == "limits":
        exported = answered(
            client, "control-designs", {"models": [{"model": "axis"}], "export": "c"} | asked
        )["exported"]
        assert "controller_step" in exported and "2.5" in exported


@pytest.mark.parametrize("case", NOT_DESIGNED)
def test_a_controller_is_refused_alike(case, plant_file, client, refused_alike, tmp_path):
    asked, field, says = NOT_DESIGNED[case]
    words = ["control", "design", plant_file, "--out", tmp_path / "k", *options(asked)]
    design = partial(rs.control.design, plant_file, **asked)
    refused_alike(field, says, design, words, "control-designs", asked | {"models": ["axis"]})


@pytest.mark.parametrize("case", WATCHED)
def test_a_residual(case, axis, short_plant, client, capsys, tmp_path):
    (path, number), (designed, judged) = axis["position"], WATCHED[case]
    out = ["--out", tmp_path / "design"]
    design = printed(
        capsys, "residual", "design", short_plant, "--healthy", path, *options(designed), *out
    )
    ran = printed(capsys, "residual", "run", tmp_path / "design", path, *options(judged))
    body = {"model": "short", "healthy": [number], "records": [number]} | designed | judged
    http, here = answered(client, "residuals", body), rs.residual(short_plant, path, **designed)
    told = shared(here.to_dict()), shared(here.run(path, **judged).to_dict())
    assert (
        (shared(design), shared(ran)) == (shared(http["design"]), shared(http["runs"][0])) == told
    )


@pytest.mark.parametrize("case", NOT_WATCHED)
def test_a_residual_is_refused_alike(case, plant_file, refused_alike, tmp_path):
    asked, field, says = NOT_WATCHED[case]
    verb = (
        ["design", plant_file, "--out", tmp_path / "d"]
        if field in DesignResidual.model_fields
        else ["run", "d", "r.csv"]
    )
    body, ask = (
        {"model": "axis", "healthy": [1], "records": [1]} | asked,
        partial(rs.residual, plant_file, "r.csv", **asked),
    )
    if verb[0] == "run":
        ask = partial(rs.Residual.run, None, "r.csv", **asked)
    refused_alike(field, says, ask, ["residual", *verb, *options(asked)], "residuals", body)


@pytest.mark.parametrize("case", BOUNDED)
def test_an_uncertainty(case, short_plant, client, capsys):
    asked = BOUNDED[case]
    told = rs.uncertainty(short_plant, **asked).to_dict()
    assert shared(printed(capsys, "uncertainty", short_plant, *options(asked))) == shared(told)
    http = client.get("/api/v1/models/short/uncertainty", params=asked).raise_for_status().json()
    assert (http["largest"], http["n_samples"], http["promise"]) == (
        told["largest_error"],
        told["samples"],
        told["promise"],
    )


@pytest.mark.parametrize("knocks", [0.0, 20.0], ids=["healthy", "faulty"])
def test_score(knocks, client, capsys, tmp_path):
    def window(seed, height):
        rng = np.random.default_rng(seed)
        after = np.arange(4096) % 512  # samples since a knock
        vibration = rng.normal(size=4096) + height * np.sin(1.4 * after) * np.exp(-after / 20.0)
        return rs.from_arrays(
            {"vibration": vibration}, units={"vibration": "m/s^2"}, sample_time=1 / 4096
        )

    window(9, knocks).save(tmp_path / "window.npz")
    rs.monitor("bearing").fit([window(seed, 0.0) for seed in range(6)]).save(
        tmp_path / "baseline.zip"
    )
    content = (tmp_path / "baseline.zip").read_bytes()
    client.post(
        "/api/v1/models?name=healthy&kind=baseline&diagnoser=bearing", content=content
    ).raise_for_status()
    told = shared(
        rs.load_monitor("bearing", tmp_path / "baseline.zip")
        .score(tmp_path / "window.npz")
        .to_dict()
    )
    assert told["verdict"] == ("faulty" if knocks else "healthy")
    at = "--baseline", tmp_path / "baseline.zip"
    status = ANSWER_IS_NO if knocks else DONE
    assert (
        shared(printed(capsys, "score", "bearing", tmp_path / "window.npz", *at, status=status))
        == told
    )
    body = {
        "content": (tmp_path / "window.npz").read_bytes(),
        "headers": {"Content-Type": "application/zip"},
    }
    assert (
        shared(
            client.post("/api/v1/score/bearing?baseline=healthy", **body).raise_for_status().json()
        )
        == told
    )
