#!/usr/bin/env bash
# Steps per second of the environment, of the same loop in Rust, and of the same spoon of powder in Newton. Takes a quarter of an hour.
#   run.sh setup       builds the wheel and installs it and Newton from PyPI into ${ENVIRONMENT_VENV:-~/.cache/flip-environment}
#   run.sh [OPTION…]   measures (options of steps.py: --repeats 3 --spoons 16 --particles 2500 --steps 1 --newton …)
# RAYON_NUM_THREADS is the number of cores for all of them; default all.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$here/../..
venv=${ENVIRONMENT_VENV:-$HOME/.cache/flip-environment}

if [ "${1:-}" = setup ]; then
  python3 "$root/python/build.py"
  python3 -m venv "$venv"
  "$venv/bin/pip" install --quiet --disable-pip-version-check -r "$here/requirements.txt"
  exec "$venv/bin/pip" install --quiet --disable-pip-version-check --force-reinstall --no-deps "$root"/target/wheels/flip_powder-*.whl
fi
[ -x "$venv/bin/python" ] || { echo "not installed: $venv/bin/python (run.sh setup)" >&2; exit 3; }
echo "load $(cut -d' ' -f1-3 /proc/loadavg), $(sed -n 's/^model name.*: //p' /proc/cpuinfo | head -1)"
"$venv/bin/python" "$root/benches/python_env.py"
exec "$venv/bin/python" "$here/steps.py" "$@"
