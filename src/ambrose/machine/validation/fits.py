"""What stands around the rotor must leave it room: magnets, collar, seals and touchdown bearings
beside the shaft.

Only what is certain is refused. A disc is a mass and two inertias here; a bell may hang over a
stator, so that no size follows from them.
"""

from __future__ import annotations

from collections.abc import Iterator

from ambrose.machine.description import MachineDescription
from ambrose.machine.messages import complaint, number
from ambrose.machine.thrust import ThrustBearing, ThrustStator
from ambrose.machine.validation.parts import JOINT, shaft_place

_ROUNDING = 1 - 1e-6  # of a radius that the file repeats, from a diameter or in another unit


def fits(machine: MachineDescription) -> Iterator[str]:
    """What cuts into the shaft, a line each; a shaft that is itself wrong is named elsewhere."""
    wrong = any(section.length <= 0 or section.outer_diameter <= 0 for section in machine.shaft)
    if wrong or not machine.shaft:
        return
    for bearing in machine.bearings:
        where = f"[[bearing]] {bearing.name}"
        magnet, contact = bearing.magnet, bearing.touchdown
        if magnet is not None and magnet.journal_radius is not None:
            inside = f"{where}, [bearing.magnet]"
            yield from _around(
                machine, inside, "journal_radius", magnet.journal_radius, bearing.position
            )
        if contact is not None and contact.radius is not None:
            inside = f"{where}, [bearing.touchdown]"
            yield from _around(machine, inside, "radius", contact.radius, bearing.position)
    for seal in machine.seals:
        if seal.geometry is not None:
            inside, radius = f"[[seal]] {seal.name}, [seal.geometry]", seal.geometry.diameter / 2
            yield from _around(machine, inside, "diameter", radius, seal.position, factor=2)
    for part in machine.effects:
        if isinstance(part, ThrustBearing):
            yield from _thrust(machine, part)


def _around(
    machine: MachineDescription, where: str, key: str, radius: float, place: float, factor: int = 1
) -> Iterator[str]:
    """A surface of the rotor, that lies on the shaft or on a sleeve over it."""
    shaft, section = least_radius(machine, place)
    if 0 < radius < _ROUNDING * shaft:
        least = f"at least the shaft's there, {factor * shaft:g} m ({section})"
        yield complaint(
            where, key, number(factor * radius, "m"), least, "correct the one or the other"
        )


def _thrust(machine: MachineDescription, part: ThrustBearing) -> Iterator[str]:
    where = f"[[thrust_bearing]] {part.name}"
    shaft, section = least_radius(machine, part.position)
    if 0 < part.collar_radius <= shaft:
        above = f"above the shaft's radius there, {shaft:g} m ({section})"
        value = number(part.collar_radius, "m")
        yield complaint(where, "collar_radius", value, above, "correct the one or the other")
    if len(part.stators) not in {1, 2} or min(part.gap) <= 0:
        return
    spans = _spans(part)
    tightest: dict[int, tuple[float, str]] = {}  # of a stator for both sides, the larger radius
    for side, span in enumerate(spans):
        k = min(side, len(part.stators) - 1)
        tightest[k] = max(tightest.get(k, (0.0, "")), _largest_radius(machine, *span))
    for k, (radius, section) in tightest.items():
        bore = part.stators[k].inner_pole[0]
        if 0 < bore <= radius:
            inside = f"{where}, [[thrust_bearing.stator]] {k + 1}"
            above = f"above the rotor's radius inside it, {radius:g} m ({section})"
            remedy = "the shaft turns in the pole's bore: widen it, or correct the shaft"
            yield complaint(inside, "inner_pole (inner)", number(bore, "m"), above, remedy)
    first, last = spans[0][0], spans[1][1]
    for bearing in machine.bearings:
        if first < bearing.position < last:
            yield (
                f"[[bearing]] {bearing.name}: position is {bearing.position:g} m, inside "
                f"[[thrust_bearing]] {part.name}, whose stators stand from {first:g} to {last:g} m;"
                " move one of the two"
            )


def _spans(part: ThrustBearing) -> tuple[tuple[float, float], tuple[float, float]]:
    """From where to where the stators (left, right) stand along the shaft [m]: behind the gap the
    slot's depth and the wall.
    """
    half = part.collar_thickness / 2

    def depth(stator: ThrustStator) -> float:
        return stator.slot_depth + stator.back_wall

    left, right = part.position - half - part.gap[0], part.position + half + part.gap[1]
    one, other = part.pair
    return (left - depth(one), left), (right, right + depth(other))


def _largest_radius(machine: MachineDescription, low: float, high: float) -> tuple[float, str]:
    """The rotor's largest radius [m] between two places, shrunk-on laminations included, and the
    section that has it.
    """
    best, slack = (0.0, ""), JOINT * machine.length
    for i, section in enumerate(machine.shaft):
        ends = max(low, section.start), min(high, section.start + section.length)
        if ends[1] - ends[0] <= slack:
            continue
        for end in ends:
            outer, _, mass = section.diameters((end - section.start) / section.length)
            best = max(best, (max(outer, mass) / 2, shaft_place(i, section)))
    return best


def least_radius(machine: MachineDescription, place: float) -> tuple[float, str]:
    """The shaft's radius [m] at a place, at a step the smaller one, and the section; laminations
    are left out: a sleeve may end before them.
    """
    slack = JOINT * machine.length
    radii = [
        (
            section.diameters((place - section.start) / section.length)[0] / 2,
            shaft_place(i, section),
        )
        for i, section in enumerate(machine.shaft)
        if section.start - slack <= place <= section.start + section.length + slack
    ]
    return min(radii, default=(0.0, ""))
