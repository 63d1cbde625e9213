"""What a current loop with resistance, inductance and back-EMF does to every bundled machine.

    python -m benchmarks.current_loop [--machine turboexpander ...]

The amplifier of the file against a "current-loop" of the same bandwidth (order "second": its
natural frequency): coil inductance as stated, else k_i^2/(2 k_s), the coil without leakage;
resistance such that L/R is 30 ms (assumed). Fastest unstable pole of the plant; with the
reference PID of the machine file, continuous: peak output sensitivity, and over all modes up to
twice the top speed that can ring the damping ratio that moved most.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose import load_machine
from ambrose.judge.nominal import check
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Amplifier
from ambrose.machine.file.toml import bundled_machines
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.static_load import magnet_coefficients

_TIME = 0.03  # [s] L/R of a coil, assumed
_PEAK = "sensitivity.output."  # and the axis
_RINGS = 0.7  # damping ratio below which a mode counts


@dataclass(frozen=True, slots=True)
class Row:
    """One machine: (as the file has it, as a current loop) of every figure."""

    machine: str
    inductance: float
    pole: tuple[float, float]
    sensitivity: tuple[float, float]
    mode: float
    damping: tuple[float, float]


def as_current_loop(machine: Machine) -> Machine:
    """The machine with the circuit in place of its amplifier's lag."""
    given = machine.amplifier
    k_i, k_s = magnet_coefficients(machine, machine.operation.nominal)
    inductance = given.inductance or float(np.median(k_i**2 / (2 * k_s)))
    drive = Amplifier(
        "current-loop",
        bandwidth=given.bandwidth or given.natural_frequency,
        max_voltage=given.max_voltage,
        inductance=inductance,
        resistance=inductance / _TIME,
    )
    return replace(machine, amplifier=drive)


def as_first_order(machine: Machine) -> Machine:
    """The machine with a first-order lag of that bandwidth: what the current loop is at
    standstill.
    """
    given = machine.amplifier
    drive = Amplifier("first", bandwidth=given.bandwidth or given.natural_frequency)
    return replace(machine, amplifier=drive)


def compare(name: str) -> Row:
    """One bundled machine at its nominal operating point."""
    machine = load_machine(name)
    sides = as_first_order(machine), as_current_loop(machine)
    K = pid_controller(machine.reference, machine)
    unstable, peaks, modes = [], [], []
    for side in sides:
        plant = assemble(side)
        unstable.append(max(0.0, float(np.linalg.eigvals(plant.system.A).real.max())))
        rows = [c.value for c in check(plant, K).checks if c.name.startswith(_PEAK)]
        peaks.append(max(map(float, rows)))
        poles = np.linalg.eigvals(closed_loop(plant, K).A)
        modes.append(poles[poles.imag > 1.0])
    top = 2 * max(point.speed for point in machine.operation.envelope)
    counted = [p for p in modes[0] if -p.real < _RINGS * abs(p) and abs(p) < max(top, 2000.0)]
    moved = []
    for pole in counted:
        other = modes[1][np.argmin(abs(modes[1] - pole))]
        moved.append((pole, -pole.real / abs(pole), -other.real / abs(other)))
    pole, before, after = max(moved, key=lambda item: abs(item[2] / item[1] - 1))
    return Row(
        name,
        float(sides[1].amplifier.inductance or 0.0),
        (unstable[0], unstable[1]),
        (peaks[0], peaks[1]),
        float(abs(pole)),
        (before, after),
    )


def main(arguments: Sequence[str] | None = None) -> list[Row]:
    """Prints the table, a row per machine; returns the rows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.current_loop")
    parser.add_argument("--machine", nargs="*", help="default: every bundled one")
    names = parser.parse_args(arguments).machine or bundled_machines()
    print("| machine | L [mH] | unstable pole [1/s] | peak S_o | mode [rad/s]: damping ratio |")
    print("|---|---|---|---|---|")
    rows = []
    for name in names:
        row = compare(name)
        rows.append(row)
        print(
            f"| {name} | {1e3 * row.inductance:.3g} | {row.pole[0]:.4g} to {row.pole[1]:.4g} | "
            f"{row.sensitivity[0]:.3g} to {row.sensitivity[1]:.3g} | {row.mode:.4g}: "
            f"{row.damping[0]:.3g} to {row.damping[1]:.3g} |",
            flush=True,
        )
    return rows


if __name__ == "__main__":
    main()
