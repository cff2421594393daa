# Each target sets everything up by itself: a virtual environment in .venv, pinned by constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
PEERS := .venv/.peers
PYTEST := $(BIN)/python -m pytest -n 2
# Python keeps the modules that it compiles, also where its user says not to: tests start many processes
export PYTHONDONTWRITEBYTECODE :=

# uv unpacks on all cores; pip alone knows an index of the user's
PIP := $(BIN)/python -m pip --disable-pip-version-check
UV := ! $(PIP) config list | grep -q '\.index-url=' && $(PIP) install --quiet -c constraints.txt uv \
  && $(BIN)/uv pip install --quiet --python $(BIN)/python -c constraints.txt -e '.[test]'

.PHONY: demo test test-all lint bench notebooks docs clean

demo: $(READY)
	$(BIN)/jaxisp demo --out demo

# most programs run once and compile quickly; tests marked `optimised` compile as users do, and what they compile
# and fit serves others of their file; the files without any take seconds to import
OPTIMISED := $$(grep -rl --include='test_*.py' mark.optimised tests)

test: $(READY)
	JAXISP_TESTS_QUICK=1 $(PYTEST) --dist worksteal -m "not slow and not optimised"
	$(PYTEST) --dist loadgroup --no-loadscope-reorder -m "not slow and optimised" $(OPTIMISED)

test-all: $(READY)
	JAXISP_TESTS_QUICK=1 $(PYTEST) --dist worksteal -m "not slow and not optimised"
	$(PYTEST) --dist loadgroup --no-loadscope-reorder -m "slow or optimised"

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

notebooks: $(READY)
	JAXISP_NOTEBOOKS=all $(BIN)/python -m pytest tests/test_notebooks.py --durations=0

# with the notebooks' pictures where `make notebooks` has run
docs: $(READY)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build
	@echo docs/_build/index.html

bench: $(PEERS)
	@status=0; for part in exactness peers stages; do $(BIN)/python -m benchmarks.$$part || status=1; done; exit $$status

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "jaxisp needs Python 3.11 or later; say which with: make PYTHON=python3.12 ..."; exit 1; }
	$(PYTHON) -m venv .venv
	@$(UV) || $(PIP) install --quiet --no-compile -c constraints.txt -e '.[test]'
	@touch $@

# large, and only for comparison: without them the tables say that they are not installed
$(PEERS): $(READY)
	$(PIP) install --quiet -c constraints.txt -e '.[test,bench]' \
	  || echo "torch, kornia and AlbumentationsX could not be installed: their comparisons are left out"
	@touch $@

clean:
	rm -rf .venv demo build docs/_build *.egg-info .mypy_cache .ruff_cache
