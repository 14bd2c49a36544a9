"""MAT files as MATLAB's and Simulink's users save them: every signal is read or named, no number is taken for a sample time."""

import numpy as np
import pytest
from scipy.io import savemat

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats import ReadOptions, read_record

N = 500
TIME = 0.01 * np.arange(N)
U = np.sign(np.sin(3 * TIME + 0.1))
Y = np.cos(2 * TIME)


def saved(tmp_path, **content):
    savemat(tmp_path / "r.mat", content)
    return tmp_path / "r.mat"


def column(values):
    return np.asarray(values)[:, None]


def log(*signals):
    kinds = [("values", "O"), ("dimensions", "O"), ("label", "O")]
    array = np.zeros((1, len(signals)), dtype=kinds)
    for k, (label, values) in enumerate(signals):
        array[0, k] = (values, float(values.shape[1]), label)
    return array


@pytest.mark.parametrize("name", ["time", "Time", "t", "tout", "Zeit"])
def test_the_time_has_many_names(tmp_path, name):
    record = read_record(saved(tmp_path, **{name: column(TIME), "u": column(U), "y": Y[None, :]}))
    assert set(record.names) == {"u", "y"} and record.sample_time == pytest.approx(0.01)


@pytest.mark.parametrize("turned", [False, True])
def test_the_columns_of_a_matrix_that_is_as_long_as_the_time_are_channels(tmp_path, turned):
    matrix = np.c_[Y, 2 * Y, 3 * Y]
    record = read_record(
        saved(tmp_path, time=column(TIME), u=column(U), acc=matrix.T if turned else matrix)
    )
    assert record.names == ("u", "acc_1", "acc_2", "acc_3")
    np.testing.assert_array_equal(record["acc_3"], 3 * Y)


def test_channels_of_two_times_keep_their_samples(tmp_path):
    record = read_record(
        saved(
            tmp_path, t_fast=column(TIME), u=column(U), t_slow=column(TIME[::10]), y=column(Y[::10])
        )
    )
    assert record.sample_time == pytest.approx(0.01) and set(record.names) == {"u", "y"}
    assert np.flatnonzero(~record.missing("y")).tolist() == list(range(0, N, 10))


def test_structs_have_times_of_their_own(tmp_path):
    fast, slow = (
        {"time": column(TIME), "u": column(U)},
        {"time": column(TIME[::5]), "y": column(Y[::5])},
    )
    record = read_record(saved(tmp_path, fast=fast, slow=slow))
    assert set(record.names) == {"u", "y"} and record.missing("y").sum() == N - N // 5


def test_a_signal_without_a_time_is_named(tmp_path):
    record = read_record(
        saved(
            tmp_path,
            time=column(TIME),
            u=column(U),
            gains=column([1.0, 2.0, 3.0]),
            cube=np.zeros((2, 3, 4)),
        )
    )
    assert record.notes == ("not read: gains (3 values), cube (2 × 3 × 4 values)",)


@pytest.mark.parametrize("unit", ["ms", "milliseconds"])
def test_a_time_in_another_unit_is_read_where_it_says_so_and_asked_for_where_not(tmp_path, unit):
    told = read_record(saved(tmp_path, time=column(1000 * TIME), units_time=unit, u=column(U)))
    assert told.sample_time == pytest.approx(0.01)
    assert read_record(
        saved(tmp_path, time_ms=column(1000 * TIME), u=column(U))
    ).sample_time == pytest.approx(0.01)
    untold = saved(tmp_path, time=column(1000 * TIME), u=column(U))
    with pytest.raises(
        BadRecord,
        match=r"nothing says the unit of 'time', whose steps are 10: .*sample_time=SECONDS",
    ):
        read_record(untold)
    assert read_record(untold, ReadOptions(sample_time=0.01)).sample_time == pytest.approx(0.01)


def test_a_scalar_that_contradicts_the_time_is_refused(tmp_path):
    file = saved(tmp_path, time=column(TIME), y=column(Y), Fs=1000.0)
    with pytest.raises(
        BadRecord,
        match=r"its time says 0\.01 s a sample, its scalar 0\.001 s; say sample_time=SECONDS",
    ):
        read_record(file)
    assert read_record(file, ReadOptions(sample_time=0.01)).sample_time == pytest.approx(0.01)


def test_the_rate_of_a_shaft_is_no_sampling_rate(tmp_path):
    with pytest.raises(BadRecord, match=r"does not say its sample time; say sample_time=SECONDS"):
        read_record(saved(tmp_path, bearing={"gs": Y, "rate": 25.0, "load": 270.0}))


@pytest.mark.parametrize(("unit", "step"), [("seconds", 0.5), ("minutes", 30.0)])
def test_identification_data_count_in_their_unit(tmp_path, unit, step):
    data = {"OutputData": column(Y), "InputData": column(U), "Ts": 0.5, "TimeUnit": unit}
    assert read_record(saved(tmp_path, z=data)).sample_time == pytest.approx(step)


@pytest.mark.parametrize("unit", ["fortnights", "samples"])
def test_a_sample_time_in_no_unit_of_time_is_refused(tmp_path, unit):
    file = saved(
        tmp_path, z={"OutputData": column(Y), "InputData": column(U), "Ts": 0.5, "TimeUnit": unit}
    )
    with pytest.raises(
        BadRecord, match=rf"'Ts' is in '{unit}', which is no unit of time; save it in seconds"
    ):
        read_record(file)


def test_scalars_that_contradict_each_other_are_refused(tmp_path):
    with pytest.raises(
        BadRecord,
        match=r"its scalars say several sample times \(dt 0\.01 s, fs 0\.001 s\); save one of them",
    ):
        read_record(saved(tmp_path, y=column(Y), dt=0.01, fs=1000.0))
    assert read_record(
        saved(tmp_path, y=column(Y), dt=0.01, fs=100.0)
    ).sample_time == pytest.approx(0.01)


def test_simulink_logs_are_read_by_their_labels(tmp_path):
    both = {"values": np.c_[U, Y], "dimensions": 2.0, "label": "<u>,<y>"}
    workspace = read_record(
        saved(
            tmp_path,
            simout={"time": column(TIME), "signals": both, "blockName": "model/To Workspace"},
        )
    )
    assert workspace.names == ("u", "y") and workspace.sample_time == pytest.approx(0.01)
    scope = {
        "time": column(TIME),
        "signals": log(("voltage", column(U)), ("speed", np.c_[Y, -Y])),
        "blockName": "model/Scope",
    }
    record = read_record(saved(tmp_path, ScopeData=scope))
    assert record.names == ("voltage", "speed_1", "speed_2")
    np.testing.assert_array_equal(record["speed_2"], -Y)


def test_what_cannot_be_told_apart_says_what_to_save_instead(tmp_path):
    with pytest.raises(
        BadRecord,
        match=r"the matrix data \(500 × 3\); save its columns under their names: time = data\(:,1\)",
    ):
        read_record(saved(tmp_path, data=np.c_[TIME, U, Y]))
    with pytest.raises(BadRecord, match=r"several times of 500 samples, .* save one file a time"):
        read_record(saved(tmp_path, t=column(TIME), tout=column(2 * TIME), y=column(Y)))
