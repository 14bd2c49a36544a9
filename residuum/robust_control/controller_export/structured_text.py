"""A controller as a function block of IEC 61131-3 structured text."""

from __future__ import annotations

import math
from collections.abc import Iterable

from residuum.robust_control.controller_export.difference_equation import DifferenceEquation

_TEMPLATE = """\
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
    """Function blocks `RobustController` and `RobustControllerTest` (Failed = 0, or the first sample that differs)."""
    e, u = equation.self_test()
    return _TEMPLATE.format(
        equation=equation.text().replace("−", "-"),
        period=_duration(equation.sample_time),
        order=equation.order,
        b=_list(equation.b),
        a=_list([0.0, *equation.a]),
        limits="".join(_limits(equation)),
        samples=len(e),
        test_e=_list(e),
        test_u=_list(u),
        tolerance=_real(1e-9 * max(1.0, float(abs(u).max()))),
    )


def _duration(seconds: float) -> str:
    return f"T#{1e3 * seconds:g}ms" if seconds < 1 else f"T#{seconds:g}s"


def _real(value: float) -> str:
    """A literal with the decimal point that the standard demands before an exponent."""
    text = repr(float(value))
    mantissa, mark, exponent = text.partition("e")
    return text if "." in mantissa else f"{mantissa}.0{mark}{exponent}"


def _list(values: Iterable[float]) -> str:
    return ", ".join(_real(value) for value in values)


def _limits(equation: DifferenceEquation) -> list[str]:
    found = []
    if math.isfinite(equation.lower):
        found.append(f"Output := MAX(Output, {_real(equation.lower)});\n")
    if math.isfinite(equation.upper):
        found.append(f"Output := MIN(Output, {_real(equation.upper)});\n")
    return found
