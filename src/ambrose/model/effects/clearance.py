"""Clearance: a place where rotor and stator must not touch: a labyrinth, an impeller eye, a motor's
air gap. It pulls at nothing; reports hold the rotor's motion there against it.

Seals are held against what their own table says (``clearance`` of a bulk-flow seal), touchdown
bearings against their gap: neither needs a row here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from ambrose.machine.kinds import Length, Name, Ratio
from ambrose.machine.messages import complaint
from ambrose.machine.part import Part
from ambrose.machine.validation.signs import not_positive
from ambrose.model.effect import Effect
from ambrose.model.effects.probe import no_reaction

LARGEST = 0.05  # [m], diametral: beyond any running clearance of a rotor


@dataclass(frozen=True, slots=True, repr=False)
class Clearance(Part):
    """A running clearance that must not be used up."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    diametral: Annotated[Length, "diametral running clearance: bore minus journal, hot and turning"]
    limit_share: Annotated[Ratio, "share of it that peak-to-peak motion may take"] = 0.75


def _findings(where: str, part: Clearance) -> Iterator[str]:
    yield from not_positive(where, part, "give the clearance as built", "diametral", "limit_share")
    if part.diametral > LARGEST:
        remedy = "a bare number is in metres: write the unit, such as 0.4 mm"
        yield complaint(
            where,
            "diametral",
            f"{part.diametral:g} m",
            f"at most {LARGEST:g} m",
            remedy,
        )
    if part.limit_share > 1:
        yield complaint(
            where, "limit_share", f"{part.limit_share:g}", "at most 1", "0.75 is usual (API 617)"
        )


CLEARANCE = Effect(
    table="clearance",
    part=Clearance,
    findings=_findings,
    most=100,
    symbol="clearance",
    reach=10.0,
    reaction=no_reaction,
)
