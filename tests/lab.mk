# The laboratory: what measures, soaks and attacks the product. Real-time figures need a machine without other load.
#
## make bench      speed of agents, lockstep and batch beside C, asyncio, mavsdk, UDP and RotorPy; writes docs/performance.md (ten minutes)
##                 make bench AGAINST=COMMIT measures that commit and this tree in turn and prints the ratios (six minutes)
##                 BENCH='step lockstep' leaves out the real flights (three minutes); BENCH=large flies a hundred vehicles (ten minutes)
## make bench-batch  vehicle-steps a second of whole batches on one core, and RotorPy's; installs PyTorch in .venv-bench
## make bench-filter  time of the separation filter with seven vehicles nearby, against its limits
## make bench-identities  CPU of agents in formation with identities against those without; limit 1.2 times
## make bench-recording  CPU, tick lateness and disk of agents that record against those that do not
## make bench-replay  ten minutes of four real agents: every tick replayed, and the time of the report (a quarter of an hour)
## make bench-large-fleet  CPU and bytes of an agent's Zenoh link among 8 to 64 others, with and without a router; writes docs/large-fleets.md
## make bench-page  the live page with 50 vehicles in a headless Chromium: update time, server, first picture
## make transports  age of the states over TCP, TLS, QUIC and multicast with lost packets; writes docs/transports.md (needs root)
## make soak       eight vehicles for an hour: memory, files, threads and ticks over time; writes docs/soak.md; SECONDS=300: a short run without the page
## make hostile    hostile input for every decoder and for whole agents; writes docs/hostile.md (a quarter of an hour on two cores); HOSTILE=: a minute
## make gauntlet   1,000 random flights in virtual time; writes docs/gauntlet.md (over an hour on two cores; Ctrl-C reports those that are complete)
## make gauntlet-adversarial  searches 5,000 flights for the worst (five hours on two cores; Ctrl-C keeps what is complete)
## make gauntlet-rare  probability per hour that two vehicles in formation come too close, of four missions (hours)
## make verdicts   200 random formations and settings, analysed and flown in virtual time: the table of docs/law.md (half an hour on two cores)
## make faults     flies real fleets under every fault and writes the measured table into docs/faults.md (a quarter of an hour)
## make link-faults  flies fleets whose computers go silent or lose their network interface, in network namespaces (needs root; some minutes)
## make attacks    lets strangers attack a real fleet with identities and writes the table into docs/attacks.md (minutes)
## make test-external  flies fleets of real PX4 and ArduCopter, of those whose programs are found (docs/external.md; some minutes)
## make test-vehicles, test-fleets  real processes one at a time: single vehicles, fleets
## make coverage   lines of the safety code and the separation filter that their tests do not reach; there must be none
## make mutants    changes one thing of failsafes, limits, setpoint or filter at a time: the core's tests have to fail (an hour on one core);
##                 MODULES='safety/limits control' only these; AGAIN=1 only those that survived the last run
## make mutants-flown  flies fleets whose filter is switched off or a mutant, with the last check and without it (ten minutes on two cores)
## make tighten    lowers the budgets of source and tick (tests/unit/budgets.json) to today's figures

.PHONY: gauntlet-adversarial gauntlet-rare bench bench-batch bench-filter bench-identities bench-recording bench-replay bench-large-fleet bench-page transports soak hostile gauntlet verdicts faults link-faults attacks test-external test-vehicles test-fleets coverage mutants mutants-flown tighten

LAB = $(BIN)/python -m tests

# The environment with RotorPy is made once, which takes some minutes.
ifdef AGAINST
bench: .venv/test.ready
	$(LAB).bench.against $(AGAINST) $(BENCH)
else
bench: .venv/test.ready .venv-bench/bench.ready
	$(LAB).bench --out runs/bench/bench.json --page docs/performance.md
endif

bench-batch: .venv-bench/bench.ready
	.venv-bench/bin/python -m tests.bench.batch_models

bench-filter: .venv/fly.ready
	$(LAB).bench.filter_step

bench-identities: .venv/test.ready
	$(LAB).bench.identities

bench-recording: .venv/test.ready
	$(LAB).bench.recording

bench-replay: .venv/test.ready
	$(LAB).bench.replay

# Needs iproute2, for the kernel's counters of bytes.
bench-large-fleet: .venv/test.ready
	$(LAB).bench.large_fleet --page docs/large-fleets.md

bench-page: .venv/test.ready
	$(LAB).bench.live_page

# In network namespaces: needs root and iproute2.
transports: .venv/test.ready
	$(LAB).bench.transports --page docs/transports.md

# Ends with exit code 1 where two vehicles came closer than allowed; the table is written in any case.
SECONDS = 3600
soak: .venv/test.ready
	$(LAB).soak --seconds $(SECONDS) $(if $(filter 3600,$(SECONDS)),--page docs/soak.md)

# Ten million inputs for each decoder and a million ticks of whole agents.
HOSTILE = --inputs 10000000 --ticks 1000000 --out docs/hostile.md
hostile: .venv/fly.ready
	$(LAB).fuzz $(HOSTILE)

gauntlet: .venv/fly.ready
	$(BIN)/sitl gauntlet --flights 1000 --seed 1 --out runs/gauntlet --page docs/gauntlet.md

gauntlet-adversarial: .venv/fly.ready
	$(BIN)/sitl gauntlet --adversarial --flights 5000 --seed $(or $(SEED),1)

gauntlet-rare: .venv/fly.ready
	$(BIN)/sitl gauntlet --rare all --flights 200

verdicts: .venv/fly.ready
	$(LAB).bench.verdicts

# One flight at a time: latencies are measured.
FAULT_TESTS = tests/faults/test_link_faults.py tests/faults/test_process_faults.py tests/faults/test_autopilot_faults.py \
	tests/faults/test_camera_faults.py
faults: .venv/test.ready
	$(BIN)/pytest -v --durations 5 --faults --fault-table docs/faults.md $(FAULT_TESTS)

# The kernel of one machine acknowledges for processes that are killed or stopped: here each computer has a network of its own,
# whose plug is pulled. Needs root and iproute2; without them these tests are skipped, as in `make test`, which runs one of them.
link-faults: .venv/test.ready
	$(BIN)/pytest -v --durations 5 tests/faults/test_lost_computers.py tests/faults/test_interfaces.py

attacks: .venv/test.ready
	$(BIN)/pytest -v --faults --fault-table docs/attacks.md tests/faults/test_strangers.py tests/faults/test_strangers_quic.py tests/faults/test_lying_agent.py

test-external: .venv/test.ready
	$(BIN)/pytest -v -rs --durations 0 tests/external

test-vehicles: .venv/test.ready
	$(REAL_TIME_TESTS) -n 1 tests/protocol

test-fleets: .venv/test.ready
	$(REAL_TIME_TESTS) -n 1 tests/fleet tests/faults

# Failsafes, limits, audit, setpoint and separation filter.
COVERED = companion/core/safety/*,companion/core/control/*,companion/core/filter/*
COVERED_BY = tests/unit/core tests/unit/link/test_failing_stages.py
coverage: .venv/test.ready
	$(BIN)/coverage run --include '$(COVERED)' -m pytest -q -m "not long" $(COVERED_BY)
	$(BIN)/coverage report --show-missing --fail-under 100

# Each mutant runs in a process of its own, for seconds at most.
mutants: .venv/mutants.ready
	$(LAB).mutants $(MODULES) $(if $(AGAIN),--again)

mutants-flown: .venv/mutants.ready
	$(LAB).mutants.flown

tighten: .venv/fly.ready
	$(LAB).bench.budgets --tighten

.venv/mutants.ready: .venv/test.ready
	$(BIN)/$(PIP_INSTALL) --editable '.[mutants]'
	@touch $@

# A venv of its own: PyTorch is as large as all the rest together, and nothing else needs it. It comes first, and in one
# version, because RotorPy would take any.
.venv-bench/bench.ready: pyproject.toml constraints.txt .venv/bin/python
	@echo "Installing RotorPy and PyTorch into .venv-bench (some minutes) ..."
	@$(PYTHON) -m venv .venv-bench
	.venv-bench/bin/$(PIP_INSTALL) torch==2.13.0
	.venv-bench/bin/$(PIP_INSTALL) --editable '.[bench]'
	@touch $@
