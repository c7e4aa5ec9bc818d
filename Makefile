# Every target starts from a bare machine: Python 3.11 or newer with venv, a C++ compiler, make.
#   make demo          the steak: out/steak.mp4, out/steak.png, out/steak.mcap
#   make test          the tests that are not slow, on the MuJoCo that dm_control supports, in 11 minutes on two cores
#   make test-all      all tests there, in 40 minutes
#   make test-mujoco4  the tests of the plugin, of scenes and of programs that are not slow, on MuJoCo 4
#   make bench         time of steps beside bodies alone and MuJoCo's flex, and of the precomputation, in 17 minutes or more
#   make bench-worlds  the same of many worlds side by side: rate, memory, beside flex
#   make report        error and run time against finite elements and MuJoCo's flex: report/report.md
#   make check         extreme states, and energy that comes from nothing, of bodies that nobody tuned: out/; damaged files
#   make wheels        a wheel for x86-64 and one for aarch64, with a library for every MuJoCo, and a source distribution: dist/
#   make check-wheels  installs these into clean environments without a compiler, and steps the steak there
#   make docs          the documentation: build/docs/index.html
#   make lint          what CI and pre-commit hold the code to

PYTHON3 ?= python3
VENV := .venv
VENV4 := .venv-mujoco4
MUJOCO := 3.17.0
MUJOCO4 := 4.0.0

# A process a core, and one thread in each: more would wait for each other. A file's tests are in one process, in the
# order of the files: the one of the most tests first would leave a few long tests for the end.
define pytest
$(call draw,$(1)) OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(1)/bin/python -m pytest -q -n auto --dist loadfile --no-loadscope-reorder
endef
PIP_INSTALL := -m pip install -q --disable-pip-version-check
# The way MuJoCo draws without a display: MUJOCO_GL if it is set, else the first that works.
define draw
MUJOCO_GL=$$($(1)/bin/python -c 'from mjframes.app.doctor import working_backend as w; print(w() or "")')
endef

.PHONY: demo test test-all test-mujoco4 bench bench-worlds report check wheels check-wheels docs lint format clean

demo: $(VENV)/installed
	$(call draw,$(VENV)) $(VENV)/bin/python examples/steak.py --out out

test: $(VENV)/installed
	$(call pytest,$(VENV)) -m "not slow"

test-all: $(VENV)/installed-ray
	$(call pytest,$(VENV))

test-mujoco4: $(VENV4)/installed
	$(call pytest,$(VENV4)) -m "not dm_control and not slow" tests/app tests/physics tests/plugin tests/scene

bench: $(VENV)/installed $(VENV4)/installed
	$(VENV)/bin/python -m benchmarks.speed.bench --mujoco4 $(VENV4)/bin/python

bench-worlds: $(VENV)/installed $(VENV4)/installed
	$(VENV)/bin/python -m benchmarks.speed.worlds --mujoco4 $(VENV4)/bin/python

report: $(VENV)/installed $(VENV4)/installed
	OPENBLAS_NUM_THREADS=1 $(call draw,$(VENV)) $(VENV)/bin/python -m benchmarks.accuracy.report --mujoco4 $(VENV4)/bin/python

check: $(VENV)/installed
	$(VENV)/bin/python -m benchmarks.stability.check
	$(VENV)/bin/python -m benchmarks.stability.energy
	$(VENV)/bin/python -m benchmarks.stability.damage

wheels: $(VENV)/installed-wheels
	rm -rf dist
	$(VENV)/bin/python plugin/wheels.py

check-wheels: $(VENV)/installed-wheels
	$(VENV)/bin/python plugin/check_wheels.py

docs: $(VENV)/installed-docs
	$(call draw,$(VENV)) $(VENV)/bin/python -m sphinx -n -W --keep-going -q docs build/docs

lint: $(VENV)/installed-lint
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/pyright
	$(VENV)/bin/clang-format --dry-run -Werror plugin/*.cc plugin/*.h plugin/laws/*.h tests/*/*.cc
	$(VENV)/bin/cmake -S plugin -B build/lint -DPython_EXECUTABLE=$(CURDIR)/$(VENV)/bin/python -DCMAKE_COMPILE_WARNING_AS_ERROR=ON
	$(VENV)/bin/cmake --build build/lint --parallel

format: $(VENV)/installed-lint
	$(VENV)/bin/ruff check --fix
	$(VENV)/bin/ruff format
	$(VENV)/bin/clang-format -i plugin/*.cc plugin/*.h plugin/laws/*.h tests/*/*.cc

clean:
	rm -rf $(VENV) $(VENV4) build dist docs/_pictures out .pytest_cache .ruff_cache

$(VENV)/installed: pyproject.toml | $(VENV)/bin/pip
	$(VENV)/bin/python $(PIP_INSTALL) -e ".[all,test]" mujoco==$(MUJOCO)
	touch $@

$(VENV)/installed-lint: $(VENV)/installed
	$(VENV)/bin/python $(PIP_INSTALL) -e ".[all,dev,docs,wheels]" mujoco==$(MUJOCO)
	touch $@

$(VENV)/installed-ray $(VENV)/installed-wheels $(VENV)/installed-docs: $(VENV)/installed-%: $(VENV)/installed
	$(VENV)/bin/python $(PIP_INSTALL) -e ".[all,test,$*]" mujoco==$(MUJOCO)
	touch $@

$(VENV4)/installed: pyproject.toml | $(VENV4)/bin/pip
	$(VENV4)/bin/python $(PIP_INSTALL) -e ".[harmonic,images,meshes,video,log,plot,view,test]" mujoco==$(MUJOCO4)
	touch $@

%/bin/pip:
	@command -v $(PYTHON3) > /dev/null || { echo "$(PYTHON3) is missing: apt-get install python3" >&2; exit 1; }
	@$(PYTHON3) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "$(PYTHON3) is older than 3.11; name a newer one: make PYTHON3=python3.12" >&2; exit 1; }
	@$(PYTHON3) -c 'import ensurepip, venv' 2> /dev/null \
	  || { echo "$(PYTHON3) cannot make environments: apt-get install python3-venv" >&2; exit 1; }
	$(PYTHON3) -m venv $*
