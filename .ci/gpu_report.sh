#!/bin/bash
# What a graphics card does for a calibration, an evaluation, a training and the demonstration, beside this machine's cores, by the commands that users call.
#
#     .ci/gpu_report.sh path/to/flip [folder]
#
# Prints how long each took, and the mean absolute error of each controller on both devices. Without a card it prints why
# there is nothing to measure. In a folder with calibrated sand, sugar and salt it does not calibrate.
set -euo pipefail
flip=$1
data=${2:-$(mktemp -d)}
mkdir -p "$data"
quick=(--method sequential --sets 4 --tolerance-deg 3 --particles 600)
evaluate=(evaluate --powders sand,salt,sugar --controllers paced,schedule --targets-mg 10,15 --repeats "${REPEATS:-20}" --json)
train=(train --seed 1 --json)

took() { # name, command...: prints how long it took; its document is in $data/NAME.json
    local name=$1 began ended
    shift
    began=$(date +%s.%N)
    "$flip" "$@" --data-dir "$data" > "$data/$name.json" 2> "$data/$name.log" || { tail -3 "$data/$name.log"; return 1; }
    ended=$(date +%s.%N)
    awk -v name="$name" -v s="$(echo "$ended $began" | awk '{print $1 - $2}')" 'BEGIN { printf "%-24s %7.1f s\n", name, s }'
}

# A policy that cannot exist is refused after a card was found, and nothing is computed.
why=$("$flip" evaluate --policy nowhere --device cuda --data-dir "$data" 2>&1 || true)
if [[ $why != *'no policy'* ]]; then
    echo "skipped: $why"
    exit 0
fi
echo "$(nproc) cores"
for powder in sand sugar salt; do
    [ -e "$data/calibrated-$powder.json" ] || took "calibrated-$powder" calibrate --powder "$powder" "${quick[@]}"
done
took evaluate-cuda "${evaluate[@]}" --device cuda
[ -n "${ONLY_CARD:-}" ] || took evaluate-cpu "${evaluate[@]}"
took evaluate-20us-cuda "${evaluate[@]}" --substep-us 20 --device cuda
took train-cuda "${train[@]}" --device cuda
# The first makes the emulator that both use.
for powder in salt sugar; do took "calibrate-$powder-cuda" calibrate --powder "$powder" --device cuda --json; done
(data=$data/nothing && mkdir -p "$data" && took demo-cuda demo --exit --listen 127.0.0.1:0 --seed 1 --json --device cuda)
policy=$(python3 -c 'import json, sys; print(json.load(open(sys.argv[1]))["policy"])' "$data/train-cuda.json")
took trained-on-card-cuda "${evaluate[@]}" --policy "$policy" --device cuda
python3 - "$data" <<'PY'
import json, pathlib, sys
for path in sorted(pathlib.Path(sys.argv[1]).glob("*-c[up]*.json")):
    document = json.loads(path.read_text())
    if not {"card", "summary"} & document.keys():
        continue
    print(path.stem, "on", document.get("card") or "the processor")
    for row in document.get("summary", []):
        low, high = row["ci95"]
        print(f"  {row['controller']:10} {row['mae_mg']:.3f} mg, 95 % {low:.3f} to {high:.3f}, bias {row['bias_mg']:+.3f}")
PY
