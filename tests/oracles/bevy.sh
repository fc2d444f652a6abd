#!/usr/bin/env bash
# The export for Bevy in Bevy: an app without a window builds the exported plugin as it is, loads the exported cube maps and
# renders mirror balls, which are compared with ones computed on the CPU from the bake's own files.
#
#   tests/oracles/bevy.sh [splatprobe] [folder for the tools] [folder for the pictures]
#
# Needs cargo, a Vulkan driver with binding arrays, without which Bevy ignores light probes, and the network the first time,
# when Bevy is built for some minutes; nothing is built inside the repository. Mesa's lavapipe will do, of Debian 13 or of
# Debian 12's backports (25.0); Debian 12's own (22.3) has no such arrays, and in Chromium's SwiftShader balls stay black.
# VK_DRIVER_FILES picks a driver.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
splatprobe=${1:-$here/../../target/debug/splatprobe}
tools=${2:-${TMPDIR:-/tmp}/splatprobe-oracles-bevy}
pictures=${3:-$tools/pictures}

app=$tools/app
mkdir -p "$app/src"
cp "$here/bevy/Cargo.toml" "$app"
cp "$here"/bevy/src/*.rs "$app/src"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# As the demo has its probes: in the middle of cubes that overlap; and one that stands off the middle of a box that is no cube.
# 6 mips, so that the roughest is as wide as the export's: 4 px.
for placement in demo room; do
    place=$([ $placement = room ] && echo "--bounds 0,0,0,10.4,2.7,4.3 --probe 2.5,1.4,2.1" || true)
    for light in captured calibration; do
        flags=$([ $light = calibration ] && echo --calibration || true)
        bake=$work/$placement-$light
        "$splatprobe" bake "$here/../../pipelines/demo/demo.json" $place $flags --face-size 128 --mips 6 \
            --outputs strip,ktx2 --progress none -o "$bake" >/dev/null
        "$splatprobe" export "$bake" --engine bevy -o "$bake-export" >/dev/null
        cp "$bake-export/src/splatprobe.rs" "$app/src"
        CARGO_TARGET_DIR=$tools/target cargo build --quiet --manifest-path "$app/Cargo.toml"
        mkdir -p "$pictures/$placement-$light"
        echo "$placement, $light light"
        RUST_LOG=${RUST_LOG:-error} timeout 300 "$tools/target/debug/bevy-oracle" "$bake" "$bake-export" \
            "$pictures/$placement-$light"
    done
done
