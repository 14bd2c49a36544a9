#!/bin/sh
# Every test, in two halves at once: those of the service wait for buses, databases and browsers while the others compute.
# Usage: tests/at_once.sh PYTHON
set -u
said=$(mktemp)
trap 'rm -f "$said"' EXIT
"$1" -m pytest tests/service >"$said" 2>&1 &
service=$!
"$1" -m pytest --ignore=tests/service
rest=$?
wait "$service"
served=$?
cat "$said"
[ "$rest" -eq 0 ] && [ "$served" -eq 0 ]
