"""Calibration on the virtual rig: what the file does not know of sensors and centres, by standard
tests.

python -m benchmarks.calibration_study [MACHINE ...]
"""

import argparse
from dataclasses import replace

import numpy as np

import ambrose as amb
from ambrose.annexes.site.calibration import calibrate
from ambrose.core.statespace import static_gain
from ambrose.machine.part import Runout
from ambrose.model.plant import top_speed
from ambrose.rig.scenario import Scenario, Sine

MACHINES = ("overhung-blower", "flywheel", "turbomolecular-pump", "nelson-mcvaugh-rotor")
GAIN = (1.04, 0.97)
OFFSET = (12e-6, -8e-6)
CENTRE = (6e-6, -4e-6)
PROFILE = (Runout(1, 3e-6, 0.7), Runout(2, 1e-6, -1.0), Runout(3, 0.4e-6, 2.0))


def true_machine(told):
    sensors = tuple(
        replace(s, gain=GAIN, offset=OFFSET, runout=PROFILE, noise=s.noise or 1e-7)
        for s in told.sensors
    )
    bearings = tuple(replace(b, magnetic_offset=CENTRE) for b in told.bearings)
    return replace(told, sensors=sensors, bearings=bearings, tolerances=())


def circle(machine, share=0.9):
    """Three times around in the touchdown bearings, by currents that turn in two seconds, the last
    time weaker; no control.
    """
    a = len(machine.axes)
    law = static_gain(
        np.zeros((a, a)),
        [f"err_{x}" for x in machine.axes],
        [f"u_{x}" for x in machine.axes],
        dt=1e-4,
    )
    sines = []
    for bearing in machine.bearings:
        for way, axis in enumerate(("zeta", "eta")):
            phase = np.pi / 2 - bearing.angle - way * np.pi / 2
            name = f"e_{bearing.name}_{axis}"
            sines += [
                Sine(name, share * bearing.max_current, np.pi, phase),
                Sine(name, -share * bearing.max_current / 3, np.pi, phase, 4.0),
            ]
    scenario = Scenario(
        "circle", 6.0, sines=tuple(sines), initial="resting", sample_time=1e-4, speed=0.0
    )
    return amb.simulate(machine, law, scenario, bending_modes=0)


def study(name):
    told = amb.load_machine(name)
    machine = true_machine(told)
    law = amb.design(replace(told, tolerances=()), "pid")
    rolling = Scenario("roll", 10.0, speed=max(0.05 * top_speed(told), 2 * np.pi * 3))
    tests = {
        "circle": circle(machine),
        "slow_roll": amb.simulate(machine, law, rolling),
        "levitated": amb.simulate(machine, law, Scenario("still", 3.0, speed=0.0)),
    }
    print(name, {key: trace.text[:60] for key, trace in tests.items()})
    tests["slow_roll"] = replace(
        tests["slow_roll"], record=tests["slow_roll"].record.between(4.0, 10.0)
    )
    found = calibrate(told, settle=1.5, **{key: trace.record for key, trace in tests.items()})
    truth = {
        "gain zeta": GAIN[0],
        "gain eta": GAIN[1],
        "offset zeta": OFFSET[0],
        "offset eta": OFFSET[1],
        "run-out 1x": 3e-6,
        "run-out 2x": 1e-6,
        "run-out 3x": 0.4e-6,
        "magnetic_offset zeta": CENTRE[0],
        "magnetic_offset eta": CENTRE[1],
    }
    inside = 0
    for row in found.entries:
        true = next(value for key, value in truth.items() if row.name.endswith(f" {key}"))
        inside += abs(row.value - true) <= row.half
        factor = 1e6 if row.unit == "m" else 1
        print(
            f"  {row.name:45s} {factor * row.value:9.4f} +- {factor * row.half:7.4f}, true "
            f"{factor * true:8.4f}"
        )
    print(f"  {inside} of {len(found.entries)} inside", found.notes)
    back = calibrate(
        replace(
            told,
            bearings=tuple(replace(b, touchdown_gap=None) for b in told.bearings),
            sensors=tuple(replace(s, gain=GAIN) for s in told.sensors),
        ),
        circle=tests["circle"].record,
        find="clearance",
        settle=1.5,
    )
    gaps = [row for row in back.entries if row.name.endswith("touchdown_gap")]
    for row, bearing in zip(gaps, told.bearings, strict=True):
        print(
            f"  {row.name:45s} {1e6 * row.value:9.3f} +- {1e6 * row.half:7.3f}, true "
            f"{1e6 * bearing.touchdown_gap:8.3f}"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("machines", nargs="*", default=list(MACHINES))
    for one in parser.parse_args().machines:
        study(one)
