"""What every listed diagnoser must do, run on its own examples."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.finding import Verdict
from residuum.identification.errors import BadInput
from residuum.identification.record import Record

NAMES = list(DIAGNOSERS)


@cache
def examples(name):
    return tuple(DIAGNOSERS[name].examples())


def with_signals(record, change):
    return replace(
        record,
        channels={name: change(np.array(signal)) for name, signal in record.channels.items()},
    )


@pytest.mark.parametrize("name", NAMES)
def test_tells_its_healthy_and_faulty_examples_apart(name, trained):
    assert examples(name), "a diagnoser shows at least one example"
    for position, example in enumerate(examples(name)):
        judge = trained(name, position)
        assert [judge.score(record).verdict for record in example.healthy] == [
            Verdict.HEALTHY
        ] * len(example.healthy)
        faulty = [judge.score(record) for record in example.faulty]
        assert [finding.verdict for finding in faulty] == [Verdict.FAULTY] * len(example.faulty)
        assert all(
            finding.fault_class in judge.classes
            for finding in faulty
            if finding.fault_class is not None
        )


@pytest.mark.parametrize("name", NAMES)
def test_finding_is_json_with_numbers_units_and_a_reason(name, trained):
    finding = trained(name).score(examples(name)[0].faulty[0])
    content = json.loads(json.dumps(finding.to_json(), allow_nan=False))
    assert content["diagnoser"] == name and content["indicators"] and content["reason"]
    assert set(content["thresholds"]) <= set(content["indicators"])
    assert set(content["units"]) <= set(content["indicators"])


@pytest.mark.parametrize("name", NAMES)
def test_stored_and_loaded_judges_the_same(name, trained, tmp_path):
    trained(name).save(tmp_path / "baseline")
    loaded = DIAGNOSERS[name].load(tmp_path / "baseline")
    for record in (*examples(name)[0].healthy, *examples(name)[0].faulty):
        assert loaded.score(record).to_json() == trained(name).score(record).to_json()


@pytest.mark.parametrize("name", NAMES)
def test_relearned_from_healthy_records_it_still_tells_the_faults(name, trained):
    example = examples(name)[0]
    before = trained(name)
    judged = [before.score(record).to_json() for record in example.faulty]
    healthy = [
        r
        for k, r in enumerate(example.training)
        if example.labels is None or example.labels[k] == "healthy"
    ]
    fresh = before.relearned(healthy)
    assert [fresh.score(record).verdict for record in example.healthy] == [Verdict.HEALTHY] * len(
        example.healthy
    )
    found = [fresh.score(record) for record in example.faulty]
    assert [finding.verdict for finding in found] == [Verdict.FAULTY] * len(found)
    assert set(found[0].thresholds) == set(judged[0]["thresholds"])
    assert [before.score(record).to_json() for record in example.faulty] == judged


@pytest.mark.parametrize("name", NAMES)
def test_a_foreign_file_is_refused(name, trained, tmp_path):
    # Two that learn within a second: a new diagnoser does not wait for a neighbour's training.
    other = "gripping-pliers" if name == "bearing" else "bearing"
    path = tmp_path / "baseline"
    trained(other).save(path)
    with pytest.raises(BadInput):
        DIAGNOSERS[name].load(path)
    path.write_bytes(b"not a baseline")
    with pytest.raises(BadInput):
        DIAGNOSERS[name].load(path)


UNUSABLE = {
    "too short": lambda record: record.window(0, 5),
    "a gap": lambda record: with_signals(
        record, lambda x: np.where(np.arange(x.size) // (x.size // 8 + 1) == 3, np.nan, x)
    ),
    "one missing sample": lambda record: with_signals(
        record, lambda x: np.where(np.arange(x.size) == x.size // 2, np.nan, x)
    ),
    "flat": lambda record: with_signals(record, lambda x: np.full_like(x, x[0])),
    "all missing": lambda record: with_signals(record, lambda x: np.full_like(x, np.nan)),
    "another rate": lambda record: replace(record, sample_time=record.sample_time * 2.7),
}


ANY_RATE = {"bearing"}
"""Those that judge a window of any rate; of all others it is not assessable."""

CASES = [
    (name, harm)
    for name in NAMES
    for harm in UNUSABLE
    if not (harm == "another rate" and name in ANY_RATE)
]


@pytest.mark.parametrize(("name", "harm"), CASES)
def test_an_unusable_window_is_never_judged_healthy(name, harm, trained):
    finding = trained(name).score(UNUSABLE[harm](examples(name)[0].healthy[0]))
    assert finding.verdict is Verdict.NOT_ASSESSABLE
    assert finding.reason


@pytest.mark.parametrize("name", NAMES)
def test_a_record_without_the_channels_is_refused_by_name(name, trained):
    with pytest.raises(BadInput, match="channel"):
        trained(name).score(Record({"something": np.arange(1e4)}, {"something": "K"}, 1.0))


@pytest.mark.parametrize("name", NAMES)
def test_it_says_what_it_reads(name, trained):
    described = trained(name).describe()
    assert described["name"] == name and described["channels"] and described["classes"]
