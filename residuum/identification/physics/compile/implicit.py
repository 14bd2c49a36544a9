"""Variables that balances without storage define together, or not linearly: the root z of g(z, a) =
0, a what they depend on.

By Newton's method with the exact Jacobian J = ∂g/∂z, each step halved until ‖g‖ falls, from a start
value; NaN where it finds no root. The root's own slopes are exact, by the implicit function
theorem: ∂z/∂a = −J⁻¹ ∂g/∂a.

Reference: U. M. Ascher, L. R. Petzold, *Computer Methods for Ordinary Differential Equations*, SIAM
1998, ch. 9 (index 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp

MOST_VARIABLES = 4
"""That balances may define together: J is inverted by its adjugate."""
# Halvings of a step among them.
MOST_STEPS = 60


class Root(sp.Function):
    """`Root(i, z, a, g, start, *values)`: element i of the root of g(z, a) = 0 where a has these
    values.
    """

    is_real = True


def roots(
    unknown: Sequence[Any], equations: Sequence[Any], start: Sequence[float], known: dict[Any, Any]
) -> list[Any]:
    """The unknown symbols as roots of the equations; `known` has values for what else those
    hold.
    """
    known_symbols = sorted(
        {s for e in equations for s in e.free_symbols} - set(unknown), key=lambda s: s.name
    )
    # Neutral names: systems that are alike but for names share their code.
    z = [sp.Symbol(f"root_z_{k}", real=True) for k in range(len(unknown))]
    a = [sp.Symbol(f"root_a_{k}", real=True) for k in range(len(known_symbols))]
    inside = dict(zip([*unknown, *known_symbols], [*z, *a], strict=True))
    system = (
        sp.Tuple(*z),
        sp.Tuple(*a),
        sp.Tuple(*(e.xreplace(inside) for e in equations)),
        sp.Tuple(*map(sp.Float, start)),
    )
    return [
        Root(sp.Integer(i), *system, *(known.get(s, s) for s in known_symbols))
        for i in range(len(z))
    ]


def jacobian(z: Sequence[Any], g: Sequence[Any]) -> Any:
    """∂g/∂z."""
    return sp.Matrix([[sp.diff(e, k) for k in z] for e in g])


def solved(J: Sequence[Sequence[Any]], right: Sequence[Any]) -> list[Any]:
    """J⁻¹ right, by Cramer's rule."""
    matrix = sp.Matrix(J)
    # Cramer rather than elimination: a pivot would have to be chosen by values that are not known
    # yet.
    return list(matrix.adjugate() * sp.Matrix(right) / matrix.det(method="berkowitz"))


def newton(name: str, start: Sequence[float]) -> str:
    """The assembly of `void name(a, z)`, which calls `name_step(a, z, …, r)`: r = Newton's next z,
    then ‖g‖² at this z.
    """
    m = len(start)
    lines = [f"define void @{name}(ptr %a, ptr %z) {{", "entry:"]
    lines += [f"  %{array} = alloca [{m + 1} x double]" for array in ("at", "to", "r")]
    for k, value in enumerate(start):
        lines += [
            f"  %{x}e{k} = getelementptr double, ptr %{x}, i64 {k}" for x in ("z", "at", "to", "r")
        ]
        lines += [f"  store double {value!r}, ptr %{x}e{k}" for x in ("z", "at", "to")]
    lines += [f"  %merit = getelementptr double, ptr %r, i64 {m}", "  br label %loop", "loop:"]
    lines += [
        "  %n = phi i64 [ 0, %entry ], [ %n1, %loop ]",
        "  %least = phi double [ 0x7FF0000000000000, %entry ], [ %best, %loop ]",
    ]
    lines += ["  %length = phi double [ 1.0, %entry ], [ %next, %loop ]"]
    lines += [
        f"  call void @{name}_step(ptr %a, ptr %z, {'ptr null, ' * 4}ptr %r, ptr null, ptr null)"
    ]
    # ‖g‖² fell: this z is kept as the best one, and the next step is tried whole. Else half a step
    # from the best.
    lines += ["  %m = load double, ptr %merit", "  %falls = fcmp olt double %m, %least"]
    lines += [
        "  %best = select i1 %falls, double %m, double %least",
        "  %half = fmul double %length, 0.5",
    ]
    lines += ["  %next = select i1 %falls, double 1.0, double %half"]
    still = "false"
    apart = "false"
    for k in range(m):
        lines += [f"  %{x}v{k} = load double, ptr %{x}e{k}" for x in ("z", "at", "to", "r")]
        lines += [f"  %p{k} = select i1 %falls, double %zv{k}, double %atv{k}"]
        lines += [f"  %q{k} = select i1 %falls, double %rv{k}, double %tov{k}"]
        lines += [f"  store double %p{k}, ptr %ate{k}", f"  store double %q{k}, ptr %toe{k}"]
        lines += [
            f"  %d{k} = fsub double %q{k}, %p{k}",
            f"  %s{k} = fmul double %d{k}, %next",
            f"  %w{k} = fadd double %p{k}, %s{k}",
        ]
        lines += [
            f"  store double %w{k}, ptr %ze{k}",
            f"  %size{k} = call double @llvm.fabs.f64(double %p{k})",
        ]
        lines += [
            f"  %far{k} = call double @llvm.fabs.f64(double %d{k})",
            f"  %step{k} = call double @llvm.fabs.f64(double %s{k})",
        ]
        lines += [
            # 0x3CC0… = 2⁻⁵¹: the step no longer changes the value but in its last digits.
            f"  %tiny{k} = fmul double %size{k}, 0x3CC0000000000000",
            f"  %moves{k} = fcmp ogt double %step{k}, %tiny{k}",
        ]
        lines += [
            # A root where the whole step is below a billionth of the value: else Newton ended
            # elsewhere.
            f"  %l{k} = fmul double %size{k}, 1.0e-9",
            f"  %limit{k} = fadd double %l{k}, 1.0e-12",
        ]
        lines += [f"  %off{k} = fcmp ugt double %far{k}, %limit{k}"]
        lines += [
            f"  %still{k} = or i1 {still}, %moves{k}",
            f"  %apart{k} = or i1 {apart}, %off{k}",
        ]
        still = f"%still{k}"
        apart = f"%apart{k}"
    lines += [
        "  %n1 = add i64 %n, 1",
        f"  %more = icmp slt i64 %n1, {MOST_STEPS}",
        f"  %go = and i1 %more, {still}",
    ]
    lines += [
        "  br i1 %go, label %loop, label %end",
        "end:",
        "  %none = fcmp oeq double %best, 0x7FF0000000000000",
    ]
    lines += [f"  %failed = or i1 %none, {apart}"]
    for k in range(m):
        lines += [
            f"  %f{k} = select i1 %failed, double 0x7FF8000000000000, double %p{k}",
            f"  store double %f{k}, ptr %ze{k}",
        ]
    return "\n".join([*lines, "  ret void", "}"])
