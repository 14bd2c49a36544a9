"""A balance that no input drives has no share of what drives it; none is printed."""

from types import SimpleNamespace

import pytest

from residuum.library.answers.comparison import comparison_text


@pytest.mark.parametrize(
    ("share", "says"), [(float("nan"), "0.2 N RMS"), (12.0, "0.2 N RMS, 12.0 % of what drives it")]
)
def test_a_share_of_nothing_is_not_printed(share, says):
    balance = SimpleNamespace(unit="N", missing_rms=0.2, relative_percent=share)
    found = {
        "structured": {},
        "present": False,
        "p_value": 0.5,
        "share": 0.0,
        "where": [],
        "warnings": (),
        "not_recorded": (),
    }
    comparison = SimpleNamespace(
        records=("a.csv",), outputs={}, balances={"ball": balance}, **found
    )
    assert f"balance ball: missing term of {says}" in comparison_text(comparison).splitlines()
