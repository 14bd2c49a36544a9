"""Analyses as plain functions: they tell how far they are, end when whoever is told wants no more, and are called by jobs."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model_file import identified_text
from residuum.identification.record import Record
from residuum.library.model import model
from residuum.library.plant import identified
from residuum.library.questions.compare import Compare
from residuum.library.questions.control_design import DesignController
from residuum.library.questions.identify import Identify
from residuum.library.questions.missing_effect import Explain
from residuum.library.questions.residual import DesignResidual, RunResidual
from residuum.service.views import analyses
from residuum.service.views.analyses import Asked
from residuum.service.work.worker_pool import parts_of

ASKED = Identify(input="u", output="y", order=20, delay=1)


@pytest.fixture(scope="module")
def plant():
    u, e = np.random.default_rng(0).normal(size=(2, 400))
    return Record(
        {"u": u, "y": lfilter([0, 0.3], [1, -0.7], u) + 0.02 * e}, {"u": "V", "y": "V"}, 0.1
    )


@pytest.fixture(scope="module")
def axis():
    rng = np.random.default_rng(2)
    force = rng.normal(size=400) * 20
    velocity = np.cumsum(force) * 1e-3 / 95 + 1e-6 * rng.normal(size=400)
    return Record({"force": force, "velocity": velocity}, {"force": "N", "velocity": "m/s"}, 1e-3)


def told_by(work, *asked):
    told = []
    found = work(lambda share, doing: told.append((round(share, 6), doing)), *asked)
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and shares[0] == 0
    return told, found


def test_identifying_tells_how_far_it_is(plant):
    told, found = told_by(analyses.identify, [parts_of(plant, "a.csv")], ASKED)
    assert (0.1, "identifying from 400 samples") in told and told[-1][0] == 0.9
    assert found["result"]["impulse_response"][:3] == pytest.approx([0.3, 0.21, 0.147], abs=0.01)
    assert found["file"].decode().startswith('{"format"')


def test_explaining_tells_what_it_tries_and_names_the_record_as_it_is_told(axis):
    asked = Asked("linear-axis", None, [parts_of(axis, "record-7.npz")], {})
    told, found = told_by(analyses.explain, asked, Explain(effects=["coulomb-friction"]))
    doings = [doing for _, doing in told]
    assert told[-1] == (0.9, "comparing") and doings[:2] == [
        "explain",
        "estimating the model as it is",
    ]
    assert "beside nothing else" in doings
    assert (found["result"]["model"], found["result"]["records"]) == (
        "linear-axis",
        ["record-7.npz"],
    )


def test_every_run_is_a_part_of_the_residuals_work(plant):
    model = identified_text(identified([plant], ASKED, lambda *_: None).identified).encode()
    runs = [parts_of(plant, "a.csv"), parts_of(plant, "b.csv")]
    told, found = told_by(
        analyses.residuals, model, runs[:1], runs, DesignResidual(), RunResidual()
    )
    assert [share for share, _ in told] == pytest.approx([0, 1 / 3, 2 / 3], abs=1e-6)
    assert found["design"]["fault"] == "sensor" and [run["alarm"] for run in found["runs"]] == [
        False,
        False,
    ]


def test_a_design_that_cannot_be_is_an_answer(plant):
    model = identified_text(identified([plant], ASKED, lambda *_: None).identified).encode()
    impossible = DesignController(structure="pi", overshoot=1e-6, settling_time=1e-6, slack=1e-6)
    _, found = told_by(analyses.design_controller, ["press"], [model], None, impossible)
    assert found["result"]["feasible"] is False and found["result"]["reason"]
    assert found["result"]["models"] == ["press"]


def test_what_does_not_fit_is_refused_by_its_name(plant):
    asked = Asked("linear-axis", None, [parts_of(plant, "record-3.npz")], {})
    with pytest.raises(BadInput, match=r"record-3\.npz.*force"):
        analyses.compare(lambda *_: None, asked, Compare())


class Enough(Exception):
    """Whoever is told wants no more."""


def test_a_teller_that_raises_ends_the_work(axis):
    def stop(share, doing):
        if share > 0:
            raise Enough(doing)

    with pytest.raises(Enough):
        model("linear-axis").explain(axis, effects=["coulomb-friction"], progress=stop)
    with pytest.raises(Enough):
        model("linear-axis").improve(axis, add=["coulomb-friction"], progress=stop)
