"""A YAML file is refused by its size before it is parsed, and by one line with its place after that."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from residuum.identification.errors import BadInput
from residuum.identification.physics.files.effect_file import read_effects
from residuum.identification.physics.files.model_file import load_model
from residuum.identification.record_formats.loggers.logger_mapping import read_mapping
from residuum.identification.yaml_text import LONGEST_TEXT, short_text, what_is_wrong

LINES = "".join(f"  p{k}: {{value: 1, unit: kg, lower: 0}}\n" for k in range(100_000))


@pytest.mark.parametrize("read", [load_model, read_effects, read_mapping])
def test_a_long_file_is_refused_before_it_is_parsed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: Callable[[Path], object]
) -> None:
    file = tmp_path / "long.yaml"
    file.write_text("name: long\nparameters:\n" + LINES)  # parsing it takes half a minute
    fetch, fetched = yaml.scanner.Scanner.fetch_more_tokens, []
    monkeypatch.setattr(
        yaml.scanner.Scanner,
        "fetch_more_tokens",
        lambda scanner: fetched.append(1) or fetch(scanner),
    )
    with pytest.raises(BadInput, match=r"at most|may have") as refused:
        read(file)
    assert not fetched
    yaml.safe_load("name: short")
    assert fetched, "the parser's steps are counted"
    assert "\n" not in str(refused.value)


def test_a_sparse_file_is_not_even_read(tmp_path: Path) -> None:
    file = tmp_path / "sparse.yaml"
    file.touch()
    os.truncate(file, 100 * LONGEST_TEXT)
    with pytest.raises(OSError, match=f"at most {LONGEST_TEXT}"):
        short_text(file)


def test_what_is_wrong_names_line_and_column() -> None:
    with pytest.raises(yaml.YAMLError) as caught:
        yaml.safe_load("host: [1\n")
    assert (
        what_is_wrong(caught.value)
        == "line 2, column 1: expected ',' or ']', but got '<stream end>'"
    )
