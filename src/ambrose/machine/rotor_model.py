"""A rotor without bearings: what drawings, spreadsheets and other programs' models say, before magnets are chosen for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ambrose.machine.description import Disc, ShaftSection


@dataclass(frozen=True, slots=True)
class RotorModel:
    """shaft and discs as in a machine; bearings [m]: where they stand (empty: not said); speed [rad/s]: the highest (None: not
    said). assumed: what was chosen on the way and why, by key; left_out: what the source holds and this does not, in words."""

    name: str
    shaft: tuple[ShaftSection, ...]
    discs: tuple[Disc, ...] = ()
    bearings: tuple[float, ...] = ()
    speed: float | None = None
    beam_theory: str = "timoshenko"
    source: str = ""
    assumed: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
