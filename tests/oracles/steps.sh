#!/usr/bin/env bash
# Checks the steps that are not run here against what their engines say of them: Kubernetes and GitHub Actions by their
# schemas, Bazel's by a Starlark interpreter. Needs a Python with kubernetes-validate, check-jsonschema, starlark-pyo3 and
# pyyaml in $PYTHON.
set -euo pipefail
cd "$(dirname "$0")/../../pipelines"
python=${PYTHON:-python3}

for file in kubernetes/*.yaml; do "$python" -m kubernetes_validate "$file"; done
"$python" -m check_jsonschema --builtin-schema vendor.github-workflows github-actions/*.yml
"$python" - bazel/splatprobe.bzl << 'PYTHON'
import sys

import starlark

# Stand-ins for what Bazel has: attributes are what they are called with, and an action is what is recorded of it.
module = starlark.Module()
calls = []
module.add_callable("_run", lambda **arguments: calls.append(arguments))
text = """
def rule(implementation, doc, attrs):
    return sorted(attrs)

def _attribute(allow_files = False, allow_single_file = [], executable = False, cfg = "", mandatory = False, default = None, doc = ""):
    return doc

def depset(files):
    return files

def DefaultInfo(files):
    return files

attr = struct(label = _attribute, label_list = _attribute, bool = _attribute)
""" + open(sys.argv[1]).read() + """
context = struct(
    label = struct(name = "room"),
    actions = struct(
        declare_directory = lambda name: struct(path = "bin/" + name),
        run = lambda **given: _run(arguments = given["arguments"], inputs = len(given["inputs"])),
    ),
    executable = struct(splatprobe = "splatprobe"),
    file = struct(job = struct(path = "room.json")),
    files = struct(data = ["room.ply", "lamp.glb"]),
    attr = struct(machine_dependent = True),
)
_splatprobe_bake_impl(context)
splatprobe_bake
"""
dialect = starlark.Dialect.extended()
globals = starlark.Globals.extended_by([starlark.LibraryExtension.StructType])
print(starlark.eval(module, starlark.parse(sys.argv[1], text, dialect), globals))
assert calls == [{"arguments": ["bake", "room.json", "-o", "bin/room", "--no-cache", "--progress", "none"], "inputs": 3}], calls
print("the action is", calls[0]["arguments"])
PYTHON
