# Each target sets everything up by itself: a virtual environment in .venv, pinned by constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
PEERS := .venv/.peers
# tests start many processes: each would compile the package's modules again where Python may not keep them
PYTEST := PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 2
# bytecode on all cores, where pip takes one; without the tests of others
COMPILE := import compileall, re, sysconfig; compileall.compile_dir(sysconfig.get_path("purelib"), \
  quiet=2, workers=0, rx=re.compile(r"\Wtests?\W"))

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
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -c constraints.txt -e '.[test]'
	@$(BIN)/python -c '$(COMPILE)'
	@touch $@

# large, and only for comparison: without them the tables say that they are not installed
$(PEERS): $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test,bench]' \
	  || echo "torch and kornia could not be installed: their comparisons are left out"
	@touch $@

clean:
	rm -rf .venv demo build docs/_build *.egg-info .mypy_cache .ruff_cache
