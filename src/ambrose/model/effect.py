"""A physical effect: one file below ``model/effects`` that makes one of these, and one line that
registers it.

The plant takes the effect's reaction into its matrices and states, the virtual rig into its linear
part, the uncertainty its channels; ports, machine file, checks, tolerances and saving follow from
the half that ``machine.attachment`` describes. None of these files knows a single effect.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ambrose.core.checks import check_shape, invalid
from ambrose.machine.attachment import Attachment, attached as parts_of
from ambrose.machine.description import MachineDescription, OperatingPoint


@dataclass(frozen=True, slots=True, eq=False)
class Reaction:
    """The force of an effect on the rotor at its p ports, at one operating point, linear:

        f = -(K q + C q' + M q'') + H x,    x' = A x + B q.

    q (p,) [m] displacements against what it stands on, station after station, two axes each.
    stiffness K, damping C, mass M (p, p); states x (n,): A (n, n), B (n, p), H (p, n). What is
    left out is zero. Raises InvalidInput for shapes that do not fit, and figures that are not
    finite.
    """

    stiffness: np.ndarray
    damping: np.ndarray
    mass: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    A: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    B: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    H: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        p, n = len(self.stiffness), len(self.A)
        shapes = {"stiffness": (p, p), "damping": (p, p), "mass": (p, p)}
        shapes |= {"A": (n, n), "B": (n, p), "H": (p, n)}
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name), dtype=float)
            if value.size == 0:
                value = np.zeros(shape)
            object.__setattr__(self, name, check_shape(value, f"{name} of a reaction", str(shape)))

    @property
    def n_ports(self) -> int:
        return len(self.stiffness)

    @property
    def n_states(self) -> int:
        return len(self.A)

    def block(self) -> np.ndarray:
        """[f; x'] = block [q; q'; x] without the mass, (p + n, 2 p + n)."""
        p, n = self.n_ports, self.n_states
        return np.block(
            [
                [-self.stiffness, -self.damping, self.H],
                [self.B, np.zeros((n, p)), self.A],
            ]
        )


@dataclass(frozen=True, slots=True)
class Action:
    """One place where an uncertain quantity acts: its nominal value, times what it makes of the
    signals, is a force.

    port: of the force, as "<station>_<axis>". gradient: (signal, factor), a signal being "q_",
    "qdot_" [m, m/s] or, of an effect with states, "h_" (H x [N]) and a port.
    """

    port: str
    nominal: float
    gradient: tuple[tuple[str, float], ...]


def _no_action(part: Any, point: OperatingPoint, quantity: str) -> Iterator[Action]:
    yield from ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Effect(Attachment):
    """A physical effect at stations of the rotor; the first fields are those of ``Attachment``.

    reaction(part, point): its linear force. It has the same number of states at every point, and
    they mean the same there. over_speed: whether the reaction differs from speed to speed; the
    virtual rig then follows it while the speed changes. knots(part): speeds [rad/s] of its table,
    at which it bends. actions(part, point, quantity): where an
    uncertain quantity of ``quantities`` acts.

    force(x, y, vx, vy, speed, p) -> (fx, fy): its force at the station in its axes where that
    differs from the linear one, as plain Python that numba compiles, with p what
    ``constants(part)`` gives; the virtual rig takes it in place of the reaction. Such an effect
    has one station and no states. x, y [m], vx, vy [m/s], speed [rad/s], forces [N].
    """

    reaction: Callable[[Any, OperatingPoint], Reaction]
    over_speed: bool = False
    knots: Callable[[Any], tuple[float, ...]] = lambda part: ()
    actions: Callable[[Any, OperatingPoint, str], Iterator[Action]] = _no_action
    force: Callable[..., tuple[float, float]] | None = None
    constants: Callable[[Any], tuple[float, ...]] | None = None


def ports_of(effect: Attachment, part: Any) -> tuple[str, ...]:
    """The ports of a part: "<station>_<axis>"."""
    return tuple(f"{s.name}_{axis}" for s in effect.stations(part) for axis in s.axes)


def reactions(
    machine: MachineDescription, point: OperatingPoint
) -> list[tuple[tuple[str, ...], Reaction]]:
    """(ports, reaction) of every part of a registered effect on a machine, at an operating point.

    Raises InvalidInput where the point lies outside of what an effect covers.
    """
    parts = []
    for effect, part in parts_of(machine):
        names, reaction = ports_of(effect, part), effect.reaction(part, point)
        if reaction.n_ports != len(names):
            raise invalid(
                f"the reaction of [[{effect.table}]] {part.name}",
                f"of {reaction.n_ports} ports",
                f"of its {len(names)} ports",
                "make its matrices as large as its stations have axes",
            )
        parts.append((names, reaction))
    return parts


def joined(parts: list[Reaction]) -> Reaction:
    """All reactions as one, port after port and state after state."""
    from scipy.linalg import block_diag

    names: Mapping[str, list[np.ndarray]] = {
        name: [getattr(part, name) for part in parts]
        for name in ("stiffness", "damping", "mass", "A", "B", "H")
    }
    return Reaction(
        **{
            name: block_diag(*blocks) if blocks else np.zeros((0, 0))
            for name, blocks in names.items()
        }
    )


def speed_knots(machine: MachineDescription, low: float, high: float) -> tuple[float, ...]:
    """Speeds between two [rad/s] at which a table of an effect or a seal of the machine bends, or
    rotating damping turns over.
    """
    from ambrose.model.effects.rotor import turn_over_speeds

    known = {w for effect, part in parts_of(machine) for w in effect.knots(part)}
    known |= turn_over_speeds(machine, high)
    known |= _seal_knots(machine, "speed")
    return tuple(sorted(w for w in known if low < w < high))


def pressure_knots(machine: MachineDescription, low: float, high: float) -> tuple[float, ...]:
    """Seal pressures between two [Pa] at which a table of a seal of the machine bends."""
    return tuple(sorted(p for p in _seal_knots(machine, "pressure") if low < p < high))


def _seal_knots(machine: MachineDescription, axis: str) -> set[float]:
    tables = (seal.table for seal in machine.seals if seal.table is not None)
    return {value for table in tables for value in dict(table.axes).get(axis, ())}
