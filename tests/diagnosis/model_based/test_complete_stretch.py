"""A window that lacks samples is judged by its longest stretch without a hole, and says so."""

import numpy as np
import pytest

from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.finding import Verdict
from residuum.diagnosis.model_based.assessment import complete_stretch
from residuum.identification.record import Record


def holed(record, name, *places):
    values = np.array(record[name])
    values[list(places)] = np.nan
    return Record(
        {**record.channels, name: values},
        record.units,
        record.sample_time,
        record.t0,
        source=record.source,
    )


@pytest.fixture
def record():
    return Record({"u": np.arange(100.0), "y": np.arange(100.0)}, {"u": "V", "y": "A"}, 0.1, 5.0)


def test_a_window_without_a_hole_is_taken_whole(record):
    assert complete_stretch(record, ["u", "y"], 50) is record


def test_the_longest_stretch_keeps_its_place_on_the_clock(record):
    found = complete_stretch(holed(holed(record, "u", 10), "y", 90, 95), ["u", "y"], 50)
    assert found["u"].tolist() == list(range(11, 90)) and found.t0 == pytest.approx(5.0 + 1.1)


def test_a_hole_in_a_signal_that_the_model_does_not_use_is_none(record):
    lost = holed(record, "y", 10)
    assert complete_stretch(lost, ["u"], 50) is lost


def test_half_a_window_does_not_stand_for_it(record):
    lost = holed(record, "u", 50)
    assert complete_stretch(lost, ["u"], 50) is lost


def test_a_lost_sample_leaves_a_window_that_is_judged_and_says_by_what(complete_axis):
    example = ModelBased.examples()[0]
    for one, verdict in (
        (example.healthy[0], Verdict.HEALTHY),
        (example.faulty[0], Verdict.FAULTY),
    ):
        finding = complete_axis.score(holed(one, "force", 300))
        assert finding.verdict is verdict
        assert finding.evidence["judged"] == {
            "from": pytest.approx(1.505),
            "to": pytest.approx(7.5),
            "samples": 1199,
            "of": 1500,
        }
        assert "1199 of 1500 samples" in finding.reason
