# `make help` lists the targets.
.DEFAULT_GOAL := help
.PHONY: help demo install test test-all test-touched test-slow test-least fuzz regress bags lint style format organ colcon pins audit clean FORCE

PY := .venv/bin/python
COLCON := .venv/bin/colcon --log-base .colcon/log
DEMO_EXTRAS := ros,viewer
EXTRAS := $(DEMO_EXTRAS),camera,instruments,learn,image,calibration,cluster,bench,test

# What the pins' own targets wait for.
AUDITED = $(if $(wildcard .venv/bin/pip-audit),,.venv/.installed)

# .venv is complete in itself: a sourced ROS, another environment's libraries or middleware would only mix with it.
unexport PYTHONPATH PYTHONHOME CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
# Without bytecode on disk each of the hundreds of processes that tests start would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE
ifneq ($(AMENT_PREFIX_PATH)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport AMENT_PREFIX_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
endif
export RMW_IMPLEMENTATION := rmw_fastrtps_cpp

help: ## this list
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1\t\2/p' $(firstword $(MAKEFILE_LIST)) | expand -t 18

# With a terminal, set -m makes Ctrl-C reach the demo alone, which then ends with 0, and not make, which would report it.
demo: .venv/.installed-demo ## node, scripted haptic bridge and viewer (http://127.0.0.1:8080); SECONDS=20 ends by itself
	@set -- .venv/bin/tissue_sim demo $(if $(SECONDS),--seconds '$(SECONDS)'); \
	if [ -t 0 ]; then set -m; "$$@"; else exec "$$@"; fi

install: .venv/.installed ## everything into .venv, with all extras; kernels are compiled, which takes minutes

# Three at once, as those with real processes mostly wait; loadfile: a file's nodes and organs are made once, in the order of
# test/conftest.py. What shares cores has no threads of its own, that would only wait. 5: none was selected.
PYTEST_ON = OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(PY) -m pytest -n 3 --dist loadfile --no-loadscope-reorder

# mypy goes on beside the tests, which wait much; what it says comes last. Kernels are compiled before several processes
# would all do it.
test: style ## checks and tests in five minutes; PYTEST="-k node" selects some of them
	@$(PY) -m mypy > .mypy.log & mypy=$$!; $(PY) .ci/compile; \
	$(PYTEST_ON) $(PYTEST); tests=$$?; .ci/alive mypy tail --pid=$$mypy -f /dev/null; \
	wait $$mypy; types=$$?; cat .mypy.log; rm -f .mypy.log; \
	[ $$types = 0 ] && { [ $$tests = 0 ] || [ $$tests = 5 ]; }

test-all: lint ## the same and the extended tests: hostile input, clusters, other processors, packaging, the browser
	@$(PY) .ci/compile
	@$(PYTEST_ON) -m "not slow" $(PYTEST) || [ $$? = 5 ]

test-touched: .venv/.installed ## the extended tests that the change since BASE affects, and why
	@files=$$($(PY) .ci/touched $(BASE)) || exit; [ -z "$$files" ] || $(PYTEST_ON) -m extended $$files || [ $$? = 5 ]

test-slow: .venv/.installed ## the tests that take minutes each
	@$(PY) -m pytest -m slow $(PYTEST)

# Beside the tests of each kind, statistics tell how many of its examples were used, and how many refused.
fuzz: .venv/.installed ## hostile files, plays and messages: EXAMPLES=200 of each kind, from SEED=1; PYTEST="-k mesh"
	@$(PY) .ci/compile
	@FUZZ_EXAMPLES=$(or $(EXAMPLES),200) FUZZ_SEED=$(or $(SEED),1) \
	$(PYTEST_ON) --dist worksteal -m extended --hypothesis-show-statistics test/fuzz $(PYTEST)

test-least: ## model, contact and node with the oldest supported numpy, scipy and numba; NUMBA=0.60.0 for another
	@.ci/least $(NUMBA)

regress: .venv/.installed-demo ## replays the scenes in bags/ and compares
	@.venv/bin/tissue_sim replay bags/*/

# Only after a change that is meant to change what they show: a diff of bags/summary.txt tells what that is.
bags: .venv/.installed ## records the scenes in bags/ again; SCENES="poke nip" selects some of them
	@$(PY) -m tissue_sim.ros.bags.suite $(SCENES)

lint: style ## ruff and mypy
	@.ci/alive mypy $(PY) -m mypy

style: .venv/.installed
	@$(PY) -m ruff check --output-format concise
	@$(PY) -m ruff format --check --output-format concise || { echo 'run "make format"'; exit 1; }

format: .venv/.installed ## ruff's formatting and safe fixes
	@$(PY) -m ruff check --fix --output-format concise
	@$(PY) -m ruff format

organ: .venv/.installed ## rebuilds the package's kidneys from the phantom and calibrates them
	@$(PY) -m tissue_sim.commands.build_shipped
	.venv/bin/tissue_sim calibrate config/organs/kidney_as_built.npz --out config/organs/kidney.npz
	@$(PY) -m tissue_sim.commands.build_shipped --tumour-in config/organs/kidney_as_built.npz --out config/organs/kidney_tumour.npz
	.venv/bin/tissue_sim calibrate config/organs/kidney_tumour.npz --out config/organs/kidney_tumour.npz

colcon: .venv/.installed-colcon ## colcon build and colcon test with the PyPI wheels, in .colcon
	@$(COLCON) build --build-base .colcon/build --install-base .colcon/install
	@$(COLCON) test --build-base .colcon/build --install-base .colcon/install \
		--return-code-on-test-failure --event-handlers console_direct+
	@$(COLCON) test-result --test-result-base .colcon/build

# Neither brings .venv up to date: pins that no longer fit setup.py would stand in the way of those that do.
pins: $(AUDITED) ## writes the newest versions that setup.py allows to constraints.txt, then runs make audit
	@.ci/alive 'resolving the pins' $(PY) .ci/pins
	@.ci/alive 'querying the vulnerabilities' $(PY) .ci/audit $(SERVICE)

audit: $(AUDITED) ## known vulnerabilities of the versions in constraints.txt, from OSV; SERVICE=pypi for PyPI
	@.ci/alive 'querying the vulnerabilities' $(PY) .ci/audit $(SERVICE)

clean: ## removes .venv, caches and builds
	@rm -rf .venv .venv-least .colcon .mypy_cache .pytest_cache .ruff_cache build install log dist *.egg-info
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

# A stamp holds the folder it was made in: scripts know their path, so a checkout that was moved installs anew.
# The same where the Python below .venv is gone.
STALE := $(if $(realpath .venv/bin/python),$(subst $(CURDIR),,$(file < .venv/.installed-demo)),gone)

.venv/.installed-demo: setup.py setup.cfg constraints.txt tissue_sim/version.py .ci/venv $(if $(STALE),FORCE)
	$(if $(shell .ci/venv --python),,$(error $(NO_PYTHON)))
	.ci/venv $(DEMO_EXTRAS)
	@printf %s '$(CURDIR)' > $@

.venv/.installed: .venv/.installed-demo
	.ci/venv $(EXTRAS)
	@touch $@

.venv/.installed-colcon: .venv/.installed
	.ci/venv colcon
	@touch $@

NO_PYTHON = tissue_sim needs CPython 3.12 and found none: install it \
(apt install python3.12, pyenv install 3.12 or uv python install 3.12) and run make again

# The pages: with what only they need, which nobody else waits for.
.PHONY: docs
docs: .venv/.installed-docs ## the pages, in build/docs; a warning is an error
	@.ci/alive 'making the pages' $(PY) -m sphinx --quiet --fail-on-warning --keep-going --doctree-dir build/doctrees docs build/docs
	@echo 'build/docs/index.html'

.venv/.installed-docs: .venv/.installed
	.ci/venv docs
	@printf %s '$(CURDIR)' > $@
