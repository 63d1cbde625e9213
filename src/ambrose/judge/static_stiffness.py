"""Whether a reference controller's gains outweigh the magnets' negative stiffness at rest."""

from __future__ import annotations

import numpy as np

from ambrose.law.pid import channel_chains
from ambrose.machine.machine import Machine
from ambrose.model.static_load import magnet_coefficients


def stiffness_margin(machine: Machine) -> float | None:
    """The least K_p k_i / k_s of the channels of the reference controller; below 1 a bearing pushes
    away at rest.
    """
    if machine.reference is None:
        return None
    k_i, k_s = magnet_coefficients(machine, machine.operation.design)
    gains = np.array([gain for gain, _ in channel_chains(machine.reference, machine.axes)])
    if machine.reference.coordinates != "axes":
        k_i, k_s = np.full(len(gains), k_i.min()), np.full(len(gains), k_s.max())
    with np.errstate(divide="ignore"):
        return float((gains * k_i / k_s).min())


def below_stiffness(margin: float) -> str:
    """What to say of a margin below one."""
    return (
        f"K_p k_i is below k_s ({margin:.3g} of it): the [controller] leaves negative stiffness "
        "and holds nothing; raise gain "
        f"{1.5 / margin:.2g} times or more"
    )
