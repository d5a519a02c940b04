"""Generates synthetic patients and runs the program on many of them, for tests and for the tables in docs/results/anatomy. Not installed."""
