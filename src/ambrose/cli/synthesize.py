"""`ambrose synthesize`."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ambrose.cli.options import chosen_from, groups_from, options_from
from ambrose.synthesis.methods.choice import methods
from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    GroupedCommand,
    claim,
    kept,
    load,
    load_controller,
    print_table,
    progress_shown,
    say_json,
    shown,
)

METHODS = methods()
_METHOD_OPTION = "--method"
# of the controller, or of the loop as it runs
_OF_ALL = ("fastest_pole", "bending_modes", "ratio_", "guard_", "direct_gain_mismatch")
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
@click.option(
    "--synchronous",
    type=click.Choice(["current-free", "force-free", "vibration-free", "damping"]),
    default=None,
    help="Design a block as well that rejects the unbalance's signal, and write it into the "
    "controller file.",
)
@click.option(
    "--synchronous-band",
    type=float,
    nargs=2,
    default=None,
    help="With --synchronous: lowest and highest speed of the block in rad/s; default: a tenth of "
    "the top speed to it; damping has none, give the speeds around the critical one.",
)
@click.option(
    "--synchronous-time",
    type=float,
    default=None,
    help="With --synchronous: time constant of the block in seconds; default: as short as the "
    "loop allows.",
)
@click.option(
    "--synchronous-update",
    type=click.Choice(["sample", "turn"]),
    default=None,
    help="With --synchronous: when the block's amplitudes move; default: every sample.",
)
@click.option(
    "--base",
    type=click.Path(path_type=Path),
    default=None,
    help="With --synchronous: the controller file to add the block to, in place of a new design.",
)
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
    help="With --structure pid or filters: write the machine with the filters found as its "
    "[controller].",
)
@AS_JSON
def synthesize(
    machine: str,
    method: str,
    point: str | None,
    synchronous: str | None,
    synchronous_band: tuple[float, float] | None,
    synchronous_time: float | None,
    synchronous_update: str | None,
    base: Path | None,
    output: Path,
    machine_file: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Design a controller on the reduced plant and certify it on the full one.

    With --method tuned, the default, for the whole envelope: all operating points and the
    tolerances around each; the other methods design for one operating point (--point), lpv for a
    range of speeds, of seal pressures or both. Exit status 1: an operating point of the machine is
    not held (with --point: that one), or what was designed for is not met.
    """
    from ambrose.core.checks import invalid
    from ambrose.judge.controller_file import write_controller
    from ambrose.judge.plants import plant_at
    from ambrose.judge.result import Status
    from ambrose.law.filters import filter_rows
    from ambrose.machine.file.update import save_machine
    from ambrose.synthesis.design import another_point, design
    from ambrose.synthesis.synchronous_design import check_request, design_synchronous, in_words

    chosen = chosen_from(METHODS, method, asked, _METHOD_OPTION)
    description = load(machine)
    on_machine = chosen.on(description)  # refuses before the design, which takes a while
    more = {
        "--synchronous-band": synchronous_band,
        "--synchronous-time": synchronous_time,
        "--synchronous-update": synchronous_update,
        "--base": base,
    }
    check_request(synchronous, method, more, description, "--synchronous")
    if machine_file is not None and getattr(chosen, "structure", None) not in {"pid", "filters"}:
        raise invalid(
            "--machine-file",
            str(machine_file),
            "given with a filter bank",
            "add --method tuned --structure pid",
        )
    claim(controller_file=output, machine_file=machine_file)
    # a peak names the point it is of: the worst one, which verify finds, is another
    where = ""
    with progress_shown(as_json) as progress:
        if base is None:
            progress("assembling the plant")
            plant = plant_at(description, point)
            where = f" at {plant.point.label or 'the design point'}"
            progress(f"designing ({method})")
            result = design(plant, chosen, progress=progress)
            if result.method == "hinf" and point is None and result.lost:
                progress("looking for a point whose design holds all")
                result = replace(result, notes=(*result.notes, another_point(plant, chosen)))
        else:
            result = load_controller(base, description)
            method = result.method
        block = None
        if synchronous is not None:
            block = design_synchronous(
                description,
                result,
                synchronous,
                band=synchronous_band,
                time_constant=synchronous_time,
                update=synchronous_update or "sample",
                rate=getattr(chosen, "rate", None),
                delay_samples=getattr(chosen, "delay_samples", None),
                progress=progress,
            )
            result = replace(result, synchronous=block.blocks)
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
    certificate = result.certificate.to_dict()
    factor = None if result.weights is None else result.weights.control_factor
    if as_json:
        summary = {
            "controller": str(output),
            "method": method,
            "status": result.status,
            "stopped_early": result.stopped_early,
            "states": result.controller.n_states,
            "control_weight_factor": factor,
            "notes": result.notes,
            "certificate": certificate,
            "filters": None if result.filters is None else result.filters.to_dict(),
        }
        if block is not None:
            summary["synchronous"] = block.to_dict()
        say_json(summary)
    else:
        rows = [("states", f"{result.controller.n_states}")]
        numbers = _numbers(certificate)
        if method != "pid":  # which minimises nothing
            numbers = {"gamma": result.gamma, **numbers}
        rows += [
            (name.replace("_", " ") + (where if name.endswith("_peak") else ""), shown(value))
            for name, value in numbers.items()
        ]
        rows += [
            (f"abscissa, {label}", shown(value)) for label, value in certificate["envelope"].items()
        ]
        if factor is not None:
            rows.append(("control weight factor", shown(factor)))
        rows += [("note", note) for note in (*result.notes, *_beside(numbers))]
        early = "STOPPED EARLY: " if result.stopped_early else ""
        print_table(
            f"{method} controller, {early}{result.verdict}: {output}",
            ("certificate", "value"),
            rows,
        )
        if result.filters is not None and result.filters.channels:
            print_table(
                "filters, each channel in series",
                ("channel", "filter", "parameters"),
                filter_rows(result.filters),
            )
        if block is not None:
            lines = [
                ("time constant", f"{2 / block.gain:.4g} s"),
                ("proved angle", f"{math.degrees(block.angle):.4g} deg"),
            ]
            lines += [
                ("on", f"{low:.4g} to {high:.4g} rad/s")
                for low, high in (item.band for item in block.blocks)
            ]
            lines += [("left out", in_words(item)) for item in block.forbidden]
            lines += [("note", note) for note in block.notes]
            print_table(f"synchronous block, {block.mode}", ("block", "value"), lines)
    if failure is not None:
        raise failure
    # of one point that was asked for, the others are told only
    holds = result.status is Status.VERIFIED and (point is not None or not result.lost)
    missed = result.missed and not (point is not None and result.lost_elsewhere)
    sys.exit(0 if holds and not missed else 1)


def _beside(numbers: dict[str, Any]) -> list[str]:
    """What the rows of the continuous loop are, where they stand beside those of the loop that
    runs.
    """
    without = numbers.get("continuous sensitivity_peak")
    as_run = numbers.get("sampled_sensitivity_peak")
    if without is None or as_run is None:
        return []
    words = "continuous: the law without its sampling, hold and delay, which no loop runs"
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
