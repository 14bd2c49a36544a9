"""YAML with places: mappings and scalars that know their line and column, so that a refusal can
name them.

Only plain data is read (mappings, sequences, scalars): no tags, no anchors or aliases (a few lines
of them can expand to gigabytes), a bound on size and on nesting, no key twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from residuum.identification.errors import BadModel
from residuum.identification.physics.files.expression import Place
from residuum.nearest_names import known_names

MOST_CHARACTERS = 200_000
"""Of a model file: the largest here has 3 000. Parsing more takes seconds, so a longer text is
refused before that.
"""
DEEPEST_NESTING = 12


@dataclass(frozen=True)
class Scalar:
    """A scalar as it was written."""

    text: str
    place: Place

    def number(self, label: str) -> float:
        """The scalar as a finite number."""
        try:
            value = float(self.text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.place.refuse(f"{label} is {self.text!r}; must be a finite number")
        return value

    def truth(self, label: str) -> bool:
        """The scalar as true or false."""
        if self.text.lower() not in ("true", "false"):
            raise self.place.refuse(f"{label} is {self.text!r}; must be true or false")
        return self.text.lower() == "true"


@dataclass(frozen=True)
class Listing:
    """A sequence."""

    items: Sequence[Tree]
    place: Place


@dataclass(frozen=True)
class Table:
    """A mapping with the places of its keys."""

    entries: Mapping[str, Tree]
    keys: Mapping[str, Place]
    place: Place

    def only(self, allowed: Sequence[str], label: str) -> None:
        """Refuse a key that is not allowed."""
        for key, place in self.keys.items():
            if key not in allowed:
                raise place.refuse(
                    f"{label}: key {key!r} is not known;"
                    f" {known_names(key, allowed, 'there are')}{self._remedy(key)}"
                )

    def table(self, key: str, label: str, *, required: bool = False) -> Table:
        """The mapping under `key` (empty when absent and not required)."""
        tree = self._get(key, label, required)
        if tree is None:
            return Table({}, {}, self.place)
        if not isinstance(tree, Table):
            raise tree.place.refuse(f"{label}: {key!r} must be a mapping")
        return tree

    def scalar(self, key: str, label: str) -> Scalar:
        """The scalar under `key`."""
        tree = self._get(key, label, True)
        if not isinstance(tree, Scalar):
            raise (tree or self).place.refuse(f"{label}: {key!r} must be a single value")
        return tree

    def optional(self, key: str, label: str) -> Scalar | None:
        """The scalar under `key`, or None."""
        return self.scalar(key, label) if key in self.entries else None

    def __iter__(self) -> Iterator[str]:
        return iter(self.entries)

    def _remedy(self, key: str) -> str:
        """How to go on where the key is the rest of a text that YAML cut at its comma: nothing
        stands under it.
        """
        value = self.entries[key]
        cut = isinstance(value, Scalar) and not value.text
        return "; a text with a comma stands in quotation marks" if cut else ""

    def _get(self, key: str, label: str, required: bool) -> Tree | None:
        if key not in self.entries and required:
            raise self.place.refuse(f"{label}: {key!r} is missing")
        return self.entries.get(key)


Tree = Scalar | Listing | Table


def read_text(path: Path, label: str = "model") -> str:
    """The text of a model file, or of another of this label, as far as it may be long."""
    try:
        with path.open(encoding="utf-8") as file:
            return file.read(MOST_CHARACTERS + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise BadModel(
            f"{label} {str(path)!r}: cannot be read as UTF-8 text ({type(error).__name__})"
        ) from None


def read_tree(
    text: str, source: str, form: str = "a model file is a mapping that begins with 'name:'"
) -> Table:
    """The mapping that a YAML text holds; BadModel with line and column when it is not
    acceptable.
    """
    start = Place(source)
    if len(text) > MOST_CHARACTERS:
        raise start.refuse(
            f"longer than the {MOST_CHARACTERS} characters that a model file may have"
        )
    try:
        # Before anything is built: aliases and deep nesting make small texts large.
        _bounded(text, source)
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = Place(source, mark.line + 1, mark.column + 1) if mark else start
        raise place.refuse(f"not YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise start.refuse(f"not YAML: {' '.join(str(error).split())[:120]}") from None
    tree = _tree(node, source) if node is not None else None
    if not isinstance(tree, Table):
        raise start.refuse(form)
    return tree


def _bounded(text: str, source: str) -> None:
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        mark = event.start_mark
        place = Place(source, mark.line + 1, mark.column + 1) if mark else Place(source)
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise place.refuse("anchors and aliases are not allowed")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > DEEPEST_NESTING:
            raise place.refuse(f"nested more than {DEEPEST_NESTING} deep")


def _tree(node: yaml.Node, source: str) -> Tree:
    place = Place(source, node.start_mark.line + 1, node.start_mark.column + 1)
    if isinstance(node, yaml.ScalarNode):
        # A quoted text begins behind its quotation mark.
        return Scalar(str(node.value), place.right(1) if node.style in ("'", '"') else place)
    if isinstance(node, yaml.SequenceNode):
        return Listing([_tree(item, source) for item in node.value], place)
    entries: dict[str, Tree] = {}
    keys: dict[str, Place] = {}
    last = ""
    for key_node, value_node in node.value:
        key = _tree(key_node, source)
        if not isinstance(key, Scalar):
            raise key.place.refuse(
                "a key must be a single word; in braces, a text with a comma or [ ] stands in"
                " quotation marks"
            )
        before = entries.get(last)
        if isinstance(before, Scalar) and before.text.count("(") > before.text.count(")"):
            # An open bracket: the text goes on behind the comma.
            # `{a: max(b, 0)}`: YAML split at the comma
            entries[last] = Scalar(f"{before.text}, {key.text}", before.place)
            continue
        if key.text in entries:
            raise key.place.refuse(f"key {key.text!r} stands twice")
        entries[key.text] = _tree(value_node, source)
        keys[key.text] = key.place
        last = key.text
    return Table(entries, keys, place)
