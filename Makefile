# Everything starts from `make demo` or `make test`; each sets up what is missing first.
.DEFAULT_GOAL := help
.PHONY: help setup demo sample strips test test-quick coverage check format lock clean
SHELL := /bin/sh

DEMO ?= runs/demo
SEED ?= 0
PYTEST ?= -n 2
PY := .venv/bin/python
# One thread a process: the processes share the cores.
ONE_THREAD := OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 LP_NUM_THREADS=1

help: ## say what can be made
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-10s %s\n", $$1, $$2}' Makefile

setup: ## the environment from the lock file, and headless GL where that may be installed
	@sh .ci/setup.sh

demo: ## collect play, train on it, reach goal images; leaves DEMO=runs/demo/eval/report.html (SEED=0, STEPS= of a trial)
	@sh .ci/setup.sh --need-gl
	@.venv/bin/playlearn demo --out $(DEMO) --seed $(SEED) $(if $(STEPS),--steps $(STEPS))

sample: ## make datasets/sample and its card anew
	@sh .ci/setup.sh --need-gl
	rm -rf datasets/sample
	.venv/bin/playlearn collect --config configs/collect/sample.yaml --out datasets/sample
	.venv/bin/playlearn info datasets/sample --verify --report datasets/sample/README.md

strips: ## film strips of clean, human and noisy play, into eval/results/play
	@sh .ci/setup.sh --need-gl
	for who in clean human noisy; do \
	    rm -rf runs/play/$$who && \
	    .venv/bin/playlearn collect --config configs/collect/$$who.yaml --out runs/play/$$who --episodes 10 && \
	    .venv/bin/playlearn info runs/play/$$who --report eval/results/play/$$who.png --report runs/play/$$who.html || exit 1; \
	done

test: setup ## the tests
	@$(ONE_THREAD) $(PY) -m pytest $(PYTEST)

test-quick: setup ## a law or more of every module: all tests but those marked slow
	@$(ONE_THREAD) $(PY) -m pytest $(PYTEST) -m "not slow"

coverage: setup ## the tests, and how much of playlearn/ they run
	@$(ONE_THREAD) $(PY) -m pytest $(PYTEST) --cov --cov-report=term

check: setup ## what CI checks beside the tests: format, lint, types, imports
	@$(PY) -m ruff format --check .
	@$(PY) -m ruff check .
	@$(PY) -m mypy
	@.venv/bin/lint-imports --no-logo

format: setup ## put the code into shape
	@$(PY) -m ruff check --fix .
	@$(PY) -m ruff format .

lock: setup ## resolve pyproject.toml again into requirements.lock (hashes, no address)
	@sh .ci/setup.sh --lock

clean: ## remove the environment and every cache, not what you made in runs/ and datasets/
	rm -rf .venv .setup .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .coverage*
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
