"""Helpers that build reports: printable HTML pages with tables and figures, and no scripts."""
from __future__ import annotations

import base64
import io
from html import escape
from pathlib import Path
from typing import Any, Iterable, Sequence

import numpy as np
import numpy.typing as npt

from . import Model
from ._files import replacing

Array = npt.NDArray[np.float64]

STYLE = (Path(__file__).parent / "_page.css").read_text(encoding="utf-8")
# Close to the Okabe-Ito palette, adjusted so that colour-blind readers can tell them apart on white; tests/view/colours_test.mjs tests this.
COLOURS = {"gland": "#e95d13", "urethra": "#0272de", "rectum": "#754a00"}
PLANNED, ACHIEVED = "#5e3aac", "#0c6f4a"
OUTLINES = "#88919f"


def svg(drawn: Any) -> str:
    """Returns a figure as SVG text, reproducibly: the same figure always gives the same text."""
    import matplotlib
    out = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "trocar", "svg.fonttype": "none"}):
        drawn.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def figure(width: float, height: float, widths: Sequence[float] = (1,)) -> tuple[Any, Sequence[Any]]:
    """Creates a figure of the given size in inches, with a row of panels of relative `widths`."""
    from matplotlib.figure import Figure
    drawn = Figure(figsize=(width, height), layout="constrained")
    return drawn, np.atleast_1d(drawn.subplots(1, len(widths), width_ratios=widths))


def section(model: Model, tets: npt.NDArray[np.int32], axis: int, at: float) -> Array:
    """Cuts the surface of a set of tetrahedra with the plane where coordinate `axis` is `at`, and returns the outline as segments (n, 2, 3) m."""
    faces = np.sort(np.concatenate([np.delete(tets, corner, axis=1) for corner in range(4)]), axis=1)
    unique, times = np.unique(faces, axis=0, return_counts=True)
    corners = model.nodes[unique[times == 1]]
    height = corners[:, :, axis] - at - 1e-9
    segments = []
    for triangle, above in zip(corners, height):
        crossings = [triangle[i] + above[i] / (above[i] - above[k]) * (triangle[k] - triangle[i]) for i, k in ((0, 1), (1, 2), (2, 0)) if (above[i] > 0) != (above[k] > 0)]
        if len(crossings) == 2:
            segments.append(crossings)
    return np.array(segments).reshape(-1, 2, 3)


def image(drawing: str, words: str) -> str:
    """Returns HTML that embeds an SVG image. `words` is both the caption and the alternative text."""
    data = base64.b64encode(drawing.encode()).decode()
    return f'<figure><img src="data:image/svg+xml;base64,{data}" alt="{escape(words)}"><figcaption>{escape(words)}</figcaption></figure>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str, numbers: Sequence[int] = ()) -> str:
    """Returns an HTML table; cells are plain text. `numbers`: indices of the columns to right-align."""
    cell = lambda i, text, tag="td": f'<{tag}{" class=number" if i in numbers else ""}>{escape(text)}</{tag}>'
    header = "".join(f'<th scope="col"{" class=number" if i in numbers else ""}>{escape(text)}</th>' if text else "<td></td>" for i, text in enumerate(head))
    body = "".join("<tr>" + "".join(cell(i, text) for i, text in enumerate(row)) + "</tr>\n" for row in rows)
    return f"<table><caption>{escape(caption)}</caption>\n<thead><tr>{header}</tr></thead>\n<tbody>\n{body}</tbody></table>\n"


def page(title: str, parts: Iterable[str], language: str = "en") -> str:
    """Returns a complete HTML page. `parts`: the HTML of the elements of its body."""
    return (f"<!DOCTYPE html>\n<html lang=\"{language}\">\n<head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">"
            f"<title>{escape(title)}</title>\n<style>\n{STYLE}</style></head>\n<body><main>\n" + "\n".join(parts) + "\n</main></body>\n</html>\n")


def save(path: Path, text: str) -> None:
    """Writes a text file atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
