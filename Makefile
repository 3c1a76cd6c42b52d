# make demo [PORT=8100] | test | soak | flaky [N=20] | coverage | setup | bench | check | docs | release | screenshots | lock | clean
PYTHON ?= python3
N ?= 20
VENV := .venv
BIN := $(VENV)/bin
VENDOR := static/vendor/made-from.sha256
CHROMIUM := /usr/bin/chromium-headless-shell
# ser2net is the device server of tests/campaign, libfaketime moves its clocks, mosquitto is the broker of the plant;
# the rest is what these need.
PROXY_PACKAGES := nginx caddy ser2net libgensio4 libsctp1 libwrap0 libyaml-0-2 libfaketime mosquitto libcjson1 libdlt2
PROXIES := $(VENV)/proxies/.unpacked-$(words $(PROXY_PACKAGES))
POSTGRESQL := $(VENV)/.postgresql
NODE_TOOLS := node_modules/.package-lock.json
COVERAGE := COVERAGE_RCFILE=tests/coverage.toml $(BIN)/coverage
# A lock is complete: what its packages need has a row of its own.
INSTALL := install --disable-pip-version-check -q --no-deps --no-compile
# uv takes a third of the work of pip. Where it has no index, as pip alone is told of one, pip installs.
INSTALL_LOCK = { test -x $(BIN)/uv && $(BIN)/uv pip install -q --python $(BIN)/python --no-deps --require-hashes -r $(1); } \
	|| $(BIN)/python -m pip $(INSTALL) --require-hashes -r $(1)
LOCK := $(BIN)/uv pip compile -q --upgrade --universal --python-version 3.11 --generate-hashes \
	--custom-compile-command "make lock" --extra rfc2217

.PHONY: demo free-port test all-tests script-tests browser-tests soak flaky coverage setup bench check docs release screenshots lock clean development tools
.DEFAULT_GOAL := demo
# Without its cache of compiled modules, each of hundreds of processes in the tests compiles the whole program.
unexport PYTHONDONTWRITEBYTECODE

demo: free-port setup
	$(BIN)/lineside demo $(if $(PORT),--port $(PORT))

# Before everything that a first set-up takes: whether a port that was chosen has another program. What else may be
# wrong of it, `lineside demo` states. Without a choice it takes 8000, or the next that is free.
free-port:
	@case "$(PORT)" in *[!0-9]*) echo "PORT=$(PORT) is no number. Example: make demo PORT=8100" >&2; exit 1;; esac
	@test -z "$(PORT)" || $(PYTHON) -c 'import socket, sys; sys.exit(3 * (socket.socket().connect_ex(("127.0.0.1", $(PORT))) == 0))' 2>/dev/null || \
		test $$? -ne 3 || { echo "Port $(PORT) is in use. End the program that has it, or choose another: make demo PORT=8100" >&2; exit 1; }

setup: $(VENV)/.lineside

# All at once, each with its output in one piece. The modules are compiled once, and not by each of the processes
# that begin together. There are more processes of tests than cores, because much of their time is a wait for a line or
# a page; still more only get in each other's way.
test: development
	$(BIN)/python -m compileall -q app bus
	$(MAKE) --no-print-directory --jobs=3 --keep-going --output-sync=target all-tests script-tests check

all-tests: development
	$(BIN)/pytest --processes 2+4+2 tests

script-tests: development
	node --test tests/js/*.test.js

browser-tests: development
	$(BIN)/pytest --processes 2 tests/e2e

# What takes long, alone on the machine: it measures. Then each property with many random examples. 56 minutes.
soak: development
	$(BIN)/python -m tests.soak

# The browser tests N times: how often each failed.
flaky: development
	$(BIN)/python -m tests.flaky $(N) --processes 3 tests/e2e

# Every line and branch of the pure modules, each by its own tests, and 90 % of all the rest.
coverage: development
	$(BIN)/python -m tests.covered
	$(COVERAGE) run -m pytest -q --processes 2 --ignore tests/e2e
	$(COVERAGE) combine --quiet
	$(COVERAGE) report

bench: development
	$(BIN)/python -m benchmarks

# The handbook as files for a web server or a stick: build/docs/index.html.
docs: setup
	$(BIN)/python -m docs.site build/docs

# What people install, in build/release: source archive, wheel, Debian package, bundle for machines without a network,
# list of parts, checksums.
release: development
	$(BIN)/python -m release build/release

screenshots: development
	$(BIN)/python -m docs.screenshots

check: development
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/djlint templates --lint --quiet
	node_modules/.bin/biome lint static/js static/css tests/js
	node_modules/.bin/tsc
	node_modules/.bin/tsc --project types/worker

# At the same time what does not need each other. Those with apt-get follow each other, as it has a lock.
development:
	@$(MAKE) --no-print-directory $(if $(findstring -j,$(MAKEFLAGS)),,--jobs=4) tools

tools: $(NODE_TOOLS) $(VENV)/.lineside $(VENV)/.development $(PROXIES)
	@:

# The locks are exact and carry a hash for every file. requirements.lock is what runs, and hatchling. What runs
# is tested with the tools beside it, so it takes the versions that they leave. npm touches the stamp of $(NODE_TOOLS)
# though it installs nothing: the lock is made newer than that.
lock: development
	$(LOCK) --extra apprise --extra mqtt --extra oidc --extra opcua --extra parquet --extra postgresql --group build --group dev pyproject.toml -o requirements-dev.lock
	$(LOCK) --group build -c requirements-dev.lock pyproject.toml -o requirements.lock
	npm install --package-lock-only --ignore-scripts --omit-lockfile-registry-resolved
	@touch package-lock.json

clean:
	rm -rf $(VENV) node_modules static/vendor dist build

# Each stamp is newer than what it was made from, so that a second run does nothing. The first package is the pip of the
# lock, which takes half as long for the others as one of 2023; the environment has another where Python has none to
# install it with. Modules are compiled when they are first imported, which two of three never are.
$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Lineside needs Python 3.11 or newer; this is " + sys.version.split()[0] + ". Set PYTHON=/path/to/python3.11.")'
	$(PYTHON) -m venv --without-pip $(VENV)
	@awk '/^[^ ]/ { wanted = /^pip==/ } wanted' requirements.lock >$(VENV)/pip.lock
	@$(PYTHON) -m pip --python $(BIN)/python $(INSTALL) --require-hashes -r $(VENV)/pip.lock 2>/dev/null || $(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.runtime: requirements.lock $(VENV)/.python
	$(call INSTALL_LOCK,requirements.lock)
	@touch $@

# Whoever only runs the program does without it.
$(VENV)/.uv: requirements-dev.lock $(VENV)/.python
	@awk '/^[^ ]/ { wanted = /^uv==/ } wanted' requirements-dev.lock >$(VENV)/uv.lock
	$(BIN)/python -m pip $(INSTALL) --require-hashes -r $(VENV)/uv.lock
	@touch $@

ifneq ($(filter tools,$(MAKECMDGOALS)),)
$(VENV)/.runtime: | $(VENV)/.uv
endif

$(VENDOR): package.json package-lock.json hatch_build.py $(VENV)/.runtime
	$(BIN)/python hatch_build.py
	@touch $@

$(VENV)/.lineside: pyproject.toml $(VENDOR)
	$(BIN)/python -m pip $(INSTALL) --no-build-isolation -e .
	@touch $@

$(VENV)/.development: requirements-dev.lock $(VENV)/.runtime
	$(call INSTALL_LOCK,requirements-dev.lock)
	@touch $@

$(NODE_TOOLS): package.json package-lock.json
	npm ci --ignore-scripts --no-audit --no-fund
	@touch $@

$(CHROMIUM):
	@test "$$(id -u)" = 0 || { echo "The browser tests need Chromium: as root, apt-get install chromium-headless-shell, then run this again." >&2; exit 1; }
	apt-get update && apt-get install --yes --no-install-recommends chromium-headless-shell

# Proxies for the tests of docs/tls.md and docs/deploy, and a device server: unpacked, not installed, which would start
# them. Where the packages cannot be had, those tests are skipped.
$(PROXIES): $(POSTGRESQL)
	@mkdir -p $(@D)
	@cd $(@D) && { apt-get download -qq $(PROXY_PACKAGES) 2>/dev/null || for name in $(PROXY_PACKAGES); do \
		apt-get download -qq $$name 2>/dev/null || echo "$$name cannot be downloaded" >&2; \
	done; }; for package in *.deb; do test -e $$package && dpkg-deb -x $$package . && rm $$package; done; true
	@touch $@

# PostgreSQL for the tests of the store, which start their own. Nothing else is started: no cluster is made. Where it
# cannot be had, those tests are skipped.
$(POSTGRESQL): $(VENV)/.python | $(CHROMIUM)
	@ls /usr/lib/postgresql/*/bin/postgres >/dev/null 2>&1 || { \
		mkdir -p /etc/postgresql-common && \
		echo "create_main_cluster = false" >/etc/postgresql-common/createcluster.conf && \
		apt-get update -qq && DEBIAN_FRONTEND=noninteractive UCF_FORCE_CONFFOLD=1 \
			apt-get install --yes --no-install-recommends postgresql; \
	} || echo "PostgreSQL cannot be installed; as root, apt-get install postgresql. Its tests are skipped." >&2
	@touch $@
