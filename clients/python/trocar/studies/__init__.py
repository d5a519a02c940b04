"""Studies of many insertions in one scene, planning by simulated insertions, and fits of a scene to recorded insertions."""
