# Common tasks. Everything is built into .venv, build and target; nothing else is touched.
#
#   make demo        install glimt into .venv and render the scenes to out/
#   make test        formatting, lints and all tests but the long ones
#   make test-rust   those of them that need Rust and a C++ compiler only
#   make test-long   the long ones
#   make fuzz        every reader on hostile bytes, for a minute or two (fuzz/run runs for longer)
#   make package     what crates.io and PyPI would be given, and whether they would take it; needs a clean checkout
#   make clean       delete what the others made

.DEFAULT_GOAL := demo
.PHONY: demo install lint test test-rust test-long fuzz package clean

PYTHON ?= python3
VENV := $(CURDIR)/.venv
export PATH := $(VENV)/bin:$(PATH)
# One directory for all of Cargo's work, so that nothing is compiled twice.
CARGO_TARGET_DIR ?= $(CURDIR)/target
override CARGO_TARGET_DIR := $(abspath $(CARGO_TARGET_DIR))
export CARGO_TARGET_DIR

# Published measurements and networks, which are not part of the project. Tests that read them are ignored; where
# they are, `make test` runs them by their name.
REFERENCE_DATA := $(wildcard ../shared/data)

SOURCES := Cargo.toml Cargo.lock CMakeLists.txt pyproject.toml \
           $(shell find plugin rust -name '*.rs' -o -name '*.toml' -o -name '*.h' -o -name '*.cpp' \
                   -o -name '*.py' -o -name '*.map')

$(VENV)/.requirements: .ci/requirements.txt .ci/setup
	bash .ci/setup
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check -r .ci/requirements.txt
	touch $@

$(VENV)/.glimt: $(VENV)/.requirements $(SOURCES)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --no-build-isolation \
	    -C cmake.define.GLIMT_WERROR=ON -C cmake.define.GLIMT_CARGO_TARGET_DIR=$(CARGO_TARGET_DIR) .
	touch $@

install: $(VENV)/.glimt

demo: install
	python scenes/render.py

lint: $(VENV)/.requirements
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked -- -D warnings
	cargo update --quiet --workspace --locked --manifest-path fuzz/Cargo.toml
	ruff check .
	ruff format --check .

test-rust:
	cargo test --workspace --locked
ifneq ($(REFERENCE_DATA),)
	cargo test --workspace --locked -- --ignored reference_data
endif

test: install
	$(MAKE) lint
	$(MAKE) test-rust
	python -m pytest

test-long: install
	cargo test --workspace --locked --release -- --ignored $(if $(REFERENCE_DATA),,--skip reference_data)
	python -m pytest -m long

fuzz:
	bash fuzz/run all 100000

package: $(VENV)/.requirements
	cargo package --workspace --locked --no-verify
	rm -rf out/dist
	python -m build --sdist --no-isolation --skip-dependency-check --outdir out/dist .
	twine check --strict out/dist/*

clean:
	rm -rf $(VENV) build out target
