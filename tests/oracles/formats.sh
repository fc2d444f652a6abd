#!/usr/bin/env bash
# Readers of other people on a calibration bake: ktx-parse and zstddec (npm), OpenEXR and OpenImageIO (PyPI), OpenEXR's own tools.
#
#   tests/oracles/formats.sh [splatprobe] [folder for the tools]
#
# Needs node, npm, python3 and the network the first time; nothing is installed inside the repository.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
splatprobe=${1:-$here/../../target/debug/splatprobe}
tools=${2:-${TMPDIR:-/tmp}/splatprobe-oracles}

mkdir -p "$tools"
[ -d "$tools/node_modules/ktx-parse" ] || npm install --silent --prefix "$tools" ktx-parse zstddec
[ -d "$tools/python" ] || { python3 -m venv "$tools/python" && "$tools/python/bin/pip" install --quiet OpenEXR OpenImageIO numpy; }

bake=$(mktemp -d)
trap 'rm -rf "$bake"' EXIT
all=strip,faces,mips,irradiance,latlong,latlong-hdr,envmap,ktx2,rgbd,moments
for encoding in rgba16f rgb9e5; do
    "$splatprobe" bake --calibration --bounds -1,-1,-1,1,1,1 --grid 1,1,1 --face-size 64 --progress none \
        --outputs $all --hdr-encoding $encoding -o "$bake/$encoding" >"$bake/log"
    node "$here/ktx2.mjs" "$tools" "$bake/$encoding/probe_000"
done
if command -v exrenvmap >/dev/null; then
    exrenvmap -l -w 256 "$bake/rgba16f/probe_000/envmap.exr" "$bake/converted.exr"
fi
"$tools/python/bin/python" "$here/images.py" "$bake/rgba16f/probe_000" "$bake/converted.exr"
for file in "$bake"/rgba16f/probe_000/*.exr; do
    if command -v exrinfo >/dev/null; then exrinfo "$file" >/dev/null; fi
done
echo "all formats were read"
