# Everything a developer or a CI machine runs. Needs Python 3.11+, pip and make; sets up its own .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test lint format bench fuzz docs clean

demo: $(STAMP)
	$(BIN)/pdgw demo

test: $(STAMP)
	$(BIN)/pytest

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(STAMP)
	$(BIN)/pdgw bench

fuzz: $(STAMP)
	PDGW_HYPOTHESIS=fuzz $(BIN)/pytest tests/fuzz

docs: $(STAMP)
	$(BIN)/python -m tools.doctables
	$(BIN)/python -m dsp402.device
	$(BIN)/python -m dsp406.device

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[plot,dev]'
	@touch $@

clean:
	rm -rf $(VENV) demo-out build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
