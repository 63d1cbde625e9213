"""The virtual rig as arrays: what does not change during a run, and its state.

The rotor is that of model/assemble.py in its free modes (p per plane), without the bearings' linear
negative stiffness, seals and registered effects: those act as forces at S stations, in the order
bearings, effects (couplings among them), seals, discs, each with two axes.
"""

import hashlib
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ambrose.core.checks import invalid
from ambrose.machine.attachment import attached
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import bending_modes_of, gyroscopic_of, seal_model
from ambrose.model.effect import joined, reactions
from ambrose.model.effects import (
    amplifier,
    magnet,
    rotor as rotors,
    seal,
    seal_rational,
    sensor,
    stations as unbalance,
    touchdown,
)
from ambrose.model.effects.rotor import (
    STANDARD_GRAVITY,
    Rotor,
    displacement_row,
    finite_element_rotor,
    free_modes,
    gravity_load,
)
from ambrose.model.effects.stations import foundation
from ambrose.model.plant import ports, sensor_ports
from ambrose.model.static_load import operating_magnets

RIG_MODES = 3  # bending modes per plane, as many as identification models
# of every touchdown bearing: race x, y, ring x, y, their velocities likewise, spin of the race
BEHIND = 9
_BLOW = 10.0  # times its share of the weight: what rolling elements usually carry at first
_NO_BIAS_LAG = 5000.0  # rad/s at which the bias current follows an ideal amplifier


Arrays = TypeVar("Arrays", bound=tuple[Any, ...])


def in_rows(values: Arrays) -> Arrays:
    """The same named tuple with every array row by row in memory. The compiled functions take no
    other: each layout of each array would be compiled on its own, for a quarter of a minute.
    """
    laid = (np.ascontiguousarray(v) if isinstance(v, np.ndarray) else v for v in values)
    return type(values)(*laid)


class Constants(NamedTuple):
    """p modes per plane, b bearings, a = 2 b axes, S stations."""

    stiffness: np.ndarray  # (p,) squared frequencies of the free rotor [rad2/s2]
    damping: np.ndarray  # (p,) 2 zeta omega [rad/s]
    # (p, 2) of that what turns with the rotor, viscous and hysteretic, or (0, 2)
    rotating: np.ndarray
    gyroscopic: np.ndarray  # (p, p) g in G = g (x) [[0, 1], [-1, 0]] [-]
    shape: np.ndarray  # (S, p) modal deflection at the stations [1/sqrt(kg)]
    sensor_shape: np.ndarray  # (c / 2, p) of every sensor pair; c sensors
    # (c / 2, 2) cosine and sine of the angle from x to its first sensor
    sensor_direction: np.ndarray
    sensor_angle: np.ndarray  # (c / 2,) that angle [rad]
    mean: np.ndarray  # (a, c) measurement from the single sensors
    direction: np.ndarray  # (S, 2) cosine and sine of the angle from x to a station's first axis
    angle: np.ndarray  # (S,) that angle [rad]
    magnet: np.ndarray  # (b, 10) physics.magnet.parameters
    touchdown: np.ndarray  # (b, 21) physics.touchdown.parameters
    # states of race and ring behind every contact, 9 (``BEHIND``), or 0 where none has any
    behind: int
    stator: np.ndarray  # (b, 4) physics.touchdown.inverses
    contact_step: float  # [s] that race and ring need in contact, infinite without
    # (2 t + e, 4 t + e) [f; x'] by [q; q'; x] of the registered effects at t stations, e states, in
    # their axes, at the point
    reaction: np.ndarray
    reaction_mass: np.ndarray  # (2 t, 2 t) [kg]
    # (t, 2) addresses of a station's force where that is not linear, 0 elsewhere, and its constants
    force_at: np.ndarray
    force_constants: np.ndarray  # (t, most)
    amplifier: np.ndarray  # (a, 6) physics.amplifier.parameters
    bias_rate: float  # [rad/s] at which the bias current follows
    sensor: np.ndarray  # (c, 6) physics.sensor.parameters
    runout: np.ndarray  # (h, 3) physics.sensor.harmonics, pair after pair
    runout_start: np.ndarray  # (c / 2 + 1,)
    # (seals, l, l + 1) A with b beside it of the seals with states; idle where a seal has fewer
    seal_lags: np.ndarray
    weight: np.ndarray  # (2 p,) modal force
    # (m, 2) squared frequency [rad2/s2] and damping [rad/s] of every coordinate of the supports
    support: np.ndarray
    # (S, 2, m) how far in x and y what a station acts against moves with it [1/sqrt(kg)]
    support_shape: np.ndarray
    sensor_support: np.ndarray  # (c / 2, 2, m) the same of the sensors


class Work(NamedTuple):
    """Scratch arrays, so that the compiled code allocates nothing; n states, m of the
    controller.
    """

    place: np.ndarray  # (S, 2) displacement of the stations in x and y [m]
    velocity: np.ndarray  # (S, 2) [m/s]
    force: np.ndarray  # (S, 2) [N]
    modal: np.ndarray  # (2 p + m,)
    command: np.ndarray  # (a,) what the amplifiers are told [A]
    magnet: np.ndarray  # (a,) forces [N]
    slopes: np.ndarray  # (3, n)
    sampled: np.ndarray  # (2, a) measurement [m] and acting controller output [A]
    ahead: np.ndarray  # (m,)
    attached: np.ndarray  # (4 t + e,) what the registered effects see: q, q', x
    pull: np.ndarray  # (2 t,) their forces in their axes [N]
    asked: np.ndarray  # (7,) x, y, vx, vy, speed for a force at an address, and its answer
    asked_at: np.ndarray  # (1,) the address of that
    depth: np.ndarray  # (2, b) penetration of the touchdown bearings before and after a step [m]


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A machine ready to run: its constants, the names of its stations' axes (ports) in their
    order, the rotor's mass [kg].
    """

    machine: Machine
    point: OperatingPoint
    constants: Constants
    port_names: tuple[str, ...]
    mass: float

    # what follows from these, once: a start is found in thousands of slopes
    axes: tuple[str, ...] = field(init=False)
    modes: int = field(init=False)  # per plane
    # displacements in the state: modes in both planes, and supports
    coordinates: int = field(init=False)
    # how many stations the registered effects have; they follow those of the bearings
    attached_stations: int = field(init=False)
    # where these are in the state, one after the other behind displacements, velocities and
    # amplifiers: bias currents, the sensors' lagged signals, (seals,) the states of the registered
    # effects, races and rings of the touchdown bearings
    bias: slice = field(init=False)
    sensed: slice = field(init=False)
    attached: slice = field(init=False)
    behind: slice = field(init=False)
    states: int = field(init=False)  # length of the state

    def __post_init__(self) -> None:
        k, bearings = self.constants, len(self.machine.bearings)
        axes, stations = self.port_names[: 2 * bearings], len(k.force_at)
        coordinates = 2 * len(k.stiffness) + len(k.support)
        bias = _after(2 * coordinates + 2 * len(axes), len(axes))
        sensed = _after(bias.stop, len(k.sensor))
        effects = len(k.reaction) - 2 * stations
        attached = _after(sensed.stop + 2 * k.seal_lags[..., 0].size, effects)
        behind = _after(attached.stop, k.behind * bearings)
        for name, value in (
            ("axes", axes),
            ("modes", len(k.stiffness)),
            ("coordinates", coordinates),
            ("attached_stations", stations),
            ("bias", bias),
            ("sensed", sensed),
            ("attached", attached),
            ("behind", behind),
            ("states", behind.stop),
        ):
            object.__setattr__(self, name, value)

    def work(self, controller_states: int = 0) -> Work:
        """Fresh scratch arrays."""
        stations, a = len(self.constants.shape), len(self.axes)
        asked = np.zeros(7)
        return Work(
            place=np.zeros((stations, 2)),
            velocity=np.zeros((stations, 2)),
            force=np.zeros((stations, 2)),
            modal=np.zeros(self.coordinates),
            command=np.zeros(a),
            magnet=np.zeros(a),
            slopes=np.zeros((3, self.states)),
            sampled=np.zeros((2, a)),
            ahead=np.zeros(controller_states),
            attached=np.zeros(self.constants.reaction.shape[1]),
            pull=np.zeros(2 * self.attached_stations),
            asked=asked,
            asked_at=np.array([asked.ctypes.data], dtype=np.int64),
            depth=np.zeros((2, len(self.constants.touchdown))),
        )


def _after(start: int, count: int) -> slice:
    """The next ``count`` places of the state, from ``start``."""
    return slice(start, start + count)


def build(
    machine: Machine, point: OperatingPoint | None = None, bending_modes: int | None = None
) -> Rig:
    """The rig of a machine with rigid-body and ``bending_modes`` modes per plane (None: 3, fewer
    where the mesh has not so many), at a bias current and seals of ``point``. Raises InvalidInput.
    """
    point = machine.operation.nominal if point is None else point
    rotor = finite_element_rotor(machine)
    available = bending_modes_of(rotor)
    bending_modes = min(RIG_MODES, available) if bending_modes is None else bending_modes
    if not 0 <= bending_modes <= available:
        raise invalid(
            "bending_modes",
            bending_modes,
            f"between 0 and {available}",
            "refine the mesh or keep fewer modes",
        )
    modes = free_modes(rotor, bending_modes)
    frequencies = modes.frequencies[0::2]
    places, sensed = ports(machine), sensor_ports(machine)
    angles = np.array([port.direction for port in places[0::2]])
    bearings = machine.bearings
    magnets = operating_magnets(machine, point.bias_current)
    rates = [
        w
        for w in (machine.amplifier.bandwidth, machine.amplifier.natural_frequency)
        if w is not None
    ]
    single = sensor.channels(machine.sensor_pairs, machine.axes)
    tracks = [sensor.harmonics(pair) for pair in machine.sensor_pairs]  # run-out
    base = foundation(machine)
    reaction = joined([item for _, item in reactions(machine, point)])
    force_at, force_constants = _forces(machine)
    shapes = _deflections(rotor, [port.position for port in places[0::2]], modes.shapes)
    landing = [touchdown.parameters(machine, b) for b in bearings]
    # landing: numbers of the touchdown bearings, with what a radial force makes the rotor do there;
    # heavy [N]: load of rolling elements for which race and ring are stepped
    met = [*zip(landing, (shapes[: len(bearings)] ** 2).sum(axis=1).tolist(), strict=True)]
    mass = float(1 / np.abs(modes.shapes[:, 0]).max() ** 2)
    heavy = _BLOW * STANDARD_GRAVITY * mass / len(bearings)
    values = Constants(
        stiffness=frequencies**2,
        damping=2 * modes.damping_ratios(machine)[0::2] * frequencies,
        rotating=modes.rotating(machine)[0::2] if machine.rotating_share else np.zeros((0, 2)),
        gyroscopic=gyroscopic_of(rotor, modes)[0::2, 1::2],
        shape=shapes,
        sensor_shape=_deflections(rotor, [port.position for port in sensed[0::2]], modes.shapes),
        sensor_direction=np.array(
            [[np.cos(port.direction), np.sin(port.direction)] for port in sensed[0::2]]
        ),
        sensor_angle=np.array([port.direction for port in sensed[0::2]]),
        mean=sensor.means(machine.sensor_pairs, machine.axes),
        direction=np.column_stack([np.cos(angles), np.sin(angles)]),
        angle=angles,
        magnet=np.array([item.of_force for item in magnets]),
        touchdown=np.array(landing, dtype=float),
        behind=BEHIND * any(item.moves for item in landing),
        stator=np.array([touchdown.inverses(*pair) for pair in met], dtype=float),
        contact_step=min(
            (touchdown.longest_steps(*pair, heavy)[0] for pair in met if pair[0].moves),
            default=np.inf,
        ),
        reaction=reaction.block(),
        reaction_mass=reaction.mass,
        force_at=force_at,
        force_constants=force_constants,
        amplifier=np.array(
            [
                amplifier.parameters(machine.amplifier, b.max_current, item.of_force[0], k_i)
                for b, item in zip(bearings, magnets, strict=True)
                for k_i in item.coefficients.force_per_current
            ]
        ),
        bias_rate=rates[0] if machine.amplifier.order != "none" and rates else _NO_BIAS_LAG,
        sensor=np.array([sensor.parameters(pair, way) for _, pair, way in single], dtype=float),
        runout=np.vstack(tracks),
        runout_start=np.cumsum([0, *(len(track) for track in tracks)]),
        seal_lags=_seal_lags(machine, point),
        weight=modes.shapes.T @ gravity_load(rotor, machine.gravity_direction),
        support=np.column_stack([base.stiffness, base.damping]),
        support_shape=base.stator_rows([port.name.rpartition("_")[0] for port in places[0::2]]),
        sensor_support=base.sensor_rows([port.name.rpartition("_")[0] for port in sensed[0::2]]),
    )
    return Rig(
        machine,
        point,
        in_rows(values),
        tuple(port.name for port in places),
        mass,
    )


def _deflections(rotor: Rotor, positions: list[float], shapes: np.ndarray) -> np.ndarray:
    """Modal deflection (S, p) at axial positions [m]."""
    return np.array(
        [displacement_row(rotor, position, 0.0) @ shapes[:, 0::2] for position in positions]
    )


def _forces(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Addresses (t, 2) of the forces of registered effects that are not linear and of their
    constants, and the constants (t, most).
    """
    forces: list[tuple[Any, tuple[float, ...]]] = []
    for effect, part in attached(machine):
        stations = len(effect.stations(part))
        constants = () if effect.constants is None else tuple(effect.constants(part))
        if effect.force is not None and stations != 1:
            raise invalid(
                f"the stations of [[{effect.table}]] {part.name}",
                stations,
                "one, as its force is not linear",
                "register an effect per station",
            )
        forces += [(effect.force, constants)] * stations
    most = max((len(row) for _, row in forces), default=0)
    values = np.zeros((len(forces), most))
    addresses = np.zeros((len(forces), 2), dtype=np.int64)
    for i, (force, row) in enumerate(forces):
        values[i, : len(row)] = row
        if force is not None:
            addresses[i] = _address(force, len(row)), values.ctypes.data + i * values.strides[0]
    return addresses, values


@cache
def _address(force: Any, count: int) -> int:
    """Where a force of ``model.effect.Effect`` is, compiled: int f(constants, asked, -, answer)."""
    return _callback(force, count).address


@cache
def _callback(force: Any, count: int) -> Any:
    from numba import carray, cfunc, njit, types  # type: ignore[attr-defined]

    inner = njit(force)

    def asked(constants: Any, asked: Any, unused: Any, answer: Any) -> int:
        p, q = carray(constants, count), carray(asked, 5)
        fx, fy = inner(q[0], q[1], q[2], q[3], q[4], p)
        out = carray(answer, 2)
        out[0], out[1] = fx, fy
        return 0

    numbers = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
    return cfunc(types.int32(numbers, numbers, numbers, numbers))(asked)


def _seal_lags(machine: Machine, point: OperatingPoint) -> np.ndarray:
    """The dynamics (seals, l, l + 1) of the seals' states, the same during the whole run; padded
    with states that stay zero.
    """
    with_lag = [seal_rational.has_states(item) for item in machine.seals]
    most = max(
        (item.poles for item, states in zip(machine.seals, with_lag, strict=True) if states),
        default=0,
    )
    result = np.tile(np.column_stack([-np.eye(most), np.zeros(most)]), (len(with_lag), 1, 1))
    for lags, item, states in zip(result, machine.seals, with_lag, strict=True):
        if states:
            n = item.poles
            rows = seal_rational.rows(seal_model(machine, item, point))
            lags[:n, :n], lags[:n, -1] = rows[:, :-1], rows[:, -1]
    return result


def kept() -> bool:
    """Whether an earlier run has left the functions of ``compiled`` on this computer."""
    from ambrose.rig.engine.products import is_kept

    return all(map(is_kept, compiled()))


@cache
def compiled() -> tuple[Any, Any]:
    """The compiled functions ``advance`` and ``slope`` of kernel.py; on a computer that never ran
    them their first call takes some forty seconds of a processor.
    """
    from ambrose.rig.engine import (
        axial_kernel,
        controller as sampled,
        exponential,
        kernel as rig_kernel,
        products,
        products as inlined,
    )

    physics = (amplifier, magnet, rotors, seal, seal_rational, sensor, touchdown, unbalance)
    modules = (rig_kernel, axial_kernel, exponential, inlined, products, sampled, *physics)
    digest = hashlib.sha256()
    for module in modules:
        digest.update(Path(str(module.__file__)).read_bytes())
    return rig_kernel.entry_points(int.from_bytes(digest.digest()[:6], "big"))
