# Everything a developer types; `make` alone lists it.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

VENV := .venv
BIN := $(VENV)/bin
WORKFLOW := ratms
INSTALLED := $(VENV)/installed.stamp
PROJECTS := pyproject.toml sim/pyproject.toml lab/pyproject.toml
TARGETS := $(filter-out __init__ running,$(basename $(notdir $(wildcard fuzz/*.py))))
SECONDS := 30
SEED := 0
PART :=
OPTIONS :=
WITH := sim hardware console
WORKERS := $(shell echo $$((3 * $$(nproc) / 2)))
EXTRAS := daemon recording report authoring hardware console imaging ros2 archive docs fuzz dev

# Some containers set it; each process would then compile every module that it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install demo test check quick nightly evidence mutants fuzz bench tools spin browser mono screenshots docs lint lock release bundle clean

help: ## List these targets
	@sed -nE 's/^([a-z]+):[^#]*## (.*)/  make \1\t\2/p' Makefile

install: $(INSTALLED) ## Create .venv with the locked versions; done once, again when they change; PYTHON=python3.13 for another Python

demo: install ## Run a procedure on the simulated cell and print its errors; WORKFLOW=femoroplasty for another
	$(BIN)/pcmrs demo --workflow $(WORKFLOW)

test: install ## Run the whole test suite; OPTIONS=--tools-installed: a test that is skipped for a missing tool fails
	$(BIN)/pytest -n $(WORKERS) --dist worksteal $(OPTIONS)

nightly: install ## Run what `make test` leaves out, in parts; PART=faults for some, OPTIONS=--publish for docs/evidence.md
	$(BIN)/python -m tests.nightly.run $(OPTIONS) $(PART)

evidence: install ## Make docs/evidence.md from the documents' promises and the last nightly runs
	$(BIN)/python -m tests.nightly.make_evidence

mutants: install ## Take guards out of the product, one at a time, and count how many the tests miss; hours
	$(BIN)/python -m tests.mutants.run_mutants map
	$(BIN)/python -m tests.mutants.run_mutants listed
	$(BIN)/python -m tests.mutants.run_mutants generated
	$(BIN)/python -m tests.mutants.run_mutants uncovered

fuzz: install ## Fuzz every parser of bytes from outside, SECONDS=30 each; TARGETS="kst ndi" for some of them
	@export TMPDIR=$$(mktemp -d); trap 'rm -rf "$$TMPDIR"' EXIT; log=$$TMPDIR/log; \
	for target in $(TARGETS); do \
	    echo "fuzz.$$target"; \
	    $(BIN)/python -m fuzz.$$target -max_total_time=$(SECONDS) -seed=$(SEED) >"$$log" 2>&1 || { tail -n 40 "$$log"; exit 1; }; \
	    tail -n 1 "$$log"; \
	done

tools: spin browser mono ## Install all that tests are skipped and faults are not injected without (Debian packages, as root)
	DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends \
	    e2fsprogs fonts-dejavu-core graphviz iproute2 mount nftables postgresql strace systemd >/dev/null

spin: ## Install the model checker SPIN and two C compilers (Debian packages, as root); without them its tests are skipped
	apt-get update -qq
	DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends spin gcc tcc libc6-dev >/dev/null

browser: ## Install the browser that the console is tested in (Debian packages, as root); without it those tests are skipped
	command -v chromium >/dev/null || { apt-get update -qq && \
	    DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends chromium >/dev/null; }

mono: ## Install the C# compiler that the Unity client is tested with (Debian packages, as root); without it those tests are skipped
	apt-get update -qq
	DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends mono-mcs >/dev/null

bench: install ## Measure every figure of speed beside its peer and write benchmarks/RESULTS.md (10 minutes)
	$(BIN)/python benchmarks/bench.py $(OPTIONS)

docs: install ## Build the documentation into site/, strictly: a broken link fails
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

screenshots: install ## Take the pictures of the console that docs/console.md shows; needs `make browser`
	$(BIN)/python -m tests.system.console.screenshots docs/pictures

check: install ## Check style, types and words, and run the unit tests that are quick (tests/slow.txt has the others)
	$(MAKE) --no-print-directory --jobs=2 --output-sync lint quick

quick: install
	$(BIN)/pytest -n $$(nproc) --dist worksteal --quick $(OPTIONS) tests/unit

lint: install ## Check style, format, words, types and import contracts
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/python .ci/style.py
	$(BIN)/mypy --strict
	$(BIN)/lint-imports

lock: install ## Remake requirements.lock from the three pyproject.toml; keeps the versions that still fit
	$(BIN)/uv pip compile --quiet --generate-hashes --no-emit-index-url --no-strip-markers --custom-compile-command "make lock" \
	    --no-emit-package pcmrs --no-emit-package pcmrs-sim $(EXTRAS:%=--extra %) --output-file requirements.lock $(PROJECTS)

release: install ## Build the wheels, the source archive, SBOM and checksums into dist/; publishes nothing
	.ci/release

bundle: install ## Make one archive that installs on a machine without a network; WITH="sim console" for other extras
	.ci/bundle $(WITH)

clean: ## Remove .venv, caches and what was built
	rm -rf $(VENV) build dist site .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(INSTALLED): requirements.lock $(PROJECTS)
	@bash .ci/venv $(VENV)
	@echo "installing the locked versions into $(VENV)"
	@$(BIN)/python -m pip install --quiet --require-hashes --no-deps --requirement <(sed -n '/^uv==/,/# via/p' requirements.lock)
	@$(BIN)/uv pip install --quiet --python $(VENV) --require-hashes --requirement requirements.lock
	@$(BIN)/uv pip install --quiet --python $(VENV) --no-deps --no-build-isolation --editable . --editable sim --editable lab
	@touch $@
