"""Any record that a writer writes is read as it was: values, units, step, and what is missing stays missing."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import WRITERS, read_record, write_record

UNITS = ["V", "rad/s", "N*m", "°C", "%", "bar", "m/s²", "rpm", "ticks", ""]
WITHOUT_MISSING = {".uff"}
"""Formats that keep no missing samples: a record that has some is not written."""


@st.composite
def records(draw):
    n = draw(st.integers(4, 40))
    names = draw(
        st.lists(
            st.sampled_from(["speed", "force", "U_1", "T oil", "T", "b"]),
            min_size=1,
            max_size=3,
            unique=True,
        )
    )
    step = draw(st.sampled_from([1e-4, 0.002, 0.1, 0.5, 1.0, 60.0]))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    channels = {
        name: np.round(rng.normal(size=n) * 10.0 ** rng.integers(-3, 4), 9) for name in names
    }
    for values in channels.values():
        values[rng.random(n) < draw(st.sampled_from([0.0, 0.1, 0.4]))] = np.nan
        values[:2] = np.round(rng.normal(size=2), 6)
    return Record(channels, {name: draw(st.sampled_from(UNITS)) for name in names}, step)


# sound keeps neither units nor names
@pytest.mark.parametrize("ending", [ending for ending in WRITERS if ending != ".wav"])
@given(record=records())
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_a_record_is_read_as_it_was_written(ending, record):
    with tempfile.TemporaryDirectory() as folder:
        if ending in WITHOUT_MISSING and any(record.missing(name).any() for name in record.names):
            with pytest.raises(BadRecord, match="keeps no missing samples"):
                write_record(record, Path(folder) / f"r{ending}")
            assert not any(Path(folder).iterdir())
            return
        write_record(record, Path(folder) / f"r{ending}")
        again = read_record(Path(folder) / f"r{ending}")
    assert again.sample_time == pytest.approx(record.sample_time, rel=1e-6) and again.n == record.n
    assert list(again.names) == list(record.names)
    assert dict(again.units) == dict(record.units)
    for name in record.names:
        np.testing.assert_array_equal(again.missing(name), record.missing(name))
        np.testing.assert_allclose(again[name], record[name], rtol=1e-8, atol=1e-12)
