"""`ambrose retune`."""

from __future__ import annotations

import cmath
import math
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ambrose.options import AsItRuns
from ambrose.terminal import (
    ALL,
    AS_JSON,
    MACHINE,
    claim,
    kept,
    kept_page,
    load,
    load_controller,
    options_from,
    print_checks,
    print_table,
    progress_shown,
    say,
    say_json,
    say_verdict,
)

if TYPE_CHECKING:
    from ambrose.machine.machine import Machine

# `ambrose accept`.


@click.command()
@MACHINE
@click.argument("controller", type=click.Path(path_type=Path))
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@options_from(AsItRuns, "delay_samples")
@click.option(
    "--harmonics",
    type=int,
    default=3,
    show_default=True,
    help="Harmonics of the speed to remove.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="The page to sign (*.html).")
@ALL
@AS_JSON
def accept(
    machine: str,
    controller: Path,
    records: tuple[Path, ...],
    delay_samples: int | None,
    harmonics: int,
    output: Path | None,
    everything: bool,
    as_json: bool,
) -> None:
    """Measure sensitivity, open and closed loop on the running machine, and compare them with
    their limits.

    RECORDS contain the displacements y_<axis> and excitations e_<axis> (or references r_<axis>) on
    every axis, at standstill or running, at one operating point or several; or they are an
    analyser's frequency responses, one file for each point. CONTROLLER is the file of the
    controller that ran; with u_<axis> this is checked. Limits and zones (ISO 14839-3) apply to the
    outer end of the 95 % intervals. Exit status 1: measured, but a check failed.
    """
    from ambrose.annexes.site.acceptance import accept as accepted
    from ambrose.law.loop import timing_in_words

    description = load(machine)
    law = load_controller(controller, description)
    claim(page=output)
    with progress_shown(as_json) as progress:
        progress("measuring the loop")
        result = accepted(
            description, law, records, harmonics=harmonics, delay_samples=delay_samples
        )
        failure = kept_page(result, output, progress=progress)
    if as_json:
        say_json({**result.to_dict(), "page": str(output) if output and failure is None else None})
    else:
        for loop in result.points:
            print_checks(loop.checks, everything)
            for note in loop.checks.notes:
                say(note)
        say(f"The measured loop is {timing_in_words(str(result.timing))}.")
        if output is not None and failure is None:
            say(f"Page: {output}")
    if failure is not None:
        raise failure
    sys.exit(0 if result.passed else 1)


# `ambrose balance`.


@click.command()
@MACHINE
@click.argument("records", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--plane",
    "planes",
    multiple=True,
    required=True,
    metavar="NAME=RADIUS",
    help="Where masses go: a bearing, disc, seal or coupling of the machine, and the radius: "
    '"impeller=80 mm" (repeatable).',
)
@click.option(
    "--trial",
    "trials",
    nargs=2,
    multiple=True,
    metavar="RECORD WEIGHTS",
    help='A record with known weights on: "impeller=2 g@30", or several, with commas between; '
    "degrees (repeatable).",
)
@click.option("--controller", type=click.Path(path_type=Path), help="The controller that ran.")
@click.option(
    "--amplitudes",
    type=click.Path(path_type=Path),
    help="In place of records: the amplitudes of converged current-free blocks (*.csv with "
    "speed_rpm, axis, amplitude_um_0p, angle_deg).",
)
@click.option(
    "--since",
    type=click.Path(path_type=Path),
    help="With --amplitudes: an earlier table of amplitudes; the unbalance added since is found "
    "and balanced.",
)
@click.option(
    "--settle",
    type=float,
    default=0.3,
    show_default=True,
    help="Seconds left out at the beginning of every record.",
)
@AS_JSON
def balance(
    machine: str,
    records: tuple[Path, ...],
    planes: tuple[str, ...],
    trials: tuple[tuple[str, str], ...],
    controller: Path | None,
    amplitudes: Path | None,
    since: Path | None,
    settle: float,
    as_json: bool,
) -> None:
    """Correction masses from what turns once with the rotor, in g and degrees, with the residual
    that they will leave.

    RECORDS contain y_<axis> and u_<axis> (or i_<axis>) at steady speeds, one or several; one at
    slow
    roll gives the run-out. With as many trial runs as planes, at the same speed, the influence
    coefficients are measured; without, they are the model's. Degrees count in the direction of spin
    from the key mark, which points along x when the signal key rises. Exit status 1: done, but the
    planes are poorly distinguished, run-out is unknown, or the correction may not lower the
    vibration;
    with --since: the unbalance has changed.
    """
    from ambrose.annexes.site.balancing import balance as balanced
    from ambrose.annexes.site.balancing_vectors import balance_amplitudes, grown, read_amplitudes
    from ambrose.annexes.site.pages import balancing_tables, in_words

    _check_sources(records, trials, amplitudes, since)
    description = load(machine)
    radii = {
        name: _read(text, "--plane", "length", f"{name}=80 mm") for name, text in map(_pair, planes)
    }
    weights = [(Path(record), _weights(text, radii)) for record, text in trials]
    law = load_controller(controller, description) if controller else None
    if amplitudes is not None:
        axes = description.axes
        earlier = None if since is None else read_amplitudes(since, axes)
        result = balance_amplitudes(
            description,
            read_amplitudes(amplitudes, axes),
            radii,
            before=earlier,
            controller=law,
        )
        passed = result.passed if since is None else not grown(result)
    else:
        result = balanced(
            description, records, radii, trials=weights, controller=law, settle=settle
        )
        passed = result.passed
    if as_json:
        say_json(result.to_dict())
    else:
        for table in balancing_tables(result):
            rows = [tuple(cell.text for cell in row) for row in table.cells]
            print_table(table.title, table.columns, rows)
        for line in in_words(result):
            say(line)
    sys.exit(0 if passed else 1)


def _check_sources(
    records: tuple[Path, ...],
    trials: tuple[tuple[str, str], ...],
    amplitudes: Path | None,
    since: Path | None,
) -> None:
    """Raises InvalidInput unless there are records, or amplitudes with nothing that goes with
    records.
    """
    from ambrose.core.checks import InvalidInput, invalid

    if amplitudes is None:
        if since is not None:
            raise invalid("--since", since, "given with --amplitudes", "give the table of now")
        if not records:
            raise InvalidInput("no record is given; name one, or a table with --amplitudes")
        return
    for name, value in {"a record": records, "--trial": trials}.items():
        if value:
            raise InvalidInput(
                f"{name} is given with --amplitudes; a table of amplitudes needs no record: "
                "leave it out"
            )


def _pair(text: str) -> tuple[str, str]:
    name, _, value = text.partition("=")
    return name.strip(), value.strip()


def _read(text: str, option: str, dimension: str, example: str) -> float:
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.units import DIMENSIONS, read_quantity

    bare = False
    with suppress(ValueError):
        bare = math.isfinite(float(text))
    if bare:
        raise InvalidInput(f'{option} {text!r} has no unit; write it as in "{example}"')
    try:
        return read_quantity(text, DIMENSIONS[dimension])
    except ValueError as error:
        raise InvalidInput(f'{option} {text!r} {error}; write it as in "{example}"') from error


def _weights(text: str, radii: dict[str, float]) -> dict[str, complex]:
    """m r exp(j angle) [kg m] by plane, of "impeller=2 g@30, D2=1 g@120"."""
    from ambrose.core.checks import invalid

    found: dict[str, complex] = {}
    for item in text.split(","):
        name, value = _pair(item)
        mass, at, degrees = value.partition("@")
        try:
            angle = float(degrees)
        except ValueError:
            at = ""
        if not at or name not in radii:
            raise invalid(
                "--trial",
                repr(text),
                "PLANE=MASS@DEGREES with the planes of --plane",
                'write "impeller=2 g@30"',
            )
        found[name] = (
            _read(mass.strip(), "--trial", "mass", f"{name}=2 g@30")
            * radii[name]
            * cmath.exp(1j * angle * cmath.pi / 180)
        )
    return found


# `ambrose calibrate`.


@click.command()
@MACHINE
@click.option(
    "--circle",
    type=click.Path(path_type=Path),
    help="A record of the rotor going around in its touchdown bearings.",
)
@click.option(
    "--slow-roll",
    type=click.Path(path_type=Path),
    help="A record of the levitated rotor turning slowly.",
)
@click.option(
    "--levitated",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A record of the levitated rotor at rest (repeatable).",
)
@click.option(
    "--find",
    type=click.Choice(("gain", "clearance")),
    default="gain",
    show_default=True,
    help="Quantity found from the circle: the gains (touchdown gaps known), or the gaps (gains "
    "known).",
)
@click.option("--harmonics", type=int, default=3, show_default=True, help="Of the run-out.")
@click.option(
    "--settle",
    type=float,
    default=0.3,
    show_default=True,
    help="Seconds left out at the beginning of every record.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("calibrated.toml"),
    show_default=True,
)
@AS_JSON
def calibrate(
    machine: str,
    circle: Path | None,
    slow_roll: Path | None,
    levitated: tuple[Path, ...],
    find: str,
    harmonics: int,
    settle: float,
    output: Path,
    as_json: bool,
) -> None:
    """Sensor gains and offsets, clearance, run-out and magnetic centre from standard tests; write
    the machine with them.

    The static circle needs no controller, only slowly turning currents that press the rotor against
    its touchdown bearings; slow roll and levitation record y_<axis> with u_<axis> or i_<axis>.
    Comments and all else in the machine file stay.
    """
    from ambrose.annexes.site.calibration import calibrate as calibrated
    from ambrose.machine.file.update import machine_text
    from ambrose.machine.ordinary_file import write_text
    from ambrose.report import theme as units

    description = load(machine)
    claim(machine_file=output)
    done = calibrated(
        description,
        circle=circle,
        slow_roll=slow_roll,
        levitated=levitated,
        find=find,  # type: ignore[arg-type]
        harmonics=harmonics,
        settle=settle,
    )
    failure = kept(
        lambda path: write_text(path, machine_text(done.machine), "machine file"), output
    )
    if as_json:
        say_json({**done.to_dict(), "machine_file": str(output)})
    else:
        rows = [
            (
                e.name,
                units.quantity(e.before, e.unit, 4),
                units.quantity(e.value, e.unit, 4),
                units.quantity(e.half, e.unit, 2),
            )
            for e in done.entries
        ]
        print_table("Calibration", ("entry", "before", "found", "+- 95 %"), rows)
        for note in done.notes:
            say(f"note: {note}")
        say(f"Machine with these values: {output}")
    if failure is not None:
        raise failure


# `ambrose bias`.


@click.command()
@MACHINE
@click.argument("records", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--controller",
    "controllers",
    multiple=True,
    metavar="[AMPERES=]PATH",
    help="The controller that ran, at all bias currents or at one: 6=pid6.json (repeatable).",
)
@click.option(
    "--loads",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A record of static loads (repeatable).",
)
@click.option(
    "--unknown",
    multiple=True,
    metavar="PATH",
    help="What else is sought at every bias (repeatable).",
)
@click.option("--report", type=click.Path(path_type=Path), help="A page (*.html).")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("bias.toml"), show_default=True
)
@AS_JSON
def bias(
    machine: str,
    records: tuple[Path, ...],
    controllers: tuple[str, ...],
    loads: tuple[Path, ...],
    unknown: tuple[str, ...],
    report: Path | None,
    output: Path,
    as_json: bool,
) -> None:
    """K_i and K_s of every axis against bias current; write the machine with a measured row for
    each.

    RECORDS are closed-loop records with excitation at several bias currents, as their operating
    points state; static loads (f_<port> [N]) give K_i alone, for comparison or without the others.
    Exit
    status 1: found and written, but something is doubtful.
    """
    from ambrose.annexes.site.bias import UNKNOWN, identify_over_bias
    from ambrose.annexes.site.pages import bias_tables
    from ambrose.machine.file.update import machine_text
    from ambrose.machine.ordinary_file import write_text

    description = load(machine)
    laws = dict(_law(text, description) for text in controllers)
    claim(machine_file=output, report=report)
    with progress_shown(as_json) as progress:
        done = identify_over_bias(
            description, records, laws, loads=loads, unknown=(*UNKNOWN, *unknown), progress=progress
        )
        text = done.comment + machine_text(done.machine)
        failures = [
            kept(lambda path: write_text(path, text, "machine file"), output),
            kept_page(done, report, progress=progress, called="report"),
        ]
    if as_json:
        say_json(
            {
                **done.to_dict(),
                "machine_file": str(output),
                "report": str(report) if report else None,
            }
        )
    else:
        for item in bias_tables(done):
            print_table(
                item.title, item.columns, [tuple(cell.text for cell in row) for row in item.cells]
            )
        for finding in done.findings:
            say(f"doubt: {finding}")
        say(
            f"Machine with a row for every bias current: {output}"
            + (f". Report: {report}" if report else "")
        )
    for failure in failures:
        if failure is not None:
            raise failure
    sys.exit(0 if done.passed else 1)


def _law(text: str, description: Machine) -> tuple[float | None, Any]:
    """ "6=pid6.json" -> 6.0 and the controller; a path alone -> None and the controller. Raises
    InvalidInput.
    """
    from ambrose.judge.controller_file import read_controller

    amperes, equals, path = text.partition("=")
    try:
        key: float | None = float(amperes) if equals else None
    except ValueError:
        key, path = None, text
    return key, read_controller(Path(path if key is not None else text), description)


# `ambrose frf`.


# identification/frf.py, which is not imported for --help
METHODS = ("sines", "periods", "polynomials")


@click.command()
@MACHINE
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--controller", type=click.Path(path_type=Path), help="The controller that ran.")
@click.option("--method", type=click.Choice(METHODS), help="Default: what suits the excitation.")
@click.option(
    "--from-hz", type=float, default=0.0, help="Lowest frequency; default: all that was excited."
)
@click.option(
    "--to-hz", type=float, default=None, help="Highest frequency; default: all that was excited."
)
@click.option(
    "--harmonics",
    type=int,
    default=3,
    show_default=True,
    help="Harmonics of the speed to remove.",
)
@click.option(
    "--settle",
    type=float,
    default=None,
    help="Sines: seconds left out of each; default: up to 0.3.",
)
@click.option(
    "--csv",
    "table",
    type=click.Path(path_type=Path),
    help="Every line as text (*.csv), or as responses for identify (*.h5).",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="A page (*.html).")
@AS_JSON
def frf(
    machine: str,
    records: tuple[Path, ...],
    controller: Path | None,
    method: str | None,
    from_hz: float,
    to_hz: float | None,
    harmonics: int,
    settle: float | None,
    table: Path | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Measure frequency responses, open and closed loop, with coherence and 95 % intervals, and
    compare them with the model.

    RECORDS contain the displacements y_<axis> and excitations e_<axis> (or references r_<axis>,
    forces
    f_<port>): chirps, binary sequences, multisines, stepped sines or noise, at one operating point
    or several. With u_<axis> they tell the open loop of every axis driven by itself, and with all
    axes driven the plant. Exit status 1: measured, but something makes it doubtful.
    """
    from math import inf, tau

    from ambrose.annexes.site.frf import respond, summary
    from ambrose.annexes.site.pages import response_tables
    from ambrose.machine.ordinary_file import write_text
    from ambrose.record.response_files import write_response

    description = load(machine)
    law = load_controller(controller, description) if controller else None
    claim(page=output, table=table)
    with progress_shown(as_json) as progress:
        band = (tau * from_hz, inf if to_hz is None else tau * to_hz)
        found = respond(
            description,
            records,
            law,
            method=method,
            band=band,
            harmonics=harmonics,
            settle=settle,
            progress=progress,
        )
        failures = []
        if table is not None and table.suffix.lower() in {".h5", ".hdf5"}:
            kept_as = found.to_response()
            failures.append(kept(lambda path: write_response(kept_as, path), table))
        elif table is not None:
            failures.append(kept(lambda path: write_text(path, found.to_csv(), "table"), table))
        failures.append(kept_page(found, output, progress=progress))
    if as_json:
        say_json(
            {
                **found.to_dict(),
                "page": str(output) if output else None,
                "table": str(table) if table else None,
            }
        )
    else:
        for point in found.points:
            for note in point.notes:
                say(f"{point.label}: {note}")
            for item in response_tables(found, point):
                print_table(
                    f"{item.title}, {point.label}",
                    item.columns,
                    [tuple(c.text for c in row) for row in item.cells],
                )
            for row in summary(point):
                if row["silent"]:
                    say(
                        f"{row['axis']}: noise hides the sensitivity, excite there: {row['silent']}"
                    )
        for finding in found.findings:
            say(f"doubt: {finding}")
        for what, place in (("Table", table), ("Page", output)):
            if place is not None:
                say(f"{what}: {place}")
    for failure in failures:
        if failure is not None:
            raise failure
    sys.exit(1 if found.findings else 0)


# a step's verdict: passed, failed, or nothing to judge
_WORDS = {True: "passed", False: "failed", None: "for information"}


@click.command()
@MACHINE
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--controller",
    required=True,
    type=click.Path(path_type=Path),
    help="The controller that ran, a fixed one.",
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
    help="Per plane in the model that is fitted. Default: as many as the data tell.",
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
    "--anyway",
    is_flag=True,
    help="Design a new controller even if the running one meets every requirement.",
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
    bending_modes: int | None,
    after: tuple[Path, ...],
    changed: bool,
    anyway: bool,
    output: Path,
    as_json: bool,
) -> None:
    """From a record of the running machine to another controller: proved, coded, tried, on a page
    to sign.

    RECORDS contain excitations e_<axis> and displacements y_<axis>, with u_<axis> best, or are an
    analyser's frequency responses: then the measured plant decides at their operating point.
    Identifies the machine, lists what changed, and checks the running controller over the
    identified intervals. If it fails a requirement, another one of the same structure is tuned,
    proved and written as code, and the change and the way back run on the virtual rig. Exit status
    1: stopped at the first step that fails; finished files stay in the folder.
    """
    from ambrose.annexes.site.retuning import PAGE, retune as run

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
        text = f"{done.text[:1].upper()}{done.text[1:]}."
        say_verdict(text, in_full=text)
        if failure is None:
            say(f"Page: {page}")
    if failure is not None:
        raise failure
    sys.exit(0 if done.passed else 1)
