"""From a patient's outlines to a mesh and a scene: see README.md beside this file."""
