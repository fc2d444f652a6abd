#!/usr/bin/env bash
# Checks the OpenJD template and runs it here, and compares all bytes with a bake and an export at once.
# Needs `openjd` (PyPI openjd-cli) on the path, or in $OPENJD.
set -euo pipefail
cd "$(dirname "$0")/../.."
splatprobe=$(realpath "${SPLATPROBE:-target/debug/splatprobe}")
openjd=${OPENJD:-openjd}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

template=pipelines/openjd/template.yaml
"$openjd" check "$template"
"$openjd" summary "$template" -p "Job=x" -p "Output=y"
engine=gltf
"$openjd" run "$template" -p "Job=$PWD/pipelines/demo/demo.json" -p "Output=$work/out" \
  -p "Splatprobe=$splatprobe" -p "Engine=$engine"
# The whole bake takes its probes from the same placement.
"$splatprobe" bake pipelines/demo/demo.json --placed "$work/out.plan/manifest.json" -o "$work/whole" --progress none
diff -r "$work/whole" "$work/out"
"$splatprobe" export "$work/whole" --engine "$engine" -o "$work/whole.$engine" > /dev/null
diff -r "$work/whole.$engine" "$work/out.$engine"
echo "the parts are the whole, byte for byte"
