# The two commands of the README are `make fly` and `make test`. Each sets up .venv by itself; python3 with venv is enough.

PYTHON ?= python3
SCENARIO ?= config/scenarios/platoon.yaml
BIN := .venv/bin

# Some container images set it. Without cached bytecode every process compiles its modules again: an agent then starts with 1.6
# times the CPU time and 10 MB more memory, and a worker collects the tests in 2.8 times the time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help fly hostile soak gauntlet pictures bench bench-batch bench-filter bench-identities bench-recording bench-replay bench-page bench-large-fleet transports test test-fast test-virtual test-real-time test-page test-again test-long test-vehicles test-fleets test-package deb boot faults attacks tick tighten check mavlink docs docs-check site page-vendor screenshots format setup clean

help:
	@echo "make fly        fly the paper's platoon with four agents and four stand-in autopilots, weighted against average"
	@echo "make test       the tests, real fleets included; make test-fast leaves the fleets out"
	@echo "make test-long  the flights that make test leaves out (a quarter of an hour)"
	@echo "make test-virtual, test-vehicles, test-fleets  one part: unit and lockstep tests, single real vehicles, real fleets"
	@echo "make test-page  the live page in a headless Chromium (apt install chromium)"
	@echo "make test-again the tests that failed in the last make test once more, one at a time"
	@echo "make test-package  builds wheel and sdist, installs each without the source tree and runs it (minutes, needs a package index)"
	@echo "make deb        the Debian packages for amd64 and arm64, installed without a network: build/deb (minutes, needs a package index)"
	@echo "make boot       boots systemd in a container with the package installed; writes docs/boot.md (needs root, debootstrap, systemd-container)"
	@echo "make faults     flies real fleets under every fault and writes the measured table into docs/faults.md (a quarter of an hour)"
	@echo "make attacks    lets strangers attack a real fleet with identities and writes the table into docs/attacks.md (minutes)"
	@echo "make tick       files, classes, calls and depth of a follower's tick, as a diagram of its stages and as JSON"
	@echo "make tighten    lowers the budgets of source and tick (tests/unit/budgets.json) to today's figures"
	@echo "make check      ruff, mypy --strict and the import directions"
	@echo "make mavlink    writes the MAVLink messages in use, with pymavlink's generator"
	@echo "make docs       writes the generated parts of docs/ again; make docs-check reports those that are not current"
	@echo "make site       builds the browsable documentation into build/site (needs npm, for the diagrams)"
	@echo "make page-vendor  installs the libraries of the live page in the versions of its package-lock.json and copies the files it uses (needs npm)"
	@echo "make screenshots  the pictures of docs/monitor.md, from the live page in Debian's Chromium (a minute)"
	@echo "make pictures   flies the scenarios of docs/scenarios.md in virtual time and draws them again"
	@echo "make soak       eight vehicles for an hour: memory, files, threads and ticks over time; writes docs/soak.md; SECONDS=300: a short run without the page"
	@echo "make gauntlet   1,000 random flights in virtual time; writes their table to docs/gauntlet.md (over an hour on two cores; Ctrl-C reports those that are complete)"
	@echo "make bench      speed of agents, lockstep and batch beside C, asyncio, mavsdk, UDP and RotorPy; writes docs/performance.md (ten minutes)"
	@echo "make hostile    hostile input for every decoder and for whole agents; writes docs/hostile.md (a quarter of an hour on two cores)"
	@echo "make bench-batch  vehicle-steps a second of whole batches on one core, and RotorPy's; installs PyTorch in .venv-bench"
	@echo "make bench-filter  time of the separation filter with seven vehicles nearby, against its limit of 60 us"
	@echo "make transports  age of the states over TCP, TLS, QUIC and multicast with lost packets; writes docs/transports.md (needs root)"
	@echo "make bench-identities  CPU of agents in formation with identities against those without; limit 1.2 times"
	@echo "make bench-recording  CPU, tick lateness and disk of agents that record against those that do not"
	@echo "make bench-replay  ten minutes of four real agents: every tick replayed, and the time of the report (a quarter of an hour)"
	@echo "make bench-large-fleet  CPU and bytes of an agent's Zenoh link among 8 to 64 others, with and without a router; writes docs/large-fleets.md"
	@echo "make bench-page  the live page with 50 vehicles in a headless Chromium: update time, server, first picture"
	@echo "make setup      only installs the project and its ground tools into .venv"
	@echo "make fly SCENARIO=FILE flies another scenario; $(BIN)/sitl fly --help explains it"

fly: .venv/fly.ready
	$(BIN)/sitl fly $(SCENARIO) --compare average_22

# Ends with exit code 1 where two vehicles came closer than allowed; the table is written in any case.
SECONDS = 3600
soak: .venv/fly.ready
	$(BIN)/python -m tests.soak --seconds $(SECONDS) $(if $(filter 3600,$(SECONDS)),--page docs/soak.md)

gauntlet: .venv/fly.ready
	$(BIN)/sitl gauntlet --flights 1000 --seed 1 --out runs/gauntlet --page docs/gauntlet.md

# Real-time figures are measured: without other load. The environment with RotorPy is made once, which takes some minutes.
bench: .venv/fly.ready .venv-bench/bench.ready
	$(BIN)/python -m tests.bench --out runs/bench/bench.json --page docs/performance.md

# Ten million inputs for each decoder and a million ticks of whole agents; the result is docs/hostile.md.
hostile: .venv/fly.ready
	$(BIN)/python -m tests.fuzz --inputs 10000000 --ticks 1000000 --out docs/hostile.md

bench-batch: .venv-bench/bench.ready
	.venv-bench/bin/python -m tests.bench.batch_models

# In network namespaces: needs root and iproute2.
transports: .venv/fly.ready
	$(BIN)/python -m tests.bench.transports --page docs/transports.md

bench-identities: .venv/fly.ready
	$(BIN)/python -m tests.bench.identities

bench-recording: .venv/fly.ready
	$(BIN)/python -m tests.bench.recording

bench-replay: .venv/fly.ready
	$(BIN)/python -m tests.bench.replay

bench-page: .venv/test.ready
	$(BIN)/python -m tests.bench.live_page

# Needs iproute2, for the kernel's counters of bytes.
bench-large-fleet: .venv/fly.ready
	$(BIN)/python -m tests.bench.large_fleet --page docs/large-fleets.md

bench-filter: .venv/fly.ready
	$(BIN)/python -m tests.bench.filter_step

# What README and docs show of scenarios flown in virtual time: the same pictures to the last bit wherever they are made.
PICTURES = aggregation ring_figure_8 formations moving_target leaving turning_column fence_and_obstacles

pictures: .venv/fly.ready
	for scenario in $(PICTURES); do \
	  $(BIN)/sitl run config/scenarios/$$scenario.yaml --quiet --out runs/pictures/$$scenario && \
	  cp runs/pictures/$$scenario/from_above.png docs/images/$$scenario.png || exit 1; \
	done
	$(BIN)/sitl run config/scenarios/platoon.yaml --quiet --compare average_22 --out runs/pictures/platoon
	cp runs/pictures/platoon/comparison.png docs/images/platoon_comparison.png

# Real processes need a quiet machine: their tests come first and alone. They mostly wait, so five workers fly them: two the
# folders with fleets, one flight of each at a time, the others one or two vehicles, file by file. A real-time test that failed
# while its processes were starved runs once more after the others; one that fails again while the hypervisor takes the
# processors is NOT JUDGED (docs/architecture). Tests in virtual time do not depend on the load of the machine. Tests of one file
# share flights: each file has one worker, and the long ones come first, so that both workers end together.
VIRTUAL_TESTS = $(BIN)/pytest -q -n 2 --dist loadfile --no-loadscope-reorder --durations 25 -m "not long" tests/lockstep tests/unit
REAL_TIME_TESTS = $(BIN)/pytest -v -n 5 --dist loadscope --no-loadscope-reorder --durations 60 -m "$(KINDS)"
KINDS = not long
FAULT_TESTS = tests/faults/test_link_faults.py tests/faults/test_process_faults.py tests/faults/test_autopilot_faults.py

test: .venv/test.ready
	@$(MAKE) --no-print-directory -j 1 --keep-going test-real-time test-page test-virtual

test-fast: .venv/test.ready
	@$(MAKE) --no-print-directory -j 1 --keep-going test-real-time test-virtual KINDS='not fleet and not long'

test-virtual: .venv/test.ready
	$(VIRTUAL_TESTS)

test-real-time: .venv/test.ready
	$(REAL_TIME_TESTS) tests/fleet tests/faults tests/protocol

# The live page in Debian's Chromium, skipped without it. Its drawing would starve real flights beside it.
test-page: .venv/test.ready
	$(BIN)/pytest -q -n 2 --dist loadfile tests/page

# Where a machine is shared with strangers, a failure may be the machine's: what failed in the last `make test`, alone.
test-again: .venv/test.ready
	$(BIN)/pytest -v --last-failed --last-failed-no-failures none tests

# Flights of real processes whose like is flown in virtual time, and every command of the field guide.
test-long: .venv/test.ready
	$(BIN)/pytest -v --durations 10 -m long tests

test-vehicles: .venv/test.ready
	$(REAL_TIME_TESTS) -n 1 tests/protocol

test-fleets: .venv/test.ready
	$(REAL_TIME_TESTS) -n 1 tests/fleet tests/faults

# Builds the wheel and the sdist and installs each into an environment of its own: downloads all dependencies twice.
test-package: .venv/test.ready
	$(BIN)/pytest -v --durations 10 tests/packaging

# Wheels of all base dependencies come from the package index; ARCHITECTURES="arm64" and REVISION=2 choose.
ARCHITECTURES = amd64 arm64
REVISION = 1
deb: .venv/fly.ready
	$(BIN)/python -m deploy.debian.build --architectures $(ARCHITECTURES) --revision $(REVISION)

# The root of the container is made once and kept in build/boot. Times are measured: without other load.
boot: .venv/fly.ready
	$(BIN)/python -m deploy.boot --out docs/boot.md

# One flight at a time, without other load: latencies are measured.
faults: .venv/test.ready
	$(BIN)/pytest -v --durations 5 --faults --fault-table docs/faults.md $(FAULT_TESTS)

attacks: .venv/test.ready
	$(BIN)/pytest -v --faults --fault-table docs/attacks.md tests/faults/test_strangers.py tests/faults/test_strangers_quic.py

# Of a follower in steady formation; tests/unit/test_budgets.py holds the budgets of tests/unit/budgets.json.
tick: .venv/fly.ready
	$(BIN)/python -m tests.bench.tick

# Writes today's figures into the budgets where they are lower.
tighten: .venv/fly.ready
	$(BIN)/python -m tests.bench.budgets --tighten

check: .venv/test.ready docs-check
	$(BIN)/python -m companion.mavlink.generate --check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# A message that the code is to use is added to the list in companion/mavlink/generate.py.
mavlink: .venv/fly.ready
	$(BIN)/python -m companion.mavlink.generate

# What the code says of itself in docs/: tables, diagrams and whole pages.
docs: .venv/fly.ready
	$(BIN)/python docs/generate/pages.py

docs-check: .venv/fly.ready
	$(BIN)/python docs/generate/pages.py --check

site: .venv/site.ready docs-check
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "build/site/index.html"

# The page works offline: what it uses of these libraries is committed.
PAGE_VENDOR = companion/monitor/page/vendor
page-vendor:
	rm -rf build/page-vendor && mkdir -p build/page-vendor
	cp $(PAGE_VENDOR)/package.json $(PAGE_VENDOR)/package-lock.json build/page-vendor
	cd build/page-vendor && npm ci --silent --ignore-scripts --no-audit --no-fund
	rm -rf $(PAGE_VENDOR)/lit-html $(PAGE_VENDOR)/uplot && mkdir -p $(PAGE_VENDOR)/lit-html/directives $(PAGE_VENDOR)/uplot
	cd build/page-vendor/node_modules/lit-html && cp LICENSE lit-html.js directive.js directive-helpers.js $(CURDIR)/$(PAGE_VENDOR)/lit-html
	cp build/page-vendor/node_modules/lit-html/directives/repeat.js $(PAGE_VENDOR)/lit-html/directives
	cd build/page-vendor/node_modules/uplot && cp LICENSE dist/uPlot.esm.js dist/uPlot.min.css $(CURDIR)/$(PAGE_VENDOR)/uplot

screenshots: .venv/test.ready
	$(BIN)/python tests/page/screenshots.py

format: .venv/test.ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

setup: .venv/fly.ready

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "This needs Python 3.11 or newer; try make PYTHON=python3.12 ..."; exit 1; }
	@echo "Making .venv ..."
	@$(PYTHON) -m venv .venv || { echo "This needs Python's venv; on Debian and Ubuntu: apt install python3-venv"; exit 1; }

.venv/fly.ready: .venv/bin/python pyproject.toml
	@echo "Installing the project and its ground tools into .venv (half a minute) ..."
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[ground]'
	$(BIN)/python -m compileall -q companion sitl
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

# Scripts of the site: Mermaid draws the diagrams, iframe-worker searches pages that are opened as files. They become part of
# the site, so that its pages request nothing from the network.
SCRIPTS = mermaid@11.12.0 iframe-worker@1.0.4
.venv/site.ready: .venv/fly.ready
	@echo "Installing what the site needs into .venv ..."
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[ground,docs]'
	for script in $(SCRIPTS); do \
	  mkdir -p .venv/$${script%@*} && (cd .venv/$${script%@*} && tar xzf "$$(npm pack --silent $$script)") || exit 1; \
	done
	@touch $@

# MAVProxy is an independent client in the tests; its windows (OpenCV, VTK) are not needed.
.venv/test.ready: .venv/fly.ready
	@echo "Installing what tests and checks need into .venv (half a minute) ..."
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[ground,cluster,test,check]'
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps MAVProxy==1.8.75
	@touch $@

clean:
	rm -rf .venv .venv-bench build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
