"""One self-contained page: `report.html`, readable on a screen without any network, printable and
signable on A4.

    write(page_of(result), "report.html")             # whatever has a page: see page_of
    closed = Section("Closed loop", "What to look at", figures, tables)
    page = Page("Verification", machine, (closed,))
    write(page, "report.html")                        # atomic: complete or not there at all

The nouns are generic; the modules beside this one and the annexes fill them, a page for each kind
of result. All text is plain text: it is escaped here. jinja2 and plotly are imported inside the
functions.
"""

import gzip
import itertools
import math
from base64 import b64decode, b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date as calendar, datetime
from functools import lru_cache
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.file.toml import machine_hash, read_toml
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import write_text
from ambrose.registry import registered, resolve
from ambrose.version import __version__

# Grounds of the cells of a map, on white and on dark paper; blue-green against orange is told apart
# by colour-blind readers.
SHADES = {
    "meets-1": ("#74c4b1", "#1d7161"),
    "meets-2": ("#a9dccf", "#1b5f51"),
    "meets-3": ("#d5efe8", "#17463d"),
    "fails-1": ("#fbe0ba", "#5e4a1c"),
    "fails-2": ("#f7bd80", "#7d4d1a"),
    "fails-3": ("#ee9566", "#96421c"),
    "fails-4": ("#de6d48", "#b03a1c"),
    "unstable": ("#4a1626", "#4a1626"),
    "absent": ("#e4e8eb", "#333c43"),
    "free": ("#f6f8f9", "#1d2328"),
}
# [px], the least width of a figure with one panel, of every further one, of any
_ONE_PANEL = 330
_PANEL = 265
_WIDEST = 900
_DETAIL = 38  # letters of a detail on one line of paper, about
_IN_A_PICTURE = 90  # words: ticks, legend and titles, about
_OPEN = 1400  # words that a page shows at most before a section is unfolded
MARKS = {
    "": "",
    "sign": "",
    "pass": "✓",
    "fail": "✗",
    "none": "–",
    "number": "",
    "muted": "",
    "heading": "",
}


@dataclass(frozen=True, slots=True)
class Cell:
    """One entry of a table; mark: "pass", "fail", "none" (information only), "number"
    (right-aligned), "muted", "sign" (room for a signature) or "".

    A first cell marked "heading" makes its row a heading across the table. best: the best of its
    kind, set off quietly; detail: more words, small, on a line of their own; shade: the colour of
    its ground in a map, one of SHADES. link: a page beside this one that the text leads to.
    """

    text: str
    mark: str = ""
    best: bool = False
    detail: str = ""
    shade: str = ""
    link: str = ""

    def __post_init__(self) -> None:
        if self.mark not in MARKS:
            raise InvalidInput(
                f"the mark of cell {self.text!r} is {self.mark!r}, but must be one of "
                f"{', '.join(MARKS)}"
            )
        if self.shade and self.shade not in SHADES:
            raise InvalidInput(
                f"the shade of cell {self.text!r} is {self.shade!r}, but must be one of "
                f"{', '.join(SHADES)}"
            )

    @property
    def symbol(self) -> str:
        """The sign that stands beside the colour."""
        return MARKS[self.mark]


Row = tuple[str | Cell, ...]


def numbers(*texts: str) -> tuple[Cell, ...]:
    """Right-aligned cells."""
    return tuple(Cell(text, "number") for text in texts)


@dataclass(frozen=True, slots=True)
class Table:
    """A table with its heading; every row as long as ``columns``; ``note`` stands beneath it.
    Raises InvalidInput.

    widths: of the columns [%], where tables are to line up with each other. groups: (heading,
    number of columns) from left to right, above the columns' own headings. by_cell: a failure tints
    its cell, not its row. folded: closed, under its title, until the reader opens it.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    note: str = ""
    widths: tuple[int, ...] = ()
    groups: tuple[tuple[str, int], ...] = ()
    by_cell: bool = False
    folded: bool = False

    def __post_init__(self) -> None:
        if self.groups and sum(span for _, span in self.groups) != len(self.columns):
            raise InvalidInput(
                f"the groups of table {self.title!r} span {sum(span for _, span in self.groups)} "
                "columns, "
                f"but must span {len(self.columns)}; give the columns without heading a group "
                "named ''"
            )
        for i, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise InvalidInput(
                    f"row {i} of table {self.title!r} has {len(row)} cells, but must have "
                    f"{len(self.columns)}; fill it with ''"
                )

    @property
    def cells(self) -> tuple[tuple[Cell, ...], ...]:
        """The rows with every entry a Cell."""
        return tuple(
            tuple(entry if isinstance(entry, Cell) else Cell(entry) for entry in row)
            for row in self.rows
        )

    @property
    def lines(self) -> int:
        """About how many lines the rows take on paper: a detail stands under its cell."""
        return sum(
            1 + max((math.ceil(len(cell.detail) / _DETAIL) for cell in row), default=0)
            for row in self.cells
        )

    @property
    def starts(self) -> tuple[int, ...]:
        """The columns at which a group begins, the first one left out."""
        return tuple(sum(span for _, span in self.groups[:i]) for i in range(1, len(self.groups)))


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """A plotly figure, its title and the caption that says what to look at."""

    title: str
    picture: Any
    caption: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A heading, some paragraphs, then figures and tables (tables first if ``tables_first``).

    folded: all its tables are; paper shows those that are open. hint: how to use the section on a
    screen, left out on paper. on_paper: whether it is printed where it is closed on the screen.
    """

    title: str
    text: str = ""
    figures: tuple[Figure, ...] = ()
    tables: tuple[Table, ...] = ()
    tables_first: bool = False
    folded: bool = False
    hint: str = ""
    on_paper: bool = True

    @property
    def words(self) -> int:
        """About how many are read before anything is unfolded."""
        texts = [self.text, self.hint, *(figure.caption for figure in self.figures)]
        for table in self.tables:
            texts.append(table.title)
            if not (self.folded or table.folded):
                cells = (f"{cell.text} {cell.detail}" for row in table.cells for cell in row)
                texts += [table.note, *table.columns, *cells]
        return len(" ".join(texts).split()) + _IN_A_PICTURE * len(self.figures)

    @property
    def paragraphs(self) -> tuple[str, ...]:
        """The text cut at empty lines."""
        return tuple(part.strip() for part in self.text.split("\n\n") if part.strip())


@dataclass(frozen=True, slots=True)
class Verdict:
    """What holds for one operating point, in plain words; passed None: for information; share: of
    its limit, where it has one.
    """

    label: str
    passed: bool | None
    text: str
    share: float | None = None

    @property
    def mark(self) -> str:
        """The mark of a Cell that says the same."""
        return "none" if self.passed is None else "pass" if self.passed else "fail"

    @property
    def symbol(self) -> str:
        """The sign that stands beside the colour."""
        return MARKS[self.mark]


@dataclass(frozen=True, slots=True)
class Subject:
    """What a page is about where there is no machine file."""

    name: str
    description: str = ""
    source: str = ""


@dataclass(frozen=True, slots=True)
class Brand:
    """Whose document it is, at the head of every printed page; logo: a data URL."""

    project: str = ""
    revision: str = ""
    author: str = ""
    logo: str = ""

    @property
    def line(self) -> str:
        """What stands beside the logo."""
        revision = f"revision {self.revision}" * bool(self.revision)
        return ", ".join(filter(None, (self.project, revision, self.author)))


# [bytes] of a logo, and the pictures that a page may hold
_LOGO = 1_000_000
_LOGOS = {".svg": "svg+xml", ".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg"}


def brand_of(file: Path, given: Mapping[str, str | None]) -> Brand:
    """Project, revision, author and the logo's path: as given, else (None) as a user's file states
    them, if there is one. Raises InvalidInput.
    """
    stated = read_toml(file, "defaults of reviews") if file.is_file() else {}
    if wrong := [key for key in stated if key not in given or not isinstance(stated[key], str)]:
        raise InvalidInput(
            f"{file} holds {wrong[0]!r}, but it states {', '.join(given)} as texts; correct it"
        )
    words = {key: text if text is not None else stated.get(key, "") for key, text in given.items()}
    if not (logo := words.pop("logo")):
        return Brand(**words)
    path = Path(logo) if given["logo"] is not None else file.parent / Path(logo).expanduser()
    if (kind := _LOGOS.get(path.suffix.lower())) is None:
        raise invalid("the logo", str(path), f"a file {', '.join(_LOGOS)}", "save it as one")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InvalidInput(
            f"cannot read the logo {path}: {error.strerror}; give its path"
        ) from None
    if len(content) > _LOGO:
        size = f"{len(content) / 1e6:.1f} MB"
        raise invalid("the logo", size, "at most 1 MB", "save it smaller")
    return Brand(**words, logo=f"data:image/{kind};base64,{b64encode(content).decode()}")


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """Everything on the page. date: ISO date, today if empty; signatures: the lines to sign at the
    end. Facts without a text are left out.

    result: how it all turned out (None: whether every verdict is good, in words of the page); it
    begins the page. opening: what stands before the verdicts. brand: on every printed page.
    """

    title: str
    machine: Machine | Subject
    sections: tuple[Section, ...]
    verdicts: tuple[Verdict, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()
    date: str = ""
    signatures: tuple[str, ...] = ("Prepared", "Checked", "Released")
    result: Verdict | None = None
    opening: Section | None = None
    brand: Brand | None = None

    @property
    def head(self) -> tuple[tuple[str, str], ...]:
        """The facts, with machine and its hash before them, date and version after them."""
        about = self.machine
        digest = f"SHA-256 {machine_hash(about)}" if isinstance(about, Machine) else ""
        return (
            ("Machine", ", ".join(filter(None, (about.name, digest, about.description)))),
            ("Source", about.source),
            *self.facts,
            ("Document", self.brand.line if self.brand else ""),
            ("Computed", f"{self.date or calendar.today().isoformat()} with ambrose {__version__}"),
        )

    @property
    def passed(self) -> bool | None:
        """Whether every verdict is good; None without verdicts."""
        known = [verdict.passed for verdict in self.verdicts if verdict.passed is not None]
        return all(known) if known else None


# What makes the page of a result, by the name of its type; annexes register theirs as "page".
_MAKERS = {
    "Verification": "ambrose.report.verification:page_of_verification",
    "LoopIdentification": "ambrose.report.identification:identification_page",
    "StaticIdentification": "ambrose.report.identification:static_page",
    "GenericIdentification": "ambrose.report.identification:generic_page",
    "SealByFrequency": "ambrose.report.identification:seal_page",
    "Record": "ambrose.report.record:record_page",
    "Trace": "ambrose.report.record:record_page",
    "Exploration": "ambrose.report.verification:exploration_page",
}


def page_of(result: Any, *beside: Any, **options: Any) -> Page:
    """The page of any result that has one.

    result: a Verification, Identification, Record, Trace, Exploration, or a result of an annex.
    beside: what that page needs next to it (the machine of a record or trace); options: those of
    the page's own function, such as ``date``. Raises InvalidInput for a result without a page.
    """
    makers = {**_MAKERS, **registered("page")}
    for kind in type(result).__mro__:
        if kind.__name__ in makers:
            page: Page = resolve(makers[kind.__name__])(result, *beside, **options)
            return page
    raise InvalidInput(
        f"a {type(result).__name__} has no page of its own; give one of {', '.join(sorted(makers))}"
    )


def render(page: Page) -> str:
    """The page as text."""
    from markupsafe import Markup

    sections = [page.opening or Section(""), *page.sections]
    pictures = [figure for section in sections for figure in section.figures]
    head = itertools.chain(*page.head, *((item.label, item.text) for item in page.verdicts))
    first = sections[0].words + len(" ".join(head).split())
    read = itertools.accumulate((section.words for section in page.sections), initial=first)
    return _layout().render(
        page=page,
        # from the top, as many as a reader takes in
        open=sum(words <= _OPEN for words in read) - 1,
        number=itertools.count(1).__next__,
        least_width=least_width,
        running_title=Markup(css_string(f"{page.title}: {page.machine.name}")),
        running_head=Markup(css_string(page.brand.line if page.brand else "")),
        shades=SHADES,
        data=[Markup(packed(figure.picture.to_json())) for figure in pictures],
        library=Markup(_packed_once(get_library())) if pictures else "",
    )


@lru_cache(maxsize=1)
def _layout() -> Any:
    """The template of every page, compiled once."""
    from jinja2 import Environment, StrictUndefined

    text = files("ambrose.report").joinpath("templates/page.html.j2").read_text("utf-8")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(text)


def css_string(text: str) -> str:
    """``text`` as what stands between the quotes of a string in a style sheet: all but letters and
    digits of ASCII as escapes of six digits (CSS Syntax 3, section 4.3.7).
    """
    return "".join(
        letter if letter.isascii() and letter.isalnum() else f"\\{ord(letter):06x}"
        for letter in text
    )


def least_width(picture: Any) -> int:
    """What a figure needs to be read [px]; a narrower page scrolls it."""
    layout = picture.layout.to_plotly_json()
    if least := (layout.get("meta") or {}).get("least"):
        return int(least)
    starts = {
        round((layout[name].get("domain") or (0,))[0], 3)
        for name in layout
        if name.startswith("xaxis")
    }
    return min(_ONE_PANEL + _PANEL * max(0, len(starts) - 1), _WIDEST)


def get_library() -> str:
    """The drawing library that a page with figures carries, once."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def packed(text: str) -> str:
    """``text`` as the page carries it, a third as long: gzip (RFC 1952), in letters that no markup
    can come from.
    """
    return b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")


@lru_cache(maxsize=1)
def _packed_once(text: str) -> str:
    """The same of the library, which every page of a program has in common: a sixth of a second."""
    return packed(text)


def write(report: Page, path: str | Path) -> Path:
    """Render the report and put it at ``path`` in one step: a reader sees the old page or the new
    one, never half of it.

    Returns the path. Raises InvalidInput when the folder does not exist or cannot be written to.
    """
    return write_text(path, render(report), "report")


# The same page as a document that a word processor edits, by python-docx. Figures need a browser:
# they are named, with the page that shows them.

_TONES = {"pass": "1B7F4D", "fail": "A3341F"}
# characters beside a text, of one at most that decides a column's width, and across a sheet
_PAD, _LINE = 3, 45
_ACROSS = 90


def documents() -> ModuleType:
    """python-docx. Raises InvalidInput where it is not installed."""
    try:
        import docx
    except ImportError:
        raise InvalidInput(
            "documents (*.docx) need the package python-docx; install it with: pip install "
            "python-docx"
        ) from None
    return docx


def document(page: Page, beside: str) -> bytes:
    """The page as an editable document (*.docx); beside: the page (*.html) that shows its figures.
    Raises InvalidInput where python-docx is not installed.
    """
    paper = documents().Document()
    from docx.oxml import OxmlElement
    from docx.shared import Mm, Pt, RGBColor

    about = paper.core_properties
    about.title, about.comments = f"{page.title}: {page.machine.name}", ""
    about.author = page.brand.author if page.brand else ""
    about.created = datetime.fromisoformat(page.date or calendar.today().isoformat())
    sheet = paper.sections[0]
    sheet.page_width, sheet.page_height = Mm(210), Mm(297)
    sheet.left_margin = sheet.right_margin = Mm(20)
    paper.styles["Normal"].font.size = Pt(10)
    if page.brand:
        head = sheet.header.paragraphs[0]
        kind, _, content = page.brand.logo.partition(";base64,")
        if content and "svg" not in kind:  # which it does not take in
            head.add_run().add_picture(BytesIO(b64decode(content)), height=Mm(10))
        head.add_run(f" {page.brand.line}")

    def write_cell(place: Any, cell: Cell) -> None:
        words = "\N{NO-BREAK SPACE}".join(filter(None, (cell.symbol, cell.text)))
        run = place.paragraphs[0].add_run(words)
        if tone := _TONES.get(cell.mark):
            run.font.color.rgb = RGBColor.from_string(tone)
        run.bold = cell.best or cell.mark in {"fail", "heading"}
        if cell.mark == "number":
            place.paragraphs[0].alignment = 2  # right
        if cell.detail:
            place.add_paragraph().add_run(cell.detail).font.size = Pt(8)

    def add_table(columns: Sequence[str], rows: Iterable[Sequence[Cell]]) -> None:
        grid = paper.add_table(rows=1, cols=len(columns), style="Table Grid")
        grid.autofit = False
        for place, text in zip(grid.rows[0].cells, columns, strict=True):
            place.paragraphs[0].add_run(text).bold = True
        for row in rows:
            for place, cell in zip(grid.add_row().cells, row, strict=True):
                write_cell(place, cell)
        # Every column holds its longest word; what the sheet has beyond that goes to those whose
        # longest text, up to a line, asks for more. Rows stay whole, and heads are repeated, where
        # a page ends.
        texts = [[place.text for place in column.cells] for column in grid.columns]
        words = [_PAD + max(len(word) for t in column for word in t.split(" ")) for column in texts]
        lines = [_PAD + min(_LINE, max(map(len, column))) for column in texts]
        more = [max(0, line - word) + 0.1 for line, word in zip(lines, words, strict=True)]
        spare = max(0, _ACROSS - sum(words)) / sum(more)
        asked = [word + spare * part for word, part in zip(words, more, strict=True)]
        for column, share in zip(grid.columns, asked, strict=True):
            column.width = Mm(170 * share / sum(asked))
            for place in column.cells:
                place.width = column.width
        for row in grid.rows:
            row._tr.get_or_add_trPr().append(OxmlElement("w:cantSplit"))
        grid.rows[0]._tr.get_or_add_trPr().append(OxmlElement("w:tblHeader"))

    def add_section(section: Section, number: int) -> int:
        for text in section.paragraphs:
            paper.add_paragraph(text)
        for table in section.tables:
            if table.title:
                paper.add_heading(table.title, 2)
            add_table(table.columns, table.cells)
            paper.add_paragraph(table.note)
        for figure in section.figures:
            number += 1
            words = f"Figure {number}. {figure.title}: see {beside}. {figure.caption}"
            paper.add_paragraph(words.strip())
        return number

    paper.add_heading(f"{page.title}: {page.machine.name}", 0)
    verdicts = [*filter(None, [page.result]), *page.verdicts]
    rows = [(Cell(item.label), Cell(item.text, item.mark)) for item in verdicts]
    add_table(("Verdict", ""), rows)
    paper.add_paragraph()
    add_table(("Document", ""), [(Cell(name), Cell(text)) for name, text in page.head if text])
    count = add_section(page.opening or Section(""), 0)
    for section in page.sections:
        paper.add_heading(section.title, 1)
        count = add_section(section, count)
    if page.signatures:
        lines = [(Cell(name), *[Cell("")] * 3) for name in page.signatures]
        add_table(("", "Name", "Date", "Signature"), lines)
    stream = BytesIO()
    paper.save(stream)
    return stream.getvalue()
