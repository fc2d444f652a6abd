#!/usr/bin/env bash
# run.sh TARGET SECONDS: fuzzes one target on one core; the log is logs/TARGET.log. Build before: see README.md.
set -euo pipefail
cd "$(dirname "$0")"
target=$1 seconds=$2
shift 2
mkdir -p logs "artifacts/$target" "corpus/$target"
dictionary=()
[ -e "dictionaries/$target" ] && dictionary=("-dict=dictionaries/$target")
# An allocation that nothing writes to shows in no resident size: the limit on addresses catches it.
ulimit -v 6000000
export TMPDIR=${TMPDIR:-/dev/shm} RAYON_NUM_THREADS=1
nice -n 10 "target/x86_64-unknown-linux-gnu/release/$target" "corpus/$target" "-artifact_prefix=artifacts/$target/" \
  "-max_total_time=$seconds" -timeout=10 -rss_limit_mb=2048 -max_len=65536 -print_final_stats=1 "${dictionary[@]}" "$@" \
  >> "logs/$target.log" 2>&1
