"""Diagnosers trained on their own examples."""

import copyreg
import pickle
from functools import cache
from types import MappingProxyType

import pytest

from residuum.diagnosis.diagnosers import DIAGNOSERS

copyreg.pickle(MappingProxyType, lambda view: (dict, (dict(view),)))


def train(file):
    """Train the diagnoser that the file is called after on one of its examples; pickled, since `save` is under test itself."""
    name, position = file.name.rsplit("-", 1)
    example = DIAGNOSERS[name].examples()[int(position)]
    file.write_bytes(pickle.dumps(DIAGNOSERS[name]().fit(example.training, example.labels)))


@pytest.fixture(scope="session")
def trained(made_once):
    """Gives a diagnoser trained on one of its examples: once, however many processes run these tests."""
    return cache(
        lambda name, position=0: pickle.loads(made_once(f"{name}-{position}", train).read_bytes())
    )
