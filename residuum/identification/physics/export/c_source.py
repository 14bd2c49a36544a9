"""A model as C99: rates, outputs, first states and steps, without any dependency but <math.h>."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.export.explicit_model import ExplicitModel


def c_source(model: ExplicitModel) -> str:
    """One file: `NAME_parameters`, `NAME_initial`, `NAME_rates`, `NAME_outputs`, `NAME_step` and
    `NAME_advance` (inputs held).

    Each effect's term is a function of its own, `NAME_EFFECT_PLACE`.
    """
    name = model.name
    counts = {
        "STATES": len(model.states),
        "INPUTS": len(model.inputs),
        "OUTPUTS": len(model.outputs),
        "PARAMETERS": len(model.parameters),
        "COMPONENTS": len(model.components),
    }
    values = ", ".join(repr(model.values[p]) for p in model.parameters) or "0.0"
    of_all = "double t, const double *x, const double *u, const double *p"
    surfaces = [model.states.index(v) for v in model.directions]
    return "\n".join(
        [
            *model.head("//", at_rest=True),
            "#include <math.h>",
            "",
            *(f"#define {name.upper()}_{key} {count}" for key, count in counts.items()),
            *_table(model, "x", model.states),
            *_table(model, "u", model.inputs),
            *_table(model, "p", model.parameters),
            *_table(model, "y", tuple(model.outputs)),
            *(
                f"// s[{k}]: direction of {model.described(v)}"
                for k, v in enumerate(model.directions)
            ),
            "",
            "static inline double residuum_sign(double v) { return (v > 0.0) - (v < 0.0); }",
            f"const double {name}_parameters[] = {{{values}}};",
            "",
            *_function(
                model,
                f"void {name}_initial(double t, const double *u, const double *p, double *x)",
                "x",
                model.initial,
            ),
            # Terms before rates: C names what it has seen.
            *(line for key in model.components for line in _component(model, key, of_all)),
            *_function(
                model,
                f"void {name}_rates_by_direction({of_all}, const double *s, double *dx)",
                "dx",
                model.rates,
            ),
            *_function(model, f"void {name}_outputs({of_all}, double *y)", "y", model.outputs),
            *c_stepping(name, len(model.states), surfaces),
            "",
        ]
    )


def _component(model: ExplicitModel, key: str, of_all: str) -> list[str]:
    part = model.components[key]
    signature = f"double {model.name}_{key}({of_all}, const double *s)"
    return [
        f"// {part.title} [{part.unit}]",
        *_function(model, signature, "return", {key: part.expression}),
    ]


def _table(model: ExplicitModel, letter: str, names: tuple[str, ...]) -> list[str]:
    return [f"// {letter}[{k}]: {model.described(name)}" for k, name in enumerate(names)]


def _function(model: ExplicitModel, signature: str, target: str, expressions: Any) -> list[str]:
    used = model.symbols_in(expressions)
    clock = ["    const double time = t;"] if model.symbols["time"] in used else ["    (void)t;"]
    # an argument that no expression needs would be a warning of the compiler
    unused = [
        f"    (void){letter};"
        for letter in ("x", "u", "p", "s")
        if f"*{letter}," in signature.replace(")", ",") and letter != target
    ]
    elements = [f"{target}[{k}] =" for k in range(len(expressions))]
    places = ["return"] if target == "return" else elements
    body = [
        f"    {place} {_code(e)};" for place, e in zip(places, expressions.values(), strict=True)
    ]
    return [signature, "{", *clock, *unused, *_locals(model, used, target), *body, "}", ""]


def _locals(model: ExplicitModel, used: set[Any], target: str) -> list[str]:
    """A constant for each symbol that expressions name: an element of an array, or an effect's term.
    First states, written to x, name no state.
    """
    arrays = {"x": model.states, "u": model.inputs, "p": model.parameters}
    if target == "x":
        del arrays["x"]
    elements = {
        name: f"{letter}[{k}]" for letter, names in arrays.items() for k, name in enumerate(names)
    }
    lines = [
        f"{name} = {element}" for name, element in elements.items() if model.symbols[name] in used
    ]
    lines += [f"{d.name} = s[{k}]" for k, d in enumerate(model.directions.values()) if d in used]
    lines += [
        f"{key} = {model.name}_{key}(t, x, u, p, s)"
        for key in model.components
        if model.symbols[key] in used
    ]
    lines += [f"{name} = {_code(e)}" for name, e in model.defined_in(used).items()]
    return [f"    const double {line};" for line in lines]


def _code(expression: Any) -> str:
    return str(
        sp.ccode(
            sp.sympify(expression).evalf(17),
            standard="c99",
            user_functions={"sign": "residuum_sign"},
        )
    )


# C99 that steps an exported model: a Runge–Kutta step of fixed length, and an adaptive one that
# finds its events.
#
# Both hold a machine at rest exactly. With f⁺ and f⁻ the rate of a velocity at zero on its two
# sides, it rests while f⁺ ≤ 0 ≤ f⁻ (Filippov's sliding condition). `NAME_step` takes the same time
# every time, as a controller needs it. `NAME_advance` keeps the error of a step below a tolerance
# (Dormand and Prince, J. Comp. Appl. Math. 6 (1980) 19) and ends steps where a velocity passes zero
# or a machine breaks away, for past a kink no step of a Runge–Kutta method is exact.

# Coefficients of Dormand and Prince, 5(4) with seven stages, the last of which is the next step's
# first.
_NODES = ("0.0", "0.2", "0.3", "0.8", "8.0 / 9.0", "1.0", "1.0")
_WEIGHTS = (
    "{0}",
    "{1.0 / 5.0}",
    "{3.0 / 40.0, 9.0 / 40.0}",
    "{44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0}",
    "{19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0}",
    "{9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0}",
    "{35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0}",
)
# Difference of the weights of order 5 and of order 4: an estimate of the error of a step.
_ERRORS = (
    "71.0 / 57600.0",
    "0.0",
    "-71.0 / 16695.0",
    "71.0 / 1920.0",
    "-17253.0 / 339200.0",
    "22.0 / 525.0",
    "-1.0 / 40.0",
)


def c_stepping(name: str, states: int, surfaces: Sequence[int]) -> list[str]:
    """Lines after `NAME_rates_by_direction(t, x, u, p, s, dx)`; `surfaces` are the states that can
    stand still.
    """
    text = (
        _TEXT.replace("NAME", name)
        .replace("STATES", str(max(states, 1)))
        .replace("COUNT", str(states))
    )
    text = text.replace("SURFACES", str(max(len(surfaces), 1))).replace(
        "STANDING", str(len(surfaces))
    )
    text = text.replace("INDICES", ", ".join(map(str, surfaces)) or "0")
    text = (
        text.replace("NODES", ", ".join(_NODES))
        .replace("WEIGHTS", ", ".join(_WEIGHTS))
        .replace("ERRORS", ", ".join(_ERRORS))
    )
    return text.splitlines()


_TEXT = """\
static const int NAME_surface[] = {INDICES};

// f+ and f- of surface j, whose velocity is zero; s[j] is its direction and m[j] 0 where it rests.
static void NAME_at_rest(double t, const double *x, const double *u, const double *p, double *s, double *m, int j,
                         double *forward, double *backward)
{
    double dx[STATES];
    s[j] = 1.0;
    NAME_rates_by_direction(t, x, u, p, s, dx);
    *forward = dx[NAME_surface[j]];
    s[j] = -1.0;
    NAME_rates_by_direction(t, x, u, p, s, dx);
    *backward = dx[NAME_surface[j]];
    m[j] = 1.0;
    if (*forward > 0.0 && *forward + *backward >= 0.0) s[j] = 1.0;
    else if (*backward < 0.0) s[j] = -1.0;
    else { s[j] = 0.0; m[j] = *forward == *backward ? 1.0 : 0.0; }
}

// Directions s of all surfaces at x, and m: 1 where it moves, 0 where it rests.
void NAME_directions(double t, const double *x, const double *u, const double *p, double *s, double *m)
{
    double forward, backward;
    for (int j = 0; j < STANDING; ++j) {
        s[j] = residuum_sign(x[NAME_surface[j]]);
        m[j] = 1.0;
    }
    for (int j = 0; j < STANDING; ++j)
        if (x[NAME_surface[j]] == 0.0) NAME_at_rest(t, x, u, p, s, m, j, &forward, &backward);
}

static void NAME_moving(double t, const double *x, const double *u, const double *p, const double *s, const double *m, double *dx)
{
    NAME_rates_by_direction(t, x, u, p, s, dx);
    for (int j = 0; j < STANDING; ++j) dx[NAME_surface[j]] *= m[j];
}

void NAME_rates(double t, const double *x, const double *u, const double *p, double *dx)
{
    double s[SURFACES], m[SURFACES];
    NAME_directions(t, x, u, p, s, m);
    NAME_moving(t, x, u, p, s, m, dx);
}

// One Runge-Kutta step of length h, inputs held: the same work every time, for controllers.
void NAME_step(double t, double h, double *x, const double *u, const double *p)
{
    static const double at_node[] = {0.0, 0.5, 0.5, 1.0};
    double k[4][STATES], at[STATES], s[SURFACES], m[SURFACES], forward, backward;
    NAME_directions(t + 0.5 * h, x, u, p, s, m);
    for (int stage = 0; stage < 4; ++stage) {
        for (int i = 0; i < COUNT; ++i) at[i] = x[i] + (stage ? at_node[stage] * h * k[stage - 1][i] : 0.0);
        NAME_moving(t + at_node[stage] * h, at, u, p, s, m, k[stage]);
    }
    for (int i = 0; i < COUNT; ++i) x[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
    for (int j = 0; j < STANDING; ++j) {
        int i = NAME_surface[j];
        double side = s[j], reached = x[i], left, there;
        if (m[j] == 0.0 || side * reached >= 0.0) continue;
        x[i] = 0.0;
        NAME_at_rest(t + h, x, u, p, s, m, j, &forward, &backward);
        left = side > 0.0 ? forward : backward;
        there = side > 0.0 ? backward : forward;
        if (m[j] != 0.0) x[i] = left * there > 0.0 ? reached * there / left : reached;
    }
}

// A step of order 5 from x to y; the largest part that its error is of what the tolerance allows.
static double NAME_tried(double t, double h, const double *x, const double *u, const double *p, const double *s, const double *m,
                         double tolerance, double *y)
{
    static const double node[] = {NODES};
    static const double weight[7][6] = {WEIGHTS};
    static const double error[] = {ERRORS};
    double k[7][STATES], largest = 0.0;
    for (int stage = 0; stage < 7; ++stage) {
        for (int i = 0; i < COUNT; ++i) {
            y[i] = x[i];
            for (int r = 0; r < stage; ++r) y[i] += h * weight[stage][r] * k[r][i];
        }
        NAME_moving(t + node[stage] * h, y, u, p, s, m, k[stage]);
    }
    for (int i = 0; i < COUNT; ++i) {
        double wrong = 0.0, size = fabs(x[i]) + fabs(h * k[0][i]) + fabs(y[i] - x[i]) + 1e-200;
        for (int r = 0; r < 7; ++r) wrong += h * error[r] * k[r][i];
        if (!(fabs(wrong) / (tolerance * size) <= largest)) largest = fabs(wrong) / (tolerance * size);
    }
    return largest;
}

// Whether a step left the side of a surface that it was computed for, or a surface that rested breaks away.
static int NAME_turned(double t, const double *y, const double *u, const double *p, const double *s, const double *m)
{
    double forward, backward, as[SURFACES], am[SURFACES];
    for (int j = 0; j < STANDING; ++j) {
        as[j] = s[j];
        am[j] = m[j];
    }
    for (int j = 0; j < STANDING; ++j) {
        if (m[j] != 0.0 && s[j] * y[NAME_surface[j]] < 0.0) return 1;
        if (m[j] == 0.0) {
            NAME_at_rest(t, y, u, p, as, am, j, &forward, &backward);
            if (am[j] != 0.0) return 1;
        }
    }
    return 0;
}

// From t to t + h, inputs held, in steps whose error is below the tolerance and that end where a surface turns.
void NAME_advance(double t, double h, double *x, const double *u, const double *p, double tolerance)
{
    double done = 0.0, step = h, y[STATES], s[SURFACES], m[SURFACES];
    while (done < h) {
        double error, grown;
        NAME_directions(t + done, x, u, p, s, m);
        if (step > h - done) step = h - done;
        while ((error = NAME_tried(t + done, step, x, u, p, s, m, tolerance, y)) > 1.0 && step > 1e-12 * h)
            step *= fmax(0.1, 0.9 * pow(error, -0.2));
        if (!(error < 1e300)) { for (int i = 0; i < COUNT; ++i) x[i] = NAN; return; }
        grown = step * fmin(5.0, 0.9 * pow(error + 1e-10, -0.2));
        if (NAME_turned(t + done + step, y, u, p, s, m)) {
            double before = 0.0, after = step;
            for (int i = 0; i < 60 && after - before > 1e-15 * h; ++i) {
                double middle = 0.5 * (before + after);
                (void)NAME_tried(t + done, middle, x, u, p, s, m, tolerance, y);
                if (NAME_turned(t + done + middle, y, u, p, s, m)) after = middle;
                else before = middle;
            }
            (void)NAME_tried(t + done, after, x, u, p, s, m, tolerance, y);
            for (int j = 0; j < STANDING; ++j)
                if (m[j] != 0.0 && s[j] * y[NAME_surface[j]] < 0.0) y[NAME_surface[j]] = 0.0;
            step = after;
        }
        for (int i = 0; i < COUNT; ++i) x[i] = y[i];
        done = step >= h - done ? h : done + step;
        step = grown;
    }
}
"""
