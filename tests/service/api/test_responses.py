"""Findings leave as what `Finding.to_json` says of them, whatever their evidence holds."""

import json

import numpy as np

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.finding import Finding, Verdict
from residuum.service.api.responses import Json, finding_json


def test_the_finding_of_a_diagnoser_is_what_its_plain_copy_is():
    bearing = DIAGNOSERS["bearing"]
    finding = bearing().score(bearing.examples()[0].faulty[0])
    assert finding.verdict is Verdict.FAULTY
    assert finding_json(finding).body == Json(finding.to_json()).body


def test_every_kind_of_evidence_is_json():
    evidence = {
        "array": np.arange(6.0).reshape(2, 3)[:, ::2],
        "numbers": (
            np.float32(0.5),
            np.int64(7),
            np.bool_(True),
            float("nan"),
            -float("inf"),
            np.float64("nan"),
        ),
        "nested": {"text": np.str_("a"), "verdict": Verdict.FAULTY, "none": None},
    }
    finding = Finding(
        "bearing",
        "faulty",
        "cage",
        {"rms": float("inf")},
        {"rms": np.float64(2.0)},
        {"rms": "g"},
        evidence,
        "é",
    )
    answer = finding_json(finding)
    assert json.loads(answer.body) == json.loads(Json(finding.to_json()).body)
    assert answer.headers["content-type"] == Json({}).headers["content-type"]
