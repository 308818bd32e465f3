# Smokeglint. `make help` lists what there is; each target sets up the environment it needs by itself.
PYTHON ?= python3
VENV ?= .venv
CASE ?= demo
ROOT ?= artifacts
# e.g. PIP_ARGS="--index-url URL" for an index of your own; where torch would come with CUDA, name a CPU index here.
PIP_ARGS ?=
SERVICES = access prioritization planning retrieval arrival
PY = $(VENV)/bin/python
READY = $(VENV)/.ready-$(shell cat requirements.lock pyproject.toml | cksum | cut -d' ' -f1)
# Spinning OpenMP threads cost eight times the time on shared cores.
export OMP_WAIT_POLICY = PASSIVE

.DEFAULT_GOAL := help
.PHONY: help setup demo serve desk test lint bench reliability up clean lock $(SERVICES:%=bench-%) $(SERVICES:%=bench-%-long)

help: ## this list
	@grep -hE '^[a-z%-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 16

$(READY):
	@echo "Setting up the environment in $(VENV) (once; about 3 minutes and 3 GB: PyTorch, solvers, geodata) ..."
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or later is needed (PYTHON=...)"; exit 1; }
	@test -x $(PY) || $(PYTHON) -m venv $(VENV)
	@$(PY) -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) --requirement requirements.lock
	@printf '#!/bin/sh\nPYTHONPATH="%s" exec "%s/bin/python" -m flows.commands "$$@"\n' "$(CURDIR)" "$(abspath $(VENV))" > $(VENV)/bin/smokeglint
	@chmod +x $(VENV)/bin/smokeglint
	@rm -f $(VENV)/.ready-* && touch $@
	@echo "The environment is ready."

setup: $(READY) ## set up the environment only

demo: $(READY) ## run a case: CASE=demo or tiny (simulated); real, with SMOKEGLINT_DATA: black-2022, la-2025, smokehouse-2024, conus-2023-07-05; live
	@$(PY) -m flows.demo --case $(CASE) --root $(ROOT)

test: $(READY) ## all tests, in parallel
	@echo "Running the tests ..."
	@$(PY) -m pytest -q -n 2 --dist loadgroup $(TESTS)

lint: $(READY) ## ruff, mypy (strict on shared/), a scan for secrets, an audit of dependencies
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/mypy --strict shared
	@$(PY) -m tests.lint.secrets
	@$(PY) -m tests.lint.dependencies

bench: $(SERVICES:%=bench-%) ## every service's benchmark, one JSON object a line

$(SERVICES:%=bench-%): bench-%: $(READY)
	@$(PY) -m tests.bench.bench_$*

$(SERVICES:%=bench-%-long): bench-%-long: $(READY)
	@$(PY) -m tests.bench.bench_$* --long

reliability: $(READY) ## random kills, a full disk, many readers, a day of hourly cycles: see docs/reliability.md
	@$(PY) -m tests.bench.reliability.load
	@$(PY) -m tests.bench.reliability.chaos
	@$(PY) -m tests.bench.reliability.disk_full
	@$(PY) -m tests.bench.reliability.soak

serve: $(READY) ## daily cycles and hourly ratings of CASE on their schedules, until it is ended
	@$(PY) -m flows.commands serve --case $(CASE) --root $(ROOT)

desk: $(READY) ## the page for operators, on http://127.0.0.1:8000
	@SMOKEGLINT_DESK_ARTIFACT_ROOT=$(ROOT) $(PY) -m uvicorn flows.desk.app:app --port 8000 --no-access-log

up: ## the services in containers (docker compose)
	docker compose up --build

lock: $(READY) ## write requirements.lock anew from pyproject.toml
	@$(VENV)/bin/pip-compile --quiet --extra dev --extra traces --strip-extras --no-emit-index-url --no-emit-find-links --no-emit-options \
	  --no-annotate --no-header --output-file requirements.lock pyproject.toml
	@# A local label such as 2.13.0+cpu is not served by other indexes.
	@sed -i 's/^torch==\([0-9.]*\)+cpu$$/torch==\1/' requirements.lock

clean: ## remove what runs and tests made (not the environment)
	rm -rf $(ROOT) .pytest_cache .mypy_cache .ruff_cache .hypothesis .cache
