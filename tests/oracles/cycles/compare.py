"""Compares `splatprobe bake --surface path` with Blender Cycles on scenes made of meshes alone.

    pip install bpy==4.5.15 numpy OpenEXR
    python compare.py PATH/TO/splatprobe [--size 48] [--samples 1024] [--out FOLDER]

Each scene is written as glTF, baked at the origin, and its -Z face compared with a Cycles render (CPU, no denoising) by
a camera of 90 degrees at the origin that looks along -Z. Both see the same environment image. What differs between the
two programs is taken out of the set-up, not out of the result:

- pixels are boxes (Cycles' default filter is wider than a pixel);
- bounces are not limited to Cycles' defaults, and nothing is clamped;
- Blender's equirectangular images have their seam a quarter elsewhere than OpenEXR's, so that its copy is rolled.

The figure is the root of the mean squared difference over the face, divided by the root of Cycles' mean square; the bar
is 2 %. Samples of Cycles per pixel are those of the bake: rays per texel times paths per ray.
"""

import argparse
import base64
import json
import math
import pathlib
import subprocess
import sys
import time

import numpy as np
import OpenEXR


def sphere(radius, centre, rows=64):
    positions, normals, triangles = [], [], []
    for row in range(rows + 1):
        for column in range(2 * rows + 1):
            polar, azimuth = math.pi * row / rows, math.pi * column / rows
            normal = np.array(
                [math.sin(polar) * math.cos(azimuth), math.cos(polar), -math.sin(polar) * math.sin(azimuth)]
            )
            normals.append(normal)
            positions.append(np.array(centre) + radius * normal)
    for row in range(rows):
        for column in range(2 * rows):
            a = row * (2 * rows + 1) + column
            b, c, d = a + 2 * rows + 1, a + 2 * rows + 2, a + 1
            triangles += [[a, b, c], [a, c, d]]
    return positions, normals, triangles


def panel(centre, across, up):
    centre, across, up = (np.array(v, float) for v in (centre, across, up))
    corners = [centre + across * x / 2 + up * y / 2 for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    normal = np.cross(across, up)
    return corners, [normal / np.linalg.norm(normal)] * 4, [[0, 1, 2], [0, 2, 3]]


def write_gltf(path, parts):
    """`parts` are (mesh, material)."""
    data, views, accessors, meshes, materials = b"", [], [], [], []

    def accessor(array, kind, component):
        nonlocal data
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        bounds = {"min": array.min(0).tolist(), "max": array.max(0).tolist()} if kind == "VEC3" else {}
        count = len(array)
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": component, "count": count, "type": kind, **bounds}
        )
        data += array.tobytes()
        return len(accessors) - 1

    for (positions, normals, triangles), material in parts:
        attributes = {
            "POSITION": accessor(np.array(positions, np.float32), "VEC3", 5126),
            "NORMAL": accessor(np.array(normals, np.float32), "VEC3", 5126),
        }
        indices = accessor(np.array(triangles, np.uint32).reshape(-1), "SCALAR", 5125)
        materials.append(material)
        meshes.append(
            {"primitives": [{"attributes": attributes, "indices": indices, "material": len(materials) - 1}]}
        )
    used = sorted({name for material in materials for name in material.get("extensions", {})})
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": used,
        "scene": 0,
        "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [{"mesh": i} for i in range(len(meshes))],
        "meshes": meshes,
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data), "uri": uri}],
    }
    if not used:
        del document["extensionsUsed"]
    path.write_text(json.dumps(document))


def material(colour=(1, 1, 1, 1), metallic=0.0, roughness=1.0, emission=0.0, blend=False, **extensions):
    made = {
        "doubleSided": blend,
        "pbrMetallicRoughness": {
            "baseColorFactor": list(colour),
            "metallicFactor": metallic,
            "roughnessFactor": roughness,
        },
    }
    if blend:
        made["alphaMode"] = "BLEND"
    if emission:
        made["emissiveFactor"] = [1, 1, 1]
        extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": emission}
    if extensions:
        made["extensions"] = extensions
    return made


DIFFUSE = {"KHR_materials_specular": {"specularFactor": 0.0}}


def scenes():
    ball = sphere(1.0, (0, 0, -2.2))
    grey = material((0.7, 0.7, 0.7, 1), **DIFFUSE)
    red = material((0.7, 0.2, 0.1, 1), **DIFFUSE)
    box = [
        (panel((0, -1, -2.5), (3, 0, 0), (0, 0, -3)), grey),
        (panel((0, 1, -2.5), (3, 0, 0), (0, 0, 3)), grey),
        (panel((0, 0, -4), (3, 0, 0), (0, 2, 0)), grey),
        (panel((-1.5, 0, -2.5), (0, 0, -3), (0, 2, 0)), red),
        (panel((1.5, 0, -2.5), (0, 0, 3), (0, 2, 0)), grey),
        (panel((0, 0.99, -2.5), (1, 0, 0), (0, 0, 1)), material((0, 0, 0, 1), emission=8.0, **DIFFUSE)),
        (sphere(0.4, (0.3, -0.6, -2.4)), grey),
    ]
    panes = [
        (panel((-0.6 + 0.6 * i, 0.1 * i, -2 - 0.3 * i), (1.2, 0, 0.2), (0, 1.5, 0)), material(colour, blend=True, **DIFFUSE))
        for i, colour in enumerate([(0.8, 0.2, 0.2, 0.5), (0.2, 0.8, 0.2, 0.7), (0.2, 0.2, 0.8, 0.3)])
    ]
    return {
        "rough-metal": [(ball, material((0.9, 0.6, 0.3, 1), metallic=1.0, roughness=0.4))],
        "dielectric": [(ball, material((0.5, 0.6, 0.7, 1), roughness=0.3))],
        "panel-in-box": box,
        "alpha-panes": panes,
    }


def environment(width=128):
    """A bright and a dark side, and a soft sun."""
    v, u = np.meshgrid((np.arange(width // 2) + 0.5) / (width // 2), (np.arange(width) + 0.5) / width, indexing="ij")
    longitude, latitude = math.pi * (1 - 2 * u), math.pi * (0.5 - v)
    x, y, z = np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)
    sky = np.stack([0.4 + 0.3 * y, 0.5 + 0.3 * y, 0.7 + 0.3 * y], -1)
    sun = np.exp(20 * ((np.stack([x, y, z], -1) @ np.array([0.6, 0.6, 0.53])) - 1))
    return (sky + 6 * sun[..., None]).astype(np.float32)


def write_exr(path, pixels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels)}).write(str(path))


def read_exr(path):
    channels = OpenEXR.File(str(path)).channels()
    for name in ("RGBA", "RGB"):
        if name in channels:
            return channels[name].pixels[..., :3].astype(np.float64)
    return np.stack([channels[c].pixels for c in "RGB"], -1).astype(np.float64)


def bake(program, scene, sky, folder, size, paths):
    command = [program, "bake", "--mesh", scene, "--background", sky, "--probe", "0,0,0", "-o", folder]
    command += ["--face-size", size, "--samples", 4, "--surface", "path", "--noise", 0, "--max-paths", paths]
    command += ["--pixel", "float", "--progress", "none"]
    subprocess.run([str(part) for part in command], check=True, stdout=subprocess.DEVNULL)
    strip = read_exr(next(folder.glob("*/radiance.exr")))
    return strip[5 * size :]


def render(scene, sky, out, size, samples):
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(scene))
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    image = nodes.new("ShaderNodeTexEnvironment")
    image.image = bpy.data.images.load(str(sky))
    image.image.colorspace_settings.name = "Linear Rec.709"
    links.new(image.outputs["Color"], nodes["Background"].inputs["Color"])
    camera = bpy.data.cameras.new("camera")
    camera.angle = math.pi / 2
    camera.clip_start = 1e-3
    eye = bpy.data.objects.new("camera", camera)
    eye.rotation_euler = (math.pi / 2, 0, 0)
    settings = bpy.context.scene
    settings.collection.objects.link(eye)
    settings.camera, settings.world = eye, world
    settings.render.engine = "CYCLES"
    settings.render.resolution_x = settings.render.resolution_y = size
    settings.render.resolution_percentage = 100
    settings.render.image_settings.file_format = "OPEN_EXR"
    settings.render.image_settings.color_depth = "32"
    settings.render.filepath = str(out)
    cycles = settings.cycles
    cycles.device, cycles.samples = "CPU", samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type = "BOX"
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = 32
    cycles.transparent_max_bounces = 32
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    bpy.ops.render.render(write_still=True)
    return read_exr(out)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("--size", type=int, default=48)
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("cycles-out"))
    parser.add_argument("--bar", type=float, default=0.02)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    out = arguments.out.resolve()
    sky = environment()
    write_exr(out / "sky.exr", sky)
    write_exr(out / "sky-blender.exr", np.roll(sky, sky.shape[1] // 4, axis=1))
    worst = 0.0
    print("| scene | relative RMSE | mean, ours | mean, Cycles | bake s | Cycles s |")
    print("|---|---|---|---|---|---|")
    for name, parts in scenes().items():
        path = out / f"{name}.gltf"
        write_gltf(path, parts)
        begun = time.monotonic()
        ours = bake(arguments.program.resolve(), path, out / "sky.exr", out / name, arguments.size, arguments.samples // 16)
        baked = time.monotonic()
        theirs = render(path, out / "sky-blender.exr", out / f"{name}-cycles.exr", arguments.size, arguments.samples)
        rendered = time.monotonic()
        error = math.sqrt(((ours - theirs) ** 2).mean() / (theirs**2).mean())
        worst = max(worst, error)
        times = f"{baked - begun:.1f} | {rendered - baked:.1f}"
        print(f"| {name} | {100 * error:.2f} % | {ours.mean():.4f} | {theirs.mean():.4f} | {times} |", flush=True)
    sys.exit(worst >= arguments.bar)


if __name__ == "__main__":
    main()
