"""The same rays by Mitsuba 3 (ellipsoids + volprim_rf_basic) and by splatprobe, side by side.

Mitsuba blends in the order in which rays enter the ellipsoids and evaluates colours along the ray, in f32; splatprobe in the
order of the strongest responses. Thin ellipsoids are missed by Mitsuba's intersection, so that the scene's aspect ratios are
clamped to 10 first, for both. The truth is splatprobe's `ray` tracer in f64 without a cut-off, with colours along the ray (the
direction that Mitsuba takes): Mitsuba's error holds its other order and its cut-off at a hundredth, too.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import time

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

# Right, up and look of each face, in the order of the strip.
FACES = np.array(
    [
        [[0, 0, 1], [0, 1, 0], [1, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
    ],
    dtype=np.float64,
)
ASPECT = 10.0


def clamped(path, out):
    """Writes the binary PLY at `path` with aspect ratios of at most ASPECT, and with the normals that Mitsuba wants."""
    with open(path, "rb") as file:
        header = b""
        while not header.endswith(b"end_header\n"):
            header += file.readline()
        names = re.findall(rb"property float (\S+)", header)
        rows = np.fromfile(file, dtype="<f4").reshape(-1, len(names))
    scales = [names.index(b"scale_%d" % axis) for axis in range(3)]
    largest = rows[:, scales].max(axis=1, keepdims=True)
    rows[:, scales] = np.maximum(rows[:, scales], largest - np.log(ASPECT))
    if b"nx" not in names:
        header = header.replace(b"property float z\n", b"property float z\n" + b"".join(b"property float n%c\n" % c for c in b"xyz"))
        rows = np.concatenate([rows[:, :3], np.zeros_like(rows[:, :3]), rows[:, 3:]], axis=1)
    with open(out, "wb") as file:
        file.write(header)
        rows.astype("<f4").tofile(file)
    return len(rows)


def directions(size):
    at = (np.arange(size) + 0.5) * 2 / size - 1
    x, y = np.meshgrid(at, -at)
    strip = [look + x[..., None] * right + y[..., None] * up for right, up, look in FACES]
    strip = np.concatenate(strip).reshape(-1, 3)
    return strip / np.linalg.norm(strip, axis=1, keepdims=True)


class Mitsuba:
    def __init__(self, path, depth):
        primitives = {"type": "ellipsoids", "filename": path, "extent": float(np.sqrt(2 * np.log(255)))}
        integrator = {"type": "volprim_rf_basic", "max_depth": depth}
        self.scene = mi.load_dict({"type": "scene", "integrator": integrator, "primitives": primitives})

    def trace(self, origin, rays):
        """Linear RGB along `rays`, and the seconds it took."""
        ray = mi.RayDifferential3f(mi.Point3f(*origin), mi.Vector3f(rays.T.astype(np.float32)))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, len(rays))
        dr.sync_thread()
        begun = time.perf_counter()
        colour = self.scene.integrator().sample(dr.ADMode.Primal, self.scene, sampler, ray, None, None, mi.Bool(True))[0]
        dr.eval(colour)
        dr.sync_thread()
        return np.array(colour).T, time.perf_counter() - begun


def bake(arguments, path, size, out, *more):
    """Linear RGB of a probe as the strip has it, and what the bake says of itself."""
    command = [arguments.splatprobe, "bake", "--splats", path, "--splat-frame", "raw", "--face-size", str(size)]
    command += ["--probe", arguments.probe, "--pixel", "float", "--no-cache", "--progress", "none"]
    command += ["--stats", f"{out}/stats.json", "-o", f"{out}/bake", *more]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    strip = np.array(mi.Bitmap(f"{out}/bake/probe_000/radiance.exr"))[..., :3].reshape(-1, 3)
    with open(f"{out}/stats.json") as file:
        return strip, json.load(file)["seconds"]["bake"]


def display(linear):
    linear = np.clip(linear, 0, None)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1 / 2.4) - 0.055)


def rms(image, truth):
    return np.sqrt(np.mean((display(image) - display(truth)) ** 2))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", help="binary PLY of floats, as 3DGS trainers write it")
    parser.add_argument("--probe", required=True, help="x,y,z in the file's coordinates")
    parser.add_argument("--sizes", default="64,256", help="face sizes [default: 64,256]")
    parser.add_argument("--truth-size", type=int, default=64, help="face size at which errors are measured")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--splatprobe", required=True)
    parser.add_argument("--out", required=True, help="folder for what is made on the way, and the table")
    arguments = parser.parse_args()
    os.makedirs(arguments.out, exist_ok=True)
    path = f"{arguments.out}/clamped.ply"
    count = clamped(arguments.scene, path)
    origin = [float(value) for value in arguments.probe.split(",")]
    mitsuba = Mitsuba(path, 4096)

    size = arguments.truth_size
    along_rays = ["--sh-direction", "ray"]
    truth, _ = bake(arguments, path, size, arguments.out, "--tracer", "ray", "--t-cutoff", "0", *along_rays)
    ours = rms(bake(arguments, path, size, arguments.out, *along_rays)[0], truth)
    theirs = rms(mitsuba.trace(origin, directions(size))[0], truth)

    lines = [
        f"{count} Gaussians, aspect ratios at most {ASPECT:.0f}, {os.cpu_count()} cores, Mitsuba {mi.__version__}, "
        f"medians of {arguments.runs}.",
        "",
        f"Error in display space at {size} px faces, RMS: splatprobe {ours:.1e}, Mitsuba {theirs:.1e} (other order).",
        "",
        "| face size | Mitsuba Mrays/s | splatprobe Mrays/s | ratio |",
        "|---|---|---|---|",
    ]
    for size in [int(size) for size in arguments.sizes.split(",")]:
        rays = directions(size)
        # The first run compiles.
        mitsuba.trace(origin, rays[:16])
        # In turns, so that both see the same load of the machine.
        pairs = []
        for _ in range(arguments.runs):
            their_seconds = mitsuba.trace(origin, rays)[1]
            pairs.append((their_seconds, bake(arguments, path, size, arguments.out)[1]))
        rate = [len(rays) / statistics.median(seconds) / 1e6 for seconds in zip(*pairs)]
        ratio = statistics.median(theirs / ours for theirs, ours in pairs)
        lines.append(f"| {size} | {rate[0]:.3f} | {rate[1]:.3f} | {ratio:.1f} |")
    with open(f"{arguments.out}/rays.md", "w") as file:
        file.write("\n".join(lines) + "\n")
    print("\n".join(lines))


main()
