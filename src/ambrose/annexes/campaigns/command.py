"""`ambrose campaign`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ambrose.terminal import AS_JSON, print_table, progress_shown, say, say_json


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
    "--most", type=click.IntRange(0), help="At most so many cases now; the next run goes on."
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

    Rows are kept as they come: a run that was interrupted or killed goes on where it was. Leaves
    rows.jsonl, table.csv, results.nc (with xarray) and report.html in the folder. Exit status 1: a
    case has no values, is unstable or does not pass.
    """
    from ambrose.annexes.campaigns.page import counts
    from ambrose.annexes.campaigns.plan import read_plan
    from ambrose.annexes.campaigns.result import read_campaign
    from ambrose.annexes.campaigns.run import executors, processors, run_plan
    from ambrose.report.page import page_of, write

    wanted = read_plan(plan)
    folder = output or plan.with_suffix("")
    with progress_shown(as_json) as progress:
        with executors(engine, workers or processors()) as (make, count):
            done = run_plan(wanted, folder, make=make, workers=count, progress=progress, most=most)
        progress("writing the table and the page")
        found = read_campaign(wanted, folder)
        files = found.write(folder)
        machine, shown = _case_pages(found, folder, pages, progress)
        files.append(write(page_of(found, machine, shown), folder / "report.html"))
    told = counts(found)
    if as_json:
        run = {
            "computed_now": done.computed,
            "seconds": done.seconds,
            "files": [str(path) for path in files],
        }
        say_json({**found.to_dict(), **run})
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
            [(name, text) for name, _, text in told],
        )
        effects = [(path, f"{100 * share:.3g} %") for path, share in found.effects().items()]
        if effects:
            print_table(
                f"What drives {found.measure}", ("setting", "share of the variance"), effects
            )
        say(f"Files: {', '.join(str(path) for path in files)}")
    sys.exit(1 if any(good is False for _, good, _ in told) else 0)


def _case_pages(found: Any, folder: Path, most: int, progress: Any) -> tuple[Any, list[str]]:
    """Pages of the worst cases, those that are there kept. Returns the machine of the plan's first
    case and their keys.
    """
    from ambrose.annexes.campaigns.case import subject
    from ambrose.annexes.campaigns.page import case_page
    from ambrose.annexes.campaigns.run import bases_of, fixed_of
    from ambrose.core.checks import AmbroseError
    from ambrose.machine.atomic_write import make_folder
    from ambrose.machine.file.toml import load_machine
    from ambrose.report.page import write

    plan = found.plan
    name = plan.named("machine")[0]
    machine = load_machine(plan.place(name) if plan.place(name).is_file() else name)
    if plan.task == "design":
        return machine, []
    wanted = found.worst_first[:most].tolist()
    cases = (
        {case.key: case for case in plan.drawn() if case.key in {found.keys[i] for i in wanted}}
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
