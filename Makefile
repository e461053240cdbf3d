# goniod: `make demo` measures a simulated sample, `make test` proves everything. Both set up what they need.

SHELL := /bin/bash
GONIOD := target/debug/goniod
RUNS ?= runs/demo

.PHONY: demo test hil check setup setup-python build validate bench clean

## Measure a simulated sample and show where the products are.
demo: build
	$(GONIOD) rehearse config/scans/demo.toml --instrument config/instrument.sim.toml --runs $(RUNS)

## All tests, as CI runs them.
test: setup setup-python
	bash tests/run.sh

## The drivers against real kernel interfaces in an emulated machine.
hil: setup
	bash tests/hil/run $(SUBJECTS)

## Formatting and lints.
check: setup
	cargo fmt --all -- --check
	cargo clippy --workspace --all-targets -- -D warnings

## Simulated samples through the whole chain: the table of what came back.
validate: setup
	cargo test --test validate -- --nocapture

## Ratios of the pixel pass against a plain implementation, in the same process.
bench: setup
	cargo bench --profile dev

build: setup
	cargo build

setup:
	bash tests/setup.sh packages

setup-python:
	bash tests/setup.sh python

clean:
	cargo clean
	rm -rf .venv runs
