# `make demo` and `make test` do their own set-up: they need Python 3.11 or newer with its venv module, and this file.
# Which package index pip uses, and through which proxy, is pip's own configuration.

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
OUT ?= report

# The first interpreter that is new enough; `make PYTHON=/path/to/python3.12 ...` overrides it.
PYTHON ?= $(shell for p in python3.11 python3 python3.12 python3.13 python3.14 python; do \
	"$$p" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$p" && break; \
	done)

# One thread a process: the tests run in two processes, and small matrices gain nothing from more.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: help demo test check format lint types wheel clean

help:
	@echo "make demo    the whole path in minutes; writes $(OUT)/index.html"
	@echo "make test    the tests"
	@echo "make check   format, lint, types, and the built wheel in an empty folder"
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

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf build dist .pytest_cache .ruff_cache .hypothesis
