"""Records of virtual machines over HTTP."""

import time

import numpy as np

import residuum as rs
from tests.service.api.doors import printed


def finished(client, asked):
    place = (
        client.post("/api/v1/records/simulations", json=asked)
        .raise_for_status()
        .headers["location"]
    )
    while (job := client.get(place).json())["state"] in ("queued", "running"):
        time.sleep(0.02)
    return job


def test_a_virtual_machines_record_is_stored_as_the_library_gives_it(client):
    hidden = {"viscous-friction": {"b": 30.0}}
    job = finished(
        client, {"machine": "linear-axis", "effects": hidden, "duration": 1.0, "seed": 4}
    )
    assert job["state"] == "done", job
    expected = rs.simulate("linear-axis", effects=hidden, duration=1.0, seed=4)
    stored = client.get(f"/api/v1/records/{job['result']['id']}").json()
    assert (
        stored == job["result"]
        and stored["units"] == dict(expected.units)
        and stored["name"] == "simulated linear-axis"
    )
    signal = client.get(f"/api/v1/records/{stored['id']}/signal", params={"points": 5000}).json()
    np.testing.assert_allclose(
        signal["channels"]["velocity"]["values"], expected["velocity"], rtol=1e-6, atol=1e-12
    )
    assert "viscous" not in str(stored)  # what is hidden is for the analysis to find


def test_what_is_hidden_is_said_alike_in_every_door(client, tmp_path, capsys):
    file = tmp_path / "oven.npz"
    said = ["--effect", "radiation:large", "--fault", "sensor-offset:3", "--set", "sample-time-s=2"]
    said += ["--exemplar", 2, "--duration", 600, "--seed", 5]
    truth = printed(capsys, "simulate", "oven", "--out", file, *said)["truth"]
    asked = {
        "effects": {"radiation": "large"},
        "faults": ["sensor-offset:3"],
        "exemplar": 2,
        "duration": 600,
        "seed": 5,
    }
    by_name = rs.simulate("oven", **asked, sample_time_s=2.0)
    job = finished(client, {"machine": "oven", "settings": {"sample_time_s": 2}, **asked})
    signal = client.get(f"/api/v1/records/{job['result']['id']}/signal", params={"points": 5000})
    assert list(truth["effects"]) == ["radiation"] and truth["faults"] == {"sensor-offset": 3.0}
    assert by_name.sample_time == rs.read(file).sample_time == 2.0
    for name, values in signal.json()["channels"].items():
        np.testing.assert_allclose(values["values"], by_name[name], rtol=1e-6, atol=1e-12)
        np.testing.assert_array_equal(rs.read(file)[name], by_name[name])


def test_a_machine_or_effect_that_there_is_not_is_refused(client, refused):
    assert "gate-drive" in finished(client, {"machine": "perpetuum-mobile"})["error"]
    assert (
        "phlogiston"
        in finished(
            client, {"machine": "gate-drive", "effects": {"phlogiston": "large"}, "duration": 1}
        )["error"]
    )
    assert (
        refused("POST", "/api/v1/records/simulations", json={"machine": "oven", "duration": 1e7})[0]
        == 422
    )
