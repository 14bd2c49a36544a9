"""Work is counted, not timed: by samples and fits, the same side by side as one after the other."""

import pytest

from residuum.identification.physics import estimate, load_model, match
from residuum.identification.record import Record
from residuum.identification.side_by_side import beside, each_beside, side_by_side
from residuum.identification.work import (
    FIT_COST,
    OutOfWork,
    at_most,
    begun,
    count_fit,
    count_samples,
    go_on,
    left_out,
)
from residuum.simulation import MACHINES


def test_nothing_bounds_what_nobody_counts():
    count_samples(10**15)
    count_fit()
    go_on()
    assert begun().effort == 0


def test_a_part_ends_with_the_whole_and_is_added_to_it():
    with at_most(effort=1000) as whole:
        count_samples(600)
        with at_most(effort=5000) as part:
            count_samples(400)
            go_on()
            count_samples(1)
            with pytest.raises(OutOfWork):
                go_on()
        assert part.samples == 401
        assert whole.samples == 1001


def test_a_part_that_is_out_of_work_leaves_the_whole_its_own():
    with at_most(effort=1000) as whole:
        with pytest.raises(OutOfWork), at_most(effort=10):
            count_samples(11)
            left_out("the rest of the part")
            go_on()
        go_on()
        assert (whole.samples, whole.not_tried, whole.timed_out) == (
            11,
            ["the rest of the part"],
            False,
        )


def test_a_fit_costs_samples_of_its_own():
    with at_most(effort=2 * FIT_COST) as work:
        count_fit()
        count_fit()
        go_on()
        count_fit()
        with pytest.raises(OutOfWork):
            go_on()
    assert (work.fits, work.samples) == (3, 0)


def test_seconds_that_a_user_gave_are_told():
    with at_most(seconds=0.0) as work, pytest.raises(OutOfWork):
        go_on()
    assert work.timed_out


def _costly(samples: int) -> int:
    count_samples(samples)
    return samples


@pytest.mark.parametrize("processors", [1, 2, 64])
def test_what_is_begun_does_not_depend_on_the_processors(monkeypatch, processors):
    monkeypatch.setattr("os.cpu_count", lambda: processors)
    items, done = list(range(100, 140)), []

    def one(samples: int) -> None:
        done.append(_costly(samples))

    with at_most(effort=2000) as work, pytest.raises(OutOfWork):
        side_by_side(one, items)
    assert sorted(done) == items[:24]
    assert work.samples == sum(items[:24])


def test_pieces_are_told_in_their_order():
    def one(name: str) -> str:
        left_out(name)
        return _costly(1) * name

    with at_most() as work:
        assert each_beside(one, list("abcdefghijklm")) == list("abcdefghijklm")
    assert (work.not_tried, work.samples) == (list("abcdefghijklm"), 13)


def test_what_runs_beside_is_counted_when_it_is_waited_for():
    with at_most() as work:
        waiting = beside(lambda: _costly(7))
        count_samples(5)
        assert waiting() == 7
    assert work.samples == 12


def test_an_estimation_counts_the_steps_and_the_values_it_is_differentiated_by():
    signals = MACHINES["gate-drive"](seed=3, rate=500.0).simulate(2.0)
    model, experiments = match(
        load_model("gate-drive"), [Record(signals.channels, signals.units, signals.sample_time)]
    )
    with at_most() as whole:
        estimate(model, experiments)
    with at_most() as one:
        estimate(model, experiments, free=())
    samples = experiments[0].n
    assert (whole.fits, one.fits) == (1, 1)
    assert one.samples >= samples
    assert whole.samples > one.samples + len(model.free) * samples
