"""Stored diagnosers: what goes in comes out, and foreign or hostile files are refused with one line."""

import io
import json
import zipfile

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from residuum.diagnosis.learning.stored import load_stored, save_stored, stored_kind
from residuum.identification.errors import BadInput


@pytest.fixture
def trained():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(40, 2)) + np.repeat([[0.0, 0.0], [3.0, 3.0]], 20, axis=0)
    return make_pipeline(StandardScaler(), SVC(kernel="linear")).fit(
        x, np.repeat(["a", "b"], 20)
    ), x


def test_everything_comes_back(tmp_path, trained):
    svm, x = trained
    arrays = {
        "a": np.arange(6.0).reshape(2, 3),
        "scalar": np.float64(2.5),
        "mask": np.array([True, False]),
    }
    save_stored(tmp_path / "m", "gate-actuator", 3, {"rate": 5000.0}, arrays, {"svm": svm})
    stored = load_stored(tmp_path / "m", "gate-actuator")
    assert (stored.version, stored.meta) == (3, {"rate": 5000.0})
    assert np.array_equal(stored.arrays["a"], arrays["a"]) and stored.arrays["mask"].dtype == bool
    assert np.array_equal(stored.estimators["svm"].decision_function(x), svm.decision_function(x))


def test_failed_write_leaves_the_old_file(tmp_path):
    save_stored(tmp_path / "m", "bearing", 1, {"old": True})
    with pytest.raises(ValueError, match="Object arrays"):
        save_stored(tmp_path / "m", "bearing", 1, {}, {"bad": np.array([{}], dtype=object)})
    assert load_stored(tmp_path / "m", "bearing").meta == {"old": True}
    assert [path.name for path in tmp_path.iterdir()] == ["m"]


def test_other_kind_and_foreign_files_are_refused(tmp_path):
    save_stored(tmp_path / "m", "bearing", 1, {})
    with pytest.raises(BadInput, match="holds a 'bearing' diagnoser; 'gate-actuator' is needed"):
        load_stored(tmp_path / "m", "gate-actuator")
    (tmp_path / "text").write_text("time [s],a [m/s²]\n")
    np.savez(tmp_path / "arrays.npz", a=np.arange(3))
    for name in ("text", "arrays.npz"):
        with pytest.raises(BadInput, match="is not a stored diagnoser"):
            load_stored(tmp_path / name, "bearing")
    with pytest.raises(BadInput, match="no such file"):
        load_stored(tmp_path / "absent", "bearing")


def test_a_header_larger_than_the_member_is_refused_before_allocation(tmp_path):
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)}
    )
    with zipfile.ZipFile(tmp_path / "m", "w") as archive:
        archive.writestr(
            "header.json",
            json.dumps(
                {"format": "residuum-diagnoser", "kind": "bearing", "version": 1, "meta": {}}
            ),
        )
        archive.writestr("arrays/a.npy", buffer.getvalue())
    with pytest.raises(BadInput, match="which the member does not hold"):
        load_stored(tmp_path / "m", "bearing")


def test_archives_that_cannot_be_unpacked_are_no_stored_diagnosers(tmp_path):
    save_stored(tmp_path / "m", "bearing", 1, {"rate": 1.0})
    whole = bytearray((tmp_path / "m").read_bytes())
    encrypted, central = bytearray(whole), whole.index(b"PK\x01\x02")
    encrypted[6] |= 1
    encrypted[central + 8] |= 1
    (tmp_path / "encrypted").write_bytes(encrypted)
    assert stored_kind(tmp_path / "m") == "bearing" and stored_kind(tmp_path / "encrypted") is None
    with pytest.raises(BadInput, match="is not a stored diagnoser"):
        load_stored(tmp_path / "encrypted", "bearing")
