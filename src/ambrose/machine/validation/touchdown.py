"""What a touchdown bearing must fulfil: contact, rings, mount and limits; and the coast-down."""

from __future__ import annotations

from collections.abc import Iterator

from ambrose.machine.description import MachineDescription, MagneticBearing
from ambrose.machine.messages import complaint
from ambrose.machine.touchdown import Touchdown
from ambrose.machine.validation.signs import not_positive


def touchdown_findings(where: str, bearing: MagneticBearing) -> Iterator[str]:
    """Complaints about a bearing's [bearing.touchdown], if it has one."""
    contact = bearing.touchdown
    if contact is None:
        return
    inside = f"{where}, [bearing.touchdown]"
    yield from not_positive(
        inside,
        contact,
        "leave it out for its default",
        *("stiffness", "radius", "sliding_speed", "stribeck_speed"),
    )
    taken = ("damping", "friction", "static_friction")
    remedy = "contact takes energy and gives none"
    yield from not_positive(inside, contact, remedy, *taken, zero=True)
    static = contact.static_friction
    if static is not None and 0 <= static < contact.friction:
        yield complaint(
            inside,
            "static_friction",
            f"{static:g}",
            f"at least friction, {contact.friction:g}",
            "friction falls with the sliding speed; swap the two or leave static_friction out",
        )
    if bearing.touchdown_gap is None:
        yield f"{where}: touchdown_gap is missing; [bearing.touchdown] needs the clearance"
    yield from _rings(where, contact)


def _rings(where: str, contact: Touchdown) -> Iterator[str]:
    if contact.race is not None:
        inside = f"{where}, [bearing.touchdown.race]"
        sizes = ("mass", "inertia", "element_stiffness", "element_load")
        rest = ("pitch_diameter", "static_capacity", "specific_heat", "temperature")
        yield from not_positive(inside, contact.race, "give its size", *sizes, *rest)
        losses = ("preload", "element_damping", "friction_moment", "load_friction")
        yield from not_positive(
            inside, contact.race, "leave it out for its default", *losses, zero=True
        )
    if contact.mount is not None:
        inside = f"{where}, [bearing.touchdown.mount]"
        remedy = "leave the table out for a rigid mount"
        yield from not_positive(
            inside, contact.mount, remedy, "mass", "stiffness", "travel", "stop_stiffness"
        )
        yield from not_positive(inside, contact.mount, remedy, "damping", zero=True)
    limits = contact.limits
    if limits is None:
        return
    inside = f"{where}, [bearing.touchdown.limits]"
    keys = ("landings", "max_force", "temperature", "energy", "static_factor")
    yield from not_positive(inside, limits, "leave it out where it is not judged", *keys)
    capacity = None if contact.race is None else contact.race.static_capacity
    if limits.static_factor is not None and capacity is None:
        yield (
            f"{inside}: static_factor needs the load rating; give static_capacity in "
            "[bearing.touchdown.race], or leave static_factor out"
        )


def coast_down(machine: MachineDescription) -> Iterator[str]:
    """Complaints about [coast_down]."""
    if machine.coast_down is None:
        return
    remedy = "give its size; it slows the rotor"
    torques = ("brake_torque", "friction_torque", "windage_torque")
    yield from not_positive("[coast_down]", machine.coast_down, remedy, *torques, zero=True)
    yield from not_positive("[coast_down]", machine.coast_down, remedy, "windage_speed")
