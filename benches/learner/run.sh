#!/usr/bin/env bash
# Stable-Baselines3's Soft Actor-Critic, timed beside FLIP's by `cargo bench --bench learner` (docs/performance.md).
#   run.sh setup     install it from PyPI (python3) into ${LEARNER_VENV:-~/.cache/flip-learner}; where download.pytorch.org can be
#                    reached, PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu spares the libraries for graphics cards
#   run.sh one       a window for each line on stdin (sb3.py)
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=${LEARNER_VENV:-$HOME/.cache/flip-learner}

setup() {
  python3 -m venv "$venv"
  "$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary=:all: -r "$here/requirements.txt"
}

one() {
  [ -x "$venv/bin/python" ] || { echo "not installed: $venv (benches/learner/run.sh setup)" >&2; exit 3; }
  # No graphics card, one thread.
  CUDA_VISIBLE_DEVICES='' OMP_NUM_THREADS=1 exec "$venv/bin/python" "$here/sb3.py"
}

case ${1:-} in
  setup) setup ;;
  one) one ;;
  *) sed -n '2,5p' "$0" >&2; exit 2 ;;
esac
