"""Lets a transform of the scene drive the needle: that of a tracker from which Slicer receives data, or one that is moved by hand in the module Transforms. Run
it after slicer_view.py. For 3D Slicer's Python console; see docs/devices/slicer.md."""
import slicer

connector = slicer.util.getNode("trocar")
stylus = slicer.mrmlScene.GetFirstNode("StylusToReference", "vtkMRMLLinearTransformNode") or \
    slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode", "StylusToReference")
connector.RegisterOutgoingMRMLNode(stylus)    # sent whenever it changes
