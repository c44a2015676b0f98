# Every target works in a fresh clone with nothing but Python 3.11 or newer: what it needs is
# installed into .venv, and again when pyproject.toml has changed. An interpreter named by PYTHON
# has an environment of its own, such as .venv-3.13, so that no target runs on another one.

ifdef PYTHON
VENV := .venv-$(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
else
PYTHON := python3
VENV := .venv
endif
BIN := $(VENV)/bin
PINNED := .venv-pinned
EXTRAS := dev
PIP := python -m pip install --quiet --disable-pip-version-check

.PHONY: help demo demo-scan test lint fuzz mutants bench results docs clean

help:
	@echo 'make demo    find a pasted object in a generated scene; results go to demo/'
	@echo 'make demo-scan  a small collection of scenes, scanned and ranked; results go to demo-scan/'
	@echo 'make test    all tests'
	@echo 'make lint    ruff and pyright, in an environment with pinned versions'
	@echo 'make mutants do the tests notice changed operators and numbers? (hours; SAMPLES=20)'
	@echo 'make fuzz    damaged files of every format: make fuzz N=1000000 SEED=1'
	@echo 'make bench   speed of splatting on this machine'
	@echo 'make results every table and chart of docs/results.md (three to four hours)'
	@echo 'make docs    the documentation as a site, in site/, with its pictures'
	@echo 'make clean   remove environments, demo/ and caches'
	@echo 'another interpreter, in an environment of its own: make test PYTHON=python3.12'

demo: $(VENV)/installed
	$(BIN)/gsc-jax demo --out demo

demo-scan: $(VENV)/installed-dev
	$(BIN)/python experiments/demo_scan.py demo-scan

test: $(VENV)/installed-dev
	$(BIN)/python -m pytest

lint: $(PINNED)/installed-dev
	$(PINNED)/bin/ruff check .
	$(PINNED)/bin/ruff format --check .
	$(PINNED)/bin/pyright --pythonpath $(PINNED)/bin/python

N ?= 20000
SEED ?= 0
fuzz: $(VENV)/installed-dev
	PYTHONPATH=tests $(BIN)/python -m fuzz --inputs $(N) --seed $(SEED)

mutants: $(PINNED)/installed-dev
	$(PINNED)/bin/python tests/mutation.py --samples $(or $(SAMPLES),20)

bench: $(VENV)/installed
	$(BIN)/python benchmarks/splat.py
	$(BIN)/python benchmarks/pipeline.py
	$(BIN)/python benchmarks/page.py
	$(BIN)/python benchmarks/cores.py

results: $(VENV)/installed-dev
	$(BIN)/python experiments/captures.py
	$(BIN)/python experiments/train_classifier.py --keep .cues --out .cues/all.npz
	for name in published_fit published departures mask_checks heldout leave_out unseen beside_masks importance editing beyond calibration enough ablation robustness authentic parsimony stability partial_views speed_accuracy real_scenes; do \
	  $(BIN)/python experiments/$$name.py || exit 1; done
	$(BIN)/python experiments/sources.py --keep .cues --seeds 1
	$(BIN)/python experiments/fusion.py --seeds 1
	$(BIN)/python experiments/backbones.py --seeds 1
	$(BIN)/python experiments/adaptive.py --scenes garden room kitchen --edits modification --seeds 1

docs: $(VENV)/installed-dev
	$(BIN)/python docs/pictures.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:
	rm -rf .venv .venv-* demo site build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/installed $(PINNED)/installed: %/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo 'gsc_jax needs Python 3.11 or newer, found:'; $(PYTHON) --version; \
	  echo 'Name another one: make $(MAKECMDGOALS) PYTHON=python3.12'; exit 1; } >&2
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo '$(PYTHON) lacks venv or ensurepip; on Debian: apt install python3-venv'; exit 1; } >&2
	$(PYTHON) -m venv $*
	$*/bin/$(PIP) $(PINS) -e .
	@touch $@

$(VENV)/installed-dev $(PINNED)/installed-dev: %/installed-dev: %/installed
	$*/bin/$(PIP) $(PINS) -e '.[$(EXTRAS)]'
	@touch $@

# New annotations of a library must not fail the lint of code that did not change.
$(PINNED)/%: PINS := --constraint .ci/pinned.txt
$(PINNED)/%: EXTRAS := dev,mutation
$(PINNED)/installed: .ci/pinned.txt
