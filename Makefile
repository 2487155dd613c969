# `make demo` and `make test` do their own set-up: they need Python 3.11 or newer with its venv module, and this file.
# Which package index pip uses, and through which proxy, is pip's own configuration.

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
OUT ?= report
SITE := build/docs/html

# The first interpreter that is new enough; `make PYTHON=/path/to/python3.12 ...` overrides it.
PYTHON ?= $(shell for p in python3.11 python3 python3.12 python3.13 python3.14 python; do \
	"$$p" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$p" && break; \
	done)

# One thread a process: the tests run in two processes, and small matrices gain nothing from more.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: help demo test check format lint types wheel docs torch-only clean

help:
	@echo "make demo    the whole path in minutes; writes $(OUT)/index.html"
	@echo "make test    the tests"
	@echo "make check   format, lint, types, and the built wheel in an empty folder"
	@echo "make docs    the site, with tutorials executed; writes $(SITE)/index.html"
	@echo "make torch-only  training where only torch, NumPy, safetensors, PyYAML and tqdm are installed"
	@echo "make format  format the code and mend what the linter can"
	@echo "make clean   remove what was built, but not $(VENV)"

$(STAMP): pyproject.toml constraints.txt .ci/pydrake_stubs.py
	@test -n "$(PYTHON)" || { echo "No Python >= 3.11 with the venv and ensurepip modules was found; install one" \
		"(on Debian and Ubuntu: python3 and python3-venv) or run make PYTHON=/path/to/python" >&2; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade --constraint constraints.txt pip
	$(BIN)/python -m pip install --constraint constraints.txt --editable '.[dev]'
	$(BIN)/python .ci/pydrake_stubs.py $(VENV)/stubs
	@touch $@

demo: $(STAMP)
	$(BIN)/xdex demo --out $(OUT)

test: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m pytest -n 2 $(PYTEST_ARGS)

check: lint types wheel

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports

types: $(STAMP)
	$(BIN)/pyright

# The source distribution is built first and the wheel from it, so that both are tested.
wheel: $(STAMP)
	rm -rf dist
	$(BIN)/python -m build --no-isolation --outdir dist
	$(ONE_THREAD) XDEX_WHEEL_DIR=dist $(BIN)/python -m pytest tests/packaging

$(VENV)/.docs: $(STAMP)
	$(BIN)/python -m pip install --constraint constraints.txt --editable '.[docs]'
	@touch $@

# Warnings are errors. Tutorials are executed once, and again when their text changes; make clean forgets them.
docs: $(VENV)/.docs
	$(ONE_THREAD) $(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet -b html docs $(SITE)
	@echo "written to $(SITE)/index.html"

# Training must run on a machine that has no Drake: an environment of its own, a tiny pack, a few steps.
TORCH_ONLY := build/torch-only

$(TORCH_ONLY)/venv/.installed: constraints.txt
	$(PYTHON) -m venv $(TORCH_ONLY)/venv
	$(TORCH_ONLY)/venv/bin/python -m pip install --quiet --constraint constraints.txt torch numpy safetensors pyyaml tqdm
	@touch $@

torch-only: $(TORCH_ONLY)/venv/.installed
	rm -rf $(TORCH_ONLY)/model
	PYTHONPATH=. $(ONE_THREAD) $(TORCH_ONLY)/venv/bin/python tests/learning/tiny_pack.py $(TORCH_ONLY)/pack.safetensors
	PYTHONPATH=. $(ONE_THREAD) $(TORCH_ONLY)/venv/bin/python -m xdex_drake.learning.training tests/learning/tiny.yaml \
		--pack $(TORCH_ONLY)/pack.safetensors --out $(TORCH_ONLY)/model

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf build dist .pytest_cache .ruff_cache .hypothesis
