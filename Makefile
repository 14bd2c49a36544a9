# run · test · check · bench · docs · soak · sbom · lock · audit · reproduce — each makes .venv first; nothing else has to be installed.
PYTHON ?= python3
BIN := .venv/bin
MAKEFLAGS += --no-print-directory
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: run test check bench docs soak sbom lock audit reproduce clean
.DEFAULT_GOAL := run

.venv/run: pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv || { rm -rf .venv; echo "make: $(PYTHON) cannot make a virtual environment; on Debian: apt-get install python3-venv"; exit 1; }
	@echo "installing residuum into .venv (once; about a minute)"
	@if [ -n "$(LOCKED)" ]; then $(BIN)/python -m pip install -qq --no-compile --require-hashes -r deploy/run.lock; fi
	@$(BIN)/python -m pip install -qq --no-compile $(if $(LOCKED),--no-deps) -e .
	@touch $@

.venv/dev: pyproject.toml .venv/run
	@echo "installing what the tests need into .venv (once)"
	@$(BIN)/python -m pip install -qq -e '.[dev,docs,notebook,formats,parquet,postgres,mqtt,oidc,fleet,fmi,opcua,sparkplug]'
	@touch $@

# LOCKED=1: with the packages of deploy/run.lock and no others, each compared with its hash.
run: .venv/run
	@$(BIN)/residuum serve --demo

test: .venv/dev
	@sh tests/system_packages.sh
	@sh tests/at_once.sh $(BIN)/python

check: .venv/dev
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/biome ci --error-on-warnings residuum/service/web/assets/js

# The reference pages from the code, and the site that the service shows under /docs/.
docs: .venv/dev
	@$(BIN)/python docs/make_reference.py
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

bench: .venv/dev
	@$(BIN)/python -m benchmarks

soak: .venv/dev
	@$(BIN)/python -m benchmarks.durability --kills 1000 --windows 55 --keep soak-durability.jsonl
	@$(BIN)/python -m benchmarks.modbus --faults 10000 --devices 10
	@$(BIN)/python -m benchmarks.can --faults 10000
	@$(BIN)/python -m benchmarks.http_cases --cases 20000
	@$(BIN)/python -m benchmarks.overload --seconds 60
	@$(BIN)/python -m benchmarks.fleet --jobs 10000 --samples 1024
	@$(BIN)/python -W ignore -m benchmarks.files --mutants 2000
	@$(BIN)/python -m benchmarks.soak --hours 24 --speed 5

# What an installation holds, and nothing of what only its development needs: CycloneDX 1.6 in residuum.cdx.json.
sbom: .venv/dev
	@rm -rf build/sbom && $(PYTHON) -m venv build/sbom
	@build/sbom/bin/python -m pip install -qq '.[formats,parquet,postgres,mqtt,oidc,fleet,fmi,opcua,sparkplug]'
	@build/sbom/bin/python -m pip uninstall -qq -y pip setuptools
	@$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible --validate -o residuum.cdx.json build/sbom/bin/python
	@rm -rf build/sbom && echo "written: residuum.cdx.json"

# The packages of an installation and of the image with their hashes, in the versions with which the tests have run.
LOCK = build/lock/bin/uv pip compile -q --generate-hashes --universal --python-version 3.11 --no-annotate --custom-compile-command "make lock"
lock: .venv/dev
	@rm -rf build/lock && $(PYTHON) -m venv build/lock && build/lock/bin/python -m pip install -qq uv
	@$(BIN)/python -m pip freeze --exclude-editable | grep == > build/lock/tested.txt
	@$(LOCK) -c build/lock/tested.txt pyproject.toml -o deploy/run.lock
	@$(LOCK) -c build/lock/tested.txt $(foreach extra,postgres mqtt oidc opcua sparkplug parquet,--extra $(extra)) pyproject.toml -o deploy/image.lock
	@rm -rf build/lock && echo "written: deploy/run.lock, deploy/image.lock"

# Known vulnerabilities of what is locked; asks a database on the network, and fails where it does not answer.
audit:
	@test -x build/audit/bin/pip-audit || { $(PYTHON) -m venv build/audit && build/audit/bin/python -m pip install -qq pip-audit; }
	@build/audit/bin/pip-audit --require-hashes --disable-pip --strict --progress-spinner off -r deploy/image.lock

reproduce: .venv/dev
	@$(BIN)/python -m reproduction

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache
