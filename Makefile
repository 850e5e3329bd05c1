# Every target runs in one virtual environment, made from the pinned versions in constraints.txt.
#   VENV=DIR     another environment than .venv       PYTHON=PATH  the interpreter that makes it
#   ARGS='...'   further arguments of the command that a target runs
#   WORKERS=N    processes that run the tests, a file in each at a time, and check the types
#   METHODS=...  methods that `make sweep` compares; all: every one

VENV ?= .venv
PYTHON ?=
ARGS ?=
WORKERS ?= 2
# In the order of tests/conftest.py, and not by the number of tests in a file.
DIST := --dist loadfile --no-loadscope-reorder
# Each worker has its core: threads of numpy's BLAS that wait for one make small matrices ten times as slow.
ALONE := OPENBLAS_NUM_THREADS=1
# The tests start Python by the dozen: what it imports is compiled once, also where it is told to write no bytecode.
BYTECODE := PYTHONDONTWRITEBYTECODE= PYTHONPYCACHEPREFIX='$(abspath $(VENV))/bytecode'
METHODS ?= direct SPG MPG-MS MPGE-MS Vine GAT diagnosed target

PY := $(VENV)/bin/python
# Without build isolation, so that what builds the project is pinned too. Python compiles what it imports, when it does:
# most of what is installed is never imported.
PIP := $(PY) -m pip install --disable-pip-version-check --no-input --no-compile --no-build-isolation -c constraints.txt
# The banner is an advertisement of another tool.
BUILD_DOCS := NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --quiet
STAMP := $(VENV)/.installed
CLIENTS := $(VENV)/.clients
UNFINISHED := $(VENV)/.unfinished

# Run, not looked up: a pyenv shim answers to `which` without being a Python, and Debian splits venv off.
SUPPORTED := import ensurepip, sys, venv; \
	sys.exit(sys.implementation.name != "cpython" or not (3, 11) <= sys.version_info[:2] <= (3, 13))
CANDIDATES := $(or $(PYTHON),python3.13 python3.12 python3.11 python3 python)

.DEFAULT_GOAL := help
.PHONY: help install demo docs cuda sweep inspect diagnose fleet pretrain benchmark peers gpu-check test test-slow matrix installed check format lock clean FORCE

help: ## list the targets
	@echo "mpge-jax. The first target that needs it installs everything into $(VENV) (Python 3.11 to 3.13)."
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s  %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@echo "Arguments are passed on in ARGS, e.g. make sweep ARGS='--task BrokenCheetah --method MPGE-MS direct'"

install: $(STAMP) ## make .venv and install the pinned versions (done by the others when needed)
	@echo "== $(VENV) is ready"

demo: $(STAMP) ## both halves in a few minutes, on one page (ARGS=--no-open shows none)
	$(PY) -m experiments.demo $(ARGS)

cuda: $(STAMP) ## add JAX for NVIDIA GPUs and MJX-Warp (Linux)
	@echo "== Adding the CUDA 12 wheels of JAX and MJX-Warp to $(VENV)"
	@$(PIP) -e '.[cuda]'

sweep: $(STAMP) ## the main job: compare methods on a quick task (about half an hour on two cores; METHODS=all for all)
	$(PY) -m experiments.sweep --preset quick --method $(METHODS) $(ARGS)

inspect: $(STAMP) ## look at a log before it is diagnosed: ARGS='LOG --model M.xml'
	$(PY) -m experiments.inspect $(ARGS)

diagnose: $(STAMP) ## name the mismatch in recordings: ARGS='--model M.xml --recordings DIR --out DIR'
	$(PY) -m experiments.diagnose $(ARGS)

fleet: $(STAMP) ## diagnose many robots of one model: ARGS='--model M.xml --robots DIR --out DIR'
	$(PY) -m experiments.fleet $(ARGS)

pretrain: $(STAMP) ## train the source policies that ship with the project anew
	$(PY) -m experiments.pretrain $(ARGS)

benchmark: $(STAMP) ## measure simulation and grounding speed on this machine
	$(PY) -m experiments.benchmark $(ARGS)

peers: $(STAMP) ## measure speed beside other libraries, which it installs, and write docs/speed.md
	@$(PIP) --quiet -e '.[peers]'
	$(PY) -m experiments.benchmark.peers $(ARGS)

gpu-check: cuda ## measure on an NVIDIA GPU: 1,024 to 16,384 copies, 1, 5 and 25 transformers; writes results/gpu
	$(PY) -m experiments.benchmark --part envs grounding sac --backend c mjx warp --copies 1024 4096 16384 --members 1 5 25 --out results/gpu $(ARGS)

test: $(STAMP) ## run the tests
	$(ALONE) $(BYTECODE) $(PY) -m pytest -n $(WORKERS) $(DIST) $(ARGS)

test-slow: $(CLIENTS) ## run the long tests too, other people's trainers among them
	$(ALONE) $(BYTECODE) $(PY) -m pytest -n $(WORKERS) $(DIST) -m 'slow or not slow' $(ARGS)

matrix: $(STAMP) ## the tests with Python 3.11 to 3.13, each with the oldest and the newest JAX (hours; ARGS='-k ...')
	$(PY) -m pip install --disable-pip-version-check --quiet uv
	$(PY) -m tests.supported.matrix $(ARGS)

installed: $(STAMP) ## build the wheel, install it elsewhere, and run the README's library examples with it
	$(PY) -m tests.supported.installed build/installed

check: $(STAMP) ## lint, formatting, types, and the pages of the documentation
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy --num-workers $(WORKERS)
	$(BUILD_DOCS)

docs: $(STAMP) ## build the documentation's pages into build/site
	$(BUILD_DOCS)

format: $(STAMP) ## format the code and apply the linter's safe fixes
	$(PY) -m ruff check --fix .
	$(PY) -m ruff format .

lock: $(STAMP) ## write constraints.txt anew from pyproject.toml (newest versions, every supported Python)
	$(PY) -m pip install --disable-pip-version-check --quiet uv
	$(PY) -m uv pip compile pyproject.toml --universal --python-version 3.11 --all-extras --upgrade \
		--no-annotate --quiet --custom-compile-command 'make lock' --output-file constraints.txt

clean: ## remove caches and build products (keeps .venv and results)
	rm -rf build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name '.?*' -prune -o -type d -name __pycache__ -exec rm -rf {} +

$(CLIENTS): $(STAMP)
	@echo "== Adding trainers that are not ours to $(VENV)"
	@$(PIP) --quiet -e '.[clients]'
	@touch $@

# A stamp is worth nothing when the interpreter behind it is gone.
ifneq ($(shell $(PY) -c 'print("runs")' 2>/dev/null),runs)
$(STAMP): FORCE
endif

# Killed half-way, an install leaves $(UNFINISHED) behind and packages that may be half there: start over.
# When pip itself gives up (no network, say) nothing is half there, and the next try goes on from what it has.
$(STAMP): pyproject.toml constraints.txt
	@if [ -e '$(UNFINISHED)' ]; then \
		echo "== The last installation into $(VENV) was cut short: starting over"; \
		rm -rf '$(VENV)'; \
	fi
	@if ! $(PY) -c '$(SUPPORTED)' 2>/dev/null; then \
		python=; \
		for candidate in $(CANDIDATES); do \
			if "$$candidate" -c '$(SUPPORTED)' >/dev/null 2>&1; then python=$$candidate; break; fi; \
		done; \
		if [ -z "$$python" ]; then \
			echo "No Python 3.11, 3.12 or 3.13 with venv was found (tried: $(CANDIDATES))." \
				"Install one (Debian, Ubuntu: apt-get install python3-venv)," \
				"or name it: make install PYTHON=/path/to/python3" >&2; \
			exit 2; \
		fi; \
		if [ -n "$$(ls -A '$(VENV)' 2>/dev/null)" ] && [ ! -e '$(VENV)/pyvenv.cfg' ]; then \
			echo "$(VENV) holds something that is not a virtual environment: name another, VENV=DIR" >&2; \
			exit 2; \
		fi; \
		echo "== Making $(VENV) with $$("$$python" --version) ($$python)"; \
		rm -rf '$(VENV)' && mkdir -p '$(VENV)' && touch '$(UNFINISHED)' && "$$python" -m venv '$(VENV)'; \
	fi
	@echo "== Installing the pinned versions into $(VENV) (a few minutes the first time)"
	@touch '$(UNFINISHED)'
	@{ $(PIP) --quiet hatchling editables && $(PIP) -e '.[dev]'; } || { rm -f '$(UNFINISHED)'; exit 1; }
	@mv '$(UNFINISHED)' '$@'
	@touch '$@'
