"""`ambrose campaign`."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Any

import click

from ambrose.terminal import AS_JSON, print_table, progress_shown, say, say_json

_REASONS = 5  # why cases failed, the most frequent ones


@click.command()
@click.argument("plan", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="A folder; default: the plan's name without .toml.",
)
@click.option(
    "--engine",
    default="processes",
    show_default=True,
    help="processes, dask, or a Dask scheduler's address.",
)
@click.option("--workers", type=click.IntRange(1, 4096), help="Default: one for each processor.")
@click.option(
    "--most", type=click.IntRange(0), help="At most this many cases now; the next run continues."
)
@click.option(
    "--pages",
    type=click.IntRange(0, 1000),
    default=10,
    show_default=True,
    help="Of the worst cases, one for each.",
)
@AS_JSON
def campaign(
    plan: Path,
    output: Path | None,
    engine: str,
    workers: int | None,
    most: int | None,
    pages: int,
    as_json: bool,
) -> None:
    """Compute a plan of many cases: anything varied in machine, controller, scenario and operating
    point.

    Rows are kept as they come: an interrupted run continues where it stopped. Leaves
    rows.jsonl, table.csv, results.nc (with xarray) and report.html in the folder. Exit status 1: a
    case has no values, is unstable or does not pass.
    """
    from ambrose.annexes.campaigns.plan import read_plan
    from ambrose.annexes.campaigns.result import counts, read_campaign
    from ambrose.annexes.campaigns.run import executors, run_plan
    from ambrose.core.processes import processors
    from ambrose.report.page import page_of, write

    wanted = read_plan(plan)
    folder = output or plan.with_suffix("")
    with progress_shown(as_json) as progress:
        with executors(engine, workers or processors()) as (make, count):
            done = run_plan(wanted, folder, make=make, workers=count, progress=progress, most=most)
        progress("writing the table and the page")
        result = read_campaign(wanted, folder)
        files = result.write(folder)
        machine, page_count = _case_pages(result, folder, pages, progress)
        files.append(write(page_of(result, machine, page_count), folder / "report.html"))
    summary = counts(result)
    if as_json:
        run = {
            "computed_now": done.computed,
            "lost_now": done.lost,
            "seconds": done.seconds,
            "files": [str(path) for path in files],
        }
        say_json({**result.to_dict(), **run})
    else:
        rate = (
            f", {done.computed / done.seconds:.3g} a second with {count} workers"
            if done.computed
            else ""
        )
        say(
            f"{done.rows} of {done.cases} cases are there, {done.computed} of them computed "
            f"now{rate}."
        )
        print_table(
            f"{wanted.task}: {plan.stem}",
            ("what", "found"),
            [(name, text) for name, _, text in summary],
        )
        effects = [(path, f"{100 * share:.3g} %") for path, share in result.effects().items()]
        if effects:
            print_table(
                f"What drives {result.measure}", ("setting", "share of the variance"), effects
            )
        reasons = Counter(text for text in result.failures if text).most_common(_REASONS)
        if reasons:
            print_table(
                "Why cases have no values",
                ("cases", "reason"),
                [(str(number), text) for text, number in reasons],
            )
        if done.lost:
            remedy = "run the same command again, or with --workers 1"
            say(
                f"{done.lost} cases have no row: their processes died (short of memory?); {remedy}."
            )
        say(f"Files: {', '.join(str(path) for path in files)}")
    sys.exit(1 if done.lost or any(good is False for _, good, _ in summary) else 0)


def _case_pages(result: Any, folder: Path, most: int, progress: Any) -> tuple[Any, list[str]]:
    """Pages of the worst cases, those that are there kept. Returns the machine of the plan's first
    case and their keys.
    """
    from ambrose.annexes.campaigns.plan import subject
    from ambrose.annexes.campaigns.result import case_page
    from ambrose.annexes.campaigns.run import bases_of, fixed_of
    from ambrose.core.checks import AmbroseError
    from ambrose.machine.file.toml import load_machine
    from ambrose.machine.ordinary_file import make_folder
    from ambrose.report.page import write

    plan = result.plan
    name = plan.named("machine")[0]
    machine = load_machine(plan.place(name) if plan.place(name).is_file() else name)
    if plan.task == "design":
        return machine, []
    wanted = result.worst_first[:most].tolist()
    cases = (
        {case.key: case for case in plan.drawn() if case.key in {result.keys[i] for i in wanted}}
        if wanted
        else {}
    )
    missing = [key for key in cases if not (folder / "cases" / f"{key}.html").exists()]
    if missing:
        progress(f"pages of {len(missing)} worst cases")
        bases, fixed = bases_of(plan), fixed_of(plan)
        for key in missing:
            try:
                page = case_page(
                    plan.task, key, cases[key].by_path, subject(cases[key], bases, fixed)
                )
                write(page, make_folder(folder / "cases") / f"{key}.html")
            except AmbroseError as error:
                progress(f"no page of case {key[:8]}: {error}")
    return machine, [key for key in cases if (folder / "cases" / f"{key}.html").exists()]
