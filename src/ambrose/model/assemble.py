"""Machine and operating point -> Plant, in three steps: the rotor with its attachments, its state
space, the wiring.

The rotor is written in mass-orthonormal modes of the free rotor: those up to 100 kHz and the static
compliance of all others (``model.basis``). There the rigid-body modes have exactly no stiffness; in
nodal coordinates rounding of the element stiffness (norm 1e14) would disturb them in the sixth
digit. Its states are the modal displacements q and q'/s, with scales s of the free rotor alone:
they mean the same at every speed, seal pressure and bias current, so that a run-up may carry them
from one plant to the next. Poles of the slow modes are good to 1e-8 rad/s
(tests/model/test_assemble.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from scipy.linalg import block_diag

from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput
from ambrose.core.mechanical import SecondOrder, to_common_statespace
from ambrose.core.statespace import StateSpace, connect, rename, static_gain
from ambrose.machine.axial import AxialMachine
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import BENDING, operating_point, uncertain_modes
from ambrose.machine.seals import Seal
from ambrose.model.axial import wiring
from ambrose.model.basis import bending_modes_of, gyroscopic_of, modes_of, rows_in
from ambrose.model.effect import Reaction, reactions
from ambrose.model.effects import amplifier, seal, seal_rational, sensor
from ambrose.model.effects.rotor import Rotor, finite_element_rotor
from ambrose.model.effects.seal_rational import has_states
from ambrose.model.effects.support import foundation
from ambrose.model.plant import Plant
from ambrose.model.ports import ports, sensor_ports, supported_ports
from ambrose.model.static_load import magnet_coefficients

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
    machine: Machine, point: OperatingPoint | str | None = None, *, every_mode: bool = False
) -> Plant:
    """The full plant at an operating point, or its label (default: the machine's nominal one).

    Its states mean the same at every operating point, see ``attached_statespace``. every_mode: in
    all modes of the mesh (4 DOF per node) in place of those that matter (``model.basis``, which
    says how little they differ). Raises InvalidInput where the point lies outside a seal's table or
    a bearing's measured bias currents.
    """
    point = machine.operation.nominal if point is None else operating_point(machine, point)
    with named_point(point):
        if isinstance(machine, AxialMachine):
            return wire(machine, point, wiring.rotor_statespace(machine, point))
        rotor = finite_element_rotor(machine)
        modes = 2 * rotor.n_nodes - 2 if every_mode else None
        return wire(machine, point, attached_statespace(machine, point, rotor, modes))


def attached_statespace(
    machine: Machine, point: OperatingPoint, rotor: Rotor, bending_modes: int | None = None
) -> StateSpace:
    """``attached_rotor`` as a state space, and the states of seals and effects after its own.

    States: modal displacements q of the free rotor and q'/s, s (n,) [rad/s] being ``state_scales``.
    Neither speed nor seal nor bearing moves them.
    """
    attached = attached_rotor(machine, point, rotor, bending_modes)
    scales = state_scales(machine, rotor, bending_modes)
    return with_states(machine, point, to_common_statespace(attached, point.speed, scales))


def state_scales(machine: Machine, rotor: Rotor, bending_modes: int | None = None) -> np.ndarray:
    """The scale s (n,) [rad/s] of each velocity state: the free mode's or support's frequency, 300
    rad/s at least.
    """
    frequencies = modes_of(machine, rotor, bending_modes).frequencies
    return np.maximum(
        np.concatenate([frequencies, np.sqrt(foundation(machine).stiffness)]), _RIGID_SCALE
    )


def attached_rotor(
    machine: Machine, point: OperatingPoint, rotor: Rotor, bending_modes: int | None = None
) -> SecondOrder:
    """The rotor plus bearing stiffness, seals, couplings and modal damping, in free-rotor modes,
    with all ports.

    Coordinates: four rigid-body modes, then ``bending_modes`` per plane by ascending frequency
    (None: the full model's, ``model.basis``), then those of the supports
    (``model.effects.support``). Inputs f_<port> [N], which act between rotor and stator as q_<port>
    is measured, and o_<port> [N] on the rotor alone where the stator can move; outputs q_<port> and
    s_<channel> [m] (``sensor_ports``); velocity outputs qdot_<port> [m/s]. A free bending mode that
    a tolerance names has ports too, bending_<k>_x and _y: the force on its mass-orthonormal
    coordinate, and the coordinate.
    """
    modes = modes_of(machine, rotor, bending_modes)
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

    # free modes and free supports: M = I, 2 zeta omega, omega^2
    mass = np.eye(count + len(base))
    damping = np.diag([*2 * modes.damping_ratios(machine) * modes.frequencies, *base.damping])
    stiffness = np.diag([*modes.frequencies**2, *base.stiffness])

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
    """Names of a rotor's inputs within the plant: F_<port>, and the external f_<port> where it acts
    on the rotor alone.
    """
    if isinstance(machine, AxialMachine):
        return wiring.rotor_inputs(machine)
    inputs = [f"F_{name}" for name in (*(p.name for p in ports(machine)), *mode_ports(machine))]
    return inputs + [f"f_{name}" for name in supported_ports(machine)]


def force_sums(machine: Machine) -> dict[str, list[str]]:
    """The rotor's force F_<port> is the external force, at a bearing plus the magnet's current
    force m_<axis>.

    Where the stator can move F_<port> acts on it, too, and the external force has an input of its
    own (``rotor_inputs``).
    """
    if isinstance(machine, AxialMachine):
        return wiring.force_sums(machine)
    names, on = [p.name for p in ports(machine)], supported_ports(machine)
    return {f"F_{n}": [f"f_{n}"] * (n not in on) + [f"m_{n}"] * (n in machine.axes) for n in names}


def magnets(machine: Machine, point: OperatingPoint) -> StateSpace:
    """The current force of every axis, i_<axis> [A] -> m_<axis> [N]; the displacement force is part
    of the rotor.
    """
    if isinstance(machine, AxialMachine):
        return wiring.magnets(machine, point)
    return static_gain(
        np.diag(magnet_coefficients(machine, point)[0]),
        [f"i_{a}" for a in machine.axes],
        [f"m_{a}" for a in machine.axes],
    )
