"""The touchdown bearing, as the machine file has it: the table [bearing.touchdown] with what lies
behind its contact, and [coast_down], what slows the rotor that has landed.

From the rotor outwards: contact with friction, inner race (its mass moves, it spins up), rolling
elements, outer race, soft mount with its stop, housing. Each table is optional: without
[bearing.touchdown.race] the rotor lands on a fixed bush.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ambrose.machine.kinds import (
    Count,
    Damping,
    Inertia,
    Length,
    Mass,
    Quantity,
    Rate,
    Ratio,
    Stiffness,
)
from ambrose.machine.part import Part

Force = Annotated[float, Quantity("force")]
Torque = Annotated[float, Quantity("torque")]


@dataclass(frozen=True, slots=True, repr=False)
class TouchdownRace(Part):
    """The rolling bearing of a touchdown bearing: rings and rolling elements; for landing.

    The elements carry F = K d^1.5 (Hertz, balls) at a deflection d of the rings; K is that of the
    secant stiffness element_stiffness = F/d at F = element_load.
    """

    mass: Annotated[Mass, "mass of the inner race"]
    inertia: Annotated[Inertia, "its moment of inertia about the axis"]
    element_stiffness: Annotated[Stiffness, "stiffness F/d of the rolling elements"]
    element_load: Annotated[Force, "load at which it holds"]
    preload: Annotated[Force, "radial preload"] = 0.0
    element_damping: Annotated[Damping, "their damping; the default is assumed"] = 1e3
    pitch_diameter: Annotated[Length | None, "pitch diameter; default: three times the radius"] = (
        None
    )
    friction_moment: Annotated[Torque, "friction moment without load, M_0"] = 0.0
    load_friction: Annotated[
        Ratio, "mu_b of the friction moment mu_b F d/2; the default is usual"
    ] = 0.0015
    static_capacity: Annotated[Force | None, "static load rating C_0"] = None
    specific_heat: Annotated[float, Quantity("specific heat"), "of the race; default: steel"] = (
        460.0
    )
    temperature: Annotated[float, Quantity("temperature"), "of the race before landing"] = 293.15


@dataclass(frozen=True, slots=True, repr=False)
class TouchdownMount(Part):
    """The soft mount between outer race (or bush) and housing, with its stop; for landing."""

    mass: Annotated[Mass, "mass of outer race or bush"]
    stiffness: Annotated[Stiffness, "radial stiffness"]
    damping: Annotated[Damping, "radial damping"]
    travel: Annotated[Length | None, "way to its stop; default: none is met"] = None
    stop_stiffness: Annotated[Stiffness, "stiffness of the stop; the default is assumed"] = 1e9


@dataclass(frozen=True, slots=True, repr=False)
class TouchdownLimits(Part):
    """What a landing may cost; a key left out is not judged."""

    landings: Annotated[int | None, Count(), "landings it must stand"] = None
    max_force: Annotated[Force | None, "largest contact force"] = None
    temperature: Annotated[
        float | None, Quantity("temperature"), "largest temperature of the race"
    ] = None
    energy: Annotated[float | None, Quantity("energy"), "slip energy of its life"] = None
    static_factor: Annotated[Ratio | None, "smallest C_0 over the largest contact force"] = None


@dataclass(frozen=True, slots=True, repr=False)
class Touchdown(Part):
    """Contact in the touchdown bearing, for the virtual rig; the defaults are assumed, not
    measured.
    """

    stiffness: Annotated[Stiffness, "contact stiffness; the default is assumed"] = 1e8
    damping: Annotated[Damping, "contact damping; the default is assumed"] = 1e4
    friction: Annotated[Ratio, "Coulomb friction; the default is assumed"] = 0.2
    radius: Annotated[Length | None, "radius of the contact; default: the shaft's there"] = None
    sliding_speed: Annotated[
        float, Quantity("velocity"), "sliding speed below which friction fades to zero"
    ] = 0.01
    static_friction: Annotated[Ratio | None, "friction at low sliding speed; default: friction"] = (
        None
    )
    stribeck_speed: Annotated[
        float, Quantity("velocity"), "sliding speed over which static_friction falls to friction"
    ] = 0.1
    race: Annotated[TouchdownRace | None, "rings and rolling elements; default: a fixed bush"] = (
        None
    )
    mount: Annotated[TouchdownMount | None, "soft mount; default: rigid"] = None
    limits: Annotated[TouchdownLimits | None, "what a landing may cost"] = None


@dataclass(frozen=True, slots=True, repr=False)
class CoastDown(Part):
    """What slows the rotor after the trip, besides its touchdown bearings; for landing."""

    brake_torque: Annotated[Torque, "braking torque of the drive"] = 0.0
    friction_torque: Annotated[Torque, "constant friction torque"] = 0.0
    windage_torque: Annotated[Torque, "windage at windage_speed; goes with its square"] = 0.0
    windage_speed: Annotated[Rate | None, "speed of windage_torque; default: the top speed"] = None
