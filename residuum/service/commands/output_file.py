"""Files that commands write: refused before the work is done, not after it."""

from pathlib import Path

from residuum.identification.errors import BadInput


def check_output_file(file: Path) -> None:
    """Refuse a file that cannot be written: its folder is missing, or it is a folder itself.

    Raises
    ------
    BadInput

    >>> check_output_file(Path("/nowhere/model.yaml"))
    Traceback (most recent call last):
    residuum.identification.errors.BadInput: /nowhere/model.yaml: folder '/nowhere' does not exist
    """
    # No folder is made: a mistyped path would be one, with the result where nobody looks for it.
    if not file.parent.is_dir():
        raise BadInput(f"{file}: folder {str(file.parent)!r} does not exist")
    if file.is_dir():
        raise BadInput(f"{file}: is a folder; give the name of a file")
