#!/usr/bin/env bash
# Kills a bake at random moments, 50 times unless told otherwise, and lets the next one go on: every one must end well, verify,
# and be the uninterrupted bytes. Beside it, two bakes at a time go for one folder, of which one must be refused.
#
# tests/oracles/kill.sh [TIMES] [SEED]
set -euo pipefail
cd "$(dirname "$0")/../.."
splatprobe=$(realpath "${SPLATPROBE:-target/debug/splatprobe}")
times=${1:-50}
RANDOM=${2:-1}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Becomes the bake, so that a shell in the background is the process to kill.
become() {
  exec "$splatprobe" bake pipelines/demo/demo.json --grid 4,1,3 --face-size 24 --outputs strip,mips,envmap \
    --progress none "$@"
}
bake() { (become "$@"); }

begun=$(date +%s%N)
bake -o "$work/whole" > /dev/null
whole=$((($(date +%s%N) - begun) / 1000000))
echo "an uninterrupted bake takes $whole ms"

killed=0 resumed=0 busy=0
for ((i = 1; i <= times; i++)); do
  out="$work/out$i"
  # Every third with a cache of its own, which is killed, too.
  cache=()
  if ((i % 3 == 0)); then cache=(--cache "$work/cache$i"); fi
  # Every second over another bake, whose manifest must not stand beside files of this one.
  if ((i % 2 == 0)); then bake -o "$out" --exposure 1 > /dev/null; fi
  attempts=0
  while true; do
    attempts=$((attempts + 1))
    become "${cache[@]}" -o "$out" --stats "$work/stats.json" > /dev/null 2> "$work/log" &
    pid=$!
    # From before the first file to after the last one.
    moment=$((RANDOM % (whole + whole / 8)))
    sleep "$(printf '%d.%03d' $((moment / 1000)) $((moment % 1000)))"
    if ((attempts == 1 && i % 5 == 0)); then
      if bake -o "$out" > /dev/null 2> "$work/second"; then :; else
        grep -q "another bake writes to this folder" "$work/second"
        busy=$((busy + 1))
      fi
    fi
    if kill -9 "$pid" 2> /dev/null; then :; fi
    if wait "$pid" 2> /dev/null; then break; fi
    killed=$((killed + 1))
    # A manifest that is there is whole.
    if [ -e "$out/manifest.json" ]; then "$splatprobe" verify "$out" 2> /dev/null || { echo "torn: $out"; exit 1; }; fi
    if ((attempts == 2)); then
      bake "${cache[@]}" -o "$out" --stats "$work/stats.json" > /dev/null
      break
    fi
  done
  kept=$(sed -n 's/.*"keptProbes": \([0-9]*\).*/\1/p' "$work/stats.json")
  resumed=$((resumed + (kept > 0)))
  "$splatprobe" verify "$out"
  diff -r "$work/whole" "$out"
  rm -rf "$out" "$work/cache$i"
done
echo "$times rounds, $killed kills, $resumed of the last bakes went on from kept probes, $busy second bakes refused: all equal"
