"""Makes a mesh and a scene from a patient's outlines: see README.md in this folder."""
