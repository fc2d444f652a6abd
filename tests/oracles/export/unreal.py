"""Unreal's editor script against a stand-in for the module `unreal` that knows the documented names only.

Unreal itself does not run here. Usage: python unreal.py <folder of the export>
"""

import json
import os
import runpy
import sys
import types

folder = os.path.abspath(sys.argv[1])
bake = json.load(open(os.path.join(folder, "probes.json"), encoding="utf-8"))


class Vector:
    def __init__(self, x, y, z):
        self.values = (x, y, z)

    def __sub__(self, other):
        return Vector(*(a - b for a, b in zip(self.values, other.values)))


class Properties:
    """An object that has the listed editor properties and no others."""

    NAMES = ()

    def __init__(self):
        self.set = {}

    def set_editor_property(self, name, value):
        assert name in self.NAMES, name
        self.set[name] = value


class AssetImportTask(Properties):
    NAMES = ("filename", "destination_path", "destination_name", "automated", "replace_existing", "save", "factory")


CAPTURE = ("reflection_source_type", "cubemap", "source_cubemap_angle", "brightness", "capture_offset")


class SphereReflectionCaptureComponent(Properties):
    NAMES = CAPTURE + ("influence_radius",)


class BoxReflectionCaptureComponent(Properties):
    NAMES = CAPTURE + ("box_transition_distance",)


class TextureCube:
    def __init__(self, path):
        self.path = path


class ReflectionCapture:
    COMPONENT = None

    def __init__(self, location):
        self.location, self.scale, self.label, self.folder = location, None, None, None
        self.component = self.COMPONENT()

    def get_component_by_class(self, wanted):
        assert isinstance(self.component, wanted)
        return self.component

    def set_actor_scale3d(self, scale):
        self.scale = scale

    def set_actor_label(self, label):
        self.label = label

    def set_folder_path(self, path):
        self.folder = path

    def get_folder_path(self):
        return self.folder


class SphereReflectionCapture(ReflectionCapture):
    COMPONENT = SphereReflectionCaptureComponent


class BoxReflectionCapture(ReflectionCapture):
    COMPONENT = BoxReflectionCaptureComponent


level, assets = [], {}


class EditorActorSubsystem:
    def spawn_actor_from_class(self, actor_class, location, rotation=None):
        level.append(actor_class(location))
        return level[-1]

    def get_all_level_actors(self):
        return list(level)

    def destroy_actor(self, actor):
        level.remove(actor)


class AssetTools:
    def import_asset_tasks(self, tasks):
        for task in tasks:
            name = os.path.splitext(os.path.basename(task.set["filename"]))[0]
            assert os.path.isfile(task.set["filename"]) and task.set["automated"]
            assets[task.set["destination_path"] + "/" + name] = TextureCube(task.set["filename"])


unreal = types.ModuleType("unreal")
unreal.Vector = Vector
unreal.AssetImportTask = AssetImportTask
unreal.TextureCube = TextureCube
unreal.ReflectionCapture = ReflectionCapture
unreal.SphereReflectionCapture = SphereReflectionCapture
unreal.BoxReflectionCapture = BoxReflectionCapture
unreal.SphereReflectionCaptureComponent = SphereReflectionCaptureComponent
unreal.BoxReflectionCaptureComponent = BoxReflectionCaptureComponent
unreal.EditorActorSubsystem = EditorActorSubsystem
unreal.ReflectionSourceType = types.SimpleNamespace(CAPTURED_SCENE=0, SPECIFIED_CUBEMAP=1)
unreal.AssetToolsHelpers = types.SimpleNamespace(get_asset_tools=AssetTools)
unreal.EditorAssetLibrary = types.SimpleNamespace(load_asset=assets.get)
unreal.get_editor_subsystem = lambda subsystem: subsystem()
unreal.log = lambda text: None
sys.modules["unreal"] = unreal

# Twice: a second run replaces what the first made.
for _ in range(2):
    runpy.run_path(os.path.join(folder, "import_probes.py"), run_name="__main__")
assert [actor.label for actor in level] == [probe["id"] for probe in bake["probes"]]
for actor, probe in zip(level, bake["probes"]):
    found = actor.component.set
    assert found["reflection_source_type"] == 1 and found["brightness"] == 1
    assert found["cubemap"].path == os.path.join(folder, probe["panorama"])
    offset = found["capture_offset"].values if "capture_offset" in found else (0, 0, 0)
    taken_at = [a + b for a, b in zip(actor.location.values, offset)]
    assert max(abs(a - b) for a, b in zip(taken_at, probe["position"])) < 1e-6
print(f"Unreal: the editor script makes {len(level)} captures through the documented names of its Python API")
