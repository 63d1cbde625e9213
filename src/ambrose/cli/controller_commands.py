"""`ambrose export`."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ambrose.code.targets import TARGETS
from ambrose.options import AsItRuns, Exploring, Rejecting, Verifying
from ambrose.synthesis.methods import Tuned, methods
from ambrose.terminal import (
    ALL,
    AS_JSON,
    AXES,
    MACHINE,
    GroupedCommand,
    asked_for,
    chosen_from,
    claim,
    groups_from,
    kept,
    kept_page,
    load,
    load_controller,
    narrowed,
    noted_part,
    one_screen,
    options_from,
    print_checks,
    print_table,
    progress_shown,
    say,
    say_json,
    say_verdict,
    shown,
)

if TYPE_CHECKING:
    from ambrose.judge.checks import Verification
    from ambrose.judge.result import Synthesis

# `ambrose synthesize`.


METHODS = methods()
_METHOD_OPTION = "--method"
# of the controller, or of the loop as it runs
_OF_ALL = (
    *("fastest_pole", "bending_modes", "ratio_", "guard_", "direct_gain_mismatch"),
    *("unmet_checks", "measured_"),
)
_APART = 1.5  # times: continuous and sampled peaks that differ by more are explained


@click.command(
    cls=GroupedCommand,
    groups={
        "": ("method", "point", "output"),
        **groups_from(METHODS, "With every method", _METHOD_OPTION),
        "A synchronous block": (
            "synchronous",
            "synchronous_band",
            "synchronous_time",
            "synchronous_update",
            "base",
        ),
    },
)
@MACHINE
@click.option(_METHOD_OPTION, type=click.Choice(list(METHODS)), default="tuned", show_default=True)
@click.option(
    "--point",
    default=None,
    help="Label of an operating point, or its beginning; default: the design point.",
)
@options_from(METHODS)
@options_from(Rejecting)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("controller.json"),
    show_default=True,
)
@click.option(
    "--machine-file",
    type=click.Path(path_type=Path),
    default=None,
    help="With --structure pid or filters: write the machine with the radial filters found as its "
    "[controller].",
)
@AS_JSON
def synthesize(
    machine: str,
    method: str,
    point: str | None,
    output: Path,
    machine_file: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Design a controller on the reduced plant and certify it on the full one; of a machine with a
    thrust bearing both groups of axes, in one file.

    With --method tuned, the default, for the whole envelope: all operating points and the
    tolerances around each; the other methods design for one operating point (--point), lpv for a
    range of speeds, of seal pressures or both. Exit status 1: an operating point of the machine is
    not stable (with --point: that one), or a requirement of the design is not met.
    """
    from ambrose.api import assemble, design_thrust, design_with_block
    from ambrose.core.checks import invalid
    from ambrose.judge.controller_file import write_controller
    from ambrose.law.law import extension
    from ambrose.machine.file.update import save_machine
    from ambrose.machine.machine import THRUST
    from ambrose.synthesis.design import another_point

    given = {item.name: asked.pop(item.name) for item in fields(Rejecting)}
    block_options = asked_for(Rejecting, given)
    chosen = chosen_from(METHODS, method, asked, _METHOD_OPTION)
    description = load(machine, part=False)
    on_machine = chosen.on(description)  # refuses before the design, which takes a while
    if block_options.synchronous is not None:
        extension("request")(block_options, method, description)
    if machine_file is not None and getattr(chosen, "structure", None) not in {"pid", "filters"}:
        raise invalid(
            "--machine-file",
            str(machine_file),
            "given with a filter bank",
            "add --method tuned --structure pid",
        )
    if machine_file is not None and description.group == THRUST:
        remedy = "its filters stand in the controller file"
        raise invalid("--machine-file", str(machine_file), "left out for the thrust axis", remedy)
    claim(controller_file=output, machine_file=machine_file)
    # a peak names the point it is of: the worst one, which verify finds, is another
    thrust: Synthesis | None = None
    where, plant = "", None
    with progress_shown(as_json) as progress:
        if narrowed() is None and block_options.base is None:
            for along in [*description.groups.values()][1:]:
                progress(f"designing the thrust axis ({method})")
                thrust = design_thrust(along, chosen, point, progress)
        if block_options.base is None:
            progress("assembling the plant")
            plant = assemble(description, point)
            where = f" at {plant.point.label or 'the design point'}"
            progress(f"designing ({method})")
        else:
            law = load_controller(given["base"], description)
            block_options, method = replace(block_options, base=law), law.method
        result, block = design_with_block(
            plant or description, chosen, block_options, progress=progress
        )
        if plant is not None and result.method == "hinf" and point is None and result.lost:
            progress("searching for a point whose design is stable at all points")
            result = replace(result, notes=(*result.notes, another_point(plant, chosen)))
        result = replace(result, thrust=result.thrust if thrust is None else thrust)
    failure = kept(lambda path: write_controller(path, result), output)
    if machine_file is not None and result.filters is not None:
        timing = on_machine.timing()
        settings = result.filters
        # without its timing in the file, the loop read back would be judged as a continuous one
        if timing is not None:
            settings = replace(
                settings,
                sample_rate=None,
                sample_time=timing.sample_time,
                delay=timing.delay_samples * timing.sample_time,
            )
        # reasons of [machine.assumed] that still hold: the other ones of [controller] speak of the
        # settings that the filters replace
        stays = {"controller.sample_time", "controller.delay"}
        reasons = tuple(
            row
            for row in description.assumed
            if row[0] in stays or row[0].partition(".")[0] != "controller"
        )
        with_filters = replace(description, controller=settings, assumed=reasons)
        failure = kept(lambda path: save_machine(with_filters, path), machine_file) or failure
    groups = [result] if result.thrust is None else [result, result.thrust]
    if as_json:
        first, *others = (_summary(part, method) for part in groups)
        summary = {"controller": str(output), **first}
        if block is not None:
            summary["synchronous"] = block.to_dict()
        say_json(summary | ({"thrust": others[0]} if others else {}))
    else:
        for part in groups:
            which = f"thrust axis, {method}" if part is result.thrust else method
            _say_controller(part, which, where, output)
        if block is not None:
            lines = [
                ("time constant", f"{2 / block.gain:.4g} s"),
                ("proved angle", f"{math.degrees(block.angle):.4g} deg"),
            ]
            lines += [
                ("on", f"{low:.4g} to {high:.4g} rad/s")
                for low, high in (item.band for item in block.blocks)
            ]
            lines += [("left out", item) for item in block.left_out]
            lines += [("note", note) for note in block.notes]
            print_table(f"synchronous block, {block.mode}", ("block", "value"), lines)
    if failure is not None:
        raise failure
    sys.exit(0 if all(_held(part, point) for part in groups) else 1)


def _held(result: Synthesis, point: str | None) -> bool:
    """Whether a design does what it is for; of one point that was asked for, the others are told
    only.
    """
    holds = result.status == "verified" and (point is not None or not result.lost)
    return holds and not (result.missed and not (point is not None and result.lost_elsewhere))


def _summary(result: Synthesis, method: str) -> dict[str, Any]:
    """What --json prints of one controller."""
    return {
        "method": method,
        "status": result.status,
        "stopped_early": result.stopped_early,
        "states": result.controller.n_states,
        "control_weight_factor": None if result.weights is None else result.weights.control_factor,
        "notes": result.notes,
        "certificate": result.certificate.to_dict(),
        "filters": None if result.filters is None else result.filters.to_dict(),
    }


def _say_controller(result: Synthesis, method: str, where: str, output: Path) -> None:
    """The table of one controller's certificate, and its filters."""
    from ambrose.law.pid import filter_rows

    certificate = result.certificate.to_dict()
    rows = [("states", f"{result.controller.n_states}")]
    numbers = _numbers(certificate)
    if result.method != "pid":  # which minimises nothing
        numbers = {"gamma": result.gamma, **numbers}
    rows += [
        (name.replace("_", " ") + (where if name.endswith("_peak") else ""), shown(value))
        for name, value in numbers.items()
    ]
    rows += [
        (f"abscissa, {label}", shown(value)) for label, value in certificate["envelope"].items()
    ]
    if result.weights is not None:
        rows.append(("control weight factor", shown(result.weights.control_factor)))
    rows += [("note", note) for note in (*result.notes, *_beside(numbers))]
    early = "STOPPED EARLY: " if result.stopped_early else ""
    print_table(
        f"{method} controller, {early}{result.verdict}: {output}", ("certificate", "value"), rows
    )
    if result.filters is not None and result.filters.channels:
        print_table(
            "filters, each channel in series",
            ("channel", "filter", "parameters"),
            filter_rows(result.filters),
        )


def _beside(numbers: dict[str, Any]) -> list[str]:
    """What the rows of the continuous loop are, where they stand beside those of the loop that
    runs.
    """
    without = numbers.get("continuous sensitivity_peak")
    as_run = numbers.get("sampled_sensitivity_peak")
    if without is None or as_run is None:
        return []
    words = "continuous: the law without sampling, hold and delay, as no loop runs"
    apart = max(without / as_run, as_run / without)
    if apart > _APART:
        words += (
            f"; its sensitivity peak is {apart:.3g} times off that of the sampled loop: at some "
            "mode the delay decides the damping, so that another rate or delay needs its own design"
        )
    return [words]


def _numbers(certificate: dict[str, Any]) -> dict[str, Any]:
    """The rows of the table: where the loop runs sampled its own margins come first, and those of
    the continuous loop, named so, only where the sampled one is stable. The controller file keeps
    all.
    """
    margins, separate = certificate["margins"], {"margins", "envelope"}
    numbers = {name: value for name, value in certificate.items() if name not in separate}
    as_run = {name: value for name, value in margins.items() if name.startswith("sampled_")}
    if not as_run:
        return numbers | margins
    leading = {name: numbers.pop(name) for name in ("stable", "plant")} | as_run
    if not certificate["stable"]:
        return leading
    others = numbers | {name: value for name, value in margins.items() if name not in as_run}
    of_full_plant = {"full_spectral_abscissa", "full_sensitivity_peak"}
    return leading | {
        name if name.startswith(_OF_ALL) else f"continuous {name}": value
        for name, value in others.items()
        if name not in of_full_plant
    }


# `ambrose trade-off`.


_OVER = (
    "settling_time",
    "unbalance_orbit",
    "max_current",
    "compliance_peak",
    "control_gain",
    "log_decrement",
    "order",
)


@click.command("trade-off")
@MACHINE
@click.option(
    "--over",
    type=click.Choice(_OVER),
    required=True,
    help="A key of [requirements], or the controller's order.",
)
@click.option(
    "--values", required=True, help='Two or more, separated by commas: "20 ms, 30 ms, 60 ms".'
)
@click.option(
    "--order", type=int, default=None, help="States of the controllers; default: three per axis."
)
@click.option(
    "--structure", type=click.Choice(["free", "plane", "axis"]), default="free", show_default=True
)
@options_from(AsItRuns)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=None,
    help="Write the curve as a page (*.html).",
)
@AS_JSON
def trade_off(
    machine: str,
    over: str,
    values: str,
    order: int | None,
    structure: str,
    output: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """What a requirement costs: the lowest sensitivity that a tuned controller reaches at each of
    its values.
    """
    from ambrose.synthesis.trade_off import read_value, trade_off as traded

    description = load(machine)
    wanted = [read_value(over, text.strip()) for text in values.split(",") if text.strip()]
    method = Tuned(order=order, structure=structure, **asked_for(AsItRuns, asked).values())
    claim(page=output)
    with progress_shown(as_json) as progress:
        result = traded(description, over, wanted, method, progress=progress)
    name = over.replace("_", " ").capitalize()
    heading = name if result.unit == "-" else f"{name} [{result.unit}]"
    columns = (heading, "Sensitivity peak", "All else met", "Tightest requirement")
    found = tuple(
        (f"{v:.4g}", f"{s:.3g}", "yes" if m else "no", b)
        for v, s, m, b in zip(
            result.values, result.sensitivity, result.met, result.binding, strict=True
        )
    )
    unit = f" {result.unit}" * (result.unit != "-")
    ends = [f"{result.sensitivity[k]:.3g} at {result.values[k]:.4g}{unit}" for k in (0, -1)]
    verdict = (
        f"Lowest sensitivity peak over {name.lower()}: {ends[0]}, {ends[1]}. All other "
        f"requirements are met at {sum(result.met)} of {len(result.met)} values."
    )
    failure = None
    if output is not None:
        from ambrose.report.page import Figure, Page, Section, Table, Verdict, write
        from ambrose.report.plot import plot

        page = Page(
            "What a requirement costs",
            description,
            (
                Section(
                    "Lowest sensitivity", "", (Figure(f"Against {name.lower()}", plot(result)),)
                ),
            ),
            facts=(("Controller", "tuned anew for every value"),),
            result=Verdict("Result", all(result.met), verdict),
            opening=Section("", tables=(Table("", columns, found),)),
            signatures=(),
        )
        failure = kept(lambda path: write(page, path), output)
    if as_json:
        rows = zip(result.values, result.sensitivity, result.met, result.binding, strict=True)
        keys = ("value", "sensitivity", "met", "binding")
        say_json(
            {
                "over": over,
                "unit": result.unit,
                "rows": [dict(zip(keys, row, strict=True)) for row in rows],
            }
        )
    else:
        say_verdict(verdict)
        print_table(f"lowest sensitivity against {name.lower()}", columns, found)
    if failure is not None:
        raise failure
    sys.exit(0 if all(result.met) else 1)


# `ambrose verify`.


_GROUPS = {
    "": ("path", "axial", "axes", "everywhere", "report", "everything"),
    "On measured responses": ("measured", "running"),
    "The loop as it runs": ("rate", "delay_samples"),
    "Proofs while the machine moves": ("pressure_rate", "pressure_error", "speed_rate"),
    "Synchronous blocks": ("page",),
}


@click.command(cls=GroupedCommand, groups=_GROUPS)
@MACHINE
@click.option(
    "--controller",
    "path",
    type=click.Path(path_type=Path),
    help="The controller: its file, or a table of coefficients (*.csv, *.json, *.mat); default: "
    "the machine file's PID.",
)
@options_from(Verifying)
@click.option(
    "--measured",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Frequency responses of the machine, a file for each operating point (repeatable): they "
    "decide there, the model elsewhere.",
)
@click.option(
    "--running",
    type=click.Path(path_type=Path),
    default=None,
    help="The controller that ran while they were measured; default: none, they are of "
    "the plant alone.",
)
@click.option(
    "--report",
    type=click.Path(path_type=Path),
    default=None,
    help="A page: verdicts, curves of all operating points, every check.",
)
@click.option(
    "--page",
    type=click.Path(path_type=Path),
    default=None,
    help="A page of the synchronous blocks: current, force, orbit and margin over speed, before "
    "and after.",
)
@ALL
@AS_JSON
def verify(
    machine: str,
    path: Path | None,
    measured: tuple[Path, ...],
    running: Path | None,
    report: Path | None,
    page: Path | None,
    everything: bool,
    as_json: bool,
    **asked: Any,
) -> None:
    """Check a controller on the full plant: at every operating point of the machine, and over all
    tolerances around each; or on the plant as measured. With a thrust bearing all five axes.
    """
    from ambrose.api import verify as verified
    from ambrose.core.checks import invalid
    from ambrose.judge.checks import moving_proofs

    options = asked_for(Verifying, asked)
    description = load(machine, part=False)
    controller = None if path is None else load_controller(path, description)
    if asked["axial"] is not None:
        options = replace(options, axial=load_controller(asked["axial"], description.axial))
    # what no requirement limits is computed where it is shown
    shown = everything or as_json or report is not None
    options = replace(options, axes=narrowed(), informed=shown)
    fastest = options.pressure_rate or description.operation.pressure_rate
    if options.pressure_error and fastest is None:
        raise invalid(
            "--pressure-error",
            asked["pressure_error"],
            "given with --pressure-rate",
            "state the fastest change of the pressure",
        )
    if page is not None:
        settings = description.controller
        if (controller is None or not controller.synchronous) and not (
            settings is not None and settings.synchronous
        ):
            remedy = "design one with ambrose synthesize --synchronous current-free"
            raise invalid(
                "--page", str(page), "given for a controller with a synchronous block", remedy
            )
    claim(page=page, report=report)
    ran = load_controller(running, description) if running else None
    with progress_shown(as_json) as progress:
        result = verified(
            description,
            controller,
            measured=measured,
            running=ran,
            progress=progress,
            **options.values(),
        )
    failure = None
    if page is not None:
        from ambrose.report.page import write
        from ambrose.report.verification import synchronous_page

        blocks = synchronous_page(
            description, result.synchronous, loop=result.timing, controller=result.controller
        )
        failure = kept(lambda path: write(blocks, path), page)
    failure = kept_page(result, report, description, called="report") or failure
    if as_json:
        say_json({"machine": description.name, **result.to_dict()})
    else:
        unproved = [
            sentence
            for proof in (moving_proofs() if not result.moving else ())
            if (sentence := proof.unproved(description, options)) is not None
        ]
        screen = one_screen()
        if screen is None:
            _say_in_full(result, unproved, everything)
        else:
            # the table that decides grows with the points
            screen.lines = min(60, max(screen.lines, 28 + 2 * len(result.points)))
            _say_what_decides(result, unproved)
    if failure is not None:
        raise failure
    sys.exit(0 if result.passed else 1)


def _say_what_decides(result: Verification, unproved: Sequence[str]) -> None:
    """The verdict, the table that decides, what fails in full, what was not checked, by kind."""
    from ambrose.judge.result import OF_MACHINE
    from ambrose.report.tables import (
        deciding_table,
        deciding_verdict,
        failing_table,
        loop_in_words,
        unchecked,
    )

    say_verdict(deciding_verdict(result))
    table, failing = deciding_table(result), failing_table(result)
    marked = ", ".join(filter(None, ("✗ not met" * (not result.passed), table.note)))
    for part, note in ((table, marked), (failing, "")):
        if part.rows:
            rows = [
                (first.text, *(c.text + " ✗" * (c.mark == "fail") for c in rest))
                for first, *rest in part.cells
            ]
            styles = {"fail": "red", "number": "bold"}
            marks = [styles.get(getattr(row[0], "mark", "fail"), "") for row in part.rows]
            print_table(part.title, part.columns, rows, marks)
        if part.rows and note:
            say(note)
    say(f"The loop is {loop_in_words(result.timing)}.")
    if OF_MACHINE in result.controller:
        names = (part.partition(", SHA")[0] for part in result.controller.split("; "))
        say(f"Controller: {'; '.join(names)}.")
    for checks in result.points:
        if checks.label.endswith(", measured"):
            say(" ".join((f"{checks.label[0].upper()}{checks.label[1:]}:", *checks.notes)))
    for sentence in (*unchecked(result), *unproved):
        say(sentence)
    say("Every check: --details, with --all those without a limit. Page: --report page.html.")


def _say_in_full(result: Verification, unproved: Sequence[str], everything: bool) -> None:
    from ambrose.law.loop import timing_in_words

    for _, checks in result.labelled:
        print_checks(checks, everything)
    say(f"The loop is {timing_in_words(result.timing)}.")
    for words in result.over_speed:
        say(f"Beyond the machine's own speed: {words}.")
    for words in result.not_varied:
        say(f"Not varied around {words}.")
    for sentence in unproved:
        say(sentence)
    failed = [label for label, checks in result.labelled if not checks.passed]
    every = f"every check of all {len(result.labelled)} tables"
    say(f"Failed: {'; '.join(failed)}." if failed else f"Passed: {every}.")
    if result.left_out:
        why = (
            "the schedule does not cover them, in what it is scheduled over or in what it was "
            "designed at"
        )
        say(f"Not checked, which does not pass: {'; '.join(result.left_out)}; {why}.")


# `ambrose map`.


@click.command("map")
@MACHINE
@click.option(
    "--controller",
    type=click.Path(path_type=Path),
    required=True,
    help="The controller: its file, or a table of coefficients (*.csv, *.json, *.mat).",
)
@options_from(Exploring, "parts")
@click.option(
    "--point", help="Label of an operating point, or its beginning; default: the design point."
)
@options_from(Exploring, "pressure", "speed", "bound", "rate", "delay_samples")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="A page (*.html).")
@AS_JSON
def map_command(
    machine: str,
    controller: Path,
    point: str | None,
    output: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Map a loop over its range: poles over speed and pressure, Campbell, pulse and unbalance over
    the tolerances.

    The limits of stability over speed and pressure, also outside the machine file's range; the
    largest motion after a pulse over all tolerances; the worst orbit by unbalance over speed. Exit
    status 1: not stable everywhere in the machine's own range.
    """
    from ambrose.judge.exploration import explore
    from ambrose.law.loop import timing_in_words
    from ambrose.report import theme
    from ambrose.report.verification import exploration_page

    description = load(machine)
    law = load_controller(controller, description)
    claim(page=output)
    options = asked_for(Exploring, asked).values()
    with progress_shown(as_json) as progress:
        exploration = explore(description, law, point=point, progress=progress, **options)
        failure = kept_page(exploration, output, progress=progress)
    if as_json:
        say_json({**exploration.to_dict(), "page": str(output) if output else None})
    else:
        report = exploration_page(exploration)
        rows = [(verdict.label, verdict.text) for verdict in report.verdicts]
        for item in exploration.maps:
            rows.append(
                (
                    f"largest real part over {item.over}",
                    theme.quantity(float(item.abscissa.max()), "1/s"),
                )
            )
        if exploration.pulses is not None and exploration.pulses.stable.all():
            rows.append(
                (
                    "settled after a pulse, worst member",
                    theme.quantity(float(exploration.pulses.settling().max()), "s"),
                )
            )
        if exploration.unbalance is not None:
            worst, at = (
                float(exploration.unbalance.found.max()),
                float(exploration.unbalance.speeds[exploration.unbalance.found.argmax()]),
            )
            rows.append(
                (
                    "worst orbit found, 0-p",
                    f"{theme.quantity(worst, 'm')} at {at * theme.RPM:.4g} rpm",
                )
            )
        title = f"{description.name}, {exploration.point.label or 'its design point'}"
        if report.result is not None:
            say_verdict(report.result.text)
        print_table(title, ("what", "found"), [tuple(map(str, row)) for row in rows])
        for note in exploration.notes:
            say(f"note: {note}")
        say(f"The loop is {timing_in_words(exploration.timing)}.")
        if output is not None and failure is None:
            say(f"Page: {output}")
    if failure is not None:
        raise failure
    sys.exit(0 if exploration.stable else 1)


_WORD = "--to"
_GROUPS_EXPORT = {
    "": (
        *("target", "output", "machine", "axial", "axes", "replaces", "name", "arithmetic", "rate"),
        "force",
    ),
    "Scheduled controllers": (
        "speed_limit",
        "speed_rate",
        "pressure_limit",
        "pressure_rate",
        "fallback",
        "pressure_error",
        "stuck_after",
    ),
    "On its processor": ("try_on", "clock", "flash", "ram", "bare_metal"),
    **groups_from(TARGETS, "With every target", _WORD),
}


@click.command(cls=GroupedCommand, groups=_GROUPS_EXPORT)
@click.argument("controller", type=click.Path(path_type=Path))
@click.option(
    _WORD,
    "target",
    type=click.Choice(list(TARGETS)),
    required=True,
    help="What to write: C99, a MAT-file, FMUs (FMI 2.0 and 3.0) or structured text.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    help="Directory for the files.",
)
@click.option(
    "--machine",
    "machine",
    default=None,
    help="Default: the bundled machine that the controller was made for.",
)
@options_from(TARGETS)
@click.option(
    "--fallback",
    type=click.Path(path_type=Path),
    help="Fixed controller for when a schedule's pressure cannot be trusted.",
)
@click.option(
    "--axial",
    type=click.Path(path_type=Path),
    help="The controller of the thrust axis, default: that of the file; both as one unit of all "
    "axes (C, FMU) or as two.",
)
@AXES
@click.option(
    "--replaces",
    type=click.Path(path_type=Path),
    help="The controller that runs now: what changes in the tables of its code, and the way back.",
)
@AS_JSON
def export(
    controller: Path,
    target: str,
    output: Path,
    machine: str | None,
    fallback: Path | None,
    replaces: Path | None,
    axial: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Sample a controller, verify its loop as it will run, and write it as code for the target.

    A scheduled controller is written in floating point, verified at frozen speeds or pressures over
    its range.
    """
    from ambrose.api import export as exported

    chosen = chosen_from(TARGETS, target, asked, _WORD)
    known = None if machine is None else load(machine, part=False)
    laws: dict[str, Any] = {"fallback": fallback, "replaces": replaces, "axial": axial}
    with progress_shown(as_json) as progress:
        delivery = exported(
            *(controller, output),
            to=chosen,
            machine=known,
            axes=narrowed(),
            progress=progress,
            **laws,
        )
    if delivery.axial is None and narrowed() is None and known is not None:
        noted_part(known)
    content = delivery.to_dict()
    if as_json:
        say_json(content)
    else:
        for problem in content["problems"]:
            say(f"forced although {problem}", err=True)
        for limit in content["unmet_limits"]:
            say(f"the loop as it runs misses a limit: {limit}", err=True)
        if delivery.not_alike:
            say(f"no parameters.json: {delivery.not_alike}", err=True)
        if delivery.trial is not None:
            say(f"{delivery.trial.processor.name}: {delivery.trial.text}", err=True)
        if delivery.apart:
            say(f"two units, the second of the thrust axis: {delivery.apart}", err=True)
        for path in content["files"]:
            say(path)
    sys.exit(0 if content["verified"] and not content["unmet_limits"] else 1)
