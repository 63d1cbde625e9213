"""What a registered effect adds to the machine file: its table, its part, where it stands, what of
it may be uncertain.

An effect is registered under the name of its table (``ambrose.registry``, kind "effect"). This is
the half of it that the room of machine files needs; ``ambrose.model.effect`` adds the physics. No
effect is imported before somebody asks for one.
"""

from bisect import insort
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Any

from ambrose.machine.description import MachineDescription
from ambrose.machine.part import Part, ShaftSection
from ambrose.registry import registered, resolve

TILTED, UPRIGHT = ("zeta", "eta"), ("x", "y")
_MOST = 20  # entries of a table, unless its effect says otherwise


@dataclass(frozen=True, slots=True)
class Station:
    """Where an effect acts: ports <name>_<axis> at a position [m] along the rotor.

    angle: of the first axis from the global x [rad]; the second one is a quarter turn ahead. axes:
    their names; one along the shaft.
    """

    name: str
    position: float
    angle: float = 0.0
    axes: tuple[str, ...] = UPRIGHT


def where_it_stands(part: Any) -> tuple[Station, ...]:
    """The station of a part with a name and a position: in its own axes where it has an angle."""
    if hasattr(part, "angle"):
        return (Station(part.name, part.position, part.angle, TILTED),)
    return (Station(part.name, part.position),)


def _no_problem(where: str, part: Any) -> Iterator[str]:
    """An effect without findings of its own."""
    yield from ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Attachment:
    """An effect as the machine file knows it.

    table: its name there, [[table]]. part: the dataclass that an entry becomes, whose annotated
    fields are the keys; it has a ``name``. findings(where, part): what is wrong with an entry, a
    line each (``where`` stands first in each). stations(part): where it acts. quantities: what
    may carry a tolerance: name -> (dimension, the components that can be named alone). most: how
    many entries a machine may have. on_stator: whether what it acts against moves with a support
    or a casing mode that names it; otherwise it acts against the ground. carries: whether it
    carries the rotor as a radial bearing does, so that a machine may do without magnets. symbol,
    reach: its mark in the drawing of the rotor, a "spring" for what carries or restrains the shaft,
    else "probe", "clearance", "load", "stage" or "mark", and how far it reaches above the shaft
    [pixels]. axis(machine): the machine of
    an axis of its own that the effect holds; None: it holds none.
    """

    table: str
    part: type[Any]
    findings: Callable[[str, Any], Iterator[str]] = _no_problem
    stations: Callable[[Any], tuple[Station, ...]] = where_it_stands
    quantities: Mapping[str, tuple[str, tuple[str, ...]]] = field(default_factory=dict)
    most: int = _MOST
    on_stator: bool = False
    carries: bool = False
    symbol: str = "spring"
    reach: float = 26.0
    axis: Callable[[Any], Any] | None = None


def attachments() -> dict[str, Any]:
    """All registered effects by their tables, in a fixed order: those of the house, of the annexes,
    then those added from outside.
    """
    return dict(_resolved(tuple(registered("effect").items())))


@lru_cache(maxsize=8)
def _resolved(places: tuple[tuple[str, Any], ...]) -> tuple[tuple[str, Any], ...]:
    return tuple((table, resolve(place)) for table, place in places)


def attachment_of(part: Part) -> Any:
    """The effect that a part belongs to. Raises TypeError for a part of no registered effect."""
    for item in attachments().values():
        if type(part) is item.part:
            return item
    known = ", ".join(item.part.__name__ for item in attachments().values())
    raise TypeError(f"{type(part).__name__} is not part of a registered effect; known: {known}")


def attached(machine: MachineDescription) -> Iterator[tuple[Any, Any]]:
    """(effect, part) of everything on a machine that belongs to a registered effect, in the order
    of its ports.
    """
    for part in machine.attached:
        yield attachment_of(part), part


def by_table(parts: tuple[Part, ...]) -> dict[str, list[Any]]:
    """Parts of registered effects by their tables, in the order of ``attachments``; empty tables
    are left out.
    """
    return {
        table: entries
        for table, item in attachments().items()
        if (entries := [part for part in parts if type(part) is item.part])
    }


# Where the finite elements of a shaft end: at the equal parts of every section, and at every part
# of the machine that stands inside one.
#
# An element deflects as under loads at its ends alone. A disc inside it would be held by that
# shape: of a bell halfway along an element of an overhung shaft, frequencies come out several per
# cent too high, however well the rest is divided. So every disc, bearing, sensor, seal and effect
# stands on a node of its own.


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
