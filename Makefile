# Two commands do everything: make demo, make test. All they make stays in this folder.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
export PIP_DISABLE_PIP_VERSION_CHECK = 1
export PIP_NO_CACHE_DIR = 1
export PYTHONDONTWRITEBYTECODE = 1
export MPLCONFIGDIR = $(CURDIR)/$(VENV)/cache/matplotlib
export IPYTHONDIR = $(CURDIR)/$(VENV)/cache/ipython
export JUPYTER_CONFIG_DIR = $(CURDIR)/$(VENV)/cache/jupyter
export JUPYTER_DATA_DIR = $(CURDIR)/$(VENV)/share/jupyter
export JUPYTER_RUNTIME_DIR = $(CURDIR)/$(VENV)/cache/runtime
export XDG_CACHE_HOME = $(CURDIR)/$(VENV)/cache

STUDY := configs/studies/kr270.toml
TARGETS := configs/studies/kr270_targets.csv
OUT := out/demo
WRONG := configs/studies/kr270_diagnose.toml
CELL := configs/studies/kr270_cell.toml
POSES := configs/studies/kr270_diagnose_poses.csv

.PHONY: help demo cell test slow exam lint bench clean

help:
	@echo "make demo   the main job: plan, simulate, identify, predict, compensate, diagnose, report"
	@echo "make cell   a plan in a real cell: tracker, floor, wall, cabinet, three weights on a crane"
	@echo "make test   the tests, a quarter of an hour at most"
	@echo "make slow   the tests that make test leaves out: whole plans and campaigns of many seconds"
	@echo "make exam   several hundred blind diagnoses; fresh seed, or EXAM='--seed 1 --cases 100'"
	@echo "make lint   style, types, import contract"
	@echo "make bench  the measured numbers of docs/benchmarks.md"

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c "import sys; sys.exit(0 if sys.version_info >= (3, 11) else 'Python 3.11 or newer is needed')"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt hatchling editables
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-build-isolation --editable ".[dev]"
	@touch $@

demo: $(STAMP)
	$(BIN)/elastocal plan $(STUDY) --out $(OUT)/plan --force
	$(BIN)/elastocal evaluate $(STUDY) $(OUT)/plan/plan.csv --out $(OUT)/evaluate --force
	$(BIN)/elastocal simulate $(STUDY) $(OUT)/plan/plan.csv --truth configs/truths/kr270.toml --out $(OUT)/measured --force
	$(BIN)/elastocal identify $(STUDY) $(OUT)/measured/measurements.csv --out $(OUT)/identify --force
	$(BIN)/elastocal predict $(STUDY) $(OUT)/identify/identify.json $(OUT)/plan/plan.csv --out $(OUT)/predict --force
	$(BIN)/elastocal compensate $(STUDY) $(OUT)/identify/identify.json $(TARGETS) --out $(OUT)/compensate --force
	$(BIN)/elastocal simulate $(WRONG) $(POSES) --truth configs/truths/kr270_diagnose.toml --out $(OUT)/wrong --force
	$(BIN)/elastocal diagnose $(WRONG) $(OUT)/wrong/measurements.csv --out $(OUT)/diagnose --force
	$(BIN)/elastocal report $(OUT)/diagnose

cell: $(STAMP)
	$(BIN)/elastocal plan $(CELL) --out out/cell --force

test: $(STAMP)
	$(BIN)/python -m pytest -n 2 -p no:cacheprovider

slow: $(STAMP)
	$(BIN)/python -m pytest -n 2 -p no:cacheprovider -m slow

exam: $(STAMP)
	$(BIN)/python -m tests.blind --cases 400 $(EXAM)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --cache-dir $(VENV)/cache/mypy
	$(BIN)/lint-imports --no-cache

bench: $(STAMP)
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) out .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
