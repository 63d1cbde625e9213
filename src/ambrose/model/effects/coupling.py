"""Flexible coupling to ground: f = -stiffness x - damping x' on the rotor, in the coupling's
axes.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ambrose.core.checks import check_shape
from ambrose.machine.attachment import TILTED
from ambrose.machine.description import Coupling, OperatingPoint
from ambrose.machine.validation.signs import not_positive
from ambrose.model.effect import Action, Effect, Reaction


def matrices(coupling: Coupling) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness (2, 2) [N/m] and damping (2, 2) [N s/m] in (zeta, eta). Raises InvalidInput for
    figures that are not finite.
    """
    stiffness = check_shape(coupling.stiffness, f"the stiffness of coupling {coupling.name}", "(2)")
    damping = check_shape(coupling.damping, f"the damping of coupling {coupling.name}", "(2)")
    return np.diag(stiffness.astype(float)), np.diag(damping.astype(float))


def _reaction(coupling: Coupling, point: OperatingPoint) -> Reaction:
    return Reaction(*matrices(coupling))


def _findings(where: str, coupling: Coupling) -> Iterator[str]:
    remedy = "a passive coupling holds back"
    yield from not_positive(where, coupling, remedy, "stiffness", "damping", zero=True)


def _actions(coupling: Coupling, point: OperatingPoint, quantity: str) -> Iterator[Action]:
    """-stiffness q, or -damping q', along either axis."""
    signal = "q" if quantity == "stiffness" else "qdot"
    for axis, value in zip(TILTED, getattr(coupling, quantity), strict=True):
        port = f"{coupling.name}_{axis}"
        yield Action(port, float(value), ((f"{signal}_{port}", -1.0),))


COUPLING = Effect(
    table="coupling",
    part=Coupling,
    findings=_findings,
    quantities={"stiffness": ("stiffness", TILTED), "damping": ("damping", TILTED)},
    reaction=_reaction,
    actions=_actions,
)
