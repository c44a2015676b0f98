# Every target works in a fresh clone with nothing but Python 3.11 or newer: what it needs is
# installed into .venv, and again when pyproject.toml has changed.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: help demo test lint bench results docs clean

help:
	@echo 'make demo    find a pasted object in a generated scene; results go to demo/'
	@echo 'make test    ruff, pyright and all tests'
	@echo 'make lint    ruff and pyright'
	@echo 'make bench   speed of splatting on this machine'
	@echo 'make results every table and chart of docs/results.md (three to four hours)'
	@echo 'make docs    the documentation as a site, in site/, with its pictures'
	@echo 'make clean   remove .venv, demo/ and caches'
	@echo 'another interpreter: make test PYTHON=python3.12'

demo: $(VENV)/installed
	$(BIN)/gsc-jax demo --out demo

test: lint
	$(BIN)/python -m pytest

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	PYRIGHT_PYTHON_IGNORE_WARNINGS=1 $(BIN)/pyright --pythonpath $(BIN)/python

bench: $(VENV)/installed
	$(BIN)/python benchmarks/splat.py
	$(BIN)/python benchmarks/pipeline.py
	$(BIN)/python benchmarks/page.py

results: $(VENV)/installed-dev
	$(BIN)/python experiments/train_classifier.py --keep .cues --out .cues/all.npz
	for name in native importance native_real editing beyond calibration enough ablation robustness authentic parsimony stability speed_accuracy real_scenes; do \
	  $(BIN)/python experiments/$$name.py || exit 1; done
	$(BIN)/python experiments/backbones.py --seeds 1

docs: $(VENV)/installed-dev
	$(BIN)/python docs/pictures.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:
	rm -rf $(VENV) demo site build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo 'gsc_jax needs Python 3.11 or newer, found:'; $(PYTHON) --version; \
	  echo 'Name another one: make $(MAKECMDGOALS) PYTHON=python3.12'; exit 1; } >&2
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo '$(PYTHON) lacks venv or ensurepip; on Debian: apt install python3-venv'; exit 1; } >&2
	$(PYTHON) -m venv $(VENV)
	$(PIP) -e .
	@touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(PIP) -e '.[dev]'
	@touch $@
