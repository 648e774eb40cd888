# make demo and make test set themselves up: .venv is made, with the tested versions, the first time.
PYTHON ?= python3.11
BIN := .venv/bin

.PHONY: setup demo test test-slow lint format clean
setup: .venv/ready

.venv/ready: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q -c constraints.txt -e ".[all]"
	touch $@

demo: setup
	$(BIN)/aerial-gym demo --out out/demo

test: setup
	$(BIN)/python -m pytest

test-slow: setup
	$(BIN)/python -m pytest -m slow

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf .venv out runs train_dir build *.egg-info
