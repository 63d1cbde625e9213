"""Faults of the pressure sensor under a controller scheduled over pressure, with and without a
fixed one to fall back to.

    python -m benchmarks.supervision [--machine seal-rig] [--part faults|monitor|alone]     three minutes of one thread

faults: virtual rig at 10 kHz with the rotor's weight: 0 to twice the nominal pressure in 0.1 s, 100
N for 2 ms at the seal 50 ms later; "stuck" goes up, freezes there and is vented. Largest measured
motion over 0.4 s; the compiled C code of the same two controllers in the loop, and how far it is
from its twin in Python (largest difference of displacements and currents, of the largest). Then
what changes the controllers how: with the one that waits as an observer of the currents or running
free, with and without the difference faded out. monitor: 0.02 A of excitation on every axis, 100 nm
of noise, 100 N for 2 ms at the seal near the end; from 1 s on a fault or a force at the seal; the
seal monitor beside the reading. alone: its estimate in place of a reading while the pressure rises.
"""

import argparse
import math
import time
from dataclasses import replace

import numpy as np

import ambrose as amb
from ambrose.annexes.scheduled.seal_watch import watched
from ambrose.code.block.block import build_block
from ambrose.code.block.scheduled import build_scheduled_block, supervise, supervised_twin
from ambrose.code.c.compiled import CompiledSchedule, has_compiler
from ambrose.code.pipeline import machine_limits
from ambrose.code.sampled import deploy, deploy_scheduled
from ambrose.law.supervision import Limits, supervised
from ambrose.rig.scenario import Prbs, PressureChange, PressureSensor, Pulse, Scenario

DT = 1e-4


def trace_of(machine, law, events, point):
    return amb.simulate(machine, law, events, point=point, rate=1 / DT, delay_samples=1)


def largest(machine, trace, kind):
    return np.abs([trace.record[f"{kind}_{axis}"] for axis in machine.axes]).max()


def cell(machine, trace):
    """Largest motion [um], or that the rotor is lost."""
    return (
        f"{1e6 * largest(machine, trace, 'y'):.1f} um" if trace.outcome == "completed" else "lost"
    )


def code_cell(machine, block, events, point):
    """The C code in the loop, and how far it is from its twin."""
    if not has_compiler():
        return "no compiler"
    code, twin = (
        trace_of(machine, law, events, point)
        for law in (CompiledSchedule(block), supervised_twin(block))
    )
    apart = 0.0
    for kind in "yu":
        differ = [
            np.abs(code.record[f"{kind}_{axis}"] - twin.record[f"{kind}_{axis}"]).max()
            for axis in machine.axes
        ]
        apart = max(apart, max(differ) / largest(machine, twin, kind))
    return f"{cell(machine, code)}, {apart:.0e} apart"


def show_faults(machine, schedule, fixed, limits):
    nominal, weight = (
        machine.operation.nominal.seal_pressure,
        (Pulse("f_center_x", 100.0, 0.2, 2e-3),),
    )
    zero = next(point for point in machine.operation.points if point.seal_pressure == 0)
    surge, vent = (
        (PressureChange(0.05, 2 * nominal, 0.1),),
        (PressureChange(0.02, 2 * nominal, 0.03), PressureChange(0.1, 0.0, 0.05)),
    )
    lost = PressureSensor(0.1, fault="lost")
    faults = {
        "none": (surge, ()),
        "lost in the surge": (surge, (lost,)),
        "lost, back after 50 ms": (surge, (lost, PressureSensor(0.15))),
        "stuck at twice, then vented": (
            vent,
            (PressureSensor(noise=100.0), PressureSensor(0.08, fault="stuck")),
        ),
        "falls to zero": (surge, (PressureSensor(0.17, gain=0.0),)),
        "0.5 of nominal off": (surge, (PressureSensor(0.1, offset=0.5 * nominal),)),
        "late by 0.1 s": (surge, (PressureSensor(lag=0.1),)),
    }
    parts = (
        build_scheduled_block(
            deploy_scheduled(schedule, DT, DT, force=True), "rig", *machine_limits(machine)
        ),
        build_block(deploy(fixed, DT, DT, force=True), "rig", *machine_limits(machine)),
    )
    print(
        "| sensor | fixed alone | schedule alone | supervised | C code | what it did "
        "|\n|---|---|---|---|---|---|"
    )
    for name, (pressures, sensors) in faults.items():
        events = Scenario(
            "fault",
            0.4,
            pulses=weight,
            pressures=pressures,
            pressure_sensors=sensors,
            sample_time=DT,
        )
        kept = replace(limits, stuck=0.01 if "stuck" in name else math.inf)
        program = supervised(schedule, fixed, machine, DT, kept)
        cells = [
            cell(machine, trace_of(machine, law, events, zero))
            for law in (fixed, schedule, program)
        ]
        cells.append(code_cell(machine, supervise(*parts, kept), events, zero))
        print(f"| {name} | {' | '.join(cells)} | {program.words()} |", flush=True)
    pressures, sensors = faults["lost, back after 50 ms"]
    events = Scenario(
        "change", 0.4, pulses=weight, pressures=pressures, pressure_sensors=sensors, sample_time=DT
    )
    for tracking in (True, False):
        for fade in (0.0, 0.02):
            program = supervised(
                schedule, fixed, machine, DT, replace(limits, fade=fade), tracking=tracking
            )
            moved = cell(machine, trace_of(machine, program, events, zero))
            print(
                f"| {'observer' if tracking else 'free'}, fade {1e3 * fade:g} ms | {moved} | "
                f"{program.words()} |",
                flush=True,
            )


def noisy(machine):
    """The machine with 100 nm of noise at every sensor, and an excitation of 0.02 A on every
    axis.
    """
    quiet = tuple(replace(item, noise=1e-7) for item in machine.sensors)
    return replace(machine, sensors=quiet), tuple(
        Prbs(f"e_{axis}", 0.02, 1e-3, 14, i % 2) for i, axis in enumerate(machine.axes)
    )


def show_monitor(machine, schedule, fixed, limits):
    machine, shaken = noisy(machine)
    nominal, here = machine.operation.nominal.seal_pressure, machine.operation.nominal
    zero, twice = (replace(here, seal_pressure=share * nominal, label="") for share in (0.0, 2.0))
    surge = (PressureChange(1.0, 2 * nominal, 0.1),)
    up = (PressureChange(1.0, 1.6 * nominal, 0.1),)
    vent = (PressureChange(1.0, 0.0, 0.1),)
    stuck = (PressureSensor(noise=100.0), PressureSensor(0.9, fault="stuck"))
    drift = tuple(
        PressureSensor(1.0 + 0.02 * i, offset=0.005 * (i + 1) * nominal) for i in range(200)
    )
    cases = {  # duration, where, pressures, sensors, forces
        "good, surge": (2.5, zero, surge, (), ()),
        "0.15 of nominal off": (2.5, here, (), (PressureSensor(1.0, offset=0.15 * nominal),), ()),
        "0.5 of nominal off": (2.5, here, (), (PressureSensor(1.0, offset=0.5 * nominal),), ()),
        "drifts by nominal in 4 s": (5.0, here, (), drift, ()),
        "late by 0.1 s, surge": (2.5, zero, surge, (PressureSensor(lag=0.1),), ()),
        "stuck at nominal, then up to 1.6": (2.5, here, up, stuck, ()),
        "stuck at nominal, then vented": (2.5, here, vent, stuck, ()),
        "stuck at twice, then vented": (2.5, twice, vent, stuck, ()),
        "good, 50 N at the seal from 1 s": (2.5, here, (), (), (Pulse("f_center_x", 50.0, 1.0),)),
        "good, 50 N for 0.1 s every 0.2 s": (
            2.5,
            here,
            (),
            (),
            (Pulse("f_center_x", 50.0, 1.0, 0.1, 0.2),),
        ),
    }
    print(
        "\n| sensor | fixed alone | schedule alone | supervised | with the monitor | what it did "
        "without, and with it |"
    )
    print("|---|---|---|---|---|---|")
    for name, (duration, point, pressures, sensors, forces) in cases.items():
        blow = Pulse("f_center_x", 100.0, duration - 0.2, 2e-3)
        events = Scenario(
            "watched",
            duration,
            pulses=(blow, *forces),
            sequences=shaken,
            pressures=pressures,
            pressure_sensors=sensors,
            sample_time=DT,
        )
        plain, inner = (supervised(schedule, fixed, machine, DT, limits) for _ in range(2))
        beside = watched(inner, machine, events, fixed, point, "beside")
        traces = [trace_of(machine, law, events, point) for law in (fixed, schedule, plain, beside)]
        did = f"{plain.words()} | {beside.words()}".replace(" | ", "; with it: ")
        print(
            f"| {name} | {' | '.join(cell(machine, trace) for trace in traces)} | {did} |",
            flush=True,
        )


def show_alone(machine, schedule, fixed, limits):
    machine, shaken = noisy(machine)
    nominal = machine.operation.nominal.seal_pressure
    start = replace(machine.operation.nominal, seal_pressure=0.5 * nominal, label="")
    print(
        "\n| nominal/s | told | motion | in charge | largest error | outside its interval | "
        "outside the band |"
    )
    print("|---|---|---|---|---|---|---|")
    for rate, told in (
        (0.0, 0.01),
        (0.05, 0.05),
        (0.1, 0.1),
        (0.2, 0.2),
        (0.5, 0.5),
        (0.5, 0.01),
        (10.0, 0.01),
    ):
        ramp = min(1.0 / rate, 5.0) if rate else 2.0
        pressures = (PressureChange(1.0, (0.5 + rate * ramp) * nominal, ramp),)
        events = Scenario(
            "alone", 1.9 + ramp, sequences=shaken, pressures=pressures, sample_time=DT
        )
        program = supervised(schedule, fixed, machine, DT, replace(limits, rate=math.inf))
        alone = watched(program, machine, events, fixed, start, "alone", told * nominal)
        trace = trace_of(machine, alone, events, start)
        true = np.array(trace.record["p_seal"])
        used = (
            np.array(
                [
                    (abs(v - true[min(k, len(true) - 1)]), h)
                    for k, v, h in alone.seen
                    if h <= limits.band
                ]
            )
            / nominal
        )
        charge, last = 0, (0, 0)
        for sample, state, _ in (*program.changes, (len(true), 0, 0)):
            charge += (sample - last[0]) * (last[1] in (0, 3))
            last = sample, state
        cells = (
            f"{cell(machine, trace)} | {100 * charge / len(true):.0f} % | {used[:, 0].max():.3f} | "
        )
        cells += (
            f"{100 * (used[:, 0] > used[:, 1]).mean():.1f} % | "
            f"{100 * (used[:, 0] > limits.band / nominal).mean():.1f} %"
        )
        print(f"| {rate:g} | {told:g} | {cells} |", flush=True)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machine", default="seal-rig")
    parser.add_argument("--part", choices=("faults", "monitor", "alone"))
    given = parser.parse_args()
    machine, begun = amb.load_machine(given.machine), time.process_time()
    nominal = machine.operation.nominal.seal_pressure
    fixed = amb.design(machine, rate=1 / DT, order=12).controller
    schedule = amb.design(machine, "lpv", pressures=(0.0, 2 * nominal), rate=1 / DT).scheduled
    limits = Limits(
        0.0,
        2 * nominal,
        0.05 * nominal,
        rate=40 * nominal,
        noise=1e3,
        band=0.2 * nominal,
        dwell=0.1,
        fade=0.02,
    )
    parts = {"faults": show_faults, "monitor": show_monitor, "alone": show_alone}
    for name, show in parts.items():
        if given.part in (None, name):
            show(machine, schedule, fixed, limits)
    print(f"{machine.name}; processor time {time.process_time() - begun:.0f} s")


if __name__ == "__main__":
    main()
