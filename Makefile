# A machine needs make and Python >= 3.11 with its venv module; everything else goes into .venv.

PYTHON ?= python3
JOBS ?= 4
VEHICLE ?= configs/vehicles/generic_8jet.toml

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
# One stamp per extra, because the tests must not wait for the 660 MB dashboard.
OPERATOR := $(VENV)/.installed-operator
DASHBOARD := $(VENV)/.installed-dashboard
DEV := $(VENV)/.installed-dev

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help demo test retest lint check format constraints clean venv wheel firmware mutants fuzz gate

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(OPERATOR)  ## Fly zhang2023's experiment on the twin of the table
	@$(BIN)/testbed run zhang2023_table

# One process more than cores: a third of the time tests wait for something that flies in real time.
test: $(DEV)  ## Run the tests (JOBS=4: processes at most)
	@$(BIN)/python -m pytest -n $$(($$(nproc) + 1)) --maxprocesses $(JOBS)

retest: $(DEV)  ## Run what failed in the last `make test` once more, one test at a time
	@$(BIN)/python -m pytest --last-failed --last-failed-no-failures none

lint: $(DEV)  ## Check format, style, types and the direction of imports
	@$(BIN)/ruff format --check
	@$(BIN)/ruff check
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo

check: lint test  ## Everything CI runs: lint, then test

wheel: $(DEV)  ## Build a wheel with machine code, with which no first flight compiles: 5 minutes
	@rm -rf testbed/machine_code
	@trap 'rm -rf testbed/machine_code' EXIT; \
		$(BIN)/python -m testbed.run.machine_code testbed/machine_code && \
		$(PIP) wheel -q --no-deps --no-build-isolation -w dist . && ls dist/*.whl

firmware: $(DEV)  ## Build the valve board's image (VEHICLE=configs/vehicles/generic_8jet.toml)
	@$(BIN)/python -m firmware_interface.compiler $(VEHICLE) build/firmware

mutants: $(DEV)  ## Put every small fault into the firmware's core; do the tests notice? 10 minutes
	@PYTHONPATH=. $(BIN)/python tests/firmware/mutation.py

fuzz: $(DEV)  ## Feed rubbish to all that reads from outside (ROUNDS=10, two minutes each)
	@ABT_SOAK=10 $(BIN)/python -m pytest tests/firmware/test_soak.py
	@for round in $$(seq $(or $(ROUNDS),10)); do ABT_FUZZ=100000 ABT_ROUND=$$round \
		$(BIN)/python -m pytest --hypothesis-seed=$$round tests/config/test_fuzz.py \
		tests/config/test_fuzz_files.py tests/net/test_fuzz_network.py \
		tests/mocap/test_fuzz_mocap.py tests/net/test_envelope.py tests/mocap/test_natnet.py \
		tests/firmware/test_hostile_board.py tests/firmware/test_assurance.py -k 'not line_of' \
		|| exit 1; done

gate: $(DEV)  ## Show that the gate's tests take every branch of it
	@mkdir -p build
	@$(BIN)/python -m coverage run --branch --include=testbed/flight/gate.py \
		--data-file=build/gate.coverage -m pytest -q tests/flight/test_gate.py
	@$(BIN)/python -m coverage report -m --fail-under=100 --data-file=build/gate.coverage

format: $(DEV)  ## Rewrite the code in the house format
	@$(BIN)/ruff check --quiet --select I --fix
	@$(BIN)/ruff format

constraints: $(OPERATOR) $(DEV)  ## Rewrite constraints.txt from what is in .venv
	@echo "Writing constraints.txt from $(VENV)"
	@$(PIP) list --format=freeze --exclude airbearing-testbed --exclude pip --exclude setuptools >$(VENV)/pins
	@{ head -n 2 constraints.txt; LC_ALL=C sort -f $(VENV)/pins; } >$(VENV)/constraints
	@mv $(VENV)/constraints constraints.txt
	@rm $(VENV)/pins
	@touch $(OPERATOR) $(DEV)

clean:  ## Remove caches and builds; .venv and runs/ stay
	@echo "Removing caches and builds"
	@rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache .benchmarks
	@find . -path ./$(VENV) -prune -o -name __pycache__ -type d -exec rm -rf {} +

venv: $(DEV)  ## Create .venv with the tools for development

$(VENV)/pyvenv.cfg:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python >= 3.11 is needed, '$(PYTHON)' is not; try: make PYTHON=python3.11" >&2; exit 1; }
	@echo "Creating $(VENV)"
	@$(PYTHON) -m venv $(VENV)

$(OPERATOR): $(VENV)/pyvenv.cfg pyproject.toml constraints.txt
	@echo "Installing into $(VENV) what README's commands need: 1.5 GB, some minutes the first time"
	@$(PIP) install -q -c constraints.txt -e '.[operator]'
	@touch $@

$(DASHBOARD): $(VENV)/pyvenv.cfg pyproject.toml constraints.txt
	@echo "Installing into $(VENV), with the dashboard: 1 GB, some minutes the first time"
	@$(PIP) install -q -c constraints.txt -e '.[dashboard]'
	@touch $@

$(DEV): $(VENV)/pyvenv.cfg pyproject.toml constraints.txt
	@echo "Installing into $(VENV), with the tools for development: a minute the first time"
	@$(PIP) install -q -c constraints.txt -e '.[dev]'
	@touch $@
