# make compare   methods side by side, each answer certified; needs Python 3.11 or newer, nothing else
# make test      lint, types and tests
# make gate      quick results of some tables against the committed ones
# make setup     the environment alone

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet install

# A stamp is written after its step succeeded: an interrupted step is done again.
MADE := $(VENV)/.made
COMPARE := $(VENV)/.installed-baselines
DEVELOP := $(VENV)/.installed-dev

.PHONY: compare test gate setup clean

compare: $(COMPARE)
	@$(BIN)/certpgo compare

test: $(DEVELOP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy certpgo
	$(BIN)/python -m pytest -n 2

gate: $(DEVELOP)
	@$(BIN)/certpgo gate

setup: $(DEVELOP)

$(MADE):
	$(PYTHON) -c 'import sys; sys.exit("certpgo needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(COMPARE): pyproject.toml $(MADE)
	$(PIP) --editable '.[baselines]'
	@touch $@

$(DEVELOP): pyproject.toml $(MADE)
	$(PIP) --editable '.[dev]'
	@touch $@ $(COMPARE)

clean:
	rm -rf $(VENV) build *.egg-info
