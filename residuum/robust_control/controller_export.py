"""Controllers for the target: difference equation, IEC 61131-3 structured text and C, each with its
self-test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction

# The difference equation of a controller with saturation, and the vector that an implementation
# is tested with.


@dataclass(frozen=True, eq=False)
class DifferenceEquation:
    r"""u(k) = sat(Σ b_i e(k−i) − Σ a_i u(k−i)), i = 0…n and 1…n.

    The past u on the right are the saturated ones: the equation goes on from what the actuator did,
    which is conditioned anti-windup (R. Hanus, M. Kinnaert, J.-L. Henrotte, *Conditioning
    technique*, Automatica 23 (1987) 729–739). Without saturation it is K(z) exactly.

    Parameters
    ----------
    controller : TransferFunction
        K(z), proper.
    lower, upper : float
        Limits of the actuator in the unit of u; infinite when there are none.

    Raises
    ------
    BadInput
        Continuous-time or improper controller, lower ≥ upper.

    Examples
    --------
    >>> integral = DifferenceEquation(TransferFunction([0.5, 0.0], [1.0, -1.0], 1.0), -1.0, 1.0)
    >>> integral.run(np.array([1.0, 1.0, 1.0, 1.0, -1.0])).tolist()
    [0.5, 1.0, 1.0, 1.0, 0.5]
    """

    controller: TransferFunction
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        if self.controller.sample_time is None or not self.controller.is_proper:
            raise BadInput("controller export: the controller must be discrete-time and proper")
        if not self.lower < self.upper:
            raise BadInput(
                f"controller export: limits {self.lower!r} and {self.upper!r}; the lower must be"
                " below the upper"
            )

    @property
    def sample_time(self) -> float:
        """Ts [s]."""
        return float(self.controller.sample_time or 0.0)

    @property
    def b(self) -> FloatArray:
        """b_0 … b_n, of e."""
        missing = len(self.controller.den) - len(self.controller.num)
        return np.concatenate([np.zeros(missing), self.controller.num]) / self.controller.den[0]

    @property
    def a(self) -> FloatArray:
        """a_1 … a_n, of u."""
        return np.asarray(self.controller.den[1:] / self.controller.den[0])

    @property
    def order(self) -> int:
        """n."""
        return len(self.a)

    def run(self, e: npt.ArrayLike) -> FloatArray:
        """u for the control error e from rest, shape (n,)."""
        e = np.asarray(e, dtype=float)
        padded, u = np.concatenate([np.zeros(self.order), e]), np.zeros(self.order + len(e))
        b, a = self.b[::-1], self.a[::-1]
        for k in range(len(e)):
            wanted = b @ padded[k : k + self.order + 1] - a @ u[k : k + self.order]
            u[k + self.order] = min(max(wanted, self.lower), self.upper)
        return u[self.order :]

    def text(self) -> str:
        """The equation in words of one line."""
        # Seventeen digits give a double back exactly.
        terms = [f"{value:+.17g} e(k{_lag(i)})" for i, value in enumerate(self.b)]
        terms += [f"{-value:+.17g} u(k{_lag(i)})" for i, value in enumerate(self.a, start=1)]
        wanted = " ".join(terms)
        bounded = math.isfinite(self.lower) or math.isfinite(self.upper)
        return (
            f"u(k) = sat({wanted}; {self.lower:g}, {self.upper:g})"
            if bounded
            else f"u(k) = {wanted}"
        )

    def self_test(self, samples: int = 24) -> tuple[FloatArray, FloatArray]:
        """(e, u): a step up that reaches a finite limit where there is one, a step back, a ramp and
        zero.
        """
        shape = np.concatenate(
            [np.ones(8), -np.ones(6), np.linspace(-1.0, 1.0, 6), np.zeros(max(0, samples - 20))]
        )[:samples]
        wanted = np.abs(DifferenceEquation(self.controller).run(shape)).max()
        limits = [
            abs(limit) for limit in (self.lower, self.upper) if math.isfinite(limit) and limit != 0
        ]
        # An error for which the controller wants twice the largest limit: the test sees the actuator
        # saturate and come back.
        e = shape * (2.0 * max(limits) / wanted if limits and wanted > 0 else 1.0)
        return e, self.run(e)


def _lag(i: int) -> str:
    return "" if i == 0 else f"−{i}"


# A controller as one file of C99 without dependencies.

_C = """\
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
    """C99 of the equation: `controller_reset`, `controller_step`, and `controller_self_test` (0, or
    1 + the failing sample).
    """
    e, u = equation.self_test()
    return _C.format(
        equation=equation.text().replace("−", "-"),
        sample_time=equation.sample_time,
        order=equation.order,
        b=_c_list(equation.b),
        # C has no array without elements, which a static gain would need for its past outputs.
        a=_c_list([*equation.a, 0.0]),
        limits="".join(_c_limits(equation)),
        samples=len(e),
        test_e=_c_list(e),
        test_u=_c_list(u),
        # compilers may order or fuse the sums otherwise, which changes their rounding alone
        tolerance=1e-9 * max(1.0, float(abs(u).max())),
    )


def _c_list(values: Iterable[float]) -> str:
    # The shortest text that gives the double back.
    return ", ".join(repr(float(value)) for value in values)


def _c_limits(equation: DifferenceEquation) -> list[str]:
    lines = []
    if math.isfinite(equation.lower):
        lines.append(f"    if (u < {float(equation.lower)!r}) u = {float(equation.lower)!r};\n")
    if math.isfinite(equation.upper):
        lines.append(f"    if (u > {float(equation.upper)!r}) u = {float(equation.upper)!r};\n")
    return lines


# A controller as a function block of IEC 61131-3 structured text.

_STRUCTURED_TEXT = """\
(* {equation}
   Call once per sample, every {period}, with Error := reference - measurement. Reset := TRUE clears the past.
   RobustControllerTest.Failed stays 0 when this controller computes what the design computed. *)
FUNCTION_BLOCK RobustController
VAR_INPUT
    Error : LREAL;
    Reset : BOOL;
END_VAR
VAR_OUTPUT
    Output : LREAL;
END_VAR
VAR
    b : ARRAY[0..{order}] OF LREAL := [{b}];
    a : ARRAY[0..{order}] OF LREAL := [{a}];
    e : ARRAY[0..{order}] OF LREAL;
    u : ARRAY[0..{order}] OF LREAL;
    i : INT;
END_VAR
IF Reset THEN
    FOR i := 0 TO {order} DO
        e[i] := 0.0;
        u[i] := 0.0;
    END_FOR;
    Output := 0.0;
    RETURN;
END_IF;
FOR i := {order} TO 1 BY -1 DO
    e[i] := e[i - 1];
    u[i] := u[i - 1];
END_FOR;
e[0] := Error;
Output := b[0] * e[0];
FOR i := 1 TO {order} DO
    Output := Output + b[i] * e[i] - a[i] * u[i];
END_FOR;
{limits}u[0] := Output;
END_FUNCTION_BLOCK

FUNCTION_BLOCK RobustControllerTest
VAR_OUTPUT
    Failed : INT;
END_VAR
VAR
    Controller : RobustController;
    TestError : ARRAY[1..{samples}] OF LREAL := [{test_e}];
    Expected : ARRAY[1..{samples}] OF LREAL := [{test_u}];
    k : INT;
END_VAR
Failed := 0;
Controller(Error := 0.0, Reset := TRUE);
FOR k := 1 TO {samples} DO
    Controller(Error := TestError[k], Reset := FALSE);
    IF (Failed = 0) AND (ABS(Controller.Output - Expected[k]) > {tolerance}) THEN
        Failed := k;
    END_IF;
END_FOR;
END_FUNCTION_BLOCK
"""


def structured_text(equation: DifferenceEquation) -> str:
    """Function blocks `RobustController` and `RobustControllerTest` (Failed = 0, or the first
    sample that differs).
    """
    e, u = equation.self_test()
    return _STRUCTURED_TEXT.format(
        equation=equation.text().replace("−", "-"),
        period=_duration(equation.sample_time),
        order=equation.order,
        b=_text_list(equation.b),
        a=_text_list([0.0, *equation.a]),
        limits="".join(_text_limits(equation)),
        samples=len(e),
        test_e=_text_list(e),
        test_u=_text_list(u),
        tolerance=_real(1e-9 * max(1.0, float(abs(u).max()))),
    )


def _duration(seconds: float) -> str:
    return f"T#{1e3 * seconds:g}ms" if seconds < 1 else f"T#{seconds:g}s"


def _real(value: float) -> str:
    """A literal with the decimal point that the standard demands before an exponent."""
    text = repr(float(value))
    mantissa, mark, exponent = text.partition("e")
    return text if "." in mantissa else f"{mantissa}.0{mark}{exponent}"


def _text_list(values: Iterable[float]) -> str:
    return ", ".join(_real(value) for value in values)


def _text_limits(equation: DifferenceEquation) -> list[str]:
    lines = []
    if math.isfinite(equation.lower):
        lines.append(f"Output := MAX(Output, {_real(equation.lower)});\n")
    if math.isfinite(equation.upper):
        lines.append(f"Output := MIN(Output, {_real(equation.upper)});\n")
    return lines


LANGUAGES: dict[str, Callable[[DifferenceEquation], str]] = {"c": c_source, "st": structured_text}
"""Name on the command line → source text of a difference equation."""
