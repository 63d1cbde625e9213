"""What a screen is made of, as plain data: the page draws it (static/screen.js), the screens fill
it (screens/).

A screen is a list of blocks; each has a key, by which the page tells which of them changed, and a
title or none. Words are words: the page never reads them as markup. A picture is SVG that
``annexes.workbench.svg`` made.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambrose.annexes.workbench.svg import svg
from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.part import PidSettings
from ambrose.report.page import Cell, Figure, Page

if TYPE_CHECKING:
    from ambrose.report.page import Table


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


def picture(key: str, svg: str, title: str = "", caption: str = "", half: bool = False) -> Block:
    """A drawing; half: another may stand beside it."""
    return _block("picture", key, title, svg=svg, caption=caption, half=half)


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
    from ambrose.report.page import Table  # with all that reports need, which the server does not

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


# The numbers of a [controller] as sliders, a decade to both sides of where they stand.


_DECADES = 1.0  # a slider's reach on either side of the value


def fields_of(settings: PidSettings, axes: Sequence[str]) -> list[Block]:
    """A slider for every number."""
    found = []
    for item in numbers_of(settings):
        by_axis = item.place[0] == "gain" and len(settings.gain) == len(axes)
        label = f"gain {axes[int(item.place[1])]}" if by_axis else item.words
        unit, factor = UNITS[item.kind]
        log = item.value > 0 and item.kind != "angle"
        low, high = -math.pi / 2, math.pi / 2
        if log:
            low, high = (math.log10(item.value) + side * _DECADES for side in (-1, 1))
        elif item.kind != "angle":
            low, high = min(2 * item.value, 0.0), max(2 * item.value, 1.0)
        more = {"low": low, "high": high, "unit": unit, "factor": factor, "log": log}
        found.append(field(item.name, label.capitalize(), item.value, "slider", **more))
    return found


def values_of(settings: PidSettings, given: Mapping[str, Any]) -> dict[str, float]:
    """Where the sliders stand. Raises InvalidInput for what is no number."""
    return {item.name: number(given, item.name, item.value) for item in numbers_of(settings)}


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


# The numbers of a [controller] that one turns: gains, times, frequencies, damping, angles, each
# with its place, also those of notches and of channels with a chain of their own.


# keys of numbers that are turned, and their kinds
KINDS = {
    **dict.fromkeys(("gain",), "gain"),
    **dict.fromkeys(("integral_time", "derivative_time"), "time"),
    **dict.fromkeys(("frequency", "zero_frequency", "pole_frequency"), "frequency"),
    **dict.fromkeys(("low_pass", "lead"), "frequency"),
    **dict.fromkeys(("damping", "zero_damping", "pole_damping", "low_pass_damping"), "share"),
    **dict.fromkeys(("derivative_filter",), "share"),
    "tilt_gain": "factor",
    "phase": "angle",
}
# the unit in which a hand turns a kind of number, and how many of it are one in SI
UNITS = {
    "gain": ("A/m", 1.0),
    "factor": ("×", 1.0),
    "time": ("s", 1.0),
    "share": ("%", 100.0),
    "frequency": ("Hz", 0.5 / math.pi),
    "angle": ("°", 180 / math.pi),
}
Place = tuple[str | int, ...]
_SAME = 1e-9  # a number that was turned and turned back is its old one to rounding


@dataclass(frozen=True, slots=True)
class Number:
    """A number and where it stands: ("notches", 0, "frequency"); words: for people; kind: one of
    KINDS; value in SI.
    """

    place: Place
    words: str
    kind: str
    value: float

    @property
    def name(self) -> str:
        """Its place as one word, "notches.0.frequency"."""
        return ".".join(map(str, self.place))


def numbers_of(settings: PidSettings) -> list[Number]:
    """All that do something beside the other settings; no blocks at the speed."""
    idle = {"synchronous"}
    if settings.low_pass is None:
        idle.add("low_pass_damping")
    if settings.coordinates == "axes":
        idle.add("tilt_gain")
    if settings.derivative_time is None:
        idle.add("derivative_filter")
    return [number for number in _numbers(settings, (), "") if number.place[0] not in idle]


def _numbers(part: Any, place: Place, words: str) -> Iterator[Number]:
    for item in fields(part):
        value = getattr(part, item.name)
        key = str(item.metadata.get("key", item.name))
        kind = KINDS.get(key, "")
        here = (*place, item.name)
        said = f"{words} {key.replace('_', ' ')}".strip()
        if isinstance(value, tuple) and value and is_dataclass(value[0]):
            for i, entry in enumerate(value):
                called = getattr(entry, "names", None) or (getattr(entry, "kind", ""), str(i + 1))
                heading = " ".join(part for part in (said, *called) if part)
                yield from _numbers(entry, (*here, i), heading)
        elif kind and isinstance(value, tuple):
            for i, entry in enumerate(value):
                many = f" {i + 1}" if len(value) > 1 else ""
                yield Number((*here, i), said + many, kind, float(entry))
        elif kind and isinstance(value, float):
            yield Number(here, said, kind, value)


def with_number(part: Any, place: Place, value: float) -> Any:
    """Settings (or a part of them) with another number at a place."""
    if not place:
        return value
    head, rest = place[0], place[1:]
    if isinstance(part, tuple):
        i = int(head)
        return (*part[:i], with_number(part[i], rest, value), *part[i + 1 :])
    return replace(part, **{str(head): with_number(getattr(part, str(head)), rest, value)})


def expression(part: Any, place: Place, value: float, words: str) -> str:
    """Python that gives ``with_number`` of what ``words`` calls, with dataclasses.replace."""
    if not place:
        return repr(value)
    head, rest = place[0], place[1:]
    if isinstance(part, tuple):
        i = int(head)
        new = expression(part[i], rest, value, f"{words}[{i}]")
        before, after = f"*{words}[:{i}], " if i else "", f"*{words}[{i + 1}:]"
        return f"({before}{new}, {after})" if i + 1 < len(part) else f"({before}{new},)"
    inner = expression(getattr(part, str(head)), rest, value, f"{words}.{head}")
    return f"replace({words}, {head}={inner})"


def _moved(settings: PidSettings, values: Mapping[str, float]) -> Iterator[tuple[Number, float]]:
    """What stands elsewhere than in the settings."""
    for item in numbers_of(settings):
        new = values.get(item.name, item.value)
        if not math.isclose(new, item.value, rel_tol=_SAME):
            yield item, new


def with_numbers(settings: PidSettings, values: Mapping[str, float]) -> PidSettings:
    """The settings with other numbers by their names."""
    for item, new in _moved(settings, values):
        settings = with_number(settings, item.place, new)
    return settings


def lines_of(settings: PidSettings, values: Mapping[str, float]) -> list[str]:
    """Lines of Python that make of ``settings`` those with other numbers."""
    lines = []
    for item, new in _moved(settings, values):
        lines.append(f"settings = {expression(settings, item.place, new, 'settings')}")
        settings = with_number(settings, item.place, new)
    return lines
