# Every target sets up its own virtual environment first; nothing else on the machine is touched.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= out
CONSTRAINTS ?= constraints.txt
EXTRAS ?= dev
# what differs from this decides which slow tests `make test` runs; without it, the main branch
BASE ?=
# Matrices here have some hundred rows: BLAS threads cost more than they bring.
export OPENBLAS_NUM_THREADS ?= 1
# As the command line does: for small matrices OpenBLAS's kernels for AVX-512 take longer than those before them.
ifneq ($(shell grep -m 1 -o avx512f /proc/cpuinfo 2> /dev/null),)
export OPENBLAS_CORETYPE ?= Haswell
endif
# Where an environment forbids it, every process would compile 500 files anew: a quarter of its start.
unexport PYTHONDONTWRITEBYTECODE

# modules are compiled when they are first imported: most of what would be compiled here never is
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
# whole files to a worker, in the order of tests/reach.py: the longest first
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m 'not study and not source'

.PHONY: help demo test test-all studies durations test-oldest lint bench docs coverage snapshot wheel clean
.DEFAULT_GOAL := demo

$(BIN)/.installed: pyproject.toml $(CONSTRAINTS)
	$(PYTHON) -c 'import sys; sys.exit("Ambrose needs Python >= 3.11; call make PYTHON=python3.11" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(PIP) -c $(CONSTRAINTS) -e '.[$(EXTRAS)]'
	@touch $@

help:  ## this list
	@sed -n 's/^\([a-z-]*\):[^#]*##  *\(.*\)/\1: \2/p' $(MAKEFILE_LIST) | awk -F ': ' '{ printf "make %-12s%s\n", $$1, substr($$0, length($$1) + 3) }'
	@echo 'Variables: PYTHON=python3.12, VENV=.venv, OUT=out, BASE=main (of make test)'

demo: $(BIN)/.installed  ## the main job, and what `make` does: machine file -> verdict -> report (a failed check is no error here)
	$(BIN)/ambrose study seal-rig -o $(OUT)/seal-rig || test $$? -eq 1

test: $(BIN)/.installed  ## the tests: quick ones, and slow ones that reach what differs from the main branch (all on CI)
	$(PYTEST) $(if $(BASE),--base $(BASE))

test-all: $(BIN)/.installed  ## all tests, whatever differs: about ten minutes on two processors
	$(PYTEST) --all

studies: $(BIN)/.installed  ## the papers' figures, and hundreds of random cases: half an hour, outside of CI
	$(BIN)/python -m pytest -n auto --all -m study

durations: $(BIN)/.installed  ## all tests, and tests/durations.json anew: how long each takes (on an idle computer)
	$(PYTEST) --all --renew-durations

lint: $(BIN)/.installed  ## ruff, the layer contract, the tests that read our own sources and prose, mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -m source tests/test_house.py tests/docs
	$(BIN)/mypy

bench: $(BIN)/.installed  ## speed and accuracy beside the peers
	$(PIP) -c $(CONSTRAINTS) -e '.[bench]'
	$(BIN)/python -m benchmarks

docs: $(BIN)/.installed  ## the documentation as a site in site/; a broken link fails
	$(PIP) -c $(CONSTRAINTS) -e '.[docs]'
	$(BIN)/python -m mkdocs build --strict

coverage: $(BIN)/.installed  ## all tests with the lines that none of them reaches, in OUT/coverage
	$(PYTEST) --all --cov --cov-report=term --cov-report=html:$(OUT)/coverage --cov-report=xml:$(OUT)/coverage.xml

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
