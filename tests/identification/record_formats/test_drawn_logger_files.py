"""Two hundred logger files, their habits drawn and not told to the reader: none is read wrong, nine of ten are read."""

import tempfile
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from residuum.identification.errors import BadInput
from residuum.identification.record_formats import ReadOptions, read_record
from residuum.identification.units import convert

START = datetime(2024, 3, 27, 21, 58, 50, tzinfo=UTC)
"""A day that is no month, shortly before the hour's end."""
TIME_NAMES = ("time", "Time", "t", "Zeit", "elapsed time", "Timestamp")
PER_UNIT = {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "us": 1e-6}
NAMES = [
    "speed",
    "Drehzahl",
    "Kraft x",
    "p1",
    "Öltemperatur",
    "U_Motor",
    "torque-2",
    "Sensor #3",
    "Valve open",
    "n (left)",
]
UNITS = ["rpm", "V", "N", "bar", "°C", "m/s²", "Nm", "%", "mA", "kPa", "mm/s", ""]
STAMPS = {
    "iso": "%Y-%m-%d %H:%M:%S.%f",
    "iso T": "%Y-%m-%dT%H:%M:%S.%fZ",
    "german": "%d.%m.%Y %H:%M:%S.%f",
    "american": "%m/%d/%Y %I:%M:%S.%f %p",
    "month": "%d-%b-%Y %H:%M:%S.%f",
    "year first": "%Y/%m/%d %H:%M:%S.%f",
    "clock": "%H:%M:%S.%f",
}


@dataclass(frozen=True)
class Drawn:
    """A file, and what it truly holds: values by name on `time`, NaN for what is missing; `absolute` if it has dates."""

    content: bytes
    ending: str
    time: np.ndarray
    step: float
    values: dict[str, np.ndarray]
    units: dict[str, str]
    rows_lost: bool
    absolute: bool


def stamp(form, k, step):
    at = START + timedelta(microseconds=round(1e6 * k * step))
    whole, _, fraction = (
        f"{at:{STAMPS[form]}}".partition(".") if "german" not in form else _german(at)
    )
    return f"{whole}.{fraction[:3]}{fraction[6:]}"


def _german(at):
    return f"{at:%d.%m.%Y %H:%M:%S}", ".", f"{at:%f}"


@st.composite
def drawn_file(draw):
    n, step = (
        draw(st.integers(24, 60)),
        draw(st.sampled_from([0.001, 0.02, 0.1, 0.25, 0.5, 1.0, 2.0, 10.0, 60.0])),
    )
    cut = draw(st.sampled_from([";", ",", "\t", "|", " "]))
    decimal = draw(st.sampled_from([".", ","])) if cut not in (",",) else "."
    names = draw(
        st.lists(
            st.sampled_from(NAMES if cut != " " else ["speed", "p1", "U_Motor", "Drehzahl"]),
            min_size=1,
            max_size=4,
            unique=True,
        )
    )
    units = [draw(st.sampled_from(UNITS)) for _ in names]
    digits, seed = draw(st.sampled_from([1, 2, 4, 5, 6])), draw(st.integers(0, 10**6))
    size = draw(st.sampled_from([0.5, 30.0, 4000.0, 2e6]))
    values = np.round(
        size * np.cumsum(np.random.default_rng(seed).normal(size=(len(names), n)), axis=1) / 5,
        digits,
    )
    hole = draw(st.sampled_from(["", "", "NaN", "---", "n/a"] if cut != " " else ["NaN", "---"]))
    if draw(st.booleans()):
        values[draw(st.integers(0, len(names) - 1)), draw(st.integers(2, n - 3)) :: 7] = np.nan
    form = draw(
        st.sampled_from(
            [*PER_UNIT, *PER_UNIT, "epoch ms", "epoch s", *STAMPS, "date and time"]
            if cut != " "
            else [*PER_UNIT]
        )
    )
    kept = np.arange(n)
    if draw(st.integers(0, 4)) == 0:
        begin = draw(st.integers(5, n - 12))
        kept = np.delete(kept, np.arange(begin, begin + draw(st.integers(1, 5))))
    exponent = draw(st.integers(0, 7)) == 0
    put = f"{{:.{digits + 2}e}}" if exponent else f"{{:.{digits}f}}"
    values = np.array([[float(put.format(value)) for value in row] for row in values])

    def cell(value):
        if np.isnan(value):
            return hole
        text = put.format(value)
        if grouped and not exponent:
            return f"{value:,.{digits}f}" if decimal == "." else _swapped(value, digits)
        return text.replace(".", decimal)

    grouped = cut in (";", "\t", "|") and draw(st.integers(0, 7)) == 0

    times, heads = times_of(form, n, step, decimal)
    if len(heads) == 1 and not form.startswith("epoch"):
        heads = [(draw(st.sampled_from(TIME_NAMES if cut != " " else TIME_NAMES[:4])), heads[0][1])]
    style = draw(st.sampled_from(["[]", "()", "row", "row ()"] if cut != " " else ["[]"]))
    place = (
        draw(st.sampled_from([0, 0, 0, len(names)])) if form in PER_UNIT or form in STAMPS else 0
    )
    return written(draw, locals())


def _swapped(value, digits):
    return f"{value:,.{digits}f}".translate(str.maketrans(",.", ".,"))


def times_of(form, n, step, decimal):
    """(cells of each time column, their (name, unit))."""
    k = np.arange(n)
    if form in PER_UNIT:
        exact = [f"{i * step / PER_UNIT[form]:.9f}".rstrip("0").rstrip(".") or "0" for i in k]
        return [[text.replace(".", decimal) for text in exact]], [("time", form)]
    if form.startswith("epoch"):
        per = 1000 if form.endswith("ms") else 1
        exact = [f"{(START.timestamp() + i * step) * per:.{0 if per == 1000 else 3}f}" for i in k]
        return [[text.replace(".", decimal) for text in exact]], [("timestamp", "")]
    if form == "date and time":
        days = [f"{START + timedelta(microseconds=round(1e6 * i * step)):%d.%m.%Y}" for i in k]
        return [days, [stamp("clock", i, step) for i in k]], [("Datum", ""), ("Uhrzeit", "")]
    return [[stamp(form, i, step) for i in k]], [("Time", "")]


def written(draw, of):
    """The bytes of the file whose habits were drawn."""
    cut, n, style, place = of["cut"], of["n"], of["style"], of["place"]
    named = list(zip(of["names"], of["units"], strict=True))
    named = [*named[:place], *of["heads"], *named[place:]]
    columns = [[of["cell"](value) for value in row] for row in of["values"]]
    columns = [*columns[:place], *of["times"], *columns[place:]]
    put = {"[]": "{} [{}]", "()": "{} ({})", "row": "{}", "row ()": "{}"}[style]
    if cut == " ":
        put = "{}[{}]"
    head = [put.format(name, unit) if unit else name for name, unit in named]
    lines = [cut.join(head)]
    if style.startswith("row"):
        lines.append(
            cut.join(f"({unit})" if style == "row ()" and unit else unit for _, unit in named)
        )
    quoted = cut != " " and draw(st.integers(0, 5)) == 0
    rows = [[column[k] for column in columns] for k in of["kept"]]
    lines += [cut.join(f'"{cell}"' for cell in row) if quoted else cut.join(row) for row in rows]
    before = draw(
        st.lists(
            st.sampled_from(
                ["# bench 7", "Device: logger 12", "", "Operator Miller", "Serial 4711-B"]
            ),
            max_size=3,
        )
    )
    if cut != " " and draw(st.integers(0, 5)) == 0:
        lines = [line + cut for line in lines]
    after = (
        [""]
        if draw(st.integers(0, 19))
        else draw(st.sampled_from([["", ""], ["# end"], ["End of measurement"]]))
    )
    text = draw(st.sampled_from(["\n", "\r\n"])).join([*before, *lines, *after])
    encoding = draw(st.sampled_from(["utf-8", "utf-8", "utf-8-sig", "cp1252", "utf-16"]))
    lost = len(of["kept"]) < n
    time = np.arange(n) * of["step"]
    truth = {
        name: np.where(np.isin(np.arange(n), of["kept"]), row, np.nan)
        for name, row in zip(of["names"], of["values"], strict=True)
    }
    clock_only = of["form"] in PER_UNIT or of["form"] == "clock"
    ending = draw(st.sampled_from([".csv", ".txt", ".dat"]))
    return Drawn(
        text.encode(encoding),
        ending,
        time,
        of["step"],
        truth,
        dict(zip(of["names"], of["units"], strict=True)),
        lost,
        not clock_only,
    )


def outcome(drawn):
    """What became of a file: `read`, or the refusal; AssertionError for one that is read wrong."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"log{drawn.ending}"
        file.write_bytes(drawn.content)
        try:
            record = read_record(file, ReadOptions(resample=drawn.rows_lost))
        except BadInput as error:
            assert "\n" not in str(error)
            return str(error).replace(str(file), "log")
    assert set(record.names) == set(drawn.values)
    assert record.sample_time == pytest.approx(drawn.step, rel=2e-3)
    if drawn.absolute:
        assert record.t0 == pytest.approx(START.timestamp(), abs=1e-3)
    for name, values in drawn.values.items():
        np.testing.assert_allclose(record[name], values[: record.n], rtol=1e-4, atol=1e-9)
        assert not (~np.isnan(values[record.n :])).any()
        given_unit, true_unit = record.units[name], drawn.units[name]
        assert bool(given_unit) == bool(true_unit)
        if true_unit:
            assert float(convert(1.0, given_unit, true_unit)) == pytest.approx(1.0)
    return "read"


def test_drawn_files_are_read_right_or_refused():
    found = []

    @settings(
        max_examples=200,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(drawn_file())
    def read(drawn):
        found.append(outcome(drawn))

    read()
    refused = [says for says in found if says != "read"]
    assert len(found) >= 200 and len(refused) <= 0.1 * len(found), refused
