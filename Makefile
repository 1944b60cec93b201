# make demo, make test: nothing need be prepared but Python >= 3.11 with its venv module.
# Override: make test PYTHON=python3.12 WORKERS=2 ARGS="-k units"

VENV := .venv
BIN := $(VENV)/bin
PYTHON ?=
CORES := $(shell getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2)
WORKERS ?= $(shell [ $(CORES) -gt 4 ] && echo 4 || echo $(CORES))
ARGS ?=
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-input

# One thread per process: faster at our array sizes, and the same digits on every run.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
export MPLBACKEND := Agg
export PIP_USER := 0
export PIP_USE_PEP517 := 1
unexport PYTHONHOME PYTHONPATH

.DEFAULT_GOAL := help
.PHONY: help setup demo test fuzz slow long quick lint bench neural oldest clean faults docs wheel

help:  ## show the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 16

setup: $(VENV)/.ok  ## make .venv and install into it (once)

demo: $(VENV)/.ok  ## run the main job; its last line says where the report is
	@$(BIN)/bsp-gp demo $(ARGS)

test: $(VENV)/.ok  ## run the default tests
	@$(BIN)/python -m pytest -n $(WORKERS) $(ARGS)

MINUTES ?= 5
SEED ?= $(shell date +%j%H%M)

fuzz: $(VENV)/.ok  ## try made-up hostile inputs for MINUTES=5; what it finds is kept in runs/fuzz
	@$(BIN)/python tests/fuzz/run.py --minutes $(MINUTES) --seed $(SEED) --workers $(WORKERS) $(ARGS)

slow: $(VENV)/.ok  ## run the slower tests
	@$(BIN)/python -m pytest -n $(WORKERS) -m "slow and not long" $(ARGS)

long: $(VENV)/.ok  ## run the longest tests, statistics that take minutes each (most of an hour)
	@$(BIN)/python -m pytest -n $(WORKERS) -m long $(ARGS)

faults: $(VENV)/.ok  ## kill every command at every write, and fill its disk (an hour)
	@$(BIN)/python -m pytest -n $(WORKERS) -m faults $(ARGS)

# What each library is used for, and whole commands: some minutes.
AT_BORDERS := $(patsubst %,tests/unit/test_%.py,units tables formats parse cli close report genetic \
    posterior vision simulate_engine sweep)

oldest:  ## test the oldest versions of the libraries that setup.cfg allows (in .venv-oldest)
	@test -x .venv-oldest/bin/python || $(BIN)/python -m venv .venv-oldest
	@$(BIN)/python tests/oldest.py >.venv-oldest/constraints.txt
	@.venv-oldest/bin/python -m pip install --quiet --disable-pip-version-check --no-input \
	    -c .venv-oldest/constraints.txt -e '.[test]'
	@.venv-oldest/bin/python -m pip check
	@.venv-oldest/bin/python -m pytest -q -n $(WORKERS) $(AT_BORDERS) $(ARGS)

EXPERIMENTS := compare_searches data_efficiency ablation em_nbody phys101 null_data power \
    undeclared_effects open_world ball_drops mechanics

quick: $(VENV)/.ok  ## run the experiments in their quick versions, into runs/quick
	@mkdir -p runs/quick
	@set -e; for name in $(EXPERIMENTS); do \
	    echo "experiments/$$name.py --quick"; \
	    $(BIN)/python experiments/$$name.py --quick --workers $(WORKERS) \
	        --out runs/quick/$$name $(ARGS) >runs/quick/$$name.log 2>&1 \
	        || { cat runs/quick/$$name.log >&2; exit 1; }; \
	    tail -n 1 runs/quick/$$name.log; \
	done

lint: $(VENV)/.dev  ## check the code with ruff, and its types with mypy
	@$(BIN)/ruff check $(ARGS) .
	@$(BIN)/mypy

bench: $(VENV)/.dev  ## time the searches, other tools beside them
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-input -e '.[peers]'
	@$(BIN)/python experiments/bench/searches.py $(ARGS)
	@$(BIN)/python experiments/bench/inference.py $(ARGS)

neural: $(VENV)/.ok  ## test the networks and the other tools, and run their experiments in small
	@$(PIP) -e '.[neural,peers]'
	@$(BIN)/python -m pytest -n $(WORKERS) tests/unit/test_neural.py tests/unit/test_peers_tools.py \
	    tests/golden/test_neural_efficiency.py $(ARGS)
	@$(MAKE) --no-print-directory quick EXPERIMENTS="neural_efficiency neural_tuning peers" ARGS=

docs: $(VENV)/.docs  ## build the pages into runs/docs; a warning is an error
	@$(BIN)/python -m sphinx -q -W --keep-going -b html -d runs/doctrees docs runs/docs $(ARGS)
	@echo "Pages: runs/docs/index.html"

wheel: $(VENV)/.dev  ## build and check the wheel and the sdist, and run the demo of the wheel alone
	@bash tests/wheel.sh $(BIN)/python

clean:  ## remove .venv, build products and caches
	rm -rf $(VENV) .venv-oldest build dist *.egg-info .pytest_cache .hypothesis .mypy_cache .ruff_cache .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamp is written last, so that an interrupted install is taken up again, and a finished one
# is repeated only when the metadata change.
$(VENV)/.ok: setup.cfg pyproject.toml
	@set -e; \
	new='import sys; sys.exit(sys.version_info < (3, 11))'; \
	python=; \
	for p in $(or $(PYTHON),python3 python3.14 python3.13 python3.12 python3.11); do \
	    if "$$p" -c "$$new" >/dev/null 2>&1; then python=$$p; break; fi; \
	done; \
	if [ -z "$$python" ]; then \
	    echo "bsp_gp needs Python 3.11 or newer; found: $$($(or $(PYTHON),python3) --version 2>&1 || true). Name another with: make PYTHON=/path/to/python3" >&2; \
	    exit 1; \
	fi; \
	if ! "$$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then \
	    echo "The venv module of $$python is missing; install it, on Debian or Ubuntu with: sudo apt-get install python3-venv" >&2; \
	    exit 1; \
	fi; \
	if ! $(BIN)/python -c "import pip; $$new" >/dev/null 2>&1; then \
	    echo "Making $(VENV) with $$("$$python" --version) ..."; \
	    "$$python" -m venv --clear $(VENV); \
	fi; \
	echo "Installing bsp_gp and what it needs into $(VENV) (once; 240 MB to download, 950 MB on disk) ..."; \
	$(PIP) -e '.[test,astro,web]'; \
	touch $@

$(VENV)/.docs: $(VENV)/.ok
	@echo "Installing what builds the pages into $(VENV) (once) ..."
	@$(PIP) -e '.[docs]'
	@touch $@

$(VENV)/.dev: $(VENV)/.ok
	@echo "Installing the developers' tools into $(VENV) (once) ..."
	@$(PIP) -e '.[dev]'
	@touch $@
