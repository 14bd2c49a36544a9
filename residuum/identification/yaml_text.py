"""YAML files that people write: read whole only while they are short, and one line on what is wrong
with one.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

FASTEST: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""libyaml's parser where PyYAML was built with it, as its wheels are: ten times as fast as the one
in Python.
"""
# what YAML 1.1 reads as octal, and to the base of 60
_LEADING_ZERO = re.compile(r"[-+]?0[0-9][0-9_]*")
_BASE_60 = re.compile(r"[-+]?[0-9][0-9_]*(:[0-5]?[0-9])+(\.[0-9_]*)?")
LONGEST_TEXT = 1_000_000
"""Bytes of a YAML file at most. PyYAML takes some 10 s and 80 MB of memory for each million; the
longest map here has 40 000.
"""


class PlainNumbers(FASTEST):
    """Numbers as people mean them: YAML 1.1 takes 010 for eight and 1:29 for eighty-nine; here both
    are refused.
    """

    def construct_plain(self, node: yaml.ScalarNode) -> Any:
        """The scalar; ConstructorError with the line where it is such a number."""
        text = node.value
        # Of plain scalars alone: what is quoted is meant as it stands.
        if not node.style and _LEADING_ZERO.fullmatch(text):
            digits = text.lstrip("+-0_") or "0"
            says = (
                f"{text} has a leading zero, which YAML reads as octal; write {digits}, or quote it"
                " where it is a name"
            )
            raise yaml.constructor.ConstructorError(None, None, says, node.start_mark)
        if not node.style and _BASE_60.fullmatch(text):
            says = (
                f"{text} has a colon, which YAML reads to the base of 60; write the number, or"
                " quote it where it is a name"
            )
            raise yaml.constructor.ConstructorError(None, None, says, node.start_mark)
        return _AS_BEFORE[node.tag](self, node)


_AS_BEFORE = {
    tag: FASTEST.yaml_constructors[tag]
    for tag in (f"tag:yaml.org,2002:{kind}" for kind in ("int", "float", "str"))
}
for _tag in _AS_BEFORE:
    PlainNumbers.add_constructor(_tag, PlainNumbers.construct_plain)


def short_text(path: Path) -> str:
    """The UTF-8 text of a file; OSError, before anything is read, for one of more than
    `LONGEST_TEXT` bytes.
    """
    if (size := path.stat().st_size) > LONGEST_TEXT:
        raise OSError(errno.EFBIG, f"{size} bytes; a YAML file has at most {LONGEST_TEXT}")
    return path.read_text(encoding="utf-8")


def read_yaml(
    file: Path, refused: Callable[[str], Exception], loader: type[yaml.SafeLoader] = yaml.SafeLoader
) -> Any:
    """What a short file holds; `refused` with one line where it cannot be read or is no YAML."""
    try:
        return yaml.load(short_text(file), Loader=loader)
    except OSError as error:
        raise refused(f"{file}: cannot be read: {error.strerror}") from None
    # PyYAML raises ValueError of a day that there is not, Python of bytes that are no UTF-8.
    except (yaml.YAMLError, ValueError) as error:
        raise refused(f"{file}: is not YAML: {what_is_wrong(error)}") from None


def what_is_wrong(error: Exception) -> str:
    """Line, column and what the parser says, in one line."""
    if isinstance(error, yaml.MarkedYAMLError) and (
        mark := error.problem_mark or error.context_mark
    ):
        return f"line {mark.line + 1}, column {mark.column + 1}: {error.problem}"
    return " ".join(str(error).split())[:120]
