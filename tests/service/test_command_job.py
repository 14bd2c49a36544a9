"""Commands as jobs tell how far they are, each within its part of the work."""

import numpy as np
from scipy.signal import lfilter

from residuum.identification.record import Record
from residuum.service.work.command_job import parts_of, run_commands


def told_by(steps, record):
    told = []
    run_commands(lambda share, doing: told.append((round(share, 6), doing)), steps, {}, {"record.npz": parts_of(record)})
    return told


def test_progress_lines_become_shares_of_the_whole():
    u = np.random.default_rng(0).normal(size=400)
    record = Record({"u": u, "y": lfilter([0, 0.3], [1, -0.7], u)}, {"u": "V", "y": "V"}, 0.1)
    step = ["identify", "@record.npz", "--input=u", "--output=y", "--order=20"]
    told = told_by([step, step], record)
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and {0.0, 0.05, 0.45, 0.5, 0.55, 0.95} <= set(shares)
    assert (0.05, "identifying from 400 samples") in told and not any("%" in doing for _, doing in told)


def test_explain_tells_what_it_tries():
    rng = np.random.default_rng(2)
    force = rng.normal(size=400) * 20
    velocity = np.cumsum(force) * 1e-3 / 95 + 1e-6 * rng.normal(size=400)
    record = Record({"force": force, "velocity": velocity}, {"force": "N", "velocity": "m/s"}, 1e-3)
    told = told_by([["explain", "linear-axis", "@record.npz", "--effects=coulomb-friction"]], record)
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and shares[0] == 0 and shares[-1] == 0.9
    assert "trying the effects of the catalogue" in [doing for _, doing in told]
