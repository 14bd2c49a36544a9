"""The Grafana dashboard asks only for metrics and labels that the service has."""

import json
import re
from pathlib import Path

from prometheus_client.parser import text_string_to_metric_families

from residuum.service.metrics import Metrics

DASHBOARD = json.loads(
    (Path(__file__).parents[2] / "deploy" / "grafana" / "dashboards" / "service.json").read_text()
)
STATUS = {
    "sources": {"press can": {"samples_per_second": 1.0, "counters": {"lost": 0}}},
    "machines": {"press": {"windows_waiting": 0, "windows_dropped": 0, "scoring_errors": 0}},
}


def test_every_expression_names_metrics_and_labels_that_there_are():
    metrics = Metrics(lambda: STATUS)
    metrics.request("GET", "/", 200, 0.01)
    metrics.event("finding", {"asset": "press", "verdict": "healthy"})
    metrics.event("alarm", {"asset": "press", "state": "unacknowledged"})
    samples = [
        sample
        for family in text_string_to_metric_families(metrics.render().decode())
        for sample in family.samples
    ]
    labels = {}
    for sample in samples:
        labels.setdefault(sample.name, set()).update(sample.labels)
    expressions = [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]
    assert len(expressions) == len(DASHBOARD["panels"]) == 7
    for expression in expressions:
        (name,) = re.findall(r"residuum_\w+", expression)
        asked = set(re.findall(r"(\w+)=~?\"", expression))
        for group in re.findall(r"by \(([^)]*)\)", expression):
            asked |= set(re.split(r",\s*", group))
        assert name in labels and asked <= labels[name], expression
        for pattern in re.findall(r"name=~?\"([^\"]*)\"", expression):
            shown = {sample.labels["name"] for sample in samples if sample.name == name}
            assert any(re.fullmatch(pattern.replace("\\\\", "\\"), each) for each in shown), (
                expression
            )
