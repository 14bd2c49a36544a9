"""An axis whose model lacks nothing, watched."""

import pytest


@pytest.fixture(scope="session")
def complete_axis(trained):
    return trained("model-based")
