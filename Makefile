# All tasks of this project. Each target sets the project up first, if necessary.
PYTHON ?= python3
SCALE ?= quick
OUT ?= out/reproduce$(if $(filter-out quick,$(SCALE)),-$(SCALE))
JOBS ?= $(shell nproc)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
CODE := src tests examples benchmarks studies tools
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
# A notice of mkdocs-material about its successor.
export NO_MKDOCS_2_WARNING := 1

.DEFAULT_GOAL := help
.PHONY: help setup reproduce test nightly lint check format bench results clients docs site wheel lock clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## */\t/' | awk -F'\t' '{printf "  make %-12s %s\n", $$1, $$2}'

setup: $(STAMP)  ## create .venv with the locked packages and this project

$(STAMP): requirements.lock pyproject.toml
	@echo "Setting up $(VENV) ..."
	@$(PYTHON) -c 'import sys; sys.exit("mavfi needs Python 3.11 or newer, this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@# most modules of the packages are never imported: only those are compiled that mavfi's commands import
	@$(BIN)/python -m pip install -qq --no-compile --requirement requirements.lock
	@$(BIN)/python -m pip install -qq --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m tools.bytecode
	@touch $@
	@echo "Next:  $(BIN)/mavfi fly       (a flight; the first one compiles its code)"
	@echo "       $(BIN)/mavfi doctor    (what is here, and what is missing)"

reproduce: setup  ## train, fly, print the tables and tested findings of the paper, write $(OUT) (SCALE=quick|paper)
	@$(BIN)/mavfi reproduce --scale $(SCALE) --out $(OUT)

test: setup  ## run the tests
	@$(BIN)/python -m tests.warm_up
	@$(PYTEST) -n $(TESTERS)

nightly: setup  ## hours: killed campaigns, full disks, damaged files, flipped bits, other machines, no compiler (ONLY="chaos machines" SHARE=0.1)
	@$(BIN)/python -m tests.nightly

lint: setup  ## formatting, lint, types, import contracts, links of the documentation
	@$(BIN)/ruff format --check $(CODE)
	@$(BIN)/ruff check $(CODE)
	@$(BIN)/mypy --num-workers $(JOBS)
	@$(BIN)/lint-imports
	@$(BIN)/python -m mkdocs build --site-dir build/site

check: lint  ## the same, and fast tests
	@$(PYTEST) -n $(JOBS) -m "not slow and not long and not machines"

format: setup  ## format the code, sort imports
	@$(BIN)/ruff check --fix --select I $(CODE)
	@$(BIN)/ruff format $(CODE)

bench: setup  ## measure one thing, or print what there is to measure (NAME=detectors: benchmarks/detectors.py, with its options)
	@$(if $(NAME),$(BIN)/python -m benchmarks.$(NAME) $(ARGS),ls benchmarks/*.py | sed -n 's|benchmarks/\(.*\)\.py|NAME=\1|p')

results: setup  ## fly and write one page of docs/results with its tables, or the pictures of all pages (NAME=sensors, NAME=pictures; without: which there are)
	@$(BIN)/python -m tools.results $(NAME) $(ARGS)

clients: setup  ## install other people's programs that tests use: Betaflight, AirSim's own client (build/clients)
	@$(BIN)/mavfi firmware setup > /dev/null 2>&1 || $(BIN)/mavfi firmware setup --build
	@test -x build/clients/airsim/bin/python || $(PYTHON) -m venv build/clients/airsim
	@build/clients/airsim/bin/python -m pip install -qq 'setuptools<70' wheel 'numpy<2.3' opencv-contrib-python-headless msgpack-rpc-python
	@build/clients/airsim/bin/python -m pip install -qq --no-build-isolation airsim==1.8.1

docs: setup  ## write the pages and tables that are derived from the code
	@$(BIN)/python -m tools.build_pages
	@$(BIN)/python -m tools.build_notebook
	@$(BIN)/python -m tools.build_demo

site: setup  ## build the documentation as a site, which the wheel ships and `mavfi docs` opens
	@$(BIN)/python -m mkdocs build

wheel: site  ## build sdist and wheel, use them in empty environments (ARGS="python3.11 python3.12 python3.13 --write")
	@$(BIN)/python -m tools.check_release $(ARGS)

lock:  ## renew requirements.lock from the ranges in pyproject.toml
	@rm -rf build/lock-venv
	@$(PYTHON) -m venv build/lock-venv
	@build/lock-venv/bin/python -m pip install -qq '.[dev]'
	@(grep '^#' requirements.lock; build/lock-venv/bin/python -m pip freeze --exclude mavfi | sort -f) > build/requirements.lock
	@mv build/requirements.lock requirements.lock && rm -rf build/lock-venv

clean:  ## remove what was built (not .venv, not out)
	@rm -rf dist build src/mavfi/data/site .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	@find src tests examples benchmarks studies tools -name __pycache__ -type d -prune -exec rm -rf {} +
