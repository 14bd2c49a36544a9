"""A picture as a file to be sent: an interactive HTML page that needs nothing else, or an image."""

from __future__ import annotations

from html import escape
from pathlib import Path

from residuum.identification.errors import BadInput
from residuum.library.picture import Picture
from residuum.library.plotly_figure import figure
from residuum.library.png import need_matplotlib, png
from residuum.library.whole_file import write_whole
from residuum.nearest_names import known_names

ENDINGS = (".png", ".html")


def check_picture_file(path: Path) -> None:
    """Refuse, before the work is done, a picture that could not be written.

    Raises
    ------
    BadInput
        Another ending than `.png` or `.html`.
    MissingPackage
        Matplotlib, which draws images, is not installed.

    >>> check_picture_file(Path("a.pgn"))
    Traceback (most recent call last):
    residuum.identification.errors.BadInput: a.pgn: ending '.pgn' is no picture; did you mean '.png'? known are .png, .html
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise BadInput(f"{path}: ending {ending!r} is no picture; {known_names(ending, ENDINGS)}")
    if ending == ".png":
        need_matplotlib()


def write_picture(picture: Picture, path: Path, title: str) -> None:
    """Write the picture as a page (`.html`, about 5 MB: Plotly is inside) or an image (`.png`), by
    the ending of `path`.

    Raises
    ------
    BadInput, MissingPackage
        As `check_picture_file` says; a folder that does not exist.
    """
    check_picture_file(path)
    if path.suffix.lower() == ".png":
        write_whole(path, png(picture))
        return
    drawn = figure(picture)
    drawn.update_layout(title={"text": escape(title)}, margin={"t": 90, "b": 50})
    page: str = drawn.to_html(full_html=True, include_plotlyjs=True)
    write_whole(path, page.replace("<head>", f"<head><title>{escape(title)}</title>", 1))
