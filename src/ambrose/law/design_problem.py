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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.lft import FullBlock, GeneralizedPlant
from ambrose.core.presentation import Presented
from ambrose.core.sampling import pade
from ambrose.core.statespace import (
    StateSpace,
    append,
    as_statespace,
    connect,
    is_stable,
    rename,
    select,
    series,
    static_gain,
    transfer_function,
)
from ambrose.machine.description import DesignWeights, Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import uncertain as uncertain_plant

# Weights from requirements in words: how large the error may be, how fast it must vanish, how hard
# the controller may work.
#
# A weight is the inverse of what is allowed: |S_o| <= 1/|W_p| and |K S_o| <= (D_u/D_e)/|W_u|, in
# units of the largest error D_e and the largest control current D_u (Lauridsen 2017, paper P5, eq.
# (7), paper P3, eq. (11); Skogestad & Postlethwaite 2005, sec. 2.8.2). ``problem.py`` puts them
# around a plant.


_SYSTEMS = ("performance", "control")
_SIZES = (
    "error_scale",
    "current_scale",
    "current_disturbance",
    "output_disturbance",
    "control_factor",
)
_LIMIT = 30.0  # default of |W_u| far above its crossover


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Weights(Presented):
    """The weights of one design; every axis has the same ones.

    performance W_p and control W_u: stable systems with one input and one output [-]. error_scale
    D_e [m]: the largest error that is acceptable; current_scale D_u [A]: the largest control
    current. current_disturbance and output_disturbance [-]: sizes of the disturbances w1 (current,
    added before the amplifier) and w2 (measured displacement) in units of D_u and D_e.
    control_factor [-]: what W_u has been multiplied by since it was stated (``scale_control``).
    Raises InvalidInput.
    """

    performance: StateSpace
    control: StateSpace
    error_scale: float
    current_scale: float
    current_disturbance: float = 1.0
    output_disturbance: float = 1.0
    control_factor: float = 1.0

    def __post_init__(self) -> None:
        for name in _SYSTEMS:
            object.__setattr__(self, name, _checked(getattr(self, name), f"the {name} weight"))
        for name in _SIZES:
            check_positive(
                getattr(self, name),
                name,
                "a disturbance or scale of size zero makes the problem singular",
            )

    def facts(self) -> Mapping[str, Any]:
        return {name: float(getattr(self, name)) for name in _SIZES}

    def to_dict(self) -> dict[str, Any]:
        """Matrices and sizes as JSON-ready data."""
        systems = {
            name: {x: getattr(getattr(self, name), x).tolist() for x in "ABCD"} for name in _SYSTEMS
        }
        return {**systems, **{name: float(getattr(self, name)) for name in _SIZES}}


def _checked(weight: Any, name: str) -> StateSpace:
    weight = as_statespace(weight)
    if weight.D.shape != (1, 1) or weight.dt is not None:
        raise invalid(
            name,
            repr(weight),
            "continuous with one input and one output",
            "all axes have the same weight",
        )
    if not is_stable(weight):
        raise invalid(
            name,
            "unstable or integrating",
            "stable",
            "move the pole off zero: low_frequency_error > 0",
        )
    return weight


def performance_weight(
    peak: float, bandwidth: float, low_frequency_error: float = 1e-3
) -> StateSpace:
    """W_p = (s/M + w_B)/(s + w_B A_w): 1/A_w at zero frequency, 1 near w_B, 1/M far above.

    peak M [-] > 1: the largest sensitivity; bandwidth w_B [rad/s]: disturbances below it are
    reduced; low_frequency_error A_w [-], 0 < A_w < 1: what is left of a constant disturbance (P5,
    eq. (7); P3, eq. (11)). Above A_w w_B the weight is a PI controller with the integral time 1/(M
    w_B) [s]. Raises InvalidInput.
    """
    peak = check_positive(peak, "peak", "3 is the border of zone A of ISO 14839-3")
    bandwidth = check_positive(
        bandwidth, "bandwidth", "give it in rad/s; 1/(peak T_i) for an integral time T_i [s]"
    )
    error = check_positive(
        low_frequency_error, "low_frequency_error", "1e-3 is close to integral action"
    )
    if peak <= 1:
        raise invalid(
            "peak",
            f"{peak:g}",
            "above 1",
            "no loop around a strictly proper plant stays below (Bode's integral)",
        )
    if error >= 1:
        raise invalid(
            "low_frequency_error", f"{error:g}", "below 1", "1e-3 is close to integral action"
        )
    return transfer_function([1 / peak, bandwidth], [1.0, bandwidth * error], "err", "z1")


def control_weight(
    level: float, crossover: float | None = None, order: int = 1, limit: float | None = None
) -> StateSpace:
    """W_u: the constant ``level`` [-], or a high-pass filter that makes the controller roll off.

    With a ``crossover`` [rad/s]: W_u = level ((s/w_z + 1)/(s/w_p + 1))^order goes from ``level`` <
    1 at low frequencies through |W_u| = 1 at the crossover to ``limit`` > 1 far above (default:
    30). A bending mode above the crossover is left alone when the weight is large enough there.
    Raises InvalidInput.
    """
    level = check_positive(level, "level", "0.3 lets the current reach 3 D_u for an error of D_e")
    if crossover is None:
        if limit is not None:
            raise invalid(
                "limit",
                limit,
                "left out without a crossover",
                "a constant weight has no other level",
            )
        return static_gain([[level]], ["u"], ["z2"])
    crossover = check_positive(crossover, "crossover", "give it in rad/s")
    limit = (
        _LIMIT
        if limit is None
        else check_positive(limit, "limit", "30 puts its pole far above the crossover")
    )
    if not isinstance(order, int | np.integer) or not 1 <= order <= 8:
        raise invalid(
            "order",
            order,
            "a whole number from 1 to 8",
            "2 suits a bending mode one octave above the crossover",
        )
    if not level < 1 < limit:
        raise invalid(
            "level and limit",
            f"{level:g} and {limit:g}",
            "below and above 1",
            "|W_u| is 1 at the crossover",
        )
    ratio = (limit / level) ** (1 / order)  # w_p / w_z
    a = level ** (2 / order)  # |1 + j w_c/w_z|^2 a = |1 + j w_c/w_p|^2
    # with t = (w_c/w_z)^2:   a (1 + t) = 1 + t/ratio^2
    zero = crossover * np.sqrt((a - ratio**-2) / (1 - a))
    section = transfer_function([1 / zero, 1.0], [1 / (zero * ratio), 1.0], "u", "z2")
    result = static_gain([[level]], ["u"], ["z2"])
    for _ in range(order):
        result = series(result, section)
    return result


def machine_weights(machine: Machine | DesignWeights) -> Weights:
    """The Weights that the machine's [weights] table describes. Raises InvalidInput when it has
    none.
    """
    settings = machine.weights if isinstance(machine, Machine) else machine
    if settings is None:
        if not isinstance(machine, Machine):
            raise InvalidInput("there are no weights; give DesignWeights")
        remedy = machine.in_file("add a [weights] table to its file")
        raise InvalidInput(f"machine {machine.name!r} has no weights; {remedy}")
    return Weights(
        performance_weight(settings.peak, settings.bandwidth, settings.low_frequency_error),
        control_weight(
            settings.control_level,
            settings.control_crossover,
            settings.control_order,
            settings.control_limit,
        ),
        settings.error_scale,
        settings.current_scale,
        settings.current_disturbance,
        settings.output_disturbance,
    )


def scale_control(weights: Weights, factor: float) -> Weights:
    """The weights with W_u multiplied by ``factor`` [-] at every frequency: above 1 the controller
    becomes more careful.
    """
    W = weights.control
    factor = check_positive(factor, "factor", "above 1 weighs the current more")
    control = StateSpace(W.A, W.B, W.C * factor, W.D * factor, W.inputs, W.outputs)
    return replace(weights, control=control, control_factor=weights.control_factor * factor)


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


@singledispatch
def open_model(
    plant: Plant | GeneralizedPlant, tolerances: Sequence[Tolerance] | None, uncertain: bool
) -> GeneralizedPlant:
    """The blocks' signals and u_<axis> -> the blocks' signals and y_<axis>; nothing else."""
    raise NotImplementedError


@open_model.register
def _(plant: Plant, tolerances: Sequence[Tolerance] | None, uncertain: bool) -> GeneralizedPlant:
    u, y = list(plant.named("u")), list(plant.named("y"))
    if not uncertain:
        return GeneralizedPlant(plant.system, [], u, [], y)
    return _opened(uncertain_plant(plant, tolerances), u, y)


@open_model.register
def _(
    plant: GeneralizedPlant, tolerances: Sequence[Tolerance] | None, uncertain: bool
) -> GeneralizedPlant:
    if tolerances is not None:
        raise InvalidInput(
            "tolerances were given for a generalized plant, which has its blocks already; "
            "leave them out"
        )
    u = [name for name in plant.system.inputs if name.startswith("u_")]
    y = [f"y_{name.removeprefix('u_')}" for name in u]
    if not u or not set(y) <= set(plant.system.outputs):
        known = ", ".join((*plant.system.inputs, *plant.system.outputs))
        raise invalid(
            "the plant's signals",
            known,
            "u_<axis> [A] and y_<axis> [m] among them",
            "rename() its system",
        )
    if uncertain and not plant.blocks:
        raise InvalidInput(
            "the generalized plant has no blocks; give it some, or ask for uncertain=False"
        )
    return _opened(plant, u, y) if uncertain else GeneralizedPlant(plant.system, [], u, [], y)


def _opened(model: GeneralizedPlant, u: list[str], y: list[str]) -> GeneralizedPlant:
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
