#!/bin/sh
# Every test. First what a new user does, alone and to its end: without it the others prove little. Then all others in one more
# process than there are cores: tests of the service often wait, for buses, databases and browsers. A process that runs out of
# tests takes over some of another's.
# Usage: tests/at_once.sh PYTHON
set -eu
# One thread for linear algebra: the processes have the cores already, and threads that wait for a core of their own cost most.
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 MKL_NUM_THREADS=1
# Tests start some hundred interpreters: each would compile all sources anew.
unset PYTHONDONTWRITEBYTECODE
RESIDUUM_FIRST_USE=$(mktemp -d) # the environment with the wheel, which both runs use
export RESIDUUM_FIRST_USE
trap 'rm -rf "$RESIDUUM_FIRST_USE"' EXIT
first=tests/first_use/test_first_findings.py
"$1" -m pytest "$first"
"$1" -m pytest -n $(($(getconf _NPROCESSORS_ONLN) + 1)) --dist worksteal -rfEs --ignore="$first"
