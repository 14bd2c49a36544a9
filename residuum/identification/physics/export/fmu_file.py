"""A model as an FMU of FMI 2.0: its description, its C sources, and its library where a C compiler
is at hand.
"""

from __future__ import annotations

import hashlib
import io
import platform
import shutil
import subprocess
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.export.c_source import c_source
from residuum.identification.physics.export.explicit_model import ExplicitModel
from residuum.identification.physics.export.fmi2_source import fmi2_source

PLATFORMS = {("Linux", "x86_64"): ("linux64", ".so"), ("Darwin", "x86_64"): ("darwin64", ".dylib")}
"""(system, machine) → folder of FMI 2.0 and ending of a library."""
_TIMEOUT = 120.0
_ABLE = dict.fromkeys(
    ("canGetAndSetFMUstate", "canSerializeFMUstate", "canNotUseMemoryManagementFunctions"), "true"
)


@dataclass(frozen=True)
class Fmu:
    """The bytes of an FMU; `library` is the folder of its compiled library, or None with `why`
    there is none.
    """

    content: bytes
    library: str | None
    why: str = ""


def fmu(model: ExplicitModel) -> Fmu:
    """An FMU for co-simulation and model exchange; effects are components:
    `coulomb_friction_shaft.tau_c`, `….term`.

    Sources are always in it; without a compiler for this platform they are all that is.
    """
    code = c_source(model)
    guid = "{" + hashlib.sha256(code.encode()).hexdigest()[:32] + "}"
    sources = {f"{model.name}.c": code, "fmi2.c": fmi2_source(model, guid)}
    library, folder, why = _compiled(model.name, sources)
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", _description(model, guid))
        for name, text in sources.items():
            archive.writestr(f"sources/{name}", text)
        if library is not None:
            archive.writestr(f"binaries/{folder}/{model.name}{PLATFORMS[_here()][1]}", library)
    return Fmu(held.getvalue(), folder, why)


def _here() -> tuple[str, str]:
    return platform.system(), platform.machine()


def _compiled(name: str, sources: dict[str, str]) -> tuple[bytes | None, str | None, str]:
    """(library, its folder, why there is none)."""
    if _here() not in PLATFORMS:
        return None, None, f"no library is made on {' '.join(_here())}: sources only"
    compiler = next(
        (program for name in ("cc", "gcc", "clang") if (program := shutil.which(name))), None
    )
    if compiler is None:
        return None, None, "no C compiler (cc, gcc, clang) was found: sources only"
    folder, ending = PLATFORMS[_here()]
    with tempfile.TemporaryDirectory() as place:
        for file, text in sources.items():
            (Path(place) / file).write_text(text, encoding="utf-8")
        out = Path(place) / f"{name}{ending}"
        flags = [
            "-std=c99",
            "-O2",
            "-fPIC",
            "-shared",
            "-fvisibility=hidden",
            "-o",
            str(out),
            str(Path(place) / "fmi2.c"),
            "-lm",
        ]
        try:
            subprocess.run([compiler, *flags], check=True, capture_output=True, timeout=_TIMEOUT)
        except (subprocess.SubprocessError, OSError) as error:
            message = (
                (getattr(error, "stderr", b"") or b"").decode(errors="replace").split("\n", 1)[0]
            )
            return (
                None,
                None,
                f"{compiler} failed ({message or type(error).__name__}): sources only",
            )
        return out.read_bytes(), folder, ""


def _description(model: ExplicitModel, guid: str) -> bytes:
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.title,
        guid=guid,
        generationTool="Residuum",
        variableNamingConvention="structured",
        numberOfEventIndicators=str(len(model.directions)),
    )
    for kind in ("ModelExchange", "CoSimulation"):
        held = {"canHandleVariableCommunicationStepSize": "true"} if kind == "CoSimulation" else {}
        part = ET.SubElement(root, kind, {"modelIdentifier": model.name, **_ABLE, **held})
        ET.SubElement(ET.SubElement(part, "SourceFiles"), "File", name="fmi2.c")
    variables = list(_variables(model))
    if units := sorted({unit for *_, unit, _ in variables if unit}):
        definitions = ET.SubElement(root, "UnitDefinitions")
        for unit in units:
            ET.SubElement(definitions, "Unit", name=unit)
    ET.SubElement(root, "DefaultExperiment", startTime="0", tolerance="1e-9")
    listed = ET.SubElement(root, "ModelVariables")
    for reference, (name, title, attributes, unit, real) in enumerate(variables):
        identity = {"name": name, "valueReference": str(reference), "description": title}
        entry = ET.SubElement(listed, "ScalarVariable", identity | attributes)
        ET.SubElement(entry, "Real", real | ({"unit": unit} if unit else {}))
    structure = ET.SubElement(root, "ModelStructure")
    n, m = len(model.states), len(model.inputs)
    indices = {
        "Outputs": range(2 * n + m + 1, 2 * n + m + 1 + len(model.outputs)),
        "Derivatives": range(n + 1, 2 * n + 1),
        "InitialUnknowns": (
            [k + 1 for k, name in enumerate(model.states) if not _known(model, name)]
            + [*range(n + 1, 2 * n + 1), *range(2 * n + m + 1, 2 * n + m + 1 + len(model.outputs))]
        ),
    }
    for kind, numbers in indices.items():
        if numbers:
            part = ET.SubElement(structure, kind)
            for index in sorted(numbers):
                ET.SubElement(part, "Unknown", index=str(index))
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root)


_Variable = tuple[str, str, dict[str, str], str, dict[str, str]]


def _variables(model: ExplicitModel) -> Iterator[_Variable]:
    """(name, description, attributes, unit, attributes of the Real) in the order of value
    references.
    """
    moving = {"causality": "local", "variability": "continuous"}
    taken = {*model.states, *model.inputs, *model.parameters}
    for name in model.states:
        known = _known(model, name)
        real = {"start": repr(float(model.initial[name]))} if known else {}
        attributes = {**moving, "initial": "exact" if known else "calculated"}
        yield name, model.meanings[name], attributes, model.units.get(name, ""), real
    for k, name in enumerate(model.states, start=1):
        unit = f"({model.units[name]})/s" if model.units.get(name) else ""
        yield (
            f"der({name})",
            f"rate of {model.meanings[name]}",
            {**moving, "initial": "calculated"},
            unit,
            {"derivative": str(k)},
        )
    for name in model.inputs:
        attributes = {"causality": "input", "variability": "continuous"}
        yield name, model.meanings[name], attributes, model.units.get(name, ""), {"start": "0.0"}
    for name in model.outputs:
        attributes = {"causality": "output", "variability": "continuous", "initial": "calculated"}
        shown = f"y.{name}" if name in taken else name
        yield shown, model.meanings[name], attributes, model.units.get(name, ""), {}
    for name in model.parameters:
        attributes = {"causality": "parameter", "variability": "tunable", "initial": "exact"}
        yield (
            structured(model, name),
            model.meanings[name],
            attributes,
            model.units.get(name, ""),
            {"start": repr(model.values[name])},
        )
    for key, part in model.components.items():
        yield f"{key}.term", part.title, {**moving, "initial": "calculated"}, part.unit, {}


def structured(model: ExplicitModel, parameter: str) -> str:
    """The name of a parameter by its component: `coulomb_friction_shaft.tau_c`."""
    effect, _, own = model.meanings[parameter].rpartition(".")
    key = next((key for key, part in model.components.items() if part.title == effect), None)
    if key is None and effect:
        key = parameter.removesuffix(f"_{own}")
    return f"{key}.{own}" if effect else parameter


def _known(model: ExplicitModel, state: str) -> bool:
    """Whether a state's first value is a plain number."""
    return bool(sp.sympify(model.initial[state]).is_number)
