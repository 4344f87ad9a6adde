#!/usr/bin/env bash
# Soft Actor-Critic of Stable-Baselines3 and in JAX, timed beside FLIP's by `cargo bench --bench learner` (docs/performance.md).
#   run.sh setup     install both from PyPI (python3) into ${LEARNER_VENV:-~/.cache/flip-learner}; where download.pytorch.org can be
#                    reached, PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu spares the libraries for graphics cards
#   run.sh one       a window for each line on stdin (sb3.py)
#   run.sh jax       likewise (jax_sac.py)
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venv=${LEARNER_VENV:-$HOME/.cache/flip-learner}

setup() {
  python3 -m venv "$venv"
  "$venv/bin/pip" install --quiet --disable-pip-version-check --only-binary=:all: -r "$here/requirements.txt"
  python3 -m venv "$venv-jax"
  "$venv-jax/bin/pip" install --quiet --disable-pip-version-check --only-binary=:all: -r "$here/requirements-jax.txt"
}

# Says why a peer is left out.
installed() {
  [ -x "$1/bin/python" ] || { echo "not installed: $1 (benches/learner/run.sh setup)" >&2; exit 3; }
}

one() {
  installed "$venv"
  # No graphics card, one thread.
  CUDA_VISIBLE_DEVICES='' OMP_NUM_THREADS=1 exec "$venv/bin/python" "$here/sb3.py"
}

jax() {
  installed "$venv-jax"
  exec "$venv-jax/bin/python" "$here/jax_sac.py"
}

case ${1:-} in
  setup) setup ;;
  one) one ;;
  jax) jax ;;
  *) sed -n '2,6p' "$0" >&2; exit 2 ;;
esac
