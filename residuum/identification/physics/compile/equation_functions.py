"""Functions of a model's equations that SymPy does not know: stairs, and what a compiled library
computes.

`ExternalValue(k, t, x…, u…)` is the k-th of the library's values at a time, states and inputs; its
slopes by them are `ExternalSlope(k, j, t, x…, u…)`. Generated code calls them by the names in
`SYMBOLS`; which library a structure calls, the texts of its expressions say (`EXTERNAL_TEXT`), and
it is linked to the functions of that one (`machine_code.LIBRARIES`).
"""

from __future__ import annotations

from typing import Any

import sympy as sp

SYMBOLS = ("external_value", "external_slope")
"""double external_value(i64 k, double *arguments) and double external_slope(i64 k, i64 j, double
*arguments).
"""


class ExternalSlope(sp.Function):
    """The slope of value k by argument j; its own slopes are taken for nothing."""

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Nothing."""
        return sp.S.Zero

    def _eval_is_extended_real(self) -> bool:
        return True


class ExternalValue(sp.Function):
    """Value k at the arguments."""

    def fdiff(self, argindex: int = 1) -> Any:
        """The slope by the argument of this index, the first being the number of the value."""
        return ExternalSlope(self.args[0], sp.Integer(argindex - 2), *self.args[1:])

    def _eval_is_extended_real(self) -> bool:
        return True


class SteppedRound(sp.Function):
    """Rounding to the nearest integer, with the derivative of the line through the stairs: 1."""

    nargs = 1

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """The line's slope."""
        return sp.S.One
