"""`--plot FILE`: the picture of an answer, beside the answer."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.library.picture import Picture
from residuum.library.picture_file import check_picture_file, write_picture
from residuum.library.result import Result
from residuum.service.commands.output_file import check_output_file

Plot = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.png|.html",
        help="Draw the answer: an image (needs residuum\\[plots]), or a page that works offline.",
    ),
]


def check_plot(plot: Path | None) -> None:
    """Refuse a picture that could not be written, before the work is done."""
    if plot is not None:
        check_output_file(plot)
        check_picture_file(plot)


def drawn(plot: Path | None, results: Sequence[Result], title: str) -> dict[str, Any]:
    """The picture of these answers, written one below the other; what the answer tells of it."""
    if plot is None:
        return {}
    # One picture for all answers, so that several records are seen on one page.
    panels = [panel for result in results for panel in result.picture().panels]
    write_picture(Picture(panels), plot, title)
    return {"plot": str(plot)}
