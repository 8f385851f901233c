# The two commands are `make demo` and `make test`; a machine needs Python 3.11 or newer with venv, and make.
PYTHON ?= python3.11
VENV ?= .venv
ARGS ?=
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.joulemap-installed

.PHONY: help demo check test test-slow mutants bench lint format docs openapi clean distclean

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

demo: $(INSTALLED) ## start the service, ask it everything, draw a picture (ARGS=--exit ends by itself)
	$(BIN)/joulemap demo $(ARGS)

# A process for each core; the tests of a file stay together, because they share what is made for them, and the files
# that take long come first (tests/conftest.py).
PARALLEL := -n logical --maxprocesses 8 --dist loadfile --no-loadscope-reorder --max-worker-restart 0

# Files of tests/unit that take seconds and touch every room: the loop while writing code.
QUICK := battery budget chunks edges frames heightmap held_readings lattice log_tables metrics mixed_model patches physics \
	places point_clouds polylines readers reproject risk robot run_words settings smoothing speeds

check: lint ## the linters and the quickest unit tests, in under two minutes
	$(BIN)/python -m pytest $(PARALLEL) $(QUICK:%=tests/unit/test_%.py) $(ARGS)

test: lint ## what must pass before a change is taken: linters, types, layers, documentation, tests
	$(BIN)/python -m pytest -m "not slow" $(PARALLEL) --durations=40 --durations-min=5 $(ARGS)

test-slow: $(INSTALLED) ## the tests that take minutes
	$(BIN)/python -m pytest -m slow $(ARGS)

mutants: $(INSTALLED) ## random changes of the product, and which of them the tests notice (ARGS="--mutants 60 --seed 1")
	$(BIN)/python -m tests.mutants $(ARGS)

bench: $(INSTALLED) ## seconds for every step, compared with SciPy, on this machine
	$(BIN)/python -m tests.bench $(ARGS)

lint: $(INSTALLED) ## ruff, mypy, the layers of the architecture, docstrings of what users call, the budget of the code
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.docs.docstrings
	$(BIN)/python -m tests.budget

format: $(INSTALLED) ## let ruff correct what it can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(INSTALLED) ## build the documentation into build/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

openapi: $(INSTALLED) ## write openapi/openapi.json, its hash and the list of operations
	$(BIN)/python -m tests.service.api_digest

clean: ## remove caches and the demo's output (data/ and $(VENV) stay)
	rm -rf build dist demo *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find model planner service joulemap tests -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## remove the environment too
	rm -rf $(VENV)

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# Installed anew when the dependencies change. The kernels are compiled here so that nobody waits for them later; those
# of an earlier version are removed first, because their cache remembers module names. Byte code is made here too: where
# PYTHONDONTWRITEBYTECODE is set, every command would compile a hundred modules at its start.
$(INSTALLED): pyproject.toml | $(BIN)/python
	@echo "joulemap and its libraries are installed, which takes a few minutes once"
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --editable '.[dev]'
	find model planner service -name '*.nb[ci]' -delete
	$(BIN)/python -m compileall -q joulemap model planner service
	$(BIN)/joulemap warmup
	touch $@
