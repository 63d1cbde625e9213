"""What may be wrong with a [bearing.magnet]."""

from __future__ import annotations

from collections.abc import Iterator

from ambrose.machine.magnet import POLES, Magnet
from ambrose.machine.messages import complaint
from ambrose.machine.validation.signs import not_positive


def magnet_findings(where: str, magnet: Magnet) -> Iterator[str]:
    """What is wrong with a [bearing.magnet], a line each; ``where`` stands first in each."""
    yield from not_positive(
        where,
        magnet,
        "give its size",
        "turns",
        "pole_area",
        "gap",
        "iron_path",
        "iron_permeability",
        "iron_flux_density",
        "journal_radius",
        "back_iron_area",
        "bias_turns",
        "remanence",
        "magnet_permeability",
        "magnet_length",
        "magnet_area",
    )
    yield from not_positive(where, magnet, "0.1 is much", "leakage", zero=True)
    allowed = POLES[magnet.kind]
    if magnet.pole_count not in allowed:
        yield complaint(
            where,
            "poles",
            f"{magnet.pole_count}",
            f"one of {', '.join(map(str, allowed))} for a {magnet.kind} magnet",
            "count the poles of one plane",
        )
    if magnet.back_iron_area is not None and None in (magnet.journal_radius, magnet.iron_path):
        yield (
            f"{where}: back_iron_area needs journal_radius and iron_path; give the three, or "
            "leave the back iron out"
        )
    pm = ("remanence", "magnet_length", "magnet_area")
    if magnet.kind != "homopolar":
        for key in ("bias_turns", *pm):
            if getattr(magnet, key) is not None:
                yield f'{where}: {key} belongs to kind = "homopolar"; leave it out'
        if magnet.bias != "coil":
            yield f'{where}: bias = "permanent-magnet" belongs to kind = "homopolar"; leave it out'
    elif magnet.bias == "coil":
        if magnet.bias_turns is None:
            yield f"{where}: bias_turns is missing; give the turns of the bias coil"
        for key in pm:
            if getattr(magnet, key) is not None:
                yield f'{where}: {key} belongs to bias = "permanent-magnet"; leave it out'
    else:
        for key in pm:
            if getattr(magnet, key) is None:
                yield f"{where}: {key} is missing; give the permanent magnet's"
        if magnet.bias_turns is not None:
            yield f'{where}: bias_turns belongs to bias = "coil"; leave it out'
