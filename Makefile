# Needs Python 3.11 or newer, make, and nothing else; pip's own configuration is honoured.
# `make demo` and `make test` build .venv on first use; later calls start at once.

VENV := .venv
BIN := $(VENV)/bin
JOBS ?= 2
DEMO_OUT ?= demo_out
export JAX_COMPILATION_CACHE_DIR ?= $(CURDIR)/.cache/jax
export PIP_DISABLE_PIP_VERSION_CHECK ?= 1

.PHONY: demo test test-long test-all lint format bench docs tutorials dist check-dist clean help
.DEFAULT_GOAL := help

help:
	@echo "make demo    install into $(VENV), run 'adaptsim demo', leave figures and a page in $(DEMO_OUT)"
	@echo "make test    run the quick tests on $(JOBS) processes (JOBS=n for another number)"
	@echo "make test-long  run those of more than ten seconds that continuous integration runs, too"
	@echo "make test-all  run all of them"
	@echo "make lint    ruff and pyright"
	@echo "make bench   one table of speeds beside their peers, bench/table.md; ten minutes at most"
	@echo "make docs    the documentation as a site, strictly, in build/site"
	@echo "make tutorials  run the tutorials' blocks, and keep what they print and draw beside them"
	@echo "make dist    a wheel and a source archive in dist"
	@echo "make check-dist  install each into an empty environment, and run the demo there in an empty folder"
	@echo "make clean   remove $(VENV) and what the other targets wrote"

demo: $(VENV)/.core
	$(BIN)/adaptsim demo --out $(DEMO_OUT)

# Most of the quick tests' time is compiling, and most programs run once: no effort there pays. Of all tests half of it does.
test test-long: effort = 0
test-all: effort = 1
test test-long test-all: export XLA_FLAGS ?= --xla_cpu_multi_thread_eigen=false --xla_backend_optimization_level=$(effort) \
	--xla_cpu_use_fusion_emitters=false
test: $(VENV)/.test
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile -m "not slow and not long" $(PYTEST_ARGS)

test-long: $(VENV)/.test
	$(BIN)/python -m pytest -n $(JOBS) --dist load -m "long and not slow" $(PYTEST_ARGS)

test-all: $(VENV)/.test
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile $(PYTEST_ARGS)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.core
	$(BIN)/python benchmarks/table.py --out bench
	@cat bench/table.md

docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet
	@echo "open build/site/index.html; with a search box: $(BIN)/python -m http.server -d build/site"

tutorials: $(VENV)/.core
	$(BIN)/python docs/run_blocks.py

dist: $(VENV)/.core
	rm -rf build/lib build/bdist* dist
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .
	$(BIN)/python -c "from setuptools.build_meta import build_sdist as build; build('dist')" > /dev/null

check-dist: dist
	@set -e; for file in $(CURDIR)/dist/*.whl $(CURDIR)/dist/*.tar.gz; do \
	  work=$$(mktemp -d); $(BIN)/python -m venv $$work/env; \
	  $$work/env/bin/python -m pip install --quiet --no-compile -r requirements.lock $$file; \
	  mkdir $$work/empty; cd $$work/empty; ../env/bin/adaptsim demo; cd $(CURDIR); rm -r $$work; \
	  echo "installs, and runs the demo: $$file"; done

clean:
	rm -rf $(VENV) .cache demo_out bench build dist *.egg-info .pytest_cache .ruff_cache .hypothesis .benchmarks

# A stamp is written only when its step ended well, so an interrupted install is taken up again.
$(VENV)/.made:
	@set -e; found=; for python in $(PYTHON) python3 python3.14 python3.13 python3.12 python3.11 python; do \
	  if "$$python" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	    found="$$python"; break; fi; done; \
	if [ -z "$$found" ]; then \
	  echo "make: no Python 3.11 or newer with the venv module found; install one or say make PYTHON=/path/to/python3" >&2; \
	  exit 1; fi; \
	echo "using $$($$found --version) for $(VENV)"; "$$found" -m venv $(VENV)
	@touch $@

# Python compiles what is imported and no more: compiling all that is installed takes longer than installing it.
INSTALL = $(BIN)/python -m pip install --quiet --no-compile

$(VENV)/.core: $(VENV)/.made requirements.lock pyproject.toml
	$(INSTALL) -r requirements.lock
	$(INSTALL) --no-deps --no-build-isolation -e .
	@touch $@

# All at once: a second call would look through what the first one installed, as long again.
$(VENV)/.test: $(VENV)/.made requirements.lock requirements-dev.lock pyproject.toml
	$(INSTALL) -r requirements-dev.lock
	$(INSTALL) --no-deps --no-build-isolation -e .
	@touch $(VENV)/.core $@

$(VENV)/.docs: $(VENV)/.core requirements-docs.lock
	$(INSTALL) -r requirements-docs.lock
	@touch $@

$(VENV)/.dev: $(VENV)/.test
	@touch $@
