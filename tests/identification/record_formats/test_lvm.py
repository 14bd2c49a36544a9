"""LabVIEW measurement files: the head says how to read them, with times in a column or without."""

import numpy as np
import pytest

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats import ReadOptions, read_record

N = 200
FORCE = np.round(np.sign(np.sin(0.1 * np.arange(N) + 0.05)), 6)
SPEED = np.round(np.cos(0.03 * np.arange(N)), 6)


def measurement(x="No", cut="\t", decimal=",", comments=(), n=N, times=None):
    def said(value):
        return f"{value:.6f}".replace(".", decimal)

    name = {"\t": "Tab", ",": "Comma", ";": "Semicolon"}[cut]
    head = [
        "LabVIEW Measurement",
        "Writer_Version\t2",
        f"Separator\t{name}",
        f"Decimal_Separator\t{decimal}",
        f"X_Columns\t{x}",
    ]
    head = [
        line.replace("\t", cut)
        for line in [*head, "Time_Pref\tAbsolute", "***End_of_Header***", ""]
    ]
    segment = [
        ("Channels", "2"),
        ("Samples", n, n),
        ("Y_Unit_Label", "Newtons", "m/s"),
        ("X_Dimension", "Time", "Time"),
    ]
    segment += [
        ("X0", said(0.5), said(0.5)),
        ("Delta_X", said(0.001), said(0.001)),
        ("***End_of_Header***", "", ""),
    ]
    names = (
        ("X_Value", "force", "X_Value", "speed") if x == "Multi" else ("X_Value", "force", "speed")
    )
    lines = [
        *head,
        *(cut.join(map(str, cells)) for cells in segment),
        cut.join((*names, "Comment")),
    ]
    for k in range(n):
        at = said(0.5 + 0.001 * k if times is None else times[k])
        own = {"No": ("",), "One": (at,), "Multi": (at,)}[x]
        second = (at,) if x == "Multi" else ()
        cells = (
            *own,
            said(FORCE[k]),
            *second,
            said(SPEED[k]),
            *((comments[k],) if k < len(comments) else ()),
        )
        lines.append(cut.join(cells))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("x", ["No", "One", "Multi"])
@pytest.mark.parametrize(("cut", "decimal"), [("\t", ","), ("\t", "."), (",", "."), (";", ",")])
def test_the_head_says_how_to_read(tmp_path, x, cut, decimal):
    (tmp_path / "r.lvm").write_text(measurement(x, cut, decimal))
    record = read_record(tmp_path / "r.lvm")
    assert (
        record.n == N
        and record.sample_time == pytest.approx(0.001)
        and record.t0 == pytest.approx(0.5)
    )
    assert dict(record.units) == {"force": "Newtons", "speed": "m/s"} and record.notes == ()
    np.testing.assert_allclose(record["speed"], SPEED)
    np.testing.assert_allclose(record.in_unit("force", "N"), FORCE)


def test_comments_are_named_and_left_out(tmp_path):
    (tmp_path / "r.lvm").write_text(measurement("One", comments=("OK", "", "LOST")))
    record = read_record(tmp_path / "r.lvm")
    assert record.names == ("force", "speed") and record.notes == ("not read: Comment (text)",)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-32", "cp1252"])
def test_the_head_is_understood_in_any_encoding(tmp_path, encoding):
    (tmp_path / "r.lvm").write_bytes(measurement().replace("m/s", "µm/s").encode(encoding))
    record = read_record(tmp_path / "r.lvm")
    assert (
        record.n == N
        and record.sample_time == pytest.approx(0.001)
        and record.units["speed"] == "µm/s"
    )


def test_uneven_times_are_refused_and_resampled_on_request(tmp_path):
    times = 0.001 * np.arange(N) + 0.0004 * np.sin(np.arange(N))
    (tmp_path / "r.lvm").write_text(measurement("One", times=times))
    with pytest.raises(BadRecord, match="resample=True"):
        read_record(tmp_path / "r.lvm")
    assert read_record(tmp_path / "r.lvm", ReadOptions(resample=True)).n > 150


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text + text, r"has 3 segments; one is read, save one file a segment"),
        (
            lambda text: text.replace("Channels\t2", "Channels\t9"),
            r"row 17: 3 cells; its head says 10",
        ),
        (
            lambda text: text.replace("\t-1,000000", "\tlost", 1),
            r"holds a cell that is no number with decimal sign ','",
        ),
        (
            lambda text: text.replace("X0\t0,500000", "X0\tabout 0"),
            r"X0 of channel 1 is 'about 0', no number with decimal sign ','",
        ),
        (
            lambda text: text.replace("Delta_X\t0,001000", "Delta_X\t1 ms"),
            r"Delta_X of channel 1 is '1 ms', no number",
        ),
        (
            lambda text: text.replace("Separator\tTab", "Separator\tPipe", 1),
            r"separator 'Pipe'; it must be one of tab, comma",
        ),
        (
            lambda text: text.replace("X_Columns\tNo", "X_Columns\tTwo"),
            r"X_Columns 'two'; it must be one of no, one, multi",
        ),
    ],
)
def test_what_contradicts_the_head_is_refused(tmp_path, change, says):
    (tmp_path / "r.lvm").write_text(change(measurement()))
    with pytest.raises(BadRecord, match=says):
        read_record(tmp_path / "r.lvm")
