"""Acceptance, balancing and calibration on the rig of the tests' own, fresh truths and noise at every
run: do the stated 95 % hold?

python -m benchmarks.site_study [--runs 100] [--rows site-study.jsonl] [accept|balance|calibrate ...]

Rows that are in the file already stay: a run that was cut off goes on. ``--table`` prints what is
there. Minutes to hours; outside CI.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.site.acceptance import accept
from ambrose.annexes.site.balancing import balance
from ambrose.annexes.site.calibration import calibrate
from benchmarks.rig_cases import (
    CASES,
    CONVERTERS,
    RUNOUT,
    Rig,
    as_record,
    excited,
    fresh,
    resumed,
    told,
    unbalanced,
)

BY_NAME = {case.machine: case for case in CASES}
SETTLE = 0.5


def acceptance(machine: str, turning: bool, seed: int, seconds: float = 12.0) -> dict[str, Any]:
    """The true sensitivity of the sampled loop against the measured intervals."""
    case, rng = BY_NAME[machine], np.random.default_rng([1, turning, seed])
    known, point, law, K = told(case, turning)
    m = fresh(case, rng)
    rig = Rig(
        m,
        case.rate,
        point.speed,
        unbalance=unbalanced(m, point.speed, rng) if turning else {},
        runout=RUNOUT,
        saturation=4.0,
        **CONVERTERS,
    )
    e = excited(case, rig, seconds, 0.02, 2e-4, 1000 + seed)
    loop = accept(known, law, as_record(case, rig, rig.run(K, e, seed))).points[0]
    S = rig.sensitivity(K, loop.omega)
    own, largest = np.abs(np.einsum("wii->wi", S)), np.linalg.norm(S, 2, axis=(1, 2))

    # the peak itself, also between the lines
    dense = np.linspace(loop.omega[0], loop.omega[-1], 4 * len(loop.omega))
    dense = np.abs(np.einsum("wii->wi", rig.sensitivity(K, dense)))
    peaks = np.maximum(dense.max(axis=0), own.max(axis=0))
    return {
        "lines": float(np.mean(np.abs(loop.modulus - own) <= loop.half)),
        "sigma": float(np.mean((largest >= loop.low) & (largest <= loop.high))),
        "inside": [bool(lo <= p <= hi) for p, (lo, hi) in zip(peaks, loop.peaks, strict=True)],
        "peak": float(peaks.max()),
        "half": float(max(hi - lo for lo, hi in loop.peaks) / 2),
        "found": [c.name for c in loop.checks.checks if c.passed is False],
    }


PLANES = {
    "flywheel": (0.1, 0.6, 1.0),
    "three-bearing-train": (0.1, 0.6, 1.0),
}


def balancing(machine: str, seed: int, seconds: float = 3.0) -> dict[str, Any]:
    """Unbalance at the bearings' planes, slow roll and two speeds."""
    case, rng = BY_NAME[machine], np.random.default_rng([2, seed])
    known, point, law, K = told(case, True)
    m = fresh(case, rng, 0.02)
    names = [bearing["name"] for bearing in m["bearings"]]
    places = unbalanced(m, point.speed, rng)
    U = np.array(list(places.values()))
    records = []
    for k, share in enumerate(PLANES[machine]):
        rig = Rig(m, case.rate, share * point.speed, unbalance=places, runout=RUNOUT, **CONVERTERS)
        records.append(as_record(case, rig, rig.run(K, seconds, 10 * seed + k), "yu"))
    found = balance(known, records, dict.fromkeys(names, 0.05), controller=law, settle=SETTLE)
    off = np.abs(U + found.correction)
    return {
        "inside": [bool(o <= h) for o, h in zip(off, found.uncertainty, strict=True)],
        "off": float(off.max() / np.abs(U).max()),
        "half": float(np.max(found.uncertainty) / np.abs(U).max()),
        "found": [note for note in found.notes if note.startswith("finding")],
    }


def calibration(machine: str, seed: int) -> dict[str, Any]:
    """Gains, offsets, centres and run-out by a circle, slow roll and standing still."""
    case, rng = BY_NAME[machine], np.random.default_rng([3, seed])
    known, point, _, K = told(case, True)
    m = fresh(case, rng, 0.0)
    a = 2 * len(m["bearings"])
    gain, offset = 1 + 0.03 * rng.uniform(-1, 1, a), 1e-5 * rng.uniform(-1, 1, a)
    centre = 6e-6 * rng.uniform(-1, 1, a)
    runout = tuple((n, 3e-6 / n**1.5 * rng.uniform(0.5, 1), rng.uniform(-3, 3)) for n in (1, 2, 3))
    about = {"gains": gain, "offset": offset, "centre": centre, "runout": runout, **CONVERTERS}
    records = {}
    for name, speed, seconds in (("slow_roll", 0.05 * point.speed, 8.0), ("levitated", 0.0, 3.0)):
        rig = Rig(m, case.rate, speed, **about)
        records[name] = as_record(case, rig, rig.run(K, seconds, seed), "yu")

    # rolled around in the touchdown bearings by hand, a straight rotor: where its sensors are
    places = np.array([b["at"] for b in m["bearings"]])
    gaps = np.array([bearing.touchdown_gap for bearing in known.bearings])
    time = np.arange(round(6 * case.rate)) / case.rate
    rows = []
    for bearing in m["bearings"]:
        share = (bearing["sensor_at"] - places[0]) / (places[1] - places[0])
        q = ((1 - share) * gaps[0] + share * gaps[1]) * np.exp(1j * np.pi * time)
        q = q * np.exp(-1j * bearing["angle"])
        rows += [q.real, q.imag]
    y = gain[:, None] * np.array(rows) + offset[:, None]
    y = y + CONVERTERS["noise"] * rng.standard_normal(y.shape)
    records["circle"] = as_record(case, Rig(m, case.rate), {"y": y}, "y")
    found = calibrate(known, settle=SETTLE, **records)
    truth = {}
    for k, bearing in enumerate(m["bearings"]):
        for j, way in enumerate(("zeta", "eta")):
            n = 2 * k + j
            truth[bearing["name"], f"gain {way}"] = gain[n]
            truth[bearing["name"], f"offset {way}"] = offset[n]
            truth[bearing["name"], f"magnetic_offset {way}"] = centre[n]
        for order, amplitude, _ in runout:
            truth[bearing["name"], f"run-out {order}x"] = amplitude
    inside, worst = [], ""
    for row in found.entries:
        true = next(
            v
            for (name, end), v in truth.items()
            if f" {name} " in f" {row.name} " and row.name.endswith(f" {end}")
        )
        inside.append(bool(abs(row.value - true) <= row.half))
        worst += "" if inside[-1] else f"{row.name} {row.value:.4g}+-{row.half:.2g} ({true:.4g}); "
    return {"inside": inside, "worst": worst, "found": list(found.notes)}


def keys(which: list[str], runs: int) -> list[tuple[str, dict[str, Any]]]:
    wanted: list[tuple[str, dict[str, Any]]] = []
    for seed in range(runs):
        for name in BY_NAME if "accept" in which else ():
            wanted += [
                ("accept", {"machine": name, "turning": t, "seed": seed}) for t in (False, True)
            ]
        for name in PLANES if "balance" in which else ():
            wanted.append(("balance", {"machine": name, "seed": seed}))
        for name in ("seal-rig", "flywheel") if "calibrate" in which else ():
            wanted.append(("calibrate", {"machine": name, "seed": seed}))
    return wanted


STUDIES = {"accept": acceptance, "balance": balancing, "calibrate": calibration}


def one(study: str, **key: Any) -> dict[str, Any]:
    """The row of one run; a refusal is one, too."""
    try:
        return STUDIES[study](**key)
    except ValueError as error:
        return {"refused": str(error)}


def table(path: Path) -> None:
    rows: dict[tuple[Any, ...], list[dict[str, Any]]] = defaultdict(list)
    for line in path.read_text().splitlines():
        row = json.loads(line)
        key = row["key"]
        rows[key["study"], key["machine"], key.get("turning")].append(row)
    for (study, name, turning), own in sorted(rows.items(), key=str):
        good = [row for row in own if "refused" not in row]
        where = "" if turning is None else "turning" if turning else "standing"
        flags = [item for row in good for item in row["inside"]]
        all_of = np.mean([all(row["inside"]) for row in good]) if good else np.nan
        text = f"{study:9s} {name:20s} {where:8s} {len(own):3d} runs, {len(own) - len(good)} refused | "
        text += f"values inside {100 * np.mean(flags):5.1f} %, whole records {100 * all_of:5.1f} %"
        for name_, words in (
            ("lines", "lines"),
            ("sigma", "sigma_max"),
            ("off", "off"),
            ("half", "half"),
        ):
            if good and name_ in good[0]:
                text += f", {words} {np.mean([row[name_] for row in good]):.3g}"
        found: dict[str, int] = defaultdict(int)
        for row in good:
            for item in row["found"]:
                found[item[:60]] += 1
        print(text, "|", dict(found) if found else "no finding")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="*", default=list(STUDIES))
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--rows", type=Path, default=Path("site-study.jsonl"))
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    if not options.table:
        every = [{"study": s, **key} for s, key in keys(options.studies, options.runs)]
        resumed(options.rows, every, one)
    table(options.rows)
