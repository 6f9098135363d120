# `make help` lists the targets.  Every target sets up what it needs: a virtual environment of its own with pinned versions.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready
# Two test processes share the cores; threads of the linear algebra below them would only wait for each other.
export OPENBLAS_NUM_THREADS := 1

.DEFAULT_GOAL := help
.PHONY: help setup demo test lint types unit docs pins golden picture clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(READY)  ## create the virtual environment with pinned versions

$(READY): requirements.txt pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("deshybrid needs Python 3.11 or newer; call make PYTHON=python3.11 ...") if sys.version_info < (3, 11) else None'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	@touch $@

demo: $(READY)  ## compile the driveline, drive it, and run the compiled observer on the drive
	$(BIN)/python examples/driveline.py

test: lint types unit docs  ## lint, types, tests, doctests, examples, generated code, documentation

lint: $(READY)  ## style of the code
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)  ## mypy, strict
	$(BIN)/mypy

unit: $(READY)  ## tests, doctests, examples and the generated code's own self-tests
	$(BIN)/python -m pytest -n 2 -q

docs: $(READY)  ## build the documentation into docs/_build/html, without warnings
	$(BIN)/sphinx-build -q -W -b html docs docs/_build/html

pins: $(READY)  ## write requirements.txt anew from a fresh environment
	./docs/pins.sh

golden: $(READY)  ## rewrite the golden files; read the difference before you commit it
	$(BIN)/python -m pytest -q tests/golden --rewrite-golden

picture: $(READY)  ## draw the pictures of README and documentation anew
	$(BIN)/deshybrid draw models/balluchi2012/driveline.yaml --what complementary-observer -o docs/driveline-observer.svg
	$(BIN)/python docs/detections.py

clean:  ## remove the environment and everything that was built
	rm -rf $(VENV) docs/_build build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
