# `make demo` and `make test` set up all they need in .venv: Python 3.11+ and a package registry suffice.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: setup demo test lint types reproduce-quick check fuzz lock bench clean
setup: .venv/ready

.venv/ready: requirements/dev.txt pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("Wakefold needs Python 3.11 or newer, this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --require-hashes -r requirements/dev.txt
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --no-deps --no-build-isolation -e .
	touch $@

demo: setup          ## learn a real harbour and follow a ship: writes demo-output/report.html
	$(BIN)/wakefold demo --out demo-output

test: setup          ## the whole suite, under 10 minutes on two cores
	$(BIN)/python -m pytest

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/pyright

reproduce-quick: setup  ## every experiment of the papers with a few runs, about a minute
	$(BIN)/wakefold reproduce --quick --out out/reproduced-quick

check: lint types test reproduce-quick

fuzz: setup          ## 20,000 spoilt files, some minutes; WAKEFOLD_SEED=1 for others
	WAKEFOLD_FUZZ=20000 $(BIN)/python -m pytest tests/io/test_io_mutated.py

lock:                ## renew the locks after a change of pyproject.toml (needs uv)
	uv pip compile --universal --generate-hashes --no-emit-index-url --python-version 3.11 --extra dev --extra demo -q -o requirements/dev.txt pyproject.toml
	uv pip compile --universal --generate-hashes --no-emit-index-url --python-version 3.11 --prerelease if-necessary-or-explicit --extra dev --extra demo --extra bench -c requirements/dev.txt -q -o requirements/bench.txt pyproject.toml

.venv-bench/ready: requirements/bench.txt pyproject.toml
	$(PYTHON) -m venv .venv-bench
	.venv-bench/bin/python -m pip install --disable-pip-version-check --quiet --require-hashes -r requirements/bench.txt
	.venv-bench/bin/python -m pip install --disable-pip-version-check --quiet --no-deps --no-build-isolation -e .
	touch $@

bench: .venv-bench/ready   ## every number of docs/benchmarks.md, with the peers beside us
	.venv-bench/bin/python -m benchmarks

clean:
	rm -rf .venv .venv-bench demo-output out
