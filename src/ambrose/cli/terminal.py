"""What the commands share: options, progress, tables."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import click

ALL = click.option("--all", "everything", is_flag=True, help="Show the quantities without a limit as well.")
AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
MACHINE = click.argument("machine")
RATE = click.option("--rate-hz", type=float, default=None, help="Sample rate; default: the controller's or the machine file's.")
DELAY = click.option(
    "--delay-samples", type=int, default=None, help="From measured errors to currents set; default: the machine file's, or 1."
)


def load(machine: str) -> Any:
    from ambrose.machine.file.toml import load_machine

    return load_machine(machine)


@contextmanager
def progress_shown(quiet: bool) -> Iterator[Callable[[str], None]]:
    """A spinner with the present stage and its time on a terminal, one line per stage elsewhere; nothing with --json."""
    if quiet:
        yield lambda stage: None
        return
    if not sys.stderr.isatty():
        yield lambda stage: click.echo(f"  {stage}", err=True)
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        tasks: list[Any] = []

        def step(stage: str) -> None:
            if tasks:
                bar.update(tasks[-1], total=1, completed=1)
            tasks.append(bar.add_task(stage, total=None))

        yield step
        if tasks:
            bar.update(tasks[-1], total=1, completed=1)


def print_table(title: str, columns: Sequence[str], rows: Sequence[tuple[str, ...]], marks: Sequence[str] = ()) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 140)
    table = Table(title=title, title_justify="left", title_style="bold")
    for column in columns:
        table.add_column(column, overflow="fold")
    for i, row in enumerate(rows):
        table.add_row(*row, style=marks[i] if marks else None)
    console.print(table)


def print_checks(checks: Any, everything: bool) -> None:
    """One operating point: the verdict in words, then the checks that have a limit (or all), without their sources."""
    from ambrose.report.tables import checks_table, verdict

    table = checks_table(checks)
    keep = [i for i, column in enumerate(table.columns) if not column.startswith("Standard")]
    shown = [i for i, check in enumerate(checks.checks) if everything or check.passed is not None]
    rows = [tuple(f"{table.cells[k][i].symbol} {table.cells[k][i].text}".strip() for i in keep) for k in shown]
    marks = tuple("red" if checks.checks[k].passed is False else "" for k in shown)
    print_table(f"{checks.label}: {verdict(checks).text}", tuple(table.columns[i] for i in keep), rows, marks)


def shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def claim(**places: Path | None) -> None:
    """Holds the files that a command will write until it ends: what cannot be written, or is being written by another run, is
    refused before the work begins. Raises InvalidInput."""
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.atomic_write import check_file
    from ambrose.machine.claim import claimed

    known: dict[str, str] = {}
    for what, path in ((what.replace("_", " "), path) for what, path in places.items() if path is not None):
        check_file(path, what)
        if (other := known.setdefault(os.path.realpath(path), what)) != what:
            raise InvalidInput(f"{path} is to hold the {other} and the {what}; give one of them another name")
        click.get_current_context().with_resource(claimed(path, what))


def kept(write: Callable[[Path], Any], path: Path) -> Exception | None:
    """Writes a result at the end of the work; where that fails, into the folder for temporary files instead. Returns what to
    raise after the other results are printed; None: nothing failed."""
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
