"""Writes the reports of tests/verification and tests/validation: REPORT.md, and plots/ in the script's folder."""
import contextlib
import subprocess

import matplotlib

matplotlib.use("svg")
matplotlib.rcParams["svg.fonttype"] = "none"  # keeps text as text in the SVG file
matplotlib.rcParams["svg.hashsalt"] = "trocar"  # makes the output file reproducible
import matplotlib.pyplot as plt  # noqa: E402

# The palette of Okabe and Ito, whose colours people with colour-vision deficiency can tell apart.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


def cell(text):
    return str(text).replace("|", "\\|")


def line(cells):
    return "| " + " | ".join(map(cell, cells)) + " |"


def output_of(folder, *command):
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def commit_of(folder):
    return output_of(folder, "git", "describe", "--always", "--dirty")


@contextlib.contextmanager
def axes_for(curves, path):
    """Provides axes for the curves, labelled as the first curve says, and saves the plot on exit."""
    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    yield axes
    axes.set_xlabel(curves[0]["x_label"])
    axes.set_ylabel(curves[0]["y_label"])
    axes.grid(color="0.9", linewidth=0.6)
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def write(folder, lines):
    """Replaces plots/ and REPORT.md. The function that generates the lines may also create files in plots/."""
    plots = folder / "plots"
    plots.mkdir(exist_ok=True)
    for old in plots.glob("*.svg"):
        old.unlink()
    (folder / "REPORT.md").write_text("\n".join(lines))
