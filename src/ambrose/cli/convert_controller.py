"""`ambrose convert controller`."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ambrose.terminal import AS_JSON, claim, load, progress_shown, say, say_json

if TYPE_CHECKING:
    from ambrose.judge.result import Synthesis

# core/sampling.py, which is not imported for --help
METHODS = ("tustin", "zoh", "backward-euler", "matched")


@click.command()
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--machine", help="The machine that it is for: axes, signs and units are tried on its loop."
)
@click.option(
    "--axes",
    help='Names of its channels in their order, such as "A_zeta,A_eta"; default: its own, else '
    "the machine's.",
)
@click.option(
    "--input",
    "given",
    type=click.Choice(["error", "displacement"]),
    help="What it takes: the error r - y (default), or the displacement y, whose sign is then "
    "turned.",
)
@click.option(
    "--input-unit", help="Unit of what it takes, such as um; default: the file's, else m."
)
@click.option(
    "--output-unit", help="Unit of its currents, such as mA; default: the file's, else A."
)
@click.option(
    "--rate-hz",
    type=float,
    help="Rate of coefficients of z, where the file has none; with --sampling the new rate.",
)
@click.option(
    "--delay-samples", type=int, help="From measured errors to currents set; default: the file's."
)
@click.option(
    "--sampling",
    type=click.Choice(METHODS),
    help="Sample a continuous controller so, at --rate-hz.",
)
@click.option(
    "--prewarp-hz",
    type=float,
    help="Tustin exact at this frequency; of matched: where the gain is that of before.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("controller.json"),
    show_default=True,
)
@AS_JSON
def convert_controller(
    source: Path, machine: str | None, output: Path, as_json: bool, **asked: Any
) -> None:
    """Write a controller of another program as a controller file, for verify, simulate, identify
    and export.

    SOURCE holds difference equations (b, a), second-order sections, or zeros, poles and gain per
    channel (*.csv, *.json, *.mat), transfer-function or state-space matrices (*.json, *.mat), or is
    a controller file. With --machine the loop is closed around the full plant at every operating
    point: exit status 1 where it is unstable, with the sign or unit that would hold it.
    """
    write_imported(source, machine, output, as_json, **asked)


def write_imported(
    source: Path,
    machine: str | None,
    output: Path,
    as_json: bool,
    *,
    sampling: str | None = None,
    prewarp_hz: float | None = None,
    given: str | None = None,
    rate_hz: float | None = None,
    axes: str | None = None,
    **stated: Any,
) -> None:
    """What the command does; also `ambrose convert SOURCE -o NAME.json`."""
    from ambrose.code.sampled import instability
    from ambrose.core.checks import InvalidInput
    from ambrose.judge.controller_file import read_controller, write_controller
    from ambrose.law.filter_table import FEEDBACK
    from ambrose.synthesis.imported_controller import named_for, not_held, resampled

    known = None if machine is None else load(machine)
    claim(controller_file=output)
    stated |= {"input": given, "axes": axes, "rate_hz": None if sampling else rate_hz}
    if axes is None and known is not None:
        stated["default_axes"] = known.axes
    law = read_controller(source, **stated)
    if sampling is not None:
        law = resampled(law, rate_hz, sampling, prewarp_hz)
    elif prewarp_hz is not None:
        raise InvalidInput(
            "--prewarp-hz goes with --sampling tustin or matched; name it, or leave it out"
        )

    def other() -> Synthesis:
        assert known is not None
        turned = read_controller(source, **stated, **{FEEDBACK: True})
        return replace(turned, controller=named_for(known, turned.controller))

    wrong, lost = instability(law.controller), list[str]()
    if known is not None:
        law = replace(law, controller=named_for(known, law.controller))
        with progress_shown(as_json) as progress:
            lost = not_held(known, law, progress, other if law.controller.dt else None)
    write_controller(output, law, known)
    kind = (
        "continuous" if law.controller.dt is None else f"sampled at {1 / law.controller.dt:.6g} Hz"
    )
    verified = None if known is None else not lost
    summary = {
        "controller": str(output),
        "inputs": law.controller.inputs,
        "states": law.controller.n_states,
        "kind": kind,
        "held": verified,
        "problems": [*wrong, *lost],
    }
    where = f"; it holds {known.name} at every operating point" if known and verified else ""
    text = (
        f"{output}: {law.controller.n_states} states, {kind}, from "
        f"{', '.join(law.controller.inputs)}{where}"
    )
    if as_json:
        say_json(summary)
    else:
        for line in (text, *lost):
            say(line)
    for problem in wrong:
        say(f"careful: {problem}", err=True)
    sys.exit(1 if verified is False else 0)
