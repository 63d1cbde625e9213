"""The design problem: a plant, its uncertainty and the weights as one generalized plant (Lauridsen
2017, P5, figs. 8 and 9).

::

                     w_delta          z_delta
                        |                ^
               w1       v                |                 w2
                |    +---------------------+                |
               D_u   |                     |               D_e
         u      v v  |  amplifiers, rotor, |  y             v
      ----+---->o--->|  seals, sensors     |-------->o----->o--> (-1) --+--> err [m], to K
          |          +---------------------+                            |
          +--> 1/D_u --> W_u --> z2                                     +--> 1/D_e --> W_p --> z1

    err = -(y + D_e w2)      v = u + D_u w1      z1 = W_p err / D_e      z2 = W_u u / D_u

u [A] and err [m] are physical, so that K in u = K err is the controller itself; w1, w2, z1, z2 [-]
are in units of the largest current D_u and the largest error D_e. The performance that is asked for
is an H-infinity norm below 1 from (w1, w2) to (z1, z2): S_o below 1/W_p, K S_o below 1/W_u, and the
same with the plant before it for disturbances of the current.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.lft import FullBlock, GeneralizedPlant
from ambrose.core.sampling import pade
from ambrose.core.statespace import StateSpace, append, connect, rename, select, static_gain
from ambrose.law.weights import Weights, machine_weights
from ambrose.machine.description import Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import uncertain as uncertain_plant

PERFORMANCE = "performance"
# relative; narrower tolerances are left to verification, which takes them all
LEAST_TOLERANCE = 0.05


def design_plant(
    plant: Plant | GeneralizedPlant,
    weights: Weights | None = None,
    tolerances: Sequence[Tolerance] | None = None,
    uncertain: bool = True,
) -> GeneralizedPlant:
    """The interconnection of this file's diagram around a plant.

    plant: a Plant, usually reduced, bending modes kept or not; or a GeneralizedPlant with inputs
    u_<axis> [A] and outputs y_<axis> [m], whose blocks are its uncertainty. weights: default those
    of the plant's machine. tolerances: default those of the machine; ``uncertain`` False leaves the
    uncertainty out, and there are no blocks.

    w: the blocks' signals, then w1_<axis>, w2_<axis>; z: the blocks' signals, then z1_<axis>,
    z2_<axis>; u: u_<axis> [A]; y: err_<axis> [m]. Raises InvalidInput for a plant that carries no
    uncertainty or no weights where they are asked for.
    """
    if weights is None:
        if not isinstance(plant, Plant):
            raise InvalidInput(
                "no weights were given, and a generalized plant carries none; give them"
            )
        weights = machine_weights(plant.machine)
    model = open_model(plant, tolerances, uncertain)
    axes = [name.removeprefix("u_") for name in model.u]
    w = list(model.w)
    z = list(model.z)
    w1, w2, z1, z2 = ([f"{letter}_{axis}" for axis in axes] for letter in ("w1", "w2", "z1", "z2"))

    # u -> v and y -> g, so that the disturbances come between
    loop = rename(
        model.system, {f"u_{a}": f"v_{a}" for a in axes}, {f"y_{a}": f"g_{a}" for a in axes}
    )

    # current = D_u w1, offset = D_e w2
    size = [
        weights.current_scale * weights.current_disturbance,
        weights.error_scale * weights.output_disturbance,
    ]
    disturbances = static_gain(
        np.diag(np.repeat(size, len(axes))),
        [*w1, *w2],
        [f"{kind}_{a}" for kind in ("current", "offset") for a in axes],
    )

    # z1 = W_p err / D_e, z2 = W_u u / D_u
    shaped = [
        _weight(weight, scale, f"{source}_{axis}", f"{letter}_{axis}")
        for weight, scale, source, letter in (
            (weights.performance, weights.error_scale, "err", "z1"),
            (weights.control, weights.current_scale, "u", "z2"),
        )
        for axis in axes
    ]

    # v = u + D_u w1, err = -(g + D_e w2)
    system = connect(
        [loop, disturbances, append(*shaped)],
        inputs=[*w, *w1, *w2, *(f"u_{a}" for a in axes)],
        outputs=[*z, *z1, *z2, *(f"err_{a}" for a in axes)],
        sums={
            **{f"v_{a}": [f"u_{a}", f"current_{a}"] for a in axes},
            **{f"err_{a}": [f"-g_{a}", f"-offset_{a}"] for a in axes},
        },
    )

    errors = [f"err_{a}" for a in axes]
    return GeneralizedPlant(
        system, [*w, *w1, *w2], list(model.u), [*z, *z1, *z2], errors, model.blocks
    )


def unit_problem(
    plant: Plant | GeneralizedPlant, tolerances: Sequence[Tolerance] | None = None
) -> GeneralizedPlant:
    """The design problem with all weights and scales 1: its closed loop holds the bare transfer
    functions.
    """
    one = static_gain([[1.0]])
    return design_plant(plant, Weights(one, one, 1.0, 1.0), tolerances)


def _weight(weight: StateSpace, scale: float, source: str, output: str) -> StateSpace:
    return StateSpace(weight.A, weight.B, weight.C / scale, weight.D / scale, [source], [output])


def open_model(
    plant: Plant | GeneralizedPlant, tolerances: Sequence[Tolerance] | None, uncertain: bool
) -> GeneralizedPlant:
    """The blocks' signals and u_<axis> -> the blocks' signals and y_<axis>; nothing else."""
    if isinstance(plant, Plant):
        u, y = list(plant.named("u")), list(plant.named("y"))
        if not uncertain:
            return GeneralizedPlant(plant.system, [], u, [], y)
        model = uncertain_plant(plant, tolerances)
    else:
        model = plant
        if tolerances is not None:
            raise InvalidInput(
                "tolerances were given for a generalized plant, which has its blocks already; "
                "leave them out"
            )
        u = [name for name in model.system.inputs if name.startswith("u_")]
        y = [f"y_{name.removeprefix('u_')}" for name in u]
        if not u or not set(y) <= set(model.system.outputs):
            known = ", ".join((*model.system.inputs, *model.system.outputs))
            raise invalid(
                "the plant's signals",
                known,
                "u_<axis> [A] and y_<axis> [m] among them",
                "rename() its system",
            )
        if uncertain and not model.blocks:
            raise InvalidInput(
                "the generalized plant has no blocks; give it some, or ask for uncertain=False"
            )
        if not uncertain:
            return GeneralizedPlant(model.system, [], u, [], y)
    w, z = model.w[: model.n_w_blocks], model.z[: model.n_z_blocks]
    return GeneralizedPlant(select(model.system, [*w, *u], [*z, *y]), w, u, z, y, model.blocks)


def design_tolerances(machine: Machine) -> tuple[Tolerance, ...]:
    """The tolerances that a design is made for: all of at least 5 %, or all where none is as wide.

    Every real parameter costs D-K iteration states and time; what identification has narrowed to a
    percent is within the margin that the wide ones force, and verification over all tolerances says
    whether that is so.
    """
    wide = tuple(
        item
        for item in machine.tolerances
        if item.relative is None or item.relative >= LEAST_TOLERANCE
    )
    return wide or machine.tolerances


def with_performance_block(plant: GeneralizedPlant) -> GeneralizedPlant:
    """The plant with a full block "performance" from its performance outputs back to its
    disturbances.

    mu < 1 of the closed loop with this block is robust performance: the H-infinity norm from the
    remaining w to the remaining z stays below 1 for every perturbation (main loop theorem; Zhou,
    Doyle & Glover 1996, thm 11.7). Raises InvalidInput when there is no w or z beyond the blocks.
    """
    n_w, n_z = len(plant.w) - plant.n_w_blocks, len(plant.z) - plant.n_z_blocks
    if n_w == 0 or n_z == 0:
        raise invalid(
            "the number of performance signals (w, z)",
            (n_w, n_z),
            "at least 1 each",
            "it has its block already",
        )
    blocks = [*plant.blocks, FullBlock(PERFORMANCE, n_w, n_z)]
    return GeneralizedPlant(plant.system, plant.w, plant.u, plant.z, plant.y, blocks)


def apply_delay(model: GeneralizedPlant, delay: float, order: int = 1) -> GeneralizedPlant:
    """The model with every current u delayed by ``delay`` [s], as a Pade all-pass of ``order``
    states per axis; 0: unchanged.

    So that a controller is designed for the sampled loop that it will run in: with the sample time
    T, acting n samples after it read the displacements, it is (n + 1/2) T late, the half sample
    being the mean age of a held value. order 1 is 0.004 degrees off at 100 Hz for 0.15 ms, 4
    degrees at 1 kHz. Raises InvalidInput.
    """
    if delay == 0:
        return model
    passes = append(*[pade(delay, order, name, f"late_{name}") for name in model.u])
    inner = rename(model.system, {name: f"late_{name}" for name in model.u}, {})
    system = connect(
        [passes, inner], inputs=list(model.system.inputs), outputs=list(model.system.outputs)
    )
    return GeneralizedPlant(system, model.w, model.u, model.z, model.y, model.blocks)
