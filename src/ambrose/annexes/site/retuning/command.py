"""`ambrose retune`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    kept_page,
    load,
    load_controller,
    print_table,
    progress_shown,
    say,
    say_json,
)

# a step's verdict: passed, failed, or nothing to judge
_WORDS = {True: "holds", False: "does not hold", None: "for information"}


@click.command()
@MACHINE
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--controller",
    required=True,
    type=click.Path(path_type=Path),
    help="The controller that ran (*.json), a fixed one.",
)
@click.option(
    "--unknown",
    multiple=True,
    metavar="PATH",
    help="What to identify, as for identify (repeatable). Default: as identify chooses.",
)
@click.option(
    "--bending-modes",
    type=click.IntRange(min=0),
    default=3,
    show_default=True,
    help="Per plane in the model that is fitted.",
)
@click.option(
    "--accept",
    "after",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A record with the new controller running, to accept the change by (repeatable).",
)
@click.option(
    "--changed",
    is_flag=True,
    help="The machine is known to have changed beyond the file's own tolerances.",
)
@click.option(
    "--anyway", is_flag=True, help="Design a new one also where the running one still holds."
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("retuning"),
    show_default=True,
    help="The folder.",
)
@AS_JSON
def retune(
    machine: str,
    records: tuple[Path, ...],
    controller: Path,
    unknown: tuple[str, ...],
    bending_modes: int,
    after: tuple[Path, ...],
    changed: bool,
    anyway: bool,
    output: Path,
    as_json: bool,
) -> None:
    """From a record of the running machine to another controller: proved, coded, tried, on a page
    to sign.

    RECORDS hold excitations e_<axis> and displacements y_<axis>, with u_<axis> best. Identifies the
    machine, says what changed, judges the running controller over the identified intervals; where
    that no longer holds, tunes another of its structure, proves it, writes its code and what of it
    changes, and tries the change and the way back on the virtual rig. Exit status 1: stopped at the
    first step that does not hold; what was done stays in the folder.
    """
    from ambrose.annexes.site.retuning.chain import PAGE
    from ambrose.annexes.site.retuning.chain import retune as run

    description = load(machine)
    law = load_controller(controller, description)
    with progress_shown(as_json) as progress:
        done = run(
            description,
            records,
            law,
            output,
            unknown=unknown,
            bending_modes=bending_modes,
            accept_from=after,
            changed=changed,
            anyway=anyway,
            progress=progress,
        )
        page = output / PAGE
        failure = kept_page(done, page, progress=progress)
    if as_json:
        say_json({**done.to_dict(), "page": None if failure else str(page)})
    else:
        rows = [(step.title, _WORDS[step.passed], step.words) for step in done.steps]
        marks = ["red" if step.passed is False else "" for step in done.steps]
        print_table(f"Retuning of {done.given.name}", ("step", "verdict", "found"), rows, marks)
        say(f"{done.text[:1].upper()}{done.text[1:]}.")
        if failure is None:
            say(f"Page: {page}")
    if failure is not None:
        raise failure
    sys.exit(0 if done.passed else 1)
