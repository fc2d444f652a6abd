"""Reads a calibration bake's images with OpenEXR and OpenImageIO and checks every direction."""

import glob
import os
import sys

import numpy
import OpenEXR
import OpenImageIO as oiio

folder, converted = sys.argv[1:]
# OpenEXR's faces: right, up, look.
FACES = numpy.array(
    [
        [[0, 0, 1], [0, 1, 0], [1, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
        [[-1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
    ],
    float,
)


def pixels(name):
    image = oiio.ImageBuf(os.path.join(folder, name))
    assert not image.has_error, f"{name}: {image.geterror()}"
    return image.get_pixels(oiio.FLOAT)[..., :3]


def strip_directions(size, edges):
    at = numpy.arange(size) / (size - 1) * 2 - 1 if edges else (numpy.arange(size) + 0.5) / size * 2 - 1
    x, y = numpy.meshgrid(at, -at)
    d = [look + right * x[..., None] + up * y[..., None] for right, up, look in FACES]
    return numpy.concatenate(d)


def latlong_directions(height, edges=False):
    def share(count):
        return numpy.arange(count) / (count - 1) if edges else (numpy.arange(count) + 0.5) / count

    longitude = numpy.pi * (1 - 2 * share(2 * height))
    latitude = numpy.pi * (0.5 - share(height))
    lon, lat = numpy.meshgrid(longitude, latitude)
    return numpy.stack([numpy.sin(lon) * numpy.cos(lat), numpy.sin(lat), numpy.cos(lon) * numpy.cos(lat)], -1)


def worst_angle(code, d):
    """Radiance is k (d + 1) / 2 with an unknown k: of the two that fit, the better."""
    d = d / numpy.linalg.norm(d, axis=-1, keepdims=True)
    total, square = code.sum(-1), (code * code).sum(-1)
    root = numpy.sqrt(numpy.maximum(total**2 - 2 * square, 0))
    best = numpy.full(total.shape, -1.0)
    for sign in (-1, 1):
        found = code * ((total + sign * root) / square)[..., None] - 1
        cosine = (found * d).sum(-1) / numpy.maximum(numpy.linalg.norm(found, axis=-1), 1e-9)
        best = numpy.maximum(best, cosine)
    return float(numpy.arccos(numpy.clip(best.min(), -1, 1)))


size = pixels("radiance.exr").shape[1]
for name, directions in [
    ("radiance.exr", strip_directions(size, False)),
    ("envmap.exr", strip_directions(size, True)),
    ("latlong.exr", latlong_directions(2 * size)),
]:
    worst = worst_angle(pixels(name), directions)
    print(f"{name}: worst direction {worst:.4f} rad, a texel is {2 / size:.4f}")
    assert worst < 2 / size, name

# OpenEXR's converter knows where the texels of its own kind of file lie.
if os.path.exists(converted):
    # The converter copies an attribute of the cube, at which OpenImageIO stops and OpenEXR does not.
    channels = OpenEXR.File(converted, separate_channels=True).parts[0].channels
    rgb = numpy.stack([channels[name].pixels for name in "RGB"], -1).astype(float)
    worst = worst_angle(rgb, latlong_directions(128, edges=True))
    print(f"exrenvmap -l envmap.exr: worst direction {worst:.4f} rad")
    assert worst < 2 / size

# The code magnifies steps of eight bits; the image is that of the EXR file within them.
exr, hdr = pixels("latlong.exr"), pixels("latlong.hdr")
assert (abs(hdr - exr) <= exr.max(-1, keepdims=True) / 250).all(), "latlong.hdr"

for path in sorted(glob.glob(os.path.join(folder, "*.exr"))):
    with OpenEXR.File(path, separate_channels=True) as file:
        for part in file.parts:
            for channel in part.channels.values():
                assert numpy.isfinite(channel.pixels).all(), path
        has_envmap = "envmap" in file.header()
        assert has_envmap == path.endswith("envmap.exr"), path
        print(f"{os.path.basename(path)}: {len(file.parts)} parts")
for path in glob.glob(os.path.join(folder, "*.png")):
    assert oiio.ImageBuf(path).get_pixels(oiio.FLOAT).size > 0
