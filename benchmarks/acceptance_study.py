"""Acceptance on the virtual rig: is the true sensitivity within its measured 95 % interval, at
standstill and running?

python -m benchmarks.acceptance_study [--runs 100]     minutes; every run another noise of the sensors
"""

import argparse
import sys
from dataclasses import replace

import numpy as np

import ambrose as amb
from ambrose.annexes.site.acceptance import accept
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.validation.places import machine_at_load
from ambrose.law.loop import Timing, running_law, timing_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.part import Runout
from ambrose.model.assemble import assemble
from ambrose.model.plant import top_speed
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.rig.scenario import Unbalance, load_scenario

CASES = (  # machine, share of the top speed, balance grade [m/s]
    ("seal-rig", 0.0, 0.0),
    ("seal-rig", 50.0, 2.5e-3),  # a speed of its own [Hz]: the file has none
    ("overhung-blower", 0.0, 0.0),
    ("overhung-blower", 1.0, 2.5e-3),
    ("three-bearing-train", 1.0, 2.5e-3),
    ("turbomolecular-pump", 1.0, 2.5e-3),
)
MODES = 3


def setting(name, share, grade):
    machine = amb.load_machine(name)
    noisy = tuple(
        replace(s, noise=s.noise or 1e-7, runout=(Runout(1, 1e-6, 0.3),)) for s in machine.sensors
    )
    machine = replace(machine, sensors=noisy, tolerances=())
    top = top_speed(machine)
    speed = share * top if top else 2 * np.pi * share
    nominal = machine.operation.design
    point = OperatingPoint(
        speed, nominal.seal_pressure, nominal.bias_current, nominal.whirl_frequency, ""
    )
    balanced = machine.requirements.balance_speed or top
    ports = [bearing.name for bearing in machine.bearings]
    heavy = tuple(
        Unbalance(port, grade=grade, grade_speed=balanced, share=1 / len(ports), phase=float(i))
        for i, port in enumerate(ports)
    )
    scenario = replace(
        load_scenario("acceptance"), speed=speed, unbalances=heavy if grade and speed else ()
    )
    return machine, amb.design(machine, "pid"), point, scenario


def truth(machine, law, record, omega):
    """S_o (w, a, a) of the rig's modes and magnets at their static load, sampled, by the model's
    own matrices.
    """
    plant = free_mode_reduction(assemble(machine_at_load(machine, [record]), record.point), MODES)
    timing = timing_of(machine, law) or Timing(record.dt)
    K = frequency_response(running_law(law.law, plant, timing), omega).values
    G = frequency_response(
        c2d(select(plant.system, plant.named("u"), plant.named("y")), timing.sample_time), omega
    ).values
    return np.linalg.inv(np.eye(len(plant.axes)) + G @ K)


def study(runs):
    for name, share, grade in CASES:
        machine, law, point, scenario = setting(name, share, grade)
        line = []
        sigma = []
        peak = []
        wide = []
        peaks = []
        for seed in range(runs):
            trace = amb.simulate(
                machine, law, scenario, point=point, seed=seed, bending_modes=MODES
            )
            if trace.outcome != "completed":
                print(name, trace.text)
                break
            loop = accept(machine, law, trace.record).points[0]
            S = truth(machine, law, trace.record, loop.omega)
            own, largest = np.abs(np.einsum("wii->wi", S)), np.linalg.norm(S, 2, axis=(1, 2))
            line.append(np.mean(np.abs(loop.modulus - own) <= loop.half))
            sigma.append(np.mean((largest >= loop.low) & (largest <= loop.high)))
            at, limits = loop.modulus.argmax(axis=0), loop.peaks
            peak.append(
                np.mean(
                    [
                        low <= top <= high
                        for top, (low, high) in zip(own.max(axis=0), limits, strict=True)
                    ]
                )
            )
            wide.append(np.array([loop.half[k, i] for i, k in enumerate(at)]).max())
            peaks.append(own.max())
        if line:
            speed = f"{point.speed / 2 / np.pi:.0f} Hz" if point.speed else "standstill"
            print(
                f"{name:22s} {speed:11s} runs {len(line):3d} | lines {100 * np.mean(line):5.1f} %,"
                f" sigma max {100 * np.mean(sigma):5.1f} %, peak of an axis "
                f"{100 * np.mean(peak):5.1f} % |"
                f" largest peak {np.mean(peaks):.3f}, half-width there {np.mean(wide):.3f}"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    study(parser.parse_args().runs)
