"""Linear discrete-time systems in state-space form: x⁺ = A x + B v, w = C x + D v."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import linalg

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.kept_loops import njit

_WORTH_MODES = 4  # states from which a recursion by modes is faster
_PARALLEL_MODES = 1e6  # condition of the modes from which six digits would be lost


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x(t+1) = A x(t) + B v(t), w(t) = C x(t) + D v(t).

    Parameters
    ----------
    A, B, C, D : arrays, shapes (n, n), (n, q), (p, n), (p, q)
        n may be 0 (a constant gain D).
    sample_time : float
        Sample time [s].

    Raises
    ------
    BadModel
        Shapes that do not fit together, non-finite entries, non-positive sample time.

    Examples
    --------
    >>> lag = StateSpace.from_transfer_function(TransferFunction([0.5], [1.0, -0.5], sample_time=1.0))
    >>> lag.is_stable, float(lag.frequency_response([0.0])[0, 0, 0].real)
    (True, 1.0)
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    sample_time: float

    def __post_init__(self) -> None:
        for name in "ABCD":
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=float))
        n, (p, q) = self.A.shape[0], self.D.shape
        if self.A.shape != (n, n) or self.B.shape != (n, q) or self.C.shape != (p, n):
            shapes = [getattr(self, name).shape for name in "ABCD"]
            raise BadModel(
                f"StateSpace: A, B, C, D have shapes {shapes}; they must be (n, n), (n, q), (p, n),"
                " (p, q)"
            )
        if not all(np.isfinite(getattr(self, name)).all() for name in "ABCD"):
            raise BadModel("StateSpace: has a non-finite entry; all must be finite")
        if not self.sample_time > 0:
            raise BadModel(f"StateSpace, sample_time: {self.sample_time!r}; must be positive")

    @classmethod
    def gain(cls, D: npt.ArrayLike, sample_time: float) -> StateSpace:
        """The system without memory w = D v."""
        D = np.atleast_2d(np.asarray(D, dtype=float))
        return cls(
            np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((D.shape[0], 0)), D, sample_time
        )

    @classmethod
    def from_transfer_function(cls, system: TransferFunction) -> StateSpace:
        """Controllable companion form of a proper discrete-time transfer function; BadModel for any
        other.
        """
        if system.sample_time is None:
            raise BadModel(
                "StateSpace: the transfer function is continuous-time; discretise it first"
            )
        if not system.is_proper:
            raise BadModel(
                "StateSpace: the transfer function is not proper; its numerator's degree exceeds"
                " its denominator's"
            )
        n = len(system.den) - 1
        a = system.den[1:] / system.den[0]
        b = np.concatenate([np.zeros(n + 1 - len(system.num)), system.num]) / system.den[0]
        A = np.eye(n, k=-1)
        if n:
            A[0] = -a
        return cls(A, np.eye(n, 1), (b[1:] - b[0] * a)[None, :], b[:1, None], system.sample_time)

    @property
    def order(self) -> int:
        """Number of states n."""
        return int(self.A.shape[0])

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues of A, shape (n,)."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=complex)

    @property
    def is_stable(self) -> bool:
        """All poles strictly inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0))

    def frequency_response(self, omega: npt.ArrayLike) -> ComplexArray:
        """Response at ω [rad/s], shape (len(omega), p, q)."""
        return self.response(
            np.exp(1j * np.atleast_1d(np.asarray(omega, dtype=float)) * self.sample_time)
        )

    def response(self, z: ComplexArray) -> ComplexArray:
        """C (z − A)⁻¹ B + D at points z of the plane, shape (len(z), p, q), through the complex
        Schur form (n² a point).
        """
        if not self.order:
            return np.repeat(self.D[None].astype(complex), len(z), axis=0)
        T, U = linalg.schur(self.A, output="complex")
        B, C = U.conj().T @ self.B, self.C @ U
        # (z − T)⁻¹ B by back substitution, all ω at once
        X = np.empty((self.order, len(z) * B.shape[1]), dtype=complex)
        points = np.repeat(z, B.shape[1])
        for i in range(self.order - 1, -1, -1):
            X[i] = (np.tile(B[i], len(z)) + T[i, i + 1 :] @ X[i + 1 :]) / (points - T[i, i])
        return np.asarray((C @ X).reshape(len(C), len(z), -1).transpose(1, 0, 2) + self.D)

    def impulse_response(self, length: int) -> FloatArray:
        """First `length` Markov parameters D, CB, CAB, …, shape (length, p, q)."""
        response = np.empty((length, *self.D.shape))
        response[0] = self.D
        power = self.B
        for k in range(1, length):
            response[k] = self.C @ power
            power = self.A @ power
        return response

    def __matmul__(self, other: StateSpace) -> StateSpace:
        """The series connection self · other (`other` acts first)."""
        top = np.hstack([self.A, self.B @ other.C])
        bottom = np.hstack([np.zeros((other.order, self.order)), other.A])
        return StateSpace(
            np.vstack([top, bottom]),
            np.vstack([self.B @ other.D, other.B]),
            np.hstack([self.C, self.D @ other.C]),
            self.D @ other.D,
            self.sample_time,
        )

    def beside(self, other: StateSpace) -> StateSpace:
        """The system [self, other] with the inputs of both and the sum of their outputs."""
        return StateSpace(
            linalg.block_diag(self.A, other.A),
            linalg.block_diag(self.B, other.B),
            np.hstack([self.C, other.C]),
            np.hstack([self.D, other.D]),
            self.sample_time,
        )

    def __mul__(self, factor: float) -> StateSpace:
        """The system with its output scaled by `factor`."""
        return StateSpace(self.A, self.B, factor * self.C, factor * self.D, self.sample_time)

    def inverse(self) -> StateSpace:
        """The system that undoes this one; BadModel unless D is square and regular."""
        p, q = self.D.shape
        if p != q or np.linalg.matrix_rank(self.D) < p:
            raise BadModel("StateSpace.inverse: D must be square and regular")
        inverse: FloatArray = np.linalg.inv(self.D).astype(float)
        return StateSpace(
            self.A - self.B @ inverse @ self.C,
            self.B @ inverse,
            -inverse @ self.C,
            inverse,
            self.sample_time,
        )

    def simulate(
        self, v: npt.ArrayLike, state: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Output, shape (len, p), for input `v`, shape (len, q), and the final state, from `state`
        (zero when not given).

        The recursion is sample by sample in a fixed order, so cutting `v` into blocks changes no
        bit of the result.
        """
        v = np.ascontiguousarray(v, dtype=float).reshape(-1, self.D.shape[1])
        x = np.zeros(self.order) if state is None else np.array(state, dtype=float)
        w = np.empty((len(v), self.D.shape[0]))
        if self._diagonals is not None:
            _tridiagonal_recursion(self._diagonals, self.D[0, 0], x, v[:, 0], w[:, 0])
            return w, x
        _recursion(self.A, self.B, self.C, self.D, self._bands, x, v, w)
        return w, x

    @cached_property
    def _bands(self) -> npt.NDArray[np.int64]:
        """First and one past the last column that is not zero of each row of A, shape (n, 2)."""
        if not self.order:
            return np.zeros((0, 2), dtype=np.int64)
        filled = self.A != 0.0
        first, last = filled.argmax(axis=1), self.order - filled[:, ::-1].argmax(axis=1)
        return np.stack([first, np.where(filled.any(axis=1), last, first)], axis=1).astype(np.int64)

    @cached_property
    def _diagonals(self) -> FloatArray | None:
        """Rows: A below, on and above its diagonal, B, C, shape (5, n); None unless A is
        tridiagonal, one input, one output.
        """
        A, n = self.A, self.order
        if not n or self.D.shape != (1, 1) or np.any(np.triu(A, 2)) or np.any(np.tril(A, -2)):
            return None
        rows = np.zeros((5, n))
        rows[0, 1:], rows[1], rows[2, :-1] = np.diag(A, -1), np.diag(A), np.diag(A, 1)
        rows[3], rows[4] = self.B[:, 0], self.C[0]
        return rows

    @cached_property
    def modal(self) -> StateSpace:
        """The same system with A block diagonal, a real mode or a complex pair a block: n, not n²,
        products a sample.

        Where the modes are too nearly parallel to be told apart without losing digits, A is upper
        triangular instead.
        """
        if self.order < _WORTH_MODES:
            return self
        eigenvalues, vectors = np.linalg.eig(self.A)
        upper, real = eigenvalues.imag > 0, eigenvalues.imag == 0
        T = np.column_stack(
            [
                vectors[:, real].real,
                *(part for v in vectors[:, upper].T for part in (v.real, v.imag)),
            ]
        )
        if T.shape[1] != self.order or np.linalg.cond(T) > _PARALLEL_MODES:
            A, T = linalg.schur(self.A, output="real")
            return StateSpace(A, T.T @ self.B, self.C @ T, self.D, self.sample_time)
        pairs = [np.array([[p.real, p.imag], [-p.imag, p.real]]) for p in eigenvalues[upper]]
        A = linalg.block_diag(*eigenvalues[real].real[:, None, None], *pairs)
        return StateSpace(A, np.linalg.solve(T, self.B), self.C @ T, self.D, self.sample_time)


@njit()
def _recursion(A, B, C, D, bands, x, v, w) -> None:  # type: ignore[no-untyped-def]
    n, (p, q) = A.shape[0], D.shape
    following = np.empty(n)
    for t in range(v.shape[0]):
        for i in range(p):
            total = 0.0
            for j in range(q):
                total += D[i, j] * v[t, j]
            for j in range(n):
                total += C[i, j] * x[j]
            w[t, i] = total
        for i in range(n):
            total = 0.0
            for j in range(q):
                total += B[i, j] * v[t, j]
            for j in range(bands[i, 0], bands[i, 1]):
                total += A[i, j] * x[j]
            following[i] = total
        x[:] = following


@njit(fastmath={"reassoc"})
def _tridiagonal_recursion(diagonals, d, x, v, w):  # type: ignore[no-untyped-def]
    """All states at once, which the modes of a system allow; the sum of an output has one order,
    whatever the blocks.
    """
    n = diagonals.shape[1]
    lower, diagonal, upper, b, c = (
        diagonals[0],
        diagonals[1],
        diagonals[2],
        diagonals[3],
        diagonals[4],
    )
    now, following = np.zeros(n + 2), np.zeros(n + 2)  # a zero at either end
    now[1 : n + 1] = x
    for t in range(len(v)):
        entering, total = v[t], 0.0
        before, current, after, new = now[:n], now[1 : n + 1], now[2:], following[1 : n + 1]
        for i in range(n):
            total += c[i] * current[i]
            new[i] = (
                diagonal[i] * current[i]
                + lower[i] * before[i]
                + upper[i] * after[i]
                + b[i] * entering
            )
        w[t] = total + d * entering
        now, following = following, now
    x[:] = now[1 : n + 1]
