"""Models that engineers published go in as they stand; all of them in benchmarks."""

import pytest

from benchmarks.published_equations import PLANTS
from benchmarks.published_models import AGREEMENT, FILES, difference, model_of
from residuum.identification.physics import Key, candidates


@pytest.mark.parametrize("name", ["battery-cell", "quadruple-tank"])
def test_a_published_model_simulates_as_its_equations_do(name):
    assert difference(name) < AGREEMENT


def test_each_file_is_read_and_may_lack_what_its_machine_hides():
    assert {path.stem for path in FILES.glob("*.yaml")} == set(PLANTS)
    for name, plant in PLANTS.items():
        assert Key(*plant.hidden.split("@")) in candidates(model_of(name))
