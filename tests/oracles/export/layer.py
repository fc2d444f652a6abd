"""usd-core on an export: all validators pass, and each variant lights the stage with its probe.

Usage: python layer.py probes.usda
"""

import os
import sys

from pxr import Usd, UsdGeom, UsdLux, UsdValidation

path = sys.argv[1]
stage = Usd.Stage.Open(path)
validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
errors = UsdValidation.ValidationContext(validators).Validate(stage)
assert not errors, [(error.GetName(), error.GetMessage()) for error in errors]

assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y and UsdGeom.GetStageMetersPerUnit(stage) == 1
root = stage.GetDefaultPrim()
environment = root.GetVariantSets().GetVariantSet("environment")
names = environment.GetVariantNames()
probes = stage.GetPrimAtPath(root.GetPath().AppendPath("Probes")).GetChildren()
assert names == [probe.GetName() for probe in probes] and environment.GetVariantSelection() == names[0]
for probe in probes:
    environment.SetVariantSelection(probe.GetName())
    light = UsdLux.DomeLight(stage.GetPrimAtPath(root.GetPath().AppendPath("Environment")))
    texture = light.GetTextureFileAttr().Get()
    assert os.path.samefile(texture.resolvedPath, probe.GetAttribute("splatprobe:panorama").Get().resolvedPath)
    assert light.GetTextureFormatAttr().Get() == UsdLux.Tokens.latlong
    position = UsdGeom.XformCache().GetLocalToWorldTransform(probe).ExtractTranslation()
    low, high = (probe.GetAttribute("splatprobe:influence:" + end).Get() for end in ("min", "max"))
    assert all(l <= p <= h for l, p, h in zip(low, position, high)), (low, position, high)
    assert len(probe.GetAttribute("splatprobe:sh").Get()) >= 9
print(f"usd-core {'.'.join(map(str, Usd.GetVersion()))}: {len(validators)} validators pass, {len(names)} variants")
