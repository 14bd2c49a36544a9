"""A Runge–Kutta step of a structure, and of its sensitivities, as LLVM assembly: unrolled over the
states.

What is done for each column of S takes the most code and asks of the equations only how many states
and outputs there are and what is always zero in A and B. So it stands apart, in `columns` and
`observed`, and is compiled once for all structures alike.

    advance(x, u₀, u₁, u₂, p, s, m, work, step)
    advance_slopes(x, u₀, u₁, u₂, p, s, m, work, step, S, columns, count)
    observe(x, u, ur, p, s, m, work, y, dy, S, columns, count)

`u₀ u₁ u₂` are the inputs at the beginning, middle and end of the step, each followed by its slopes;
`step` holds its length h. With k₁ … k₄ the rates of the four stages, x ← x + h/6·(k₁ + 2k₂ + 2k₃ +
k₄); a column of S obeys d = A·S + B, A and B taken at the same four stages, so S stays the exact
derivative of the computed x. `work`, of 5·NX + 4·NX·(NP + 2·NX) doubles (NY·(NP
+ 2·NX) for `observe`), is zero at first: the places of A and B that are always zero are never
  written. No two arrays
overlap, so that what depends on p alone is computed once a step.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import reduce

FREE = "nsz arcp contract"
"""What the compiler may do beyond IEEE 754: share a reciprocal, fuse a product with a sum."""
_VECTORS = (4, 1)
"""Columns side by side in a vector, the widest first."""
_STAGES = ("0", "1", "1", "2")
"""Which of the three inputs each stage takes."""


Places = Collection[tuple[int, int]]
"""Row and column of what need not be zero in a matrix."""


_COLUMNS = (
    "ptr noalias %work, ptr noalias {0}, ptr noalias %S, ptr noalias %columns, i64 %count, i64 {1}"
)
"""Of `columns`, whose second argument is `step`, and of `observed`, whose second is `dy`; the last
is the width of B.
"""


def stepping(nx: int, nu: int, n_p: int, ny: int) -> str:
    """The assembly of the three functions for so many states, inputs, parameters and outputs.

    They call `rates`, `slopes`, `outputs` and `output_slopes` beside them, and what `columns_of`
    gives.
    """
    declared = [
        f"declare void @{name}(ptr, ptr, ptr, ptr, i64, i64)" for name in ("columns", "observed")
    ]
    return "\n\n".join(
        [*declared, _advance(nx, nu), _advance(nx, nu, n_p + nx), _observe(nx, ny, n_p + nx)]
    )


def columns_of(nx: int, ny: int, A: Places, B: Places) -> tuple[str, str]:
    """The assembly of `columns` and of `observed`, a module each; `A` and `B` say where slopes need
    not be zero.
    """
    return _columns(nx, A, {row for row, _ in B}), _observed(nx, ny)


class _Lines:
    """Assembly text while it is written; every value has a name of its own. Sums and products are
    of `kind`.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.kind = "double"

    def new(self, operation: str) -> str:
        name = f"%t{len(self.lines)}"
        self.lines.append(f"  {name} = {operation}")
        return name

    def place(self, array: str, index: int | str) -> str:
        return self.new(f"getelementptr double, ptr {array}, i64 {index}")

    def load(self, array: str, index: int | str) -> str:
        return self.new(f"load double, ptr {self.place(array, index)}")

    def store(self, value: str, array: str, index: int | str) -> None:
        self.lines.append(f"  store double {value}, ptr {self.place(array, index)}")

    def add(self, a: str, b: str) -> str:
        return self.new(f"fadd {FREE} {self.kind} {a}, {b}")

    def times(self, a: str, b: str) -> str:
        return self.new(f"fmul {FREE} {self.kind} {a}, {b}")

    def say(self, line: str) -> None:
        self.lines.append(line)

    def ended(self) -> str:
        """The text of a function that returns here."""
        return "\n".join([*self.lines, "  ret void", "}"]) + "\n"


def _advance(nx: int, nu: int, width: int | None = None) -> str:
    """With the sensitivities where the width of B is given."""
    t = _Lines()
    slopes = width is not None
    t.say(
        f"define void @{'advance_slopes' if slopes else 'advance'}({_advance_arguments(slopes)}) {{"
    )
    h, half, sixth, third = _lengths(t)
    # Kept in registers: x itself is overwritten at the end of the step only.
    x0 = [t.load("%x", i) for i in range(nx)]
    # Behind the four rates.
    xs = t.place("%work", 4 * nx)
    results = list(zip(*_slope_places(t, nx, str(width)), strict=True)) if slopes else [None] * 4
    # Each set of inputs has time after them, then their slopes.
    slopes_of_inputs = [t.place(f"%u{j}", nu + 1) for j in range(3)]
    rates: list[list[str]] = []
    for r, reach in enumerate((half, half, h, None)):
        k = t.place("%work", r * nx)
        j = int(_STAGES[r])
        inputs = f"ptr %u{j}, ptr {slopes_of_inputs[j]}"
        rates.append(_stage(t, inputs, k, "%x" if r == 0 else xs, results[r], nx))
        if reach is not None:
            _move(t, x0, reach, rates[r], xs)
    for i, of_stages in enumerate(zip(*rates, strict=True)):
        t.store(_weighted(t, x0[i], of_stages, sixth, third), "%x", i)
    if slopes:
        t.say(f"  call void @columns({_COLUMNS.format('%step', width).replace('noalias ', '')})")
    return t.ended()


def _advance_arguments(slopes: bool) -> str:
    arrays = ["x", "u0", "u1", "u2", "p", "s", "m", "work", "step"]
    if slopes:
        arrays += ["S", "columns"]
    arguments = [f"ptr noalias %{array}" for array in arrays]
    return ", ".join([*arguments, "i64 %count"] if slopes else arguments)


def _columns(nx: int, A: Places, rows: Collection[int]) -> str:
    t = _Lines()
    t.say(f"define void @columns({_COLUMNS.format('%step', '%width')}) {{\nentry:")
    lengths = _lengths(t)
    # Rows of B that are zero throughout are left out.
    begins = {i: t.new(f"mul i64 %width, {i}") for i in sorted(rows)}
    matrices = _slope_places(t, nx, "%width")
    in_rows = [[j for j in range(nx) if (i, j) in A] for i in range(nx)]
    _columns_loop(t, lambda column: _column_step(t, in_rows, begins, matrices, column, lengths))
    return t.ended()


def _lengths(t: _Lines) -> tuple[str, str, str, str]:
    """Of a step: the whole, a half, a sixth and a third."""
    h = t.load("%step", 0)
    half = t.times(h, "0.5")
    sixth = t.new(f"fdiv double {h}, 6.0")
    return h, half, sixth, t.add(sixth, sixth)


def _slope_places(t: _Lines, nx: int, width: str) -> tuple[list[str], list[str]]:
    """Where in the working memory the slopes of each stage by states and by parameters stand."""
    *A, behind = (t.place("%work", 5 * nx + r * nx * nx) for r in range(5))
    return A, [t.place(behind, t.new(f"mul i64 {width}, {r * nx}")) for r in range(4)]


def _stage(
    t: _Lines, inputs: str, k: str, at: str, results: tuple[str, str] | None, nx: int
) -> list[str]:
    """Rates, written to k, of a stage at the states `at` with these inputs and their slopes; with
    slopes of the rates where there are places for these results.
    """
    inputs = f"{inputs}, ptr %p, ptr %s, ptr %m"
    function, written = ("slopes", (k, *results)) if results else ("rates", (k, k, k))
    t.say(f"  call void @{function}(ptr {at}, {inputs}, {', '.join(f'ptr {q}' for q in written)})")
    return [t.load(k, i) for i in range(nx)]


def _move(t: _Lines, x0: list[str], reach: str, rates: list[str], xs: str) -> None:
    """The states xs of the next stage: x0 + reach · rates."""
    for i, rate in enumerate(rates):
        t.store(t.add(x0[i], t.times(reach, rate)), xs, i)


class _Column:
    """One sensitivity column, or as many as a vector holds side by side: how their values are read,
    written and repeated.
    """

    def __init__(self, t: _Lines, c: str, together: int) -> None:
        self.t = t
        self.c = c
        self.together = together
        # Sums and products are written for the width of this column.
        t.kind = "double" if together == 1 else f"<{together} x double>"
        numbers = [c] + [t.new(f"add i64 {c}, {lane}") for lane in range(1, together)]
        self.columns = [
            t.new(f"load i64, ptr {t.new(f'getelementptr i64, ptr %columns, i64 {number}')}")
            for number in numbers
        ]

    def load(self, array: str, row: int) -> str:
        """Of an array with a place for each column in every row."""
        return self.t.new(f"load {self.t.kind}, ptr {self._place(array, row)}, align 8")

    def store(self, value: str, array: str, row: int) -> None:
        """Into such an array."""
        self.t.say(f"  store {self.t.kind} {value}, ptr {self._place(array, row)}, align 8")

    def pick(self, array: str, row: str) -> str:
        """Of a row of a matrix, which begins at `row`, the values in the places that the columns
        name.
        """
        t = self.t
        values = [t.load(array, t.new(f"add i64 {row}, {column}")) for column in self.columns]
        return values[0] if self.together == 1 else self._joined(values)

    def all(self, value: str) -> str:
        """The same value for every column."""
        if self.together == 1:
            return value
        # The first place, then that one everywhere: LLVM's idiom for a broadcast.
        first = self.t.new(f"insertelement {self.t.kind} poison, double {value}, i32 0")
        return self.t.new(
            f"shufflevector {self.t.kind} {first}, {self.t.kind} poison, <{self.together} x i32>"
            " zeroinitializer"
        )

    def _joined(self, values: Sequence[str]) -> str:
        joined = "poison"
        for lane, value in enumerate(values):
            joined = self.t.new(f"insertelement {self.t.kind} {joined}, double {value}, i32 {lane}")
        return joined

    def _place(self, array: str, row: int) -> str:
        return self.t.place(
            array, self.t.new(f"add i64 {self.t.new(f'mul i64 {row}, %count')}, {self.c}")
        )


def _column_step(
    t: _Lines,
    rows: Sequence[Sequence[int]],
    begins: Mapping[int, str],
    matrices: tuple[Sequence[str], Sequence[str]],
    column: _Column,
    lengths: tuple[str, str, str, str],
) -> None:
    """One step of d = A·S + B for one column of S, or those of a vector. Of row i of A only the
    columns rows[i] are read, and of B only the rows that `begins` has: all else is always zero.
    """
    nx = len(rows)
    h, half, sixth, third = map(column.all, lengths)
    S0 = [column.load("%S", i) for i in range(nx)]
    S = S0
    stages = []
    # where the stage after each one stands in the step; after the last none is asked for
    reaches = (half, half, h, half)
    for A, B, reach in zip(*matrices, reaches, strict=True):
        d = []
        for i, in_row in enumerate(rows):
            terms = [column.pick(B, begins[i])] if i in begins else []
            terms += [t.times(column.all(t.load(A, i * nx + j)), S[j]) for j in in_row]
            d.append(reduce(t.add, terms) if terms else column.all("0.0"))
        stages.append(d)
        S = [t.add(S0[i], t.times(reach, d[i])) for i in range(nx)]
    for i in range(nx):
        column.store(_weighted(t, S0[i], [d[i] for d in stages], sixth, third), "%S", i)


def _columns_loop(t: _Lines, body: Callable[[_Column], None]) -> None:
    """Do `body` for all sensitivity columns, as many side by side as a vector holds, then for those
    left one by one.
    """
    first = "0"
    begun = "entry"
    for together in _VECTORS:
        n = str(together)
        t.say(
            f"  br label %head{n}\nhead{n}:\n  %c{n} = phi i64 [ {first}, %{begun} ], [ %next{n},"
            f" %body{n} ]"
        )
        t.say(f"  %next{n} = add i64 %c{n}, {n}\n  %more{n} = icmp sle i64 %next{n}, %count")
        t.say(f"  br i1 %more{n}, label %body{n}, label %done{n}\nbody{n}:")
        body(_Column(t, f"%c{n}", together))
        t.say(f"  br label %head{n}\ndone{n}:")
        first = f"%c{n}"
        begun = f"done{n}"
    t.kind = "double"


def _weighted(t: _Lines, start: str, k: Sequence[str], sixth: str, third: str) -> str:
    # x + h/6·(k₁ + k₄) + h/3·(k₂ + k₃).
    outer = t.times(sixth, t.add(k[0], k[3]))
    return t.add(start, t.add(outer, t.times(third, t.add(k[1], k[2]))))


def _observe(nx: int, ny: int, width: int) -> str:
    t = _Lines()
    arrays = ("x", "u", "ur", "p", "s", "m", "work", "y", "dy", "S", "columns")
    t.say(f"define void @observe({', '.join(f'ptr noalias %{a}' for a in arrays)}, i64 %count) {{")
    given = ", ".join(f"ptr %{a}" for a in arrays[:6])
    t.say(f"  call void @outputs({given}, ptr %y, ptr %work, ptr %work)")
    # Without columns only the outputs are asked for.
    t.say("  %none = icmp eq i64 %count, 0\n  br i1 %none, label %end, label %slopes\nslopes:")
    t.say(
        f"  call void @output_slopes({given}, ptr %work, ptr {t.place('%work', ny * nx)}, ptr"
        " %work)"
    )
    t.say(
        f"  call void @observed({_COLUMNS.format('%dy', width).replace('noalias ', '')})\n  br"
        " label %end\nend:"
    )
    return t.ended()


def _observed(nx: int, ny: int) -> str:
    t = _Lines()
    t.say(f"define void @observed({_COLUMNS.format('%dy', '%width')}) {{\nentry:")
    D = t.place("%work", ny * nx)
    # The same for all columns: loaded before the loop.
    C = [[t.load("%work", o * nx + i) for i in range(nx)] for o in range(ny)]
    begins = [t.new(f"mul i64 %width, {o}") for o in range(ny)]

    def column_of(column: _Column) -> None:
        S = [column.load("%S", i) for i in range(nx)]
        for o in range(ny):
            total = column.pick(D, begins[o])
            for i in range(nx):
                total = t.add(total, t.times(column.all(C[o][i]), S[i]))
            column.store(total, "%dy", o)

    _columns_loop(t, column_of)
    return t.ended()
