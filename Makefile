# facewright: `make demo` and `make test` do everything on a fresh machine.
# Another Python: make setup PYTHON=/path/to/python3.12     Real test data: FACEWRIGHT_TEST_DATA=/path/to/data

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-builtin-rules

VENV := .venv
VENV_NUMPY2 := .venv-numpy2
PY := $(VENV)/bin/python
PY2 := $(VENV_NUMPY2)/bin/python
PIP_INSTALL := -m pip install --quiet --disable-pip-version-check --no-input
PYTHON ?= $(shell sh tools/find_python.sh 3.11 3.12)
PYTHON_NUMPY2 ?= $(shell sh tools/find_python.sh 3.12 3.11)
PYTEST_ARGS ?=
BENCH_ARGS ?=

ifneq ($(wildcard ../shared/data/README.md),)
export FACEWRIGHT_TEST_DATA ?= $(abspath ../shared/data)
endif

.PHONY: help setup demo browser test test-all test-numpy2 check format bench docs clean

help: ## Show this list
	@sed -n 's/^\([a-z0-9-]*\):.*## \(.*\)/  make \1	\2/p' $(firstword $(MAKEFILE_LIST)) | expand -t 24

setup: $(VENV)/.installed ## Make .venv and install everything with pinned versions

$(VENV)/.installed: pyproject.toml constraints/numpy1-landmarks.txt tools/ensure_system_libraries.sh
	@test -n "$(PYTHON)" || exit 2
	@echo "Making $(VENV) with $(PYTHON); the first install takes a few minutes."
	@test -x $(PY) || { rm -rf $(VENV); "$(PYTHON)" -m venv $(VENV); }
	@$(PY) $(PIP_INSTALL) -c constraints/numpy1-landmarks.txt -e ".[landmarks,video,capture,warehouse,mocap,studio,dev]"
	@sh tools/ensure_system_libraries.sh $(PY) cv2 mediapipe open3d
	@touch $@

$(VENV_NUMPY2)/.installed: pyproject.toml constraints/numpy2.txt tools/ensure_system_libraries.sh
	@test -n "$(PYTHON_NUMPY2)" || exit 2
	@echo "Making $(VENV_NUMPY2) with $(PYTHON_NUMPY2)."
	@test -x $(PY2) || { rm -rf $(VENV_NUMPY2); "$(PYTHON_NUMPY2)" -m venv $(VENV_NUMPY2); }
	@$(PY2) $(PIP_INSTALL) -c constraints/numpy2.txt -e ".[video,capture,warehouse,mocap,studio,dev]"
	@sh tools/ensure_system_libraries.sh $(PY2) open3d
	@touch $@

demo: setup ## Run the tour and leave demo/index.html
	@$(VENV)/bin/facewright demo --out demo

browser: setup ## Find or install a Chromium for the tests of the pages
	@sh tools/ensure_browser.sh $(PY)

test: setup ## Run the default tests
	@$(PY) -m pytest -m "not slow" $(PYTEST_ARGS)

test-all: setup ## Run all tests, the slow ones too
	@$(PY) -m pytest $(PYTEST_ARGS)

test-numpy2: $(VENV_NUMPY2)/.installed ## Run the detector-free tests under NumPy 2
	@$(PY2) -m pytest -m "not slow and not landmarks" $(PYTEST_ARGS)

check: setup ## Lint, format, types, import contracts, docs
	@$(PY) -m ruff check .
	@$(PY) -m ruff format --check .
	@$(PY) -m mypy
	@$(VENV)/bin/lint-imports --no-cache
	@$(PY) tools/check_docs.py

format: setup ## Format the code
	@$(PY) -m ruff check --fix .
	@$(PY) -m ruff format .

bench: $(VENV)/.bench-installed ## Run the benchmarks against their peers (BENCH_ARGS=--quick)
	@$(PY) -m benchmarks $(BENCH_ARGS)

$(VENV)/.bench-installed: $(VENV)/.installed
	@echo "Installing the peers of the benchmarks, about 550 MB."
	@$(PY) $(PIP_INSTALL) -c constraints/numpy1-landmarks.txt -e ".[landmarks,video,capture,warehouse,mocap,studio,dev,bench]"
	@touch $@

docs: setup ## Renew docs/cli.md and the pictures of the examples
	@$(PY) tools/make_cli_docs.py
	@for example in examples/*/*.py; do test -e "$$example" || continue; echo "$$example"; $(PY) "$$example"; done

clean: ## Remove environments, caches and the demo
	rm -rf $(VENV) $(VENV_NUMPY2) demo build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find src tests tools -name __pycache__ -type d -prune -exec rm -rf {} +
