"""The closed loop of core/lft.py's diagram, around a plant and a controller; how a controller's
signals find their axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.sampling import c2d
from ambrose.core.statespace import (
    ControllerLike,
    StateSpace,
    as_statespace,
    connect,
    rename,
    select,
)
from ambrose.law.law import LawLike, law_of
from ambrose.law.timing import Timing
from ambrose.machine.axial import AXIS, SUFFIX, AxialMachine
from ambrose.machine.machine import Machine, require_magnets
from ambrose.machine.thrust import ThrustBearing
from ambrose.model.plant import Plant


def closed_loop(plant: Plant, controller: LawLike) -> StateSpace:
    """Everything that can be asked of the loop, as one system.

    Inputs: e_<axis> [A] excitation added to the controller's output, d_<axis> [m] output
    disturbance, r_<axis> [m] reference, f_<port> [N] force. Outputs: y_<axis> [m] measured
    displacement (d included), u_<axis> [A] controller output, i_<axis> [A] coil current, q_<port>
    [m], qdot_<port> [m/s]. A sampled controller closes the loop around the plant sampled with a
    zero-order hold. The controller is matched by ``match_controller``, which raises InvalidInput.
    """
    controller = match_controller(controller, plant)
    system = plant.system if controller.dt is None else c2d(plant.system, controller.dt)
    axes = plant.axes
    return connect(
        [
            rename(system, {f"u_{a}": f"v_{a}" for a in axes}, {f"y_{a}": f"g_{a}" for a in axes}),
            controller,
        ],
        inputs=[f"{kind}_{a}" for kind in "edr" for a in axes] + [f"f_{p}" for p in plant.ports],
        outputs=[f"{kind}_{a}" for kind in "yui" for a in axes]
        + [f"{kind}_{p}" for kind in ("q", "qdot") for p in plant.ports],
        sums={
            **{f"v_{a}": [f"u_{a}", f"e_{a}"] for a in axes},
            **{f"y_{a}": [f"g_{a}", f"d_{a}"] for a in axes},
            **{f"err_{a}": [f"r_{a}", f"-y_{a}"] for a in axes},
        },
    )


def match_controller(controller: LawLike, plant: Plant) -> StateSpace:
    """The controller's law with inputs err_<axis> [m] and outputs u_<axis> [A], in the order of the
    plant's axes.

    Signals that are named after axes (err_A_zeta, y_A_zeta, u_A_zeta ...) are matched by name,
    whatever their order; a controller without such names is matched by place. A scheduled law is
    the one at the plant's speed or seal pressure. Raises InvalidInput where the size does not fit,
    or the names are those of other axes.
    """
    require_magnets(plant.machine)
    law = law_of(controller).at(plant.point)
    check_side(law.inputs, plant.machine)
    return match_axes(law, plant.axes, repr(plant.machine.name))


def check_side(inputs: Sequence[str], machine: Machine) -> None:
    """Refuses a controller of the axis along the shaft on the radial axes of its machine, and the
    other way round, by the names of its inputs. Raises InvalidInput.
    """
    whole = machine.whole if isinstance(machine, AxialMachine) else machine
    parts = () if whole is None else whole.effects
    thrust = next((part for part in parts if isinstance(part, ThrustBearing)), None)
    if whole is None or thrust is None:
        return
    along, across = {f"err_{thrust.name}{AXIS}"}, {f"err_{axis}" for axis in whole.axes}
    if whole is machine and set(inputs) == along:
        raise InvalidInput(
            f"this controller is of {thrust.name}{AXIS}, the axis along the shaft; add "
            f'"{SUFFIX}" to the machine, {machine.name}{SUFFIX}'
        )
    if whole is not machine and set(inputs) == across:
        raise InvalidInput(
            f"this controller is of the radial axes {', '.join(whole.axes)}; take the machine "
            f'without "{SUFFIX}", {whole.name}'
        )


def match_axes(controller: ControllerLike, axes: Sequence[str], machine: str = "") -> StateSpace:
    """``match_controller`` for a fixed law and the axes themselves; machine: in words, for the
    message.
    """
    system = as_statespace(controller)
    n = len(axes)
    if system.D.shape != (n, n):
        requirement = f"({n}, {n}) for the axes {', '.join(axes)}"
        raise invalid(
            "the controller's size (outputs, inputs)",
            system.D.shape,
            requirement,
            "design it for this machine",
        )
    into, out = (axis_order(system, side, axes, machine) for side in ("inputs", "outputs"))
    if into != list(range(n)) or out != list(range(n)):
        system = select(system, [system.inputs[k] for k in into], [system.outputs[k] for k in out])
    return rename(system, [f"err_{axis}" for axis in axes], [f"u_{axis}" for axis in axes])


def axis_order(
    controller: StateSpace,
    side: Literal["inputs", "outputs"],
    axes: Sequence[str],
    machine: str = "",
) -> list[int]:
    """Which of the controller's inputs or outputs belongs to each axis: by its name, or by place
    without names of axes.

    Raises InvalidInput where the names are those of other axes.
    """
    names, prefix = (controller.inputs, "err_") if side == "inputs" else (controller.outputs, "u_")
    ways = ("_zeta", "_eta", *(f"_{axis.rpartition('_')[2]}" for axis in axes))
    if not any(name.startswith(prefix) or name.endswith(ways) for name in names):
        return list(range(len(axes)))
    axis_of = [_axis_named(name, axes) for name in names]
    if sorted(map(str, axis_of)) != sorted(axes):
        remedy = (
            f"this controller is for another machine: design one for {machine or 'this'}, or give "
            "its signals these names"
        )
        raise invalid(
            f"the list of the controller's {side}",
            ", ".join(names),
            ", ".join(prefix + axis for axis in axes),
            remedy,
        )
    return [axis_of.index(axis) for axis in axes]


def _axis_named(name: str, axes: Sequence[str]) -> str | None:
    """The axis that a signal's name ends with; generated code writes _ for a bearing's hyphens."""
    for spelled in (str, lambda text: text.replace("-", "_")):
        for axis in axes:
            if f"_{spelled(name)}".endswith(f"_{spelled(axis)}"):
                return axis
    return None


def running_law(law: LawLike, plant: Plant, timing: Timing | None) -> StateSpace:
    """The law in the loop of a plant: at its operating point, its signals matched and, with a
    timing, sampled and late.
    """
    fixed = match_controller(law, plant)
    return fixed if timing is None else timing.in_loop(fixed)
