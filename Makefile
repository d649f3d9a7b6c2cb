# All tasks of this project. Each target sets the project up first, if necessary.
PYTHON ?= python3
SCALE ?= quick
OUT ?= out/reproduce$(if $(filter-out quick,$(SCALE)),-$(SCALE))
JOBS ?= $(shell nproc)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# When make began, if there is no $(VENV) yet: the time of set-up counts from here.
BEGUN := $(if $(wildcard $(BIN)/python),,$(shell date +%s))
CODE := src tests examples benchmarks tools
# Many tests wait for programs that they start: one process more than processors.
TESTERS := $(shell expr $(JOBS) + 1)
# The summary lists skipped tests with their reasons: otherwise a missing program goes unnoticed.
PYTEST := $(BIN)/python -m pytest -rfEs

# One thread per process: sums keep their order, and two workers do not fight for two cores.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
# No picture needs a display.
export MPLBACKEND := Agg
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Modules are compiled to bytecode once, not by each process that a test starts (empty = not set).
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help setup reproduce test test-all machines lint check check-nojit robust chaos fuzz failures damage reliability tune format bench bench-detectors single-rules airsim clients coupling detector-cost machine-level fast-forward many-injections memory cluster golden-rates difficulty smoke fault-map real-logs sensors lasting detector-faults protected firmware hardening pictures ros train readme docs wheel lock clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## */\t/' | awk -F'\t' '{printf "  make %-12s %s\n", $$1, $$2}'

setup: $(STAMP)  ## create .venv with the locked packages and this project

$(STAMP): requirements.lock pyproject.toml
	@echo "Setting up $(VENV) ..."
	@$(PYTHON) -c 'import sys; sys.exit("mavfi needs Python 3.11 or newer, this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@# bytecode is written when a module is first imported: most modules of the packages never are
	@$(BIN)/python -m pip install -qq --no-compile --requirement requirements.lock
	@$(BIN)/python -m pip install -qq --no-deps --no-build-isolation --editable .
	@# shown by `mavfi reproduce`; only for a new environment: an update takes a part of the time
	@$(if $(BEGUN),echo $$(( $$(date +%s) - $(BEGUN) )) > $(VENV)/setup-seconds)
	@touch $@

reproduce: setup  ## train, fly, print the tables and tested findings of the paper, write $(OUT) (SCALE=quick|paper)
	@$(BIN)/mavfi reproduce --scale $(SCALE) --out $(OUT)

test: setup  ## run the tests
	@$(PYTEST) -n $(TESTERS) -m "not long and not alone"
	@$(PYTEST) -n 2 -m "alone and not long"

test-all: setup  ## run all tests, including those that repeat others in more settings
	@$(PYTEST) -n $(JOBS) -m "not alone"
	@$(PYTEST) -n 2 -m "alone"

machines: setup  ## flights and campaigns have the same bits on every x86-64 machine: other C library, CPU, folder, environment
	@$(PYTEST) -n $(JOBS) --dist=worksteal -m machines tests/golden/test_machines.py

lint: setup  ## formatting, lint, types, import contracts
	@$(BIN)/ruff format --check $(CODE)
	@$(BIN)/ruff check $(CODE)
	@$(BIN)/mypy --num-workers $(JOBS)
	@$(BIN)/lint-imports

check: lint  ## the same, and fast tests
	@$(PYTEST) -n $(JOBS) -m "not slow and not long and not alone"

check-nojit: setup  ## tests of kernels and numerics as plain Python, without the compiler
	@$(BIN)/python -m tests.robustness.nojit

chaos: setup  ## send signals to processes of campaigns at random instants, resume, compare ledgers (N=500 kills)
	@$(BIN)/python -m tests.robustness.chaos

fuzz: setup  ## 100,000 mutated files and texts for every reader of them (N=... SEED=1 ONLY=vehicle)
	@$(BIN)/python -m tests.robustness.fuzz

failures: setup  ## let system calls of campaigns fail at random points, resume, compare ledgers (N=200)
	@$(BIN)/python -m tests.robustness.failures

damage: setup  ## flip bits of ledgers, cut them off, swap their rows: nothing may be silent (N=1000)
	@$(BIN)/python -m tests.robustness.damage

reliability: setup  ## run all of these, write docs/generated/reliability.md (SHARE=0.1 = a tenth of the tries)
	@$(BIN)/python -m tools.reliability

robust: setup  ## 100,000 random corruptions of recorded kernel inputs, with bounds checked (N=...)
	@$(BIN)/python -m tests.robustness.storm

format: setup  ## format the code, sort imports
	@$(BIN)/ruff check --fix --select I $(CODE)
	@$(BIN)/ruff format $(CODE)

bench: setup  ## measure speed, write docs/generated/speed.md
	@$(BIN)/python -m benchmarks.run

fast-forward: setup  ## fly runs of table1 with and without fast-forward, compare every byte, print the gain (N=... missions)
	@$(BIN)/python -m benchmarks.fast_forward --missions $(or $(N),3)

many-injections: setup  ## inject 100,000 faults in forked children, and look for leaks (N=...)
	@$(BIN)/python -m benchmarks.many_injections $(N)

bench-detectors: setup  ## fly every detector on the same faults, write docs/generated/leaderboard.md (SCALE=paper: leaderboard-paper.md, docs/engineers.md, README.md)
	@$(BIN)/mavfi bench detectors --scale $(SCALE) --out out/bench-$(SCALE) --workers $(JOBS)
	@$(BIN)/python -m tools.build_leaderboard out/bench-$(SCALE) $(SCALE)

single-rules: setup  ## fly each of the five rules alone, write its table in docs/engineers.md (SCALE=quick|paper)
	@$(BIN)/mavfi bench detectors five-rules --scale $(SCALE) --out out/rules-$(SCALE) --workers $(JOBS)
	@$(BIN)/python -m tools.build_rules out/rules-$(SCALE)

cluster: setup  ## cost of campaigns of up to 100,000 missions without their flights; writes the table in docs/cluster.md (N="1000 10000")
	@$(BIN)/python -m benchmarks.cluster

memory: setup  ## memory of a worker over 1,500 state-level and 300 instruction-level runs: flat, or does it grow?
	@$(BIN)/python -m benchmarks.memory

airsim: setup  ## speed of client programs of AirSim in simulated time; writes the table in docs/airsim.md (N=...)
	@$(BIN)/python -m benchmarks.airsim

clients: setup  ## install other people's programs that tests use: Betaflight, MAVSDK, AirSim's own client (build/clients)
	@$(BIN)/mavfi firmware setup > /dev/null 2>&1 || $(BIN)/mavfi firmware setup --build
	@test -x build/clients/mavsdk/bin/python || $(PYTHON) -m venv build/clients/mavsdk
	@build/clients/mavsdk/bin/python -m pip install -qq mavsdk==3.17.4
	@test -x build/clients/airsim/bin/python || $(PYTHON) -m venv build/clients/airsim
	@build/clients/airsim/bin/python -m pip install -qq 'setuptools<70' wheel 'numpy<2.3' opencv-contrib-python-headless msgpack-rpc-python
	@build/clients/airsim/bin/python -m pip install -qq --no-build-isolation airsim==1.8.1

coupling: setup  ## cost of an observer's delay against a gate; writes the table in docs/ros.md (N=...)
	@$(BIN)/python -m benchmarks.coupling

detector-cost: setup  ## what detection costs against the kernels; writes the table in docs/models.md (N=5 SEEDS=2 MODELS=folder ONLY="pca duplicate")
	@$(BIN)/python -m benchmarks.detectors

machine-level: setup  ## faults in instructions at machine and at IR level; writes the table in docs/fault-model.md (N=400)
	@$(BIN)/python -m benchmarks.machine_level

golden-rates: setup  ## fly golden missions in every setting, write docs/generated/golden-rates.md (N=300 HARD_N=100 ONLY=word RESUME=1)
	@$(BIN)/python -m tools.golden_rates

difficulty: setup  ## golden success and fault effect against density and v_max, write docs/generated/difficulty.md (N=40)
	@$(BIN)/python -m tools.difficulty

tune: setup  ## try the gains of the tracker of `hardened` on design seeds (N=... SEED=... ONLY=gain_p)
	@$(BIN)/python benchmarks/tune_pid.py

smoke: setup  ## a campaign of a few flights, and its report
	@$(BIN)/mavfi campaign run configs/campaigns/smoke.yaml --out out/smoke
	@$(BIN)/mavfi report out/smoke

fault-map: setup  ## effect of one fault, by site, on design seeds; writes docs/generated/fault-map.md
	@$(BIN)/mavfi campaign run configs/campaigns/fault_map.yaml --out out/fault_map
	@$(BIN)/python -m tools.build_fault_map out/fault_map

real-logs: setup  ## judge recorded flights of other vehicles, write docs/generated/real-logs.md (LOGS=folder)
	@$(BIN)/python -m tools.real_logs $(or $(LOGS),$(error LOGS: not given; allowed: LOGS=folder of recorded flights))

sensors: setup  ## fly missions with failing sensors and motors, write docs/generated/sensors.md
	@$(BIN)/mavfi campaign run sensors --scale paper --out out/sensors
	@$(BIN)/python -m tools.campaign_pages sensors out/sensors

detector-faults: setup  ## inject faults in detectors, write docs/generated/detector-faults.md
	@$(BIN)/mavfi campaign run detector_memory --scale paper --out out/detector-memory
	@$(BIN)/mavfi campaign run detector_memory_others --scale paper --out out/detector-memory-others
	@$(BIN)/mavfi campaign run detector_instructions --scale paper --out out/detector-instructions
	@$(BIN)/mavfi campaign run failure_rate --scale paper --out out/failure-rate
	@$(BIN)/mavfi bench detectors --part instruction --scale paper --out out/bench-paper --workers $(JOBS)
	@$(BIN)/mavfi bench detectors --part instruction --out out/bench-quick --workers $(JOBS)
	@$(BIN)/python -m tools.detector_faults out/detector-memory out/detector-memory-others out/detector-instructions out/failure-rate out/bench-paper/instruction out/bench-quick/instruction

lasting: setup  ## fly missions with stuck bits, intermittent ones and bursts, write docs/generated/lasting.md
	@$(BIN)/mavfi campaign run lasting --scale paper --out out/lasting
	@$(BIN)/python -m tools.campaign_pages lasting out/lasting

protected: setup  ## fly protected kernels with a detector and restarts, write docs/generated/protected.md
	@$(BIN)/mavfi campaign run protected --scale paper --out out/protected
	@$(BIN)/python -m tools.campaign_pages protected out/protected

firmware: setup  ## fly register faults in a flight controller's firmware, write docs/generated/firmware.md (N=400)
	@for pattern in hover square; do $(BIN)/python -m tools.firmware_faults fly $$pattern --count $(or $(N),400) && $(BIN)/python -m tools.firmware_faults check $$pattern || exit 1; done
	@for environment in sparse dense farm factory; do $(BIN)/python -m tools.firmware_faults golden $$environment && $(BIN)/python -m tools.firmware_faults healthy $$environment --count 10 && $(BIN)/python -m tools.firmware_faults healthy $$environment --first 1 --count 4 --noises 3 || exit 1; done
	@$(BIN)/mavfi campaign run firmware --out out/firmware-campaign
	@$(BIN)/python -m tools.firmware_faults write out/firmware-campaign

hardening: setup  ## which instructions to duplicate, certified; writes docs/generated/hardening.md (FAULTS=200 FLIGHTS=10)
	@$(BIN)/mavfi campaign run configs/campaigns/hardening.yaml --out out/hardening
	@$(BIN)/python -m tools.build_hardening out/hardening --faults $(or $(FAULTS),200) --flights $(or $(FLIGHTS),10)
	@$(BIN)/mavfi harden out/hardening --plan configs/protections/ten_percent.yaml --certify --faults 1000 || test $$? = 3
	@$(BIN)/python -m tools.build_certificate

ros: setup  ## install Debian's ROS 1 packages (as root; else unpack them into a folder), check them
	@$(BIN)/python -m mavfi.hosts.ros1.install

train: setup  ## train the detectors that are shipped
	@$(BIN)/mavfi train --flights 100 --out src/mavfi/data/models

readme: setup  ## put the results of scale paper, or the digests of scale quick, into README.md and docs/results (SCALE=paper)
	@$(BIN)/python -m tools.build_readme $(OUT)

pictures: setup  ## draw the pictures of the documentation from flights and kernel runs (LOGS=folder)
	@for script in tools/draw_*.py; do echo "$$script"; $(BIN)/python -m tools.$$(basename $$script .py) || exit 1; done
	@$(BIN)/mavfi fly --environment dense --seed 10007 --fault state:perception.collision_status.collision --fault-seed 1 --detector recommended --picture docs/images/rescue.png

docs: setup  ## write the pages and tables that are derived from the code
	@$(BIN)/python -m tools.build_pages
	@$(BIN)/python -m tools.build_notebook

wheel: setup  ## build the wheel, install it in an empty environment, run it
	@rm -rf dist build/wheel-venv
	@$(BIN)/python -m build --wheel --no-isolation --outdir dist . > /dev/null
	@$(PYTHON) -m venv build/wheel-venv
	@build/wheel-venv/bin/python -m pip install -qq --constraint requirements.lock dist/*.whl
	@cd build && wheel-venv/bin/mavfi --help > /dev/null && wheel-venv/bin/mavfi states > /dev/null
	@rm -rf build/wheel-venv
	@ls dist/*.whl

lock:  ## renew requirements.lock from the ranges in pyproject.toml
	@rm -rf build/lock-venv
	@$(PYTHON) -m venv build/lock-venv
	@build/lock-venv/bin/python -m pip install -qq '.[dev]'
	@(grep '^#' requirements.lock; build/lock-venv/bin/python -m pip freeze --exclude mavfi | sort -f) > build/requirements.lock
	@mv build/requirements.lock requirements.lock && rm -rf build/lock-venv

clean:  ## remove what was built (not .venv, not out)
	@rm -rf dist build .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	@find src tests examples benchmarks tools -name __pycache__ -type d -prune -exec rm -rf {} +
