"""Studies of many insertions in one scene, and planning by simulated insertions."""
