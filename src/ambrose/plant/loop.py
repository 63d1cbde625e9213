"""The closed loop of core/lft.py's diagram, around a plant and a controller."""

from __future__ import annotations

from typing import Any

from ambrose.core.checks import invalid
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, as_statespace, connect, rename
from ambrose.plant.model import Plant


def closed_loop(plant: Plant, controller: Any) -> StateSpace:
    """Everything that can be asked of the loop, as one system.

    Inputs: e_<axis> [A] excitation added to the controller's output, d_<axis> [m] output disturbance, r_<axis> [m] reference,
    f_<port> [N] force. Outputs: y_<axis> [m] measured displacement (d included), u_<axis> [A] controller output,
    i_<axis> [A] coil current, q_<port> [m], qdot_<port> [m/s]. A sampled controller closes the loop around the plant sampled
    with a zero-order hold. Raises InvalidInput when the controller's size does not match the axes.
    """
    controller = named_controller(plant, controller)
    system = plant.system if controller.dt is None else c2d(plant.system, controller.dt)
    axes = plant.axes
    return connect(
        [rename(system, {f"u_{a}": f"v_{a}" for a in axes}, {f"y_{a}": f"g_{a}" for a in axes}), controller],
        inputs=[f"{kind}_{a}" for kind in "edr" for a in axes] + [f"f_{p}" for p in plant.ports],
        outputs=[f"{kind}_{a}" for kind in "yui" for a in axes]
        + [f"{kind}_{p}" for kind in ("q", "qdot") for p in plant.ports],
        sums={
            **{f"v_{a}": [f"u_{a}", f"e_{a}"] for a in axes},
            **{f"y_{a}": [f"g_{a}", f"d_{a}"] for a in axes},
            **{f"err_{a}": [f"r_{a}", f"-y_{a}"] for a in axes},
        },
    )


def named_controller(plant: Plant, controller: Any) -> StateSpace:
    """``controller`` with inputs err_<axis> [m] and outputs u_<axis> [A]; signals are matched by place. A scheduled one is
    the one at the plant's speed.

    Raises InvalidInput when its size does not fit the plant's control axes.
    """
    controller = as_statespace(controller.at(plant.point.speed) if isinstance(controller, ScheduledSystem) else controller)
    n = len(plant.axes)
    if controller.D.shape != (n, n):
        raise invalid(
            "the controller's size (outputs, inputs)",
            controller.D.shape,
            f"({n}, {n}) for the axes {', '.join(plant.axes)}",
            "design it for this machine",
        )
    return rename(controller, [f"err_{a}" for a in plant.axes], [f"u_{a}" for a in plant.axes])
