"""What the commands share: options, progress, tables, and the one way by which anything reaches the
terminal.

Whatever a text holds and wherever it goes, the exit status says what was found: a line is one line
without control characters, what an encoding lacks is spelled (``>=``, ``10^-7``, ``\\u4e00``), and
output that nobody reads any more is dropped.
"""

from __future__ import annotations

import codecs
import errno
import io
import os
import re
import shutil
import sys
import tempfile
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import Field, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeVar, cast

import click
from click.core import ParameterSource

from ambrose.machine.units import DIMENSIONS, one_line, read_quantity
from ambrose.options import (
    GROUPS,
    Option,
    Options,
    check_option,
    either,
    kinds_with,
    option_of,
    refuse_foreign,
)

if TYPE_CHECKING:
    from ambrose.judge.result import Synthesis
    from ambrose.machine.machine import Machine

ALL = click.option(
    "--all", "everything", is_flag=True, help="Show the quantities without a limit as well."
)


def AS_JSON(command: Callable[..., Any]) -> Callable[..., Any]:  # a decorator
    """--json, and --details, without which what is printed is one screen."""
    with_details = click.option(
        "--details",
        is_flag=True,
        expose_value=False,
        callback=_begin_screen,
        help="Print every table and note in full, not one screen.",
    )
    return click.option(
        "--json", "as_json", is_flag=True, help="Print one JSON object and nothing else."
    )(with_details(command))


def _narrow(ctx: click.Context, _: click.Parameter, axes: str | None) -> None:
    ctx.meta[_AXES] = axes


AXES = click.option(
    "--axes",
    type=click.Choice(GROUPS),
    expose_value=False,
    callback=_narrow,
    help="Only these axes; default: all of the machine that the command is for.",
)


def MACHINE(command: Callable[..., Any]) -> Callable[..., Any]:  # a decorator
    """The machine, and which of its axes."""
    return click.argument("machine")(AXES(command))


def narrowed() -> str | None:
    """The group of axes that the command line names; None: it names none."""
    context = click.get_current_context(silent=True)
    return None if context is None else context.meta.get(_AXES)


_SUFFIX = {"controller file": ".json", "machine file": ".toml", "report": ".html", "page": ".html"}
# endings that mean a file of this package, or a record
_KINDS = {*_SUFFIX.values(), ".h5", ".hdf5", ".csv", ".mat", ".tdms"}
_SILENCE = 30.0  # s
_WIDTH, _LINES = 100, 40  # of one screen, in columns and lines
_FULL = 140  # columns of the tables of --details where there is no terminal
_LEAST = 60  # columns of a terminal, below which lines are torn
_LEAD = 30  # characters
_AXES = "axes"  # in the meta data of click's context
_SCREEN = "one screen"  # in the meta data of click's context
_said: list[bool] = []  # whether this command has printed its JSON object
# nobody reads: as Unix, as Windows, and as a terminal that was closed says it
_GONE = {errno.EPIPE, errno.EINVAL, errno.EIO}
_SPELLED = {
    "≤": "<=",
    "≥": ">=",
    "≠": "!=",
    "±": "+-",
    "×": "*",
    "·": "*",
    "−": "-",
    "–": "-",
    "→": "->",
    "…": "...",
    "°": " deg",
    "µ": "u",
    "μ": "u",
    "∞": "inf",
    "✓": "+",
    "✗": "x",
    "•": "*",
    "ζ": "zeta",
    "η": "eta",
    "ω": "omega",
    "γ": "gamma",
    "σ": "sigma",
    "Ω": "Omega",
    "\u00a0": " ",
    "\u2009": " ",
    "\u202f": " ",
}
_POWER, _DIGITS = re.compile("[⁻⁰¹²³⁴-⁹]+"), str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


class GroupedCommand(click.Command):
    """A command whose options stand in groups in its help, those that one begins with first.

    groups: {title: names of parameters}; what is in none of them stands under "More options".
    """

    def __init__(
        self, *arguments: Any, groups: Mapping[str, Sequence[str]], **attributes: Any
    ) -> None:
        super().__init__(*arguments, **attributes)
        self.groups = groups

    def grouped(self, ctx: click.Context) -> dict[str, list[click.Parameter]]:
        """{title: its options}, those without a group last."""
        options = {
            item.name: item for item in self.get_params(ctx) if item.param_type_name == "option"
        }
        groups = {
            title or "Options": [options.pop(name) for name in names if name in options]
            for title, names in self.groups.items()
        }
        return {
            title: rows
            for title, rows in (*groups.items(), ("More options", list(options.values())))
            if rows
        }

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, options in self.grouped(ctx).items():
            with formatter.section(title):
                formatter.write_dl([item.get_help_record(ctx) or ("", "") for item in options])


def _spell(error: UnicodeError) -> tuple[str, int]:
    """A codec's error handler: the package's own signs in ASCII, other characters as their
    escapes.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = _POWER.sub(
        lambda power: "^" + power[0].translate(_DIGITS), error.object[error.start : error.end]
    )
    spelled = (
        _SPELLED.get(c) or (c if c.isascii() else c.encode("unicode_escape").decode()) for c in text
    )
    return "".join(spelled), error.end


codecs.register_error("ambrose.spell", _spell)


class _Outlet(io.RawIOBase):
    """A standard stream that drops what nobody reads; errors of another kind are those of ``name``,
    or dropped as well.
    """

    def __init__(self, raw: io.RawIOBase, name: str) -> None:
        self._raw = raw
        self._name = name
        self._lost = False

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._raw.isatty()

    def fileno(self) -> int:
        return self._raw.fileno()

    def write(self, data: Any) -> int:
        while not self._lost:
            try:
                written = self._raw.write(data)
            except OSError as error:
                self._lost = True
                if self._name and error.errno not in _GONE:
                    raise OSError(error.errno, error.strerror, self._name) from error
            else:
                if written is not None:
                    return written
                time.sleep(0.01)  # a pipe that does not wait, and is full
        return len(data)


@contextmanager
def streams_settled() -> Iterator[None]:
    """Standard output and error as this module promises them, as long as the block runs."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except (
            OSError
        ):  # closed: the next file that is opened would take its place, and what is printed
            os.open(os.devnull, os.O_RDWR)
    before = sys.stdout, sys.stderr
    _said.clear()
    try:
        sys.stdout, sys.stderr = _settled(sys.stdout, "standard output"), _settled(sys.stderr, "")
        yield
    finally:
        sys.stdout, sys.stderr = before


def _settled(stream: Any, name: str) -> Any:
    if stream is None:
        return io.StringIO()
    buffered = getattr(stream, "buffer", None)
    raw = getattr(buffered, "raw", buffered)  # unbuffered, it is the file itself
    if isinstance(raw, io.RawIOBase):
        stream.flush()
        buffer = io.BufferedWriter(_Outlet(raw, name))
        return io.TextIOWrapper(buffer, _encoding(stream), "ambrose.spell", line_buffering=True)
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(encoding=_encoding(stream), errors="ambrose.spell")
    return stream


def _encoding(stream: Any) -> str:
    """The stream's, but ASCII where LC_ALL=C asks for it, which Python by itself takes for UTF-8
    (PEP 538, 540).
    """
    stated = {"PYTHONIOENCODING", "PYTHONUTF8"} & os.environ.keys()
    return (
        "ascii"
        if os.environ.get("LC_ALL") in {"C", "POSIX"} and not stated
        else str(stream.encoding)
    )


def say(text: str, *, err: bool = False) -> None:
    """Print one line."""
    screen = None if err else one_screen()
    if screen is None:
        _write(sys.stderr if err else sys.stdout, one_line(text) + "\n")
    else:
        screen.parts.append(one_line(text))


def say_json(content: Any, *, unless_said: bool = False) -> None:
    """Print one JSON object, in ASCII; unless_said: only where a command has not printed its
    own.
    """
    if not (unless_said and _said):
        # --help does without numpy, which the package of this imports
        from ambrose.core.presentation import json_text

        _write(sys.stdout, one_line(json_text(content)) + "\n")
        _said.append(True)


def say_whole(text: str) -> None:
    """Print lines that go into a file: never cut, never broken."""
    for line in text.splitlines():
        _write(sys.stdout, one_line(line) + "\n")


def _write(stream: TextIO, text: str) -> None:
    stream.write(text)
    stream.flush()


def _worded(text: str) -> str:
    """A line as standard output shows it, so that the width of a column is known."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return one_line(text).encode(encoding, "ambrose.spell").decode(encoding)


def quantity_given(text: str | None, option: str, dimension: str) -> float | None:
    """A positive quantity of an option such as "20 bar/s" in SI; None: not given. Raises
    InvalidInput.
    """
    from ambrose.core.checks import InvalidInput

    if text is None:
        return None
    unit = DIMENSIONS[dimension]
    if text.strip().replace(".", "", 1).isdecimal():
        raise InvalidInput(
            f'{option} is {text}, without a unit; write it with one, such as "{unit.example}"'
        )
    try:
        value = read_quantity(text, unit)
    except ValueError as error:
        raise InvalidInput(f"{option} {error}") from error
    if not value > 0:
        raise InvalidInput(
            f"{option} is {text}, but must be positive; leave it out where nothing is known"
        )
    return value


def load(machine: str, *, magnets: bool = True, part: bool = True) -> Machine:
    """The machine of a command, with --axes thrust that of its thrust axis; magnets: whether the
    command needs magnetic bearings; part: whether it takes one group of axes, the radial ones
    unless --axes says another, which is noted. Raises InvalidInput.
    """
    from ambrose.machine.file.toml import load_machine
    from ambrose.machine.machine import THRUST, require_magnets

    found, axes = load_machine(machine), narrowed()
    if axes is not None:
        narrow = found.only(axes)
        found = narrow if axes == THRUST else found
    elif part:
        noted_part(found)
    if magnets:
        require_magnets(found)
    return found


def noted_part(machine: Machine) -> None:
    """Notes that what is done is of the radial axes, where the machine has others."""
    if len(machine.groups) > 1:
        say("note: the radial axes; --axes thrust takes the thrust axis", err=True)


def load_controller(path: Path, machine: Machine) -> Synthesis:
    """A controller file, of one that holds all axes the part of a machine that is the thrust axis;
    that it was made for another machine, or before the machine file was changed, is noted.
    """
    from ambrose.judge.controller_file import made_for, read_controller
    from ambrose.machine.machine import THRUST

    result = read_controller(path, machine)
    if machine.group == THRUST and result.thrust is not None:
        result = replace(result.thrust, file=result.file)
    if not result.provenance.date:  # a table of another program
        dt = result.controller.dt
        kind = "continuous" if dt is None else f"sampled at {1 / dt:.6g} Hz"
        words = "; ".join((f"{result.controller.n_states} states", kind, *result.notes))
        say(f"note: {path}: {words}", err=True)
    if other := made_for(result.provenance, machine):
        say(
            f"note: {path} was made for {other}; results are for {machine.name} as given",
            err=True,
        )
    return result


@contextmanager
def progress_shown(quiet: bool) -> Iterator[Callable[[str], None]]:
    """A spinner with the present stage and its time on a terminal; nothing with --json.

    Elsewhere a line per stage, and one every _SILENCE seconds of a stage that lasts. Every stage is
    a sign of work to the process, which waits for some after Ctrl-C.
    """
    context = click.get_current_context(silent=True)
    at_work = (context and context.obj) or (lambda: None)
    with _stages_shown(quiet) as show:

        def step(stage: str) -> None:
            at_work()
            show(stage)

        yield step


@contextmanager
def _stages_shown(quiet: bool) -> Iterator[Callable[[str], None]]:
    if quiet:
        yield lambda stage: None
        return
    if not sys.stderr.isatty():
        with _lines() as line:
            yield line
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    spinner = SpinnerColumn("dots" if console.encoding.startswith("utf") else "line")
    columns = (spinner, TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:
        tasks: list[Any] = []

        def step(stage: str) -> None:
            if tasks:
                bar.update(tasks[-1], total=1, completed=1)
            tasks.append(bar.add_task(one_line(stage), total=None))

        yield step
        if tasks:
            bar.update(tasks[-1], total=1, completed=1)


@contextmanager
def _lines() -> Iterator[Callable[[str], None]]:
    now, over = [("", time.monotonic())], threading.Event()

    def remind() -> None:
        while not over.wait(_SILENCE):
            stage, since = now[0]
            if stage and time.monotonic() - since >= _SILENCE:
                say(f"  {stage}: since {time.monotonic() - since:.0f} s", err=True)

    def line(stage: str) -> None:
        now[0] = stage, time.monotonic()
        say(f"  {stage}", err=True)

    threading.Thread(target=remind, daemon=True).start()
    try:
        yield line
    finally:
        over.set()


@dataclass(frozen=True)
class _Table:
    """A table to be drawn; marks: the style of each row; left: rows that were cut."""

    title: str
    columns: Sequence[str]
    rows: Sequence[tuple[str, ...]]
    marks: Sequence[str]
    left: int = 0

    def drawn(self, width: int | None, *, plain: bool) -> str:
        """width: in columns (None: the terminal's); plain: without lines between the columns."""
        from rich import box
        from rich.console import Console
        from rich.table import Table

        console = Console(width=width, markup=False, emoji=False, highlight=False)
        frame: Any = (
            {"box": box.SIMPLE_HEAD, "show_edge": False, "padding": (0, 1, 0, 0)} if plain else {}
        )
        table = Table(title=_worded(self.title), title_justify="left", title_style="bold", **frame)
        texts = [[_worded(cell) for cell in row] for row in self.rows]
        columns = [_worded(column) for column in self.columns]
        widths = [None] * len(columns) if not plain else _widths([columns, *texts], console.width)
        for column, size in zip(columns, widths, strict=True):
            table.add_column(column, overflow="fold", width=size)
        for i, row in enumerate(texts):
            table.add_row(*row, style=self.marks[i] if self.marks else None)
        with console.capture() as capture:
            console.print(table)
        return capture.get()

    def cut(self, by: int) -> _Table:
        """Without ``by`` of its rows: the last ones, those that are marked last of all."""
        marks = self.marks or [""] * len(self.rows)
        order = sorted(range(len(self.rows)), key=lambda i: (not marks[i], i))
        keep = sorted(order[: max(len(order) - by, 1)])
        left = self.left + len(self.rows) - len(keep)
        return replace(
            self, rows=[self.rows[i] for i in keep], marks=[marks[i] for i in keep], left=left
        )


def _widths(rows: Sequence[Sequence[str]], width: int) -> list[int]:
    """The width of every column, two spaces between them, in lines of ``width``: the widest are
    narrowed first, none below its longest word while another still can be. A word, path or name is
    not torn for the sake of a neighbour.
    """
    cells = list(zip(*rows, strict=True))
    found = [max(map(len, column)) for column in cells]
    words = [max(len(word) for cell in column for word in cell.split(" ")) for column in cells]
    for least in (words, [1] * len(found)):
        while sum(found) + 2 * len(found) - 1 > width:
            k = max(range(len(found)), key=lambda k: (found[k] > least[k], found[k]))
            if found[k] <= least[k]:
                break
            found[k] -= 1
    return found


@dataclass
class Screen:
    """What a command prints without --details: ``verdict`` in one sentence, the tables, the notes,
    and at most ``lines`` lines; what had no room is counted in the last one.
    """

    verdict: str = ""
    parts: list[str | _Table] = field(default_factory=list)
    lines: int = _LINES

    def show(self) -> None:
        """Print it; the width is that of the terminal, or of COLUMNS, up to 100. What nobody's
        terminal takes keeps each sentence on one line, for programs that read it.
        """
        width = max(min(_WIDTH, shutil.get_terminal_size((_WIDTH, 0)).columns), _LEAST)
        broken = sys.stdout.isatty() or "COLUMNS" in os.environ
        _write(sys.stdout, "".join(f"{line}\n" for line in self.fitted(width, broken)))

    def fitted(self, width: int, broken: bool = True) -> list[str]:
        """Its lines at that width; broken: sentences, too, which are counted so in any case."""
        head = _wrapped(self.verdict, width) if self.verdict else []
        parts = [(part, self._drawn(part, width)) for part in self.parts]
        if len(head) + sum(len(lines) for _, lines in parts) <= self.lines:
            return _joined([("", head), *parts], broken)
        # notes first: whole ones as long as a third of the screen holds them, the others counted
        room = max(
            self.lines // 3,
            self.lines
            - len(head)
            - 1
            - sum(len(lines) for part, lines in parts if isinstance(part, _Table)),
        )
        unsaid: dict[str, int] = {}
        shown: list[tuple[str | _Table, list[str]]] = []
        for part, lines in parts:
            if isinstance(part, _Table) or len(lines) <= room:
                shown.append((part, lines))
                room -= 0 if isinstance(part, _Table) else len(lines)
            else:
                kind = part.partition(":")[0] if ":" in part[:_LEAD] else "line"
                unsaid[kind] = unsaid.get(kind, 0) + 1
        # then rows, of the longest table first; each keeps one
        while (over := len(head) + 1 + sum(len(lines) for _, lines in shown) - self.lines) > 0:
            longest = [k for k, (part, _) in enumerate(shown) if _can_be_cut(part)]
            if not longest:
                break
            k = max(longest, key=lambda k: len(shown[k][1]))
            table, lines = cast("tuple[_Table, list[str]]", shown[k])
            # rows differ in height: in large steps only while far off
            table = table.cut(max(over // 2 * len(table.rows) // len(lines), 1))
            shown[k] = table, self._drawn(table, width)
        rows = sum(part.left for part, _ in shown if isinstance(part, _Table))
        counted = [f"{rows} more rows"] * (rows > 0)
        counted += [f'{number} more of "{kind}"' for kind, number in unsaid.items()]
        if not counted:  # one row of each table is left, and that is everything
            return _joined([("", head), *shown], broken)
        rest = f"Not shown: {', '.join(counted)}. --details prints everything."
        return _joined([("", head), *shown, ("", _wrapped(rest, width)[:1])], broken)

    @staticmethod
    def _drawn(part: str | _Table, width: int) -> list[str]:
        if isinstance(part, str):
            return _wrapped(part, width)
        return [line.rstrip() for line in part.drawn(width, plain=True).splitlines()]


def _joined(parts: Sequence[tuple[str | _Table, list[str]]], broken: bool) -> list[str]:
    """The lines of all parts; not broken: a sentence is one."""
    return [
        line
        for part, lines in parts
        for line in (
            lines if broken or isinstance(part, _Table) or not lines else [" ".join(lines)]
        )
    ]


def _can_be_cut(part: str | _Table) -> bool:
    return isinstance(part, _Table) and len(part.rows) > 1


def _wrapped(text: str, width: int) -> list[str]:
    """A line of text in as many as it takes; words and paths stay whole."""
    return textwrap.wrap(_worded(text), width, break_long_words=False, break_on_hyphens=False) or [
        ""
    ]


def one_screen() -> Screen | None:
    """The screen of the command that runs; None with --details, which prints as it comes."""
    context = click.get_current_context(silent=True)
    found: Screen | None = None if context is None else context.meta.get(_SCREEN)
    return found


def _begin_screen(context: click.Context, _: click.Parameter, details: bool) -> None:
    if details:
        return
    screen = context.meta[_SCREEN] = Screen()

    def end() -> None:
        del context.meta[_SCREEN]
        screen.show()

    context.call_on_close(end)


def say_verdict(text: str, *, in_full: str = "") -> None:
    """The first sentence of a screen; in_full: what --details prints in its place, if anything."""
    if (screen := one_screen()) is not None:
        screen.verdict = one_line(text)
    elif in_full:
        say(in_full)


def print_table(
    title: str, columns: Sequence[str], rows: Sequence[tuple[str, ...]], marks: Sequence[str] = ()
) -> None:
    table, screen = _Table(title, columns, rows, marks), one_screen()
    if screen is None:
        width = None if sys.stdout.isatty() else _FULL
        _write(sys.stdout, table.drawn(width, plain=False))
    else:
        screen.parts.append(table)


def print_checks(checks: Any, everything: bool) -> None:
    """One operating point: the verdict in words, then the checks that have a limit (or all),
    without their sources.
    """
    from ambrose.report.tables import checks_table, verdict

    table = checks_table(checks)
    cells = table.cells  # made anew at every look
    keep = [i for i, column in enumerate(table.columns) if not column.startswith("Standard")]
    listed = [i for i, check in enumerate(checks.checks) if everything or check.passed is not None]
    rows = [tuple(f"{cells[k][i].symbol} {cells[k][i].text}".strip() for i in keep) for k in listed]
    marks = tuple("red" if checks.checks[k].passed is False else "" for k in listed)
    print_table(
        f"{checks.label}: {verdict(checks).text}",
        tuple(table.columns[i] for i in keep),
        rows,
        marks,
    )


def shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def claim(**places: Path | None) -> None:
    """Holds the files that a command will write until it ends: what cannot be written, or is being
    written by another run, is refused before the work begins. Raises InvalidInput.
    """
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.ordinary_file import check_file, claimed

    known: dict[str, str] = {}
    for what, path in (
        (what.replace("_", " "), path) for what, path in places.items() if path is not None
    ):
        check_file(path, what)
        if (other := known.setdefault(os.path.realpath(path), what)) != what:
            raise InvalidInput(
                f"{path} is named for the {other} and the {what}; give one of them another name"
            )
        if (
            (suffix := _SUFFIX.get(what, "")) != path.suffix.lower()
            and suffix
            and path.suffix.lower() in _KINDS
        ):
            raise InvalidInput(
                f"the {what} is to be {path}, but must be a file *{suffix}; that ending means "
                "another kind of file"
            )
        click.get_current_context().with_resource(claimed(path, what))


def kept(write: Callable[[Path], Any], path: Path) -> Exception | None:
    """Writes a result at the end of the work; where that fails, into the folder for temporary files
    instead. Returns what to raise after the other results are printed; None: nothing failed.
    """
    from ambrose.core.checks import InvalidInput

    try:
        write(path)
    except InvalidInput as error:
        with suppress(InvalidInput, OSError):
            elsewhere = Path(tempfile.mkdtemp(prefix="ambrose-")) / path.name
            write(elsewhere)
            return InvalidInput(f"{error}; it was written to {elsewhere} instead")
        return error
    return None


def kept_page(
    result: Any,
    path: Path | None,
    *beside: Any,
    progress: Callable[[str], None] | None = None,
    called: str = "page",
    **options: Any,
) -> Exception | None:
    """The page of a result at ``path`` (None: none is wanted), kept as by ``kept``.

    beside, options: as for ``page_of``. progress is told that the page (``called`` otherwise in
    some commands) is written. Returns what to raise in the end; None: nothing failed.
    """
    if path is None:
        return None
    from ambrose.report.page import page_of, write

    if progress is not None:
        progress(f"writing the {called}")
    return kept(lambda place: write(page_of(result, *beside, **options), place), path)


# Options of the command line, made from the fields of the classes that the library takes: flag,
# type, unit and help stand once, with the field (``ambrose.options``).

Kinds = Mapping[str, type[Options]]
Chosen = TypeVar("Chosen", bound=Options)
# of an annotation its first alternative -> what click makes of one word, and how many words
_TYPES: dict[str, tuple[Any, int]] = {
    "float": (float, 1),
    "int": (int, 1),
    "str": (str, 1),
    "Sequence[str]": (str, 1),
    "Mapping[str, float]": (str, 1),
    "Path": (click.Path(path_type=Path), 1),
    "LawLike": (click.Path(path_type=Path), 1),
    "tuple[float, float]": (float, 2),
}


def options_from(kinds: Kinds | type[Options], *only: str) -> Callable[[Any], Any]:
    """Decorator of a command: a flag for every option that the class, or any of several, has, or
    ``only`` for some.
    """
    several = {"": kinds} if isinstance(kinds, type) else kinds

    def decorate(command: Any) -> Any:
        for name in reversed(only or _names(several)):
            command = _flag(several, name)(command)
        return command

    return decorate


def groups_from(kinds: Kinds, every: str, word: str) -> dict[str, tuple[str, ...]]:
    """{title: options} for ``GroupedCommand``: those that all classes have under ``every``, others
    by what has them.
    """
    groups: dict[str, tuple[str, ...]] = {}
    for name in _names(kinds):
        having = kinds_with(kinds, name)
        title = every if len(having) == len(kinds) else f"With {word} {either(having)}"
        groups[title] = (*groups.get(title, ()), name)
    return groups


def chosen_from(
    kinds: Mapping[str, type[Chosen]], kind: str, asked: Mapping[str, Any], word: str
) -> Chosen:
    """The one of the classes that a command line chose, with the options given there.

    asked: what click gives for all options. Raises InvalidInput by the names of the flags.
    """
    refuse_foreign(kinds, "kind", kind, _stated(asked), {**_flags(), "kind": word})
    return asked_for(kinds[kind], asked)


def asked_for(kind: type[Chosen], asked: Mapping[str, Any]) -> Chosen:
    """A class with the options that a command line gives; asked as of ``chosen_from``. Raises
    InvalidInput by the names of the flags.
    """
    having, flags = {item.name: item for item in fields(kind)}, _flags()
    kind.check_rules({name: asked[name] for name in _stated(asked)}, flags)
    return kind(**{name: _read(having[name], asked[name], flags[name]) for name in _stated(asked)})


def _flags() -> dict[str, str]:
    """{option: its flag} of the command that runs."""
    command = click.get_current_context().command
    return {item.name: item.opts[-1] for item in command.params if item.name}


def _stated(asked: Mapping[str, Any]) -> list[str]:
    """The names of those that the command line states, and leaves to no default."""
    source = click.get_current_context().get_parameter_source
    return [name for name in asked if source(name) is not ParameterSource.DEFAULT]


def _names(kinds: Kinds) -> tuple[str, ...]:
    """All options that have a flag, in the order of the classes."""
    rows = [item for kind in kinds.values() for item in fields(kind)]
    return tuple(dict.fromkeys(item.name for item in rows if option_of(item).flag is not None))


def _flag(kinds: Kinds, name: str) -> Callable[[Any], Any]:
    """The click option of a field; where several classes have it they differ in meaning alone."""
    having = {
        key: item for key, kind in kinds.items() for item in fields(kind) if item.name == name
    }
    item = next(iter(having.values()))
    known, annotation = option_of(item), str(item.type).partition(" | ")[0]
    meanings: dict[str, list[str]] = {}
    for key, one in having.items():
        meanings.setdefault(option_of(one).meaning, []).append(key)
    # where the meanings differ, each after the names that it goes with
    help_text = " ".join(
        text if len(meanings) == 1 else f"{either(keys)}: {text}" for text, keys in meanings.items()
    )
    choices = list(dict.fromkeys(c for one in having.values() for c in option_of(one).choices))
    attributes: dict[str, Any] = {
        "help": help_text,
        "metavar": known.metavar,
        "default": () if known.many else item.default,
    }
    if annotation != "bool":
        kind, count = (str, 1) if known.dimension else _TYPES.get(annotation, (float, 1))
        attributes |= {"type": click.Choice(choices) if choices else kind}
        attributes |= {"nargs": count, "multiple": known.many}
        attributes["show_default"] = bool(item.default)
    elif "/" not in _spelled(item, known):
        attributes["is_flag"] = True
    return click.option(_spelled(item, known), name, **attributes)


def _spelled(item: Field[Any], known: Option) -> str:
    return known.flag or f"--{item.name.replace('_', '-')}"


def _read(item: Field[Any], value: Any, flag: str) -> Any:
    """A value of the command line in SI. Raises InvalidInput by its flag."""
    known = option_of(item)
    if known.dimension:
        return quantity_given(value, flag, known.dimension)
    if known.many:
        return value
    check_option(item, value, flag)
    if known.convert is None:
        return value
    return tuple(map(known.convert, value)) if isinstance(value, tuple) else known.convert(value)
