"""FMUs for tests: made by our own export, then changed as others' are."""

import io
import subprocess
import zipfile
from pathlib import Path

from residuum.identification.physics.export import explicit
from residuum.identification.physics.export.fmu_file import fmu


def exported(model, file):
    """The model as an FMU."""
    file.write_bytes(fmu(explicit(model)).content)
    return file


def rewritten(file, to, rename=lambda name: name, **replaced):
    """A copy of an FMU with files renamed or their text replaced, by what their names end with."""
    held = io.BytesIO()
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(held, "w") as new:
        for name in old.namelist():
            key = name.rsplit(".", 1)[-1]
            new.writestr(
                rename(name), replaced[key](old.read(name)) if key in replaced else old.read(name)
            )
    to.write_bytes(held.getvalue())
    return str(to)


def without_exchange(description):
    """A description that offers co-simulation alone."""
    head, _, rest = description.partition(b"<ModelExchange")
    return head + rest.partition(b"</ModelExchange>")[2]


def recompiled(file, to, folder, change, describe=lambda description: description):
    """A copy of an FMU whose C source is changed, and its description with it."""
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder)
    source = Path(folder) / "sources" / "fmi2.c"
    text = source.read_text()
    changed = change(text)
    assert changed != text
    source.write_text(changed)
    library = Path(folder) / "changed.so"
    subprocess.run(["gcc", "-O2", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    return rewritten(file, to, so=lambda _: library.read_bytes(), xml=describe)
