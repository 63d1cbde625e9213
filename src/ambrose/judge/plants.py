"""The full plants of a machine at its operating points, and what they show along the speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.checks import invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import select
from ambrose.judge import campbell
from ambrose.judge.checks import Curve
from ambrose.law.law import LawLike, law_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import with_offsets_of

Progress = Callable[[str], None]
_CAMPBELL_SPEEDS, _CAMPBELL_MODES = 15, 10  # points over speed; branches drawn


def full_plants(machine: Machine) -> tuple[Plant, ...]:
    """The full finite-element plant at every operating point of the machine; the first is the one
    designs are made for.
    """
    first = machine.operation.design
    others = [point for point in machine.operation.envelope if point is not first]
    return tuple(assemble(machine, point) for point in (first, *others))


def plant_at(machine: Machine, point: str | OperatingPoint | None = None) -> Plant:
    """The full plant at an operating point, given itself or by its label or the beginning of it
    (None: the design point).

    Raises InvalidInput.
    """
    return assemble(machine, chosen_point(machine, point) or machine.operation.design)


def chosen_point(machine: Machine, point: str | OperatingPoint | None) -> OperatingPoint | None:
    return None if point is None else operating_point(machine, point)


def plants_along_speed(plant: Plant) -> Callable[[float], Plant]:
    """Speed [rad/s] -> the plant assembled anew at that speed."""
    return lambda speed: with_offsets_of(
        assemble(plant.machine, replace(plant.point, speed=speed)), plant
    )


def split_covered(
    given: LawLike, plants: Sequence[Plant]
) -> tuple[tuple[Plant, ...], tuple[str, ...]]:
    """The plants that a law is meant for, and the labels of the points that it leaves out. Raises
    InvalidInput for none.
    """
    law = law_of(given)
    within = tuple(plant for plant in plants if law.covers(plant))
    if not within and law.range is not None and law.scheduled_over is not None:
        (low, high), along = law.range, law.scheduled_over
        wanted, remedy = (
            "one with an operating point of the machine in it",
            f"design over the machine's own {along.plural}",
        )
        raise invalid(
            "the scheduled range", f"{along.words(low)} to {along.words(high)}", wanted, remedy
        )
    return within, tuple(plant.point.label for plant in plants if not law.covers(plant))


def plant_gain(plant: Plant) -> Curve:
    """Largest singular value of currents -> sensors [m/A], 1 Hz to 5 kHz."""
    omega = np.geomspace(2 * np.pi, 2 * np.pi * 5000, 600)
    gain = frequency_response(
        select(plant.system, plant.named("u"), plant.named("y")), omega
    ).max_singular_value()[None]
    name = "plant gain, currents to sensors"
    return Curve(
        "plant.gain", name, "frequency", omega, gain, ("max singular value",), "rad/s", "m/A"
    )


def campbell_map(plant: Plant, controller: LawLike, progress: Progress) -> tuple[Curve, ...]:
    """Closed-loop natural frequencies and damping over the machine's speed range; empty for one
    that does not turn.
    """
    low, high = plant.machine.operation.speed_range
    if high <= low:
        return ()
    progress("following the modes over speed")
    along = campbell.campbell(
        plants_along_speed(plant),
        np.linspace(low, high, _CAMPBELL_SPEEDS),
        _CAMPBELL_MODES,
        controller,
    )
    return tuple(campbell.campbell_curves(along))
