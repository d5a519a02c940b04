#!/usr/bin/python3
"""Tests the scripts for 3D Slicer, docs/examples/slicer_*.py, with a stand-in for Slicer and SlicerOpenIGTLink. It provides only the classes and functions that
the scripts may use, as declared in the originals' sources.

usage: test_scripts.py SOURCE_DIR
"""
import runpy
import sys
from types import ModuleType, SimpleNamespace

CLASSES = {    # declared in Libs/MRML/Core in Slicer and in OpenIGTLinkIF/MRML/vtkMRMLIGTLConnectorNode.h in SlicerOpenIGTLink
    "vtkMRMLModelNode": ("CreateDefaultDisplayNodes", "GetDisplayNode"),
    "display": ("SetColor", "SetOpacity", "SetLineWidth"),
    "vtkMRMLTextNode": ("AddObserver", "GetText"),
    "vtkMRMLLinearTransformNode": (),
    "vtkMRMLIGTLConnectorNode": ("SetTypeClient", "Start", "RegisterOutgoingMRMLNode"),
}
STATUS = '{"server": true, "coordinates": "mesh, mm", "needles": [{"state": "held", "owned": true, "depth_mm": 12.5, "force_N": 0.4, "contacts": 3, "flags": []}]}'
calls, shown, nodes = [], [], {}


class Node:
    def __init__(self, kind, name):
        self.kind, self.name = kind, name

    def __getattr__(self, function):
        if function not in CLASSES[self.kind]:
            raise AttributeError(f"{self.kind} has no {function}")
        return lambda *values: self.call(function, values)

    def call(self, function, values):
        calls.append((self.name, function, values))
        return {"GetDisplayNode": Node("display", self.name), "GetText": STATUS}.get(function)


def add_node(kind, name):
    return nodes.setdefault(name, Node(kind, name))


slicer = ModuleType("slicer")
slicer.mrmlScene = SimpleNamespace(GetFirstNode=lambda name, kind: nodes.get(name), AddNewNodeByClass=add_node)
slicer.util = SimpleNamespace(showStatusMessage=shown.append, getNode=nodes.__getitem__)
slicer.vtkMRMLTextNode = SimpleNamespace(TextModifiedEvent=1)
sys.modules["slicer"] = slicer
for script in ("slicer_view.py", "slicer_drive.py"):
    runpy.run_path(f"{sys.argv[1]}/docs/examples/{script}")

done = [(name, function) for name, function, _ in calls]
assert ("trocar", "SetTypeClient", ("localhost", 18944)) in calls and ("trocar", "Start") in done, calls
assert ("trocar", "RegisterOutgoingMRMLNode", (nodes["StylusToReference"],)) in calls, calls
assert {"Needle", "prostate", "TrocarStatus"} <= set(nodes), nodes
observer = next(values[1] for name, function, values in calls if function == "AddObserver")
observer(None, None)
assert shown == ["12.5 mm, 0.40 N"], shown
print("passed")
