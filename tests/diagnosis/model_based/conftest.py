"""An axis whose model lacks nothing, watched."""

import pytest

from residuum.diagnosis.diagnosers.model_based import ModelBased, _axis


@pytest.fixture(scope="session")
def complete_axis(made_once):
    return ModelBased.load(
        made_once("complete-axis.base", lambda file: ModelBased().fit([_axis(seed) for seed in range(12)]).save(file))
    )
