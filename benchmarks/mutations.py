"""Do the tests turn red when the code is made wrong on purpose? One mutation a room, in a copy of the sources.

python -m benchmarks.mutations                     # all: the tests must be green before and red after
python -m benchmarks.mutations --from 6 --to 10    # those alone, by number
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Mutation:
    """What is made wrong in which file, as the text that is there and the one that takes its place; the room's tests."""

    name: str
    file: str
    right: str
    wrong: str
    tests: str
    chosen: str = ""
    """Of the tests those that pytest's `-k` chooses; all without."""

    def apply(self, folder: Path) -> None:
        """Make it wrong in a copy; ValueError when the code has moved on."""
        file = folder / self.file
        text = file.read_text(encoding="utf-8")
        if text.count(self.right) != 1:
            raise ValueError(
                f"mutation {self.name!r}: {self.file} has {text.count(self.right)} times {self.right!r}; needs one"
            )
        file.write_text(text.replace(self.right, self.wrong), encoding="utf-8")


MUTATIONS = (
    Mutation(
        "friction drives instead of braking",
        "residuum/identification/physics/effects/friction.py",
        'term=-scene.p["tau_c"]',
        'term=scene.p["tau_c"]',
        "tests/identification/physics/test_effect_conformance.py",
        "test_effect_in_its_examples and coulomb",
    ),
    Mutation(
        "the residual's threshold of a moving RMS lacks a root",
        "residuum/diagnosis/thresholds/threshold.py",
        "b * np.sqrt(spread)) ** 1.5",
        "b * spread) ** 1.5",
        "tests/diagnosis/thresholds/test_hazard_tail.py",
        "rms",
    ),
    Mutation(
        "a frame that never came is not counted",
        "residuum/service/fieldbus/sequence.py",
        "                lost += step\n",
        "                lost += 0\n",
        "tests/service/fieldbus/test_sequence_counter.py",
    ),
    Mutation(
        "a viewer may acknowledge an alarm",
        "residuum/service/security/gate.py",
        "return Role.OPERATOR if path",
        "return Role.VIEWER if path",
        "tests/service/api/test_access.py",
    ),
    Mutation(
        "the demo's training is keyed by a file that is not there",
        "residuum/service/simulated/demo.py",
        "code_digest('residuum')[:16]",
        "Path(__file__).with_name('windows.py').read_text()[:16]",
        "tests/service/simulated/test_demo_training.py",
    ),
    Mutation(
        "a gradient of the prediction error has the wrong sign",
        "residuum/identification/linear_models/prediction_error/criterion.py",
        "(p.d, by_fc, w, -1.0, 1, o.nf),",
        "(p.d, by_fc, w, 1.0, 1, o.nf),",
        "tests/identification/linear_models/prediction_error/test_prediction_error.py",
        "gradient",
    ),
    Mutation(
        "AIC without its penalty",
        "residuum/identification/linear_models/prediction_error/order_selection.py",
        '"aic": 2 * likelihood + 2 * orders.count',
        '"aic": 2 * likelihood',
        "tests/identification/linear_models/prediction_error/test_order_selection.py",
        "costs",
    ),
    Mutation(
        "a bar is ten kilopascals",
        "residuum/identification/common_units.py",
        'NamedUnit("bar", 1e5, _PRESSURE)',
        'NamedUnit("bar", 1e4, _PRESSURE)',
        "tests/identification/test_units.py",
    ),
    Mutation(
        "an alarm never clears",
        "residuum/service/alarms/alarm_states.py",
        "    if seen == status.condition:\n",
        "    if seen == status.condition or not seen:\n",
        "tests/service/alarms/test_alarm_states.py",
    ),
    Mutation(
        "an idempotency key is ignored",
        "residuum/service/storage/rows/windows.py",
        '"idempotency_key": idempotency_key,',
        '"idempotency_key": None,',
        "tests/service/storage/test_disk_store.py",
        "test_one_key_stores_once",
    ),
    Mutation(
        "the first line of a signal block is not looked at",
        "residuum/service/storage/blocks.py",
        "if stream.read(len(MAGIC)) != MAGIC:",
        "if not stream.read(len(MAGIC)):",
        "tests/service/storage/test_disk_store.py",
        "block or bit",
    ),
    Mutation(
        "kurtosis is not divided by the square of the variance",
        "residuum/diagnosis/vibration/vibration_indicators.py",
        "fourth / second**2",
        "fourth / second",
        "tests/diagnosis/vibration/test_kurtogram_and_bands.py",
        "indicators",
    ),
    Mutation(
        "the healthy limit is at another quantile",
        "residuum/diagnosis/thresholds/tails.py",
        "student.isf(false_alarm, self.n - 1)",
        "student.isf(2 * false_alarm, self.n - 1)",
        "tests/diagnosis/vibration/test_sensor_and_severity.py",
        "healthy_limit",
    ),
    Mutation(
        "a fold trains on what it is judged by",
        "residuum/identification/linear_models/prediction_error/order_selection.py",
        "(slice(start), slice(stop, None))",
        "(slice(start), slice(start, None))",
        "tests/identification/linear_models/prediction_error/test_order_selection.py",
    ),
    Mutation(
        "an empty cell of a CSV file is zero",
        "residuum/identification/record_formats/csv.py",
        '_EMPTY_CELL.sub(b"nan", body)',
        '_EMPTY_CELL.sub(b"0", body)',
        "tests/identification/record_formats/test_csv.py",
    ),
    Mutation(
        "the words of a Modbus number are swapped",
        "residuum/service/fieldbus/modbus/channel_registers.py",
        'words[:, ::-1] if word_order == "little" else words',
        'words[:, ::-1] if word_order == "big" else words',
        "tests/service/fieldbus/test_register_maps.py",
    ),
    Mutation(
        "a DBC file's factor is ignored",
        "residuum/service/fieldbus/can/frame_layout.py",
        "raw.astype(float)) * self._scale + self._offset",
        "raw.astype(float)) + self._offset",
        "tests/service/fieldbus/test_frame_layout.py",
    ),
    Mutation(
        "a controller needs no certificate",
        "residuum/robust_control/weights/performance_weight.py",
        "return design if design.certified < limit and design.stable else None",
        "return design",
        "tests/robust_control/synthesis/test_structured_synthesis.py",
        "nominal or impossible",
    ),
    Mutation(
        "the page does not ask for a key",
        "residuum/service/web/assets/js/lib/api.js",
        "response.status === 401",
        "response.status === 499",
        "tests/service/web/test_plant_and_machine_pages.py",
        "with_keys",
    ),
    Mutation(
        "a webhook that sends elsewhere has received",
        "residuum/service/notifications.py",
        "build_opener(_NoDetour)",
        "build_opener()",
        "tests/service/test_notifications.py",
        "sends_elsewhere",
    ),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the mutations asked for; 0 when the tests of each were green before and red after."""
    parser = argparse.ArgumentParser(
        description="Make the code wrong on purpose and see whether its tests turn red."
    )
    parser.add_argument("--from", dest="first", type=int, default=1, help="the first one's number")
    parser.add_argument(
        "--to", dest="last", type=int, default=len(MUTATIONS), help="the last one's number"
    )
    chosen = parser.parse_args(arguments)
    print(
        "| | mutation | tests | before | after | seconds |\n|---:|---|---|---|---|---:|", flush=True
    )
    well = True
    with tempfile.TemporaryDirectory(prefix="residuum-mutations-") as name:
        folder = Path(name)
        _copy_sources(folder)
        for number in range(chosen.first, chosen.last + 1):
            mutation, begin = MUTATIONS[number - 1], time.perf_counter()
            before = _colour(mutation, folder)
            mutation.apply(folder)
            after = _colour(mutation, folder)
            shutil.copy2(ROOT / mutation.file, folder / mutation.file)
            tests = f"`{mutation.tests}`" + (f" -k '{mutation.chosen}'" if mutation.chosen else "")
            seconds = time.perf_counter() - begin
            print(
                f"| {number} | {mutation.name} | {tests} | {before} | {after} | {seconds:.0f} |",
                flush=True,
            )
            well &= (before, after) == ("green", "red")
    return 0 if well else 1


def _copy_sources(folder: Path) -> None:
    """What git knows or would take, as it lies in the work tree."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def _colour(mutation: Mutation, folder: Path) -> str:
    """Green, red, or why it is neither: tests that cannot be collected prove nothing."""
    command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", mutation.tests]
    command += ["-k", mutation.chosen] if mutation.chosen else []
    done = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    colours = {pytest.ExitCode.OK: "green", pytest.ExitCode.TESTS_FAILED: "red"}
    if done.returncode not in colours:
        return f"status {done.returncode}: {' '.join(done.stdout.split())[-200:]}"
    return colours[pytest.ExitCode(done.returncode)]


if __name__ == "__main__":
    sys.exit(main())
