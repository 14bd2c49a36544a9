#!/bin/sh
# Debian packages that tests use: a browser for the pages, database servers, a message broker, proxies
# that end TLS and a tracer of programs. Installed
# only as root and only where absent; the tests start servers of their own, so none of the system has to run.
set -u
have() { PATH="$PATH:/usr/sbin:/usr/lib/postgresql/$(ls /usr/lib/postgresql 2>/dev/null | tail -n 1)/bin" command -v "$1" >/dev/null 2>&1; }
missing=""
have chromium || missing="$missing chromium fonts-dejavu-core"
have initdb || missing="$missing postgresql"
have strace || missing="$missing strace"
have nginx || missing="$missing nginx-light"
have caddy || missing="$missing caddy"
have mosquitto || missing="$missing mosquitto"
have influxd || missing="$missing influxdb"
[ -z "$missing" ] && exit 0
if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null 2>&1; then
    echo "installing for the tests (once):$missing"
    export DEBIAN_FRONTEND=noninteractive
    # shellcheck disable=SC2086
    { apt-get update -qq && apt-get install -y -qq --no-install-recommends $missing; } >/dev/null 2>&1 && exit 0
fi
echo "not here and cannot be installed:$missing; the tests that need them will say that they were skipped"
