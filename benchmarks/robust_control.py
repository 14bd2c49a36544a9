"""Fixed-structure designs beside a global search in one run; Algorithms 2–4; the guarantee on plants drawn from the posterior."""

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from scipy.signal import lfilter

from benchmarks.peers import FOLDER, run_peer
from benchmarks.peers.full_order import full_order_design
from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.identified_model_file import save_identified
from residuum.identification.linear_models.schur import is_schur
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import design_uncertainty_weight
from residuum.identification.record import Record
from residuum.library.questions.control_design import DesignController
from residuum.robust_control.certificates import (
    RobustAim,
    design_for_robust_performance,
    h_infinity_norm,
)
from residuum.robust_control.loop import (
    Loop,
    Weights,
    characteristic,
    frequency_grid,
    weighted_loop,
)
from residuum.robust_control.synthesis.constrained_structure import PI, PIDN, Rational
from residuum.robust_control.synthesis.structured_synthesis import default_starts, synthesise
from residuum.robust_control.weights.performance_weight import (
    NominalAim,
    ReferenceModel,
    design_for_nominal_performance,
)
from residuum.service.views.control_view import view_control_design

TS = 0.01
# (2.38) of the source
TRUE = TransferFunction([0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642], TS)
OMEGA = np.geomspace(1e-3, np.pi / TS, 600)
SYSTEMS, PLANTS = 1000, 20


def cpu_seconds(run: Callable[[], object], repeats: int = 1) -> float:
    """Best of several."""
    best = np.inf
    for _ in range(repeats):
        begin = time.process_time()
        run()
        best = min(best, time.process_time() - begin)
    return best


def identified(true: TransferFunction, order: int, seed: int, n: int = 4000) -> IdentifiedModel:
    rng = np.random.default_rng(seed)
    u = rng.normal(size=n + 1000)
    y = lfilter(np.r_[np.zeros(len(true.den) - len(true.num)), true.num], true.den, u)
    y += rng.normal(size=len(y)) * np.std(y) / 5.0
    sample_time = float(true.sample_time or 0.0)
    record = Record(
        {"u": u[1000:], "y": y[1000:]}, {"u": "", "y": ""}, sample_time, source=f"seed {seed}"
    )
    return identify_impulse_response(record, "u", "y", order=order, offset=False)


def one_design() -> None:
    """Ours and a global search on the same cost: 4 parameters, the true plant of (2.38)."""
    omega = frequency_grid([TRUE], points=500, lowest=1e-3)
    loop, structure = Loop([TRUE], omega), PIDN(TS)
    W_T = np.abs(TransferFunction([0.02, 0.3], [1e-3, 1.0]).frequency_response(omega))
    print(f"## One design: 4 parameters, {len(omega)} frequencies\n")
    print("| ℓ [s] | ours | CPU [ms] | differential evolution | CPU [ms] |")
    print("|---|---|---|---|---|")
    for settling in (2.0, 0.6, 0.3):
        weights = Weights(ReferenceModel(0.01, settling).weight_magnitude(omega), W_T)
        found = synthesise(loop, weights, structure)
        ours = cpu_seconds(lambda w=weights: synthesise(loop, w, structure), 30)  # type: ignore[misc]

        def cost(rho: np.ndarray, w: Weights = weights) -> float:
            if not loop.is_stable(structure.transfer_function(rho)):
                return 1e3
            return float(loop.cost(structure.response(rho, loop.z)[0], w).max())

        box = [(-1.0, 1.0), (0.0, 20.0), (-0.05, 0.05), (0.0055, 0.2)]
        begin = time.process_time()
        globally = differential_evolution(cost, box, seed=1, maxiter=150, popsize=15, tol=1e-8)
        theirs = time.process_time() - begin
        print(
            f"| {settling} | {found.cost:.5f} | {1e3 * ours:.0f} | {globally.fun:.5f} | {1e3 * theirs:.0f} |"
        )


def optimum() -> None:
    """The same designs by PyGRANSO, SLSQP and differential evolution, judged on the finer grid that certifies ours."""
    omega = frequency_grid([TRUE], points=500, lowest=1e-3)
    loop, structure = Loop([TRUE], omega), PIDN(TS)
    fine, position = loop.finer
    W_T = np.abs(TransferFunction([0.02, 0.3], [1e-3, 1.0]).frequency_response(omega))
    settling_times, cases = (2.0, 0.6, 0.3), []
    for settling in settling_times:
        weights = Weights(ReferenceModel(0.01, settling).weight_magnitude(omega), W_T)
        between = weights.between(position)
        found = synthesise(loop, weights, structure)
        cases.append(
            {"W_S": between.W_S.tolist(), "W_T": between.W_T.tolist(), "rho": found.rho.tolist()}
        )
    starts = [
        rho.tolist()
        for rho in default_starts(loop, structure)
        if loop.stabilised_by(*structure.polynomials(rho))
    ]
    problem = {"sample_time": TS, "omega": fine.omega.tolist(), "num": TRUE.num.tolist(), "den": TRUE.den.tolist(),
               "sizes": structure.sizes(*loop.gain_and_time_constant).tolist(), "starts": starts, "cases": cases}  # fmt: skip
    with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
        json.dump(problem, file)
        file.flush()
        script = (Path(__file__).parent / "fixed_structure_peers.py").read_text(encoding="utf-8")
        packages = ["torch==2.13.0", "pygranso==1.2.0", "osqp", "scipy", "numpy"]
        theirs = run_peer("granso", packages, f"PROBLEM = {file.name!r}\n{script}", timeout=1800.0)
    print(f"\n## The optimum beside its peers, on {len(fine.omega)} frequencies\n")
    if theirs is None:
        print("PyGRANSO could not be installed.")
        return
    methods = [name for name in theirs[0] if name != "ours"]
    print(
        "| ℓ [s] | ours | "
        + " | ".join(f"{name} | CPU [s]" for name in methods)
        + " | ours over the best |"
    )
    print("|" + "---|" * (3 + 2 * len(methods)))
    for settling, row in zip(settling_times, theirs, strict=True):
        cells = [f"{row[name][0]:.6f} | {row[name][1]:.2f}" for name in methods]
        best = min(row[name][0] for name in methods)
        print(
            f"| {settling} | {row['ours']:.6f} | "
            + " | ".join(cells)
            + f" | {row['ours'] / best - 1.0:+.1e} |"
        )


def algorithms() -> None:
    """Algorithms 2 and 3 on the identified (2.38), and whether a global search with ten times the time beats the front."""
    model = identified(TRUE, 100, 1)
    weight = design_uncertainty_weight(model, omega=OMEGA, order=2, seed=1)
    plant, structure, aim = model.transfer_function(), PIDN(TS), NominalAim(0.01, 5.0, 0.1)
    omega = frequency_grid([plant], lowest=1e-3)
    loop = Loop([plant], omega)
    W_T = np.abs(weight.weight.frequency_response(omega))
    critical = weight.critical_frequency or np.pi / TS
    begin = time.process_time()
    nominal = design_for_nominal_performance(loop, W_T, structure, aim, critical)
    second = time.process_time() - begin
    third = cpu_seconds(
        lambda: design_for_robust_performance(loop, W_T, structure, RobustAim(), critical)
    )
    chosen = nominal.chosen
    print(
        f"\n## Algorithms on (2.38), kernel identification\n\nAlgorithm 2: {second:.1f} s CPU, ô = {chosen.first:g}, ",
        end="",
    )
    print(
        f"ℓ̂ = {chosen.second:.4f} s, cost {chosen.design.certified:.4f}; Algorithm 3: {third:.1f} s CPU."
    )
    begin = time.process_time()

    fine, position = loop.finer

    def settling(x: np.ndarray) -> float:
        """ℓ where feasible, on the design's grid and then on the one 20 times finer that certifies ours too."""
        if time.process_time() - begin > 10 * second:
            return 1e3
        weights = Weights(ReferenceModel(0.01, float(np.exp(x[4]))).weight_magnitude(omega), W_T)
        cost = float(loop.cost(structure.response(x[:4], loop.z)[0], weights).max())
        if cost < 1.1 and loop.is_stable(structure.transfer_function(x[:4])):
            cost = float(
                fine.cost(structure.response(x[:4], fine.z)[0], weights.between(position)).max()
            )
            if cost < 1.1:
                return float(np.exp(x[4]))
        return 10.0 + min(cost, 100.0)

    box = [(-1.0, 1.0), (0.0, 20.0), (-0.05, 0.05), (0.0055, 0.2), (np.log(0.05), np.log(5.0))]
    spent = 10 * second
    globally = differential_evolution(
        settling,
        box,
        seed=1,
        maxiter=10_000,
        popsize=15,
        tol=0,
        callback=lambda *_: time.process_time() - begin > spent,
    )
    print(
        f"Differential evolution over (ρ, ℓ) with ten times the CPU time: shortest feasible ℓ = {globally.fun:.4f} s."
    )


def random_system(rng: np.random.Generator) -> TransferFunction:
    """Stable, of order 1 to 4, with poles of modulus 0.3 to 0.93 and static gain 1."""
    poles: list[complex] = []
    for _ in range(int(rng.integers(1, 3))):
        r, angle = rng.uniform(0.3, 0.93), rng.uniform(0.0, 1.2)
        poles += (
            [r * np.exp(1j * angle), r * np.exp(-1j * angle)]
            if rng.random() < 0.6
            else [complex(r)]
        )
    den = np.real(np.poly(poles))
    num = rng.normal(size=len(den) - 1) + 1.0
    gain = num.sum() / den.sum()
    return TransferFunction(num / (gain if abs(gain) > 0.1 else 0.1), den, 1.0)


def guarantee() -> None:
    """Random systems: design on the identified model, then plants drawn anew from its posterior."""
    names = (
        "designed",
        "refused",
        "plants",
        "within",
        "within unstable",
        "outside",
        "outside unstable",
        "violations",
    )
    counts = dict.fromkeys(names, 0)
    begin = time.process_time()
    for seed in range(SYSTEMS):
        rng = np.random.default_rng([7, seed])
        model = identified(random_system(rng), 60, seed, n=1500)
        try:
            weight = design_uncertainty_weight(model, seed=seed, order=2)
            plant = model.transfer_function()
            omega = frequency_grid([plant], points=400)
            W_T = np.abs(weight.weight.frequency_response(omega))
            critical = weight.critical_frequency or np.pi
            aim = NominalAim(0.01, 2000.0, 0.1, overshoots=1, settling_times=12, halvings=0)
            found = design_for_nominal_performance(
                Loop([plant], omega), W_T, PIDN(1.0), aim, critical
            )
            K = found.chosen.design.controller
        except BadInput:
            counts["refused"] += 1
            continue
        counts["designed"] += 1
        norm, _ = h_infinity_norm(weighted_loop(plant, K, W_T=weight.weight))
        allowed = W_T / norm
        nominal, response = plant.frequency_response(omega), K.frequency_response(omega)
        W_S = found.reference.weight_magnitude(omega)
        for g in model.sample(PLANTS, 10_000 + seed):
            drawn = TransferFunction(g, plant.den, 1.0)
            G = drawn.frequency_response(omega)
            within = bool(np.all(np.abs(G / nominal - 1.0) < allowed))
            stable = is_schur(characteristic(drawn, K))
            counts["plants"] += 1
            counts["violations"] += bool(
                np.any((1.0 + aim.slack) * np.abs(1.0 + G * response) < W_S)
            )
            counts["within" if within else "outside"] += 1
            counts["within unstable" if within else "outside unstable"] += not stable
    print("\n## The guarantee: plants drawn from the posterior\n")
    print(
        f"{SYSTEMS} random systems: {counts['designed']} designed, {counts['refused']} refused; {counts['plants']} plants: ",
        end="",
    )
    print(
        f"{counts['within']} within the certified set, of them {counts['within unstable']} destabilised; ",
        end="",
    )
    print(
        f"{counts['outside']} outside it, of them {counts['outside unstable']} destabilised; ",
        end="",
    )
    print(
        f"{counts['violations']} of all miss the performance bound |W_S S| < 1.1 that was designed for the nominal plant; ",
        end="",
    )
    print(f"{time.process_time() - begin:.0f} s.")


def control_view() -> None:
    """What the page asks for: the front, its promises and drawn plants, for 2/(s² + 1.2 s + 1) at 5 Hz known by 100 lags."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal(4000)
    y = TransferFunction([2.0], [1.0, 1.2, 1.0]).discretise(0.2).simulate(
        u
    ) + 0.05 * rng.standard_normal(4000)
    model = identify_impulse_response(
        Record({"u": u, "y": y}, {"u": "", "y": ""}, 0.2), "u", "y", order=100
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plant.json"
        save_identified(model, file)
        content = file.read_bytes()
    print(
        "\n## The page's view of a plant of 100 lags\n\n| aim | points | CPU [s] |\n|---|---|---|"
    )
    for aim in ("nominal", "robust"):

        def view(aim: str = aim) -> dict[str, Any]:
            return dict(
                view_control_design(lambda *_: None, [content], None, DesignController(aim=aim))
            )

        points = len(view()["points"])
        print(f"| {aim} | {points} | {cpu_seconds(view, 3):.1f} |")


NORMS = """
import json, warnings
import control, numpy as np
warnings.simplefilter("ignore")
with open({path!r}) as file:
    systems = json.load(file)
print(json.dumps([float(control.system_norm(control.ss(*map(np.array, s), 1.0), p="inf", tol=1e-9)) for s in systems]))
"""


def peers() -> None:
    """Norms of random systems beside python-control with slycot, and the price of the structure beside slycot's full order."""
    print("\n## Norms and full order beside python-control and slycot\n")
    rng = np.random.default_rng(11)
    systems = []
    for _ in range(200):
        n, inputs, outputs = (int(k) for k in rng.integers([1, 1, 1], [11, 4, 4]))
        A = rng.normal(size=(n, n))
        A *= rng.uniform(0.5, 0.995) / np.abs(np.linalg.eigvals(A)).max()
        parts = [rng.normal(size=shape) for shape in ((n, inputs), (outputs, n), (outputs, inputs))]
        systems.append(StateSpace(A, *parts, sample_time=1.0))
    with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
        json.dump([[m.tolist() for m in (s.A, s.B, s.C, s.D)] for s in systems], file)
        file.flush()
        theirs = run_peer(
            "control", ["control==0.10.2", "slycot==0.7.1"], NORMS.format(path=file.name)
        )
    if theirs is None:
        print("python-control and slycot could not be installed.")
        return
    gaps = [
        abs(h_infinity_norm(system)[0] / norm - 1.0)
        for system, norm in zip(systems, theirs, strict=True)
    ]
    print(f"{len(gaps)} random systems, norms: largest relative difference {max(gaps):.1e}.\n")
    print("| plant | PI | PIDN | rational of order 4 | full order, slycot |")
    print("|---|---|---|---|---|")
    ts = 0.05
    W_S = TransferFunction([0.5, 0.5], [1.0, 0.001]).discretise(ts, "bilinear")
    W_T = TransferFunction([0.3, 0.3], [0.01, 1.0]).discretise(ts, "bilinear")
    for name, num, den in (
        ("2/(s² + 1.2 s + 1)", [2.0], [1.0, 1.2, 1.0]),
        ("(1 − s)/(s + 1)²", [-1.0, 1.0], [1.0, 2.0, 1.0]),
    ):
        plant = TransferFunction(num, den).discretise(ts)
        omega = frequency_grid([plant], points=500, lowest=1e-4)
        weights = Weights(*(np.abs(W.frequency_response(omega)) for W in (W_S, W_T)))
        costs = [
            synthesise(Loop([plant], omega), weights, law).certified
            for law in (PI(ts), PIDN(ts), Rational(ts, order=4))
        ]
        full = full_order_design(plant, W_S, W_T, python=str(FOLDER / "control" / "bin" / "python"))
        confirmed = "a bound" if full.is_bound else "no bound"
        print(
            f"| {name} | {' | '.join(f'{cost:.4f}' for cost in costs)} | {full.norm:.4f} ({confirmed}) |"
        )


def main() -> None:
    """All tables; `python -m benchmarks.robust_control design|optimum|peers|algorithms|view|guarantee` runs some."""
    parts: dict[str, Callable[[], None]] = {
        "design": one_design,
        "optimum": optimum,
        "peers": peers,
        "algorithms": algorithms,
        "view": control_view,
        "guarantee": guarantee,
    }
    for name in [argument for argument in sys.argv[1:] if argument in parts] or parts:
        parts[name]()


if __name__ == "__main__":
    main()
