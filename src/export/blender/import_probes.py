"""Sets up Blender's world and light probes from a splatprobe bake that was exported with --engine blender.

    blender scene.blend --python import_probes.py            # the world from the first probe
    blender scene.blend --python import_probes.py -- probe_002

or open it in the text editor and run it. Needs Blender 4.1 or later.

The world is lit by one probe's panorama, as seen from where it was taken: right for what stands near that probe. Blender
cannot load images into light probes; the objects made here stand where the bake's probes stand, with their boxes, so that
EEVEE captures your scene, with that world around it, where the bake did.
"""

import json
import os
import sys

import bpy

FOLDER = os.path.dirname(os.path.abspath(__file__))
COLLECTION = "Splatprobe"


def load():
    with open(os.path.join(FOLDER, "probes.json"), encoding="utf-8") as file:
        return json.load(file)


def set_world(bake, probe, scene):
    """Lights the scene's world with the panorama of a probe."""
    world = bpy.data.worlds.new(probe["id"])
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(os.path.join(FOLDER, probe["panorama"]), check_existing=True)
    # Radiance is linear with Rec.709 primaries already.
    texture.image.colorspace_settings.name = "Linear Rec.709"
    texture.projection = "EQUIRECTANGULAR"
    background = nodes.new("ShaderNodeBackground")
    background.inputs["Strength"].default_value = bake["strength"]
    out = nodes.new("ShaderNodeOutputWorld")
    links.new(texture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], out.inputs["Surface"])
    scene.world = world
    return world


def make_probes(bake, scene):
    """A light probe object per probe, in a collection of their own; those of an earlier run are replaced."""
    collection = bpy.data.collections.get(COLLECTION)
    if collection is None:
        collection = bpy.data.collections.new(COLLECTION)
        scene.collection.children.link(collection)
    for earlier in list(collection.objects):
        bpy.data.objects.remove(earlier)
    for probe in bake["probes"]:
        data = bpy.data.lightprobes.new(probe["id"], "SPHERE")
        data.influence_type = "BOX"
        # Distances are in units of the object's scale.
        data.influence_distance = 1.0
        data.falloff = probe["falloff"]
        if probe["parallaxHalfSize"] != probe["halfSize"]:
            # One distance for all axes, in the same units: it reaches every face of the proxy box.
            data.use_custom_parallax = True
            data.parallax_type = "BOX"
            ratios = [p / h for p, h in zip(probe["parallaxHalfSize"], probe["halfSize"])]
            data.parallax_distance = max(ratios)
        thing = bpy.data.objects.new(probe["id"], data)
        thing.location = probe["position"]
        thing.scale = probe["halfSize"]
        collection.objects.link(thing)
    return collection


def main(arguments):
    bake = load()
    by_id = {probe["id"]: probe for probe in bake["probes"]}
    wanted = arguments[0] if arguments else bake["probes"][0]["id"]
    if wanted not in by_id:
        raise SystemExit("no probe {}; there are {}".format(wanted, ", ".join(by_id)))
    scene = bpy.context.scene
    make_probes(bake, scene)
    set_world(bake, by_id[wanted], scene)


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
