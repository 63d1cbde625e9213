"""Where API's unbalance is placed: by the shape of each forward mode at the maximum continuous
speed, so that the mode is excited as strongly as the amounts allow (recalled, see ``standard``).

* One antinode between the bearings: there, for the weight that all journals carry.
* Several: at each, for the weight of the nearest journal, turned by 180 degrees where the shape
  changes its sign.
* An overhung end whose antinode is the largest, or at least half of it: there, for the mass
  outboard of the bearing.

Antinodes below 10 % of the largest get nothing.
"""

from dataclasses import dataclass, field

import numpy as np

from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.stations import Layout
from ambrose.judge.campbell import OSCILLATORY, damping_ratio
from ambrose.machine.part import ShaftSection

BACKWARD = 0.25  # amplitude-weighted whirl beyond which a mode counts as backward
_OUTER = 1.05  # an overhung end is an antinode where it moves so many times as its journal does
_FLAT = 0.95  # of the largest: stations that move so much alike are one plateau
_SAME = 1e-3  # of the frequency: two poles nearer to each other are one mode
_PER_GRAM_MM = 1e-6  # [kg m]


@dataclass(frozen=True, slots=True, eq=False)
class ShaftMode:
    """A mode of the loop with the shape of the whole shaft.

    pole [1/s]; shape (s, 2) complex displacements of the stations in x and y; whirl in [-1, 1],
    +1 a forward circle; states (n,) of the loop.
    """

    pole: complex
    shape: np.ndarray
    whirl: float
    states: np.ndarray

    @property
    def frequency(self) -> float:
        """Damped natural frequency [rad/s]."""
        return abs(self.pole.imag)

    @property
    def log_decrement(self) -> float:
        """2 pi (-Re)/|Im|."""
        return -2 * np.pi * self.pole.real / abs(self.pole.imag)

    @property
    def forward(self) -> bool:
        """Forward or planar: what unbalance excites and cross-coupling drives. On supports that
        are stiffer one way than the other a mode is planar until cross-coupling turns it.
        """
        return self.whirl > -BACKWARD

    def line(self) -> np.ndarray:
        """The forward part z (s,) = x + j y turned so that its largest value is 1: its real part
        is the bent shaft in the plane that turns with it.
        """
        z = self.shape[:, 0] + 1j * self.shape[:, 1]
        return np.asarray(z / z[np.argmax(np.abs(z))])

    @property
    def way(self) -> str:
        """The direction of whirl in a word."""
        return "forward" if self.whirl > BACKWARD else "planar" if self.forward else "backward"


def shaft_modes(loop: ShaftLoop, highest: float, above: float = 0.0) -> tuple[ShaftMode, ...]:
    """The lateral modes that can ring up to a frequency [rad/s] (and above another), by frequency,
    each followed to the root of the loop's characteristic matrix.

    Left out: overdamped poles (damping ratio above 0.7), those of controller, amplifiers and
    filters that hardly move the shaft, and what is met twice.
    """
    found: list[ShaftMode] = []
    for pole in loop.all_modes().poles:
        if not above < pole.imag <= highest or damping_ratio(np.array([pole]))[0] > OSCILLATORY:
            continue
        # forward and backward circles: two modes of one pole, where nothing tells them apart
        for turn in (-1j, 1j):
            s, x = loop.mode_near(pole * (1 + 1e-6), turn=turn)
            if abs(s - pole) > 0.02 * abs(pole) or not above < s.imag:
                continue  # it fell into a neighbour, which is in the list itself
            mode = _mode(loop, s, x)
            if not any(_same(mode, other) for other in found):
                found.append(mode)
    return tuple(sorted(found, key=lambda mode: mode.frequency))


def _same(one: ShaftMode, other: ShaftMode) -> bool:
    """Whether two modes are one: the same pole, and whirl to the same side."""
    close = abs(one.pole - other.pole) < _SAME * abs(one.pole)
    return close and abs(one.whirl - other.whirl) < 1


def _mode(loop: ShaftLoop, s: complex, x: np.ndarray) -> ShaftMode:
    shape = (loop.read @ x).reshape(-1, 2)
    # whirl: |x + j y| is the backward circle's share of e^{s t}, |x - j y| the forward one's
    ahead = np.abs(shape[:, 0] + 1j * shape[:, 1]) ** 2
    behind = np.abs(shape[:, 0] - 1j * shape[:, 1]) ** 2
    total = float((ahead + behind).sum())
    whirl = float((ahead - behind).sum()) / total if total else 0.0
    return ShaftMode(s, shape, whirl, x)


@dataclass(frozen=True, slots=True)
class Weight:
    """One unbalance: at a station, amount [kg m], angle [rad] from the first; carried [kg]: the
    static load that the amount was computed from.
    """

    station: int
    amount: float
    angle: float
    carried: float


@dataclass(frozen=True, slots=True)
class UnbalanceCase:
    """A set of unbalances that turn together, and for which mode or purpose it was placed.

    line (s,): the shape along the shaft that it was placed on; heading: what that shape is, in
    words.
    """

    name: str
    weights: tuple[Weight, ...]
    why: str
    line: np.ndarray = field(default_factory=lambda: np.zeros(0), compare=False, repr=False)
    heading: str = ""

    @property
    def total(self) -> float:
        """Sum of the amounts [kg m]."""
        return sum(weight.amount for weight in self.weights)

    def forces(self, stations: int) -> np.ndarray:
        """Complex forces per square of the speed (2 s,) [kg m]: forward circles (1, -j)."""
        force = np.zeros(2 * stations, complex)
        for weight in self.weights:
            amplitude = weight.amount * np.exp(1j * weight.angle)
            force[2 * weight.station] += amplitude
            force[2 * weight.station + 1] += -1j * amplitude
        return force


def amount(carried: float, speed: float) -> float:
    """U_a [kg m]: twice the residual amount of a plane that carries ``carried`` [kg], at the
    maximum continuous speed [rad/s].
    """
    residual = standard.residual_amount(carried, speed / standard.RPM)
    return standard.ANALYSIS_FACTOR * residual * _PER_GRAM_MM


def mode_name(mode: ShaftMode) -> str:
    """What its placement is called: "10898 rpm mode"."""
    return f"{standard.rpm(mode.frequency)} rpm mode"


def place(layout: Layout, mode: ShaftMode, speed: float) -> tuple[UnbalanceCase, ...]:
    """The sets of unbalance that excite a mode, after the rules of this file's head; speed
    [rad/s]: the maximum continuous one.

    Where an overhung antinode governs, a second set is placed between the bearings if the shape
    has an antinode there: a rotor that bends freely has both.
    """
    heading = f"{standard.rpm(mode.frequency)} rpm, log decrement {mode.log_decrement:.3g}"
    return _placed(layout, mode.line().real, mode_name(mode), heading, speed)


def place_rigid(layout: Layout, speed: float) -> tuple[UnbalanceCase, ...]:
    """The sets for a rotor of which no mode can ring: by the same rules on the shapes of the rigid
    rotor, moving in parallel and tilting about the middle of its journals. Assumed: the standard
    knows placements by modes alone.
    """
    places = [journal.position for journal in layout.journals]
    arm = layout.positions - 0.5 * (min(places) + max(places))
    shapes = {
        "rigid rotor in parallel": np.ones_like(arm),
        "rigid rotor tilting": arm / np.abs(arm).max(),
    }
    return tuple(
        case
        for name, line in shapes.items()
        for case in _placed(layout, line, name, f"{name}, no oscillatory mode", speed)
    )


def _placed(
    layout: Layout, line: np.ndarray, name: str, heading: str, speed: float
) -> tuple[UnbalanceCase, ...]:
    """The sets for a shape line (s,) along the shaft."""
    ends = _overhung_ends(layout, line)
    inner = _inner_antinodes(layout, line)
    largest = max(abs(line[k]) for k in (*ends, *inner))
    inside = [k for k in inner if abs(line[k]) >= standard.LEAST_ANTINODE * largest]
    overhung = [k for k in ends if abs(line[k]) >= standard.OVERHANG * largest]
    sets = []
    if overhung:
        outer = [
            (k, _mass_outboard(layout, right=bool(layout.overhang_right[k]))) for k in overhung
        ]
        sets.append(("", "overhung antinode: amount for the mass outboard of the bearing", outer))
    if len(inside) == 1:
        whole = sum(journal.weight for journal in layout.journals)
        why = "one antinode between the bearings: amount for the static load of all journals"
        sets.append((", between bearings" if overhung else "", why, [(inside[0], whole)]))
    elif inside:
        each = [(k, _nearest_load(layout, k)) for k in inside]
        why = "antinodes between the bearings: amounts for the static load of the nearest journal"
        sets.append((", between bearings" if overhung else "", why, each))
    return tuple(
        UnbalanceCase(
            name + where,
            _weights(line, chosen, speed),
            why,
            line,
            f"{heading.partition(',')[0]}{where}" if where else heading,
        )
        for where, why, chosen in sets
    )


def _weights(line: np.ndarray, chosen: list[tuple[int, float]], speed: float) -> tuple[Weight, ...]:
    """Amounts at stations, each for the load [kg] that it carries, turned with the shape's sign."""
    first = np.sign(line[chosen[0][0]])
    return tuple(
        Weight(k, amount(carried, speed), 0.0 if np.sign(line[k]) == first else np.pi, carried)
        for k, carried in chosen
    )


def _overhung_ends(layout: Layout, line: np.ndarray) -> list[int]:
    """The ends of the shaft that move more than their journal: overhung antinodes."""
    places = [journal.position for journal in layout.journals]
    found = []
    for end, journal in ((0, min(places)), (len(line) - 1, max(places))):
        at = layout.nearest(journal)
        if at != end and abs(line[end]) > _OUTER * abs(line[at]):
            found.append(end)
    return found


def _inner_antinodes(layout: Layout, line: np.ndarray) -> list[int]:
    """One station between the outermost journals for each stretch in which ``line`` (s,) keeps its
    sign: where it is largest; on a plateau, as of a rigid rotor that moves in parallel, the middle.
    """
    places = [journal.position for journal in layout.journals]
    inside = np.arange(layout.nearest(min(places)), layout.nearest(max(places)) + 1)
    cuts = np.flatnonzero(np.diff(np.sign(line[inside]))) + 1
    found = []
    for stretch in np.split(inside, cuts):
        size = np.abs(line[stretch])
        top = int(np.argmax(size))
        if 0 < top < len(stretch) - 1 and size[top] > size[[0, -1]].max() / _FLAT:
            found.append(int(stretch[top]))
        else:
            flat = layout.positions[stretch[size >= _FLAT * size[top]]]
            found.append(layout.nearest(0.5 * (flat[0] + flat[-1])))
    return found


def _nearest_load(layout: Layout, station: int) -> float:
    at = layout.positions[station]
    return min(layout.journals, key=lambda journal: abs(journal.position - at)).weight


def _mass_outboard(layout: Layout, *, right: bool) -> float:
    """Mass [kg] of shaft and discs outboard of the outermost journal on one side, whatever the
    mesh.
    """
    machine = layout.machine
    places = [journal.position for journal in layout.journals]
    border = max(places) if right else min(places)
    low, high = (border, np.inf) if right else (-np.inf, border)
    discs = sum(disc.mass for disc in machine.discs if low < disc.position < high)
    return float(discs + sum(_mass_within(section, low, high) for section in machine.shaft))


def _mass_within(section: ShaftSection, low: float, high: float) -> float:
    """Mass [kg] of what a section has between two axial places [m]."""
    start = max(low, section.start)
    end = min(high, section.start + section.length)
    if end <= start:
        return 0.0

    # m = rho int pi/4 (D^2 - d^2) dx; diameters are linear, so that Simpson's rule is exact
    areas = []
    for x in (start, 0.5 * (start + end), end):
        _, bore, outer = section.diameters((x - section.start) / section.length)
        areas.append(0.25 * np.pi * (outer**2 - bore**2))
    first, middle, last = areas
    return float(section.material.density * (end - start) * (first + 4 * middle + last) / 6)


def span_middle(layout: Layout) -> int:
    """The station halfway between the outermost journals."""
    places = [journal.position for journal in layout.journals]
    return layout.nearest(0.5 * (min(places) + max(places)))
