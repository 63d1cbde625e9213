"""Where the finite elements of a shaft end: at the equal parts of every section, and at every part
of the machine that stands inside one.

An element deflects as under loads at its ends alone. A disc inside it would be held by that shape:
of a bell halfway along an element of an overhung shaft, frequencies come out several per cent too
high, however well the rest is divided. So every disc, bearing, sensor, seal and effect stands on a
node of its own.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise

from ambrose.machine.attachment import attached
from ambrose.machine.description import MachineDescription
from ambrose.machine.rotor_model import ShaftSection

# of the rotor's length: a part this near to a node is read there by the element's shape. Shorter
# pieces would be 1e12 times as stiff as the whole, and their rounding would show in the modes.
NEAR = 1e-4


@dataclass(frozen=True, slots=True)
class Piece:
    """One element: of which section, from ``left`` to ``right`` within it (0 to 1), and its length
    [m].
    """

    section: ShaftSection
    left: float
    right: float
    length: float


def stations(machine: MachineDescription) -> tuple[float, ...]:
    """The axial places [m] of everything that stands on the shaft, ascending, each once."""
    places = [disc.position for disc in machine.discs]
    places += [bearing.position for bearing in machine.bearings]
    places += [sensor.position for sensor in machine.sensors]
    places += [seal.position for seal in machine.seals]
    places += [at.position for effect, part in attached(machine) for at in effect.stations(part)]
    return tuple(sorted(set(places)))


def mesh(shaft: tuple[ShaftSection, ...], places: Iterable[float] = ()) -> tuple[Piece, ...]:
    """The elements from the left end to the right: ``elements`` equal ones of each section, divided
    at ``places`` [m] that are further than NEAR of the rotor's length from every node.

    Of two places nearer than that to each other the one further from the middle has the node, so
    that a mirrored rotor has the mirrored mesh. Places beyond the shaft divide nothing.
    """
    length = sum(section.length for section in shaft)
    near = NEAR * length
    middle = shaft[0].start + length / 2 if shaft else 0.0
    wanted = sorted(places, key=lambda at: -abs(at - middle))
    found: list[Piece] = []
    for section in shaft:
        n = section.elements
        for i in range(n):
            ends = [i / n, (i + 1) / n]
            for at in wanted:
                place = (at - section.start) / section.length
                room = min(abs(place - end) for end in ends) * section.length
                if ends[0] < place < ends[-1] and room > near:
                    insort(ends, place)
            # an element that stays whole has its length to the last bit
            lengths = [(b - a) * section.length for a, b in pairwise(ends)]
            lengths = lengths if len(lengths) > 1 else [section.length / n]
            found += [
                Piece(section, a, b, length)
                for a, b, length in zip(ends[:-1], ends[1:], lengths, strict=True)
            ]
    return tuple(found)


def node_positions(pieces: tuple[Piece, ...]) -> list[float]:
    """The N nodes [m] between and at the ends of N - 1 elements."""
    return list(accumulate((p.length for p in pieces), initial=pieces[0].section.start))


def finer(shaft: tuple[ShaftSection, ...], factor: int) -> tuple[ShaftSection, ...]:
    """The shaft with ``factor`` times the elements in every section."""
    return tuple(replace(section, elements=factor * section.elements) for section in shaft)
