#!/usr/bin/env bash
# Real consumers of exports, on a calibration bake: gltf-validator, Filament and Babylon.js in headless Chromium (npm),
# usd-core and Blender (PyPI), Mono's C# compiler and Python for the editor scripts of Unity and Unreal, which do not run
# here.
#
#   tests/oracles/export.sh [splatprobe] [folder for the tools]
#
# Needs node, npm, python3.11 (for bpy 4.5), chromium, mcs, and the network the first time; nothing is installed inside the repository.
# What is missing is skipped, with a word.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
splatprobe=${1:-$here/../../target/debug/splatprobe}
tools=${2:-${TMPDIR:-/tmp}/splatprobe-oracles}

mkdir -p "$tools"
[ -d "$tools/node_modules/filament" ] ||
    npm install --silent --prefix "$tools" gltf-validator playwright-core filament babylonjs babylonjs-loaders
[ -d "$tools/usd" ] || { python3 -m venv "$tools/usd" && "$tools/usd/bin/pip" install --quiet usd-core numpy; }
[ -d "$tools/blender" ] || { python3 -m venv "$tools/blender" && "$tools/blender/bin/pip" install --quiet bpy==4.5.*; } ||
    rm -rf "$tools/blender"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$splatprobe" bake --calibration --bounds -1,0,-2,5,2.5,3 --grid 2,1,1 --overlap 0.2 --face-size 64 --progress none \
    -o "$work/bake" >/dev/null
for engine in unity unreal godot filament blender gltf usd; do
    "$splatprobe" export "$work/bake" --engine $engine --out "$work/$engine" >/dev/null
done

node "$here/export/gltf.mjs" "$tools" "$work/gltf/probes.gltf"
"$tools/usd/bin/python" "$here/export/layer.py" "$work/usd/probes.usda"
if command -v chromium >/dev/null; then
    node "$here/export/viewers.mjs" "$tools" "$work/filament" "$work/gltf" probe_000 "$(command -v chromium)"
else
    echo "skipped: chromium is not installed"
fi
python3 "$here/export/unreal.py" "$work/unreal"
if [ -d "$tools/blender" ]; then
    "$tools/blender/bin/python" "$here/export/blender.py" "$work/blender" | tail -n 1
else
    echo "skipped: bpy cannot be installed for $(python3 --version)"
fi
if command -v mcs >/dev/null; then
    for define in NONE SPLATPROBE_HDRP; do
        mcs -target:library -define:$define -warnaserror -nowarn:649,414 -out:"$work/importer.dll" \
            "$work/unity/Editor/SplatprobeImporter.cs" "$here/export/UnityApi.cs"
    done
    echo "Unity: the editor script compiles against the documented API, without and with HDRP"
else
    echo "skipped: mcs is not installed"
fi
