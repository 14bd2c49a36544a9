"""Register traces: what a Modbus device published, page by page, as a text file that can be
replayed.

UTF-8, one page a line, in the order of publication; lines that begin with `#` are notes, of which
two are needed:

    # residuum register trace 1
    # map: process_plant.yaml
    0.100 process 0000 0000 3F80 0000
    0.200 process …

A line holds the time since the first page [s], the stream of the register map, and the registers of
the page's samples (without the page's head, which is made anew), each as four hexadecimal digits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.modbus.channel_registers import Registers
from residuum.service.fieldbus.modbus.register_map import RegisterMap, read_register_map
from residuum.service.fieldbus.settings import map_file

_TITLE = "# residuum register trace 1"
_MAP = "# map:"


class TracedPage(NamedTuple):
    """One page of a trace: when it was published [s], its stream, and the registers of its
    samples.
    """

    time: float
    stream: str
    samples: Registers


def write_trace(path: str | Path, map_name: str, pages: Iterable[TracedPage]) -> None:
    """Write a trace of a device with this register map."""
    with open(path, "w", encoding="utf-8") as file:
        file.write(f"{_TITLE}\n{_MAP} {map_name}\n")
        for page in pages:
            words = " ".join(f"{int(word):04X}" for word in page.samples)
            file.write(f"{page.time:.6f} {page.stream} {words}\n")


def read_trace(path: str | Path) -> tuple[RegisterMap, Iterator[TracedPage]]:
    """The register map of a trace, and its pages as they are asked for.

    Raises BadBusDescription with file and line for a line that is no page, times that go back, or a
    stream that the map does not have.
    """
    where = Path(path).name
    notes = []
    try:
        with open(path, encoding="utf-8") as file:
            for line in file:
                if not line.startswith("#"):
                    break
                notes.append(line.strip())
    except (OSError, UnicodeDecodeError) as error:
        raise BadBusDescription(f"{where}: cannot be read: {error}") from None
    maps = [note.removeprefix(_MAP).strip() for note in notes if note.startswith(_MAP)]
    if not notes or notes[0] != _TITLE or len(maps) != 1:
        raise BadBusDescription(
            f"{where}: is no register trace; it must begin with {_TITLE!r} and name its map"
        )
    registers = read_register_map(map_file(maps[0]))
    return registers, _pages(Path(path), registers)


def _pages(path: Path, registers: RegisterMap) -> Iterator[TracedPage]:
    last = 0.0
    with open(path, encoding="utf-8") as file:
        for number, line in enumerate(file, start=1):
            if line.startswith("#") or not line.strip():
                continue
            page = _page(line.split(), registers, f"{path.name}, line {number}")
            if page.time < last:
                raise BadBusDescription(
                    f"{path.name}, line {number}: time {page.time:g} s lies before {last:g} s"
                )
            last = page.time
            yield page


def _page(fields: list[str], registers: RegisterMap, where: str) -> TracedPage:
    try:
        time, stream, words = float(fields[0]), fields[1], [int(word, 16) for word in fields[2:]]
    except (ValueError, IndexError):
        raise BadBusDescription(
            f"{where}: must be time, stream and hexadecimal registers"
        ) from None
    layout = registers.streams.get(stream)
    if layout is None or layout.pages is None:
        raise BadBusDescription(f"{where}: the register map has no paged stream {stream!r}")
    if len(words) != layout.words * layout.samples or not all(
        0 <= word <= 0xFFFF for word in words
    ):
        raise BadBusDescription(
            f"{where}: {len(words)} registers; a page of {stream!r} has"
            f" {layout.words * layout.samples}"
        )
    if not math.isfinite(time):
        raise BadBusDescription(f"{where}: the time is not finite")
    return TracedPage(time, stream, np.array(words, np.uint16))
