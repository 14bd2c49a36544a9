"""The source's methods and ours: either decides, both are in every finding."""

import numpy as np
import pytest

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import NotTrained
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.finding import Verdict
from residuum.diagnosis.thresholds.threshold import bounds, source_threshold
from residuum.identification.errors import BadInput


@pytest.fixture(scope="module")
def gate():
    case = GateActuator.examples()[0]
    return GateActuator().fit(case.training, case.labels), case


@pytest.fixture(scope="module")
def residual():
    case = RobustResidual.examples()[0]
    return RobustResidual().fit(case.training), case


def test_the_support_vector_machine_decides_for_the_gate(gate):
    trained, case = gate
    # A classifier that is wrong on purpose: what it says must be the verdict by the source's method and by it alone.
    spoiled = trained.with_settings(method="source")
    labels = np.array(["rack", "healthy", "pinion-or-gear"])
    X = np.array([[0.0, 0.0], [1e6, 1e6], [-1e6, 1e6]])
    trained.baseline.source.fit(X, labels)
    record = case.healthy[0]
    by_source, by_default = spoiled.score(record), trained.score(record)
    assert (by_source.verdict, by_source.fault_class) == (Verdict.FAULTY, "rack")
    assert by_default.verdict is Verdict.HEALTHY
    assert by_source.evidence["method"] == "source"
    for finding in (by_source, by_default):
        assert finding.evidence["source_method"]["class"] == "rack"
        assert finding.evidence["default_method"]["verdict"] == "healthy"
    assert "linear SVM" in by_source.reason


def test_a_gate_trained_on_healthy_movements_has_no_classifier(tmp_path):
    case = GateActuator.examples()[1]
    trained = GateActuator().fit(case.training)
    assert "needs faults too" in trained.score(case.healthy[0]).evidence["source_method"]["reason"]
    with pytest.raises(NotTrained, match="train it with labels"):
        trained.with_settings(method="source").score(case.healthy[0])


def test_algorithm_6_decides_for_the_robust_residual(residual):
    trained, case = residual
    by_source = trained.with_settings(method="source")
    record = case.faulty[0]
    finding = by_source.score(record)
    limit = source_threshold(trained.design, *bounds(trained.design, record["u"])).typical
    signals, bank = trained.stream().process(record["u"], record["y"])
    largest = np.abs(signals.robust[signals.valid]).max()
    assert finding.indicators["robust_peak"] == pytest.approx(largest)
    assert finding.thresholds == {"robust_peak": pytest.approx(limit)}
    assert (finding.verdict is Verdict.FAULTY) == (largest > limit)
    assert finding.evidence["default_method"]["value"] == pytest.approx(bank.statistic.max())
    # Without the post-filter another residual would be judged: the verdict rests on Q.
    assert not np.allclose(signals.robust, signals.primary)


def test_the_two_methods_differ_where_the_source_sees_nothing(residual):
    """Drifts and lost gains stay below a threshold made for the largest input; an offset of ten deviations does not."""
    trained, case = residual
    by_source = trained.with_settings(method="source")
    ours = [trained.score(record).verdict for record in case.faulty]
    theirs = [by_source.score(record).verdict for record in case.faulty]
    assert ours == [Verdict.FAULTY] * 4
    assert Verdict.HEALTHY in theirs
    assert all(by_source.score(record).verdict is Verdict.HEALTHY for record in case.healthy)


@pytest.mark.parametrize("name", ["gate-actuator", "robust-residual"])
def test_the_method_is_stored_with_the_baseline(name, tmp_path, request):
    trained, _ = request.getfixturevalue("gate" if name == "gate-actuator" else "residual")
    trained.with_settings(method="source").save(tmp_path / "a")
    loaded = DIAGNOSERS[name].load(tmp_path / "a")
    assert loaded.method == "source"
    assert loaded.with_settings(method="default").method == "default"
    assert loaded.describe()["methods"] == ["default", "source"]


@pytest.mark.parametrize("name", list(DIAGNOSERS))
def test_an_unknown_method_is_refused(name):
    with pytest.raises(BadInput, match="method 'better': must be default"):
        DIAGNOSERS[name]().with_settings(method="better")
