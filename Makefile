# `make demo`, `make play` and `make test` are all that a newcomer needs; each sets up what it uses, in .venv.
PYTHON ?= python3
ROBOT ?= g1
VENV := .venv
BIN := $(VENV)/bin
# The processes of the tests start faster with the bytecode of earlier ones.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo browser play test lint bench test-kilted boundscheck kernel-coverage docs site dist install-test lock check-lock clean

help:  ## say what there is to make
	@grep -E '^[a-z-]+:.*##' Makefile | sed 's/:.*## /\t/' | expand -t 17

demo: $(VENV)/demo.installed  ## watch a robot stand, sway, squat, reach and be shoved: make demo ROBOT=talos
	$(BIN)/wbc demo $(ROBOT) --sensors good

play: $(VENV)/demo.installed  ## play with a robot in the browser: push it, drag its hands: make play ROBOT=go2
	$(BIN)/wbc play $(ROBOT)

# Files with live tests: reading of all others would take each process seconds.
LIVE_TESTS = $(shell grep -rl --include='test_*.py' 'mark\.live' test)

test: $(VENV)/dev.installed  ## run all tests: in parallel, then those that wait for wall time, two at a time
	$(BIN)/python -m pytest -n logical --dist worksteal --durations 12 -m "not live and not browser"
	$(BIN)/python -m pytest -n 2 --dist worksteal --durations 12 -m live $(LIVE_TESTS)

test-kilted:  ## test nodes and transports with the wheels of ROS 2 Kilted, in .venv-kilted
	$(MAKE) VENV=.venv-kilted .venv-kilted/kilted.installed
	.venv-kilted/bin/python -m pytest -n 2 --dist worksteal -m "not browser" test/nodes/ros2 test/middleware/transports

browser: $(VENV)/dev.installed  ## press, drag and pull on the live page in headless Chromium, which has to be installed
	$(BIN)/python -m pytest -m browser

SCHEMA := $(BIN)/check-jsonschema --builtin-schema

lint: $(VENV)/dev.installed  ## ruff and mypy; the workflows, issue forms and CITATION.cff by their schemas and by zizmor
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(SCHEMA) vendor.github-workflows .github/workflows/*.yml
	$(SCHEMA) vendor.github-issue-forms .github/ISSUE_TEMPLATE/bug.yml .github/ISSUE_TEMPLATE/feature.yml
	$(SCHEMA) vendor.github-issue-config .github/ISSUE_TEMPLATE/config.yml
	$(SCHEMA) vendor.citation-file-format CITATION.cff
	$(BIN)/zizmor --offline --pedantic --quiet .github/workflows

bench: $(VENV)/dev.installed  ## time the solvers, and whole cycles beside tsid's and placo's: make bench AGAINST=commit
	$(BIN)/python benchmarks/solvers.py
	$(BIN)/python benchmarks/compare.py $(if $(AGAINST),--against $(AGAINST))

# The tests of the rooms with kernels, without those that depend on wall time.
KERNEL_TESTS := test/test_compilation.py test/test_kernel_sizes.py test/inverse_dynamics test/estimation test/safety \
    test/walking
NOT_LIVE := -n logical --dist worksteal -m "not live and not browser"

boundscheck: $(VENV)/dev.installed  ## test the kernels with bounds checks of arrays
	NUMBA_BOUNDSCHECK=1 $(BIN)/python -m pytest $(NOT_LIVE) $(KERNEL_TESTS)

kernel-coverage: $(VENV)/dev.installed  ## test the kernels as Python functions, and report the lines that ran
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest $(NOT_LIVE) --cov --cov-config pyproject.toml \
	    --cov-report term-missing:skip-covered $(KERNEL_TESTS)

docs: $(VENV)/dev.installed  ## write the generated pages of docs/
	$(BIN)/python docs/reference_pages.py docs

dist: $(VENV)/dev.installed  ## build sdist and wheel in dist/, and check their metadata and files
	rm -rf dist build
	$(BIN)/check-manifest --no-build-isolation
	$(BIN)/python -m build --no-isolation
	$(BIN)/twine check --strict dist/*

install-test: dist  ## install the wheel in an empty environment without and with each extra, and try it: downloads 500 MB
	$(PYTHON) benchmarks/installation.py dist/*.whl

# Without --quiet, which also hides the warnings from the strict build.
site: docs  ## build the documentation site from docs/ into site/; broken links and pages outside the navigation are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

lock:  ## resolve requirements/*.txt anew; needs uv
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-emit-index-url --no-header --no-annotate --no-strip-extras \
	    --upgrade --quiet pyproject.toml --extra demo --output-file requirements/demo.txt
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-emit-index-url --no-header --no-annotate --no-strip-extras \
	    --upgrade --quiet pyproject.toml requirements/dev.in --constraints requirements/demo.txt --extra demo --extra test --extra ros2 \
	    --output-file requirements/dev.txt
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-emit-index-url --no-header --no-annotate --no-strip-extras \
	    --upgrade --quiet pyproject.toml requirements/kilted.in --constraints requirements/demo.txt --extra demo --extra test \
	    --extra ros2-kilted --output-file requirements/kilted.txt

# Machines and Pythons on which the locked packages can be installed.
MACHINES := x86_64 aarch64
PYTHONS := 3.10 3.11 3.12 3.13 3.14

check-lock:  ## look for a wheel of each package of requirements/demo.txt for each machine and Python; needs uv
	for machine in $(MACHINES); do for python in $(PYTHONS); do echo "$$machine, Python $$python"; \
	    uv pip compile --quiet --no-deps --only-binary :all: --python-platform $$machine-manylinux_2_28 \
	        --python-version $$python requirements/demo.txt >/dev/null || exit 1; \
	done; done

clean:  ## remove the virtual environment and everything that was built
	rm -rf $(VENV) .venv-kilted .venv-tsid .venv-placo build dist *.egg-info report faults bench site .pytest_cache .coverage .mypy_cache .ruff_cache .hypothesis

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 10) or sys.exit("wbc_controller needs Python 3.10 or newer; $(PYTHON) is " + sys.version.split()[0] + ". Name another one: make PYTHON=python3.12 …")'
	$(PYTHON) -m venv $(VENV)

# The locked requirements first, by hash; then this package itself, in place. They are complete, so that pip need not
# resolve them, and Python compiles the imported modules only.
$(VENV)/%.installed: requirements/%.txt pyproject.toml setup.py | $(BIN)/python
	@echo "Installing the locked requirements into $(VENV): about 395 MB to download the first time."
	$(BIN)/python -m pip install --disable-pip-version-check --no-deps --no-compile --require-hashes --requirement $<
	$(BIN)/python -m pip install --disable-pip-version-check --quiet --no-deps --no-build-isolation --editable .
	@touch $@
