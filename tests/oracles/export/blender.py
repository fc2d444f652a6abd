"""Blender on an export of a calibration bake: its script runs, and Cycles shows every direction where it is.

Usage: python blender.py <folder of the export> (a Python that has bpy)
"""

import json
import math
import os
import runpy
import sys
import tempfile

import bpy
import numpy as np
from mathutils import Matrix, Vector

folder = os.path.abspath(sys.argv[1])
EDGE = 64
bake = json.load(open(os.path.join(folder, "probes.json"), encoding="utf-8"))
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene

worst = 0.0
for probe in bake["probes"]:
    sys.argv = ["blender", "--", probe["id"]]
    runpy.run_path(os.path.join(folder, "import_probes.py"), run_name="__main__")
    objects = bpy.data.collections["Splatprobe"].objects
    assert {o.name for o in objects} == {p["id"] for p in bake["probes"]}, list(objects)
    thing = objects[probe["id"]]
    assert thing.type == "LIGHT_PROBE" and thing.data.type == "SPHERE"
    assert max(abs(a - b) for a, b in zip(thing.location, probe["position"])) < 1e-5
    assert max(abs(a - b) for a, b in zip(thing.scale, probe["halfSize"])) < 1e-5

    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 1
    scene.cycles.use_denoising = False
    scene.cycles.filter_width = 0.01
    scene.render.resolution_x = scene.render.resolution_y = EDGE
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.view_settings.view_transform = "Raw"
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.data.angle = math.pi / 2

    for axis in [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]:
        rotation = Vector(axis).to_track_quat("-Z", "Y")
        camera.matrix_world = rotation.to_matrix().to_4x4()
        with tempfile.TemporaryDirectory() as work:
            scene.render.filepath = os.path.join(work, "view.exr")
            bpy.ops.render.render(write_still=True)
            image = bpy.data.images.load(scene.render.filepath)
            pixels = np.array(image.pixels[:], dtype=np.float64).reshape(EDGE, EDGE, 4)[:, :, :3]
            bpy.data.images.remove(image)
        # Rows from the bottom.
        place = (np.arange(EDGE) + 0.5) / EDGE * 2 - 1
        x, y = np.meshgrid(place, place)
        directions = np.stack([x, y, -np.ones_like(x)], axis=2) @ np.array(Matrix(rotation.to_matrix())).T
        directions /= np.linalg.norm(directions, axis=2, keepdims=True)
        # Blender's (x, y, z) is the manifest's (x, z, -y).
        expected = np.stack([directions[:, :, 0], directions[:, :, 2], -directions[:, :, 1]], axis=2)
        # Radiance is k (d + 1) / 2 of a unit vector d for an unknown factor k: marks are brighter.
        total, square = pixels.sum(axis=2), (pixels**2).sum(axis=2)
        root = np.sqrt(np.maximum(total**2 - 2 * square, 0))
        angles = []
        for sign in (-1, 1):
            found = pixels * ((total + sign * root) / square)[:, :, None] - 1
            found /= np.linalg.norm(found, axis=2, keepdims=True)
            angles.append(np.arccos(np.clip((found * expected).sum(axis=2), -1, 1)))
        worst = max(worst, np.minimum(*angles).max())
    bpy.data.objects.remove(camera)

texel = 2 / (bpy.data.images[bake["probes"][0]["panorama"]].size[1] / 2)
print(f"Blender {bpy.app.version_string}: directions are within {worst / texel:.2f} texels in Cycles")
assert worst < texel
