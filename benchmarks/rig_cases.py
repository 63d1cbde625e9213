"""Machines on the rig of the tests' own (tests/independent_rig.py): fresh truths, and its records as
a user would have them.
"""

from __future__ import annotations

import copy
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import ambrose as amb
from ambrose.identification.output_error.problem import deployed_controller
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble
from ambrose.record.record import Record

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from independent_rig import Rig, binary, numbers_of

MACHINES = Path(amb.__file__).parent / "machines"
CONVERTERS = {"hum": 2e-8, "noise": 5e-8, "step_y": 1e-8, "step_u": 2e-4}
RUNOUT = ((1, 2e-6, 0.3), (2, 8e-7, 1.1), (3, 4e-7, -0.7))


@dataclass(frozen=True)
class Case:
    """A bundled machine, the rate [Hz] of its PID, its speed [rad/s] where it turns, the seal's
    pressure [Pa].
    """

    machine: str
    rate: float
    speed: float
    pressure: float


CASES = (
    Case("seal-rig", 1e4, 2 * np.pi * 50, 2.04e5),
    Case("flywheel", 1e4, 2 * np.pi * 140, 0.0),
    Case("three-bearing-train", 1e4, 2 * np.pi * 150, 2e6),
)


@cache
def told(case: Case, turning: bool) -> tuple[Any, OperatingPoint, Any, tuple[np.ndarray, ...]]:
    """What the user has: the machine's file, the operating point, the controller; and that sampled."""
    machine = amb.load_machine(case.machine)
    settings = replace(machine.controller, sample_time=1 / case.rate, delay=None)
    machine = replace(machine, controller=settings)
    point = OperatingPoint(case.speed if turning else 0.0, case.pressure)
    law = amb.design(replace(machine, tolerances=()), "pid")
    K = deployed_controller(assemble(machine, point), law, 1 / case.rate, 0)
    return machine, point, law, (K.A, K.B, K.C, K.D)


def fresh(case: Case, rng: np.random.Generator, spread: float = 0.03) -> dict[str, Any]:
    """The machine's numbers, each magnet, seal and the amplifier by a normal ``spread`` off."""
    m = copy.deepcopy(numbers_of(MACHINES / f"{case.machine}.toml", case.pressure))

    def off(shape: int | None = None) -> Any:
        return 1 + spread * np.clip(rng.standard_normal(shape), -2, 2)

    for bearing in m["bearings"]:
        bearing["ki"], bearing["ks"] = bearing["ki"] * off(2), bearing["ks"] * off(2)
    for seal in m["seals"]:
        seal.update({key: seal[key] * off() for key in "KkCc"})
    for key, value in m["amplifier"].items():
        m["amplifier"][key] = value if key == "order" else value * off()
    return m


def mass_of(m: dict[str, Any]) -> float:
    """The rotor's mass [kg]."""
    shaft = sum(
        r["density"] * r["length"] * np.pi / 4 * (r["mass"] ** 2 - r["inner"] ** 2)
        for r in m["shaft"]
    )
    return float(shaft + sum(disc["mass"] for disc in m["discs"]))


def unbalanced(m: dict[str, Any], speed: float, rng: np.random.Generator) -> dict[float, complex]:
    """A balance grade of 2.5 mm/s at a speed [rad/s], parted among the bearings at any angle."""
    share = 2.5e-3 * mass_of(m) / speed / len(m["bearings"])
    angles = np.exp(2j * np.pi * rng.random(len(m["bearings"])))
    return {b["at"]: complex(share * u) for b, u in zip(m["bearings"], angles, strict=True)}


def as_record(case: Case, rig: Rig, found: dict[str, np.ndarray], kinds: str = "yue") -> Record:
    """The signals of some kinds, with the operating point as it is."""
    names = [f"{kind}_{axis}" for kind in kinds for axis in rig.axes]
    units = [{"y": "m"}.get(kind, "A") for kind in kinds for _ in rig.axes]
    point = OperatingPoint(rig.speed, case.pressure)
    values = np.vstack([found[kind] for kind in kinds])
    return Record(case.machine, case.rate, tuple(names), tuple(units), values, point)


def excited(
    case: Case, rig: Rig, seconds: float, share: float, hold: float, seed: int
) -> np.ndarray:
    """Binary sequences of a share of the largest current, each value held for ``hold`` [s]."""
    limit = min(bearing["limit"] for bearing in rig.numbers["bearings"])
    count, length = round(seconds * case.rate), max(round(hold * case.rate), 1)
    return binary(len(rig.axes), count, share * limit, length, np.random.default_rng(seed))


def resumed(
    path: Path, wanted: Iterable[dict[str, Any]], run: Callable[..., dict[str, Any]]
) -> None:
    """A row of ``run(**key)`` for every key, appended to a file of JSON lines; those in it stay."""
    lines = path.read_text().splitlines() if path.exists() else []
    done = {json.dumps(json.loads(line)["key"], sort_keys=True) for line in lines}
    for key in wanted:
        if json.dumps(key, sort_keys=True) in done:
            continue
        with path.open("a") as file:
            file.write(json.dumps({"key": key, **run(**key)}) + "\n")
