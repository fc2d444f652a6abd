#!/bin/sh
# Joins the parts that bake.sh made.
#SBATCH --job-name=splatprobe-merge
set -eu

parts=""
for part in $(seq 1 "$SPLATPROBE_PARTS"); do
  parts="$parts $SPLATPROBE_OUTPUT.part$part"
done
# Word by word.
# shellcheck disable=SC2086
"${SPLATPROBE:-splatprobe}" merge $parts -o "$SPLATPROBE_OUTPUT"
"${SPLATPROBE:-splatprobe}" verify "$SPLATPROBE_OUTPUT"
