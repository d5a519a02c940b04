"""Synthetic patients and runs over many of them, for tests and for the reports in meshes/. Not installed."""
