"""Faults of the pressure sensor under a controller scheduled over pressure, with and without a fixed one to fall back to.

    python -m benchmarks.supervision [--machine seal-rig]      20 s of processor time on one thread

Virtual rig at 10 kHz with the rotor's weight: 0 to twice the nominal pressure in 0.1 s, 100 N for 2 ms at the seal 50 ms later;
"stuck" goes up, freezes there and is vented. Largest measured motion and current over 0.4 s. Then what changes the controllers
how: with the one that waits as an observer of the currents or running free, with and without the difference faded out.
"""

import argparse
import math
import time
from dataclasses import replace

import numpy as np

import ambrose as amb
from ambrose.plant.supervision import Limits, SupervisedProgram, supervised
from ambrose.simulation.disturbances import PressureChange, PressureSensor, Pulse
from ambrose.simulation.scenario import Scenario

DT = 1e-4


def run(machine, law, events):
    """Cells: outcome, largest motion [um] and current [A], and what the supervision did."""
    zero = next(point for point in machine.operation.points if point.seal_pressure == 0)
    trace = amb.simulate(machine, law, events, point=zero, rate=1 / DT, delay_samples=1)
    y, u = (np.abs([trace.record[f"{kind}_{axis}"] for axis in machine.axes]).max() for kind in "yu")
    did = f" | {law.words()}" if isinstance(law, SupervisedProgram) else ""
    return f"{f'{1e6 * y:.1f} um, {u:.2f} A' if trace.outcome == 'completed' else 'lost'}{did}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="seal-rig")
    machine, begun = amb.load_machine(parser.parse_args().machine), time.process_time()
    nominal = machine.operation.nominal.seal_pressure
    fixed = amb.design(machine, rate=1 / DT, order=12).controller
    schedule = amb.design(machine, "lpv", pressures=(0.0, 2 * nominal), rate=1 / DT).scheduled
    surge, vent = (
        (PressureChange(0.05, 2 * nominal, 0.1),),
        (PressureChange(0.02, 2 * nominal, 0.03), PressureChange(0.1, 0.0, 0.05)),
    )
    lost = PressureSensor(0.1, fault="lost")
    faults = {
        "none": (surge, ()),
        "lost in the surge": (surge, (lost,)),
        "lost, back after 50 ms": (surge, (lost, PressureSensor(0.15))),
        "stuck at twice, then vented": (vent, (PressureSensor(noise=100.0), PressureSensor(0.08, fault="stuck"))),
        "falls to zero": (surge, (PressureSensor(0.17, gain=0.0),)),
        "0.5 of nominal off": (surge, (PressureSensor(0.1, offset=0.5 * nominal),)),
        "late by 0.1 s": (surge, (PressureSensor(lag=0.1),)),
    }
    limits = Limits(0.0, 2 * nominal, 0.05 * nominal, rate=40 * nominal, noise=1e3, band=0.2 * nominal, dwell=0.1, fade=0.02)
    weight = (Pulse("f_center_x", 100.0, 0.2, 2e-3),)
    print("| sensor | fixed alone | schedule alone | supervised | what it did |\n|---|---|---|---|---|")
    for name, (pressures, sensors) in faults.items():
        events = Scenario("fault", 0.4, pulses=weight, pressures=pressures, pressure_sensors=sensors, sample_time=DT)
        watched = replace(limits, stuck=0.01 if "stuck" in name else math.inf)
        laws = fixed, schedule, supervised(schedule, fixed, machine, DT, watched)
        print(f"| {name} | {' | '.join(run(machine, law, events) for law in laws)} |", flush=True)
    pressures, sensors = faults["lost, back after 50 ms"]
    events = Scenario("change", 0.4, pulses=weight, pressures=pressures, pressure_sensors=sensors, sample_time=DT)
    for tracking in (True, False):
        for fade in (0.0, 0.02):
            program = supervised(schedule, fixed, machine, DT, replace(limits, fade=fade), tracking=tracking)
            print(
                f"| {'observer' if tracking else 'free'}, fade {1e3 * fade:g} ms | {run(machine, program, events)} |",
                flush=True,
            )
    print(f"{machine.name}; processor time {time.process_time() - begun:.0f} s")


if __name__ == "__main__":
    main()
