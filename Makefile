# goniod: `make demo` measures a simulated sample, `make test` proves everything. Both set up what they need.

SHELL := /bin/bash
GONIOD := target/debug/goniod
FEATURES ?= --all-features
RUNS ?= runs/demo

PROGRAM ?= target/release/goniod

.PHONY: demo test hil check setup setup-python build release install validate bench soak soak-cameras soak-devices clean

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
	cargo clippy --workspace --all-targets $(FEATURES) -- -D warnings

## Simulated samples through the whole chain: the table of what came back.
validate: setup
	cargo test $(FEATURES) --test validate -- --nocapture

## Ratios of the pixel pass against a plain implementation, in the same process.
bench: setup
	cargo bench --profile dev $(FEATURES)

## Both camera drivers against their twins with the full counts (docs/cameras.md), about 20 minutes of a quiet machine.
soak-cameras: setup setup-python
	GONIOD_FULL=1 cargo test -p goniod-drivers $(FEATURES) --test v4l2 -- --nocapture
	GONIOD_FULL=1 cargo test -p goniod-sim $(FEATURES) --test gige -- --nocapture

## Every driver on its twin with the full counts (docs/devices.md): 10,000 random commands each, 1,000,000 noisy exchanges over all.
soak-devices: setup
	GONIOD_FULL=1 cargo test -p goniod-sim $(FEATURES) --test conformance -- --nocapture

## Two thousand nights with faults, where CI runs two hundred.
soak: setup
	GONIOD_NIGHTS=2000 cargo test $(FEATURES) --test night -- --nocapture

build: setup
	cargo build $(FEATURES)

release: setup
	cargo build --release $(FEATURES)

## Program, units, rules and documents where Debian looks for them; `DESTDIR=…` for a package. See docs/installing.md.
install:
	install -D -m 755 $(PROGRAM) $(DESTDIR)/usr/bin/goniod
	install -D -m 644 -t $(DESTDIR)/usr/lib/systemd/system systemd/*.service
	install -D -m 644 systemd/sysusers.conf $(DESTDIR)/usr/lib/sysusers.d/goniod.conf
	install -D -m 644 systemd/tmpfiles.conf $(DESTDIR)/usr/lib/tmpfiles.d/goniod.conf
	install -D -m 644 systemd/sysctl.conf $(DESTDIR)/usr/lib/sysctl.d/60-goniod.conf
	install -D -m 644 -t $(DESTDIR)/usr/lib/udev/rules.d systemd/70-goniod.rules
	install -D -m 644 -t $(DESTDIR)/usr/share/doc/goniod docs/*.md
	mkdir -p $(DESTDIR)/usr/share/goniod
	cp -r --no-preserve=ownership config $(DESTDIR)/usr/share/goniod

setup:
	bash tests/setup.sh packages

setup-python:
	bash tests/setup.sh python

clean:
	cargo clean
	rm -rf .venv runs
