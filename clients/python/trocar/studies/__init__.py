"""Studies of many insertions on one scene, and planning, which rehearses insertions."""
