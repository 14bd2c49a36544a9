"""A record is cut where an input was not measured: nobody knows what the machine did meanwhile."""

import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import BadRecord
from residuum.identification.physics import load_model, measured_parts
from residuum.identification.record import Record

H = 0.01


def drive(n=2000, hole=()):
    """A first-order drive followed exactly, and not recorded within the hole, where it goes on."""
    t = H * np.arange(n)
    u = np.where(np.sin(2 * np.pi * 0.3 * t + 0.1) > 0, 50.0, -30.0)
    v = np.zeros(n)
    for k in range(n - 1):
        v[k + 1] = v[k] + H * u[k] / 95.0
    for channel in (u, v):
        channel[slice(*hole) if hole else slice(0, 0)] = np.nan
    return Record(
        {"force": u, "velocity": v}, {"force": "N", "velocity": "m/s"}, H, t0=5.0, source="axis.csv"
    )


def test_the_parts_are_what_was_measured():
    record = drive(hole=(800, 1200))
    first, second = measured_parts(load_model("linear-axis"), [record])
    assert (first.n, second.n, second.t0) == (800, 800, pytest.approx(5.0 + 1200 * H))
    assert first.source == "axis.csv (part 1: 5 to 12.99 s)" and not np.isnan(second["force"]).any()
    np.testing.assert_array_equal(second["velocity"], record["velocity"][1200:])


def test_an_exact_model_fits_both_sides_of_a_hole_and_the_answer_says_so():
    compared = rs.model("linear-axis").compare(drive(hole=(800, 1200)))
    assert compared.to_dict()["outputs"]["velocity"]["fit_percent"] > 99.0
    assert "axis.csv (part 2: 17 to 24.99 s): simulated by itself" in str(compared)
    assert len(compared.to_dict()["records"]) == 2


def test_missing_outputs_cut_nothing():
    record = drive()
    v = np.array(record["velocity"])
    v[300:900] = np.nan
    whole = Record({"force": record["force"], "velocity": v}, record.units, H)
    assert [part.n for part in measured_parts(load_model("linear-axis"), [whole])] == [2000]


def test_an_input_that_is_there_now_and_then_is_refused():
    u = np.array(drive()["force"])
    u[::2] = np.nan
    record = Record({"force": u, "velocity": drive()["velocity"]}, drive().units, H)
    with pytest.raises(BadRecord, match="input 'force' has no value at sample 0"):
        rs.model("linear-axis").compare(record)


@pytest.mark.parametrize("separator", [",", ";"])
@pytest.mark.parametrize("every", [2, 5])
def test_an_input_of_a_lower_rate_is_completed_by_resampling_as_its_refusal_says(
    tmp_path, every, separator
):
    """No hole is one: the values between are asked for, and come from the input's own samples."""
    whole = drive()
    force = 50.0 * np.sin(2 * np.pi * 0.3 * whole.time)
    slow = Record(
        {"force": np.where(np.arange(2000) % every, np.nan, force), "velocity": whole["velocity"]},
        whole.units,
        H,
    )
    rs.from_arrays(slow.channels, units=slow.units, sample_time=H).save(tmp_path / "axis.csv")
    (tmp_path / "axis.csv").write_text((tmp_path / "axis.csv").read_text().replace(",", separator))
    with pytest.raises(
        BadRecord, match=f"one every {every} samples; say resample=True where the record is read"
    ):
        rs.model("linear-axis").compare(rs.read(tmp_path / "axis.csv"))
    record = rs.read(tmp_path / "axis.csv", resample=True)
    assert any("force resampled to 0.01 s" in note for note in record.notes)
    assert (
        np.nanmax(np.abs(record["force"] - force)) < 0.2
        and np.isnan(record["force"]).sum() == every - 1
    )
    assert not np.isnan(record["velocity"]).any() and rs.model("linear-axis").compare(record)


def test_resampling_fills_no_stretch_of_an_even_record(tmp_path):
    record = rs.from_arrays(
        drive(hole=(800, 801)).channels, units={"force": "N", "velocity": "m/s"}, sample_time=H
    )
    record.save(tmp_path / "axis.csv")
    assert np.flatnonzero(
        np.isnan(rs.read(tmp_path / "axis.csv", resample=True)["force"])
    ).tolist() == [800]
