"""What goes wrong between a machine, its file and a record, on the rig of the tests' own, through
``identify``: is any wrong value silent?

python -m benchmarks.mistakes_study [--first 0] [--seeds 1] [--good 50] [--rows FILE] [MISTAKE ...]

Every mistake under four conditions (standing, turning; linear, nonlinear magnets) on three machines,
fresh truths every time, from the first seed on; and correct records: those whose truth lies within
the tolerances that the file states. Silent wrong: no finding, and a value that lies more
than 3 standard deviations beyond its 95 % interval. Rows that are in the file stay. Minutes to
hours; outside CI.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import ambrose as amb
from ambrose.record.record import Record
from benchmarks.rig_cases import (
    CASES,
    CONVERTERS,
    RUNOUT,
    Case,
    Rig,
    as_record,
    excited,
    fresh,
    resumed,
    told,
    unbalanced,
)

BY_NAME = {case.machine: case for case in CASES}
SECONDS = 3.0


@dataclass
class Trial:
    """What a mistake may change: the machine's numbers, the rig's settings, the law that runs, the
    signals, and what the record says.
    """

    case: Case
    numbers: dict[str, Any]
    settings: dict[str, Any]
    law: tuple[np.ndarray, ...]
    signals: dict[str, Any] = field(default_factory=dict)
    says: dict[str, Any] = field(default_factory=dict)


def late(rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows[:, :1], rows[:, :-1]], axis=1)


def changed(kind: str, change: Any) -> Any:
    def apply(trial: Trial) -> None:
        trial.signals[kind] = change

    return apply


def clipped(rows: np.ndarray) -> np.ndarray:
    middle, level = rows.mean(axis=1, keepdims=True), 0.7 * np.ptp(rows, axis=1, keepdims=True) / 2
    return np.clip(rows, middle - level, middle + level)


def anti_alias(trial: Trial) -> None:
    trial.settings["anti_alias"] = 2 * np.pi * 0.15 * trial.case.rate


def coupling(trial: Trial) -> None:
    bearing = trial.numbers["bearings"][0]
    stiffness = np.full(2, 0.3 * float(np.mean(bearing["ks"])))
    spring = {"at": bearing["at"], "angle": bearing["angle"], "k": stiffness, "d": np.zeros(2)}
    trial.numbers["springs"] = [*trial.numbers["springs"], spring]


def cross_coupled(trial: Trial) -> None:
    trial.settings["cross"] = 0.15


def under_pressure(trial: Trial) -> None:
    """Pressure that the record does not tell; where the file has no seal, one that it lacks."""
    if trial.numbers["seals"]:
        trial.says["seal_pressure"] = 0.0
        return
    bearing = trial.numbers["bearings"][0]
    k = 0.25 * float(np.mean(bearing["ks"]))
    trial.numbers["seals"] = [{"at": bearing["at"], "K": 0.0, "k": k, "C": 0.0, "c": 0.0, "M": 0.0}]


def another_controller(trial: Trial) -> None:
    A, B, C, D = trial.law
    trial.law = (A, B, 1.05 * C, 1.05 * D)


def sensor_gain(trial: Trial) -> None:
    gains = np.ones(2 * len(trial.numbers["bearings"]))
    gains[1] = 1.05
    trial.settings["gains"] = gains


def wrong_speed(trial: Trial) -> None:
    """10 % off where it turns, and said to turn where it stands."""
    speed = trial.settings["speed"]
    trial.says["speed"] = 1.1 * speed if speed else trial.case.speed


def wrong_bias(trial: Trial) -> None:
    """15 % more bias than the file says."""
    for bearing in trial.numbers["bearings"]:
        bearing["bias"] *= 1.15
        bearing["ki"], bearing["ks"] = 1.15 * bearing["ki"], 1.15**2 * bearing["ks"]


def two_samples(trial: Trial) -> None:
    trial.settings["delay"] = 2


def eddy_currents(trial: Trial) -> None:
    """A second lag of the amplifier that the file lacks."""
    own = trial.numbers["amplifier"]
    if own["order"] == "first":
        own.update(order="twice-first", eddy_bandwidth=0.5 * own["bandwidth"])
    else:
        own["damping"] *= 1.3


def heavier(trial: Trial) -> None:
    """A rotor that is 7 % heavier than drawn."""
    for row in trial.numbers["shaft"]:
        row["density"] *= 1.07
        row["youngs_modulus"] *= 1.07
    for disc in trial.numbers["discs"]:
        disc.update({key: 1.07 * disc[key] for key in ("mass", "Ip", "Id")})


def other_rate(trial: Trial) -> None:
    trial.says["rate"] = 0.98 * trial.case.rate


MISTAKES = {
    "anti-alias filter": anti_alias,
    "coupling missing": coupling,
    "cross-coupled magnet": cross_coupled,
    "pressure untold": under_pressure,
    "another controller": another_controller,
    "sensor gain 5 %": sensor_gain,
    "y swapped": changed("y", lambda y: y[[1, 0, *range(2, len(y))]]),
    "y inverted": changed("y", lambda y: y * np.array([1, -1] + [1] * (len(y) - 2))[:, None]),
    "y a sample late": changed("y", late),
    "u a sample late": changed("u", late),
    "e a sample late": changed("e", late),
    "e times 1.5": changed("e", lambda e: 1.5 * e),
    "y clipped": changed("y", clipped),
    "wrong speed": wrong_speed,
    "wrong bias": wrong_bias,
    "two samples of delay": two_samples,
    "second lag of the amplifier": eddy_currents,
    "rotor 7 % heavier": heavier,
    "rate 2 % off": other_rate,
}


def made(
    machine: str, mistake: str, turning: bool, linear: bool, seed: int
) -> tuple[Record, Rig, Any]:
    """The record of a trial, the rig that ran and the law that ran on it."""
    case = BY_NAME[machine]
    number = 1 + list(MISTAKES).index(mistake) if mistake else 0
    rng = np.random.default_rng([number, turning, linear, seed])
    _, point, _, K = told(case, turning)
    m = fresh(case, rng)
    settings = {"speed": point.speed, "linear": linear, "runout": RUNOUT, **CONVERTERS}
    if turning:
        settings["unbalance"] = unbalanced(m, 4 * point.speed, rng)
    trial = Trial(case, m, settings, K)
    if mistake:
        MISTAKES[mistake](trial)
    rig = Rig(m, case.rate, **settings)
    e = excited(case, rig, SECONDS, 0.02, 4e-4, seed + 7)
    found = rig.run(trial.law, e, seed)
    found = {key: trial.signals.get(key, lambda x: x)(rows) for key, rows in found.items()}
    record = as_record(case, rig, found)
    says = dict(trial.says)
    record = replace(record, sample_rate_hz=says.pop("rate", record.sample_rate_hz))
    return replace(record, point=replace(record.point, **says)), rig, trial.law


def truth_of(path: str, rig: Rig, law: Any) -> float | None:
    """A parameter as it is on the rig, where it stands."""
    parts = path.split(".")
    if parts[0] == "bearing":
        ki, ks = rig.slopes(law)
        values = ki if parts[2] == "force_per_current" else ks
        return float(values[rig.axes.index(f"{parts[1]}_{parts[3]}")])
    if parts[0] == "amplifier":
        own = rig.numbers["amplifier"]
        lag = own.get(parts[1])
        return None if lag is None else float(lag)
    if parts[0] == "seal":
        return float(next(s for s in rig.numbers["seals"] if s.get("name") == parts[1])[parts[2]])
    return None


def trial(machine: str, mistake: str, turning: bool, linear: bool, seed: int) -> dict[str, Any]:
    begun = time.process_time()
    known, _, law, _ = told(BY_NAME[machine], turning)
    try:
        record, rig, ran = made(machine, mistake, turning, linear, seed)
    except ArithmeticError:
        return {"outcome": "touched"}
    try:
        found = amb.identify(known, record, law)
    except ValueError as error:
        return {
            "outcome": "refused",
            "words": str(error)[:400],
            "took": time.process_time() - begun,
        }
    off, outside = {}, []
    for row in found.parameters:
        true = truth_of(row.path, rig, ran)
        if true is None:
            continue
        off[row.path] = [(row.value - true) / row.standard_deviation, row.value / true - 1]
        stated = [t.relative for t in known.tolerances if row.path.startswith(t.parameter)]
        if any(width and abs(true / row.start - 1) > width for width in stated):
            outside.append(row.path)
    worst = max(off, key=lambda path: abs(off[path][0]))
    far = max(off, key=lambda path: abs(off[path][1]))
    return {
        "outcome": "passed" if found.passed else "finding",
        "codes": [str(item.code) for item in found.findings],
        "words": [str(item)[:300] for item in found.findings][:3],
        "worst": [worst, *(round(v, 4) for v in off[worst])],
        "far": [far, *(round(v, 4) for v in off[far])],
        "outside": outside,
        "along": bool(getattr(found, "found_along", "")),
        "took": time.process_time() - begun,
    }


def verdict(row: dict[str, Any]) -> str:
    """One word for a row."""
    if not row["key"]["mistake"] and row.get("outside"):
        return "beyond a tolerance"  # no correct record
    if row["outcome"] != "passed":
        return row["outcome"]
    return "SILENT" if abs(row["worst"][1]) > 1.96 + 3 else "right"


def table(path: Path) -> None:
    cells: dict[str, dict[tuple[Any, ...], list[dict[str, Any]]]] = defaultdict(
        lambda: defaultdict(list)
    )
    for line in path.read_text().splitlines():
        row = json.loads(line)
        key = row["key"]
        where = key["machine"], key["turning"], key["linear"]
        cells[key["mistake"] or "(correct)"][where].append(row)
    for mistake, by_case in cells.items():
        counts: dict[str, int] = defaultdict(int)
        notes = []
        for where, rows in by_case.items():
            for row in rows:
                word = verdict(row)
                counts[word] += 1
                if word == "SILENT" or (mistake == "(correct)" and word != "right"):
                    turns = "turning" if where[1] else "standing"
                    kind = "linear" if where[2] else "nonlinear"
                    told_ = (
                        row.get("worst") if word == "SILENT" else row.get("codes", row.get("words"))
                    )
                    notes.append(
                        f"    {where[0]}, {turns}, {kind}: {word} {told_} far {row.get('far')}"
                    )
        print(f"{mistake:28s} " + ", ".join(f"{n} {word}" for word, n in sorted(counts.items())))
        print("\n".join(notes[:40])) if notes else None


def keys(mistakes: list[str], seeds: range, good: int) -> list[dict[str, Any]]:
    wanted = [
        {"machine": case.machine, "mistake": mistake, "turning": t, "linear": lin, "seed": seed}
        for seed in seeds
        for case in CASES
        for mistake in mistakes
        for t in (False, True)
        for lin in (True, False)
    ]
    return wanted + [
        {
            "machine": CASES[n % 3].machine,
            "mistake": "",
            "turning": n // 3 % 2 == 1,
            "linear": n // 6 % 2 == 1,
            "seed": seeds.start + n,
        }
        for n in range(good)
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mistakes", nargs="*", default=list(MISTAKES))
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--good", type=int, default=50)
    parser.add_argument("--rows", type=Path, default=Path("mistakes.jsonl"))
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    if not options.table:
        resumed(options.rows, keys(options.mistakes, seeds, options.good), trial)
    table(options.rows)
