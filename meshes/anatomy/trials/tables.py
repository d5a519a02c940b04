"""Prints tables of results as CSV."""
import csv
import sys


def row(*cells):
    """Prints one row of a table and flushes the output."""
    csv.writer(sys.stdout, lineterminator="\n").writerow(cells)
    sys.stdout.flush()
