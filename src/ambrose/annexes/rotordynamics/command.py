"""`ambrose lateral` and `ambrose compare`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ambrose.core.checks import InvalidInput
from ambrose.options import AsItRuns
from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    asked_for,
    claim,
    kept,
    kept_page,
    load,
    load_controller,
    one_screen,
    options_from,
    print_table,
    progress_shown,
    say,
    say_json,
    say_verdict,
)

if TYPE_CHECKING:
    from ambrose.annexes.rotordynamics.comparison import Comparison, Pair
    from ambrose.annexes.rotordynamics.result import Item

_MOST_ROWS = 200  # of a comparison in a terminal


@click.command("lateral")
@MACHINE
@click.option(
    "--controller",
    type=click.Path(path_type=Path),
    default=None,
    help="The controller: its file, or a table of coefficients; left out for a rotor on journal "
    "bearings alone.",
)
@click.option(
    "--point", help="The operating point at maximum continuous speed; default: the fastest one."
)
@click.option(
    "--trip-rpm",
    type=float,
    default=None,
    help="Trip speed; default: 1.05 times the highest running speed.",
)
@click.option(
    "--density",
    type=float,
    default=None,
    help="Mean gas density [kg/m3], for the screening of Level I.",
)
@click.option("--nominal", is_flag=True, help="Without the search over the tolerances.")
@options_from(AsItRuns)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="The report as a page (*.html)."
)
@click.option(
    "--beside",
    type=click.Path(path_type=Path),
    help="Another analysis (its lateral.json: before and after), a table of measured values or of "
    "another code (*.csv), or frequency responses that were measured while this controller ran, "
    "side by side with this one.",
)
@click.option("--data", type=click.Path(path_type=Path), help="The report as data (lateral.json).")
@AS_JSON
def lateral_command(
    machine: str,
    controller: Path | None,
    point: str | None,
    trip_rpm: float | None,
    density: float | None,
    nominal: bool,
    output: Path | None,
    beside: Path | None,
    data: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Lateral analysis after API 617 and ISO 14839, clause by clause.

    Unbalance response with API's amounts placed for every mode, separation margins, vibration
    limit, clearances up to trip, stability Level I and II with each component's share, and
    load capacity. Clauses are recalled, not read from the standards, and marked so. Exit status 1:
    a requirement is not met, or one that the standard requires was not checked.
    """
    from ambrose.annexes.rotordynamics.analysis import lateral
    from ambrose.annexes.rotordynamics.comparison import beside_responses, compare, read_theirs
    from ambrose.annexes.rotordynamics.page import verdict_words
    from ambrose.annexes.rotordynamics.standard import RPM
    from ambrose.law.loop import timing_of
    from ambrose.record.response_files import holds_responses, read_response

    description = load(machine, magnets=False)
    law = None if controller is None else load_controller(controller, description)
    other, responses = None, None
    if beside is not None and holds_responses(beside):
        responses = read_response(beside)
        if law is None:
            raise InvalidInput("responses of a loop are compared with it; give its --controller")
    elif beside is not None:
        other = read_theirs(beside)
    claim(page=output, data=data)
    with progress_shown(as_json) as progress:
        result = lateral(
            description,
            law,
            point,
            trip=None if trip_rpm is None else trip_rpm * RPM,
            density=density,
            tolerances=not nominal,
            progress=progress,
            **asked_for(AsItRuns, asked).values(),
        )
        comparison = None if other is None else compare(result, other)
        if responses is not None and law is not None and beside is not None:
            how = asked_for(AsItRuns, asked)
            timing = timing_of(
                description, law, how.rate or responses.sample_rate_hz, how.delay_samples
            )
            comparison = replace(
                beside_responses(description, law, responses, timing), theirs_name=beside.name
            )
        failure = kept_page(result, output, progress=progress, comparison=comparison)
        if data is not None:
            failure = kept(lambda path: _write(result, path), data) or failure
    if as_json:
        sides = {} if comparison is None else {"beside": comparison.to_dict()}
        say_json(dict(result.to_dict()) | sides)
    else:
        shown = [item for item in result.items if item.value is not None or item.passed is not None]
        rows = [
            (
                item.title,
                value_in_words(item),
                "-" if item.limit is None else f"{item.relation} {item.limit:.4g}",
                "-" if item.passed is None else "meets" if item.passed else "fails",
            )
            for item in shown
        ]
        marks = ["red" if item.passed is False else "" for item in shown]
        title = f"{description.name}: lateral analysis"
        print_table(title, ("item", "value", "limit", ""), rows, marks)
        if comparison is not None:
            print_comparison(comparison)
        left_out = [item for item in result.items if item.left_out]
        say_verdict(f"{verdict_words(result)}.")
        if one_screen() is not None and left_out:
            titles = "; ".join(item.title for item in left_out)
            say(f"Not checked, {len(left_out)} clauses: {titles}.")
            left_out = []
        for item in result.items:
            if item.passed is False or item in left_out:
                verdict = "not checked" if item.left_out else "fails"
                say(f"{verdict}: {item.title}: {item.note}")
        for note in result.notes:
            say(note)
    if failure is not None:
        raise failure
    sys.exit(0 if result.passed else 1)


@click.command("compare")
@click.argument("mine", type=click.Path(path_type=Path))
@click.argument("theirs", type=click.Path(path_type=Path))
@click.option("--within", type=float, help="The largest difference that is accepted [%].")
@AS_JSON
def compare_command(mine: Path, theirs: Path, within: float | None, as_json: bool) -> None:
    """Compare a lateral analysis with another code's results, or with measured ones.

    MINE is the lateral.json of `ambrose lateral --data`; THEIRS a table (*.csv) with the columns
    kind (critical, mode or response), speed [rpm], amplitude [um p-p], amplification [-],
    log_decrement [-] or damping_ratio [%], whirl, probe, case, label, or another lateral.json.
    Exit status 1: no row has a partner; with --within, a row differs by more or has none.
    """
    from ambrose.annexes.rotordynamics.comparison import compare

    result = compare(mine, theirs, within=within)
    if as_json:
        say_json(result.to_dict())
    else:
        print_comparison(result)
    sys.exit(1 if result.passed is False else 0)


def print_comparison(result: Comparison) -> None:
    """The pairs as a table, and how far they are apart."""
    from ambrose.annexes.rotordynamics.page import comparison_texts

    if result.agreement:
        say(f"{result.theirs_name}: {result.agreement}")
    if result.responses and not result.pairs:
        say("No resonance stands out of the measured responses.")
        return
    print_table(
        f"{result.machine} beside {result.theirs_name}",
        ("where", "quantity", "theirs", "ours", "ours less theirs", ""),
        [comparison_texts(pair) for pair in foremost(result.pairs)],
    )
    if len(result.pairs) > _MOST_ROWS:
        say(
            f"{_MOST_ROWS} of {len(result.pairs):,} rows: first those without a partner, then the "
            "largest differences; --json has all"
        )
    if not result.compared:
        what = f"none of the {len(result.pairs)} rows has a partner" if result.pairs else "no row"
        say(f"no row was compared: {what}; see the remarks in the table, and check units")
        return
    if result.largest_percent is not None:
        say(f"largest difference {result.largest_percent:.3g} %")
    if result.unpaired:
        say(f"{len(result.unpaired)} rows without a partner")


def foremost(pairs: Sequence[Pair], most: int = _MOST_ROWS) -> list[Pair]:
    """At most so many pairs, in their order: first those without a partner, then those with the
    largest differences in per cent.
    """

    def rank(i: int) -> tuple[bool, float]:
        return pairs[i].ours is not None, -abs(pairs[i].percent or 0.0)

    kept = sorted(sorted(range(len(pairs)), key=rank)[:most])
    return [pairs[i] for i in kept]


def value_in_words(item: Item) -> str:
    """A row's value with its unit, "-" without one."""
    from ambrose.annexes.rotordynamics.result import not_finite

    if item.value is None:
        return "-"
    if not isfinite(item.value):
        return not_finite(item.value)
    return f"{item.bound} {item.value:.4g} {item.unit}".lstrip().rstrip(" -")


def _write(result: Any, path: Path) -> None:
    from ambrose.machine.ordinary_file import write_json

    write_json(path, dict(result.to_dict()), "lateral analysis")
