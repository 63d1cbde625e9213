"""Stability, Level II: every mode with seals, stages and controller as it runs, and what each
component takes out of it, or puts in.

For a mode q(t) = Re(q e^{s t}) with s = sigma + j omega the mean energy of rotor (and supports),
E = (|s q|^2_M + |q|^2_K)/4, changes at 2 sigma E: that is the sum of the mean powers of all other
forces on it,

    2 sigma E = sum_c P_c,    P_c = Re((s q_c)^H f_c)/2,

with f_c the force of component c at its ports and q_c the motion there. The log decrement
delta = -2 pi sigma/omega is therefore a sum, delta_c = -pi P_c/(omega E). Gyroscopic forces do no
work; the negative stiffness of a magnet belongs to the magnet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.placement import ShaftMode
from ambrose.model.assemble import seal_coefficients, seal_model
from ambrose.model.basis import modes_of
from ambrose.model.effect import reactions
from ambrose.model.effects import seal as seals
from ambrose.model.effects import seal_rational
from ambrose.model.effects.support import foundation
from ambrose.model.static_load import magnet_coefficients

INTERNAL = "rotor's own damping"


@dataclass(frozen=True, slots=True)
class Share:
    """What a component adds to a mode's log decrement; negative: it destabilises."""

    component: str
    log_decrement: float


def shares(loop: ShaftLoop, mode: ShaftMode) -> tuple[Share, ...]:
    """The share of every component; their sum is the mode's log decrement.

    Supports and casing modes count with the rotor: their energy is in E, their damping in
    "supports".
    """
    plant = loop.plant
    machine, point = plant.machine, plant.point
    s, x = mode.pole, mode.states
    modes = modes_of(machine, plant.rotor_model, None)
    base = foundation(machine)
    count = len(modes.frequencies) + len(base)
    q = x[:count]  # modal displacements: the plant's first states
    stiffness = np.concatenate([modes.frequencies**2, base.stiffness])
    energy = float((abs(s) ** 2 * np.abs(q) ** 2 + stiffness * np.abs(q) ** 2).sum()) / 4
    power = {
        INTERNAL: -float(
            (
                2
                * modes.damping_ratios(machine)
                * modes.frequencies
                * np.abs(s * q[: len(modes.frequencies)]) ** 2
            ).sum()
        )
        / 2
    }
    if len(base):
        power["supports"] = -float((base.damping * np.abs(s * q[-len(base) :]) ** 2).sum()) / 2

    def motion(names: list[str]) -> np.ndarray:
        rows = [plant.system.outputs.index(f"q_{name}") for name in names]
        return plant.system.C[rows] @ x

    def add(component: str, at: np.ndarray, force: np.ndarray) -> None:
        work = float(np.real((s * at).conj() @ force)) / 2
        power[component] = power.get(component, 0.0) + work

    # magnets: k_i i + k_s q along each axis
    if machine.bearings:
        k_i, k_s = magnet_coefficients(machine, point)
        at = motion(list(plant.axes))
        current = loop.currents(s, x) if loop.law is not None else np.zeros(len(at))
        force = k_i * current + k_s * at
        for k, bearing in enumerate(machine.bearings):
            axes = slice(2 * k, 2 * k + 2)
            add(f"magnet {bearing.name}", at[axes], force[axes])

    # registered effects: -(K + s D + s^2 M) q + H (s I - A)^-1 B q
    for names, reaction in reactions(machine, point):
        at = motion(list(names))
        dynamic = reaction.stiffness + s * reaction.damping + s**2 * reaction.mass
        force = -dynamic @ at
        if reaction.n_states:
            inner = np.linalg.solve(s * np.eye(reaction.n_states) - reaction.A, reaction.B @ at)
            force = force + reaction.H @ inner
        if any(
            matrix.any() for matrix in (reaction.stiffness, reaction.damping, reaction.mass)
        ) or (reaction.n_states):
            add(names[0].rpartition("_")[0], at, force)

    # seals: -(K + s C + s^2 M) q, and the states of those that depend on the frequency
    for item in machine.seals:
        at = motion([f"{item.name}_x", f"{item.name}_y"])
        rational = seal_rational.has_states(item)
        constant = (
            seal_model(machine, item, point).static if rational else seal_coefficients(item, point)
        )
        stiff, damping, mass = seals.matrices(constant)
        force = -(stiff + s * damping + s**2 * mass) @ at
        if rational and point.seal_pressure > 0:
            system = seal_rational.system(seal_model(machine, item, point), item.name)
            given = [system.inputs.index(f"q_{item.name}_{axis}") for axis in "xy"]
            taken = [system.outputs.index(f"h_{item.name}_{axis}") for axis in "xy"]
            inner = np.linalg.solve(s * np.eye(system.n_states) - system.A, system.B[:, given] @ at)
            force = force + system.C[taken] @ inner + system.D[np.ix_(taken, given)] @ at
        add(f"seal {item.name}", at, force)

    omega = abs(s.imag)
    return tuple(
        Share(name, float(-np.pi * value / (omega * energy))) for name, value in power.items()
    )
