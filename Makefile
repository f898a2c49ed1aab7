# The two commands of the README are `make fly` and `make test`. Each sets up .venv by itself; python3 with venv is enough.

PYTHON ?= python3
SCENARIO ?= config/scenarios/platoon.yaml
BIN := .venv/bin

.PHONY: help fly pictures bench bench-batch test test-fast test-vehicles test-fleets check format setup clean

help:
	@echo "make fly        fly the paper's platoon with four agents and four stand-in autopilots, weighted against average"
	@echo "make test       all tests, real fleets included (about half an hour; unit and lockstep are 5 minutes of it); make test-fast leaves the fleets out"
	@echo "make check      ruff, mypy --strict and the import directions"
	@echo "make pictures   flies the scenarios of docs/scenarios.md in virtual time and draws them anew"
	@echo "make bench      how many times faster than real time four vehicles fly in virtual time, without and with sensor noise"
	@echo "make bench-batch  vehicle-steps a second of whole batches on one core, and RotorPy's; installs PyTorch in .venv-bench"
	@echo "make setup      only make .venv ready"
	@echo "make fly SCENARIO=FILE flies another scenario; $(BIN)/sitl fly --help tells more"

fly: .venv/fly.ready
	$(BIN)/sitl fly $(SCENARIO) --compare average_22

bench: .venv/fly.ready
	$(BIN)/sitl run $(SCENARIO) --quiet --out runs/bench/ideal --set stand_in.sensors=ideal
	$(BIN)/sitl run $(SCENARIO) --quiet --out runs/bench/default --set stand_in.sensors=default

bench-batch: .venv-bench/bench.ready
	.venv-bench/bin/python -m sitl.batch.benchmark

# What README and docs show of scenarios flown in virtual time: the same pictures to the last bit wherever they are made.
PICTURES = aggregation ring_figure_8 formations moving_target leaving turning_column

pictures: .venv/fly.ready
	for scenario in $(PICTURES); do \
	  $(BIN)/sitl run config/scenarios/$$scenario.yaml --quiet --out runs/pictures/$$scenario && \
	  cp runs/pictures/$$scenario/from_above.png docs/$$scenario.png || exit 1; \
	done

# What knows no clock goes wherever a core is free. Processes fly in real time and mostly wait: single vehicles and whole fleets
# share the cores, each one after the other, so that none takes another's ports.
VIRTUAL_TESTS = $(BIN)/pytest -n 2 --dist worksteal tests/unit tests/lockstep
REAL_TESTS = $(MAKE) -j 2 test-vehicles test-fleets
ONE_BY_ONE = $(BIN)/pytest -n 1 -v --durations 10
KINDS =

test: .venv/test.ready
	$(VIRTUAL_TESTS)
	$(REAL_TESTS)

test-fast: .venv/test.ready
	$(VIRTUAL_TESTS)
	$(REAL_TESTS) KINDS='-m "not fleet"'

test-vehicles: .venv/test.ready
	$(ONE_BY_ONE) $(KINDS) tests/protocol

test-fleets: .venv/test.ready
	$(ONE_BY_ONE) $(KINDS) tests/fleet tests/faults

check: .venv/test.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: .venv/test.ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

setup: .venv/test.ready

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "This needs Python 3.11 or newer; try make PYTHON=python3.12 ..."; exit 1; }
	@echo "Making .venv ..."
	@$(PYTHON) -m venv .venv || { echo "This needs Python's venv; on Debian and Ubuntu: apt install python3-venv"; exit 1; }

.venv/fly.ready: .venv/bin/python pyproject.toml
	@echo "Installing the project and its ground tools into .venv (half a minute) ..."
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[ground]'
	@touch $@

# A venv of its own: PyTorch is as large as all the rest together, and nothing else needs it. It comes first, and in one
# version, because RotorPy would take any.
.venv-bench/bench.ready: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "This needs Python 3.11 or newer; try make PYTHON=python3.12 ..."; exit 1; }
	@echo "Installing RotorPy and PyTorch into .venv-bench (some minutes) ..."
	@$(PYTHON) -m venv .venv-bench
	.venv-bench/bin/pip install --quiet --disable-pip-version-check torch==2.13.0
	.venv-bench/bin/pip install --quiet --disable-pip-version-check --editable '.[bench]'
	@touch $@

# MAVProxy is an independent client in the tests; its windows (OpenCV, VTK) are not needed.
.venv/test.ready: .venv/fly.ready
	@echo "Installing what tests and checks need into .venv (half a minute) ..."
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[ground,test,check]'
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps MAVProxy==1.8.75
	@touch $@

clean:
	rm -rf .venv .venv-bench build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
