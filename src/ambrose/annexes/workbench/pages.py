"""A page of the reports as blocks of a screen: its verdicts, its pictures, its tables."""

from __future__ import annotations

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Block
from ambrose.report.page import Cell, Figure, Page
from ambrose.report.svg import svg

_DRAWN = {"scatter", "scattergl"}  # kinds of traces that ``report.svg`` knows
_MANY = 300_000  # letters of a picture that is left to the page itself


def blocks_of(page: Page, width: int) -> list[Block]:
    """Verdicts first, then every section; pictures that are no lines are left to the page."""
    found = []
    if page.verdicts:
        rows = [(Cell(v.label, v.mark), v.text) for v in page.verdicts]
        title = "Verdicts"
        if page.result is not None:
            title = page.result.text[:1].upper() + page.result.text[1:]
        found.append(blocks.table("verdicts", blocks.rows_table(title, ("what", "verdict"), rows)))
    for i, section in enumerate(page.sections):
        found += _pictures(f"section-{i}", section.figures, width)
        for k, known in enumerate(section.tables):
            found.append(blocks.table(f"section-{i}-table-{k}", known, folded=section.folded))
    return found


def _pictures(key: str, figures: tuple[Figure, ...], width: int) -> list[Block]:
    found = []
    for k, item in enumerate(figures):
        kinds = {str(trace.type) for trace in item.picture.data}
        if getattr(item.picture, "frames", ()) or not kinds <= _DRAWN:
            continue
        drawing = svg(item.picture, width, item.title, f"{key}-{k}")
        if len(drawing) < _MANY:
            found.append(blocks.picture(f"{key}-{k}", drawing, item.title, item.caption))
    return found
