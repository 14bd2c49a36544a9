"""Run in the peers' environment by `benchmarks.robust_control optimum`: PyGRANSO and SciPy on one and the same H∞ problem.

Reads PROBLEM (a JSON file: the plant's frequency response, weights, starts) and prints for each case the least cost that each
found on all frequencies, and its median CPU time [s].
"""

import json
import sys
import time
import types

import numpy as np
import numpy.core.numeric
from scipy.optimize import differential_evolution, minimize

numpy.core.numeric.Inf = np.inf  # PyGRANSO 1.2.0 takes it from there, NumPy 2 has it no more
# imported, but only used by another of its QP solvers
sys.modules["gurobipy"] = types.ModuleType("gurobipy")
sys.modules["gurobipy"].GRB = None

import torch  # noqa: E402
from pygranso.pygranso import pygranso  # noqa: E402
from pygranso.pygransoStruct import pygransoStruct  # noqa: E402

PROBLEM = globals().get("PROBLEM", "")
COARSE = 20  # of the frequencies every so many-th makes the grid that is searched first
torch.set_num_threads(1)
with open(PROBLEM) as file:
    problem = json.load(file)
ts, sizes = problem["sample_time"], np.array(problem["sizes"])
num, den = np.array(problem["num"]), np.array(problem["den"])


def stable(rho):
    kp, ki, kd, p = rho[0], rho[1] * ts, rho[2] / rho[3], 1.0 - ts / rho[3]
    above, below = [kp + kd, ki - kp * (1 + p) - 2 * kd, (kp - ki) * p + kd], [1.0, -1.0 - p, p]
    return (
        np.abs(np.roots(np.polyadd(np.convolve(den, below), np.convolve(num, above)))).max() < 1.0
    )


def grid_of(case, step):
    z = np.exp(1j * np.array(problem["omega"])[::step] * ts)
    return (
        z,
        np.polyval(num, z) / np.polyval(den, z),
        np.array(case["W_S"])[::step],
        np.array(case["W_T"])[::step],
    )


def log_costs(rho, z, G, W_S, W_T, log=np.log):
    L = G * (rho[0] + rho[1] * ts / (z - 1) + rho[2] * (z - 1) / (ts + rho[3] * (z - 1)))
    return 0.5 * log(W_S**2 + (W_T * abs(L)) ** 2) - log(abs(1 + L))


def peak(rho, *grid):
    return float(np.exp(log_costs(rho, *grid).max())) if rho[3] > 0.55 * ts and stable(rho) else 1e3


def granso(start, grid):
    tensors = [torch.tensor(x) for x in grid]

    def objective(variables):
        rho = variables.x[:, 0] * torch.tensor(sizes)
        limits = pygransoStruct()
        limits.filter = 1.0 - rho[3] / (0.55 * ts)
        cost = log_costs(rho, *tensors, log=torch.log).max()
        return [cost if stable(rho.detach().numpy()) else cost + 20.0, limits, None]

    options = pygransoStruct()
    options.torch_device, options.x0 = (
        torch.device("cpu"),
        torch.tensor(np.array(start) / sizes)[:, None],
    )
    options.print_level, options.quadprog_info_msg, options.double_precision = 0, False, True
    options.maxit, options.opt_tol, options.QPsolver = 1000, 1e-8, "osqp"
    found = pygranso(var_spec={"x": [4, 1]}, combined_fn=objective, user_opts=options)
    return found.final.x.detach().numpy().ravel() * sizes


def slsqp(start, grid):
    first = np.r_[np.array(start) / sizes, log_costs(start, *grid).max()]
    below = {"type": "ineq", "fun": lambda x: x[4] - log_costs(x[:4] * sizes, *grid)}
    bounds = [(None, None)] * 3 + [(0.55 * ts / sizes[3], None), (None, None)]
    options = {"maxiter": 300, "ftol": 1e-12}
    return (
        minimize(
            lambda x: x[4],
            first,
            bounds=bounds,
            constraints=[below],
            method="SLSQP",
            options=options,
        ).x[:4]
        * sizes
    )


def best_of(search, case):
    """Least cost on all frequencies over the starts, the best one searched on from there on all of them; median CPU time."""
    fine, coarse, found, times = grid_of(case, 1), grid_of(case, COARSE), [], []
    for start in problem["starts"]:
        begin = time.process_time()
        found.append(search(start, coarse))
        times.append(time.process_time() - begin)
    best = min(found, key=lambda rho: peak(rho, *fine))
    on = search(best, fine) if search is granso else best
    return min(peak(best, *fine), peak(on, *fine)), float(np.median(times))


def evolution(case):
    """Differential evolution, then Nelder and Mead's simplex on all frequencies."""
    fine, coarse, begin = grid_of(case, 1), grid_of(case, COARSE), time.process_time()
    box = [(-1.0, 1.0), (0.0, 20.0), (-0.05, 0.05), (0.0055, 0.2)]
    found = differential_evolution(
        peak, box, args=coarse, seed=1, maxiter=150, popsize=15, tol=1e-8
    )
    spent = time.process_time() - begin
    options = {"maxiter": 4000, "xatol": 1e-10, "fatol": 1e-9}
    on = minimize(peak, found.x, args=fine, method="Nelder-Mead", options=options)
    return min(peak(found.x, *fine), float(on.fun)), spent


answers = []
for case in problem["cases"]:
    methods = {
        "PyGRANSO": best_of(granso, case),
        "SLSQP": best_of(slsqp, case),
        "differential evolution": evolution(case),
    }
    answers.append({"ours": peak(np.array(case["rho"]), *grid_of(case, 1)), **methods})
print(json.dumps(answers))
