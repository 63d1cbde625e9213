# Every target sets up its own virtual environment first; nothing else on the machine is touched.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= out
CONSTRAINTS ?= constraints.txt
# Matrices here have some hundred rows: BLAS threads cost more than they bring.
export OPENBLAS_NUM_THREADS ?= 1
# Where an environment forbids it, every process would compile 500 files anew: a quarter of its start.
unexport PYTHONDONTWRITEBYTECODE

PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# files in their own order: sorted by the number of their tests, long ones would come last
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

.PHONY: help demo test campaigns studies test-oldest lint bench docs coverage snapshot wheel clean
.DEFAULT_GOAL := demo

$(BIN)/.installed: pyproject.toml $(CONSTRAINTS)
	$(PYTHON) -c 'import sys; sys.exit("Ambrose needs Python >= 3.11; call make PYTHON=python3.11" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(PIP) -c $(CONSTRAINTS) -e '.[dev]'
	@touch $@

help:  ## this list
	@sed -n 's/^\([a-z-]*\):[^#]*##  *\(.*\)/\1: \2/p' $(MAKEFILE_LIST) | awk -F ': ' '{ printf "make %-12s%s\n", $$1, substr($$0, length($$1) + 3) }'
	@echo 'Variables: PYTHON=python3.12, VENV=.venv, OUT=out'

demo: $(BIN)/.installed  ## the main job, and what `make` does: machine file -> verdict -> report (a failed check is no error here)
	$(BIN)/ambrose study seal-rig -o $(OUT)/seal-rig || test $$? -eq 1

test: $(BIN)/.installed  ## the tests, about four minutes on two processors
	$(PYTEST) -m 'not campaign and not study'

campaigns: $(BIN)/.installed  ## the long tests that `make test` leaves out, eleven minutes
	$(PYTEST) -m 'campaign and not study'

studies: $(BIN)/.installed  ## the papers' figures, and hundreds of random cases: half an hour, outside of CI
	$(PYTEST) -m study

lint: $(BIN)/.installed  ## ruff, mypy, and the layer contract
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(BIN)/.installed  ## speed and accuracy beside the peers
	$(PIP) -c $(CONSTRAINTS) -e '.[bench]'
	$(BIN)/python -m benchmarks

docs: $(BIN)/.installed  ## the documentation as a site in site/; a broken link fails
	$(PIP) -c $(CONSTRAINTS) -e '.[docs]'
	$(BIN)/python -m mkdocs build --strict

coverage: $(BIN)/.installed  ## all tests with the lines that none of them reaches, in OUT/coverage
	$(PYTEST) --cov --cov-report=term --cov-report=html:$(OUT)/coverage --cov-report=xml:$(OUT)/coverage.xml

snapshot: $(BIN)/.installed  ## every number of every command, to compare before and after a change (LEVEL=--quick: minutes)
	@mkdir -p $(OUT)
	$(BIN)/python -m benchmarks.snapshot $(LEVEL) -o $(OUT)/snapshot.json

wheel: $(BIN)/.installed  ## the wheel in OUT/dist, built and used outside the checkout
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir $(OUT)/dist .
	$(BIN)/python -m pytest -m wheel

test-oldest:  ## the same tests with the lower bounds of pyproject.toml, in a virtual environment of its own (Python 3.11)
	$(MAKE) test VENV=$(VENV)-oldest CONSTRAINTS=constraints-oldest.txt

clean:  ## removes the virtual environments and all that the targets wrote
	rm -rf $(VENV) $(VENV)-oldest $(OUT) site
