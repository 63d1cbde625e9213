"""`ambrose size`."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ambrose.options import AsItRuns
from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    asked_for,
    claim,
    kept,
    kept_page,
    load,
    options_from,
    print_table,
    progress_shown,
    say,
    say_json,
    say_verdict,
)

if TYPE_CHECKING:
    from ambrose.machine.machine import Machine

_LEVERS = ("gain", "weight", "area", "bias", "bandwidth")


@click.command()
@MACHINE
@click.option(
    "--areas", default=None, help='Pole areas over the machine file\'s: "0.35, 0.5, 0.7, 1".'
)
@click.option(
    "--biases", default=None, help='Bias currents over the machine file\'s: "0.5, 0.7, 1".'
)
@click.option(
    "--least",
    "lever",
    type=click.Choice(_LEVERS),
    default=None,
    help="Instead of the map the least of one thing.",
)
@click.option(
    "--tolerance", default=None, help='With --least: a tolerance to widen, "seal.center.k".'
)
@click.option(
    "--widths",
    default=None,
    help='Widths of the tolerance, "50 %, 100 %, 120 %"; the minimum is found for each.',
)
@click.option(
    "--reserve",
    type=float,
    default=2.0,
    show_default=True,
    help="Force over static load, at least.",
)
@click.option(
    "--order", type=int, default=None, help="States of the controllers; default: three per axis."
)
@options_from(AsItRuns)
@click.option("--unverified", is_flag=True, help="Do not verify the size that is taken.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=None,
    help="Write the map as a page (*.html).",
)
@click.option(
    "--machine-out",
    type=click.Path(path_type=Path),
    default=None,
    help="Write the machine of that size (*.toml).",
)
@AS_JSON
def size(
    machine: str,
    areas: str | None,
    biases: str | None,
    lever: str | None,
    tolerance: str | None,
    widths: str | None,
    reserve: float,
    order: int | None,
    unverified: bool,
    output: Path | None,
    machine_out: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """How small the magnets may be: every pole area with every bias current, and whether a
    controller meets every requirement.

    The size with the least copper and iron is verified. With --least: the least control gain, area,
    bias or amplifier bandwidth that still meets all, or the heaviest control weight with which mu
    stays at most 1; with --tolerance and --widths: what robustness costs. Exit status 1: nothing
    meets all, or the verification failed.
    """
    from ambrose.core.checks import InvalidInput
    from ambrose.synthesis.methods import Tuned

    if (tolerance is None) != (widths is None) or (tolerance is not None and lever is None):
        raise InvalidInput("--tolerance, --widths and --least go together; give all three")
    if lever is not None and (areas or biases or output or machine_out):
        raise InvalidInput(
            "--least gives no map; leave out --areas, --biases, --output and --machine-out"
        )
    description = load(machine)
    method = Tuned(order=order, **asked_for(AsItRuns, asked).values())
    if lever is not None:
        _least(description, lever, method, tolerance, _shares("--widths", widths), reserve, as_json)
    else:
        _map(
            description,
            _shares("--areas", areas),
            _shares("--biases", biases),
            method,
            reserve,
            unverified,
            output,
            machine_out,
            as_json,
        )


def _map(
    machine: Machine,
    areas: list[float],
    biases: list[float],
    method: Any,
    reserve: float,
    unverified: bool,
    output: Path | None,
    machine_out: Path | None,
    as_json: bool,
) -> None:
    from ambrose.annexes.sizing.least import AREAS, BIASES, size as sized
    from ambrose.judge.verdict import verify_controller
    from ambrose.machine.file.update import save_machine

    claim(page=output, machine_file=machine_out)
    failure, verified = None, None
    with progress_shown(as_json) as progress:
        result = sized(
            machine, areas or AREAS, biases or BIASES, method, reserve=reserve, progress=progress
        )
        knee = result.knee
        if knee is not None and knee.synthesis is not None and not unverified:
            progress("verifying the size that is taken")
            timing = method.timing(knee.machine)
            when = (
                {}
                if timing is None
                else {"rate": timing.rate, "delay_samples": timing.delay_samples}
            )
            verified = verify_controller(
                knee.machine,
                knee.synthesis,
                axes=knee.machine.group,
                progress=progress,
                **when,
            )
        failure = kept_page(result, output, verified, progress=progress)
        if machine_out is not None and knee is not None:
            failure = kept(lambda path: save_machine(knee.machine, path), machine_out) or failure
    passed = knee is not None and (verified is None or verified.passed)
    if as_json:
        rows = [_plain(trial) for trial in result.trials]
        say_json(
            {
                "rows": rows,
                "knee": None if knee is None else _plain(knee),
                "smaller": [_plain(t) for t in result.smaller],
                "verified": None if verified is None else verified.passed,
            }
        )
    else:
        cells = [
            (
                f"{t.size.area:.3g}",
                f"{t.size.bias:.3g}",
                _number(t.ratio),
                _number(t.sensitivity),
                f"{t.costs.copper_loss:.3g}",
                f"{t.costs.volt_amperes:.3g}",
                t.binding,
            )
            for t in result.trials
        ]
        heads = ("area", "bias", "ratio", "S_o", "copper loss", "volt-amperes", "what binds")
        print_table(f"{machine.name}: sizes over the machine file's", heads, cells)
        if knee is None:
            none = "No size meets all requirements. Try larger ones, or relax the binding one."
            say_verdict(none, in_full=none)
        else:
            least = (
                f"Least copper and iron: {knee.size.area:.3g} of the area at {knee.size.bias:.3g} "
                "of the bias current."
            )
            say_verdict(least, in_full=least)
            if result.at_edge:
                say(
                    "It is the smallest, or the lowest bias, that was tried: ask for smaller "
                    "ones, too."
                )
            for trial in result.smaller:
                say(
                    f"One size smaller, {trial.size.area:.3g} at {trial.size.bias:.3g}: "
                    f"{trial.binding}, {_number(trial.ratio)}"
                )
        if verified is not None:
            failed = ", ".join(verified.facts()["failed"])
            say(
                f"Verification of that size: {'passed' if verified.passed else 'failed: ' + failed}"
            )
    if failure is not None:
        raise failure
    sys.exit(0 if passed else 1)


def _least(
    machine: Machine,
    lever: str,
    method: Any,
    tolerance: str | None,
    widths: list[float],
    reserve: float,
    as_json: bool,
) -> None:
    from ambrose.annexes.sizing.least import least, price
    from ambrose.machine.parameters import find_uncertain

    with progress_shown(as_json) as progress:
        if tolerance is not None:
            find_uncertain(machine, tolerance)
            priced = price(
                machine, tolerance, widths, lever, method, reserve=reserve, progress=progress
            )
            found, labels = priced.found, [f"+-{100 * width:.4g} %" for width in priced.widths]
        else:
            found, labels = (
                (least(machine, lever, method, reserve=reserve, progress=progress),),
                ["machine file"],
            )
    unit = "A/m" if lever == "gain" else "of the machine file's"
    if as_json:
        rows = [
            {
                "width": label,
                "least": _finite(item.value),
                "failed": _finite(item.refused),
                "binding": item.binding,
                "searched": item.searched,
            }
            for label, item in zip(labels, found, strict=True)
        ]
        say_json({"lever": lever, "unit": unit, "tolerance": tolerance, "rows": rows})
    else:
        cells = [
            (label, _number(item.value), _number(item.refused), item.binding)
            for label, item in zip(labels, found, strict=True)
        ]
        word, fewer = ("largest", "more") if lever == "weight" else ("least", "less")
        heads = (
            tolerance or "tolerances",
            f"{word} {lever} [{unit}]",
            "next, failed",
            "what binds",
        )
        print_table(f"{machine.name}: the {word} found that meets all", heads, cells)
        for words in dict.fromkeys(item.searched for item in found):
            say(f"Searched: {words}. More states or another start may find {fewer}.")
    sys.exit(0 if all(0 < item.value < math.inf for item in found) else 1)


def _plain(trial: Any) -> dict[str, Any]:
    return {
        "area": trial.size.area,
        "bias": trial.size.bias,
        "met": trial.met,
        "ratio": _finite(trial.ratio),
        "sensitivity": _finite(trial.sensitivity),
        "gain": _finite(trial.gain),
        "copper_loss": trial.costs.copper_loss,
        "volt_amperes": trial.costs.volt_amperes,
        "reserve": _finite(trial.costs.reserve),
        "capacity_margin": _finite(trial.capacity),
        "capacity_of": trial.demand,
        "binding": trial.binding,
        "ratios": trial.ratios,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) and value else "-"


def _shares(option: str, text: str | None) -> list[float]:
    """Numbers between commas, "0.5" or "50 %". Raises InvalidInput."""
    from ambrose.core.checks import invalid

    found = []
    for word in (text or "").split(","):
        if not word.strip():
            continue
        number, percent = word.strip().removesuffix("%").strip(), word.strip().endswith("%")
        try:
            found.append(float(number) / (100 if percent else 1))
        except ValueError:
            raise invalid(
                f"a value of {option}",
                repr(word.strip()),
                "a number or per cent",
                'write "0.5, 1" or "50 %, 100 %"',
            ) from None
    return found
