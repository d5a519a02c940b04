"""Generates synthetic patients and runs the program on them, for tests and for the tables in docs/results/anatomy. Not installed."""
