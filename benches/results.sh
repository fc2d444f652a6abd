#!/usr/bin/env bash
# Measures everything that docs/results quotes, and writes it there: a page per subject, with the commands that made it.
#
#   benches/results.sh              # all of it: about an hour on two cores that do nothing else
#   benches/results.sh seams load   # some pages
#
# `prefilter` needs node, npm and chromium, `peers` python3 and an LLVM library (Debian: libllvm19), both the network the first
# time. SCENES names further splat files
# for `errors`, each of which gets a page of its own.
set -euo pipefail
cd "$(dirname "$0")/.."
pages=docs/results
tools=${TOOLS:-${TMPDIR:-/tmp}/splatprobe-peers}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir -p "$pages"

# Begins the page $1 with the title $2; further arguments are its paragraphs.
page() {
    page=$pages/$1.md
    { echo "# $2"; shift 2; printf '\n%s\n' "$@"; echo; grep -m1 'model name' /proc/cpuinfo | sed 's/.*: /Machine: /; s/$/, '"$(nproc)"' cores./'; } >"$page"
}

# Runs a command and adds it and what it prints to the page.
run() {
    echo "$*" >&2
    { printf '\n```sh\n%s\n```\n\n' "$*"; "$@" 2>"$work/stderr" || { cat "$work/stderr" >&2; exit 1; }; } >>"$page"
}

tracers() {
    page tracers "Tracers" \
        "Rays per second of one cubemap in the generated interior, and the error against the f64 reference in display space." \
        "Wall time on all cores, processor time on one."
    cases=beam-800,beam-800-camera,beam-800-avx2,beam-256,beam-64,ray-256
    run cargo bench --bench trace -- --gaussians 1500000 --sh 3 --cases $cases --runs 3 --pixels 1000
    run cargo bench --bench trace -- --gaussians 1500000 --sh 0 --cases beam-800,beam-256 --runs 3 --pixels 200
    run cargo bench --bench trace -- --gaussians 750000 --sh 3 --cases beam-800 --runs 3 --pixels 100
    run cargo bench --bench trace -- --gaussians 3000000 --sh 3 --cases beam-800 --runs 3 --pixels 100
    run cargo bench --bench trace -- --gaussians 1000000 --sh 3 --cases ray-256 --runs 3 --pixels 1000
}

load() {
    page load "Readers" "From files in the page cache to a scene, SH degree 3. Peak memory with the file and the scene, and the scene's own."
    run cargo bench --bench load -- --gaussians 1000000 --runs 5
}

seams() {
    page seams "Seams" "How much the two faces that share an edge disagree along it: rays, and splatting with its approximation."
    run cargo bench --bench seams
}

footprint() {
    page footprint "Footprint filter" "One filtered ray per texel against 16 x 16 rays."
    run cargo bench --bench footprint -- --gaussians 150000
}

prefilter() {
    page prefilter "Prefiltering" "A chain of seven mips of a 256 px cubemap, and its error against brute force; that of three.js beside it."
    run cargo bench --bench filter
    [ -d "$tools/web/node_modules/three" ] ||
        npm install --silent --prefix "$tools/web" playwright-core ktx-parse zstddec three@0.187.0
    cargo build --release --quiet
    run target/release/splatprobe bake pipelines/demo/demo.json --outputs ktx2 --progress none -o "$work/demo"
    run node tests/oracles/web/pmrem.mjs "$tools/web" "$work/demo/probe_000/specular.ktx2"
}

placement() {
    page placement "Placement" "Adaptive probes beside a grid, in a building of sixteen rooms and halls."
    run cargo bench --bench placement -- --gaussians 1500000 --bake
}

surfaces() {
    page surfaces "Lit surfaces" "Time and error of path tracing by its samples, beside light from local cubemaps."
    run cargo bench --bench surface
}

skips() {
    page skips "What a scene does not need" "Each skip beside the same work without it."
    run cargo bench --bench skips -- --gaussians 500000
}

errors() {
    page errors "Run time against error" \
        "One setting at a time about the defaults, and the presets. A row on the front is beaten by none in both." \
        "![Run time against error](errors.svg)"
    cargo build --release --quiet
    run target/release/splatprobe bench interior:300000 -o "$work/interior"
    cp "$work/interior/bench.svg" "$pages/errors.svg"
    for scene in ${SCENES:-}; do
        name=errors-$(basename "${scene%.*}")
        page "$name" "Run time against error: $(basename "$scene")" "![Run time against error]($name.svg)"
        run target/release/splatprobe bench "$scene" -o "$work/$name"
        cp "$work/$name/bench.svg" "$pages/$name.svg"
    done
}

peers() {
    page peers "Beside Mitsuba 3" "The same rays by Mitsuba's ellipsoids and volprim_rf_basic, which blends in another order, in one run."
    [ -d "$tools/python" ] || { python3 -m venv "$tools/python" && "$tools/python/bin/pip" install --quiet mitsuba numpy; }
    cargo build --release --quiet
    cargo run --release --quiet --example make_interior -- 1000000 3 "$work/interior.ply"
    export DRJIT_LIBLLVM_PATH=${DRJIT_LIBLLVM_PATH:-$(ls /usr/lib/*/libLLVM.so.19* 2>/dev/null | head -1)}
    run "$tools/python/bin/python" benches/peers/rays.py "$work/interior.ply" --probe 7.5,1.6,6.3 --sizes 64,256 \
        --splatprobe target/release/splatprobe --out "$work/peers"
}

all="tracers load seams footprint prefilter placement surfaces skips errors peers"
for subject in ${*:-$all}; do
    "$subject"
done
# Paths of this run are of no use to a reader.
sed -i "s#$work/#out/#g; s#$tools/python/bin/##g; s#$HOME/##g" "$pages"/*.md
