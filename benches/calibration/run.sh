#!/usr/bin/env bash
# The usual optimisers on the product's calibration task (baselines.py).
#   run.sh setup               install what it needs from PyPI (python3) into ${BASELINES_VENV:-~/.cache/flip-baselines}
#   run.sh run --out DIR …     search, verify, print the table; again to go on. FLIP_BIN is the binary, else cargo's release one
#   run.sh vendor DIR [3.12]   what a machine with numpy, scipy and scikit-learn lacks, for that Python, to be put on its PYTHONPATH
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=${BASELINES_VENV:-$HOME/.cache/flip-baselines}

setup() {
  python3 -m venv "$venv"
  "$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary=:all: -r "$here/requirements.txt"
}

run() {
  [ -x "$venv/bin/python" ] || { echo "not installed: $venv (run.sh setup)" >&2; exit 3; }
  exec "$venv/bin/python" "$here/baselines.py" "$@"
}

vendor() {
  local version=${2:-$(python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])')}
  sed '/vendor/,$d' "$here/requirements.txt" |
    python3 -m pip install --quiet --disable-pip-version-check --no-compile --no-deps --only-binary=:all: \
      --python-version "$version" --target "$1" -r /dev/stdin
}

case ${1:-} in
  setup) setup ;;
  run) run "${@:2}" ;;
  vendor) vendor "${@:2}" ;;
  *) sed -n '2,5p' "$0" >&2; exit 2 ;;
esac
