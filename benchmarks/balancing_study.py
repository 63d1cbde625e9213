"""Balancing in one step on the virtual rig: how far 1x falls, with and without trial weights, and
what was predicted.

python -m benchmarks.balancing_study [MACHINE ...]     some machines, noise and run-out of the sensors on: minutes
"""

import argparse
import sys
from dataclasses import replace

import numpy as np

import ambrose as amb
from ambrose.annexes.site.balancing import balance, once_per_turn, revolution
from ambrose.machine.part import Runout
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.plant import top_speed
from ambrose.rig.scenario import Scenario, Unbalance

CASES = {  # planes; shares of the balancing speed, the first of them slow roll
    "turbomolecular-pump": (("bell", "fore-vacuum"), (0.05, 0.6, 1.0)),
    "overhung-blower": (("impeller", "free-end"), (0.05, 0.6, 1.0)),
    "lalanne-ferraris-rotor": (("D1", "D3"), (0.1, 0.6, 1.0)),
    "three-bearing-train": (("impeller-1", "impeller-3", "DE"), (0.1, 0.6, 1.0)),
    "vertical-pump": (("upper", "lower"), (0.2, 0.6, 1.0)),
}
RUNOUT = 3e-6
RADIUS = 0.05
GRADE = 6.3e-3
DURATION = 3.0
SETTLE = 1.5
WRONG = 1.1  # K_i of the rig over that of the machine file, in the second part


def with_runout(machine):
    runout = (Runout(1, RUNOUT, 0.7), Runout(2, RUNOUT / 3, 0.2))
    return replace(
        machine,
        sensors=tuple(
            replace(item, noise=item.noise or 1e-7, runout=runout) for item in machine.sensors
        ),
    )


def run(machine, speed, unbalance, seed):
    """A record of the rig at a speed [rad/s]: unbalance (p,) [kg m] by plane, at angles from the
    key mark.
    """
    first = {bearing.name: bearing.angle for bearing in machine.bearings}
    items = [
        Unbalance(name, amount=abs(u), phase=float(np.angle(u) - first.get(name, 0.0)))
        for name, u in unbalance.items()
        if u
    ]
    scenario = Scenario(
        "run", duration=DURATION + 20 * np.pi / speed, unbalances=tuple(items), speed=float(speed)
    )
    law = amb.design(replace(machine, tolerances=()), "pid")
    return amb.simulate(machine, law, scenario, seed=seed, bending_modes=2), law


def size(record, kind, machine):
    """Root mean square of the 1x of displacements of one kind over the bearings [m]."""
    names = tuple(f"{kind}_{axis}" for axis in machine.axes)
    return float(
        np.linalg.norm(once_per_turn(record, revolution(record, SETTLE), names, SETTLE).mean)
    )


def study(name, seed=0):
    told = amb.load_machine(name)
    names, shares = CASES[name]
    rng = np.random.default_rng(seed)
    top = told.requirements.balance_speed or top_speed(told)
    mass = mass_properties(finite_element_rotor(told)).mass
    U = {
        p: GRADE
        * mass
        / top
        / len(names)
        * rng.uniform(0.5, 1)
        * np.exp(2j * np.pi * rng.uniform())
        for p in names
    }
    machine = with_runout(told)
    before = [run(machine, share * top, U, seed + i)[0] for i, share in enumerate(shares)]
    if any(trace.outcome != "completed" for trace in before):
        print(name, [trace.text for trace in before])
        return
    records = [trace.record for trace in before]
    law = amb.design(replace(machine, tolerances=()), "pid")
    weight = 0.3 * max(abs(u) for u in U.values())
    trials = [
        (run(machine, top, {**U, p: U[p] + weight}, seed + 10 + i)[0].record, {p: weight})
        for i, p in enumerate(names)
    ]
    for label, planes_radii, options in (
        ("model", dict.fromkeys(names, RADIUS), {}),
        (
            "model, one speed, run-out in the file",
            dict.fromkeys(names, RADIUS),
            {"only": -1, "file": machine},
        ),
        ("model, one speed, run-out unknown", dict.fromkeys(names, RADIUS), {"only": -1}),
        ("trial weights", dict.fromkeys(names, RADIUS), {"trials": trials}),
    ):
        only, file = options.pop("only", None), options.pop("file", told)
        used = records if only is None else [records[only]]
        result = balance(file, used, planes_radii, controller=law, settle=SETTLE, **options)
        after = run(
            machine,
            top,
            {p: U[p] + c for p, c in zip(names, result.correction, strict=True)},
            seed + 99,
        )[0].record
        rolled = run(machine, top, {}, seed + 98)[0].record
        change = {
            kind: 1 - size(after, kind, machine) / size(records[-1], kind, machine) for kind in "yq"
        }
        axes = tuple(f"y_{axis}" for axis in machine.axes)
        vectors = [
            once_per_turn(r, revolution(r, SETTLE), axes, SETTLE).mean
            for r in (records[-1], after, rolled)
        ]
        pure = 1 - np.linalg.norm(vectors[1] - vectors[2]) / np.linalg.norm(vectors[0] - vectors[2])
        wanted = np.array([U[p] for p in names])
        off = np.linalg.norm(wanted + result.correction) / np.linalg.norm(wanted)
        inside = int(np.sum(np.abs(wanted + result.correction) <= result.uncertainty))
        print(
            f"{name:22s} {label:36s} falls by {100 * pure:5.1f} %, with run-out y "
            f"{100 * change['y']:6.1f} %,"
            f" q {100 * change['q']:6.1f} %;"
            f" left at most {100 * result.remaining:5.1f} %; U off {100 * off:5.1f} %, {inside} "
            f"of {len(names)} inside;"
            f" condition {result.condition:.2g}, error {100 * result.model_error:.2g} %"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machines", nargs="*", default=list(CASES))
    for one in parser.parse_args().machines:
        study(one)
