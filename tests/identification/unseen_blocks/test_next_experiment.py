"""What to measure next: a machine that was driven one way only is to be driven both ways."""

import numpy as np
import pytest

from residuum.identification.physics import load_model, match
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.next_experiment import distinguishing


@pytest.mark.parametrize(("least", "both_ways"), [(30.0, True), (-30.0, False)])
def test_only_an_input_that_kept_one_sign_is_to_be_reversed(least, both_ways):
    force = np.linspace(least, 90.0, 200)
    record = Record({"force": force, "velocity": np.zeros(200)}, {"force": "N", "velocity": "m/s"}, 0.01)
    model, experiments = match(load_model("linear-axis"), [record])
    lowest = {}

    def power(tried, _only):
        lowest[len(lowest)] = float(tried[0].U.min())
        return 0.5 - tried[0].U.min() / 1000.0  # most for what goes furthest back

    best = distinguishing(("a", "b"), model, experiments, power)[0]
    assert ("both ways" in best.do) is both_ways
    assert (min(lowest.values()) == pytest.approx(-90.0, rel=0.02)) is both_ways
