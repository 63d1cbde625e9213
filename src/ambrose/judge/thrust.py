"""The magnets of the axis along the shaft against their process thrust: at rest, and while it
changes.

| check | what | unit |
|---|---|---|
| axial.capacity | process thrust over the largest static force against it | - |
| axial.current | static control current that holds it | A |
| axial.change.displacement_0p | largest motion while the thrust goes from end to end | m |
| axial.change.current_0p | largest control current on the way, the static one with it | A |
| axial.change.voltage_0p | slew: L di/dt of a coil on the way, L at rest if none is given | V |

The change is from the least to the largest thrust of all operating points within load_time, or
back; the loop is the linear one of the point. Rows of the change are absent where there is none.
"""

from __future__ import annotations

import numpy as np

from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.checks import Check, Curve
from ambrose.judge.criteria import information, judge
from ambrose.machine.axial import AxialMachine
from ambrose.machine.criteria import machine_limit
from ambrose.model.axial.magnet import Loaded, at_point, loaded, sides
from ambrose.model.plant import Plant

_STEP = 2e-5  # [s] of a continuous loop
_RECORD = 0.25  # [s] after the change


def thrust_checks(closed: StateSpace, plant: Plant) -> tuple[list[Check], list[Curve]]:
    """The checks and curves of this file's table; closed: ``law.loop.closed_loop``."""
    machine = plant.machine
    assert isinstance(machine, AxialMachine)
    part, at = machine.thrust, at_point(machine, plant.point)
    side = "right" if at.load < 0 else "left"
    largest = at.capacity[at.load < 0]
    checks = [
        judge(
            "axial.capacity",
            "Process thrust over static capacity",
            abs(at.load) / largest if largest > 0 else np.inf,
            "-",
            machine_limit(1.0, "the magnet's largest force at its place"),
            f"{abs(at.load):.4g} N, carried to the {side}, of {largest:.4g} N",
        ),
        judge(
            "axial.current",
            "Static control current",
            abs(at.current),
            "A",
            machine_limit(part.max_current, "max_current"),
            f"bias {part.bias_current[0]:g} and {part.bias_current[1]:g} A",
        ),
    ]
    loads = [item.load for item in machine.conditions] or [0.0]
    low, high = min(loads), max(loads)
    if high <= low:
        return checks, []
    time, moved, current = _change(closed, plant, high - low, part.load_time)
    return [*checks, *_change_checks(machine, at, (low, high), time, moved, current)], [
        Curve(
            f"axial.change.{name}",
            f"{title} while the thrust changes",
            "time",
            time,
            values[None],
            plant.axes,
            "s",
            unit,
        )
        for name, title, values, unit in (
            ("displacement", "Displacement", moved, "m"),
            ("current", "Control current", current, "A"),
        )
    ]


def _change(
    closed: StateSpace, plant: Plant, height: float, duration: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time [s], displacement [m] and change of the control current [A] (k,) while a force rises by
    so much [N] in so long [s].
    """
    (axis,) = plant.axes
    part = select(closed, [f"f_{axis}"], [f"q_{axis}", f"i_{axis}"])
    sampled = c2d(part, _STEP) if part.dt is None else part
    dt = sampled.dt or _STEP
    time = np.arange(int(np.ceil((_RECORD + duration) / dt))) * dt
    ramp = np.ones(len(time)) if duration <= 0 else np.clip((time + dt / 2) / duration, 0, 1)
    moved, current = simulate(sampled, height * ramp[None])
    return time, moved, current


def _change_checks(
    machine: AxialMachine,
    at: Loaded,
    ends: tuple[float, float],
    time: np.ndarray,
    moved: np.ndarray,
    change: np.ndarray,
) -> list[Check]:
    part, amplifier = machine.thrust, machine.amplifier
    words = f"{ends[0]:.4g} to {ends[1]:.4g} N " + (
        f"in {1e3 * part.load_time:g} ms" if part.load_time else "at once"
    )
    # from the static current of one end: up with the force, or down with its mirror image
    starts = [loaded(part, end, at.place).current for end in ends]
    peak = max(
        float(np.abs(start + way * change).max())
        for start, way in zip(starts, (1.0, -1.0), strict=True)
    )
    stops = part.touchdown_gap
    # the nearer stop
    left = None if stops is None else min(stops[0] + at.place, stops[1] - at.place)
    slope = float(np.abs(np.diff(change)).max() / (time[1] - time[0]))
    # without a stated inductance N^2/R of the coil whose flux meets least
    inductance = amplifier.inductance or max(
        side.turns**2 / side.met(0.0, side.gap) for side in sides(part)
    )
    return [
        judge(
            "axial.change.displacement_0p",
            "Largest displacement while the thrust changes",
            float(np.abs(moved).max()),
            "m",
            machine_limit(left, "way to the nearer stop"),
            words,
        ),
        judge(
            "axial.change.current_0p",
            "Largest control current while the thrust changes",
            peak,
            "A",
            machine_limit(part.max_current, "max_current"),
            words,
        ),
        information(
            "axial.change.voltage_0p",
            "Coil voltage while the thrust changes",
            inductance * slope,
            "V",
            words,
        )
        if amplifier.max_voltage is None
        else judge(
            "axial.change.voltage_0p",
            "Coil voltage while the thrust changes",
            inductance * slope,
            "V",
            machine_limit(amplifier.max_voltage, "the amplifier's max_voltage"),
            words,
        ),
    ]
