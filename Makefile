# make demo   install into .venv, make a few garments on the CPU, load them, leave pictures in demo/
# make test   install into .venv, then lint, types and tests
# make lint   format and lint in place

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
# A process a core, of one thread each; more than eight would have too little memory to themselves.
SHARED_OUT := --numprocesses logical --maxprocesses 8 --dist worksteal

.PHONY: demo test lint

demo: $(INSTALLED)
	$(BIN)/python -m benchmarks.demo --out demo

test: $(INSTALLED)
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest $(SHARED_OUT) --doctest-modules gcd_dataset tests

lint: $(INSTALLED)
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("gcd_dataset needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@
