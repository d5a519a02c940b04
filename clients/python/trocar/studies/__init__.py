"""Studies of many insertions in one scene, planning by simulation, and fitting a scene to recorded insertions."""
