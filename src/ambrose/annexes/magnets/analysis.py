"""The sheet of every magnet with a geometry."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput
from ambrose.core.presentation import Presented
from ambrose.machine.axial import across_the_shaft
from ambrose.machine.description import MagneticBearing, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.magnet import Magnet
from ambrose.model.magnetics.driven import DrivenMagnet, LinearityMap, linearity
from ambrose.model.magnetics.kinds import magnet_of
from ambrose.model.magnetics.of_bearing import coefficients_of

_HALF_ANGLE = math.pi / 8  # of the eight poles that [bearing.geometry] is read as
_PERMEABILITY = 3000.0  # of the iron that [bearing.iron] is read as; its path follows
AXES = ("zeta", "eta")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MagnetSheet(Presented):
    """One magnet at its bias current, SI.

    part: its geometry; current [A]: the bearing's bias current; bias [A]: that of the opposing pair
    of the same coefficients, which full modulation means. force_per_current, negative_stiffness
    (2,); inductance [H] that a control current sees in a coil. flux_density [T] in the gap without
    and with full modulation. capacity [N]: force along zeta at full modulation. lost_force [N] that
    acts at once when the first coil opens at the bias, lost_share: what is left of its axis' k_i.
    maps: the straightness per axis.
    """

    _FACTS: ClassVar = ("bearing", "force_per_current", "negative_stiffness", "capacity")

    bearing: str
    part: Magnet
    current: float
    bias: float
    force_per_current: tuple[float, float]
    negative_stiffness: tuple[float, float]
    inductance: float
    flux_density: tuple[float, float]
    capacity: float
    lost_force: float
    lost_share: float
    maps: tuple[LinearityMap, LinearityMap]
    driven: DrivenMagnet

    @property
    def tolerances(self) -> tuple[Tolerance, Tolerance]:
        """Tolerances that cover k_i and k_s over the maps, for the machine file."""
        rows = []
        for name in ("force_per_current", "negative_stiffness"):
            ends = [end - 1 for item in self.maps for end in getattr(item, name)]
            width = math.ceil(1e3 * max(map(abs, ends))) / 1e3
            rows.append(Tolerance(f"bearing.{self.bearing}.{name}", relative=width))
        return rows[0], rows[1]

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; of the maps what they say."""
        plain = {
            "bearing": self.bearing,
            "magnet": self.part.to_dict(defaults=True),
            "bias_current": self.bias,
            "force_per_current": list(self.force_per_current),
            "negative_stiffness": list(self.negative_stiffness),
            "inductance": self.inductance,
            "flux_density_at_bias": self.flux_density[0],
            "flux_density_at_full_modulation": self.flux_density[1],
            "force_at_full_modulation_0p": self.capacity,
            "force_when_a_coil_opens": self.lost_force,
            "force_per_current_left": self.lost_share,
        }
        for axis, item in zip(AXES, self.maps, strict=True):
            plain[f"linearity_{axis}"] = {
                "largest_error": item.worst,
                "force_per_current": list(item.force_per_current),
                "negative_stiffness": list(item.negative_stiffness),
            }
        return plain


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MagnetSheets(Presented):
    """The sheets of a machine's magnets; share: of gap and current that the maps cover."""

    _FACTS: ClassVar = ("machine=machine_name", "bearings")

    machine: Machine
    share: float
    sheets: tuple[MagnetSheet, ...]

    @property
    def machine_name(self) -> str:
        return self.machine.name

    @property
    def bearings(self) -> tuple[str, ...]:
        return tuple(sheet.bearing for sheet in self.sheets)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        return {
            "machine": self.machine.name,
            "share": self.share,
            "magnets": [sheet.to_dict() for sheet in self.sheets],
            "tolerances": [item.to_dict() for sheet in self.sheets for item in sheet.tolerances],
        }


@names_wrong_types
def magnet_sheets(
    machine: Machine, bearing: str | None = None, *, share: float = 0.25
) -> MagnetSheets:
    """The sheets of the magnets with a [bearing.magnet] or [bearing.geometry].

    bearing: the one of that name alone. share: of the gap, and of the full control current, over
    which the force law is compared with its straight line. Raises InvalidInput where no magnet has
    a geometry, or the share is not between 0 and 1.
    """
    across_the_shaft(
        machine,
        "the sheets are those of radial magnets",
        "ambrose check of it tells those of the axis: k_i, k_s, core, capacity",
    )
    names = [item.name for item in machine.bearings]
    if bearing is not None and bearing not in names:
        raise InvalidInput(
            f"there is no bearing {bearing!r} in {machine.name}; it has {', '.join(names)}"
        )
    chosen = [item for item in machine.bearings if bearing in (None, item.name)]
    sheets = []
    for item in chosen:
        part = geometry_of(item)
        if part is not None:
            sheets.append(sheet_of(item, part, share))
    if not sheets:
        raise InvalidInput(
            f"no magnet of {machine.name} has a geometry; give [bearing.magnet] in its machine file"
        )
    return MagnetSheets(machine, share, tuple(sheets))


def geometry_of(bearing: MagneticBearing) -> Magnet | None:
    """The magnet as a network's: its [bearing.magnet], or the eight poles that its
    [bearing.geometry] means, with the iron of [bearing.iron]; None without either, or for other
    pole angles.
    """
    if bearing.magnet is not None:
        return bearing.magnet
    stated = bearing.geometry
    if stated is None or abs(stated.pole_half_angle - _HALF_ANGLE) > 1e-3:
        return None
    part = Magnet("heteropolar", stated.turns / 2, stated.pole_area, stated.gap)
    if bearing.iron is None or bearing.iron.equivalent_gap == 0:
        return part
    # the iron's equivalent gap is its path over 2 mu_r, both poles together
    return replace(
        part,
        iron_path=bearing.iron.equivalent_gap * _PERMEABILITY,
        iron_permeability=_PERMEABILITY,
        iron_flux_density=bearing.iron.flux_density,
    )


def sheet_of(bearing: MagneticBearing, part: Magnet, share: float) -> MagnetSheet:
    """The sheet of one magnet. Raises InvalidInput."""
    driven = magnet_of(part)
    current = bearing.bias_current
    k_i, k_s, bias = coefficients_of(part, current, bearing.name)
    rest = driven.at(current)
    full = driven.at(current, bias * np.array([1.0, 0.0]))
    gaps = driven.network.normals.any(axis=1)
    lost = driven.without(0)
    left = lost.coefficients(current)[0][0, 0] / k_i[0]
    maps = [linearity(driven, current, part.gap, axis, share, bias) for axis in (0, 1)]
    return MagnetSheet(
        bearing.name,
        part,
        current,
        bias,
        k_i,
        k_s,
        driven.inductance(current),
        (_largest(rest.flux_density[gaps]), _largest(full.flux_density[gaps])),
        float(full.force[0]),
        float(np.hypot(*lost.at(current).force)),
        float(left),
        (maps[0], maps[1]),
        driven,
    )


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max())
