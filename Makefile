# Everything runs in a private environment; the only needs are make and Python 3.11 or later.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.DEFAULT_GOAL := help
.PHONY: help setup demo test lint types bench accuracy ablation pictures clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

$(READY): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "planewise needs Python 3.11 or later: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@

setup: $(READY)  ## make the private environment (.venv) and install into it

demo: $(READY)  ## build a synthetic room, find its planes, write the pictures
	$(BIN)/planewise demo -o demo-output

test: $(READY)  ## run all tests, the examples in the docs included
	$(BIN)/python -m pytest

lint: $(READY)  ## style
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)  ## types
	$(BIN)/mypy

bench: $(READY)  ## time the detector on this machine
	$(BIN)/python -m benchmarks.speed

accuracy: $(READY)  ## score the detector on synthetic and, where they are at hand, labelled real frames
	$(BIN)/python -m benchmarks.accuracy

ablation: $(READY)  ## the same with parts of the objective taken out
	$(BIN)/python -m benchmarks.ablation

pictures: $(READY)  ## draw the pictures of docs/method.md
	$(BIN)/python -m benchmarks.pictures

clean:  ## remove the environment and everything made
	rm -rf $(VENV) demo-output dist build .mypy_cache .ruff_cache .pytest_cache
