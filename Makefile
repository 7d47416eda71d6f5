# Everything for everyone: make setup, make demo, make test, make check, make bench. Each can be repeated and reuses what stands.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CACHE := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/foretouch
PIP := $(BIN)/pip --disable-pip-version-check --quiet

# The messages take a compiler and most of a minute: their wheel is built once for each content and Python, and kept.
MESSAGE_FILES := $(sort $(shell find foretouch_msgs -type f -not -name '*.pyc'))
MESSAGE_KEY := $(shell { cat $(MESSAGE_FILES); $(PYTHON) -c 'import sys; print(sys.implementation.cache_tag)'; } | sha256sum | cut -c1-16)
MESSAGE_WHEEL := $(CACHE)/foretouch_msgs-$(MESSAGE_KEY)

# Two cores are enough for everything; more threads than cores only make the small matrices slower.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: setup demo test check bench format clean

setup: $(VENV)/.installed

$(VENV)/.installed: setup.cfg setup.py pyproject.toml $(wildcard src/foretouch/kernels/*.[ch]) $(MESSAGE_FILES)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "foretouch needs Python 3.11 or newer: make setup PYTHON=python3.11")'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "setup: installing what setup.cfg pins (a minute or two)"
	@$(PIP) install -e '.[ros,camera,test,dev]'
	@test -d $(MESSAGE_WHEEL) || { echo "setup: building the ROS messages (once)"; mkdir -p $(CACHE) \
	  && $(PIP) wheel --no-deps -w $(MESSAGE_WHEEL).part ./foretouch_msgs && mv $(MESSAGE_WHEEL).part $(MESSAGE_WHEEL); }
	@$(PIP) install --no-deps --force-reinstall $(MESSAGE_WHEEL)/*.whl
	-@$(BIN)/foretouch doctor
	@touch $@

demo: setup
	@rm -rf demo-output
	$(BIN)/foretouch run --source config/scenes/clean.yaml --count 30 --picture demo-output/touch.png

test: setup
	$(BIN)/pytest -n 2 --dist loadgroup

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -n 2 --dist loadgroup

# Fails on a loss of more than 20 % of speed; make bench BENCH=--renew commits the ratios of this machine.
bench: setup
	$(BIN)/python benchmarks/guard/bench.py $(BENCH)

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) build install log dist demo-output
