"""Headers of .npy arrays: what NumPy writes is read as it was, what a stranger writes is refused without an allocation."""

import io
import tracemalloc

import numpy as np
import pytest

from residuum.identification.npy_header import LongHeader, NotNpy, npy_header


def written(array, version=None):
    file = io.BytesIO()
    np.lib.format.write_array(file, array, version=version)
    return file.getvalue()


@pytest.mark.parametrize("version", [(1, 0), (2, 0)])
@pytest.mark.parametrize(
    "array",
    [np.zeros((3, 5), order="F"), np.arange(7, dtype=">i2"), np.array("units"), np.float32(1)],
)
def test_what_numpy_writes_is_read_as_it_was(array, version):
    array = np.asanyarray(array)
    data = written(array, version)
    header = npy_header(data)
    assert (header.dtype, header.shape, header.size) == (array.dtype, array.shape, array.nbytes)
    order = "F" if header.fortran_order else "C"
    read = np.ndarray(header.shape, header.dtype, data, header.start, order=order)
    assert np.array_equal(read, array)


def declaring(text):
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"PK\x03\x04" + bytes(20), "is not an .npy array"),
        (written(np.zeros(9))[:40], "ends inside"),
        (declaring(b"{'descr': '<f8', 'fortran_order': False, 'shape': (-2, -4), }"), "negative"),
        (
            declaring(b"{'descr': '<f8', 'fortran_order': __import__('os'), 'shape': (8,), }"),
            "only plain",
        ),
        (declaring(b"-" * 1000 + b"1"), "only plain"),
        (b"\x93NUMPY\x09\x00" + written(np.zeros(2))[8:], "ends inside|header of|only plain"),
    ],
)
def test_what_is_no_plain_array_is_refused(data, says):
    with pytest.raises(NotNpy, match=says):
        npy_header(data)


def test_a_long_header_is_refused_by_its_length_alone():
    with pytest.raises(LongHeader, match="2147483648 bytes; at most 1024"):
        npy_header(b"\x93NUMPY\x02\x00" + (2**31).to_bytes(4, "little") + bytes(64))


def test_a_giant_shape_costs_nothing():
    data = declaring(
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (4294967296, 4294967296), }"
    )
    tracemalloc.start()
    size = npy_header(data).size
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert size == 2**67 and most < 1e6
