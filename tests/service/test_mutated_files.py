"""A short version of the campaign of mutated files; the long one is `python -m benchmarks.files`."""

import subprocess
import sys

from benchmarks.files import FORMATS


def test_no_mutant_of_any_format_ends_its_reader_or_gets_more_than_one_line():
    command = [
        sys.executable,
        "-W",
        "ignore",
        "-m",
        "benchmarks.files",
        "--mutants",
        "12",
        "--whole-way",
        "0",
        "--seed",
        "5",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split("|")[1:-1] for line in done.stdout.splitlines()[2:]]
    assert [row[0].strip() for row in rows] == FORMATS
    for _, read, refused, ended, memory, _, _ in rows:
        # whoever takes more than the limits of an upload is ended
        assert int(ended) == 0 and int(read) + int(refused) == 12
        assert int(memory) <= 512
