"""What the integrator errs must stay below what a record can show, or it passes for physics that is missing."""

import numpy as np

from residuum.identification.physics import Experiment, Simulator, load_model


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
    return simulator, x0, Y, spread, Experiment(U, Y + spread * rng.standard_normal(Y.shape), np.zeros(1), sample_time)


def test_steps_are_so_fine_that_their_error_hides_in_the_noise():
    simulator, x0, exact, spread, experiment = stiff_drive(noise=0.003)
    coarse = simulator.substeps_along(
        experiment, simulator.run_vectors(experiment, x0, simulator.p(), substeps=8).X, simulator.p()
    )
    chosen = simulator.substeps(experiment, x0, simulator.p())

    def error(steps):
        Y = simulator.run_vectors(experiment, x0, simulator.p(), substeps=steps).Y
        return np.max(np.sqrt(np.mean((Y - exact) ** 2, axis=0)) / spread)

    assert error(coarse) > 0.1
    assert chosen > coarse and error(chosen) < 0.5 * error(coarse)


def test_steps_are_no_finer_than_a_noisy_record_can_tell():
    simulator, x0, _, _, experiment = stiff_drive(noise=3.0)
    X = simulator.run_vectors(experiment, x0, simulator.p(), substeps=8).X
    assert simulator.substeps(experiment, x0, simulator.p()) == simulator.substeps_along(experiment, X, simulator.p())
