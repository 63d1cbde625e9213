"""Every bundled machine through every command, and the pages that list the machines and say what came out.

    python -m benchmarks.fleet      everything anew, an hour on two cores: benchmarks/fleet.json, docs/reference/machines.md,
                                    docs/research/machines.md
    python -m benchmarks.fleet NAME ... --only pid,cycle      some rows, some columns; the rest stays as it is stored

The fleet is discovered: a file more in src/ambrose/machines is a row more here, and a case more in
tests/test_fleet.py, which runs the same commands.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.law.loop import machine_timing
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_bending_frequencies,
    mass_properties,
)

STORED = Path(__file__).with_name("fleet.json")
DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "reference" / "machines.md"
RESULTS = DOCS / "research" / "machines.md"
OUTCOMES = {0: "passed", 1: "fails a check", 2: "refused"}
MARKS = {0: "+", 1: "**1**", 2: "**2**"}


def commands(machine, folder, levitation="levitation", prbs="prbs"):
    """The commands of the chain in their order: {what it is: arguments}. What one writes the next
    ones read.

    Tuning is told the rate where the machine file states none.
    """
    pid = folder / "pid.json"
    tuned = folder / "tuned.json"
    record = folder / "prbs.h5"
    rate = (
        ("--rate-hz", 10_000)
        if machine and machine_timing(amb.load_machine(machine)) is None
        else ()
    )
    return {
        "check": ("check", machine),
        "pid": ("synthesize", machine, "--method", "pid", "-o", pid),
        "levitation": (
            "simulate",
            machine,
            "--controller",
            pid,
            "--scenario",
            levitation,
            "-o",
            folder / "levitation.h5",
        ),
        "convert": ("convert", folder / "levitation.h5", "-o", folder / "levitation.csv"),
        "export": ("export", pid, "--to", "c", "--machine", machine, "-o", folder / "code"),
        "verify": ("verify", machine, "--controller", pid),
        "prbs": ("simulate", machine, "--controller", pid, "--scenario", prbs, "-o", record),
        "identify": (
            "identify",
            machine,
            record,
            "--controller",
            pid,
            "-o",
            folder / "identified.toml",
        ),
        "cycle": (
            "simulate",
            machine,
            "--controller",
            pid,
            "--scenario",
            "operating-cycle",
            "-o",
            folder / "cycle.h5",
        ),
        "tuned": ("synthesize", machine, "-o", tuned, *rate),
        "tuned verify": ("verify", machine, "--controller", tuned),
        "tuned cycle": (
            "simulate",
            machine,
            "--controller",
            tuned,
            "--scenario",
            "operating-cycle",
            "-o",
            folder / "tuned.h5",
        ),
    }


def call(arguments):
    """Exit status, seconds, and what was printed as JSON (None: not that) or the message of a
    refusal.
    """
    start = time.perf_counter()
    done = CliRunner().invoke(main, [*map(str, arguments), "--json"])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    said = json.loads(done.stdout) if done.exit_code in {0, 1} else done.stderr.strip()
    return done.exit_code, time.perf_counter() - start, said


def oddities(what, status, said):
    """What a reader should know of an outcome that is no pass."""
    if status == 0:
        return ""
    if not isinstance(said, dict):
        return str(said).splitlines()[-1].removeprefix("ambrose: ")
    if "points" in said:
        groups = [*said["points"], *(said["tolerances"] or ())]
        failed = {
            check["name"]
            for group in groups
            for check in group["checks"]
            if check.get("passed") is False
        }
        return ", ".join(sorted(failed))
    if said.get("method") == "tuned":
        return "; ".join([said["status"], *said["notes"]])
    words = [
        said.get("verdict"),
        said.get("outcome"),
        *said.get("problems", ()),
        *said.get("unmet_limits", ()),
    ]
    return "; ".join(str(word) for word in words if word) or str(said.get("status", ""))


def outcomes(machine, only=(), progress=print):
    """The commands on a machine (those that are named; what they read comes first): {what: [status,
    seconds, oddities]}.
    """
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for what, arguments in commands(machine, Path(folder)).items():
            if not only or what in only:
                status, seconds, said = call(arguments)
                found[what] = [status, round(seconds, 1), oddities(what, status, said)]
                progress(
                    f"{machine:24} {what:13} {OUTCOMES[status]:14} {seconds:6.1f} s  "
                    f"{found[what][2]}"
                )
    return found


def description(name):
    """A row: what the machine is and where it comes from."""
    machine = amb.load_machine(name)
    rotor = finite_element_rotor(machine)
    bending = free_bending_frequencies(rotor, 1)[0] / (2 * np.pi)
    figures = (
        f"{mass_properties(rotor).mass:.3g} | {bending:.0f} | "
        f"{machine.operation.speed_range[1] * 30 / np.pi:,.0f}"
    )
    return f"| `{name}` | {machine.description} | {figures} | {machine.source} |"


def page(names):
    """The page of the bundled machines, for users."""
    rows = "\n".join(description(name) for name in names)
    return f"""# Bundled machines

`ambrose machines` lists them. Each is a [machine file](machine-file.md) to start from, `src/ambrose/machines/NAME.toml`, with
its chosen figures under `[machine.assumed]`. Rotors from books have our own magnets. [What every command gives on
them](../research/machines.md).

| machine | what it is | mass [kg] | free-free bending [Hz] | top speed [rpm] | source |
|---|---|---|---|---|---|
{rows}
"""


def results_page(results):
    """The page of what came out: results {machine: outcomes}."""
    passed = {
        what: [found[what][1] for found in results.values()]
        for what in commands("", PAGE)
        if all(what in found and found[what][0] == 0 for found in results.values())
    }
    everywhere = ", ".join(f"{w} ({min(s):.1f} to {max(s):.1f} s)" for w, s in passed.items())
    columns = [what for what in commands("", PAGE) if what not in passed]
    head = f"| machine | {' | '.join(columns)} |\n|---|{'---|' * len(columns)}"
    table = "\n".join(
        f"| `{name}` | "
        + " | ".join(cell(found[c]) if c in found else "not run" for c in columns)
        + " |"
        for name, found in results.items()
    )
    return f"""# All commands on all machines

Exit status and seconds of twelve commands on the [bundled machines](../reference/machines.md): **+** all checks passed, **1** done, but a check failed, **2** refused. `pid` is the machine file's own
`[controller]`. Those of turboexpander and seal rigs are published continuous ones; at the
assumed 10 kHz the first does not levitate. `python -m benchmarks.fleet` makes this page.

Passed on all {len(results)} machines: {everywhere}. The others:

{head}
{table}

Failing checks and refusals: `benchmarks/fleet.json`.
"""


def cell(outcome):
    """How a command ended, and its seconds."""
    status, seconds, _ = outcome
    return f"{MARKS[status]}&nbsp;{seconds:.1f}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Every bundled machine through every command.")
    parser.add_argument("machine", nargs="*", help="default: all")
    parser.add_argument("--only", default="", help="commands, with commas; default: all")
    asked = parser.parse_args()
    stored = json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else {}
    for name in asked.machine or amb.bundled_machines():
        stored[name] = stored.get(name, {}) | outcomes(
            name, tuple(filter(None, asked.only.split(",")))
        )
        STORED.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
    machines = amb.bundled_machines()
    PAGE.write_text(page(machines), encoding="utf-8")
    RESULTS.write_text(
        results_page({name: stored.get(name, {}) for name in machines}), encoding="utf-8"
    )
