"""A controller scheduled over seal pressure against the tuned fixed one, both sampled at 10 kHz,
one sample late, full plants.

    python -m benchmarks.pressure_schedule [--machine seal-rig] [--factors 1 3]      a minute

Largest sigma_max(S_o) at nine pressures from zero to twice the nominal one that stand still: as
they are, read wrong by a part of the nominal pressure either way (clipped to the range, as the code
does), and with the reading stuck anywhere. Gain: mean of the direct gains below 200 Hz at the
nominal pressure against the tuned controller's. Surge, on the virtual rig: zero to twice the
nominal pressure in 0.1 s, in its middle 100 N for 2 ms at the seal; largest measured motion and how
long after the knock it stays beyond a tenth of it, where the magnets do not carry the rotor's
weight, and the largest motion where they do.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

import ambrose as amb
from ambrose.core.scheduled import ScheduledSystem
from ambrose.judge.result import certify
from ambrose.law.law import law_of
from ambrose.law.loop import Timing
from ambrose.rig.scenario import PressureChange, Pulse, Scenario
from ambrose.synthesis.hinf import direct_gain_mismatch

TIMING = Timing(1e-4, 1)
# of twice the nominal; of the nominal, the last one: stuck anywhere
PRESSURES, WRONG = 9, (0.0, 0.2, 0.4, 2.0)


def peak(plant, law, told):
    """sigma_max(S_o) as the loop runs, the law at a told pressure; inf where it is unstable."""
    return certify(
        plant, TIMING.in_loop(law_of(law).at(replace(plant.point, seal_pressure=told))), False
    ).closed_loop_norm


def misread(plants, law, wrong):
    """The largest peak with a pressure told up to ``wrong`` [Pa] off; of a fixed law as it is."""
    if not isinstance(law, ScheduledSystem):
        return max(peak(plant, law, plant.point.seal_pressure) for plant in plants)
    low, high = law.range
    peaks = []
    for plant in plants:
        p = plant.point.seal_pressure
        for told in {min(max(p + sign * wrong, low), high) for sign in (-1, 1)}:
            peaks.append(peak(plant, law, told))
    return max(peaks)


def surge(machine, law, top):
    """Largest motion [m] and the time [s] after the knock until it stays within a tenth of it; inf:
    lost.
    """
    events = Scenario(
        "surge",
        0.5,
        pulses=(Pulse("f_center_x", 100.0, 0.1, 2e-3),),
        pressures=(PressureChange(0.05, top, 0.1),),
        sample_time=TIMING.sample_time,
    )
    zero = next(point for point in machine.operation.points if point.seal_pressure == 0)
    trace = amb.simulate(machine, law, events, point=zero)
    if trace.outcome != "completed":
        return np.inf, np.inf
    y = np.abs(np.array([trace.record[f"y_{axis}"] for axis in machine.axes]))
    late = np.flatnonzero((y > 0.1 * y.max()).any(axis=0))
    return float(y.max()), float(late[-1] * TIMING.sample_time - 0.1)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machine", default="seal-rig")
    parser.add_argument(
        "--factors",
        type=float,
        nargs="*",
        default=[1.0, 3.0],
        help="of the control weight, a design each",
    )
    given = parser.parse_args()
    machine, begun = amb.load_machine(given.machine), time.process_time()
    nominal = machine.operation.nominal.seal_pressure
    tuned = amb.design(machine, rate=1 / TIMING.sample_time, order=12)
    laws = {f"tuned, {tuned.controller.n_states} states": tuned.controller}
    for factor in given.factors:
        weights = machine.weights
        other = (
            replace(weights, control_level=weights.control_level * factor)
            if factor != 1.0
            else weights
        )
        design = amb.design(
            replace(machine, weights=other),
            "lpv",
            pressures=(0.0, 2 * nominal),
            rate=1 / TIMING.sample_time,
        )
        name = f"over pressure, {design.controller.n_states} states" + (
            f", control weight x {factor:g}" if factor != 1 else ""
        )
        laws[name] = design.scheduled
    plants = [
        amb.assemble(machine, replace(machine.operation.nominal, seal_pressure=float(p)))
        for p in np.linspace(0.0, 2 * nominal, PRESSURES)
    ]
    weightless, heads = (
        replace(machine, gravity_direction=None),
        ("controller", "at rest", "read 0.2 off", "0.4 off", "stuck"),
    )
    print(f"| {' | '.join((*heads, 'gain', 'surge', 'with weight'))} |\n{'|---' * 8}|")
    for name, law in laws.items():
        cells = [f"{misread(plants, law, wrong * nominal):.3g}" for wrong in WRONG]
        gain = direct_gain_mismatch(law_of(law).at(machine.operation.nominal), tuned.controller)[0]
        (size, settled), (loaded, _) = (
            surge(item, law, 2 * nominal) for item in (weightless, machine)
        )
        runs = f"{1e6 * size:.3g} um, {1e3 * settled:.3g} ms | {1e6 * loaded:.3g} um"
        print(
            f"| {name} | {' | '.join(cells)} | {100 * np.expm1(gain):+.0f} % | {runs} |", flush=True
        )
    print(f"{machine.name}; processor time {time.process_time() - begun:.0f} s")


if __name__ == "__main__":
    main()
