"""The YAML text of a map: plain data, no name twice in one place."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from residuum.identification.yaml_text import PlainNumbers, read_yaml, short_text, what_is_wrong
from residuum.service.fieldbus.can.frame_layout import BadBusDescription

Map = TypeVar("Map", bound=BaseModel)


class _EachNameOnce(PlainNumbers):
    """YAML itself would let the later of two equal names win, without a word."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        names: set[Hashable] = set()
        for key, _ in node.value:
            name = self.construct_object(key, deep=True)
            if name in names:
                raise yaml.constructor.ConstructorError(
                    None,
                    None,
                    f"{name!r} is named twice in one place; rename or remove one",
                    key.start_mark,
                )
            names.add(name)
        return super().construct_mapping(node, deep)


def read_map_text(path: str | Path) -> Any:
    """The content of a YAML file; BadBusDescription names file, line and rule."""
    where = Path(path).name
    # ConstructorError before YAMLError, of which it is one: it names a name that stands twice
    try:
        return yaml.load(short_text(Path(path)), Loader=_EachNameOnce)
    except yaml.constructor.ConstructorError as error:
        line = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise BadBusDescription(f"{where}{line}: {error.problem}") from None
    except FileNotFoundError:
        raise BadBusDescription(f"{where}: no such file") from None
    except OSError as error:
        raise BadBusDescription(f"{where}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, yaml.YAMLError, TypeError) as error:
        raise BadBusDescription(f"{where}: is not YAML: {what_is_wrong(error)}") from None


def read_map(path: Path, kind: type[Map], way_on: Callable[[str], str] = lambda _field: "") -> Map:
    """The map of a kind in a YAML file; BadBusDescription names file and field, and says what
    `way_on` knows for it.
    """
    try:
        return kind.model_validate(read_yaml(path, BadBusDescription, _EachNameOnce))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise BadBusDescription(f"{path}, {where}: {first['msg']}{way_on(where)}") from None
