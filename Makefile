# make run    everything from a clean clone: fetch, build, and run the demonstration (ARGS=--exit ends it after the table)
# make test   every test: Rust, page in a headless Chromium, clients that others wrote; prints how many ran
# make test-long   those tests, too, that take minutes each: rates of discovery, every law of nature; not run whole yet
# make laws   every law of nature of the validation suite, those that take minutes too: a quarter of an hour
# make bench-peers   the simulator's speed beside other simulators', which it installs (python3.11, PyPI)
# make bench-learner   the learner's speed beside Stable-Baselines3's, which it installs (python3, PyPI)
# make calibration-report   the published method and ours on the five powders, twenty minutes on two cores
# make training-report   trains ours and the four published orders, and weighs with all; hours, stop it and call it again (EPISODES=4000)
# make discovery-report   effects hidden in data, hundreds of them, and the table of what was found; hours, stop it and call it again (NULLS=70 EFFECTS=10 WHOLE=10; ONLY=spoon POWDERS=4)
# make weighing-gain   a version of the simulator from hidden data, and policies adapted to it, weighing: hours on two cores, stop it and call it again (SEEDS=6; DEVICE=cuda on a graphics card)
# make reliability   every fault of every emulated device at every state of a weighing, 300 kills on each database, a minute of fuzzing for each parser: two hours or more, most of it kills
# make bench-stop    how soon a stop makes the arm stand still while a hundred clients poll, and while others do their worst (ARGS="-- 200 100 1 none messages silent readers pollers streams lock all")
# make bench-workers   one job on 1, 2 and 4 workers with a private PostgreSQL, beside the ideal; its investigation takes a quarter of an hour on one worker and needs the calibration before it (ARGS="3 100 1,2,4 calibration,evaluation": repeats, size in %, workers, jobs; FLIP_POSTGRES_BIN=folder of initdb)
# make cluster    PostgreSQL, two servers and two workers on this machine: the demonstration with a worker and a server killed in the middle, beside one process alone: forty minutes (ARGS='--episodes 40')
# make bench-database   what one PostgreSQL carries: jobs, events and records of doses a second, and answers of three servers (ARGS="30 300 10000": seconds, requests a second, queued jobs)
# make faults     mixed jobs while workers, servers and PostgreSQL are killed, restarted and stopped, the network is cut, the disk fills up and clocks are set: an hour or two (ARGS='10 2': 10 % of the faults, seed)
# make gpu-report   a graphics card beside this machine's cores: speed, repeatability, equivalence, heaps, a million launches, what binds, updates of the learner, laws of nature, doses, a training on both, an emulator, new powders, the demonstration, the published experiment with both networks, the weighing gain: three quarters of an hour and a training on the cores, stop it and call it again; without a card it says so (ARGS='speed heaps': parts of it; ARGS=--again; DATA=folder; PROGRAMS=folder of programs built elsewhere)
# make published-experiment   four orders, five seeds, 4000 episodes each, in the simulator on a graphics card, and doses with all policies: a quarter of an hour, stop it and call it again (STUDY=feed-forward ARGS=seconds=600)
# make slim       the program without training and libtorch, and the Python wheel: their sizes
# make page-report   the page among 100 000 weighings and 10 000 jobs: times, bytes sent, long tasks (WEIGHINGS=100000 JOBS=10000 REPEATS=20)
# make pictures   the pictures of the page in README and docs, of doses it has weighed on the emulated bench: about five minutes
# make docs   the documentation as pages, which the service shows below /docs; checks links, spelling and style · make docs-reference   the generated ones, from the built binary
# make stale   results in docs that are older than the code they speak of
# make proto  the gRPC contract: buf's lint, and nothing that breaks a client of the last tag
# make dist   a tarball and a Debian package that run without Rust, Python or network, each started in an empty root
# make check  what is wrong without running a test: format, clippy, licences, repeated blocks, and the README's own commands · make tidy   without clippy, as the gate
# make web    the page alone · make bench   the hot loops · make lint   make check's first half and the code's documentation

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.ONESHELL:
.PHONY: run test test-long laws setup need web docs docs-reference stale chromium postgres faketime bench bench-peers bench-learner calibration-report training-report discovery-report weighing-gain reliability bench-stop bench-workers bench-database cluster faults gpu-report published-experiment on-a-card slim page-report pictures proto dist lint check tidy

ARGS ?=
DOCS_SOURCES := $(shell find docs web/docs -name node_modules -prune -o -type f -print 2>/dev/null)
# Without what tests and the build itself write: a page that seems older is built again, and then the service.
WEB_SOURCES := $(shell find web -name node_modules -prune -o -name dist -prune -o -path web/docs -prune -o -path web/tests -prune -o -name docs-dist -prune -o -name schema.d.ts -prune -o -type f -print 2>/dev/null)

run: setup
	cargo build --release --locked
	exec cargo run --quiet --release --locked -- demo $(ARGS)

test: setup chromium postgres
	python3 .ci/tests.py

test-long: setup chromium postgres
	FLIP_LONG=1 python3 .ci/tests.py

laws: setup
	cargo test --locked --test physics -- --include-ignored

# What cargo cannot fetch by itself: libtorch (checked by SHA-256), and the built page and documentation, which the binary embeds.
setup: need .libtorch/build-version web web/docs-dist/index.html

need:
	@.ci/need.sh

.libtorch/build-version: .cargo/fetch_libtorch.py .cargo/libtorch-requirements.txt
	python3 .cargo/fetch_libtorch.py
	touch $@

web: web/dist/index.html

web/node_modules/.package-lock.json: web/package.json web/package-lock.json
	cd web && npm ci --no-fund --no-audit
	touch node_modules/.package-lock.json

web/dist/index.html: web/node_modules/.package-lock.json $(WEB_SOURCES)
	cd web && npm run build
	touch dist/index.html

web/docs-dist/index.html: web/docs/node_modules/.package-lock.json $(DOCS_SOURCES)
	rm -rf web/docs-dist
	cd web/docs
	npm run --silent build
	touch ../docs-dist/index.html

docs: web/docs-dist/index.html
	cd web/docs
	npm run --silent check

stale:
	python3 .ci/stale.py

docs-reference: web/docs/node_modules/.package-lock.json
	cargo build --release --locked
	cd web/docs
	FLIP_BIN="$${CARGO_TARGET_DIR:-$(CURDIR)/target}/release/flip" npm run --silent reference

web/docs/node_modules/.package-lock.json: web/docs/package.json web/docs/package-lock.json
	cd web/docs && npm ci --no-fund --no-audit
	touch node_modules/.package-lock.json

# For tests only, which start clusters of their own: the package's own cluster is not made.
postgres:
	[ -x "$${FLIP_POSTGRES_BIN:-}/initdb" ] && exit 0
	ls /usr/lib/postgresql/*/bin/initdb > /dev/null 2>&1 && exit 0
	command -v initdb > /dev/null && exit 0
	as_root=; [ "$$(id -u)" = 0 ] || as_root=sudo
	$$as_root apt-get update
	DEBIAN_FRONTEND=noninteractive $$as_root apt-get install -y --no-install-recommends postgresql-common
	$$as_root sed -i 's/^#\?create_main_cluster.*/create_main_cluster = false/' /etc/postgresql-common/createcluster.conf
	DEBIAN_FRONTEND=noninteractive $$as_root apt-get install -y --no-install-recommends postgresql

# Clocks that can be set, for tests only; without it that fault is left out.
faketime:
	ls /usr/lib/*/faketime/libfaketimeMT.so.1 > /dev/null 2>&1 && exit 0
	as_root=; [ "$$(id -u)" = 0 ] || as_root=sudo
	DEBIAN_FRONTEND=noninteractive $$as_root apt-get install -y --no-install-recommends faketime || true

chromium:
	command -v chromium chromium-browser google-chrome > /dev/null && exit 0
	as_root=; [ "$$(id -u)" = 0 ] || as_root=sudo
	$$as_root apt-get update
	DEBIAN_FRONTEND=noninteractive $$as_root apt-get install -y --no-install-recommends chromium

BUF := npx --yes @bufbuild/buf@1.75.0
proto:
	$(BUF) lint proto
	if tag=$$(git describe --tags --abbrev=0 2> /dev/null); then
		old=$$(mktemp -d); trap 'rm -rf "$$old"' EXIT
		git archive "$$tag" proto/flip | tar -x -C "$$old"
		cp proto/buf.yaml "$$old/proto/" && mkdir -p "$$old/proto/sila"
		cd proto && $(BUF) breaking --against "$$old/proto"
	else
		echo "no tag yet: nothing to compare with"
	fi

dist: setup
	cargo build --release --locked --bin flip
	.ci/dist/build.sh
	.ci/dist/try.sh

bench: setup
	cargo bench --locked

bench-peers: setup
	benches/peers/run.sh setup
	cargo run --quiet --release --locked -- bench sim --peers benches/peers $(ARGS)

bench-learner: setup
	benches/learner/run.sh setup
	cargo bench --quiet --locked --bench learner -- $(ARGS)

calibration-report: setup
	cargo build --release --locked
	folder=$$(mktemp -d); trap 'rm -rf "$$folder"' EXIT
	for method in paper emulator; do
		echo "--method $$method"
		cargo run --quiet --release --locked -- calibrate --data-dir "$$folder" --powder all --method "$$method" $(ARGS)
	done

# Jobs that its data folder has finished are found and one that was stopped goes on from its checkpoint, so it can be made in pieces.
EPISODES ?= 200
discovery-report: setup
	cargo build --release --locked --bin flip --example discovery_report
	FLIP_BIN="$${CARGO_TARGET_DIR:-$(CURDIR)/target}/release/flip" cargo run --quiet --release --locked --example discovery_report

weighing-gain: setup
	cargo build --release --locked --bin flip
	CUDA_DEVICE_MAX_CONNECTIONS=32 FLIP_BIN="$${CARGO_TARGET_DIR:-$(CURDIR)/target}/release/flip" cargo experiment weighing_gain

reliability: setup postgres
	FLIP_RELIABILITY=full cargo test --release --locked --test reliability -- --nocapture
	FLIP_KILLS=300 cargo test --release --locked --test kills -- --nocapture
	FLIP_TEST_DATABASE=postgres FLIP_KILLS=300 cargo test --release --locked --test kills -- --nocapture
	FLIP_FUZZ_SECONDS=60 cargo test --release --locked -p flip-bench --test fuzz

page-report: setup web chromium
	cargo build --release --locked --bin flip
	cd web && FLIP_BIN="$${CARGO_TARGET_DIR:-$(CURDIR)/target}/release/flip" node tests/page_report.mjs

pictures: setup web chromium
	cargo build --release --locked --bin flip
	cd web && FLIP_BIN="$${CARGO_TARGET_DIR:-$(CURDIR)/target}/release/flip" npm run --silent pictures

bench-stop: setup
	cargo bench --locked --bench stop_latency $(ARGS)

bench-workers: setup postgres
	cargo bench --quiet --locked --bench workers -- $(ARGS)

FLIP_BUILT = FLIP_BIN="$${CARGO_TARGET_DIR:-$(CURDIR)/target}/release/flip"

bench-database: setup postgres
	cargo bench --quiet --locked --bench database -- $(ARGS)

cluster: setup postgres
	cargo build --release --locked --bin flip --example cluster
	$(FLIP_BUILT) cargo run --quiet --release --locked --example cluster -- demonstration $(ARGS)

faults: setup postgres faketime
	cargo build --release --locked --bin flip --example cluster
	$(FLIP_BUILT) cargo run --quiet --release --locked --example cluster -- faults $(ARGS)

# PROGRAMS=folder: programs built elsewhere, for a machine that has a card and no Rust.
PROGRAMS ?=
RELEASE = $(or $(PROGRAMS),$${CARGO_TARGET_DIR:-$(CURDIR)/target}/release)
gpu-report: $(if $(PROGRAMS),,on-a-card)
	.ci/gpu_report.py "$(RELEASE)" $(ARGS)

STUDY ?= published
published-experiment: $(if $(PROGRAMS),,on-a-card)
	DATA="$${DATA:-$(CURDIR)/target/published-experiment}" .ci/published_experiment.sh "$(RELEASE)" $(STUDY) $(ARGS)

on-a-card: setup
	cargo build --release --locked --bin flip
	cargo build --release --locked -p flip-cuda --example gpu_report --example learner_report
	cargo build --release --locked -p flip-experiments --bin emulator_rounds --bin published_experiment --bin weighing_gain

# What has training stays where it was.
slim: setup
	release="$${CARGO_TARGET_DIR:-$(CURDIR)/target}/release"
	[ ! -e "$$release/flip" ] || cp -p "$$release/flip" "$$release/flip-with-training"
	cargo build --release --locked --no-default-features --bin flip
	mv "$$release/flip" "$$release/flip-slim"
	[ ! -e "$$release/flip-with-training" ] || mv "$$release/flip-with-training" "$$release/flip"
	! ldd "$$release/flip-slim" | grep torch
	python3 python/build.py
	strip -o "$$release/flip-slim-stripped" "$$release/flip-slim"
	du --apparent-size --block-size=1000 "$$release/flip-slim" "$$release/flip-slim-stripped" | sed 's/\t/ kB\t/'

training-report: setup
	cargo build --release --locked
	data="$${DATA:-$(CURDIR)/target/training-report}"
	flip() { cargo run --quiet --release --locked -- "$$@" --data-dir "$$data"; }
	policies() { python3 -c 'import json, sys; found = json.load(sys.stdin); print(*[one["policy"] for one in (found if isinstance(found, list) else [found])])'; }
	doses() { echo "== $$*"; flip evaluate --targets-mg 5,10,15,20 --seed 4 "$$@"; }
	flip calibrate --powder all --seed 1 > "$$data.calibrations.txt"
	ours=$$(flip train --seed 1 --json | policies)
	doses --repeats 5 --policy "$$ours"
	for readability in 0.1 1; do
		doses --repeats 5 --controllers paced --max-shakes 30 --readability-mg $$readability
	done
	for conditions in '--particles 3500' '--extension rotation=1 --extension rolling_friction=0.2' '--extension size_spread=0.2' '--extension humidity=0.5'; do
		doses --repeats 3 --controllers paced --max-shakes 30 $$conditions
	done
	orders=curriculum,random,reverse,domain-randomisation
	for paper in $$(flip train --order "$$orders" --preset paper --episodes $(EPISODES) --seed 1 --json | policies); do
		echo "== preset paper, $(EPISODES) episodes, the next of $$orders"
		doses --repeats 5 --policy "$$paper" --controllers policy
	done

check: tidy
	cargo clippy --locked --workspace --all-targets -- -D warnings

tidy: setup
	cargo fmt --all --check
	python3 .ci/deny.py
	python3 .ci/repeats.py
	cargo build --locked --bin flip
	python3 .ci/readme.py "$${CARGO_TARGET_DIR:-$(CURDIR)/target}/debug/flip"

lint: setup
	cargo fmt --all --check
	cargo clippy --locked --workspace --all-targets -- -D warnings
	cargo doc --locked --workspace --no-deps --document-private-items
	python3 .ci/deny.py
