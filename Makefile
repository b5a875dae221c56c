# make run   the parking study: four planners, 200 runs each, and its report
# make test  the tests, on the CPU
# make slow  the tests of a release: all cases of what `make test` tests by a case a path, claims of the thesis,
#            and equal bits with XLA's default options
# make check formatting, lints, types, layers, links of the documentation
# make smoke a sweep and a robot with the newest versions of all packages, with PYTHON=python3.13
# make site  the documentation as a site, in ./site
# make gallery every figure that bojax can draw, on one page
# EXTRA=cuda13 (or cuda12) installs JAX for an NVIDIA GPU; PYTHON=python3.12 picks the interpreter.
PYTHON ?= python3
EXTRA ?=
BIN := .venv/bin
PINS = constraints/$(shell $(PYTHON) -c 'import sys; print("py311" if sys.version_info < (3, 12) else "py312")').txt
STAMP := .venv/.bojax-$(if $(EXTRA),$(EXTRA),cpu)
DEV_STAMP := .venv/.bojax-dev
# pip itself would compile on one core, and tests of packages too; some packages hold files of Python 2.
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c $(PINS) -e
COMPILE := $(BIN)/python -m compileall -q -j 0 -x /tests/ .venv/lib > /dev/null 2>&1 || true
# Every process that a test starts would compile bojax again, which takes longer than to import it.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run test slow check smoke site gallery format clean

run: $(STAMP)
	$(BIN)/bojax sweep sweeps/parking.yaml

test: $(DEV_STAMP)
	JAX_PLATFORMS=cpu $(BIN)/python -m pytest -n auto --dist loadfile -m "not slow" $(if $(CI),--durations=40)

slow: $(DEV_STAMP)
	BOJAX_TESTS=release JAX_PLATFORMS=cpu $(BIN)/python -m pytest -n auto --dist loadfile -m "bits or minutes"
	JAX_PLATFORMS=cpu $(BIN)/python -m pytest -n auto --dist worksteal -m "slow and not bits and not minutes"

check: $(DEV_STAMP) site
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/pyright

smoke:
	.ci/smoke $(PYTHON)

site: $(DEV_STAMP)
	$(BIN)/zensical build --strict

gallery: $(DEV_STAMP)
	$(BIN)/python pictures/gallery.py results/gallery

format: $(DEV_STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf .venv

$(BIN)/python:
	$(PYTHON) -m venv .venv

$(STAMP): pyproject.toml $(wildcard constraints/*.txt) | $(BIN)/python
	$(INSTALL) ".$(if $(EXTRA),[$(EXTRA)])"
	$(COMPILE)
	touch $@

$(DEV_STAMP): pyproject.toml $(wildcard constraints/*.txt) | $(BIN)/python
	$(INSTALL) ".[test,docs$(if $(EXTRA),$(comma)$(EXTRA))]"
	$(COMPILE)
	touch $@

comma := ,
