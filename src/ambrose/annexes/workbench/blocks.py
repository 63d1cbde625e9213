"""What a screen is made of, as plain data: the page draws it (static/screen.js), the screens fill
it (screens/).

A screen is a list of blocks; each has a key, by which the page tells which of them changed, and a
title or none. Words are words: the page never reads them as markup. A picture is SVG that
``annexes.workbench.svg`` made.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ambrose.annexes.workbench.svg import svg
from ambrose.core.checks import InvalidInput, invalid
from ambrose.report.page import Cell, Figure, Page, Table

Block = dict[str, Any]


def _block(kind: str, key: str, title: str, **more: Any) -> Block:
    return {"key": key, "kind": kind, "title": title, **more}


def words(key: str, text: str, title: str = "", tone: str = "") -> Block:
    """A paragraph; tone: "", "good", "bad" or "muted"."""
    return _block("words", key, title, text=text, tone=tone)


def table(key: str, content: Table, folded: bool = False) -> Block:
    """A table of the reports; folded: closed until it is opened."""
    rows = [[_cell(cell) for cell in row] for row in content.cells]
    more = {"columns": list(content.columns), "rows": rows, "note": content.note}
    return _block("table", key, content.title, folded=folded, **more)


def _cell(cell: Cell) -> dict[str, str]:
    return {"text": f"{cell.symbol} {cell.text}".strip(), "mark": cell.mark}


def picture(
    key: str, svg: str, title: str = "", caption: str = "", half: bool = False, **more: Any
) -> Block:
    """A drawing; half: another may stand beside it; more: handles on it, and the px of a decade."""
    return _block("picture", key, title, svg=svg, caption=caption, half=half, **more)


def chains(key: str, title: str, document: Any, kinds: Mapping[str, Any], **more: Any) -> Block:
    """The filters of every channel as rows; document: a [controller] table whose channels have a
    chain each; kinds: of a filter, its keys with label, unit, factor to the unit and first value.
    """
    return _block("chains", key, title, document=document, kinds=kinds, **more)


def grid(key: str, title: str, document: Any, columns: Mapping[str, Any], **more: Any) -> Block:
    """Lists of tables as a spreadsheet; document: of every list its rows of cells; columns: of
    every list key, name, unit and whether it is shown at first; more: fresh, where the rows are not
    those of a file.
    """
    return _block("grid", key, title, document=document, columns=columns, **more)


def page(key: str, file: Path, title: str) -> Block:
    """A page of results of the project, shown and to be opened alone; anew where it was written
    anew.
    """
    address = f"/files/{file.parent.name}/{file.name}?{file.stat().st_mtime_ns}"
    return _block("page", key, title, src=address)


def link(key: str, address: str, text: str) -> Block:
    """A file to take along."""
    return _block("link", key, "", href=address, text=text)


def same(command: str, *lines: str) -> Block:
    """The command and the lines of Python that do the same."""
    given = {"Command line": command, "Python": "\n".join(("import ambrose as amb", *lines))}
    return _block("same", "same", "", lines=given)


def form(
    key: str,
    fields: Iterable[Block],
    buttons: Sequence[Block] = (),
    title: str = "",
    *,
    live: str = "",
    folded: bool = False,
    hint: str = "",
    tone: str = "",
    **more: Any,
) -> Block:
    """Fields and buttons; live: the action that every change asks for; more: log, words as they
    were printed, and same, what does the same.
    """
    known = list(fields)
    # a button that needs one of no files cannot act, and says what is missing
    empty = [item["label"] for item in known if item["kind"] == "choice" and not item["options"]]
    if empty:
        buttons = [{**item, "off": f"There is no {empty[0].lower()} yet"} for item in buttons]
    own = {"fields": known, "buttons": list(buttons), "live": live, "folded": folded}
    return _block("form", key, title, hint=hint, tone=tone, **own, **more)


def field(name: str, label: str, value: Any = "", kind: str = "text", **more: Any) -> Block:
    """One field; kind: "text", "area", "check", "file" (to: the folder that takes it), "choice"
    (options) or "slider" (low, high, unit, factor to the unit, log: low and high are exponents of
    ten). action: what a change asks for, in place of the form's; heading: above it.
    """
    return {"name": name, "label": label, "value": value, "kind": kind, **more}


def choice(name: str, label: str, options: Sequence[str], value: str = "") -> Block:
    """A field that takes one of some words."""
    chosen = value if value in options else (options[0] if options else "")
    return field(name, label, chosen, "choice", options=list(options))


def button(text: str, action: str, *, main: bool = False, **more: Any) -> Block:
    """A button that asks for an action of the screen, or with an address of the server that; more:
    what goes with it beside the fields.
    """
    return {"text": text, "action": action, "main": main, "more": more}


def job(text: str, kind: str) -> Block:
    """A button that starts a job of a kind, with the fields beside it."""
    return button(text, "/api/jobs/start", main=True, kind=kind)


def rows_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """A table of the reports from rows of words and cells."""
    return Table(title, tuple(columns), tuple(tuple(row) for row in rows))


def content(
    blocks: Sequence[Block],
    *,
    stamp: str = "",
    jobs: Sequence[str] = (),
    whole: bool = True,
    told: str = "",
    gone: Sequence[str] = (),
) -> dict[str, Any]:
    """An answer to the page: the blocks of a screen, or (not whole) those that changed, and the
    keys of those that are gone.

    stamp: of the file that the screen edits; jobs: the commands whose jobs stand below it; told:
    what was done, in words.
    """
    found = {"blocks": list(blocks), "stamp": stamp, "jobs": list(jobs), "gone": list(gone)}
    return {**found, "whole": whole, "told": told}


class Refusal(Exception):
    """What the page is told beside its fields: a sentence, and sentences by the name of a field;
    stale: what the page holds was overtaken.
    """

    def __init__(
        self, text: str, fields: Mapping[str, str] | None = None, stale: bool = False
    ) -> None:
        super().__init__(text)
        self.content = {"error": text, "fields": dict(fields or {}), "stale": stale}


# A page of the reports as blocks of a screen: its verdicts, its pictures, its tables.


_DRAWN = {"scatter", "scattergl"}  # kinds of traces that ``annexes.workbench.svg`` knows
_MANY = 300_000  # letters of a picture that is left to the page itself


def blocks_of(page: Page, width: int) -> list[Block]:
    """The verdict first, then every section; pictures that are no lines are left to the page."""
    found = []
    if page.result is not None:
        passed = page.result.passed
        tone = "" if passed is None else "good" if passed else "bad"
        text = page.result.text[:1].upper() + page.result.text[1:]
        found.append(words("verdict", text, tone=tone))
    if page.verdicts:
        rows = [(Cell(v.label, v.mark), v.text) for v in page.verdicts]
        found.append(table("verdicts", rows_table("Verdicts", ("what", "verdict"), rows)))
    for i, section in enumerate(page.sections):
        found += _pictures(f"section-{i}", section.figures, width)
        for k, known in enumerate(section.tables):
            found.append(table(f"section-{i}-table-{k}", known, folded=section.folded))
    return found


def _pictures(key: str, figures: tuple[Figure, ...], width: int) -> list[Block]:
    found = []
    for k, item in enumerate(figures):
        kinds = {str(trace.type) for trace in item.picture.data}
        if getattr(item.picture, "frames", ()) or not kinds <= _DRAWN:
            continue
        drawing = svg(item.picture, width, item.title, f"{key}-{k}")
        if len(drawing) < _MANY:
            found.append(picture(f"{key}-{k}", drawing, item.title, item.caption))
    return found


# What a page gives, looked at before it is used. Each raises InvalidInput.


_LONGEST = 200  # characters of a word
_WIDE = (280, 1600)  # [px] of a picture


def word(given: Mapping[str, Any], name: str, longest: int = _LONGEST) -> str:
    """A text, "" where there is none."""
    value = given.get(name, "")
    if not isinstance(value, str) or len(value) > longest:
        wanted = f"a text of at most {longest} characters"
        raise invalid(name, str(value)[:40], wanted, "shorten it")
    return value


def number(given: Mapping[str, Any], name: str, default: float | None = None) -> float:
    """A finite number."""
    value = given.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e15:
        raise invalid(name, str(value)[:40], "a finite number", "give it in SI units")
    return float(value)


def width(given: Mapping[str, Any]) -> int:
    """How wide a picture may be [px]."""
    return int(min(max(number(given, "width", 900), _WIDE[0]), _WIDE[1]))


def texts(given: Mapping[str, Any], most: int) -> dict[str, str]:
    """All fields of a form that are texts."""
    if len(given) > most:
        raise InvalidInput(f"a form has {most} fields at most; reload the page")
    return {name: value for name, value in given.items() if isinstance(value, str)}
