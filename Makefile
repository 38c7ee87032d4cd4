# make compare   methods side by side, each answer certified; needs Python 3.11 to 3.13
# make test      lint, types and tests
# make gate      quick results of some tables against the committed ones
# make formal    theorems about public sets, checked by Coq; see formal/README.md
# make paper     the manuscript and the software paper, into build/paper; needs pandoc and LaTeX
# make docs      the site, into build/docs, lessons run; make linkcheck looks its outside links up
# make dist      a wheel and an sdist, into dist
# make release ADDRESS=https://... DATE=2027-01-31   fills in where and when it is released
# make setup     the environment alone

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet install

# A stamp is written after its step succeeded: an interrupted step is done again.
MADE := $(VENV)/.made
COMPARE := $(VENV)/.installed-baselines
DEVELOP := $(VENV)/.installed-dev
DOCS := $(VENV)/.installed-docs

.PHONY: compare test types tests gate formal paper docs linkcheck dist release setup clean

compare: $(COMPARE)
	@$(BIN)/certpgo compare

test: $(DEVELOP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@$(MAKE) --no-print-directory --jobs 2 types tests

types:
	$(BIN)/mypy

tests:
	@# Two workers share the cores: threads of BLAS would only wait for each other.
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal

gate: $(DEVELOP)
	@$(BIN)/certpgo gate

formal: $(DEVELOP)
	@$(BIN)/python formal/build.py

paper: $(DEVELOP)
	@$(BIN)/python -m paper.build
	@echo build/paper/manuscript.pdf build/paper/paper.pdf

docs: $(DOCS)
	@$(BIN)/python -m sphinx -q -W --keep-going -n -b html -d build/docs-doctrees docs build/docs
	@echo build/docs/index.html

linkcheck: $(DOCS)
	@$(BIN)/python -m sphinx -q -b linkcheck -D nb_execution_mode=off docs build/linkcheck

dist: $(DEVELOP)
	$(BIN)/python -m build --outdir dist

# The placeholders: the address in README.md, CITATION.cff and docs; the date in the citation.
release:
	@test -n "$(ADDRESS)" -a -n "$(DATE)" || { echo "make release ADDRESS=https://... DATE=2027-01-31"; exit 1; }
	@git grep -lF -e https://example.org/certpgo -e '{YEAR}' -e '# date-released: DATE' -- '*.md' '*.cff' | xargs sed -i \
		-e 's|https://example.org/certpgo|$(ADDRESS)|g' -e 's|{YEAR}|{$(firstword $(subst -, ,$(DATE)))}|' \
		-e 's|# date-released: DATE|date-released: $(DATE)|'

setup: $(DEVELOP)

$(MADE):
	$(PYTHON) -c 'import sys; sys.exit(0 if (3, 11) <= sys.version_info[:2] <= (3, 13) else "certpgo needs Python 3.11 to 3.13: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(COMPARE): pyproject.toml $(MADE)
	$(PIP) --editable '.[baselines,pages,downloads]'
	@touch $@

$(DEVELOP): pyproject.toml $(MADE)
	$(PIP) --editable '.[dev]'
	@touch $@ $(COMPARE)

$(DOCS): pyproject.toml $(MADE)
	$(PIP) --editable '.[docs]'
	@touch $@

clean:
	rm -rf $(VENV) build *.egg-info
