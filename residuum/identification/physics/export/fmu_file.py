"""A model as an FMU of FMI 2.0: its description, its C sources, and its library where a C compiler
is at hand.

Reference: Functional Mock-up Interface for Model Exchange and Co-Simulation, version 2.0.5,
Modelica Association 2024.

Value references count through the states, their derivatives, the inputs, the outputs, the
parameters, and the effects' terms. In model exchange each velocity that can stand still has one
event indicator: while it moves, its size on the side that it is on; while it rests, how much is
wanting until it breaks away. At an event the directions are found anew, so that rest is exact.
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

PLATFORMS = {("Linux", "x86_64"): ("linux64", ".so"), ("Darwin", "x86_64"): ("darwin64", ".dylib")}
"""(system, machine) → folder of FMI 2.0 and ending of a library."""
# [s] A compiler that hangs is given up: sources are an FMU too.
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
    # Of the code: a changed model gets another identity, the same model the same one.
    guid = "{" + hashlib.sha256(code.encode()).hexdigest()[:32] + "}"
    sources = {f"{model.name}.c": code, "fmi2.c": fmi2_source(model, guid)}
    library, folder, why = _compiled(model.name, sources)
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as archive:
        parts: dict[str, str | bytes] = {"modelDescription.xml": _description(model, guid)}
        parts |= {f"sources/{name}": text for name, text in sources.items()}
        if library is not None:
            parts[f"binaries/{folder}/{model.name}{PLATFORMS[_here()][1]}"] = library
        for name, part in parts.items():
            # without the time of day: one model is one file, which caches and baselines know again
            entry = zipfile.ZipInfo(name)
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, part, zipfile.ZIP_DEFLATED)
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
        # -O2 without -march: the library may run on another machine of this platform.
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
        # Only a master of co-simulation chooses the step.
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
    # The order of variables is that of the C source's value references.
    for reference, (name, title, attributes, unit, real) in enumerate(variables):
        identity = {"name": name, "valueReference": str(reference), "description": title}
        entry = ET.SubElement(listed, "ScalarVariable", identity | attributes)
        ET.SubElement(entry, "Real", real | ({"unit": unit} if unit else {}))
    _add_structure(root, model)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root)


def _add_structure(root: ET.Element, model: ExplicitModel) -> None:
    """What is computed from what, by numbers in the list of variables, which count from 1."""
    n = len(model.states)
    m = len(model.inputs)
    derivatives = range(n + 1, 2 * n + 1)
    outputs = range(2 * n + m + 1, 2 * n + m + 1 + len(model.outputs))
    # A first value that is a number is known; one that follows from inputs or parameters is
    # computed.
    unknown_first = [k for k, name in enumerate(model.states, 1) if not _known(model, name)]
    indices = {
        "Outputs": [*outputs],
        "Derivatives": [*derivatives],
        "InitialUnknowns": [*unknown_first, *derivatives, *outputs],
    }
    structure = ET.SubElement(root, "ModelStructure")
    for kind, numbers in indices.items():
        if numbers:
            part = ET.SubElement(structure, kind)
            for index in sorted(numbers):
                ET.SubElement(part, "Unknown", index=str(index))


_Variable = tuple[str, str, dict[str, str], str, dict[str, str]]


def _variables(model: ExplicitModel) -> Iterator[_Variable]:
    """(name, description, attributes, unit, attributes of the Real) in the order of value
    references.
    """
    moving = {"causality": "local", "variability": "continuous"}
    taken = {*model.states, *model.inputs, *model.parameters}
    yield from _variables_of_states(model, moving)
    for name in model.inputs:
        attributes = {"causality": "input", "variability": "continuous"}
        yield name, model.meanings[name], attributes, model.units.get(name, ""), {"start": "0.0"}
    for name in model.outputs:
        attributes = {"causality": "output", "variability": "continuous", "initial": "calculated"}
        # An output may be called as the state that it shows; names of an FMU are unique.
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


def _variables_of_states(model: ExplicitModel, moving: dict[str, str]) -> Iterator[_Variable]:
    """The states, then their derivatives."""
    for name in model.states:
        known = _known(model, name)
        real = {"start": repr(float(model.initial[name]))} if known else {}
        attributes = {**moving, "initial": "exact" if known else "calculated"}
        yield name, model.meanings[name], attributes, model.units.get(name, ""), real
    for k, name in enumerate(model.states, start=1):
        # Brackets: a unit may be a product or a quotient itself.
        unit = f"({model.units[name]})/s" if model.units.get(name) else ""
        yield (
            f"der({name})",
            f"rate of {model.meanings[name]}",
            {**moving, "initial": "calculated"},
            unit,
            {"derivative": str(k)},
        )


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


def fmi2_source(model: ExplicitModel, guid: str) -> str:
    """The text that, after that of `c_source`, makes an FMU's library; `guid` is the one of its
    description.
    """
    sizes = {
        "STATES": len(model.states),
        "INPUTS": len(model.inputs),
        "OUTPUTS": len(model.outputs),
        "PARAMETERS": len(model.parameters),
        "TERMS": len(model.components),
        "SURFACES": len(model.directions),
    }
    terms = ["(void)m; (void)y;"] + [
        f"y[{k}] = {model.name}_{key}(m->t, m->x, m->u, m->p, m->s);"
        for k, key in enumerate(model.components)
    ]
    text = (
        _TEXT.replace("GUID", guid)
        .replace("TERM_VALUES", "\n    ".join(terms))
        .replace("NAME", model.name)
    )
    # ROOM_: C knows no arrays of no elements.
    for key, count in sizes.items():
        text = text.replace(f"N_{key}", str(count)).replace(f"ROOM_{key}", str(max(count, 1)))
    return text


_TEXT = """\
#include <stdlib.h>
#include <string.h>
#include "NAME.c"

// What FMI 2.0 fixes of types and values.
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef char fmi2Char, fmi2Byte;
typedef const fmi2Char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
typedef struct {
    fmi2Boolean newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged, valuesOfContinuousStatesChanged,
        nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;

#if defined(_WIN32)
#define FMI2_EXPORT __declspec(dllexport)
#else
#define FMI2_EXPORT __attribute__((visibility("default")))
#endif

typedef struct {
    double t, tolerance, x[ROOM_STATES], u[ROOM_INPUTS], p[ROOM_PARAMETERS], s[ROOM_SURFACES], m[ROOM_SURFACES];
    int begun[ROOM_STATES], initialised, exchanged;
} Model;

static const double EDGE = 1e-12; // keeps an indicator off zero right after its event
enum { RATES = N_STATES, INPUTS = 2 * N_STATES, OUTPUTS = INPUTS + N_INPUTS, PARAMETERS = OUTPUTS + N_OUTPUTS,
       TERMS = PARAMETERS + N_PARAMETERS, ALL = TERMS + N_TERMS };

static void begin(Model *m)
{
    double x[ROOM_STATES];
    NAME_initial(m->t, m->u, m->p, x);
    for (int i = 0; i < N_STATES; ++i)
        if (!m->begun[i]) m->x[i] = x[i];
    NAME_directions(m->t, m->x, m->u, m->p, m->s, m->m);
}

static void reset(Model *m)
{
    memset(m, 0, sizeof *m);
    m->tolerance = 1e-9;
    for (int i = 0; i < N_PARAMETERS; ++i) m->p[i] = NAME_parameters[i];
    begin(m);
}

static void terms(const Model *m, double *y)
{
    TERM_VALUES
}

static void rates(Model *m, double *dx)
{
    if (!m->exchanged) NAME_directions(m->t, m->x, m->u, m->p, m->s, m->m);
    NAME_moving(m->t, m->x, m->u, m->p, m->s, m->m, dx);
}

FMI2_EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI2_EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
FMI2_EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c; (void)on; (void)n; (void)categories;
    return fmi2OK;
}

FMI2_EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    Model *m;
    (void)name; (void)type; (void)resources; (void)functions; (void)visible; (void)logging;
    if (!guid || strcmp(guid, "GUID") != 0) return NULL;
    m = malloc(sizeof *m);
    if (m) reset(m);
    return m;
}

FMI2_EXPORT void fmi2FreeInstance(fmi2Component c) { free(c); }

FMI2_EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean given, fmi2Real tolerance, fmi2Real start,
                                           fmi2Boolean ends, fmi2Real stop)
{
    Model *m = c;
    (void)ends; (void)stop;
    m->t = start;
    if (given && tolerance > 0.0 && tolerance < m->tolerance) m->tolerance = tolerance;
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { begin(c); return fmi2OK; }
FMI2_EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    begin(c);
    ((Model *)c)->initialised = 1;
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }
FMI2_EXPORT fmi2Status fmi2Reset(fmi2Component c) { reset(c); return fmi2OK; }

FMI2_EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Model *m = c;
    double dx[ROOM_STATES], y[ROOM_OUTPUTS], z[ROOM_TERMS];
    if (!m->initialised) begin(m);
    rates(m, dx);
    NAME_outputs(m->t, m->x, m->u, m->p, y);
    terms(m, z);
    for (size_t k = 0; k < n; ++k) {
        int i = (int)vr[k];
        if (i < 0 || i >= ALL) return fmi2Error;
        value[k] = i < RATES ? m->x[i] : i < INPUTS ? dx[i - RATES] : i < OUTPUTS ? m->u[i - INPUTS]
                 : i < PARAMETERS ? y[i - OUTPUTS] : i < TERMS ? m->p[i - PARAMETERS] : z[i - TERMS];
    }
    return fmi2OK;
}

FMI2_EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    Model *m = c;
    for (size_t k = 0; k < n; ++k) {
        int i = (int)vr[k];
        if (i >= 0 && i < RATES) { m->x[i] = value[k]; m->begun[i] = 1; }
        else if (i >= INPUTS && i < OUTPUTS) m->u[i - INPUTS] = value[k];
        else if (i >= PARAMETERS && i < TERMS) m->p[i - PARAMETERS] = value[k];
        else return fmi2Error;
    }
    return fmi2OK;
}

#define NONE(name, type) \\
    FMI2_EXPORT fmi2Status name(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[]) \\
    { (void)c; (void)vr; (void)value; return n ? fmi2Error : fmi2OK; }
NONE(fmi2GetInteger, fmi2Integer)
NONE(fmi2GetBoolean, fmi2Boolean)
NONE(fmi2GetString, fmi2String)
NONE(fmi2SetInteger, const fmi2Integer)
NONE(fmi2SetBoolean, const fmi2Boolean)
NONE(fmi2SetString, const fmi2String)

FMI2_EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return fmi2Error;
    memcpy(*state, c, sizeof(Model));
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { memcpy(c, state, sizeof(Model)); return fmi2OK; }
FMI2_EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c; (void)state;
    *size = sizeof(Model);
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    (void)c;
    if (size < sizeof(Model)) return fmi2Error;
    memcpy(bytes, state, sizeof(Model));
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    (void)c;
    if (size < sizeof(Model)) return fmi2Error;
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return fmi2Error;
    memcpy(*state, bytes, sizeof(Model));
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                                    const fmi2ValueReference known[], size_t k,
                                                    const fmi2Real dv[], fmi2Real du[])
{
    (void)c; (void)unknown; (void)n; (void)known; (void)k; (void)dv; (void)du;
    return fmi2Error;
}

// Model exchange

FMI2_EXPORT fmi2Status fmi2EnterEventMode(fmi2Component c) { (void)c; return fmi2OK; }
FMI2_EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    Model *m = c;
    int stopped = 0;
    for (int j = 0; j < N_SURFACES; ++j) {
        double *v = &m->x[NAME_surface[j]];
        if (m->exchanged && (m->m[j] == 0.0 || m->s[j] * *v <= 0.0) && *v != 0.0) {
            *v = 0.0;
            stopped = 1;
        }
    }
    NAME_directions(m->t, m->x, m->u, m->p, m->s, m->m);
    m->exchanged = 1;
    memset(info, 0, sizeof *info);
    info->valuesOfContinuousStatesChanged = stopped;
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { (void)c; return fmi2OK; }
FMI2_EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean kept, fmi2Boolean *event, fmi2Boolean *terminate)
{
    (void)c; (void)kept;
    *event = *terminate = 0;
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { ((Model *)c)->t = t; return fmi2OK; }
FMI2_EXPORT fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    if (n != N_STATES) return fmi2Error;
    memcpy(((Model *)c)->x, x, n * sizeof *x);
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    if (n != N_STATES) return fmi2Error;
    memcpy(x, ((Model *)c)->x, n * sizeof *x);
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    (void)c;
    for (size_t i = 0; i < n; ++i) x[i] = 1.0;
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n)
{
    double all[ROOM_STATES];
    if (n != N_STATES) return fmi2Error;
    rates(c, all);
    memcpy(dx, all, n * sizeof *dx);
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n)
{
    Model *m = c;
    double s[ROOM_SURFACES], rests[ROOM_SURFACES], forward, backward;
    if (n != N_SURFACES) return fmi2Error;
    memcpy(s, m->s, sizeof s);
    for (int j = 0; j < N_SURFACES; ++j) {
        z[j] = m->s[j] == 0.0 ? 1.0 : m->s[j] * m->x[NAME_surface[j]] + EDGE;
        if (m->m[j] != 0.0) continue;
        NAME_at_rest(m->t, m->x, m->u, m->p, s, rests, j, &forward, &backward);
        s[j] = m->s[j];
        z[j] = fmin(-forward, backward) + EDGE;
    }
    return fmi2OK;
}

// Co-simulation

FMI2_EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                   const fmi2Integer order[], const fmi2Real value[])
{
    (void)c; (void)vr; (void)n; (void)order; (void)value;
    return fmi2Error;
}
FMI2_EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                                    const fmi2Integer order[], fmi2Real value[])
{
    (void)c; (void)vr; (void)n; (void)order; (void)value;
    return fmi2Error;
}
FMI2_EXPORT fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean kept)
{
    Model *m = c;
    (void)kept;
    NAME_advance(t, h, m->x, m->u, m->p, m->tolerance);
    m->t = t + h;
    for (int i = 0; i < N_STATES; ++i)
        if (!(fabs(m->x[i]) < 1e300)) return fmi2Error;
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2CancelStep(fmi2Component c) { (void)c; return fmi2Error; }
FMI2_EXPORT fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}
FMI2_EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Model *)c)->t;
    return fmi2OK;
}
FMI2_EXPORT fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}
FMI2_EXPORT fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}
FMI2_EXPORT fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}
"""
