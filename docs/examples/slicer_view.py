"""Shows what trocar-slicer sends. For 3D Slicer's Python console, with the extension SlicerOpenIGTLink; see docs/devices/slicer.md."""
import json

import slicer


def node(kind, name):
    """The connector fills the nodes whose names are those of its messages, and creates missing nodes."""
    return slicer.mrmlScene.GetFirstNode(name, kind) or slicer.mrmlScene.AddNewNodeByClass(kind, name)


for name, colour, opacity in (("Needle", (1.0, 0.9, 0.3), 1.0), ("prostate", (0.9, 0.5, 0.4), 0.4), ("surrounding", (0.8, 0.7, 0.6), 0.1)):
    model = node("vtkMRMLModelNode", name)
    model.CreateDefaultDisplayNodes()
    model.GetDisplayNode().SetColor(*colour)
    model.GetDisplayNode().SetOpacity(opacity)
    model.GetDisplayNode().SetLineWidth(4)

status = node("vtkMRMLTextNode", "TrocarStatus")
status.AddObserver(slicer.vtkMRMLTextNode.TextModifiedEvent, lambda *_: slicer.util.showStatusMessage(
    "; ".join(f"{needle['depth_mm']:.1f} mm, {needle['force_N']:.2f} N" for needle in json.loads(status.GetText())["needles"]) or "no needle"))

connector = node("vtkMRMLIGTLConnectorNode", "trocar")
connector.SetTypeClient("localhost", 18944)
connector.Start()
