# Every command sets up its own virtual environment in .venv: the run-time packages for the demo
# and the development packages for the rest, pinned by constraints.txt.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PINS := constraints.txt
# a test process for each core; ARGS='-n 0' for one
IN_PARALLEL := --numprocesses auto --dist worksteal
# The second name pins what builds the package too; pip before 25.3 reads the first for that.
PIP := PIP_CONSTRAINT=$(PINS) PIP_BUILD_CONSTRAINT=$(PINS) PIP_DISABLE_PIP_VERSION_CHECK=1 \
	$(BIN)/python -m pip install --quiet

.DEFAULT_GOAL := help
.PHONY: help demo test slow check bench studies clean

help: ## list these commands
	@echo "make demo          identify two records: a real building and a simulated shaker test"
	@echo "make demo FILE=…   identify your own file; more options as ARGS='--dt 0.01 --order 12'"
	@echo "make test          run the tests, on all cores; ARGS='-n 0 -k name' on one, by name"
	@echo "make slow          run the longer evidence and the benchmarks' self-test"
	@echo "make check         check format and lint (ruff) and types (mypy --strict)"
	@echo "make bench         write docs/benchmarks.md; ARGS=--quick for small sizes, ARGS='--only W5'"
	@echo "make studies       run the Monte-Carlo studies and write docs/studies (hours; goes on where"
	@echo "                   it stopped); some: ARGS='blind blind_acceptance --minutes 50 --workers 2'"
	@echo "make clean         remove .venv, caches and build products"
	@echo "Each sets up .venv by itself with $(PYTHON); another one: make test PYTHON=python3.12"

demo: $(VENV)/core.stamp
	$(BIN)/vibrid demo $(if $(FILE),"$(FILE)") $(ARGS)

test: $(VENV)/dev.stamp
	$(BIN)/python -m pytest $(IN_PARALLEL) $(ARGS)

slow: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -m slow $(IN_PARALLEL) $(ARGS)

check: $(VENV)/dev.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy --strict vibrid

bench: $(VENV)/dev.stamp
	$(BIN)/python -m benchmarks $(ARGS)

studies: $(VENV)/dev.stamp
	$(BIN)/python -m studies $(ARGS)

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Small matrices and few cores: more BLAS threads cost more than they give, and times would vary.
test slow bench studies: export OPENBLAS_NUM_THREADS := 1
test slow bench studies: export OMP_NUM_THREADS := 1
test slow bench studies: export MKL_NUM_THREADS := 1

$(VENV)/core.stamp: pyproject.toml $(PINS) | $(VENV)/made.stamp
	@echo "Installing what vibrid needs into $(VENV) …"
	@$(PIP) --editable .
	@touch $@

$(VENV)/dev.stamp: pyproject.toml $(PINS) | $(VENV)/made.stamp
	@echo "Installing what development needs into $(VENV) …"
	@$(PIP) --editable '.[dev]'
	@touch $(VENV)/core.stamp $@

$(VENV)/made.stamp:
	@command -v $(PYTHON) >/dev/null || { \
	  echo "There is no $(PYTHON); install Python 3.11 or newer, or say make … PYTHON=path." >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "vibrid needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1)." \
	    "Say for example: make … PYTHON=python3.12" >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "$(PYTHON) cannot make virtual environments (ensurepip or venv is missing)." \
	    "On Debian and Ubuntu: apt install python3-venv" >&2; \
	  exit 1; }
	@$(PYTHON) -m venv --clear $(VENV)
	@touch $@
