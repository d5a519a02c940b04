"""Makes a mesh and a scene from a patient's contours. See README.md in this folder."""
