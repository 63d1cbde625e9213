"""The `ambrose` command. Exit status: 0 done and all required checks passed, 1 done but a check failed, 2 bad input.

Results go to standard output (with --json exactly one JSON object), progress and errors to standard error.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from ambrose import __version__

ALL = click.option("--all", "everything", is_flag=True, help="Show the quantities without a limit as well.")
AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
MACHINE = click.argument("machine")


class AmbroseCommand(click.Group):
    """Turns every refusal of the package, and every file that cannot be used, into one message and exit status 2."""

    def invoke(self, ctx: click.Context) -> Any:
        # Before numpy is loaded: at these sizes (some hundred states) BLAS threads cost more than they bring.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        from ambrose.core.checks import AmbroseError

        try:
            return super().invoke(ctx)
        except AmbroseError as error:
            _stop(str(error))
        except OSError as error:
            _stop(f"{error.filename or 'file'}: {error.strerror or error}; check that it exists and may be read or written")
        except KeyboardInterrupt:
            _stop("interrupted; what was finished before stays on disk", 130)


def _stop(message: str, status: int = 2) -> None:
    click.echo(f"ambrose: {message}", err=True)
    sys.exit(status)


@click.group(cls=AmbroseCommand, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="ambrose")
def main() -> None:
    """Rotors on active magnetic bearings with destabilising seal forces: model, control, verification, report.

    MACHINE is a machine file (*.toml) or the name of a bundled machine; see `ambrose machines`.
    """


@main.command()
@AS_JSON
def machines(as_json: bool) -> None:
    """List the bundled machines."""
    from ambrose.machine.config import bundled_machines, load_machine

    found = {name: load_machine(name).description for name in bundled_machines()}
    if as_json:
        click.echo(json.dumps(found))
        return
    _table("Bundled machines", ("name", "what it is"), list(found.items()))


@main.command()
@MACHINE
@AS_JSON
def check(machine: str, as_json: bool) -> None:
    """Validate a machine file; mass, bending frequencies, open-loop poles and model sizes."""
    from ambrose import study

    facts = study.facts(_load(machine))
    if as_json:
        click.echo(json.dumps(facts))
        return
    _table(f"{facts['machine']}: {facts['description']}", ("quantity", "value"), _facts_in_words(facts))


@main.command()
@MACHINE
@click.option("--method", type=click.Choice(["pid", "hinf", "mu", "polish"]), default="pid", show_default=True)
@click.option("--bending-modes", type=int, default=0, show_default=True, help="Bending modes per plane in the design model.")
@click.option(
    "--match-reference/--own-gain",
    default=None,
    help="Scale the control weight until the direct gains match the reference PID's; default: with a constant weight.",
)
@click.option("--order", type=int, default=None, help="States of the polished controller; default: half of what mu needs.")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("controller.json"), show_default=True)
@AS_JSON
def synthesize(
    machine: str,
    method: str,
    bending_modes: int,
    match_reference: bool | None,
    order: int | None,
    output: Path,
    as_json: bool,
) -> None:
    """Design a controller on the reduced plant and certify it on the full one, at the nominal operating point."""
    from ambrose.export.files import write_controller
    from ambrose.export.results import certificate_to_dict
    from ambrose.plant.assemble import assemble
    from ambrose.synthesis.design import design

    description = _load(machine)
    with _progress(as_json) as progress:
        progress("assembling the plant")
        plant = assemble(description)
        progress(f"designing ({method})")
        result = design(
            plant, method, bending_modes=bending_modes, match_reference=match_reference, order=order, progress=progress
        )
    write_controller(output, result, description)
    certificate = certificate_to_dict(result.certificate)
    if as_json:
        summary: dict[str, Any] = {"controller": str(output), "method": method, "status": result.status}
        summary["notes"] = list(result.notes)
        summary["certificate"] = certificate
        click.echo(json.dumps(summary))
    else:
        rows = [(name.replace("_", " "), _shown(value)) for name, value in certificate.items() if name != "margins"]
        rows += [(name.replace("_", " "), _shown(value)) for name, value in certificate["margins"].items()]
        rows += [("note", note) for note in result.notes]
        _table(f"{method} controller, {result.status}: {output}", ("certificate", "value"), rows)
    sys.exit(0 if result.status.startswith("verified") else 1)


@main.command()
@MACHINE
@click.option("--controller", "path", type=click.Path(path_type=Path), required=True, help="A controller file (*.json).")
@ALL
@AS_JSON
def verify(machine: str, path: Path, everything: bool, as_json: bool) -> None:
    """Check a controller on the full plant: at every operating point of the machine, and over all its tolerances."""
    from ambrose import study
    from ambrose.export.files import read_controller
    from ambrose.export.results import checks_to_dict

    description = _load(machine)
    controller = read_controller(path).controller
    with _progress(as_json) as progress:
        plants = study.full_plants(description)
        points = study.verification(plants, controller, progress)
        over_box = study.over_tolerances(plants[0], controller, points[0].stable, progress)
    if as_json:
        found = {"points": [checks_to_dict(r) for r in points], "robust": checks_to_dict(over_box) if over_box else None}
        click.echo(json.dumps({"machine": description.name, **found}))
    else:
        for result in [*points, *([over_box] if over_box else [])]:
            _print_checks(result, everything)
    sys.exit(0 if all(r.passed for r in points) and (over_box is None or over_box.passed) else 1)


@main.command()
@MACHINE
@click.option("--controller", "path", type=click.Path(path_type=Path), required=True, help="A controller file (*.json).")
@click.option("--scenario", required=True, help="A scenario file (*.toml) or the name of a bundled scenario.")
@click.option("--linear", is_flag=True, help="The linear model instead of the nonlinear virtual rig.")
@click.option("--second", type=click.Path(path_type=Path), help="A controller that takes over at the scenario's switch_at.")
@click.option("--bending-modes", type=int, default=1, show_default=True, help="Bending modes per plane of the rig.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the sensors' noise.")
@click.option("--point", default=None, help="Label of an operating point, or its beginning; default: nominal.")
@click.option("--report", type=click.Path(path_type=Path), help="A page of the run: orbits, waterfall, currents, animation.")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("record.h5"), show_default=True)
@AS_JSON
def simulate(
    machine: str,
    path: Path,
    scenario: str,
    linear: bool,
    second: Path | None,
    bending_modes: int,
    seed: int,
    point: str | None,
    report: Path | None,
    output: Path,
    as_json: bool,
) -> None:
    """Run a scenario on the virtual rig (or the linear model) and write the record (*.h5 or *.csv).

    An *.h5 record of the rig grows while it runs, as *.partial.h5, which stays readable when the run is interrupted.
    """
    from ambrose import study
    from ambrose.export.files import read_controller
    from ambrose.machine.parameters import operating_point
    from ambrose.machine.record import write_record
    from ambrose.simulate import virtual_rig
    from ambrose.simulate.scenario import load_scenario

    description = _load(machine)
    controller = read_controller(path).controller
    with _progress(as_json) as progress:
        if linear:
            progress("assembling the plant")
            plant = study.plant_at(description, point)
            progress(f"simulating {scenario}")
            trace = study.simulation(plant, controller, scenario)
        else:
            progress(f"running {scenario} on the virtual rig (the first run on a computer compiles it, half a minute)")
            trace = virtual_rig.run(
                description,
                controller,
                load_scenario(scenario),
                second=None if second is None else read_controller(second).controller,
                point=None if point is None else operating_point(description, point),
                bending_modes=bending_modes,
                seed=seed,
                path=None if output.suffix.lower() == ".csv" else output,
                progress=progress,
            )
    if linear or output.suffix.lower() == ".csv":
        write_record(trace.record, output)
    if report is not None:
        from ambrose.report.document import write
        from ambrose.report.record_page import record_report

        write(record_report(trace, description), report)
    summary = {"record": str(output), "outcome": trace.outcome, "text": trace.text, "report": str(report) if report else None}
    click.echo(json.dumps(summary) if as_json else f"{output}: {trace.text}")
    sys.exit(0 if trace.outcome == "completed" else 1)


@main.command()
@click.argument("record", type=click.Path(path_type=Path))
@click.option("--columns", type=click.Path(path_type=Path), help="Column map (*.toml), for files of MATLAB and LabVIEW.")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("record.h5"), show_default=True)
@AS_JSON
def convert(record: Path, columns: Path | None, output: Path, as_json: bool) -> None:
    """Write a record (*.h5, *.csv), or a file of MATLAB (*.mat) or LabVIEW (*.tdms), as a record (*.h5 or *.csv)."""
    from ambrose.machine.record import read_record, write_record
    from ambrose.machine.record_import import read_foreign

    result = read_record(record) if columns is None else read_foreign(record, columns)
    write_record(result, output)
    count, rate = result.values.shape[1], result.sample_rate_hz
    summary = {"record": str(output), "signals": result.signals, "samples": count, "sample_rate_hz": rate}
    signals = f"{', '.join(result.signals[:8])}{' ...' if len(result.signals) > 8 else ''}"
    words = f"{output}: {count / rate:.6g} s at {rate:.6g} Hz, {len(result.signals)} signals ({signals})"
    click.echo(json.dumps(summary) if as_json else words)


@main.command()
@click.argument("controller", type=click.Path(path_type=Path))
@click.option("--to", "target", type=click.Choice(["c"]), required=True, help="What to write.")
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, help="Directory for the files.")
@click.option("--name", default="controller", show_default=True, help="Prefix of every name in the code, a C identifier.")
@click.option(
    "--arithmetic", type=click.Choice(["double", "float", "fixed32", "fixed16"]), default="double", show_default=True
)  # fmt: skip
@click.option("--rate-hz", type=float, default=None, help="Sample rate; default: the controller's own, or 10000.")
@click.option("--delay-samples", type=int, default=1, show_default=True, help="From measured errors to currents set.")
@click.option("--sampling", type=click.Choice(["tustin", "zoh"]), default="tustin", show_default=True)
@click.option("--prewarp-hz", type=float, default=None, help="Tustin exact at this frequency.")
@click.option("--machine", "machine", default=None, help="Default: the bundled machine that the controller was made for.")
@click.option("--error-limit", type=float, default=None, help="Largest plausible error in m; default: the bearing's gap.")
@click.option("--current-limit", type=float, default=None, help="Largest current in A; default: the bearing's.")
@click.option("--force", is_flag=True, help="Export a controller that is not verified, or not stable everywhere.")
@AS_JSON
def export(
    controller: Path, target: str, output: Path, name: str, arithmetic: Any, rate_hz: float | None, delay_samples: int,
    sampling: Any, prewarp_hz: float | None, machine: str | None, error_limit: float | None, current_limit: float | None,
    force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Sample a controller, verify its loop as it will run, and write it as code for the target."""
    from ambrose.core.checks import check_positive
    from ambrose.export.deliver import deliver_code
    from ambrose.export.files import read_controller

    remedy = "give it in Hz"
    dt = None if rate_hz is None else 1 / check_positive(rate_hz, "--rate-hz", remedy)
    prewarp = None if prewarp_hz is None else 6.283185307179586 * check_positive(prewarp_hz, "--prewarp-hz", remedy)
    file = read_controller(controller)
    with _progress(as_json) as progress:
        done = deliver_code(
            file, output, None if machine is None else _load(machine), name=name, arithmetic=arithmetic, sample_time=dt,
            delay_samples=delay_samples, method=sampling, prewarp=prewarp, error_limit=error_limit,
            current_limit=current_limit, force=force, progress=progress,
        )  # fmt: skip
    paths, problems = [str(path) for path in done.paths], list(done.deployment.problems)
    if as_json:
        summary = {"target": target, "files": paths, "verified": done.deployment.verified, "problems": problems}
        click.echo(json.dumps(summary))
    else:
        for problem in problems:
            click.echo(f"forced although {problem}", err=True)
        click.echo("\n".join(paths))
    sys.exit(0 if done.deployment.verified else 1)


@main.command(name="study")
@MACHINE
@click.option("-o", "--output", type=click.Path(path_type=Path), default=None, help="Directory; default: study-<machine>.")
@ALL
@AS_JSON
def study_command(machine: str, output: Path | None, everything: bool, as_json: bool) -> None:
    """The whole chain: every controller the machine file allows, verified, simulated and compared in report.html."""
    from ambrose import study
    from ambrose.report.tables import verdict

    description = _load(machine)
    directory = output or Path(f"study-{description.name}")
    with _progress(as_json) as progress:
        result = study.run(description, directory, progress)
    report = directory / "report.html"
    if as_json:
        click.echo(json.dumps({**study.results(result), "report": str(report)}))
    else:
        rows = [(name, "design", why) for name, why in result.failed]
        marks = ["red"] * len(rows)
        for candidate in result.candidates:
            for checks in [*candidate.checks, *([candidate.robust] if candidate.robust else [])]:
                label = "over all tolerances" if checks is candidate.robust else checks.label
                rows.append((candidate.name, label, verdict(checks).text))
                marks.append("" if checks.passed else "red")
                if everything:
                    _print_checks(checks, everything)
        _table(f"{description.name}: {len(result.candidates)} controllers", ("controller", "at", "verdict"), rows, marks)
        click.echo(f"Most checks are met by {result.best.name}. Report: {report}")
    sys.exit(0 if result.passed else 1)


def _load(machine: str) -> Any:
    from ambrose.machine.config import load_machine

    return load_machine(machine)


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str], None]]:
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


def _table(title: str, columns: Sequence[str], rows: Sequence[tuple[str, ...]], marks: Sequence[str] = ()) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 140)
    table = Table(title=title, title_justify="left", title_style="bold")
    for column in columns:
        table.add_column(column, overflow="fold")
    for i, row in enumerate(rows):
        table.add_row(*row, style=marks[i] if marks else None)
    console.print(table)


def _facts_in_words(facts: dict[str, Any]) -> list[tuple[str, str]]:
    from ambrose.report.units import quantity

    unstable = ", ".join(f"{re:.1f}{im:+.1f}j" for re, im in facts["unstable_poles_rad_s"])
    return [
        ("rotor mass", quantity(facts["mass_kg"], "kg")),
        ("centre of mass", quantity(facts["centre_m"], "m")),
        (
            "inertia, diametral and polar",
            f"{facts['diametral_inertia_kg_m2']:.4g} and {facts['polar_inertia_kg_m2']:.4g} kg m²",
        ),
        ("free-free bending", ", ".join(quantity(w, "rad/s") for w in facts["bending_rad_s"])),
        ("unstable open-loop poles", f"{unstable} rad/s" if unstable else "none"),
        ("rotor states, full and reduced", f"{facts['rotor_states']} and {facts['reduced_rotor_states']}"),
        ("plant states, full and reduced", f"{facts['plant_states']} and {facts['reduced_plant_states']}"),
        ("operating points", ", ".join(facts["operating_points"])),
        ("uncertain parameters", ", ".join(facts["tolerances"]) or "none"),
        ("assumed entries", f"{facts['assumed']}, listed with their reasons in the report"),
    ]


def _print_checks(checks: Any, everything: bool) -> None:
    """One operating point: the verdict in words, then the checks that have a limit (or all), without their sources."""
    from ambrose.report.tables import checks_table, verdict

    table = checks_table(checks)
    keep = [i for i, column in enumerate(table.columns) if not column.startswith("Standard")]
    shown = [i for i, check in enumerate(checks.checks) if everything or check.passed is not None]
    rows = [tuple(f"{table.cells[k][i].symbol} {table.cells[k][i].text}".strip() for i in keep) for k in shown]
    marks = tuple("red" if checks.checks[k].passed is False else "" for k in shown)
    _table(f"{checks.label}: {verdict(checks).text}", tuple(table.columns[i] for i in keep), rows, marks)


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
