"""Monitors keep scikit-learn's conventions over windows."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.utils import estimator_checks
from sklearn.utils.validation import check_is_fitted

import residuum as rs
from residuum.diagnosis.diagnosers import DIAGNOSERS


@pytest.fixture(scope="module")
def monitor():
    return rs.monitor("robust-residual", order=60).fit(
        [rs.simulate("process-plant", seed=seed) for seed in (1, 2)]
    )


def test_parameters_are_got_set_and_cloned():
    monitor = rs.monitor("robust-residual", order=60)
    assert monitor.get_params()["settings"] == {"order": 60}
    copy = clone(monitor.set_params(diagnoser="bearing"))
    assert copy.get_params() == monitor.get_params() and copy is not monitor


def test_nothing_is_judged_before_fit():
    monitor = rs.monitor("robust-residual")
    window = rs.simulate("process-plant", seed=1)
    with pytest.raises(NotFittedError):
        check_is_fitted(monitor)
    with pytest.raises(rs.BadInput, match="is not fitted; give it healthy records with fit"):
        monitor.predict(window)


def test_faults_are_outliers_and_a_short_window_is_neither(monitor):
    healthy = rs.simulate("process-plant", seed=5)
    faulty = rs.simulate("process-plant", faults={"sensor-offset": None}, seed=6)
    short = healthy.window(0, 30)
    windows = [healthy, faulty, short]
    assert monitor.predict(windows).tolist() == [1, -1, 0]
    normal, strange, unknown = monitor.score_samples(windows)
    assert normal > -1.0 > strange and np.isnan(unknown)
    np.testing.assert_allclose(monitor.decision_function([healthy]), [normal + 1.0])
    check_is_fitted(monitor)


def test_a_finding_is_the_contract_s_and_its_features_go_on(monitor):
    finding = monitor.score(rs.simulate("process-plant", faults={"sensor-offset": None}, seed=6))
    answer = finding.to_dict()
    assert {
        "diagnoser",
        "verdict",
        "class",
        "indicators",
        "thresholds",
        "evidence",
        "reason",
    } <= set(answer)
    assert (finding.verdict, finding.fault_class) == ("faulty", answer["class"])
    assert str(finding).startswith("robust-residual: faulty") and "<svg" in finding._repr_html_()
    assert list(finding.plot().data[0].x) == list(answer["thresholds"])
    features = monitor.indicators([rs.simulate("process-plant", seed=seed) for seed in (7, 8)])
    assert features.shape[0] == 2 and "glr" in features


def test_every_diagnoser_can_be_a_monitor_by_its_id():
    for name, kind in DIAGNOSERS.items():
        try:
            kind()
        except TypeError:
            continue  # one that needs a model
        example = kind.examples()[0]
        monitor = rs.monitor(name).fit(list(example.training), example.labels)
        assert monitor.score(example.faulty[0]).to_dict()["diagnoser"] == name
    with pytest.raises(rs.BadInput, match="diagnoser 'nobody': there is none of this name"):
        rs.monitor("nobody").fit(rs.simulate("process-plant", seed=1))
    with pytest.raises(rs.BadInput, match="colour 'red': not a setting of bearing"):
        rs.monitor("bearing", colour="red").fit(rs.simulate("process-plant", seed=1))


def test_a_model_watches_columns_of_other_names():
    record = rs.simulate("linear-axis", duration=20.0, seed=1).rename({"force": "F_motor"})
    monitor = rs.monitor(rs.model("linear-axis"), map={"force": "F_motor"}).fit(record)
    answer = monitor.score(record.window(0, record.n // 2)).to_dict()
    assert (
        answer["verdict"] in ("healthy", "faulty", "not-assessable")
        and answer["diagnoser"] != "robust-residual"
    )
    with pytest.raises(rs.BadRecord, match="F_motor"):
        monitor.score(record.rename({"F_motor": "other"}))


@pytest.mark.parametrize(
    "name",
    [
        "check_no_attributes_set_in_init",
        "check_parameters_default_constructible",
        "check_get_params_invariance",
        "check_set_params",
        "check_estimator_repr",
        "check_estimator_cloneable",
        "check_mixin_order",
        "check_estimator_tags_renamed",
        "check_valid_tag_types",
    ],
)
def test_scikit_learns_checks_hold_where_a_sample_need_not_be_a_row_of_numbers(name):
    """The other checks of `check_estimator` hand over arrays; a monitor's sample is a record."""
    getattr(estimator_checks, name)("Monitor", rs.Monitor())


def test_an_array_is_refused_with_the_way_to_a_record():
    with pytest.raises(rs.BadRecord, match="from_arrays"):
        rs.monitor("robust-residual").fit(np.zeros((3, 2)))
