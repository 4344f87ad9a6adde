#!/bin/bash
# What a build needs and does not fetch by itself: names what is missing and the one command that mends it. Says before
# a first build how long it takes and what it downloads. Called by `make run` and `make test`.
set -euo pipefail
cd "$(dirname "$0")/.."
missing=0

need() { # what, how to get it, test
    local what="$1" how="$2"
    shift 2
    if ! "$@" > /dev/null 2>&1; then
        echo "missing: $what. To get it: $how" >&2
        missing=1
    fi
}

rust_is_new() { cargo --version | awk '{ split($2, v, "."); exit !(v[1] > 1 || v[2] >= 95) }'; }
node_is_new() { node -e 'const [a, b] = process.versions.node.split(".").map(Number); process.exit(a > 20 || (a == 20 && b >= 19) ? 0 : 1)'; }

need "Rust 1.95 or later" "curl https://sh.rustup.rs -sSf | sh, and open a new shell" rust_is_new
need "g++" "apt-get install g++" g++ --version
need "Python 3 with pip" "apt-get install python3-pip" python3 -m pip --version
need "Node 20.19 or later with npm" "https://nodejs.org/en/download, or apt-get install nodejs npm where that is new enough" node_is_new
need "npm" "apt-get install npm" npm --version
[ "$(uname -sm)" = "Linux x86_64" ] || { echo "missing: Linux on x86-64; this is $(uname -sm)" >&2; missing=1; }
if [ "$missing" = 1 ]; then exit 1; fi

if [ ! -e "${CARGO_TARGET_DIR:-target}/release/flip" ]; then
    free=$(df -Pk . | awk 'NR == 2 { print int($4 / 1048576) }')
    echo "The first build takes about 11 minutes on two cores, downloads about 650 MB, and needs 4 GB of disk (tests: 12 GB); $free GB are free."
    [ "$free" -ge 5 ] || { echo "missing: disk; free some, or set CARGO_TARGET_DIR to a folder elsewhere" >&2; exit 1; }
fi
