"""FMUs for tests: made by our own export, then changed as others' are."""

import hashlib
import io
import subprocess
import zipfile
from pathlib import Path

import numpy as np

from residuum.diagnosis.learning.stored import load_stored, save_stored
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


def aborting(file, folder, calls=1000):
    """The FMU that ends its process when it is asked for its rates for so many times."""

    def change(source):
        head, begin, rest = source.partition("fmi2Status fmi2GetDerivatives(")
        signature, brace, body = rest.partition("{")
        count = f" static int calls; if (++calls > {calls}) abort();"
        return head + begin + signature + brace + count + body

    made = folder / "aborting"
    made.mkdir()
    return recompiled(file, made / "abort.fmu", made, change)


def with_another_fmu(baseline, to, content, digest="its own"):
    """A copy of a baseline that holds another FMU, by default as if it had been trained with it."""
    stored = load_stored(baseline, "model-based")
    if digest is not None:
        stored.meta["fmu"]["sha256"] = hashlib.sha256(content).hexdigest()
    arrays = stored.arrays | {"fmu": np.frombuffer(content, dtype=np.uint8)}
    save_stored(to, stored.kind, stored.version, stored.meta, arrays)
    return str(to)
