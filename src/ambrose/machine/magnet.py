"""What a radial magnet is made of, as the machine file has it: the table [bearing.magnet]."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from ambrose.machine.kinds import Choice, Count, Length, Quantity, Ratio
from ambrose.machine.part import Part

KINDS = ("heteropolar", "e-core", "homopolar")
POLARITIES = ("NSNS", "NNSS")
BIASES = ("coil", "permanent-magnet")
POLES = {"heteropolar": (8, 12, 16), "e-core": (12,), "homopolar": (3, 4, 6, 8)}


@dataclass(frozen=True, slots=True, repr=False)
class Magnet(Part):
    """A radial magnet's poles, coils, iron and permanent magnets; its coefficients follow from the
    magnetic network (``ambrose.model.magnetics``).

    "heteropolar": poles around the journal, a quarter of them for each half-axis. "e-core": twelve
    poles, of each three the middle one twice as wide and with the coil. "homopolar": two planes of
    poles, the bias flux enters the journal in one and leaves it in the other.
    """

    kind: Annotated[str, Choice(KINDS), "how the flux runs"] = field(metadata={"required": True})
    turns: Annotated[
        float, Quantity("plain number"), "turns on one pole (e-core: on a middle pole)"
    ]
    pole_area: Annotated[
        float, Quantity("area"), "face of one pole (e-core: of a side pole; the middle one has two)"
    ]
    gap: Annotated[Length, "radial air gap at the centre"]
    poles: Annotated[
        int | None, Count(), "poles, of a homopolar magnet in one plane; default: 8, 12 or 4"
    ] = None
    polarity: Annotated[
        str, Choice(POLARITIES), "order of the poles around a heteropolar magnet"
    ] = "NSNS"
    leakage: Annotated[
        Ratio, "flux beside each gap (with a permanent magnet: beside it), over that through it"
    ] = 0.0
    iron_path: Annotated[Length | None, "length of a pole in its iron; default: ideal iron"] = None
    iron_permeability: Annotated[Ratio, "relative permeability of the iron without field"] = 3000.0
    iron_flux_density: Annotated[
        float, Quantity("magnetic flux density"), "flux density that the iron never reaches"
    ] = 1.9
    journal_radius: Annotated[Length | None, "radius of the journal, for the back iron"] = None
    back_iron_area: Annotated[
        float | None, Quantity("area"), "section of the yoke and of the journal's laminations"
    ] = None
    bias: Annotated[str, Choice(BIASES), "what drives the bias flux of a homopolar magnet"] = "coil"
    bias_turns: Annotated[
        float | None, Quantity("plain number"), "turns of the bias coil of a homopolar magnet"
    ] = None
    remanence: Annotated[
        float | None, Quantity("magnetic flux density"), "remanence of the permanent magnet"
    ] = None
    magnet_permeability: Annotated[Ratio, "relative permeability of the permanent magnet"] = 1.05
    magnet_length: Annotated[Length | None, "length of the permanent magnet along its flux"] = None
    magnet_area: Annotated[float | None, Quantity("area"), "section of the permanent magnet"] = None

    @property
    def pole_count(self) -> int:
        """The poles of one plane."""
        usual = {"heteropolar": 8, "e-core": 12, "homopolar": 4}
        return usual[self.kind] if self.poles is None else self.poles
