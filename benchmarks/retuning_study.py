"""Retuning on machines that are not their file: does the changed loop hold what the page says?

python -m benchmarks.retuning_study [--runs 1] [--rows retuning-study.jsonl] [MACHINE ...]

The truth: every K_i and K_s 5 to 25 % off the file's, every seal's k half as much again (worn). The
file's controller runs it on the nonlinear rig, standing and turning; ``amb.retune`` has the record
and the file only. Then the new controller runs the truth, is accepted from its record, and the
truth's own loop is judged. Draws that the file's controller does not hold afloat, or that bend its
record too far, are drawn anew, and counted.

Rows that are in the file already stay: a run that was cut off goes on. ``--table`` prints what is
there. Minutes per machine; outside CI.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import ambrose as amb
from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.identification.parameters import nominal_values
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING
from ambrose.model.assemble import assemble
from ambrose.record.record import Record
from ambrose.rig.disturbances import Prbs
from ambrose.rig.scenario import Scenario

MACHINES = (
    "seal-rig",
    "flywheel",
    "overhung-blower",
    "turbomolecular-pump",
    "vertical-pump",
    "high-speed-spindle",
)
DRAWS = 20  # until the file's controller holds one
SECONDS = 5.0
AMPLITUDE = 0.05  # of the bias current


def truth(machine: Machine, rng: np.random.Generator) -> Machine:
    """The machine with magnets 5 to 25 % off, and worn seals."""

    def off(values: tuple[float, float] | None) -> tuple[float, float]:
        if values is None:
            raise InvalidInput(f"{machine.name} states no coefficients of its magnets")
        factor = 1 + rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.25)
        return factor * values[0], factor * values[1]

    bearings = tuple(
        replace(
            item,
            force_per_current=off(item.force_per_current),
            negative_stiffness=off(item.negative_stiffness),
        )
        for item in machine.bearings
    )
    seals = tuple(
        replace(item, k=1.5 * item.k) if item.geometry is None and item.table is None else item
        for item in machine.seals
    )
    return replace(machine, bearings=bearings, seals=seals)


def recorded(true: Machine, law: Any, label: str, seed: int) -> Record | None:
    """Binary sequences on every axis at an operating point; None where the rotor does not float."""
    driven = tuple(
        Prbs(f"e_{axis}", AMPLITUDE * bearing.bias_current, 5e-4, order=15, seed=seed + n)
        for n, (axis, bearing) in enumerate(zip(true.axes, true.axis_bearings, strict=True))
    )
    try:
        run = amb.simulate(
            true, law, Scenario("prbs", SECONDS, sequences=driven), point=label, seed=seed
        )
    except AmbroseError:
        return None
    if run.outcome != "completed":
        return None
    kept = [
        name for name in run.record.signals if name[:2] in {"y_", "u_", "e_"} or name == "speed"
    ]
    return run.record.select(kept)


def one(name: str, turning: bool, seed: int) -> dict[str, Any]:
    """A truth drawn, retuned, changed and accepted."""
    machine = amb.load_machine(name)
    law = amb.design(machine, "pid")
    points = sorted(machine.operation.points, key=lambda point: point.speed)
    label = points[-1 if turning else 0].label
    rng = np.random.default_rng([seed, turning])
    draws = 0
    record = None
    while record is None:
        draws += 1
        if draws > DRAWS:
            return {"outcome": f"none of {DRAWS} draws floats"}
        true = truth(machine, rng)
        record = recorded(true, law, label, seed)
    begun = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        done = amb.retune(machine, record, law, folder, changed=True)
        spent = time.process_time() - begun
        row = {
            "outcome": done.outcome,
            "stopped": done.stopped_at.words if done.stopped_at else "",
            "draws": draws,
            "seconds": round(spent, 1),
            "inside": _inside(true, done),
        }
        if done.new is None or done.after is None:
            return row
        row["running"], row["new"] = _peaks(true, law), _peaks(true, done.new)
        row["stated"] = _stated(done)
        after = recorded(true, done.new, label, seed + 100)
        if after is None:
            return {**row, "accepted": "does not float"}
        loop = amb.accept(done.machine, done.new, after).points[0]
        return {
            **row,
            "accepted": [c.name for c in loop.checks.checks if c.passed is False],
            "measured": [round(float(max(high for _, high in loop.peaks)), 3)],
        }


def _inside(true: Machine, done: Any) -> list[float]:
    """Distance of every K_i and K_s of the truth from what was found, in its half-widths."""
    if done.identification is None:
        return []
    result = done.identification.result
    plant = assemble(true, result.point)
    paths = [path for path in result.paths if path not in TIMING]
    wanted = dict(zip(paths, nominal_values(plant, paths).tolist(), strict=True))
    return [
        round(abs(item.value - wanted[item.path]) / item.half, 2)
        for item in done.moved
        if item.path in wanted
    ]


def _peaks(true: Machine, law: Any) -> list[float | None]:
    """The largest singular value of S at every operating point of the truth; None: unstable."""
    found: list[float | None] = []
    for part in amb.verify(true, law, tolerances=False).points:
        checks = {check.name: check for check in part.checks}
        stable = checks["stability"].passed
        found.append(round(float(checks["sensitivity"].value), 3) if stable else None)
    return found


def _stated(done: Any) -> list[float]:
    """What the page says at most of S over the intervals, by operating point: proved, else found."""
    found = []
    for box in done.after.boxes:
        values = {check.name: float(check.value) for check in box.checks}
        bound = values.get("robust.sensitivity.bound")
        found.append(round(bound if bound is not None else max(values.values()), 3))
    return found


def table(rows: list[dict[str, Any]]) -> str:
    """A line per run."""
    lines = [
        "| machine | | outcome | s | worst miss, half-widths | S before | S now | stated | accepted |"
    ]
    lines.append("|" + "---|" * 9)
    for row in rows:
        worst = max(row.get("inside") or [float("nan")])
        how = "turning" if row["turning"] else "standing"
        lines.append(
            f"| {row['machine']} | {how} | {row['outcome']} {row.get('stopped', '')} | "
            f"{row.get('seconds', '')} | {worst:.2f} | {row.get('running', '')} | "
            f"{row.get('new', '')} | {row.get('stated', '')} | {row.get('accepted', '')} |"
        )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """The study; see above."""
    parser = argparse.ArgumentParser(prog="benchmarks.retuning_study")
    parser.add_argument("machines", nargs="*")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--rows", type=Path, default=Path("out/retuning-study.jsonl"))
    parser.add_argument("--table", action="store_true")
    given = parser.parse_args(arguments)
    text = given.rows.read_text() if given.rows.exists() else ""
    rows = [json.loads(line) for line in text.splitlines()]
    if not given.table:
        given.rows.parent.mkdir(parents=True, exist_ok=True)
        known = {(row["machine"], row["turning"], row["seed"]) for row in rows}
        for seed in range(given.runs):
            for name in given.machines or MACHINES:
                for turning in (False, True):
                    if (name, turning, seed) in known:
                        continue
                    try:
                        made = one(name, turning, seed)
                    except AmbroseError as error:
                        made = {"outcome": f"refused: {error}"}
                    row = {"machine": name, "turning": turning, "seed": seed, **made}
                    rows.append(row)
                    with given.rows.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                    print(json.dumps(row), flush=True)
    print(table(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
