# make demo and make test set themselves up: .venv is made, with the tested versions, the first time. Python compiles what is
# imported when it is; pip would compile all 17,000 files, one after the other.
PYTHON ?= python3.11
BIN := .venv/bin

# Versions that were tested together. rl-games and Sample Factory need NumPy 1, and are tested on Python 3.11.
ifeq ($(shell $(firstword $(wildcard $(BIN)/python) $(PYTHON)) -c 'import sys; print(*sys.version_info[:2], sep=".")'),3.11)
CONSTRAINTS ?= constraints.txt
EXTRAS ?= all,rl-games,sample-factory
else
CONSTRAINTS ?= constraints-numpy2.txt
EXTRAS ?= all
endif

# Compiled once: without this, where bytecode is not to be written, each process compiles PyTorch anew, which takes 7 s.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo docs test test-slow browser view-test view-pictures firmware-tools package golden golden-update kill-test fuzz undeclared lint format clean
setup: .venv/ready

.venv/ready: pyproject.toml $(CONSTRAINTS)
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q --no-compile -c $(CONSTRAINTS) -e ".[$(EXTRAS)]"
	touch $@

demo: setup
	$(BIN)/aerial-gym demo --out out/demo

# The documentation site, with the generated reference: open site/index.html. Needs no network.
docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build

test: setup
	$(BIN)/python -m pytest -n auto --dist worksteal

test-slow: setup
	$(BIN)/python -m pytest -m slow

# Debian's Chromium and Playwright for tests/browser; Playwright downloads no browser of its own.
SUDO := $(if $(filter 0,$(shell id -u)),,sudo)
browser: setup
	command -v chromium > /dev/null || { $(SUDO) apt-get update && $(SUDO) apt-get install -y --no-install-recommends chromium fonts-dejavu-core; }
	$(BIN)/python -m pip install -q --no-compile -c $(CONSTRAINTS) -e ".[browser]"

# Pages and the viewer in a headless Chromium, which `make browser` installs; without it the tests skip.
view-test: setup
	$(BIN)/python -m pytest -m slow -rs tests/browser

# Pictures of the viewer in docs/images, by the same browser.
view-pictures: setup
	$(BIN)/python -m tests.browser.pictures

# Engines that fly exported policies, for tests/slow and export --to tflm: a compiler and an emulator of the Crazyflie's
# processor; TensorFlow Lite Micro and RLtools, in an environment of their own.
ENGINES := $(or $(XDG_CACHE_HOME),$(HOME)/.cache)/aerial_gym/engines
firmware-tools: setup
	command -v arm-none-eabi-gcc > /dev/null && command -v qemu-system-arm > /dev/null || { $(SUDO) apt-get update && \
		$(SUDO) apt-get install -y --no-install-recommends gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm; }
	test -x $(ENGINES)/bin/python || $(PYTHON) -m venv $(ENGINES)
	$(ENGINES)/bin/python -m pip install -q --no-compile tflite-micro==0.dev20261023182759
	$(ENGINES)/bin/python -m pip install -q --no-compile --no-deps rltools==2.2.1

# Wheel and source archive in dist/, tried in new environments of each Python that is here: minutes each, and PyTorch's
# gigabytes where its CPU build is not at hand. PYTHONS selects some, such as python3.12.
PYTHONS ?=
package: setup
	rm -rf dist build
	$(BIN)/python -m build
	$(BIN)/python -m tests.package_smoke $(PYTHONS)

# Minutes: compares results of the whole package with tests/golden/reference. TOPICS: interface releases cases tasks.
TOPICS ?=
golden: setup
	$(BIN)/python -m tests.golden $(TOPICS)

golden-update: setup
	$(BIN)/python -m tests.golden $(TOPICS) --update

# A quarter of an hour: trainings killed at random moments, each of which must go on.
KILLS ?= 50
kill-test: setup
	$(BIN)/python -m benchmarks.robustness.kill_runs --count $(KILLS)

# Minutes: mutated robots, environments, tasks, logs, meshes, checkpoints; each must work or be refused in one sentence. KIND=log
# takes the logs of all formats only, within 1 s and 1 GB each.
FUZZ ?= 5000
KIND ?=
SEED ?= 0
fuzz: setup
	$(BIN)/python -m benchmarks.robustness.fuzz --count $(FUZZ) --seed $(SEED) $(if $(KIND),--only $(KIND))

# Hours: every effect, size and seed that the truth plant can hide. Interrupt and start again at will; SEEDS, JOBS and ARGS
# (such as --nuisance) may be given.
SEEDS ?= 301 302 303
JOBS ?= $(shell nproc)
PAIRS := com_offset+constant_wind thrust_coefficient+motor_time_constant weak_motor+rotor_drag payload_mass+actuation_delay \
	ground_effect+battery_sag imu_bias+quadratic_drag rotor_inertia+motor_time_constant torque_ratio+rotor_drag+com_offset \
	thrust_coefficient+rotor_drag+com_offset+motor_time_constant
undeclared: setup
	$(BIN)/python -m benchmarks.scores.score_undeclared --effects all --sizes small moderate large --unknown --hover --pairs $(PAIRS) \
		--seeds $(SEEDS) --jobs $(JOBS) --out out/undeclared $(ARGS)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf .venv out runs site train_dir build *.egg-info
