"""Stage: the aerodynamic cross-coupling of an impeller or a row of blades,

    f = -[[0, q], [-q, 0]] (x, y),    q > 0 drives forward whirl.

Rated stiffness (Wachel & von Nimitz 1981 for impellers, Alford 1965 for blade rows), as API 617
takes it for its Level I stability analysis (recalled), with torque = power/speed:

    radial  q = 3.0 torque (rho_d/rho_s) / (D H)      D, H: impeller's diameter, narrowest width
    axial   q = 1.5 torque / (D H)                    D, H: mean diameter, blade height

The usual form, q [kN/mm] = P [W] B 9.55 (rho_d/rho_s) / (D [mm] H [mm] N [rpm]), is this one:
9.55 = 30/pi. At another speed power goes with its cube (affinity laws), so that q goes with its
square; at rest nothing is left.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ambrose.machine.description import OperatingPoint
from ambrose.machine.kinds import Choice, Length, Name, Quantity, Rate, Ratio
from ambrose.machine.messages import complaint
from ambrose.machine.part import Part
from ambrose.machine.validation.signs import not_positive
from ambrose.model.effect import Action, Effect, Reaction

KINDS = ("radial", "axial")
_BETA = {"radial": 3.0, "axial": 1.5}
_DIAMETER = (0.01, 5.0)  # [m]: outside of it a unit was forgotten


@dataclass(frozen=True, slots=True, repr=False)
class Stage(Part):
    """An impeller or a row of blades that does work on the gas."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    power: Annotated[float, Quantity("power"), "rated power that the stage takes"]
    speed: Annotated[Rate, "speed at that power"]
    diameter: Annotated[Length, "impeller diameter; of blades the mean diameter"]
    width: Annotated[
        Length, "least of impeller discharge width and diffuser width; of blades their height"
    ]
    density_ratio: Annotated[
        Ratio, "gas density at discharge over that at suction; not used of blades"
    ] = 1.0
    kind: Annotated[str, Choice(KINDS), "radial (impeller) or axial (blades)"] = "radial"


def rated_cross_coupling(stage: Stage) -> float:
    """q [N/m] at the rated speed, the formula of this file's head."""
    torque = stage.power / stage.speed
    density = stage.density_ratio if stage.kind == "radial" else 1.0
    return _BETA[stage.kind] * torque * density / (stage.diameter * stage.width)


def cross_coupling(stage: Stage, speed: float) -> float:
    """q [N/m] at a speed [rad/s]: of the rated one, by the square of the speeds' ratio."""
    return rated_cross_coupling(stage) * (speed / stage.speed) ** 2


def _findings(where: str, stage: Stage) -> Iterator[str]:
    sizes = ("power", "speed", "diameter", "width", "density_ratio")
    yield from not_positive(where, stage, "give what the stage was rated for", *sizes)
    low, high = _DIAMETER
    if not low <= stage.diameter <= high:
        yield complaint(
            where,
            "diameter",
            f"{stage.diameter:g} m",
            f"from {low:g} to {high:g} m",
            "a bare number is in metres: write the unit, such as 400 mm",
        )
    if stage.width >= stage.diameter:
        yield complaint(
            where,
            "width",
            f"{stage.width:g} m",
            f"below the diameter, {stage.diameter:g} m",
            "it is the narrowest axial width of the flow at discharge",
        )
    if 0 < stage.density_ratio < 1:
        yield complaint(
            where,
            "density_ratio",
            f"{stage.density_ratio:g}",
            "at least 1",
            "it is discharge over suction",
        )


def _reaction(stage: Stage, point: OperatingPoint) -> Reaction:
    q = cross_coupling(stage, point.speed)
    return Reaction(np.array([[0.0, q], [-q, 0.0]]), np.zeros((2, 2)))


def _actions(stage: Stage, point: OperatingPoint, quantity: str) -> Iterator[Action]:
    """Where q acts: f_x = -q y and f_y = +q x."""
    q = cross_coupling(stage, point.speed)
    yield Action(f"{stage.name}_x", q, ((f"q_{stage.name}_y", -1.0),))
    yield Action(f"{stage.name}_y", q, ((f"q_{stage.name}_x", 1.0),))


STAGE = Effect(
    table="stage",
    part=Stage,
    findings=_findings,
    quantities={"cross_coupling": ("stiffness", ())},
    most=40,
    symbol="stage",
    reach=18.0,
    reaction=_reaction,
    over_speed=True,
    actions=_actions,
)
