"""The plant that Lauridsen (2017) prints in paper P5, Appendix A: the test rig's rigid rotor with
its seal, as data.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.lft import GeneralizedPlant, RealBlock
from ambrose.core.statespace import StateSpace, append, rename, series, static_gain
from ambrose.law.design_problem import Weights, design_plant, machine_weights
from ambrose.machine.description import DesignWeights
from ambrose.machine.part import PidSettings


@cache
def published_p5_data() -> Mapping[str, Any]:
    """The numbers as printed or restored, SI units: matrices, axes, actuator, PID settings,
    weights, and notes on each.
    """
    text = Path(__file__).with_name("published-p5.json").read_text(encoding="utf-8")
    return json.loads(text)


def published_p5() -> GeneralizedPlant:
    """Rotor, seal and actuators: w, f_<axis> [N] and u_<axis> [A] to z and y_<axis> [m], 16 states.

    The block "seal.k", one real parameter repeated twice, takes the cross-coupled stiffness from
    zero (-1) over nominal (0) to twice nominal (+1) (eq. 5). u passes the actuator w_n^2/(s^2 + d s
    + w_n^2) and the force per current k_i; f acts on the rotor directly. y is the displacement, not
    the error: close the loop with u = K (r - y).
    """
    data = published_p5_data()
    axes = data["axes"]
    n = len(axes)
    wn = data["actuator"]["natural_frequency"]
    damping = data["actuator"]["damping"]
    lag = StateSpace([[0, wn], [-wn, -damping]], [[0.0], [wn]], [[1.0, 0.0]], [[0.0]])
    lags = append(*[rename(lag, [f"u_{a}"], [f"i_{a}"]) for a in axes])
    actuators = series(
        lags, static_gain(np.diag(data["force_per_current"]), outputs=[f"m_{a}" for a in axes])
    )
    w, z = ["w_seal.k_1", "w_seal.k_2"], ["z_seal.k_1", "z_seal.k_2"]
    f, u, y = ([f"{kind}_{a}" for a in axes] for kind in "fuy")
    B = np.array(data["B"])
    rotor = StateSpace(
        data["A"],
        np.hstack([data["B_delta"], B, B]),
        np.vstack([data["C_delta"], data["C"]]),
        np.zeros((2 + n, 2 + 2 * n)),
        [*w, *f, *(f"i_{a}" for a in axes)],
        [*z, *y],
    )
    direct = static_gain(np.eye(2 + n), [*w, *f], [*w, *f])
    system = series(append(direct, actuators), rotor)
    return GeneralizedPlant(
        system, w=[*w, *f], u=u, z=z, y=y, blocks=[RealBlock("seal.k", repeat=2)]
    )


def published_p5_pid(gain: float | None = None) -> PidSettings:
    """The reference controller of section 4.2; gain K_p [A/m] (None: 18 000, that is 0.36 A per 20
    um; it is not printed).
    """
    pid = published_p5_data()["pid"]
    return PidSettings(
        gain=(pid["gain"] if gain is None else gain,),
        integral_time=pid["integral_time"],
        derivative_time=pid["derivative_time"],
        derivative_filter=pid["derivative_filter"],
    )


def published_p5_weights() -> Weights:
    """The weights of the published P5 plant, as printed or inferred: M = 3, A_w = 1e-3, w_B = 1.5
    rad/s, W_u = 0.315.
    """
    data = published_p5_data()["weights"]
    return machine_weights(
        DesignWeights(
            error_scale=data["displacement_unit"],
            current_scale=data["current_unit"],
            bandwidth=data["w_B"],
            control_level=data["control"],
            peak=data["M"],
            low_frequency_error=data["A_w"],
        )
    )


def published_p5_problem(
    weights: Weights | None = None, uncertain: bool = True
) -> GeneralizedPlant:
    """The design problem of paper P5 on its published plant: 8 rotor, 8 actuator and 4 weight
    states.
    """
    return design_plant(
        published_p5(), published_p5_weights() if weights is None else weights, uncertain=uncertain
    )
