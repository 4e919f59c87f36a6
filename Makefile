# Everything runs in a private environment; the only needs are make and Python 3.11 or later.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
RIVALS := $(VENV)/.ready-bench
SAM := $(VENV)/.ready-sam
REPRODUCE := $(VENV)/.ready-reproduce
RAY := $(VENV)/.ready-ray
LOWEST := .venv-lowest
BENCH_OUTPUT := bench-output
REPORT := report

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-lowest test-sam test-ray lint types bench bench-quick guard guard-record accuracy ablation pictures reproduce clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 16

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

# The bounds of pyproject.toml are promises, too; what is that old may itself be deprecated. Compiled
# loops of two versions of Numba do not share a folder: each would take the other's for its own.
$(LOWEST)/.ready: pyproject.toml tests/lowest_versions.py
	$(PYTHON) -m venv --clear $(LOWEST)
	$(PYTHON) tests/lowest_versions.py > $(LOWEST)/constraints.txt
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check -c $(LOWEST)/constraints.txt -e '.[test]'
	touch $@

test-lowest: $(LOWEST)/.ready  ## run all tests with the oldest versions of what is needed (Python 3.11 or 3.12)
	NUMBA_CACHE_DIR=$(CURDIR)/$(LOWEST)/compiled $(LOWEST)/bin/python -m pytest -W ignore::DeprecationWarning

# Torch and transformers take 1 GB and more, which the other tests do not need.
TORCH ?= torch==2.13.0
$(SAM): $(READY) pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check '$(TORCH)' -e '.[sam]'
	touch $@

test-sam: $(SAM)  ## pass the tests of Segment Anything, on tiny networks made on the spot
	$(BIN)/python -m pytest tests/test_segment_anything.py

# Ray takes 250 MB, which the other tests do not need.
$(RAY): $(READY) pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[ray]'
	touch $@

test-ray: $(RAY)  ## pass the tests of the Ray engine, on a cluster of two nodes on this machine
	$(BIN)/python -m pytest tests/test_batch_ray.py

lint: $(READY)  ## style, and which way imports run
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo --no-cache

types: $(READY)  ## types
	$(BIN)/mypy

# The other detectors take 2 GB and are not needed for anything else.
$(RIVALS): $(READY) pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[bench]'
	touch $@

# Open3D, of which the report is the poorer where it cannot be had.
$(REPRODUCE): $(READY) pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[reproduce]'
	touch $@

reproduce: $(REPRODUCE)  ## run the paper's experiments again, with Open3D beside it, and write a report
	$(BIN)/planewise reproduce all -o $(REPORT)

bench: $(RIVALS)  ## time the detector here, and OpenCV, Open3D, CGAL and pyransac3d beside it
	mkdir -p $(BENCH_OUTPUT)
	$(BIN)/python -m benchmarks.speed --json $(BENCH_OUTPUT)/speed.json --picture $(BENCH_OUTPUT)/speed.png

bench-quick: $(RIVALS)  ## the same without what takes seconds a frame
	mkdir -p $(BENCH_OUTPUT)
	$(BIN)/python -m benchmarks.speed --quick --json $(BENCH_OUTPUT)/quick.json --picture $(BENCH_OUTPUT)/quick.png

guard: $(READY)  ## fail where a call takes longer, against fixed work, than was recorded
	$(BIN)/python -m benchmarks.guard

guard-record: $(READY)  ## record what the guard holds against
	$(BIN)/python -m benchmarks.guard --record

accuracy: $(READY)  ## score the detector on synthetic and, where they are at hand, labelled real frames
	$(BIN)/python -m benchmarks.accuracy

ablation: $(READY)  ## the same with parts of the objective taken out
	$(BIN)/python -m benchmarks.ablation

pictures: $(READY)  ## draw the pictures of docs/method.md, docs/clouds.md, docs/lidar.md and docs/waves.md
	$(BIN)/python -m benchmarks.pictures
	$(BIN)/python -m benchmarks.cloud_pictures
	$(BIN)/python -m benchmarks.panoramas --picture docs/panorama.png
	$(BIN)/python -m benchmarks.waves --picture docs/waves.png

clean:  ## remove the environment and everything made
	rm -rf $(VENV) $(LOWEST) demo-output $(BENCH_OUTPUT) $(REPORT) dist build .mypy_cache .ruff_cache .pytest_cache
