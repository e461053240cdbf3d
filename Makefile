# goniod: `make demo` measures a simulated sample, `make test` proves everything. Both set up what they need.

SHELL := /bin/bash
GONIOD := target/debug/goniod
RUNS ?= runs/demo

.PHONY: demo test check setup setup-python build validate bench soak clean

## Measure a simulated sample and show where the products are.
demo: build
	$(GONIOD) rehearse config/scans/demo.toml --instrument config/instrument.sim.toml --runs $(RUNS)

## All tests, as CI runs them.
test: setup setup-python
	bash tests/run.sh

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

## Two thousand nights with faults, where CI runs two hundred.
soak: setup
	GONIOD_NIGHTS=2000 cargo test --test night -- --nocapture

build: setup
	cargo build

setup:
	bash tests/setup.sh packages

setup-python:
	bash tests/setup.sh python

clean:
	cargo clean
	rm -rf .venv runs
