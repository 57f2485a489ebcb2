# make demo | test | test-slow | search | lint | coverage | wheels | docs | pictures | pages | scaling | bench | clean
# PYTHON=/path/to/python3.12 chooses the interpreter of .venv
#
# Needs Python 3.10 or newer with venv, and make. Everything else is installed into .venv, ROS 2 included.

PYTHON ?= python3
PYTEST_ARGS ?=
BENCH_ARGS ?=
PYTHONS ?=
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check

# The .venv brings its own ROS 2: a sourced one, or the library path of another venv, must not leak into it.
ifneq ($(AMENT_PREFIX_PATH)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport LD_LIBRARY_PATH
endif
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE AMENT_PREFIX_PATH COLCON_PREFIX_PATH PYTHONHOME PYTHONPATH RMW_IMPLEMENTATION

INSTALL_HINT := Installation failed. If it was ROS 2: its wheels are for Linux on x86-64 and Python 3.10 to 3.14; \
elsewhere build with colcon in a sourced ROS 2 Jazzy.

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: demo docs pictures pages scaling bench test test-slow search lint coverage wheels clean

demo: $(VENV)/installed-demo
	$(BIN)/rb-dynamics demo

# The demo is flown only if it has not been; after a change: make demo pictures
pictures: out/demo.rrd | $(VENV)/installed-demo
	$(BIN)/python tools/make_pictures.py

# What a run costs, and how that grows: docs/scaling.md. Times are of this machine; a few minutes.
scaling: $(VENV)/installed-test
	$(BIN)/python benchmarks/scaling.py

# The pages of docs/ whose numbers and figures are made by a script.
pages: $(VENV)/installed-test
	$(BIN)/python tools/make_diagram.py
	$(BIN)/python tools/make_lecture.py
	$(BIN)/python tools/make_reference.py
	$(BIN)/python tools/make_verification.py

# The site, in out/site; a link that leads nowhere is an error, but not with --quiet: mkdocs counts what it says.
docs: $(VENV)/installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "out/site/index.html"

# What users would pick instead, on the same problems: a quarter of an hour, and the machine to itself. A peer that cannot
# be installed here is left out; gcc is used if it is there.
bench: $(VENV)/installed-bench
	$(BIN)/python benchmarks/compare.py $(BENCH_ARGS)

out/demo.rrd: | $(VENV)/installed-demo
	$(BIN)/rb-dynamics demo

# Three workers for two cores: that of ROS waits most of the time.
test: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 3 $(PYTEST_ARGS)

test-slow: $(VENV)/installed-test
	$(BIN)/python -m pytest -m slow $(PYTEST_ARGS)

# The property tests with new examples each time, ten times as many where a test does not say how many: what it finds
# becomes a test of its own.
search: $(VENV)/installed-test
	$(BIN)/python -m pytest -n 3 --hypothesis-profile search $(PYTEST_ARGS)

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --strict rb_dynamics

# What of the package the tests run, processes that they start included; it takes twice as long as the tests, and from
# Python 3.14 on hardly longer than they.
coverage: $(VENV)/installed-test
	$(BIN)/python -m coverage erase
	-$(BIN)/python -m coverage run -m pytest -n 3 --timeout 600 $(PYTEST_ARGS)
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report

# Sdist and wheel, installed with the newest and the oldest dependencies in every python on PATH, or in these: PYTHONS='...'
wheels: $(VENV)/installed-test
	$(BIN)/python tools/try_wheels.py $(PYTHONS)

clean:
	rm -rf $(VENV) build dist install log out *.egg-info .coverage* .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# An environment that is there is kept; a half-made one is made anew. colcon-core asks for setuptools below 80.
$(VENV)/created:
	@$(PYTHON) -c '' 2>/dev/null || { echo "No working '$(PYTHON)': install Python 3.10 or newer, or say: make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; v = sys.version_info; v >= (3, 10) or sys.exit("Python %d.%d is too old: Python 3.10 or newer is needed; say: make PYTHON=/path/to/python3" % v[:2])'
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV) || { echo "'$(PYTHON) -m venv' failed: install the venv module (Debian, Ubuntu: apt install python3-venv)" >&2; exit 1; }
	@$(PIP) install --quiet --upgrade 'pip>=23.1' 'setuptools>=70.1,<80'
	@touch $@

# setuptools warns of what an editable install is; that is known here.
INSTALL := PYTHONWARNINGS=ignore::UserWarning $(PIP) install --quiet --no-build-isolation --editable
EXTRAS_demo := ros,log,plot
EXTRAS_test := $(EXTRAS_demo),fast,scale,test,dev,docs
EXTRAS_docs := docs

# Peers are installed one by one: not every one has wheels for every machine.
PEERS = $(BIN)/python -c "import importlib.metadata as m; \
    [print(r.split(';')[0]) for r in m.requires('rb_dynamics') if 'extra == \"bench\"' in r.replace(chr(39), chr(34))]"
$(VENV)/installed-bench: $(VENV)/created package.xml pyproject.toml setup.cfg setup.py
	@echo "Installing the peers of the benchmark into $(VENV), once: this takes some minutes ..."
	@$(INSTALL) '.[fast,plot]'
	@$(PEERS) | while read -r peer; do \
	    $(PIP) install --quiet "$$peer" || echo "$$peer cannot be installed here: it is left out"; done
	@touch $@

$(VENV)/installed-%: $(VENV)/created package.xml pyproject.toml setup.cfg setup.py
	@echo "Installing into $(VENV), once: this takes a minute or two ..."
	@$(INSTALL) '.[$(EXTRAS_$*)]' || { echo "$(INSTALL_HINT)" >&2; exit 1; }
	@touch $(VENV)/installed-demo $@
