"""Non-negative least squares for a few equations and some tens of unknowns, compiled."""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"

import numpy as np

from residuum.kept_loops import njit

_ZERO = 1e-13
_DEPENDENT = 1e-12


@njit(error_model="numpy")
def nonnegative_least_squares(E, f):
    r"""u ≥ 0 that minimises ‖E u − f‖₂, shape (n,), E of shape (m, n).

    Lawson and Hanson's active-set method: the unknown with the steepest descent becomes free, the free ones are solved for by
    Householder's QR, and those that would become negative go back to zero. For E of a few rows at most as many unknowns are
    free at once, so a step costs O(m n + m³), and no library call is in the way.

    References
    ----------
    C. L. Lawson, R. J. Hanson, *Solving Least Squares Problems*, algorithm 23.10.

    >>> nonnegative_least_squares(np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([1.0, -1.0])).round(12).tolist()
    [1.0, 0.0]
    """
    m, n = E.shape
    u, residual, sizes = np.zeros(n), np.empty(m), np.empty(n)
    for j in range(n):
        sizes[j] = _norm(E, j, 0)
    free, count, is_free = np.empty(min(m, n) + 1, dtype=np.int64), 0, np.zeros(n, dtype=np.bool_)
    R, solution = np.empty((m, m + 2)), np.empty(m + 1)
    enough = _ZERO * (1.0 + np.sqrt(np.sum(f**2)))
    for _ in range(20 * n):
        for i in range(m):
            residual[i] = f[i]
            for k in range(count):
                residual[i] -= E[i, free[k]] * u[free[k]]
        entering = _steepest(E, residual, sizes, is_free, enough)
        if entering < 0 or count == min(m, n):
            break
        free[count] = entering
        is_free[entering] = True
        count += 1
        regular = _solve(E, f, free, count, R, solution)
        if not regular or solution[count - 1] <= 0.0:  # depends on the others to rounding: it cannot help
            count -= 1
            sizes[entering], is_free[entering] = 0.0, False
            continue
        while solution[:count].min() <= 0.0:
            count = _move(u, solution, free, count, is_free)
            if count == 0:
                break
            _solve(E, f, free, count, R, solution)
        for i in range(count):
            u[free[i]] = solution[i]
    return u


@njit(error_model="numpy")
def _steepest(E, residual, sizes, is_free, enough):
    """The unknown at zero whose growth lowers the residual most, −1 when none does."""
    entering, steepest = -1, enough
    for j in range(len(sizes)):
        if not is_free[j] and sizes[j] > 0.0:
            slope = 0.0
            for i in range(len(residual)):
                slope += E[i, j] * residual[i]
            if slope > steepest * sizes[j]:
                entering, steepest = j, slope / sizes[j]
    return entering


@njit(error_model="numpy")
def _move(u, solution, free, count, is_free):
    """Go towards the solution until the first unknown is zero; the number of those still free."""
    step, first = 1.0, -1
    for i in range(count):
        if solution[i] <= 0.0:
            share = u[free[i]] / (u[free[i]] - solution[i])
            if first < 0 or share < step:
                step, first = share, i
    kept = 0
    for i in range(count):
        j = free[i]
        u[j] += step * (solution[i] - u[j])
        if i == first or u[j] <= 0.0:
            u[j], is_free[j] = 0.0, False
        else:
            free[kept] = j
            kept += 1
    return kept


@njit(error_model="numpy")
def _norm(E, j, top):
    total = 0.0
    for i in range(top, E.shape[0]):
        total += E[i, j] * E[i, j]
    return np.sqrt(total)


@njit(error_model="numpy")
def _solve(E, f, columns, p, R, solution):
    """Least squares on p columns by Householder's QR, into `solution`; whether they are independent."""
    m = E.shape[0]
    for i in range(m):
        for j in range(p):
            R[i, j] = E[i, columns[j]]
        R[i, p] = f[i]
    for i in range(p):
        norm = _norm(R, i, i)
        if norm <= _DEPENDENT * _norm(E, columns[i], 0):
            return False
        pivot = R[i, i] + (norm if R[i, i] >= 0.0 else -norm)
        half = norm * np.abs(pivot)  # half the square of the reflector (pivot, R[i + 1:, i])
        diagonal = -norm if R[i, i] >= 0.0 else norm
        for j in range(i + 1, p + 1):
            along = pivot * R[i, j]
            for k in range(i + 1, m):
                along += R[k, i] * R[k, j]
            along /= half
            R[i, j] -= along * pivot
            for k in range(i + 1, m):
                R[k, j] -= along * R[k, i]
        R[i, i] = diagonal
    for i in range(p - 1, -1, -1):
        total = R[i, p]
        for j in range(i + 1, p):
            total -= R[i, j] * solution[j]
        solution[i] = total / R[i, i]
    return True
