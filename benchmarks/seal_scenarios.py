"""Seals that change, on the virtual rig: controllers side by side in a surge, on a seal twice as
strong as thought, over its wear, in a surge while the machine runs up, and at a trip; at 10 kHz and
one sample late, every seal there twice.

    python -m benchmarks.seal_scenarios [MACHINE ...] [--pages FOLDER] [--wear SECONDS]

What a controller scheduled over pressure is told: where the pressure makes the seal strong, twice
the pressure of the two seals together, which is that of one as strong as both; where the seal is
stronger than thought, or worn, the nominal pressure throughout. Its range is zero to twice the
nominal pressure, so that nothing is clamped.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import ambrose as amb
from ambrose.core.checks import AmbroseError
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.plant import top_speed
from ambrose.report import theme
from ambrose.report.page import Cell, Figure, Page, Section, Table, Verdict, write
from ambrose.rig.scenario import (
    PressureChange,
    PressureSensor,
    Pulse,
    Scenario,
    SpeedChange,
    Unbalance,
)

MACHINES = ("seal-rig", "turboexpander")
RATE = 10_000
FEW = 3  # operating points, above which one mu problem of all takes more than ten minutes
TOLD = PressureSensor(gain=2.0)  # of one seal as strong as both
KNOCK, WIDTH = 0.5, 2e-3  # of the rotor's weight; s
SETTLED, LAST = 0.05, 0.05  # of a knock's peak above what is left; s, over which that is taken
WORDS = (
    "Largest motion at the seal from its mean [um], and the time in which the last knock dies "
    "away to 5 %. Every knock is half "
    "the rotor's weight for 2 ms. The seals are there twice: at the nominal pressure twice as "
    "strong as the machine file says. "
    "A schedule over pressure is told the nominal one where the seal is stronger than thought or "
    "worn, else twice what it is. "
    "Where the rotor turns, unbalance G2.5."
)


@dataclass(frozen=True)
class Case:
    """A scenario and when the rotor is knocked [s]."""

    scenario: Scenario
    knocks: tuple[float, ...]


def twice(machine):
    """The machine with every seal there twice."""
    again = tuple(replace(seal, name=f"{seal.name}-again") for seal in machine.seals)
    return replace(machine, seals=(*machine.seals, *again), tolerances=())


def cases(machine, wear):
    """{name: Case}; pressures from nothing to the nominal one, wear within so many seconds."""
    nominal, top, held = (
        machine.operation.nominal.seal_pressure,
        top_speed(machine),
        machine.operation.design.speed,
    )
    force = KNOCK * 9.81 * mass_properties(finite_element_rotor(machine)).mass
    unbalance = (
        (Unbalance("every", grade=2.5e-3, grade_speed=machine.requirements.balance_speed or top),)
        if top
        else ()
    )

    def case(name, duration, knocks, pressures, speed=held, changes=(), told=TOLD):
        pulses = tuple(Pulse(f"f_{machine.seals[0].name}_x", force, at, WIDTH) for at in knocks)
        changing = tuple(PressureChange(*item) for item in pressures)
        return Case(
            Scenario(
                name,
                duration,
                pulses=pulses,
                unbalances=unbalance,
                speed=speed,
                speed_changes=changes,
                pressures=changing,
                pressure_sensors=(told,),
            ),
            knocks,
        )

    found = {
        "surge: 0 to 2 in 0.1 s": case(
            "surge", 1.0, (0.1, 0.45), [(0.0, 0.0), (0.3, nominal, 0.1)]
        ),
        "twice as strong as thought": case(
            "strong", 0.6, (0.1,), [(0.0, nominal)], told=PressureSensor()
        ),
        f"wear: 1 to 2, in {wear:g} s": case(
            "wear",
            wear + 0.6,
            tuple(0.1 + wear / 4 * k for k in range(5)),
            [(0.0, nominal / 2), (0.05, nominal, wear)],
            told=PressureSensor(gain=0.0, offset=nominal),
        ),
        "trip: 2 to 0 in 0.05 s": case(
            "trip", 0.8, (0.1, 0.45), [(0.0, nominal), (0.3, 0.0, 0.05)]
        ),
    }
    if top:
        pressures, changes = [(0.0, 0.0), (0.9, nominal, 0.1)], (SpeedChange(0.1, top, 1.6),)
        found["surge during run-up"] = case("run-up", 2.0, (), pressures, 0.05 * top, changes)
    return found


def controllers(machine):
    """{name: controller, or why there is none}."""
    rate = {"rate": RATE}
    asked = {
        "PID": ("pid", rate),
        "tuned PID": ("tuned", rate | {"structure": "pid"}),
        "mu": ("mu", rate),
        "tuned": ("tuned", rate),
    }
    if len(machine.operation.envelope) <= FEW:
        asked["mu of all points"] = "mu", rate | {"envelope": True}
    pressures = {"pressures": (0.0, 2 * machine.operation.nominal.seal_pressure)}
    asked["LPV over pressure"] = "lpv", rate | pressures
    if top := top_speed(machine):
        asked["LPV over speed"] = "lpv", {}
        asked["LPV over both"] = "lpv", rate | pressures | {"speeds": (0.0, top)}
    found = {}
    for name, (method, options) in asked.items():
        try:
            found[name] = amb.design(machine, method, **options)
        except AmbroseError as error:
            found[name] = f"no design: {error}"
    return found


def motion(machine, trace):
    """Distance from the mean place at the first seal [m], at every sample."""
    places = np.array([trace.record[f"q_{machine.seals[0].name}_{axis}"] for axis in "xy"])
    return np.hypot(*(places - np.median(places, axis=1)[:, None]))


def outcome(machine, case, trace):
    """What became of a run, in words."""
    if trace.outcome != "completed":
        return (
            f"{trace.outcome.replace('touchdown', 'lost')} at "
            f"{trace.text.split('t = ')[-1].split(' s')[0]} s"
        )
    path = motion(machine, trace)
    words = f"{1e6 * path[int(0.02 * RATE) :].max():.1f} um"
    if not case.knocks:
        return words
    after = path[int(case.knocks[-1] * RATE) :]
    rest = after[-int(LAST * RATE) :].max()
    outside = np.flatnonzero(after > rest + SETTLED * (after.max() - rest))
    return f"{words}, {1e3 * (outside[-1] + 1) / RATE if len(outside) else 0:.0f} ms"


def study(name, wear):
    """The names of the controllers, {case: outcomes}, and the runs of the first case."""
    machine = amb.load_machine(name)
    laws = controllers(machine)
    strong = twice(machine)
    rows = {}
    first = {}
    print(f"| {name} | {' | '.join(laws)} |\n|---|{'---|' * len(laws)}", flush=True)
    for title, case in cases(machine, wear).items():
        rows[title] = []
        for called, law in laws.items():
            if isinstance(law, str):
                rows[title].append(law)
                continue
            trace = amb.simulate(strong, law, case.scenario)
            rows[title].append(outcome(machine, case, trace))
            if len(rows) == 1:
                first[called] = trace
        print(f"| {title} | {' | '.join(rows[title])} |", flush=True)
    return machine, tuple(laws), rows, first


def largest(rows, which):
    """The largest motion and the longest time of a controller that holds all, in words."""
    parts = [part.split() for texts in rows.values() for part in texts[which].split(", ")]
    most = {
        unit: max((float(value) for value, of in parts if of == unit), default=0.0)
        for unit in ("um", "ms")
    }
    return f"at most {most['um']:.1f} um, settled within {most['ms']:.0f} ms"


def page(machine, names, rows, first):
    """The report: the table, and the surge in time."""
    figure = theme.subplots(rows=1, cols=1)
    for name, style in theme.candidate_styles(list(first)).items():
        trace = first[name]
        path = 1e6 * motion(machine, trace)
        kept = path < 40 if trace.outcome != "completed" else np.ones(len(path), bool)
        last = int(np.argmin(kept)) if not kept.all() else len(path)
        part = slice(0, last, max(1, len(path) // 4000))
        time = np.arange(len(path)) / RATE
        theme.scatter(
            figure, {"row": 1, "col": 1}, time[part], path[part], name, shown=True, line=style.line
        )
    theme.dress(figure, 320, legend=True)
    figure.update_xaxes(title_text="Time [s]")
    figure.update_yaxes(title_text="Motion at the seal [um]", rangemode="tozero")
    lost = {text for texts in rows.values() for text in texts if " um" not in text}
    table = Table(
        "Every scenario, every controller",
        ("Scenario", *names),
        tuple(
            (title, *(Cell(text, "fail" if text in lost else "pass") for text in texts))
            for title, texts in rows.items()
        ),
        WORDS,
        by_cell=True,
    )
    failed = {
        name: [title for title, texts in rows.items() if texts[i] in lost]
        for i, name in enumerate(names)
    }
    verdicts = tuple(
        Verdict(
            name,
            not titles,
            "not held: " + "; ".join(titles)
            if titles
            else f"holds all; {largest(rows, names.index(name))}",
        )
        for name, titles in failed.items()
    )
    count = sum(not titles for titles in failed.values())
    result = Verdict("", count > 0, f"{count} of {len(names)} controllers hold every scenario")
    surge = Figure("Surge: seal from nothing to twice its strength in 0.1 s", figure, "")
    section = Section("A seal that changes", "", (surge,), (table,))
    return Page(
        "Controllers and a seal that changes", machine, (section,), verdicts, (), result=result
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("machine", nargs="*")
    parser.add_argument("--pages", type=Path)
    parser.add_argument(
        "--wear",
        type=float,
        default=4.0,
        metavar="SECONDS",
        help="in which the seal wears to twice its strength",
    )
    given = parser.parse_args()
    for name in given.machine or MACHINES:
        found = study(name, given.wear)
        if given.pages:
            given.pages.mkdir(exist_ok=True)
            write(page(*found), given.pages / f"{name}-scenarios.html")


if __name__ == "__main__":
    main()
