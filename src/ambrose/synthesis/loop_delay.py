"""The delay of a sampled loop inside the design model, so that a controller is designed for the loop that it will run in.

A controller that runs at the sample time T and gives its currents n samples after it read the displacements acts (n + 1/2) T
late: the half sample is the mean age of a held value. The delay enters the design plant as an all-pass before the amplifiers.
"""

from __future__ import annotations

from ambrose.core.lft import GeneralizedPlant
from ambrose.core.sampling import pade
from ambrose.core.statespace import append, connect, rename


def apply_delay(model: GeneralizedPlant, delay: float, order: int = 1) -> GeneralizedPlant:
    """The model with every current u delayed by ``delay`` [s], as a Pade all-pass of ``order`` states per axis; 0: unchanged.

    order 1 is 0.004 degrees off at 100 Hz for 0.15 ms, 4 degrees at 1 kHz. Raises InvalidInput.
    """
    if delay == 0:
        return model
    passes = append(*[pade(delay, order, name, f"late_{name}") for name in model.u])
    inner = rename(model.system, {name: f"late_{name}" for name in model.u}, {})
    system = connect([passes, inner], inputs=list(model.system.inputs), outputs=list(model.system.outputs))
    return GeneralizedPlant(system, model.w, model.u, model.z, model.y, model.blocks)
