# `make demo` and `make test` are all that a fresh clone needs.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
DEMO   ?= demo
FUZZ_MINUTES ?= 10
DAMAGE_PLACES ?= 200

.PHONY: setup dev demo test test-nojit lint format types bench fuzz damage samples clean
.DEFAULT_GOAL := demo

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[dev]"
	touch $@

setup: $(VENV)/.installed

dev: $(VENV)/.installed-dev

demo: setup
	$(BIN)/dynmap build sample_logs/corridor_monday.mcap --output $(DEMO)/corridor
	$(BIN)/dynmap localize $(DEMO)/corridor sample_logs/corridor_tuesday.mcap --output $(DEMO)/tuesday

test: dev
	$(BIN)/python -m pytest

test-nojit: dev
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -m "not slow"

lint: dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

format: dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

types: dev
	$(BIN)/mypy

bench: dev
	-$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[peers]"
	$(BIN)/python tests/bench/run.py

fuzz: dev
	$(BIN)/python -m tests.fuzz.run --minutes $(FUZZ_MINUTES)

damage: dev
	DYNMAP_CORPUS_PLACES=$(DAMAGE_PLACES) $(BIN)/python -m pytest tests/ingest/test_corpus.py

samples: setup
	$(BIN)/dynmap simulate sample_logs/corridor_monday.yaml --output sample_logs/corridor_monday.mcap --force
	$(BIN)/dynmap simulate sample_logs/corridor_tuesday.yaml --output sample_logs/corridor_tuesday.mcap --force

clean:
	rm -rf $(VENV) $(DEMO) .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist *.egg-info
