# Everything for everyone: make setup, make demo, make test, make check, make test-portable, make coverage, make bench, make docs, make reference, make reference-times. Each can be repeated and reuses what stands.
# ROS=kilted runs it on ROS 2 Kilted, in an environment of its own.
PYTHON ?= python3
ROS ?= jazzy
VENV := .venv$(if $(filter-out jazzy,$(ROS)),-$(ROS))
ROS_EXTRA := $(if $(filter-out jazzy,$(ROS)),$(ROS),ros)
CONSTRAINTS := -c constraints.txt -c constraints-$(ROS).txt
BIN := $(VENV)/bin
CACHE := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/foretouch
PIP := $(BIN)/pip --disable-pip-version-check --quiet
# Says what it downloads and installs: a loaded machine or a slow network takes many minutes.
INSTALL := $(BIN)/pip --disable-pip-version-check install

# The messages take a compiler and most of a minute: their wheel is built once for each content and Python, and kept.
MESSAGE_FILES := $(sort $(shell find foretouch_msgs -type f -not -name '*.pyc'))
MESSAGE_KEY := $(shell { cat $(MESSAGE_FILES); $(PYTHON) -c 'import sys; print(sys.implementation.cache_tag)'; echo $(ROS); } | sha256sum | cut -c1-16)
MESSAGE_WHEEL := $(CACHE)/foretouch_msgs-$(MESSAGE_KEY)

# Two cores are enough for everything; more threads than cores only make the small matrices slower.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

# Where an environment forbids to keep compiled modules, each of the processes that tests start would compile foretouch anew.
export PYTHONDONTWRITEBYTECODE :=

# Tests find memory filled with a pattern where it was not initialised, so that what depends on it fails everywhere.
test test-ros test-portable check coverage: export MALLOC_PERTURB_ ?= 170

.PHONY: setup runtime demo simulated test test-portable test-ros check coverage bench docs reference reference-times format clean

# What a robot needs, and the laboratory's simulator for the demo; and what the tests need besides.
runtime: $(VENV)/.runtime
setup: $(VENV)/.installed

$(VENV)/.runtime: setup.cfg constraints.txt constraints-$(ROS).txt setup.py pyproject.toml $(wildcard src/foretouch/kernels/*.[ch]) src/foretouch/kernels/build.py $(MESSAGE_FILES)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "foretouch needs Python 3.11 or newer: make setup PYTHON=python3.11")'
	@test ! -e $@ || test "$$(cat $@)" = $(ROS) || { echo "setup: $(VENV) holds another ROS 2: it is made anew"; rm -rf $(VENV); }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "setup: installing what setup.cfg requires, in the versions of constraints.txt (some minutes), and building the ROS messages meanwhile (once)"
	@{ test -d $(MESSAGE_WHEEL) || { mkdir -p $(CACHE) && FORETOUCH_ROS=$(ROS) $(PIP) wheel --no-deps -w $(MESSAGE_WHEEL).part ./foretouch_msgs \
	    && mv $(MESSAGE_WHEEL).part $(MESSAGE_WHEEL); }; } & messages=$$!; \
	  $(INSTALL) $(CONSTRAINTS) -e '.[$(ROS_EXTRA),camera,sim]' && wait $$messages
	@$(PIP) install --no-deps --force-reinstall $(MESSAGE_WHEEL)/*.whl
	@echo $(ROS) > $@

$(VENV)/.installed: $(VENV)/.runtime
	@echo "setup: installing what the tests need (half a minute; on a loaded machine more)"
	@$(INSTALL) $(CONSTRAINTS) -e '.[lab,open3d,hdf5,tables,urdf,view,serve,physics,docs,test,dev]'
	-@$(BIN)/foretouch doctor
	@touch $@

demo: runtime
	@rm -rf demo-output
	$(BIN)/foretouch run --source config/scenes/demo.yaml --dwell 2 --count 110 --picture demo-output/touch.png

# The released model of the simulated hand: its training grasps, the model and its scores, in a quarter of an hour on one core.
simulated: setup
	rm -rf build/simulated_hand build/simulated
	$(BIN)/foretouch simulate config/scenes/simulated_hand.yaml -n 1200 -o build/simulated_hand --no-sheet
	$(BIN)/foretouch train simulated data=build/simulated_hand release=true -o build/simulated
	cp build/simulated/simulated*.json build/simulated/simulated*.safetensors src/foretouch/models/weights

# All but the slow tests; docs/testing.md describes the targets and markers.
test: setup
	$(BIN)/pytest -n 2 --dist loadgroup -m "not slow"

# What reads committed numbers, as other processors compute them.
test-portable: setup
	$(BIN)/python test/portable.py

test-ros: runtime
	@$(PIP) install $(CONSTRAINTS) -e '.[lab,test]'
	$(BIN)/pytest -n 2 --dist loadgroup test/ros

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -n 2 --dist loadgroup

# Branches of src/foretouch that no test takes.
coverage: setup
	$(BIN)/pytest -n 2 --dist loadgroup --cov --cov-report term-missing:skip-covered

# Fails on a loss of more than 20 % of speed; make bench BENCH=--renew commits the ratios of this machine.
bench: setup
	$(BIN)/python -m benchmarks.guard.bench $(BENCH)

# The site, in build/docs; a warning is an error.
docs: runtime
	@$(PIP) install $(CONSTRAINTS) -e '.[lab,docs]'
	$(BIN)/sphinx-build -q -W --keep-going -b html docs build/docs
	@echo "docs: open build/docs/index.html"

# The reference pages of docs, from the code; a test compares them.
reference: setup
	$(BIN)/python docs/_ext/reference_pages.py

# What accuracy costs in time: all areas of `foretouch tradeoff`, on two idle cores within an hour; then the page, its tables and
# pictures. It goes on where it was stopped; rm -r build/reference-times starts anew. TIMES="--preset smoke" tries it, to build/tried-times alone.
# The papers' networks have their skill from the leaderboard; PCL's LCCP and the published GeoGrasp are rows where they can be compiled.
NEW_TIMES := $(if $(TIMES),build/tried-times,build/reference-times)
reference-times: setup
	test -f $(NEW_TIMES)/model/tradeoff.csv || $(BIN)/foretouch tradeoff model -o $(NEW_TIMES)/model $(if $(wildcard $(NEW_TIMES)/model),--resume) $(TIMES) leaderboard=docs/results/leaderboard/results.csv
	$(BIN)/foretouch tradeoff all -o $(NEW_TIMES) --resume $(TIMES)
	$(if $(TIMES),,$(BIN)/python docs/reference_times.py build/reference-times)

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf .venv .venv-kilted build install log dist demo-output
