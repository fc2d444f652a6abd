"""usd-core on an export: the compliance checker and the validators pass, and each variant lights the stage with its probe.

Usage: python layer.py probes.usda
"""

import os
import sys

from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdUtils

path = sys.argv[1]
checker = UsdUtils.ComplianceChecker(arkit=False, skipARKitRootLayerCheck=True)
checker.CheckCompliance(path)
problems = checker.GetErrors() + checker.GetFailedChecks() + checker.GetWarnings()
assert not problems, problems

stage = Usd.Stage.Open(path)
count = "no"
try:
    from pxr import UsdValidation

    registry = UsdValidation.ValidationRegistry()
    errors = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators()).Validate(stage)
    assert not errors, [(error.GetName(), error.GetMessage()) for error in errors]
    count = len(registry.GetOrLoadAllValidators())
except ImportError:
    pass

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
print(f"usd-core {'.'.join(map(str, Usd.GetVersion()))}: compliance checker and {count} validators pass, {len(names)} variants")
