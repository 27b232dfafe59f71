# `make demo`, `make test` with `make lint`, and for measuring `make bench`, `make tradeoff` and `make paper`. Each sets everything up first and skips what is already there.
SHELL := /bin/bash
.DELETE_ON_ERROR:
.PHONY: setup stubs demo detector test lint format test-slow wheel sanitize fuzz bench tradeoff paper docs clean

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CPP := $(shell find cpp cmake tests/cpp -name '*.h' -o -name '*.cpp' -o -name 'CMakeLists.txt' -o -name '*.cmake*') CMakeLists.txt

setup: $(VENV)/.core

# apt packages: one look at dpkg's database when all are there
$(VENV)/.packages: tools/apt-packages.txt tools/install-apt
	tools/install-apt tools/apt-packages.txt
	$(PYTHON) -m venv $(VENV)
	touch $@

# a long download may be cut off: it gets a second try
INSTALL = $(BIN)/pip install --quiet $(1) || $(BIN)/pip install --quiet $(1)

# torch by itself first and at one version, so that nothing else chooses a build of it
$(VENV)/.python: $(VENV)/.packages pyproject.toml tools/python-requirements
	$(BIN)/pip install --quiet --upgrade pip
	$(call INSTALL,torch==2.13.0)
	tools/python-requirements pyproject.toml studio avatar export peers test lint wheel > $(VENV)/requirements.txt
	$(call INSTALL,--requirement $(VENV)/requirements.txt)
	$(BIN)/pip install --quiet 'scikit-build-core>=0.10' 'pybind11>=3.1,<3.2'
	touch $@

# one build serves the Python module and the C++ tests
$(VENV)/.core: $(VENV)/.python $(CPP)
	$(BIN)/pip install --quiet --no-build-isolation --no-deps --config-settings=cmake.define.TOILE_TESTS=ON --editable .
	touch $@

# mediapipe, whose wheel carries its networks, in an environment of its own: it wants an older numpy
detector: $(VENV)-detector/.ready
$(VENV)-detector/.ready: tools/detector-requirements.txt
	$(PYTHON) -m venv $(VENV)-detector
	$(VENV)-detector/bin/pip install --quiet --requirement tools/detector-requirements.txt
	touch $@

demo: setup
	$(BIN)/python apps/demo.py

# a process a core, of one thread where a test asks for no more: threads of two processes wait for one another by spinning. Each takes
# neighbours, which share what their file makes once
test: setup lint
	ctest --test-dir build --output-on-failure
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses auto --dist worksteal

# the types of the compiled module, after a change of the bindings
stubs: setup
	$(BIN)/python tools/make-stubs

# what machines hold: names and imports, layout of Python and C++, types of what users import
LAYOUT = find cpp tests/cpp -name "*.h" -print0 -o -name "*.cpp" -print0 | xargs -0 $(BIN)/clang-format
lint: setup
	$(BIN)/ruff check
	$(BIN)/ruff format --check --quiet
	$(LAYOUT) --dry-run -Werror
	$(BIN)/mypy

format: setup
	$(BIN)/ruff check --fix
	$(BIN)/ruff format
	$(LAYOUT) -i

# SLOW="--time-budget SECONDS" runs as many as fit and says which do not
test-slow: setup sanitize
	$(BIN)/python -m pytest -m slow -rs $(SLOW)

# dist/: a wheel for any processor with the libraries that it links to; tried in an environment of its own
wheel: setup
	rm -rf dist/plain
	$(BIN)/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist/plain .
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python -m auditwheel repair --wheel-dir dist dist/plain/toile-*.whl
	$(BIN)/python -m pytest -m "slow or not slow" -rs tests/test_wheel.py

# the core with address and undefined-behaviour sanitizers, and its C++ tests. Leaks of the libraries beneath are not ours
SANITIZED := build-sanitize
sanitize: setup
	cmake -S . -B $(SANITIZED) -G Ninja -DTOILE_SANITIZE=ON -DTOILE_TESTS=ON -DPython_EXECUTABLE=$(abspath $(BIN)/python) \
		-Dpybind11_DIR=$$($(BIN)/python -m pybind11 --cmakedir)
	cmake --build $(SANITIZED) --parallel 2
	ASAN_OPTIONS=detect_leaks=0 ctest --test-dir $(SANITIZED) --output-on-failure

# random ugly arrays into every function of toile.kernels, in the sanitized core; what is found lies in fuzz/
FUZZ_SECONDS ?= 600
fuzz: sanitize
	$(BIN)/python -m tests.fuzz --core $(SANITIZED) --seconds $(FUZZ_SECONDS)

# what only benchmarks need; probreg is built from source, and is left out where it does not build
$(VENV)/.peers: $(VENV)/.core
	tools/python-requirements pyproject.toml bench | $(BIN)/pip install --quiet -r /dev/stdin
	$(BIN)/pip install --quiet probreg || echo "probreg does not install here: it is left out"
	touch $@

# times of single kernels
bench: $(VENV)/.peers
	$(BIN)/python -m pytest tests/bench -o python_files='bench_*.py' -o python_functions='bench_*' -o addopts=

# time against error of all presets and peers: tradeoff/tradeoff.png. TRADEOFF=--quick takes minutes
tradeoff: $(VENV)/.peers
	$(BIN)/python -m bench.tradeoff tradeoff $(TRADEOFF)

# the paper's comparisons: paper/index.html; what was stopped goes on. It takes some six hours of two cores, PAPER_FLAGS=--small minutes
paper: setup
	$(BIN)/python -m bench.paper paper $(PAPER_FLAGS)

# the site: build/site/index.html. References are made from the code, equations become MathML
$(VENV)/.docs: $(VENV)/.core
	tools/python-requirements pyproject.toml docs | $(BIN)/pip install --quiet -r /dev/stdin
	touch $@

docs: $(VENV)/.docs
	$(BIN)/toile settings --markdown > docs/reference/settings.md
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

clean:
	rm -rf build $(SANITIZED) demo fuzz tradeoff
