# The two commands of the README are `make fly` and `make test`. Each sets up .venv by itself; python3 with venv is enough.
# What measures the product is in tests/lab.mk, what builds and boots packages in deploy/package.mk, what makes the
# documentation in docs/docs.mk.

# The distribution's Python where it has venv: it is built with optimisation, which many others are not, and takes 0.73 to 0.88 of
# their CPU time. The flights are the same to the bit.
PYTHON ?= $(shell /usr/bin/python3 -c 'import ensurepip, sys; sys.exit(sys.version_info < (3, 11))' 2> /dev/null && \
	echo /usr/bin/python3 || echo python3)
SCENARIO ?= config/scenarios/platoon.yaml
BIN := .venv/bin
PIP_INSTALL = pip install --quiet --disable-pip-version-check --constraint constraints.txt

# Some container images set it. Without cached bytecode every process compiles its modules again: an agent then starts with 1.6
# times the CPU time and 10 MB more memory, and a worker collects the tests in 2.8 times the time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help fly setup test test-fast test-virtual test-real-time test-page page-needs test-again test-long test-new-inputs tick check format docs clean

help:
	@echo "make fly        fly the paper's platoon with four agents and four stand-in autopilots, weighted against average"
	@echo "                make fly SCENARIO=FILE flies another scenario; $(BIN)/sitl fly --help explains it"
	@echo "make setup      only installs the project and its ground tools into .venv"
	@echo "make test       the tests, real fleets included; make test-fast leaves the fleets out"
	@echo "make test-virtual, test-real-time, test-page  one part: virtual time; real processes; the live page (apt install chromium)"
	@echo "                SKIP_PAGE=1 leaves the live page out of make test"
	@echo "make test-again the tests that failed in the last make test once more, one at a time"
	@echo "make test-long  the flights that make test leaves out, and the tests of the laboratory (half an hour)"
	@echo "make test-new-inputs  random inputs that no run before has tried, for every night; make test has the same in every run"
	@echo "make tick       files, classes, calls and depth of a follower's tick, as a diagram of its stages and as JSON"
	@echo "make check      ruff, mypy --strict and the import directions"
	@echo "make format     ruff puts the source in order"
	@echo "make docs       writes the generated parts of docs/ again; make docs-check reports those that are not current"
	@echo "make clean      removes what was installed and built"
	@for file in $(filter %.mk,$(MAKEFILE_LIST)); do sed -n 's/^## //p' $$file; done

fly: .venv/fly.ready
	$(BIN)/sitl fly $(SCENARIO) --compare average_22

setup: .venv/fly.ready

# Real processes need a quiet machine: their tests come first and alone. They mostly wait, so four workers fly them: two the
# folders with fleets, one flight of each at a time, the others one or two vehicles, file by file. A real-time test that failed
# while its processes were starved runs once more after the others; one that fails again while the hypervisor takes the
# processors is NOT JUDGED. Tests in virtual time do not depend on the load of the machine. Tests of one file
# share flights: each file has one worker, and the long ones come first, so that both workers end together.
VIRTUAL_TESTS = $(BIN)/pytest -q -r fEs -n 2 --dist loadfile --no-loadscope-reorder --durations 25 -m "not long" tests/lockstep tests/unit
REAL_TIME_TESTS = $(BIN)/pytest -v -r fEs -n 4 --dist loadscope --no-loadscope-reorder --durations 60 -m "$(KINDS)"
KINDS = not long

ifeq ($(SKIP_PAGE),1)
test: .venv/test.ready
	@$(MAKE) --no-print-directory -j 1 --keep-going test-real-time test-virtual; ended=$$?; \
		echo "SKIPPED: the live page, tests/page (SKIP_PAGE=1)"; exit $$ended
else
test: page-needs .venv/test.ready
	@$(MAKE) --no-print-directory -j 1 --keep-going test-real-time test-page test-virtual
endif

test-fast: .venv/test.ready
	@$(MAKE) --no-print-directory -j 1 --keep-going test-real-time test-virtual KINDS='not fleet and not long'

test-virtual: .venv/test.ready
	$(VIRTUAL_TESTS)

test-real-time: .venv/test.ready
	$(REAL_TIME_TESTS) tests/fleet tests/faults tests/protocol

# The live page in Debian's Chromium. Its drawing would starve real flights beside it, so the one of a real fleet is shown alone.
WITH_REAL_FLEET = tests/page/test_real_fleet.py
test-page: page-needs .venv/test.ready
	@$(BIN)/pytest -q $(WITH_REAL_FLEET); ended=$$?; $(BIN)/pytest -q -n 2 --ignore $(WITH_REAL_FLEET) tests/page && exit $$ended

export CHROMIUM ?= /usr/bin/chromium
page-needs:
	@test -x $(CHROMIUM) || { echo "The live page is tested in Chromium, and $(CHROMIUM) is missing: sudo apt install chromium" \
		"(or CHROMIUM=PATH); make test SKIP_PAGE=1 leaves it out"; exit 1; }

# Where a machine is shared with strangers, a failure may be the machine's: what failed in the last `make test`, alone.
test-again: .venv/test.ready
	$(BIN)/pytest -v --last-failed --last-failed-no-failures none tests

# Three times as many random inputs. Flights of real processes whose like is flown in virtual time, statistics of many flights,
# every command of the field guide, and the laboratory's tests.
test-long: .venv/test.ready
	$(BIN)/pytest -q -n 2 --hypothesis-profile thorough -m hypothesis tests/unit
	$(BIN)/pytest -v --durations 10 -m long tests

# What fails is printed as a line `@reproduce_failure(...)` for its test. Hostile input has a new seed as well.
test-new-inputs: .venv/test.ready
	$(BIN)/pytest -q -n 2 --hypothesis-profile new -m hypothesis tests/unit
	$(BIN)/python -m tests.fuzz --inputs 100000 --ticks 20000 --seed $$(date +%s)

# Of a follower in steady formation; tests/unit/test_budgets.py holds the budgets of tests/unit/budgets.json.
tick: .venv/fly.ready
	$(BIN)/python -m tests.bench.tick

check: .venv/test.ready docs-check
	$(BIN)/python -m companion.mavlink.generate --check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: .venv/test.ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# What the code says of itself in docs/: tables, diagrams and whole pages.
docs: .venv/fly.ready
	$(BIN)/python docs/generate/pages.py

clean:
	rm -rf .venv .venv-bench build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "This needs Python 3.11 or newer; try make PYTHON=python3.12 ..."; exit 1; }
	@echo "Making .venv ..."
	@$(PYTHON) -m venv .venv || { echo "This needs Python's venv; on Debian and Ubuntu: apt install python3-venv"; exit 1; }

.venv/fly.ready: .venv/bin/python pyproject.toml constraints.txt
	@echo "Installing the project and its ground tools into .venv (half a minute) ..."
	$(BIN)/$(PIP_INSTALL) --editable '.[ground,mocap]'
	$(BIN)/python -m compileall -q companion sitl
	@touch $@

# MAVProxy is an independent client in the tests; its windows (OpenCV, VTK) are not needed.
.venv/test.ready: .venv/fly.ready
	@echo "Installing what tests and checks need into .venv (half a minute) ..."
	$(BIN)/$(PIP_INSTALL) --editable '.[ground,mocap,cluster,test,check]'
	$(BIN)/$(PIP_INSTALL) --no-deps MAVProxy==1.8.75
	@touch $@

include tests/lab.mk deploy/package.mk docs/docs.mk
