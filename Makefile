# make demo         install into .venv, make a few garments on the CPU, leave them and pictures in demo/
# make test         install into .venv, then lint, types and tests
# make test-extras  install into .venv-extras, then run the recipes of docs/training.md with their frameworks,
#                   make garments on a Ray cluster of several nodes, read an S3 store, check a Croissant description,
#                   call gcd-mcp as agents do,
#                   carry out the examples of CONTRIBUTING.md, run the long tests beside the others,
#                   try 60 inputs instead of 20 in each test of properties, and import a garment into Blender
# make docs         write the documentation into site/
# make release      rehearse a release: build, install on each Python that is there, publish to a stand-in; see dist/
# make fuzz N=10000  give every reader of files N damaged inputs, and print what came of them
# make lint         format and lint in place

PYTHON ?= python3
N ?= 200
BIN := .venv/bin
INSTALLED := .venv/.installed
EXTRAS := .venv-extras/bin
EXTRAS_INSTALLED := .venv-extras/.installed
BLENDER_INSTALLED := .venv-blender/.installed
DOCS_INSTALLED := .venv/.installed-docs
# uv takes half a minute where pip takes six, and links what two environments have in common; where uv finds no
# package index, as behind one that only pip knows, pip installs. Arguments: environment, packages.
UV := .venv/bin/uv
install = $(UV) pip install --quiet --python $(1) $(2) || $(1)/bin/python -m pip install --quiet $(2)
EXTRAS_OF_PACKAGE := dev,frameworks,ray,croissant,mcp,docs,browser,notebooks
LOCKED := --constraint constraints.txt --editable
# Wheels also from where pip is told to look.
export UV_FIND_LINKS ?= $(PIP_FIND_LINKS)
# The tests start hundreds of processes, each of which would compile torch, the package and the tests again.
unexport PYTHONDONTWRITEBYTECODE
# A process a core, of one thread each; more than eight would have too little memory to themselves.
SHARED_OUT := --numprocesses logical --maxprocesses 8 --dist worksteal

.PHONY: demo test test-extras docs release fuzz lint

demo: $(INSTALLED)
	$(BIN)/gcd generate demo/garments --count 8 --seed 4 --bodies both --device cpu --resolution 2 --picture 384
	$(BIN)/gcd show demo/garments --index 0-7 --sheet demo/contact_sheet.png

test: $(INSTALLED)
	! git grep -nE '^(<<<<<<<|>>>>>>>) '
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy --num-workers auto
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest $(SHARED_OUT) --doctest-modules -m "not long" --ignore tests/extras gcd_dataset tests

test-extras: $(EXTRAS_INSTALLED) $(BLENDER_INSTALLED)
	OMP_NUM_THREADS=1 $(EXTRAS)/python -m pytest $(SHARED_OUT) -m "extras or hypothesis or long" --hypothesis-profile many --durations 20 tests

docs: $(DOCS_INSTALLED)
	$(BIN)/mkdocs build --strict

release: $(INSTALLED)
	$(BIN)/python -m tools.release

fuzz: $(INSTALLED)
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz.campaign --examples $(N)

lint: $(INSTALLED)
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

$(UV):
	$(PYTHON) -c 'import sys; sys.exit("gcd_dataset needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet uv

$(INSTALLED): pyproject.toml constraints.txt | $(UV)
	$(call install,.venv,$(LOCKED) '.[dev]')
	touch $@

# Apart from .venv: what frameworks pull in is not to change what the other tests run with.
$(EXTRAS_INSTALLED): pyproject.toml constraints.txt | $(UV)
	$(PYTHON) -m venv .venv-extras
	$(call install,.venv-extras,$(LOCKED) '.[$(EXTRAS_OF_PACKAGE)]')
	touch $@

$(DOCS_INSTALLED): $(INSTALLED)
	$(call install,.venv,$(LOCKED) '.[docs]')
	touch $@

# Blender's module wants a NumPy and one version of Python of its own, and a download of 374 MB; its tests are skipped
# where it does not install.
$(BLENDER_INSTALLED): | $(UV)
	$(PYTHON) -m venv .venv-blender
	$(UV) pip install --quiet --python .venv-blender 'bpy>=4.2' && touch $@ \
	  || echo "bpy was not installed: the tests of the import into Blender are skipped; make test-extras tries again"
