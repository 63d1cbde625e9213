"""Machine and operating point -> Plant, in three steps: the rotor with its attachments, its state
space, the wiring.

The rotor is written in mass-orthonormal modes of the free rotor: those up to 100 kHz and the static
compliance of all others (``model.assemble``). There the rigid-body modes have exactly no stiffness;
in nodal coordinates rounding of the element stiffness (norm 1e14) would disturb them in the sixth
digit. Its states are the modal displacements q and q'/s, with scales s of the free rotor alone:
they mean the same at every speed, seal pressure and bias current, so that a run-up may carry them
from one plant to the next. Poles of the slow modes are good to 1e-8 rad/s
(tests/model/test_assemble.py).
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.linalg import block_diag

from ambrose.core.checks import InvalidInput, invalid, names_wrong_types
from ambrose.core.mechanical import SecondOrder, to_common_statespace
from ambrose.core.statespace import StateSpace, connect, rename, static_gain
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import FINE_MESH_MODES, LEAST_MODES
from ambrose.machine.parameters import BENDING, operating_point, uncertain_modes
from ambrose.machine.part import Seal
from ambrose.model.axial import rotor_statespace
from ambrose.model.effect import Reaction, reactions
from ambrose.model.effects import amplifier, seal, seal_rational, sensor
from ambrose.model.effects.rotor import (
    FreeModes,
    Rotor,
    displacement_row,
    finite_element_rotor,
    free_modes,
    plane_rows,
    residual_modes,
    to_plane,
)
from ambrose.model.effects.seal_rational import has_states
from ambrose.model.effects.stations import foundation
from ambrose.model.plant import Plant, Port, highest_verified, ports, sensor_ports, supported_ports
from ambrose.model.static_load import each_magnet, magnet_coefficients

# The coordinates of the full model: the lowest modes of the free rotor, and what the rest of them
# yields at the ports.
#
# Kept are all bending modes up to 100 kHz, 24 to 64 per plane; of a mesh with few modes all. The
# static displacements that forces at the ports and the gyroscopic moments of the lowest modes leave
# in the rest of them (residual attachment modes: MacNeal 1971, Rubin 1975) are coordinates like the
# others: made orthonormal in the mass, with the frequencies that they have among themselves. So the
# compliance of all modes is in the model, and what is cut off begins with the square of the
# frequency.


_HIGHEST = 2e5 * np.pi  # [rad/s] up to which every bending mode is kept
_TURNING = 3  # bending modes, beside tilting, whose gyroscopic moments have residual modes
_SMALL_MESH = 40  # bending modes per plane up to which all are kept


def bending_modes_of(rotor: Rotor) -> int:
    """How many true bending modes per plane the full model has; the mesh has 2 N - 2."""
    available = rotor.most_bending
    if available <= _SMALL_MESH or rotor.stated is not None:
        return available
    below = free_modes(rotor, min(available, FINE_MESH_MODES)).frequencies[4::2] <= _HIGHEST
    return min(max(int(below.sum()), LEAST_MODES), len(below))


def judged_bending(machine: Machine) -> np.ndarray:
    """The bending frequencies (k,) [rad/s] at which the sensitivity is judged."""
    if not machine.lateral:
        return np.zeros(0)  # rigid along its axis
    rotor = finite_element_rotor(machine)
    frequencies = free_modes(rotor, bending_modes_of(rotor)).frequencies[4::2]
    return frequencies[frequencies <= highest_verified(machine)]


def seen_modes(machine: Machine, count: int) -> Iterator[tuple[str, int, float, float, float]]:
    """Bearing, bending mode, its frequency [rad/s], and its deflection at the magnet and as the
    sensors read it, both of its largest one, for the lowest ``count`` modes of the rotor at rest.
    """
    rotor = finite_element_rotor(machine)
    modes = free_modes(rotor, min(count, bending_modes_of(rotor)))
    shapes = in_plane(modes)[:, 2:]
    for bearing in machine.bearings:
        pairs = [pair for pair in machine.sensor_pairs if pair.bearing == bearing.name]
        places = [bearing.position, *(pair.position for pair in pairs)]
        values = plane_rows(rotor, places)[0] @ shapes / np.abs(shapes[0::2]).max(axis=0)
        measured = np.array([pair.weight for pair in pairs]) @ values[1:]
        for k, frequency in enumerate(modes.frequencies[4::2]):
            yield bearing.name, k + 1, float(frequency), float(values[0, k]), float(measured[k])


def driven_modes(machine: Machine) -> dict[int, tuple[float, str]]:
    """The bending modes within the loop's reach that are driven by what damps the others: frequency
    [rad/s], and the bearing whose magnet and sensor move most against each other.

    A force -d y' of every bearing, y what its sensors read, gives mode k the damping
    d sum w_magnet w_sensor: where the sum is below zero it is driven.
    """
    corner = machine.amplifier.bandwidth or machine.amplifier.natural_frequency or np.inf
    found: dict[int, list[tuple[float, float, str]]] = {}
    for bearing, mode, frequency, at, measured in seen_modes(
        machine, int((judged_bending(machine) <= corner).sum())
    ):
        found.setdefault(mode, []).append((at * measured, frequency, bearing))
    return {
        mode: min(items)[1:] for mode, items in found.items() if sum(item[0] for item in items) < 0
    }


_FAINT = 0.25  # of a mode's largest deflection: a magnet there has a sixteenth of its authority
_PART = 0.5  # of what sensors at the magnets would read, by which a mode is damped
_LOUD = 1.8  # times that: the gain that the rigid modes need is too much for this one
_AWAY = 0.4  # of the largest deflection, at least, where a magnet is to stand instead


def badly_placed(machine: Machine) -> dict[int, tuple[float, str, dict[str, float]]]:
    """The bending modes within the loop's reach that magnets or sensors can hardly damp: frequency
    [rad/s], what stands wrong ("magnet", "sensor", "loud sensor"), and of which bearings, with the
    place [m] to which it is to be moved.

    Magnets where all stand near its node; sensors where what they read damps the mode less than
    ``_PART`` of what sensors at the magnets would (the sum of w_magnet w_sensor against that of
    w_magnet^2), of the bearings whose own part is so small; loud sensors where it is more than
    ``_LOUD`` times as much, as beyond magnets near the shaft's ends.
    """
    corner = machine.amplifier.bandwidth or machine.amplifier.natural_frequency or np.inf
    count = int((judged_bending(machine) <= corner).sum())
    rows: dict[int, list[tuple[str, float, float]]] = {}
    frequencies: dict[int, float] = {}
    for bearing, mode, frequency, at, measured in seen_modes(machine, count):
        frequencies[mode] = frequency
        rows.setdefault(mode, []).append((bearing, at**2, at * measured))
    places = {bearing.name: bearing.position for bearing in machine.bearings}
    found: dict[int, tuple[float, str, dict[str, float]]] = {}
    for mode, own in rows.items():
        if max(at for _, at, _ in own) < _FAINT**2:
            moved = {name: _off_node(machine, mode, places[name]) for name, _, _ in own}
            found[mode] = frequencies[mode], "magnet", moved
            continue
        best = sum(at for _, at, _ in own)
        damped = sum(part for _, _, part in own)
        if damped < _PART * best:
            lacking = {name: places[name] for name, at, part in own if part < _PART * at}
            found[mode] = frequencies[mode], "sensor", lacking
        elif damped > _LOUD * best:
            loud = {name: places[name] for name, at, part in own if part > _LOUD * at}
            found[mode] = frequencies[mode], "loud sensor", loud
    return found


def _off_node(machine: Machine, mode: int, place: float) -> float:
    """The place [m] nearest to one at which a bending mode moves by ``_AWAY`` of its largest
    deflection.
    """
    rotor = finite_element_rotor(machine)
    shape = in_plane(free_modes(rotor, mode))[:, 1 + mode]
    along = np.linspace(0.02, 0.98, 193) * machine.length
    w = np.abs(plane_rows(rotor, along)[0] @ shape) / np.abs(shape[0::2]).max()
    return float(min(along[w >= _AWAY], key=lambda at: abs(at - place), default=place))


def modes_judged(plant: Plant) -> int:
    """How many bending modes per plane a model needs for the sensitivity to be judged on it: all
    of ``judged_bending``, and one more.
    """
    available = bending_modes_of(plant.rotor_model)
    frequencies = free_modes(plant.rotor_model, available).frequencies[4::2]
    return min(int((frequencies <= highest_verified(plant.machine)).sum()) + 1, available)


def modes_of(
    machine: Machine, rotor: Rotor, bending_modes: int | None, residual: bool = False
) -> FreeModes:
    """The lowest ``bending_modes`` per plane, with the residual ones of all others if ``residual``;
    None: the modes of the full model, true ones and then residual ones.
    """
    if bending_modes is not None and not residual:
        return free_modes(rotor, bending_modes)
    return _with_residual(rotor, bending_modes, port_positions(machine))


def port_positions(machine: Machine) -> tuple[float, ...]:
    """The axial places [m] of all ports and sensors, ascending, each once."""
    return tuple(sorted({port.position for port in (*ports(machine), *sensor_ports(machine))}))


@lru_cache(maxsize=16)
def _with_residual(rotor: Rotor, count: int | None, forces: tuple[float, ...]) -> FreeModes:
    """With forces at axial positions [m]. Computed once; the arrays are read-only."""
    kept = bending_modes_of(rotor) if count is None else count
    true = free_modes(rotor, kept)
    if kept == rotor.most_bending:
        return true
    # loads: a unit force at every place, gyroscopic moments of tilting and the first bending modes
    turning = in_plane(true)[:, 1 : 2 + _TURNING].T @ rotor.plane_gyroscopic
    frequencies, plane = residual_modes(
        rotor, kept, np.vstack([plane_rows(rotor, forces)[0], turning])
    )

    # columns in turn: a mode in x, the same in y
    both = np.stack([to_plane(plane, "x"), to_plane(plane, "y")], axis=2).reshape(
        2 * len(plane), -1
    )
    arrays = (
        np.hstack([true.shapes, both]),
        np.concatenate([true.frequencies, np.repeat(frequencies, 2)]),
    )
    for array in arrays:
        array.flags.writeable = False
    # of few that are kept, the others' compliance rings within a sampled loop's reach
    return FreeModes(*arrays, compliance=0 if count is None else 2 * len(frequencies))


@lru_cache(maxsize=64)
def rows_in(rotor: Rotor, modes: FreeModes, places: tuple[Port, ...]) -> np.ndarray:
    """The rows (p, k) that read the displacement at ports from mode coordinates; read-only."""
    whole = [displacement_row(rotor, p.position, p.direction) for p in places]
    rows = np.reshape(whole, (len(places), len(modes.shapes))) @ modes.shapes
    rows.flags.writeable = False
    return rows


@lru_cache(maxsize=16)
def gyroscopic_of(rotor: Rotor, modes: FreeModes) -> np.ndarray:
    """The gyroscopic matrix (k, k) in mode coordinates, which come in x/y pairs of equal shape;
    read-only.

    Both planes share one symmetric matrix g, and G = g (x) [[0, 1], [-1, 0]]: an eighth of the work
    of the whole product.
    """
    # g = Phi^T G Phi of one plane
    plane = in_plane(modes)
    whole = np.kron(plane.T @ rotor.plane_gyroscopic @ plane, np.array([[0.0, 1.0], [-1.0, 0.0]]))
    whole.flags.writeable = False
    return whole


def in_plane(modes: FreeModes) -> np.ndarray:
    """The shapes (2N, k / 2) of the x plane, in [w, theta] per node."""
    plane = np.empty((len(modes.shapes) // 2, modes.shapes.shape[1] // 2))
    # x and beta of the x modes
    plane[0::2], plane[1::2] = modes.shapes[0::4, 0::2], modes.shapes[3::4, 0::2]
    return plane


_RIGID_SCALE = 300.0  # [rad/s] of a rigid mode's velocity state: the pace of a levitated rotor


@contextmanager
def named_point(point: OperatingPoint) -> Iterator[None]:
    """Around what reads coefficients at a point: a complaint names the point."""
    try:
        yield
    except InvalidInput as error:
        if not point.label:
            raise
        raise InvalidInput(f'operating point "{point.label}": {error}') from error


@names_wrong_types
def assemble(
    machine: Machine,
    point: OperatingPoint | str | None = None,
    *,
    every_mode: bool = False,
    beside: Plant | None = None,
) -> Plant:
    """The full plant at an operating point, or its label (default: the machine's nominal one).

    Its states mean the same at every operating point, see ``attached_statespace``. every_mode: in
    all modes of the mesh (4 DOF per node) in place of those that matter (``model.assemble``, which
    says how little they differ). beside: the plant at another speed, whose wiring is taken where it
    is the same. Raises InvalidInput where the point lies outside a seal's table or a bearing's
    measured bias currents.
    """
    point = machine.operation.nominal if point is None else operating_point(machine, point)
    with named_point(point):
        if not machine.lateral:
            return wire(machine, point, rotor_statespace(machine, point))
        rotor = finite_element_rotor(machine)
        modes = rotor.most_bending if every_mode else None
        attached = attached_statespace(machine, point, rotor, modes)
        return _wired_alike(machine, point, attached, beside) or wire(machine, point, attached)


def attached_statespace(
    machine: Machine,
    point: OperatingPoint,
    rotor: Rotor,
    bending_modes: int | None = None,
    residual: bool = False,
) -> StateSpace:
    """``attached_rotor`` as a state space, and the states of seals and effects after its own.

    States: modal displacements q of the free rotor and q'/s, s (n,) [rad/s] being ``state_scales``.
    Neither speed nor seal nor bearing moves them.
    """
    attached = attached_rotor(machine, point, rotor, bending_modes, residual)
    scales = state_scales(machine, rotor, bending_modes, residual)
    return with_states(machine, point, to_common_statespace(attached, point.speed, scales))


def state_scales(
    machine: Machine, rotor: Rotor, bending_modes: int | None = None, residual: bool = False
) -> np.ndarray:
    """The scale s (n,) [rad/s] of each velocity state: the free mode's or support's frequency, 300
    rad/s at least.
    """
    frequencies = modes_of(machine, rotor, bending_modes, residual).frequencies
    return np.maximum(
        np.concatenate([frequencies, np.sqrt(foundation(machine).stiffness)]), _RIGID_SCALE
    )


def attached_rotor(
    machine: Machine,
    point: OperatingPoint,
    rotor: Rotor,
    bending_modes: int | None = None,
    residual: bool = False,
) -> SecondOrder:
    """The rotor plus bearing stiffness, seals, couplings and modal damping, in free-rotor modes,
    with all ports.

    Coordinates: four rigid-body modes, then ``bending_modes`` per plane by ascending frequency
    (None: the full model's, ``model.assemble``; residual: and what all others yield), then those of
    the supports (``model.effects.stations``). Inputs f_<port> [N], which act between rotor and
    stator as q_<port> is measured, and o_<port> [N] on the rotor alone where the stator can move;
    outputs q_<port> and s_<channel> [m] (``sensor_ports``); velocity outputs qdot_<port> [m/s]. A
    free bending mode that a tolerance names has ports too, bending_<k>_x and _y: the force on its
    mass-orthonormal coordinate, and the coordinate.
    """
    if machine.measured_rotor is not None and not machine.measured_rotor.holds_at(point.speed):
        raise invalid(
            "the speed of a measured rotor",
            f"{point.speed:g} rad/s",
            f"{machine.measured_rotor.speed:g} rad/s, at which it was measured",
            "measure there, or describe shaft and discs",
        )
    modes = modes_of(machine, rotor, bending_modes, residual)
    places, sensed = ports(machine), sensor_ports(machine)

    # Rows over (modes, supports): N of the ports, S of the sensors; ``alone`` reads the rotor
    # without its stator.
    N, S = rows_in(rotor, modes, places), rows_in(rotor, modes, sensed)
    base, count = foundation(machine), len(modes.frequencies)
    on = supported_ports(machine)
    alone = np.hstack([N[[p.name in on for p in places]], np.zeros((len(on), len(base)))])

    # how far the stator under a port or sensor moves along its direction, to be subtracted
    stators, fixed = (
        np.einsum("pd,pdm->pm", np.column_stack([np.cos(angles), np.sin(angles)]), rows)
        for angles, rows in (
            (
                [p.direction for p in places],
                base.stator_rows([p.name.rpartition("_")[0] for p in places]),
            ),
            (
                [p.direction for p in sensed],
                base.sensor_rows([p.name.rpartition("_")[0] for p in sensed]),
            ),
        )
    )
    N, S = np.hstack([N, -stators]), np.hstack([S, -fixed])
    rows = {p.name: row for p, row in zip(places, N, strict=True)}

    # free modes and free supports: M = I, 2 zeta omega, omega^2; what turns with the rotor couples
    # x and y of a mode, which are neighbours
    mass = np.eye(count + len(base))
    braking, circulatory = modes.damping(machine, point.speed)
    damping = np.diag([*braking, *base.damping])
    stiffness = np.diag([*modes.frequencies**2, *base.stiffness])
    x, y = np.arange(0, count, 2), np.arange(1, count, 2)
    stiffness[x, y], stiffness[y, x] = circulatory[x], -circulatory[y]

    # bearings: -k_s N^T N at every axis
    control = np.reshape([rows[axis] for axis in machine.axes], (-1, count + len(base)))
    stiffness -= control.T @ (magnet_coefficients(machine, point)[1][:, None] * control)

    # registered effects and seals at their pairs of ports: N^T (K, D, M) N
    for names, reaction in reactions(machine, point):
        pair = np.array([rows[name] for name in names])
        stiffness += pair.T @ reaction.stiffness @ pair
        damping += pair.T @ reaction.damping @ pair
        if reaction.mass.any():
            mass += pair.T @ reaction.mass @ pair
    for annular in machine.seals:
        pair = np.array([rows[f"{annular.name}_x"], rows[f"{annular.name}_y"]])
        k, d, m = seal.matrices(constant_coefficients(machine, annular, point))
        stiffness += pair.T @ k @ pair
        damping += pair.T @ d @ pair
        if m.any():
            mass += pair.T @ m @ pair

    # ports of single modes: unit rows; zero where the mode is beyond those in use or the coordinate
    # is a support's
    modal_basis = np.eye(max(bending_modes_of(rotor) * 2 + 4, count), len(mass)) * (
        np.arange(len(mass)) < count
    )
    N = np.vstack([N, *(modal_basis[2 + 2 * k : 4 + 2 * k] for k in uncertain_modes(machine))])
    every = [*(p.name for p in places), *mode_ports(machine)]

    # forces enter where displacements are read: B = (N, alone)^T; outputs N and S; velocities N
    return SecondOrder(
        mass,
        damping,
        block_diag(gyroscopic_of(rotor, modes), np.zeros((len(base), len(base)))),
        stiffness,
        np.vstack([N, alone]).T,
        np.vstack([N, S]),
        N,
        tuple(f"f_{name}" for name in every) + tuple(f"o_{name}" for name in on),
        tuple(f"q_{name}" for name in every) + tuple(f"s_{p.name}" for p in sensed),
        tuple(f"qdot_{name}" for name in every),
    )


def mode_ports(machine: Machine) -> tuple[str, ...]:
    """The ports of the free bending modes that the machine's tolerances name; they are the rotor's
    alone, not the plant's.
    """
    return tuple(f"{BENDING}{k}_{plane}" for k in uncertain_modes(machine) for plane in "xy")


def with_states(machine: Machine, point: OperatingPoint, rotor: StateSpace) -> StateSpace:
    """A rotor (full or reduced, of ``attached_rotor``) with the states of its frequency-dependent
    seals, then those of registered effects, after its own.

    Outputs d_<seal>_<axis> and e_<seal>_<axis> [N] of ``seal_rational.system`` are added, and
    h_<port> [N], the force of the states of an effect.
    """
    seals = [item for item in machine.seals if has_states(item) and point.seal_pressure > 0]
    places = [f"{item.name}_{axis}" for item in seals for axis in "xy"]
    parts = [seal_rational.system(seal_model(machine, item, point), item.name) for item in seals]
    outputs = [name for part in parts for name in part.outputs if not name.startswith("h_")]
    for names, reaction in reactions(machine, point):
        if reaction.n_states:
            parts.append(_states_of(reaction, names))
            places += names
            outputs += parts[-1].outputs
    if not parts:
        return rotor
    return connect(
        [rename(rotor, {f"f_{place}": f"F_{place}" for place in places}), *parts],
        inputs=list(rotor.inputs),
        outputs=[*rotor.outputs, *outputs],
        sums={f"F_{place}": [f"f_{place}", f"h_{place}"] for place in places},
    )


def _states_of(reaction: Reaction, names: Sequence[str]) -> StateSpace:
    """The part of a reaction with states: q_<port> [m] -> h_<port> [N] = H x."""
    return StateSpace(
        reaction.A,
        reaction.B,
        reaction.H,
        np.zeros((len(names), len(names))),
        [f"q_{name}" for name in names],
        [f"h_{name}" for name in names],
    )


def part_states(machine: Machine, point: OperatingPoint) -> int:
    """How many states seals and registered effects add to the rotor's."""
    seals = sum(2 * item.poles for item in machine.seals if has_states(item))
    others = sum(reaction.n_states for _, reaction in reactions(machine, point))
    return others + (seals if point.seal_pressure > 0 else 0)


def seal_model(machine: Machine, item: Seal, point: OperatingPoint) -> seal_rational.RationalSeal:
    """The rational model of a seal with states, at the point's pressure and speed, on the poles of
    ``seal_poles``.
    """
    return seal_rational.rational(item, point.seal_pressure, point.speed, seal_poles(machine, item))


def seal_poles(machine: Machine, item: Seal) -> np.ndarray:
    """The poles (n,) [rad/s] of a seal with states: those of the machine's nominal speed, common to
    all operating points.

    Poles of every speed's own would come and go in pairs, and the seal's states would mean
    something else from speed to speed.
    """
    return seal_rational.poles_of(item, machine.operation.nominal.speed)


def constant_coefficients(
    machine: Machine, item: Seal, point: OperatingPoint
) -> seal.SealCoefficients:
    """A seal's coefficients at the point; of one with states those beside the states."""
    if has_states(item):
        return seal_model(machine, item, point).static
    return seal_coefficients(item, point)


def seal_coefficients(item: Seal, point: OperatingPoint) -> seal.SealCoefficients:
    """The seal's coefficients at the point; those that depend on the frequency are read at its
    whirl frequency.
    """
    frequency = point.speed if point.whirl_frequency is None else point.whirl_frequency
    return seal.coefficients(item, point.seal_pressure, point.speed, frequency)


def _wired_alike(
    machine: Machine, point: OperatingPoint, rotor: StateSpace, other: Plant | None
) -> Plant | None:
    """The plant of a rotor that differs from that of another plant in A alone; None where it does
    not, or the wiring does.
    """
    if other is None or rotor.A.shape != other.rotor.A.shape:
        return None
    n, wiring_of = (
        rotor.n_states,
        [magnet_coefficients(machine, at)[0] for at in (point, other.point)],
    )
    same = [
        (other.system.A[:n, :n], other.rotor.A),
        wiring_of,
        *((getattr(rotor, k), getattr(other.rotor, k)) for k in "BCD"),
    ]
    if other.machine is not machine or not all(np.array_equal(*pair) for pair in same):
        return None
    A = other.system.A.copy()
    A[:n, :n] = rotor.A
    return replace(other, point=point, rotor=rotor, system=replace(other.system, A=A))


def wire(
    machine: Machine,
    point: OperatingPoint,
    rotor: StateSpace,
    bending_modes: int | None = None,
) -> Plant:
    """Amplifiers and sensors around a rotor state space (full or reduced)."""
    names = tuple(p.name for p in ports(machine))
    system = connect(
        [
            rename(rotor, rotor_inputs(machine)),
            amplifier.linearised(
                machine.amplifier, machine.axes, magnet_coefficients(machine, point)[0]
            ),
            magnets(machine, point),
            sensor.linearised(machine.sensor_pairs, machine.axes),
        ],
        inputs=plant_inputs(machine.axes, names),
        outputs=plant_outputs(machine.axes, names),
        sums={**force_sums(machine), **{f"F_{name}": [] for name in mode_ports(machine)}},
    )
    return Plant(machine, point, system, rotor, names, bending_modes)


def plant_inputs(axes: Sequence[str], names: Sequence[str]) -> list[str]:
    """The plant's input names: currents, then forces."""
    return [f"u_{a}" for a in axes] + [f"f_{n}" for n in names]


def plant_outputs(axes: Sequence[str], names: Sequence[str]) -> list[str]:
    """The plant's output names: measurements, coil currents, displacements, velocities."""
    return [f"{kind}_{a}" for kind in "yi" for a in axes] + [
        f"{kind}_{n}" for kind in ("q", "qdot") for n in names
    ]


def rotor_inputs(machine: Machine) -> list[str]:
    """Names of a rotor's inputs within the plant: F_<port>, also where a magnet alone pulls, and
    the external f_<port> where it acts on the rotor alone.
    """
    inputs = [*force_sums(machine), *(f"F_{name}" for name in mode_ports(machine))]
    return inputs + [f"f_{name}" for name in supported_ports(machine)]


def force_sums(machine: Machine) -> dict[str, list[str]]:
    """The rotor's force F_<port> is the external force, at a bearing plus the magnet's current
    force m_<axis>; where a magnet alone pulls, its current force.

    Where the stator can move F_<port> acts on it, too, and the external force has an input of its
    own (``rotor_inputs``).
    """
    names, pull = [p.name for p in ports(machine)], machine.magnets
    pushed = {*names} - {*supported_ports(machine)}
    return {
        f"F_{n}": [f"f_{n}"] * (n in pushed) + [f"m_{n}"] * (n in pull)
        for n in dict.fromkeys((*names, *pull))
    }


def magnets(machine: Machine, point: OperatingPoint) -> StateSpace:
    """The current force of every magnet, i_<axis> [A] -> m_<magnet> [N]; the displacement force is
    part of the rotor.
    """
    k_i, axes = each_magnet(machine, point)[0], machine.axes
    onto = np.repeat(np.eye(len(axes)), k_i.shape[1], axis=0) * k_i.reshape(-1, 1)
    return static_gain(onto, [f"i_{a}" for a in axes], [f"m_{name}" for name in machine.magnets])
