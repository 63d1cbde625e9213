"""Load: a radial force on the rotor that the magnets must carry beside weight and unbalance: a
lasting one, an impulse, or a surge. It pulls at nothing in the model of the machine; load capacity
(``judge.capacity``, the lateral report, ``size``) holds the magnets against it.

    static    f(t) = F
    impulse   f(t) = F sin(pi t/T),  0 <= t <= T        duration T
    surge     f(t) = F sin(w t)                         frequency w
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from ambrose.machine.kinds import Angle, Choice, Length, Name, Quantity, Rate, Time
from ambrose.machine.messages import complaint
from ambrose.machine.part import Part
from ambrose.machine.validation.signs import not_positive
from ambrose.model.effect import Effect
from ambrose.model.effects.probe import no_reaction

STATIC = "static"
IMPULSE, SURGE = "impulse", "surge"
_NEEDS = {STATIC: None, IMPULSE: "duration", SURGE: "frequency"}


@dataclass(frozen=True, slots=True, repr=False)
class Load(Part):
    """A force that the magnets must be able to carry."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    kind: Annotated[
        str, Choice(tuple(_NEEDS)), "static (lasting), impulse (half a sine) or surge (a sine)"
    ]
    force: Annotated[float, Quantity("force"), "its amplitude, zero to peak"]
    duration: Annotated[Time | None, "of the half sine, of an impulse"] = None
    frequency: Annotated[Rate | None, "of the sine, of a surge"] = None
    direction: Annotated[
        Angle | None, "from the global x towards y; default: the worst one for every axis"
    ] = None


def _findings(where: str, part: Load) -> Iterator[str]:
    yield from not_positive(where, part, "give what the machine must withstand", "force")
    needed = _NEEDS[part.kind]
    for key in ("duration", "frequency"):
        value = getattr(part, key)
        if key == needed and value is None:
            yield complaint(where, key, "missing", f"given for kind '{part.kind}'", "add it")
        elif key != needed and value is not None:
            yield complaint(where, key, "given", f"left out for kind '{part.kind}'", "remove it")
        elif value is not None:
            yield from not_positive(where, part, "it is a time or a rate", key)


LOAD = Effect(
    table="load",
    part=Load,
    findings=_findings,
    most=20,
    symbol="load",
    reach=34.0,
    reaction=no_reaction,
)
