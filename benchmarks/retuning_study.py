"""Retuning on machines that are not their file: does the changed loop hold what the page says?

python -m benchmarks.retuning_study [--runs 1] [--rows retuning-study.jsonl] [MACHINE ...]

The truth: every K_i and K_s 5 to 25 % off the file's, every seal's k half as much again (worn). The
file's controller runs it on the nonlinear rig, standing and turning; ``amb.retune(anyway=True)`` has
the record and the file only. Then the new controller runs the truth, REPEATS records are made, and
the peak of |S_ii| of every axis that they show is held against what was predicted over the
identified intervals. Draws that the file's controller does not hold afloat, or that bend its
record too far, are drawn anew, and counted.

Rows that are in the file already stay: a run that was cut off goes on. ``--table`` prints what is
there. Minutes per machine; outside CI.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import ambrose as amb
from ambrose.chain.commissioning import as_recorded
from ambrose.core.checks import AmbroseError, InvalidInput, NumericalFailure
from ambrose.identification.parameters import nominal_values
from ambrose.judge.sampled import sampled_box
from ambrose.law.loop import DEFAULT, machine_timing, match_controller, timing_of
from ambrose.machine.criteria import SENSITIVITY_RANGE, SPEED_RANGE_FACTOR
from ambrose.machine.description import MagneticBearing, OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING
from ambrose.machine.part import PidSettings
from ambrose.model.assemble import assemble
from ambrose.model.plant import top_speed
from ambrose.record.record import Record
from ambrose.rig.scenario import Prbs, Scenario
from ambrose.terminal import kept_page

MACHINES = (
    "seal-rig",
    "turboexpander",
    "overhung-blower",
    "flywheel",
    "outboard-sensor-rotor",
    "turbomolecular-pump",
    "high-speed-spindle",
)
DRAWS = 20  # until the file's controller holds one
SECONDS = 5.0
RATES = (2e4, 4e4)  # [Hz], tried in turn where the file states none and 10 kHz do not do
AMPLITUDE = 0.05  # of the bias current
ABOVE = 1.25  # times the highest frequency that is judged: where the sequence's first null is
REPEATS = 3  # records of the new controller
MODES = 12  # bending modes per plane on the rig; with three its S is 2 % off the shaft's at 2 kHz
MEMBERS = 64  # of the identified box, at random, beside its middle, for the predicted interval


def truth(machine: Machine, rng: np.random.Generator) -> Machine:
    """The machine with magnets 5 to 25 % off, and worn seals. K_i and K_s go with the area of the
    poles, which is what is off where they follow from the magnets' dimensions.
    """

    def off(values: Any) -> tuple[float, float]:
        factor = 1 + rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.25)
        return factor * values[0], factor * values[1]

    def other(item: MagneticBearing) -> MagneticBearing:
        if item.force_per_current is None or item.negative_stiffness is None:
            if item.geometry is None:
                raise InvalidInput(f"{machine.name} states neither coefficients nor pole areas")
            area, _ = off((item.geometry.pole_area, 0.0))
            return replace(item, geometry=replace(item.geometry, pole_area=area))
        return replace(
            item,
            force_per_current=off(item.force_per_current),
            negative_stiffness=off(item.negative_stiffness),
        )

    bearings = tuple(other(item) for item in machine.bearings)
    seals = tuple(
        replace(item, k=1.5 * item.k) if item.geometry is None and item.table is None else item
        for item in machine.seals
    )
    return replace(machine, bearings=bearings, seals=seals)


def bit_time(machine: Machine, rate: float) -> float:
    """Seconds per bit, whole samples, so that the first null of the sequence, 1 over it, lies above
    all that is judged.
    """
    highest = max(SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * top_speed(machine))
    return max(int(rate / (ABOVE * highest / (2 * np.pi))), 1) / rate


def recorded(true: Machine, law: Any, label: str, seed: int) -> Record | None:
    """Binary sequences on every axis at an operating point; None where the rotor does not float."""
    rate = (timing_of(true, law) or DEFAULT).rate
    bit = bit_time(true, rate)
    driven = tuple(
        Prbs(f"e_{axis}", AMPLITUDE * bearing.bias_current, bit, order=16, seed=seed + n)
        for n, (axis, bearing) in enumerate(zip(true.axes, true.axis_bearings, strict=True))
    )
    try:
        run = amb.simulate(
            true,
            law,
            Scenario("prbs", SECONDS, sequences=driven),
            point=label,
            seed=seed,
            bending_modes=MODES,
        )
    except AmbroseError:
        return None
    if run.outcome != "completed":
        return None
    kept = [
        name for name in run.record.signals if name[:2] in {"y_", "u_", "e_"} or name == "speed"
    ]
    return run.record.select(kept)


def running(machine: Machine, point: OperatingPoint) -> tuple[Machine, Any, str]:
    """The machine, the file's controller and its method: the PID, or the tuned one where the PID
    does not hold the file's machine at the point of the record, as the rig runs it. Where the file
    states no rate and neither holds at the assumed one, twice that is stated, and so on, as the
    product's own refusal advises.
    """
    for rate in (None, *RATES):
        if rate is not None:
            settings = replace(machine.controller or PidSettings(), sample_time=1 / rate)
            machine = replace(machine, controller=settings)
        plant = assemble(machine, point)
        for method in ("pid", "tuned"):
            law = amb.design(machine, method)
            if as_recorded(plant, law).stable:
                return machine, law, method
        if rate is None and machine_timing(machine) is not None:
            break
    raise NumericalFailure(f"no controller holds {machine.name} at {point.label}")


def advised(
    machine: Machine, record: Record, law: Any, folder: str, told: Callable[[str], None]
) -> tuple[Any, int]:
    """The retuning, and how many bending modes it was told; once more with as many as its findings
    advise, as the user would.
    """
    modes = 3
    while True:
        done = amb.retune(
            machine,
            record,
            law,
            folder,
            changed=True,
            anyway=True,
            bending_modes=modes,
            progress=told,
        )
        advice = re.search(r"(\d+) bending modes instead of", done.text)
        if advice is None or int(advice[1]) <= modes:
            return done, modes
        modes = int(advice[1])


def one(name: str, turning: bool, seed: int) -> dict[str, Any]:
    """A truth drawn, retuned, changed and accepted."""
    machine = amb.load_machine(name)
    points = sorted(machine.operation.points, key=lambda point: point.speed)
    at = points[-1 if turning else 0]
    label = at.label
    if turning and not at.speed:
        return {"outcome": "does not turn"}
    machine, law, under = running(machine, at)
    rng = np.random.default_rng([seed, turning])
    draws = 0
    record = None
    while record is None:
        draws += 1
        if draws > DRAWS:
            return {"outcome": f"none of {DRAWS} draws floats"}
        true = truth(machine, rng)
        if as_recorded(assemble(true, at), law).stable:
            record = recorded(true, law, label, seed)
    begun = time.process_time()
    stages: dict[str, float] = {}
    under_way = [(begun, "")]

    def told(stage: str) -> None:
        now, (since, before) = time.process_time(), under_way[0]
        key = before.split(",")[0][:40]
        stages[key] = stages.get(key, 0.0) + now - since
        under_way[0] = now, stage

    with tempfile.TemporaryDirectory() as folder:
        done, modes = advised(machine, record, law, folder, told)
        told("page")
        if done.after is not None:
            kept_page(done, Path(folder) / "page.html", progress=lambda stage: None)
    spent = time.process_time() - begun
    told("")
    longest = sorted(stages.items(), key=lambda item: -item[1])[:6]
    stopped = done.stopped_at
    row = {
        "outcome": done.outcome,
        "stopped": "" if stopped is None else f"{stopped.name}: {stopped.words}",
        "under": under,
        "running_does": done.before is not None and done.before.passed,
        "draws": draws,
        "modes": modes,
        "seconds": round(spent, 1),
        "stages": {name: round(value, 1) for name, value in longest},
        "inside": _inside(true, done),
        "switches": [[run.passed, round(1e6 * run.bump, 2)] for run in done.switches],
    }
    if done.new is None or done.after is None:
        return row
    row["running"], row["new"] = _peaks(true, law), _peaks(true, done.new)
    row["stated"] = _stated(done)
    row["axes"] = []
    for repeat in range(REPEATS):
        after = recorded(true, done.new, label, seed + 100 * (repeat + 1))
        if after is None:
            return {**row, "axes": None}
        row["axes"] += measured(done, after)
    return row


def measured(done: Any, record: Record) -> list[dict[str, Any]]:
    """By axis: the peak of |S_ii| that a record shows, with its 95 % interval; what was predicted
    over the identified intervals alone, on the same lines; whether the two meet; and of all lines
    the share at which they do.
    """
    loop = amb.accept(done.machine, done.new, record).points[0]
    plant = assemble(done.machine, replace(record.point, label=""))
    known = {item.path for item in done.moved}
    box_of = tuple(item for item in done.machine.tolerances if item.parameter in known)
    law = done.timing.in_loop(match_controller(done.new, plant))
    box = sampled_box(plant, law, box_of)
    rng = np.random.default_rng(0)
    count = len(box.names)
    corners = rng.choice([-1.0, 1.0], (MEMBERS, count))
    inner = rng.uniform(-1, 1, (MEMBERS, count))
    S = np.abs(
        np.einsum(
            "dwii->dwi",
            box.sensitivity(loop.omega, np.vstack([np.zeros((1, count)), corners, inner])),
        )
    )
    least, most = S.max(axis=1).min(axis=0), S.max(axis=1).max(axis=0)
    meets = (loop.modulus + loop.half >= S.min(axis=0)) & (
        loop.modulus - loop.half <= S.max(axis=0)
    )
    rows = []
    for i, axis in enumerate(loop.axes):
        told = loop.told[:, i]
        at = int(np.where(told, loop.modulus[:, i], 0.0).argmax())
        peak, half = float(loop.modulus[at, i]), float(loop.half[at, i])
        rows.append(
            {
                "axis": axis,
                "measured": [round(peak, 4), round(half, 4)],
                "predicted": [round(float(least[i]), 4), round(float(most[i]), 4)],
                "inside": bool(least[i] - half <= peak <= most[i] + half),
                "lines": round(float(meets[told, i].mean()), 3),
                "told": round(float(told.mean()), 3),
            }
        )
    return rows


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
        peak = checks["sensitivity.output.max"].value if part.stable else None
        found.append(None if peak is None else round(float(peak), 3))
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
    """A line per run, and the count."""
    lines = [
        "| machine | | outcome | s | worst miss, half-widths | S before | S now | stated | "
        "change, back [um] | axes inside | lines |"
    ]
    lines.append("|" + "---|" * 11)
    for row in rows:
        worst = max(row.get("inside") or [float("nan")])
        how = "turning" if row["turning"] else "standing"
        axes = row.get("axes") or []
        inside = f"{sum(item['inside'] for item in axes)} of {len(axes)}" if axes else ""
        shares = [item["lines"] for item in axes]
        lines.append(
            f"| {row['machine']} | {how} | {row['outcome']} {row.get('stopped', '')} | "
            f"{row.get('seconds', '')} | {worst:.2f} | {row.get('running', '')} | "
            f"{row.get('new', '')} | {row.get('stated', '')} | "
            f"{', '.join(str(bump) for _, bump in row.get('switches', ()))} | {inside} | "
            f"{np.mean(shares) if shares else float('nan'):.3f} |"
        )
    every = [item for row in rows for item in row.get("axes") or []]
    held = sum(item["inside"] for item in every)
    return "\n".join([*lines, "", f"peaks of an axis inside: {held} of {len(every)}"])


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
