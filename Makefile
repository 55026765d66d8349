# make demo         a simulated phone capture through everything, ending with the viewer's URL; CAPTURE=path takes your own
# make test         lint, the fast tests, and of browser, S3 and processes what is essential; says what it leaves to make test-all
# make test-all     all tests, in parts; a run that was killed goes on with the part it was in. PART=3/12: one part alone
# make test-compose the whole stack in a Docker engine of its own; as root, minutes. CAPTURE2VR_COMPOSE=folder keeps its images
# make lint         ruff, mypy and the import contracts alone; Prettier for pages and documents; eslint and the TypeScript compiler for JavaScript
# make bench        all tables of tests/bench/README.md that need no data of others; hours. NAME alone: .venv/bin/python -m tests.bench NAME
# make audit        ask OSV and npm whether a pinned version has a known vulnerability; says "not audited" where it cannot ask
# make sbom         dist/*.cdx.json: all that an installation consists of, with licences (CycloneDX)
# make dist         wheel, source distribution, SBOM and their hashes in dist/, to look at
# make release      checked, with notes, and signed: KEY=path of an Ed25519 key of OpenSSH; docs/releasing.md tells the steps
# make proto        services/edge/api from proto/
# make docs         the documentation site on http://127.0.0.1:8000
# make drawing      docs/rooms.svg from the imports
# make setup        .venv with the product; make test-setup adds what tests need
# make clean        remove .venv and node_modules, and what builds and demos left
# All do their own set-up: .venv here, system packages through apt when root. PyTorch's CPU build is taken where there is no
# CUDA device; a PyTorch that .venv has already stays.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
PYTHON ?= python3
CAPTURE ?=
DEMO_FLAGS ?=
# One more than cores: tests wait for browsers and servers.
TEST_PROCESSES ?= 3
PART ?=
WITHIN ?=
KEY ?=
export OMP_NUM_THREADS ?= 2
# Without compiled files every process of a test compiles the product anew, and pytest rewrites all tests.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-all test-compose lint lint-types lint-others setup test-setup bench audit sbom dist release proto docs drawing clean
.DEFAULT_GOAL := help

help:
	@grep -E '^# make' Makefile | sed 's/^# //'

.venv/.ready: pyproject.toml constraints.txt deploy/setup.sh
	PYTHON="$(PYTHON)" bash deploy/setup.sh product
	touch $@

.venv/.test-ready: .venv/.ready
	PYTHON="$(PYTHON)" bash deploy/setup.sh tests
	touch $@

# What checks the pages' JavaScript, and their layout; the set-up above has installed Node. The pages themselves use none of it.
node_modules/.ready: package.json package-lock.json | .venv/.test-ready
	@command -v npm >/dev/null || { echo "make: eslint, Prettier and the TypeScript compiler need npm; install Node 18 or newer" >&2; exit 1; }
	npm ci --no-audit --no-fund --loglevel=error
	touch $@

setup: .venv/.ready
test-setup: .venv/.test-ready node_modules/.ready

demo: .venv/.ready
	.venv/bin/capture2vr demo $(if $(CAPTURE),"$(CAPTURE)") $(DEMO_FLAGS)

lint: .venv/.test-ready node_modules/.ready
	$(MAKE) --no-print-directory --jobs=2 --output-sync=target lint-types lint-others

lint-types:  # takes as long as all others together
	.venv/bin/mypy

lint-others:
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/lint-imports
	node_modules/.bin/tsc -p tsconfig.json
	node_modules/.bin/tsc -p tsconfig.workers.json
	node_modules/.bin/eslint --cache --cache-location node_modules/.cache/eslint/ --max-warnings 0 .
	node_modules/.bin/prettier --cache --cache-strategy content --cache-location node_modules/.cache/prettier --check .

test: lint
	.venv/bin/pytest -n $(TEST_PROCESSES) -m "essential or not (browser or s3 or docker or slow or compose)"

# WITHIN=seconds: no part begins later, and the commit says which is the first, so that every part has its turn.
test-all: .venv/.test-ready node_modules/.ready
	.venv/bin/python -m tests.parts -n $(TEST_PROCESSES) $(PART) $(if $(WITHIN),--within $(WITHIN))

test-compose: .venv/.test-ready
	.venv/bin/pytest -m compose -s tests/deploy/test_compose_stack.py

bench: .venv/.test-ready
	.venv/bin/python -m tests.bench all

audit sbom dist: .venv/.test-ready
	.venv/bin/python -m release $@

release: .venv/.test-ready
	@[[ -n "$(KEY)" ]] || { echo "make: name the key that signs: make release KEY=path (docs/releasing.md)" >&2; exit 1; }
	.venv/bin/python -m release publish --key "$(KEY)"

proto: .venv/.test-ready
	.venv/bin/python proto/generate.py

docs: .venv/.ready
	.venv/bin/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	.venv/bin/python docs/make_site.py
	.venv/bin/zensical serve

drawing: .venv/.test-ready
	.venv/bin/python docs/draw_rooms.py

clean:
	rm -rf .venv node_modules build dist demo out
