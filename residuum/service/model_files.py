"""Checking a model file before it is stored: every kind of model has its reader.

As a program (`python -m residuum.service.model_files MEMORY SECONDS FILE KIND DIAGNOSER`) it checks
FILE within limits.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from residuum.diagnosis.learning.stored import load_stored
from residuum.identification.errors import BadInput, BadModel, Forbidden
from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.identification.physics.files.model_file import load_model
from residuum.identification.physics.fmu.description import describe
from residuum.identification.physics.fmu.permission import ARRAY, check_size, holds_fmu, is_packed
from residuum.service.machines.scoring import diagnoser_class
from residuum.service.work.limited_process import run_limited, within_limits

MODEL_KINDS: dict[str, tuple[str, str]] = {
    "physical": ("application/yaml", ".yaml"),
    "identified": ("application/json", ".json"),
    "baseline": ("application/zip", ".zip"),
    "fmu": ("application/octet-stream", ".fmu"),
}
"""Media type and file ending of each kind."""


_NO_FMUS = (
    "model file: holds an FMU, which is native code; this service runs none, as its setting"
    " allow_fmus says"
)
_IS_PACKED = (
    "model file: is packed, as an FMU is, and no text; an FMU is stored as kind=fmu, where the"
    " service's setting allow_fmus is on"
)
# Bytes up to which a model's text is read in the service itself: parsing YAML of 200 kB takes
# seconds of the interpreter.
_SHORT = 16 * 2**10


def is_read_apart(kind: str, content: bytes) -> bool:
    """Whether a file is checked in a process of its own: it is long, or packed."""
    return kind in ("baseline", "fmu") or len(content) > _SHORT


def check_long_model_file(
    kind: str,
    content: bytes,
    diagnoser: str | None,
    *,
    memory: int,
    seconds: int,
    fmus: bool = False,
) -> None:
    """`check_model_file` of a file that is long, or packed, in a limited process of its own;
    BadModel also beyond a limit. Without `fmus` a baseline that holds an FMU is Forbidden; with
    it nothing of the FMU is loaded here.
    """
    _reader(kind, diagnoser)  # no process is started for a diagnoser that there is not
    with tempfile.TemporaryDirectory(prefix="residuum-model-") as folder:
        file = Path(folder) / "model"
        file.write_bytes(content)
        refusal = run_limited(
            __name__,
            (str(file), kind, diagnoser or "", *(["fmus"] if fmus else [])),
            Path(folder),
            memory=memory,
            seconds=seconds,
        )
    if refusal is not None:
        reason, parts = refusal
        if reason == Forbidden.__name__:
            raise Forbidden(**parts)
        raise BadModel(**parts) if reason else BadModel(f"model file: {parts['what']}")


def check_model_file(
    kind: str, content: bytes, diagnoser: str | None = None, *, fmus: bool = False
) -> None:
    """Refuse a file that its reader refuses; the reader's message is kept, with 'model file' for
    the file's name.

    NotFound for a diagnoser that there is not, BadInput for a baseline without one, BadModel for
    all that is wrong with the file.
    """
    reader = _reader(kind, diagnoser)
    if kind == "physical" and is_packed(content):
        raise BadModel(_IS_PACKED)
    if kind == "fmu" and not fmus:
        raise Forbidden(_NO_FMUS)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"model{MODEL_KINDS[kind][1]}"
        file.write_bytes(content)
        try:
            if kind == "baseline" and fmus and holds_fmu(file):
                _check_fmu_baseline(file, diagnoser or "")
            else:
                reader(file)
        except Forbidden:
            # in our words: where it lay while it was read is nobody's business
            raise Forbidden(_NO_FMUS) from None
        except BadInput as error:
            refusal = str(error).replace(f"model {str(file)!r}", "model file")
            raise BadModel(
                refusal.replace(str(file), "model file").replace(file.name, "model file")
            ) from None


def _check_fmu(file: Path) -> None:
    """Read what the FMU says of itself; nothing of it is loaded."""
    check_size(file)
    describe(file)


def _check_fmu_baseline(file: Path, diagnoser: str) -> None:
    """Read what is stored, and what the FMU in it says of itself."""
    file.write_bytes(load_stored(file, diagnoser).arrays[ARRAY].tobytes())
    describe(file)


def _reader(kind: str, diagnoser: str | None) -> Callable[[Path], object]:
    if kind == "baseline":
        if diagnoser is None:
            raise BadInput("query: diagnoser is missing; a baseline needs it")
        return diagnoser_class(diagnoser).load
    return {"physical": load_model, "fmu": _check_fmu}.get(kind, load_identified)


def main(memory: int, seconds: int, name: str, kind: str, diagnoser: str, *more: str) -> int:
    """Check a file within the limits; gives the exit status."""
    fmus = "fmus" in more
    return within_limits(
        lambda: check_model_file(kind, Path(name).read_bytes(), diagnoser or None, fmus=fmus),
        memory,
        seconds,
    )


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]))
