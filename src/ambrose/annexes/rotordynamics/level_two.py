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

from ambrose.annexes.rotordynamics.components import forces_of_components
from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.placement import ShaftMode
from ambrose.model.basis import modes_of
from ambrose.model.effects.support import foundation

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
    machine = plant.machine
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

    for component in forces_of_components(loop, s, x):
        work = float(np.real((s * component.motion).conj() @ component.force)) / 2
        power[component.name] = power.get(component.name, 0.0) + work

    omega = abs(s.imag)
    return tuple(
        Share(name, float(-np.pi * value / (omega * energy))) for name, value in power.items()
    )
