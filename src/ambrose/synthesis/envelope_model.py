"""Several operating points as one uncertain plant: what changes from point to point becomes real
parameters.

In common states (``free_mode_reduction``) a plant is one matrix [A B; C D]. The principal
components of its changes over the points are a few matrices E_j, each of low rank: gyroscopic
coupling and the seals at their place. The plants lie within M_0 + sum_j delta_j E_j, |delta_j| <=
1, so that D-K iteration knows all points at once; it counts combinations, too, that no point has,
and treats the real delta_j as complex.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.lft import GeneralizedPlant, RealBlock
from ambrose.core.statespace import StateSpace
from ambrose.law.design_problem import open_model
from ambrose.machine.description import Tolerance
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import channels

# components of at least this share of the largest one; verification on the full plants says what
# the rest does
_KEPT = 0.1
_RANK = 1e-6  # of the largest singular value, below which one is rounding
_NOTHING = 1e-9  # SI; half-width of a relative tolerance where the nominal value is zero


def envelope_model(
    plants: Sequence[Plant], tolerances: Sequence[Tolerance] | None = None
) -> GeneralizedPlant:
    """``open_model`` with the blocks "envelope 1", ... that span the plants, then those of the
    tolerances (None: without).

    plants: reduced in common states, at two operating points at least. Relative tolerances keep
    their share of each point's own value. Raises InvalidInput where the plants do not differ or
    have not the same states.
    """
    models = [
        open_model(
            plant,
            None if tolerances is None else [_held(plant, item) for item in tolerances],
            tolerances is not None,
        )
        for plant in plants
    ]
    first = models[0]
    n = first.system.n_states
    if len({model.system.n_states for model in models}) > 1:
        raise InvalidInput(
            "the plants of the operating points have different numbers of states, as seals with "
            "states under pressure alone "
            "give; design for the points under pressure, or take method 'tuned'"
        )
    whole = np.array(
        [
            np.block([[model.system.A, model.system.B], [model.system.C, model.system.D]])
            for model in models
        ]
    )
    shape = whole.shape[1:]
    middle = (whole.max(axis=0) + whole.min(axis=0)) / 2
    U, size, Vh = np.linalg.svd((whole - middle).reshape(len(whole), -1), full_matrices=False)
    if len(models) < 2 or size[0] <= 1e-12 * np.abs(middle).max():
        raise InvalidInput(
            "the plant is the same at every operating point of the machine; leave envelope out"
        )
    blocks = []
    into = []
    out = []
    for j in np.flatnonzero(size >= _KEPT * size[0]):
        along = U[:, j] * size[j]
        half, centre = np.ptp(along) / 2, (along.max() + along.min()) / 2
        direction = Vh[j].reshape(shape)
        middle = middle + centre * direction
        u, s, vh = np.linalg.svd(half * direction)
        rank = int((s > _RANK * s[0]).sum())
        into.append(u[:, :rank] * np.sqrt(s[:rank]))
        out.append(np.sqrt(s[:rank])[:, None] * vh[:rank])
        blocks.append(RealBlock(f"envelope {j + 1}", rank))
    L, R = np.hstack(into), np.vstack(out)
    w, z = ([f"{letter}_envelope_{k + 1}" for k in range(L.shape[1])] for letter in "wz")
    system = StateSpace(
        middle[:n, :n],
        np.hstack([L[:n], middle[:n, n:]]),
        np.vstack([R[:, :n], middle[n:, :n]]),
        np.block([[np.zeros((len(w), len(w))), R[:, n:]], [L[n:], middle[n:, n:]]]),
        [*w, *first.system.inputs],
        [*z, *first.system.outputs],
    )
    return GeneralizedPlant(
        system, [*w, *first.w], first.u, [*z, *first.z], first.y, [*blocks, *first.blocks]
    )


def _held(plant: Plant, tolerance: Tolerance) -> Tolerance:
    """The tolerance at a plant; a relative one of what is zero there is as good as none."""
    if tolerance.relative is None or any(
        channel.nominal != 0 for channel in channels(plant, tolerance.parameter)
    ):
        return tolerance
    return replace(tolerance, relative=None, absolute=_NOTHING)
