"""Prints tables of results as CSV."""
import csv
import sys


def row(*cells):
    """Prints one line of a table at once."""
    csv.writer(sys.stdout, lineterminator="\n").writerow(cells)
    sys.stdout.flush()
