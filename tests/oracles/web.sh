#!/usr/bin/env bash
# Exports for web engines in those engines: three.js, Babylon.js and PlayCanvas (npm) load a bake in headless Chromium, and a
# mirror ball there is compared with one computed on the CPU; so is the preview page's. ktx-parse (npm) reads every KTX2 file.
# Prefiltering is compared with brute force, beside three.js's own.
#
#   tests/oracles/web.sh [splatprobe] [folder for the tools] [folder for the pictures]
#
# Needs node, npm, chromium (or its path in CHROMIUM) and the network the first time; nothing is installed inside the
# repository. ENGINES="three babylon" runs some of them.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
splatprobe=${1:-$here/../../target/debug/splatprobe}
tools=${2:-${TMPDIR:-/tmp}/splatprobe-oracles-web}
pictures=${3:-$tools/pictures}

mkdir -p "$tools" "$pictures"
[ -d "$tools/node_modules/playcanvas" ] || npm install --silent --prefix "$tools" \
    playwright-core pngjs ktx-parse zstddec esbuild three@0.187.0 @babylonjs/core@9.34.0 playcanvas@2.23.3
# Babylon.js's thousands of modules as one file.
modules=$tools/node_modules
[ -f "$modules/babylon-core.mjs" ] || "$modules/.bin/esbuild" "$modules/@babylonjs/core/index.js" --bundle --format=esm \
    --log-level=error --outfile="$modules/babylon-core.mjs"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for light in captured calibration; do
    flags=$([ $light = calibration ] && echo --calibration || true)
    "$splatprobe" bake "$here/../../pipelines/demo/demo.json" $flags --face-size 128 --outputs strip,ktx2 --progress none \
        -o "$work/$light" >/dev/null
    for engine in three babylon playcanvas bevy; do
        "$splatprobe" export "$work/$light" --engine $engine -o "$work/exports-$light/$engine" >/dev/null
    done
    "$splatprobe" preview "$work/$light" -o "$work/$light.html"
    mkdir -p "$pictures/$light"
    echo "$light light"
    node "$here/web/run.mjs" "$tools" "$work/$light" "$work/exports-$light" "$work/$light.html" "$pictures/$light"
    node "$here/web/ktx2.mjs" "$tools" "$work/exports-$light"
done
node "$here/web/pmrem.mjs" "$tools" "$work/captured/probe_000/specular.ktx2"
