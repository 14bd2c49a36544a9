"""A controller as one file of C99 without dependencies."""

from __future__ import annotations

import math
from collections.abc import Iterable

from residuum.robust_control.controller_export.difference_equation import DifferenceEquation

_TEMPLATE = """\
/* {equation}
   Sample time {sample_time:.12g} s. Call controller_step once per sample with e = reference - measurement.
   controller_self_test returns 0 when this machine computes what the design computed; to run it on its own:
       cc -std=c99 -DCONTROLLER_SELF_TEST controller.c -lm && ./a.out && echo right */
#include <math.h>
#include <string.h>

#define CONTROLLER_ORDER {order}

typedef struct {{
    double e[CONTROLLER_ORDER + 1];  /* e(k), e(k-1), ... */
    double u[CONTROLLER_ORDER + 1];  /* u(k-1), u(k-2), ...; the last one is not used */
}} controller_state;

static const double controller_b[CONTROLLER_ORDER + 1] = {{{b}}};
static const double controller_a[CONTROLLER_ORDER + 1] = {{{a}}};

void controller_reset(controller_state *state) {{ memset(state, 0, sizeof *state); }}

double controller_step(controller_state *state, double error)
{{
    double u = 0.0;
    int i;
    for (i = CONTROLLER_ORDER; i > 0; --i) state->e[i] = state->e[i - 1];
    state->e[0] = error;
    for (i = 0; i <= CONTROLLER_ORDER; ++i) u += controller_b[i] * state->e[i];
    for (i = 0; i < CONTROLLER_ORDER; ++i) u -= controller_a[i] * state->u[i];
{limits}    for (i = CONTROLLER_ORDER; i > 0; --i) state->u[i] = state->u[i - 1];
    state->u[0] = u;
    return u;
}}

int controller_self_test(void)
{{
    static const double error[{samples}] = {{{test_e}}};
    static const double expected[{samples}] = {{{test_u}}};
    controller_state state;
    int k;
    controller_reset(&state);
    for (k = 0; k < {samples}; ++k) {{
        double u = controller_step(&state, error[k]);
        if (!(fabs(u - expected[k]) <= {tolerance:.3g})) return k + 1;
    }}
    return 0;
}}

#ifdef CONTROLLER_SELF_TEST
int main(void) {{ return controller_self_test(); }}
#endif
"""


def c_source(equation: DifferenceEquation) -> str:
    """C99 of the equation: `controller_reset`, `controller_step`, and `controller_self_test` (0, or 1 + the failing sample)."""
    e, u = equation.self_test()
    return _TEMPLATE.format(
        equation=equation.text().replace("−", "-"),
        sample_time=equation.sample_time,
        order=equation.order,
        b=_list(equation.b),
        a=_list([*equation.a, 0.0]),
        limits="".join(_limits(equation)),
        samples=len(e),
        test_e=_list(e),
        test_u=_list(u),
        tolerance=1e-9 * max(1.0, float(abs(u).max())),
    )


def _list(values: Iterable[float]) -> str:
    return ", ".join(repr(float(value)) for value in values)


def _limits(equation: DifferenceEquation) -> list[str]:
    found = []
    if math.isfinite(equation.lower):
        found.append(f"    if (u < {float(equation.lower)!r}) u = {float(equation.lower)!r};\n")
    if math.isfinite(equation.upper):
        found.append(f"    if (u > {float(equation.upper)!r}) u = {float(equation.upper)!r};\n")
    return found
