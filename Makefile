# The commands of this project. `make race` and `make test` need only Python 3.10 or newer, make
# and, for the game's data, apt (Debian, Ubuntu) or a network connection. A compiler is installed
# by root on Debian and Ubuntu.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
# What pip installs before the other libraries.
TORCH ?= torch==2.13.0
# Runs on all cores; an idle core takes over tests from a busy one.
PYTEST := $(BIN)/python -m pytest -n auto --dist worksteal --durations=25
# The tests start hundreds of programs, which start faster with cached bytecode.
unexport PYTHONDONTWRITEBYTECODE

C_SOURCES := setup.py $(wildcard stkzoo/kernel/*.[ch] stkzoo/engine/*.c agents/planning/*.[ch])
GRAPHICS_PACKAGES := libegl1 libgl1 libgl1-mesa-dri xvfb
BROWSER_PACKAGES := chromium chromium-driver
# $(call apt_install,PACKAGES): updates the package lists only if the first attempt fails.
apt_install = { apt-get install -y -q $(1) >/dev/null 2>&1 || \
	{ apt-get update -q && apt-get install -y -q $(1); }; }

# Text for readers, checked for typos and for words to avoid.
PROSE := README.md CHANGELOG.md CONTRIBUTING.md docs stkzoo wrappers agents examples benchmarks

.PHONY: browser compiler data engine graphics sandbox help race test test-fast test-lowest test-all sanitize check bench docs pictures release check-release clean

help:
	@echo "make race    set everything up; a learned driver races the hardest bots"
	@echo "make test    set everything up and run the tests: one case of each kind, 12 minutes"
	@echo "make test-fast  the quick tests: every package, two minutes"
	@echo "make test-lowest  the quick tests with the oldest libraries that pyproject.toml allows"
	@echo "make test-all  the tests with all cases of each kind"
	@echo "make sanitize  the kernel's tests under AddressSanitizer and UBSan (gcc, Linux)"
	@echo "make check   lint, format, types and spelling"
	@echo "make bench   measure speed and memory"
	@echo "make pictures  draw the tracks and charts of the documentation again"
	@echo "make docs    build the documentation's pages; the tests run their examples"
	@echo "make release  build and check the wheel and the source distribution, in the folder dist"
	@echo "make clean   remove what was built here; the game's data stays"

race: $(VENV)/.core engine
	$(BIN)/stkzoo assets install
	$(BIN)/stkzoo race --demo

# Per commit: one case of each kind. pyproject.toml describes the markers.
test: data $(VENV)/.dev graphics browser sandbox
	$(PYTEST) -m "not matrix" $(ARGS)

# Tests every package with the real engine, in two minutes on two cores.
test-fast: data $(VENV)/.dev
	$(PYTEST) -m "not slow and not matrix" $(ARGS)

# Old libraries warn about newer versions of libraries that they use.
test-lowest:
	$(PYTHON) -m venv build/uv
	build/uv/bin/python -m pip install --quiet uv
	build/uv/bin/uv pip compile --quiet --resolution lowest-direct --python $$(command -v $(PYTHON)) \
		--extra all --group dev --output-file build/lowest.txt pyproject.toml
	PIP_CONSTRAINT=$(CURDIR)/build/lowest.txt $(MAKE) VENV=build/lowest TORCH=torch \
		ARGS="-W ignore::DeprecationWarning" test-fast

# Every night: all cases.
test-all: data $(VENV)/.dev graphics browser sandbox
	$(PYTEST) $(ARGS)

# Builds the C extensions with checks of addresses, alignment and undefined behavior, in a copy of this
# checkout. An invalid access ends its process, also if that is a game process, so the test fails.
# PYTHONMALLOC=malloc allocates each object separately, so that the checks see its bounds. Leaks are
# not reported, because Python and NumPy never free some memory.
SANITIZED := build/sanitize
SANITIZERS := -O1 -g -fno-omit-frame-pointer -fno-sanitize-recover=all \
	-fsanitize=address,undefined,float-cast-overflow
ODD_VALUES := $(addprefix tests/chaos/test_properties.py::test_any_,\
	actions_are_accepted_or_leave_the_race_unchanged action_of_any_view_is_accepted_or_refused \
	batch_of_actions_is_accepted_or_refused)
SANITIZED_TESTS := tests/kernel tests/agents/planning tests/drivers/test_messages.py tests/env/test_parallel.py \
	tests/env/test_events.py tests/env/test_vec.py tests/wrappers/test_chain.py $(ODD_VALUES)

sanitize: $(VENV)/.dev
	$(BIN)/stkzoo assets install
	rm -rf $(SANITIZED) && mkdir -p $(SANITIZED)
	git ls-files -z --cached --others --exclude-standard | \
		xargs -0 cp --no-dereference --parents --target-directory $(SANITIZED)
	cd $(SANITIZED) && CC=gcc CFLAGS="$(SANITIZERS)" $(CURDIR)/$(BIN)/python setup.py -q build_ext --inplace
	cd $(SANITIZED) && \
		LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libstdc++.so)" \
		ASAN_OPTIONS=detect_leaks=0:alloc_dealloc_mismatch=0:allocator_may_return_null=1:max_allocation_size_mb=4096 \
		UBSAN_OPTIONS=print_stacktrace=1 PYTHONMALLOC=malloc PYTHONPATH=$(CURDIR)/$(SANITIZED) \
		$(CURDIR)/$(BIN)/python -m pytest -p no:cacheprovider --capture=sys $(or $(ARGS),$(SANITIZED_TESTS))

check: $(VENV)/.dev
	! git grep -nE '^(<{7}|>{7}) '
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell --builtin clear,rare,en-GB_to_en-US --dictionary - --dictionary .codespell.txt $(PROSE)
	$(BIN)/mypy

bench: $(VENV)/.dev
	$(BIN)/stkzoo assets install
	$(BIN)/python -m benchmarks.steps $(ARGS)
	$(BIN)/python -m benchmarks.learners $(ARGS)

# The pictures are in the repository; draw them again after a change to the map or the results.
pictures: $(VENV)/.dev
	$(BIN)/stkzoo assets install
	$(BIN)/python docs/_extensions/track_atlas.py
	$(BIN)/python docs/_extensions/gallery.py
	$(BIN)/python docs/_extensions/charts.py
	$(BIN)/python docs/_extensions/suite_page.py

# Builds the documentation in the folder site; fails on any warning or broken link. The pages of the
# views need the game's data.
docs: $(VENV)/.docs
	$(BIN)/stkzoo assets install
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs site
	@echo "open site/index.html"

# Builds everything that a release uploads and this machine can build: the source distribution and, from
# it, a wheel for each interpreter in PYTHONS. The workflow release.yml builds wheels for other systems.
PYTHONS ?= $(PYTHON)
RELEASE_TOOLS := PATH="$(abspath $(BIN)):$$PATH"
release: $(VENV)/.release | compiler
	rm -rf dist build/wheels
	$(BIN)/uv build --quiet --sdist --out-dir dist .
	for python in $(PYTHONS); do $(BIN)/uv build --quiet --wheel \
		--python "$$(command -v $$python)" --out-dir build/wheels dist/*.tar.gz || exit 1; done
	if [ -z "$(PYTHONS)" ]; then :; \
	elif [ "$$(uname)" = Linux ]; then \
		$(RELEASE_TOOLS) auditwheel repair --strip --wheel-dir dist build/wheels/*.whl; \
	else cp build/wheels/*.whl dist; fi
	$(MAKE) check-release

# The weights of the learned drivers take 4.1 MB of each file.
check-release: $(VENV)/.release
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist
	@large=$$(find dist -name '*.whl' -size +5300k -o -name '*.tar.gz' -size +5900k); \
	[ -z "$$large" ] || { ls -l $$large; echo "too large: at most 5.3 and 5.9 MB"; exit 1; }
	@ls -l dist

# The extensions need a C compiler and the headers of Python, which minimal systems do not have.
compiler:
	@include=$$($(PYTHON) -c 'import sysconfig; print(sysconfig.get_path("include"))'); \
	packages="gcc libc6-dev"; \
	[ -e "$$include/Python.h" ] || packages="$$packages $$($(PYTHON) -c \
		'import sys; print("python%d.%d-dev" % sys.version_info[:2])')"; \
	if echo '#include <Python.h>' | $(CC) -fsyntax-only -I"$$include" -x c - 2>/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		$(call apt_install,--no-install-recommends $$packages); \
	else \
		echo "stkzoo needs a C compiler and Python's headers: sudo apt install $$packages" \
			"(Fedora: sudo dnf install gcc python3-devel)"; \
		exit 1; \
	fi

# Fetches the game's data while pip installs torch.
data: engine
	@$(BIN)/stkzoo assets install & fetching=$$!; $(MAKE) $(VENV)/.torch && wait $$fetching

# The engine needs glib 2 (libglib-2.0.so.0), which minimal systems do not have.
engine: $(VENV)/.core
	@if $(BIN)/python -c "import pystk2" 2>/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		$(call apt_install,libglib2.0-0); \
	else \
		$(BIN)/python -c "import pystk2"; \
		echo "if this is glib: sudo apt install libglib2.0-0 (Fedora: sudo dnf install glib2)"; \
		exit 1; \
	fi

# The game renders off-screen with these libraries, and the tests open its window in Xvfb. If they
# cannot be installed, stkzoo draws the map instead, and the tests expect that.
graphics:
	@if PATH="$$PATH:/usr/sbin:/sbin" ldconfig -p 2>/dev/null | grep -q 'libEGL\.so' && \
		ls /usr/lib/*/dri/*_dri.so /usr/lib64/dri/*_dri.so /usr/lib/*/libnvidia-eglcore* \
		2>/dev/null | grep -q . && command -v Xvfb >/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		$(call apt_install,$(GRAPHICS_PACKAGES)) || \
		echo "the game's own pictures cannot be drawn here; the map is drawn instead"; \
	else \
		echo "for the game's own pictures and window: sudo apt install $(GRAPHICS_PACKAGES)"; \
	fi

# Tests of the live page use this browser. They are skipped if it cannot be installed.
browser:
	@if command -v chromedriver >/dev/null && \
		{ command -v chromium || command -v google-chrome; } >/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		$(call apt_install,$(BROWSER_PACKAGES)) || \
		echo "no browser is available; tests of the live page are skipped"; \
	else \
		echo "to try the live page in a browser: sudo apt install $(BROWSER_PACKAGES)"; \
	fi

# Agents race in bubblewrap's sandbox. Its tests are skipped if it cannot be installed.
sandbox:
	@if command -v bwrap >/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		$(call apt_install,bubblewrap) || \
		echo "bubblewrap is not available; tests of the sandbox are skipped"; \
	else \
		echo "to test the sandbox for agents: sudo apt install bubblewrap"; \
	fi

clean:
	rm -rf $(VENV) build dist site jupyter_execute .ecosystem *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# If the system has no pip (a bare Debian or Ubuntu), the apt client downloads it into the
# environment; nothing is installed outside the environment.
$(VENV)/.made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { \
		echo "stkzoo needs Python 3.10 or newer: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	@if $(BIN)/python -m pip --version >/dev/null 2>&1; then \
		echo "using the environment in $(VENV)"; \
	elif $(PYTHON) -c 'import ensurepip, venv' 2>/dev/null; then \
		$(PYTHON) -m venv $(VENV); \
	elif $(PYTHON) -c 'import virtualenv' 2>/dev/null; then \
		$(PYTHON) -m virtualenv --quiet $(VENV); \
	elif $(PYTHON) -c 'import venv' 2>/dev/null && command -v apt-get >/dev/null; then \
		$(PYTHON) -m venv --without-pip $(VENV) && $(fetch_pip); \
	else \
		echo "$(PYTHON) has neither venv nor virtualenv. On Debian and Ubuntu:" \
			"sudo apt install python3-venv"; exit 1; \
	fi
	@touch $@

define fetch_pip
cd $(VENV) && mkdir -p apt/lists/partial apt/cache/archives/partial && cd apt && \
{ apt-get -q download python3-pip-whl 2>/dev/null || { \
	options="-o Dir::State=$$PWD -o Dir::State::lists=$$PWD/lists \
		-o Dir::State::status=/var/lib/dpkg/status -o Dir::Cache=$$PWD/cache \
		-o Dir::Cache::archives=$$PWD/cache/archives -o APT::Sandbox::User=root"; \
	apt-get -q $$options update; apt-get -q $$options download python3-pip-whl; }; } && \
dpkg-deb -x python3-pip-whl_*.deb . && \
wheel=$$(echo usr/share/python-wheels/pip-*.whl) && \
../bin/python $$wheel/pip install --quiet --no-warn-script-location --no-index $$wheel && cd .. && rm -rf apt || { \
	echo "pip is not available. On Debian and Ubuntu: sudo apt install python3-venv"; exit 1; }
endef

# Builds the extensions again if their sources have changed.
$(VENV)/.core: $(VENV)/.made pyproject.toml $(C_SOURCES) | compiler
	$(PIP) install --quiet --editable .
	@touch $@

# Installed first and separately, so that pip's settings determine its build.
$(VENV)/.torch: $(VENV)/.core
	$(PIP) install --quiet $(TORCH)
	@touch $@

# The pip of Debian 12 is too old for dependency groups.
$(VENV)/.release: $(VENV)/.made pyproject.toml
	$(PIP) install --quiet 'pip>=25.1'
	$(PIP) install --quiet --group release
	@touch $@

$(VENV)/.dev: $(VENV)/.core $(VENV)/.torch $(VENV)/.release pyproject.toml
	$(PIP) install --quiet --editable '.[all]' --group dev
	@touch $@

$(VENV)/.docs: $(VENV)/.dev pyproject.toml
	$(PIP) install --quiet --group docs
	@touch $@
