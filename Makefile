# Tasks of users and contributors. Each target first brings .venv up to date with tools/bootstrap,
# which takes a moment if nothing has changed.

# PYTHON=python3.12 make test    chooses the interpreter of .venv
PYTHON ?=
# DEMO_SPP=16 make demo          a quick, noisy demo (samples per pixel; default: as in the scenes)
DEMO_SPP ?=
# TESTS='-k automean' make test  arguments of pytest
TESTS ?=

# FIGURES='projs' make paper-figures   arguments of python -m paper.figures: names, --quality, --out
FIGURES ?=

# BENCH='--only wigner' make bench  arguments of python -m benchmarks: --quick, --only, --list, --out
BENCH ?=

# These variables are removed, so that an activated environment or other module paths do not affect
# .venv, and so that hundreds of processes do not each compile the modules again.
unexport PYTHONPATH PYTHONHOME VIRTUAL_ENV PYTHONDONTWRITEBYTECODE

BIN := .venv/bin
RUNNER = $(if $(shell command -v python3 2>/dev/null),python3,"$(or $(PYTHON),python3)")
SETUP = $(RUNNER) tools/bootstrap $(if $(PYTHON),--python "$(PYTHON)")
RENDER = $(BIN)/polywigner render
TRANSFORM = $(BIN)/polywigner transform
PROPAGATE = $(BIN)/polywigner propagate
PYTEST = $(BIN)/python -m pytest -n auto --maxprocesses 4 --max-worker-restart 2 --dist loadfile --no-loadscope-reorder

.DEFAULT_GOAL := help
.PHONY: help demo pictures paper-figures test test-all lint format typecheck hooks bench docs dist release constraints ci clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\): ## \(.*\)/  make \1	\2/p' Makefile | expand -t 20

demo: ## render the example scenes, transforms and near fields into out/
	@$(SETUP) --group demo
	@$(MAKE) --no-print-directory pictures \
	  SAMPLES="$$(if [ -n '$(DEMO_SPP)' ]; then echo --spp $(DEMO_SPP); else $(BIN)/python tools/demo_samples.py; fi)" \
	  DIFFRACTING="$$($(BIN)/python tools/demo_samples.py --diffraction $(DEMO_SPP))"

paper-figures: ## draw the figures of the paper into out/paper_figures; FIGURES=projs draws a selection
	@$(SETUP) --group demo
	$(BIN)/python -m paper.figures $(FIGURES)

pictures:
	$(TRANSFORM) examples/two_chevrons/chevrons.geojson --frequency "94 GHz" --out out/two_chevrons_transforms
	$(RENDER) examples/patch_above_floor/scene.xml $(DIFFRACTING) --out out/patch_above_floor
	$(RENDER) examples/two_chevrons/scene.xml $(SAMPLES) --out out/two_chevrons
	$(RENDER) examples/street_77ghz/scene.xml $(DIFFRACTING) --out out/street_77ghz
	$(RENDER) examples/phased_array_77ghz/scene.xml $(SAMPLES) --db-floor -30 --out out/phased_array_77ghz
	$(PROPAGATE) examples/two_chevrons/chevrons.geojson --frequency "94 GHz" --method kirchhoff --accuracy 1e-4 \
	  --plane "-40 mm to 40 mm, 0 mm, 2 mm to 120 mm" --samples "161 x 237" --out out/two_chevrons_near_field
	@echo; echo "Images:"; find out -name '*.png' | sort | sed 's/^/  /'

test: ## run all tests except the slow ones
	@$(SETUP) --group test
	$(PYTEST) -m "not slow" $(TESTS)

test-all: ## run all tests, including the slow ones
	@$(SETUP) --group test
	$(PYTEST) $(TESTS)

lint: ## check style, formatting and English
	@$(SETUP) --group dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python tools/check_prose.py

format: ## format the sources
	@$(SETUP) --group dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

typecheck: ## check the types with mypy
	@$(SETUP) --group dev
	$(BIN)/mypy

hooks: ## check style, types and documents before each commit
	@$(SETUP) --group dev
	$(BIN)/pre-commit install

bench: ## compare with other programs, into benchmarks/results; BENCH=--quick make bench takes half a minute
	@$(SETUP) --group bench
	$(BIN)/python -m benchmarks $(BENCH)

docs: ## check the documents, and build the site in docs/_build/html/index.html
	@$(SETUP) --group docs
	$(BIN)/python tools/check_documents.py
	$(BIN)/python tools/fill_documents.py --check
	@rm -rf docs/_build docs/lessons # Sphinx would not repeat the warnings of unchanged pages
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going --conf-dir docs . docs/_build/html
	$(BIN)/python tools/check_documents.py --site docs/_build/html
	@echo "The site: docs/_build/html/index.html"

dist: ## build wheel and sdist into dist/
	@$(SETUP) --group dev
	$(BIN)/python -m build

release: ## rehearse a release: build, check and install the packages, and list what is left to do
	$(or $(PYTHON),python3) tools/release.py

constraints: ## write the versions in .venv, if they have passed the tests, to constraints.txt
	@$(SETUP) --group docs
	$(BIN)/python tools/pin_versions.py

ci: ## run all checks, and install the packages into empty environments
	.ci/run

clean: ## remove .venv and all generated files
	rm -rf .venv out build dist docs/_build docs/lessons benchmarks/results .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
