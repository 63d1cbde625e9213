"""Coverage and width of the seal monitor's intervals on the nonlinear rig: seal-rig, PID, 10 kHz,
100 nm of noise.

python -m benchmarks.monitor_study [--runs 200] [--case TEXT]           minutes; one row per case

In every run all that the monitor takes as known is drawn anew: k_i of every axis within 3 % and the
amplifier's frequency within 5 %, uniformly; other noise, another excitation, another unbalance's
angle.
"""

import argparse
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import ambrose as amb
from ambrose.annexes.scheduled.seal_watch import monitor
from ambrose.judge.result import pid_synthesis
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Prbs, PressureChange, Scenario, Unbalance

TIMES = (0.1, 0.5, 2.0)  # [s] after the filters have settled
SPEED, BALANCED = 2 * np.pi * 50, 2 * np.pi * 500


@dataclass(frozen=True)
class Case:
    amplitude: float = 0.02  # [A]
    share: float = 1.0  # of the nominal pressure
    speed: float = 0.0
    gas: float = 0.0  # [N], binary noise of 0.8 ms per bit on the seal, x and y
    known: str = "drawn"  # or "high", all at their upper end, or "exact"
    unknown: str = "pressure"
    ramp: float = 0.0  # [nominal/s]
    rate: float = 0.01
    modes: int = 1  # of the monitor; the rig has 3


CASES = {
    "0.02 A, standstill": Case(),
    "0.02 A, standstill, no pressure": Case(share=0.0),
    "0.02 A, standstill, 1.2 times nominal": Case(share=1.2),
    "0.02 A, standstill, monitor with 3 modes": Case(modes=3),
    "0.05 A, standstill": Case(amplitude=0.05),
    "0.02 A, 50 Hz, G2.5": Case(speed=SPEED),
    "0.02 A, standstill, gas force 5 N": Case(gas=5.0),
    "0.05 A, 50 Hz, G2.5, gas force 5 N": Case(amplitude=0.05, gas=5.0, speed=SPEED),
    "0.02 A, standstill, all k_i +3 %": Case(known="high"),
    "0.02 A, standstill, rising by 0.1/s, told": Case(share=0.7, ramp=0.1, rate=0.1),
    "0.02 A, standstill, k and C": Case(unknown="k,C"),
}


@cache
def setting():
    machine = amb.load_machine("seal-rig")
    machine = replace(machine, sensors=tuple(replace(item, noise=1e-7) for item in machine.sensors))
    return machine, pid_synthesis(free_mode_reduction(assemble(machine), 3)).controller


def truth(machine, known, rng):
    """The machine that runs: what the monitor takes as known is a little different."""
    if known == "exact":
        return machine
    draw = (lambda: rng.uniform(-1, 1)) if known == "drawn" else (lambda: 1.0)
    bearings = tuple(
        replace(b, force_per_current=tuple(k * (1 + 0.03 * draw()) for k in b.force_per_current))
        for b in machine.bearings
    )
    lag = machine.amplifier.natural_frequency * (1 + 0.05 * (draw() if known == "drawn" else 0.0))
    return replace(
        machine, bearings=bearings, amplifier=replace(machine.amplifier, natural_frequency=lag)
    )


def run(case, seed):
    """Errors and half widths at TIMES, and the share of all times that the interval holds; in units
    of the reference.
    """
    machine, law = setting()
    rng = np.random.default_rng(seed)
    nominal = machine.operation.nominal
    duration = 0.8 * bool(case.speed) + 0.45 + TIMES[-1] + 0.05
    driven = [f"e_{axis}" for axis in machine.axes]
    sequences = [Prbs(name, case.amplitude, 1e-3, 9, int(rng.integers(1, 500))) for name in driven]
    gas = [
        Prbs(f"f_center_{axis}", case.gas, 8e-4, 14, int(rng.integers(1, 16000))) for axis in "xy"
    ]
    wheel = Unbalance("center", grade=2.5e-3, grade_speed=BALANCED, phase=float(rng.uniform(0, 6)))
    change = PressureChange(
        0.0, nominal.seal_pressure * (case.share + case.ramp * duration), duration - 1e-3
    )
    scenario = Scenario(
        "watched",
        duration,
        sequences=tuple(sequences + gas * bool(case.gas)),
        speed=case.speed,
        unbalances=(wheel,) if case.speed else (),
        pressures=(change,) if case.ramp else (),
    )
    point = replace(
        nominal, speed=case.speed, seal_pressure=case.share * nominal.seal_pressure, label=""
    )
    record = virtual_rig.run(
        truth(machine, case.known, rng), law, scenario, point=point, seed=seed
    ).record
    told = replace(record, point=point)
    found = monitor(
        machine,
        law,
        told,
        unknown=case.unknown.split(","),
        rate=case.rate,
        bending_modes=case.modes,
    )
    true = case.share + case.ramp * (found.time - record.start_time)
    errors = found.values / found.reference - true[:, None]
    widths = found.half_widths / found.reference
    at = [int(np.argmin(np.abs(found.time - found.settling - t - 1e-9))) for t in TIMES]
    said = found.known_at
    return errors[at], widths[at], (np.abs(errors) <= widths)[said].mean(axis=0)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--case", default="")
    arguments = parser.parse_args()
    print(
        "| case | +- after 0.1 / 0.5 / 2 s | scatter (2 sd) | held | held at all times "
        "|\n|---|---|---|---|---|"
    )
    for title in [title for title in CASES if arguments.case in title]:
        found = [run(CASES[title], seed) for seed in range(arguments.runs)]
        errors, widths, always = (np.array([row[i] for row in found]) for i in range(3))
        for j, name in enumerate(CASES[title].unknown.split(",")):
            e, w = errors[..., j], widths[..., j]
            held = np.abs(e) <= w
            said = np.isfinite(w)
            show = [
                " / ".join(f"{x:.3f}" for x in np.nanmedian(w, axis=0)),
                " / ".join(f"{x:.3f}" for x in 2 * np.nanstd(e, axis=0)),
                " / ".join(f"{100 * h[s].mean():.1f}" for h, s in zip(held.T, said.T, strict=True)),
            ]
            print(
                f"| {title}: {name} | {show[0]} | {show[1]} | {show[2]} % | "
                f"{100 * always[:, j].mean():.1f} % |",
                flush=True,
            )


if __name__ == "__main__":
    main()
