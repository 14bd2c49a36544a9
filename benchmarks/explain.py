"""How long explain takes on a record of 60 s at 1 kHz of the drive, with all effects of the catalogue to choose from.

`python -m benchmarks explain`: every case in processes of its own, first with an empty cache of compiled kernels, then with the
cache that left behind; imports and reading the record are not counted, the processor's seconds stand beside the clock's.
"""

import os
import subprocess
import sys
import tempfile
import time

CASES = {
    "nothing missing": (),
    "Coulomb friction": (("coulomb-friction", "medium"),),
    "inductance": (("inductance", "medium"),),
}
DURATION, RATE = 60.0, 1000.0


def once(name: str) -> None:
    """Explain one case in this process and print its seconds, the processor's, and the answer."""
    from residuum.identification.discrepancy.explain import explain
    from residuum.identification.physics import load_model
    from residuum.identification.record import Record
    from residuum.service.work.loaded_modules import leave_loaded_modules
    from residuum.service.work.worker_pool import keep_large_arrays
    from residuum.simulation import MACHINES

    machine = MACHINES["gate-drive"](seed=1, effects=dict(CASES[name]), profile="rich", rate=RATE)
    signals = machine.simulate(DURATION)
    record = Record(signals.channels, signals.units, signals.sample_time)
    keep_large_arrays()  # as the command does, and
    leave_loaded_modules()
    begin, used = time.perf_counter(), time.process_time()
    found = explain(load_model("gate-drive"), [record])
    seconds, used = time.perf_counter() - begin, time.process_time() - used
    says = found.verdict + (
        f" {found.candidates[0].effect}" if found.verdict == "missing-effect" else ""
    )
    print(f"{seconds:.1f} | {used:.1f} | {record.n} | {says}")


def main() -> None:
    print("| case | cache | seconds | CPU | samples | answer |\n|---|---|---|---|---|---|")
    for name in CASES:
        with tempfile.TemporaryDirectory() as cache:
            for state in ("empty", "filled", "filled"):
                command = [sys.executable, "-m", "benchmarks.explain", name]
                done = subprocess.run(
                    command,
                    env=os.environ | {"RESIDUUM_CACHE": cache},
                    capture_output=True,
                    text=True,
                    check=True,
                )
                print(f"| {name} | {state} | {done.stdout.strip()} |", flush=True)


if __name__ == "__main__":
    once(sys.argv[1]) if len(sys.argv) > 1 else main()
