"""From a patient's outlines to a mesh and a scene: see README.md in this folder."""
