"""Makes reflection captures of a splatprobe bake that was exported with --engine unreal.

In the Unreal editor (5.x, with the plugins "Python Editor Script Plugin" and "Editor Scripting Utilities"), with the level
open that the probes belong to, run by Tools > Execute Python Script, or in the console:

    py "C:/path/to/export/import_probes.py"

Panoramas become TextureCube assets under /Game/Splatprobe/<folder>. Captures of an earlier run for the same folder are
replaced. Then choose Build > Build Reflection Captures.
"""

import json
import os

import unreal

FOLDER = os.path.dirname(os.path.abspath(__file__))


def import_panorama(path, content_folder):
    """Imports a longitude-latitude .hdr; returns the TextureCube."""
    task = unreal.AssetImportTask()
    task.set_editor_property("filename", path)
    task.set_editor_property("destination_path", content_folder)
    task.set_editor_property("automated", True)
    task.set_editor_property("replace_existing", True)
    task.set_editor_property("save", True)
    unreal.AssetToolsHelpers.get_asset_tools().import_asset_tasks([task])
    name = os.path.splitext(os.path.basename(path))[0]
    asset = unreal.EditorAssetLibrary.load_asset(content_folder + "/" + name)
    if not isinstance(asset, unreal.TextureCube):
        raise RuntimeError("{} did not become a TextureCube but {}".format(path, type(asset).__name__))
    return asset


def spawn(probe, brightness, cubemap, outliner_folder):
    """Makes the capture of a probe. Numbers are in Unreal's world space, in centimetres."""
    position = unreal.Vector(*probe["position"])
    actors = unreal.get_editor_subsystem(unreal.EditorActorSubsystem)
    if "box" in probe:
        box = probe["box"]
        centre = unreal.Vector(*box["centre"])
        actor = actors.spawn_actor_from_class(unreal.BoxReflectionCapture, centre)
        # A box capture's scale is half of its size.
        actor.set_actor_scale3d(unreal.Vector(*box["halfSize"]))
        component = actor.get_component_by_class(unreal.BoxReflectionCaptureComponent)
        component.set_editor_property("box_transition_distance", box["transitionDistance"])
        component.set_editor_property("capture_offset", position - centre)
    else:
        actor = actors.spawn_actor_from_class(unreal.SphereReflectionCapture, position)
        component = actor.get_component_by_class(unreal.SphereReflectionCaptureComponent)
        component.set_editor_property("influence_radius", probe["sphere"]["radius"])
    component.set_editor_property("reflection_source_type", unreal.ReflectionSourceType.SPECIFIED_CUBEMAP)
    component.set_editor_property("cubemap", cubemap)
    component.set_editor_property("source_cubemap_angle", 0.0)
    component.set_editor_property("brightness", brightness)
    actor.set_actor_label(probe["id"])
    actor.set_folder_path(outliner_folder)
    return actor


def remove_earlier(outliner_folder):
    actors = unreal.get_editor_subsystem(unreal.EditorActorSubsystem)
    for actor in actors.get_all_level_actors():
        if isinstance(actor, unreal.ReflectionCapture) and str(actor.get_folder_path()) == outliner_folder:
            actors.destroy_actor(actor)


def main():
    with open(os.path.join(FOLDER, "probes.json"), encoding="utf-8") as file:
        bake = json.load(file)
    name = "".join(c if c.isalnum() else "_" for c in os.path.basename(FOLDER))
    content_folder = "/Game/Splatprobe/" + name
    outliner_folder = "Splatprobe/" + name
    remove_earlier(outliner_folder)
    for probe in bake["probes"]:
        cubemap = import_panorama(os.path.join(FOLDER, probe["panorama"]), content_folder)
        spawn(probe, bake["brightness"], cubemap, outliner_folder)
    unreal.log("Splatprobe: {} reflection captures; now build reflection captures".format(len(bake["probes"])))


main()
