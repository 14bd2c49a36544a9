"""What the integrator errs must stay below what a record can show, or it passes for physics that is missing."""

from dataclasses import replace

import numpy as np

from residuum.identification.physics import Experiment, Simulator, load_model, windows


def stiff_drive(noise, n=3000, sample_time=0.002, seed=5):
    """A drive with a fast winding and dry friction that reverses often; its record is the model's own, in fine steps."""
    rng = np.random.default_rng(seed)
    model = load_model("gate-drive").with_effect("inductance", "winding", {"L": 1e-3})
    model = model.with_effect("coulomb-friction", "shaft", {"tau_c": 0.02})
    U = np.repeat(rng.uniform(-12.0, 12.0, n // 100), 100)[:, None]
    empty = Experiment(U, np.full((n, len(model.outputs)), np.nan), np.zeros(1), sample_time)
    simulator = Simulator(model)
    x0 = simulator.x0()
    Y = simulator.run_vectors(empty, x0, simulator.p(), substeps=64).Y
    spread = noise * Y.std(axis=0)
    return (
        simulator,
        x0,
        Y,
        spread,
        Experiment(U, Y + spread * rng.standard_normal(Y.shape), np.zeros(1), sample_time),
    )


def test_steps_are_so_fine_that_their_error_hides_in_the_noise():
    simulator, x0, exact, spread, experiment = stiff_drive(noise=0.003)
    coarse = simulator.modal_substeps([experiment], [x0], simulator.p())[0]
    chosen = simulator.substeps(experiment, x0, simulator.p())

    def error(steps):
        Y = simulator.run_vectors(experiment, x0, simulator.p(), substeps=steps).Y
        return np.max(np.sqrt(np.mean((Y - exact) ** 2, axis=0)) / spread)

    assert error(coarse) > 0.1
    assert chosen > coarse and error(chosen) < 0.5 * error(coarse)


def test_steps_are_no_finer_than_a_noisy_record_can_tell():
    simulator, x0, _, _, experiment = stiff_drive(noise=3.0)
    assert [simulator.substeps(experiment, x0, simulator.p())] == list(
        simulator.modal_substeps([experiment], [x0], simulator.p())
    )


def test_experiments_together_are_simulated_as_each_alone():
    """Of other lengths, sample times, holds, first states and steps; one of them diverges."""
    rng = np.random.default_rng(8)
    model = load_model("gate-drive").with_effect("coulomb-friction", "shaft", {"tau_c": 0.02})
    simulator, slopes = Simulator(model), ["K", "coulomb-friction@shaft.tau_c", "initial:omega"]
    nothing = np.full((1, len(model.outputs)), np.nan)
    each = [
        Experiment(
            6.0 * rng.standard_normal((n, 1)),
            np.repeat(nothing, n, axis=0),
            np.array([hold]),
            h,
            known=known,
        )
        for n, h, hold, known in (
            (400, 0.002, 0.0, {}),
            (90, 0.01, 1.0, {}),
            (250, 0.001, 0.0, {"omega": 1.0}),
        )
    ]
    initial = [np.array([0.0, 0.0]), np.array([0.1, -20.0]), np.array([0.0, np.inf])]
    together = simulator.run_each(each, initial, simulator.p(), slopes=slopes, substeps=[2, 5, 1])
    for e, x0, steps, run in zip(each, initial, (2, 5, 1), together, strict=True):
        alone = simulator.run_vectors(e, x0, simulator.p(), slopes=slopes, substeps=steps)
        for values, expected in ((run.X, alone.X), (run.Y, alone.Y), (run.dY, alone.dY)):
            np.testing.assert_array_equal(values, expected)
    assert np.all(together[2].dY[:, :, 2] == 0.0) and not together[2].finite and together[1].finite
    alone = [simulator.substeps(e, x0, simulator.p()) for e, x0 in zip(each, initial, strict=True)]
    assert simulator.substeps_each(each, initial, simulator.p()) == alone


def test_sensitivities_that_have_decayed_are_zero():
    """Numbers that underflow take a processor forty times as long; those of a first state would stay there for a whole record."""
    simulator, x0, _, _, experiment = stiff_drive(noise=1.0)
    names = [f"initial:{name}" for name in simulator.free_states]
    found = simulator.run_vectors(experiment, x0, simulator.p(), slopes=names, substeps=8).dY
    seen = np.abs(found[found != 0.0])
    assert seen.max() > 0.1
    assert seen.min() > 1e-200 * seen.max()


def test_what_an_effect_remembers_goes_on_from_window_to_window():
    """A mass on a strained guideway, cut into windows that begin where the whole run was, and its slopes by what strains it."""
    model = load_model("linear-axis").with_effect("hysteresis", "axis", {"f_c": 30.0, "x_0": 0.05})
    simulator = Simulator(model)
    t = np.arange(3000) * 2e-3
    U = (60.0 * np.sin(2 * np.pi * 0.7 * t) + 25.0 * np.sin(2 * np.pi * 2.3 * t))[:, None]
    whole = Experiment(U, np.full((3000, 2), np.nan), np.ones(1), 2e-3, source="a.csv")
    names = ["hysteresis@axis.f_c", "hysteresis@axis.x_0"]
    run = simulator.run(whole, slopes=names, substeps=2)
    parts = windows(whole, 150)
    starts = [np.r_[run.X[150 * k, :2], 0.0] for k in range(len(parts))]
    pieces = simulator.run_each(
        parts, starts, simulator.p(), slopes=names, substeps=[2] * len(parts)
    )
    joined = np.concatenate([piece.X for piece in pieces])
    assert np.max(np.abs(joined[:, 2] - run.X[:, 2])) < 0.02
    forgotten = [
        simulator.run_vectors(e, x, simulator.p(), substeps=2).X
        for e, x in zip(parts, starts, strict=True)
    ]
    # each alone begins without strain
    assert np.max(np.abs(np.concatenate(forgotten)[:, 2] - run.X[:, 2])) > 0.5
    # records of their own remember nothing of each other
    apart = [replace(e, source=str(k)) for k, e in enumerate(parts)]
    alone = simulator.run_each(apart, starts, simulator.p(), substeps=[2] * len(parts))
    np.testing.assert_array_equal(np.concatenate([a.X for a in alone]), np.concatenate(forgotten))
    x_0 = model.values[names[1]]
    up, down = (
        simulator.run_each(
            parts, starts, simulator.p({names[1]: x_0 + s}), substeps=[2] * len(parts)
        )
        for s in (1e-6, -1e-6)
    )
    numeric = np.concatenate([a.Y - b.Y for a, b in zip(up, down, strict=True)]) / 2e-6
    exact = np.concatenate([piece.dY[:, :, 1] for piece in pieces])
    assert np.max(np.abs(exact - numeric)) < 0.03 * np.max(np.abs(numeric))
