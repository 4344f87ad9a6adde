#!/bin/bash
# The published experiment by built programs: `.ci/published_experiment.sh target/release STUDY [seconds=600…]`.
# In the folder DATA it finds the calibrations and goes on with the trainings of an earlier call. STUDY `none` only calibrates.
set -euo pipefail
programs=$1 study=$2
data=${DATA:-target/published-experiment}
mkdir -p "$data"
calibrated() { # name, powders: the document of a calibration, made once
    [ ! -e "$data/$1.json" ] || return 0
    "$programs/flip" calibrate --data-dir "$data/flip" --method sequential --json "${@:2}" > "$data/new"
    mv "$data/new" "$data/$1.json"
}
for angle in 28 33 37; do calibrated "$angle" --repose-deg "$angle"; done
calibrated powders --powder all
[ "$study" != none ] || exit 0
# With fewer connections than trainings, some wait for others' spoons.
CUDA_DEVICE_MAX_CONNECTIONS=32 "$programs/published_experiment" "$study" "$data/$study" 5 4000 "$data"/{28,33,37,powders}.json "${@:3}"
