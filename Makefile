# make demo   a simulated phone capture through everything, ending with the viewer's URL; CAPTURE=path takes your own
# make test   everything that can be checked on this machine
# make bench  all tables of tests/bench/README.md that need no data of others; hours. NAME alone: .venv/bin/python -m tests.bench NAME
# They do all their own set-up: .venv here, system packages through apt when root. A PyTorch that .venv has already, such as the
# CPU build, stays.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
PYTHON ?= python3
CAPTURE ?=
DEMO_FLAGS ?=
TEST_PROCESSES ?= 2
export OMP_NUM_THREADS ?= 2

.PHONY: help demo test setup test-setup bench proto clean
.DEFAULT_GOAL := help

help:
	@grep -E '^# make' Makefile | sed 's/^# //'

.venv/.ready: pyproject.toml constraints.txt deploy/setup.sh
	PYTHON="$(PYTHON)" bash deploy/setup.sh product
	touch $@

.venv/.test-ready: .venv/.ready
	PYTHON="$(PYTHON)" bash deploy/setup.sh tests
	touch $@

setup: .venv/.ready
test-setup: .venv/.test-ready

demo: .venv/.ready
	.venv/bin/capture2vr demo $(if $(CAPTURE),"$(CAPTURE)") $(DEMO_FLAGS)

test: .venv/.test-ready
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/lint-imports
	.venv/bin/pytest -n $(TEST_PROCESSES)

bench: .venv/.test-ready
	.venv/bin/python -m tests.bench all

proto: .venv/.test-ready
	.venv/bin/python proto/generate.py

clean:
	rm -rf .venv build dist demo out
