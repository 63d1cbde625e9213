"""The rotor itself: shaft sections, discs and measured bending modes as the user writes them down;
and a rotor without bearings, as drawings, spreadsheets and other programs' models have it before
magnets are chosen for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from ambrose.machine.kinds import (
    Count,
    Inertia,
    Length,
    Mass,
    Name,
    Quantity,
    Rate,
    Ratio,
    Text,
    Words,
)
from ambrose.machine.part import Part


@dataclass(frozen=True, slots=True, repr=False)
class Material(Part):
    """A material, [material.NAME], that shaft sections refer to by name; the name is not
    compared.
    """

    density: Annotated[float, Quantity("density"), "mass density"] = 7850.0
    youngs_modulus: Annotated[float, Quantity("elastic modulus"), "Young's modulus"] = 2.1e11
    poisson_ratio: Annotated[Ratio, "Poisson's ratio"] = 0.3
    name: str = field(default="", compare=False)


@dataclass(frozen=True, slots=True, repr=False)
class ShaftSection(Part):
    """A cylindrical or conical piece of shaft; the sections follow each other from the left end to
    the right, without gap or overlap.

    mass_diameter lets shrunk-on laminations add inertia without stiffness. A cone has other
    diameters at its right end.
    """

    start: Annotated[Length, "where the section starts; default: the end of the previous one"] = (
        field(metadata={"required": False})
    )
    length: Annotated[Length, "axial length"]
    outer_diameter: Annotated[Length, "outer diameter, for the stiffness"]
    inner_diameter: Annotated[Length, "bore"] = 0.0
    mass_diameter: Annotated[
        Length | None,
        "outer diameter for the mass, where laminations add mass without stiffness; default: "
        "outer_diameter",
    ] = None
    elements: Annotated[int, Count(), "number of finite elements"] = 1
    material: Annotated[
        Material,
        Text("the name of a [material.NAME] table"),
        "name of a [material.NAME] table; default: steel",
    ] = field(default_factory=Material)
    label: Annotated[Words, "a name for drawings and messages"] = ""
    end_outer_diameter: Annotated[
        Length | None,
        "outer diameter at the right end of a cone, linear in between; default: outer_diameter",
    ] = None
    end_inner_diameter: Annotated[
        Length | None, "bore at the right end of a cone; default: inner_diameter"
    ] = None

    @property
    def conical(self) -> bool:
        return self.diameters(0.0) != self.diameters(1.0)

    def diameters(self, place: float) -> tuple[float, float, float]:
        """Outer diameter, bore and outer diameter of the mass [m] at a place from 0 (left end) to 1
        (right end).
        """
        outer = _between(self.outer_diameter, self.end_outer_diameter, place)
        mass = outer if self.mass_diameter is None else self.mass_diameter
        return outer, _between(self.inner_diameter, self.end_inner_diameter, place), mass


def _between(start: float, end: float | None, place: float) -> float:
    return start if end is None else start + place * (end - start)


@dataclass(frozen=True, slots=True, repr=False)
class Disc(Part):
    """A rigid disc on the shaft: an impeller, a wheel, a thrust collar."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position of its centre of mass, from the left end"]
    mass: Annotated[Mass, "mass"]
    polar_inertia: Annotated[Inertia, "moment of inertia about the shaft's axis"] = 0.0
    diametral_inertia: Annotated[
        Inertia, "moment of inertia about a diameter through its centre of mass"
    ] = 0.0


@dataclass(frozen=True, slots=True, repr=False)
class BendingMode(Part):
    """A bending mode of the free rotor at standstill as measured, in place of what shaft and discs
    give, in both planes.

    Its shape stays that of shaft and discs. Measured hanging from a soft rope, or found by
    identification.
    """

    number: Annotated[int, Count(), "which one: 1 for the lowest"]
    frequency: Annotated[Rate | None, "natural frequency; default: that of shaft and discs"] = None
    damping: Annotated[Ratio | None, "damping ratio; default: modal_damping"] = None


@dataclass(frozen=True, slots=True)
class RotorModel:
    """shaft and discs as in a machine; bearings [m]: where they stand (empty: not said); speed
    [rad/s]: the highest (None: not said). assumed: what was chosen on the way and why, by key;
    left_out: what the source holds and this does not, in words.
    """

    name: str
    shaft: tuple[ShaftSection, ...]
    discs: tuple[Disc, ...] = ()
    bearings: tuple[float, ...] = ()
    speed: float | None = None
    beam_theory: str = "timoshenko"
    source: str = ""
    assumed: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
