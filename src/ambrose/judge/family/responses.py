"""Families over a box of tolerances: worst-case unbalance by search and by bound, and pulse
responses of its members.

The loop is closed once with the uncertain parameters pulled out; every member of the family is then
a small correction to it (``core.box``). The plant may be full, or reduced, or the members be those
of many speeds, one after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_positive, check_shape, invalid, named_failure
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.statespace import StateSpace
from ambrose.core.worst_case.bounds import gain_bound
from ambrose.core.worst_case.loop import BoxLoop, box_loop, box_points, gains, perturbed_matrix
from ambrose.core.worst_case.search import worst_gain_at
from ambrose.law.law import LawLike
from ambrose.law.loop import match_controller
from ambrose.machine.description import Tolerance
from ambrose.model.plant import Plant
from ambrose.model.unbalance import Unbalance, residual_unbalance
from ambrose.model.uncertainty import uncertain

_BLOCK = 64  # members integrated at once


@named_failure("the loop over the box")
def loop_over_box(
    plant: Plant,
    controller: LawLike,
    inputs: Sequence[str],
    outputs: Sequence[str],
    tolerances: Sequence[Tolerance] | None = None,
) -> BoxLoop:
    """The closed loop from inputs (f_<port> [N]) to outputs (q_, qdot_, y_, i_ of the plant), its
    tolerances pulled out.

    controller: err -> u, continuous. tolerances: default the machine's. Raises InvalidInput for
    unknown signals or a sampled controller, UnstableSystem where the nominal loop is unstable.
    """
    K = match_controller(controller, plant)
    if K.dt is not None:
        raise invalid(
            "the controller",
            repr(K),
            "continuous",
            "give the one that the sampled controller was made from",
        )
    model = uncertain(plant, tolerances)
    w, z = model.w[: model.n_w_blocks], model.z[: model.n_z_blocks]
    u, y = list(plant.named("u")), list(plant.named("y"))
    twins = [f"{name} measured" for name in y]  # y_<axis> may be asked for as well
    s = model.system
    rows = [*range(len(s.outputs)), *(s.outputs.index(name) for name in y)]
    system = StateSpace(s.A, s.B, s.C[rows], s.D[rows], s.inputs, [*s.outputs, *twins])
    problem = GeneralizedPlant(system, [*w, *inputs], u, [*z, *outputs], twins, model.blocks)
    minus = StateSpace(K.A, K.B, -K.C, -K.D, K.inputs, K.outputs)  # err = -y
    return box_loop(lft(problem, minus), model.blocks)


@dataclass(frozen=True, slots=True, eq=False)
class BoxUnbalance:
    """Unbalance orbits over a box [m], all (w,): nominal, the largest found by search, and an upper
    bound by mixed mu.

    speeds (w,) [rad/s]; delta (w, k): where each largest one was found. The bound is NaN where it
    was not asked for.
    """

    speeds: np.ndarray
    nominal: np.ndarray
    found: np.ndarray
    bound: np.ndarray
    delta: np.ndarray


@named_failure("the unbalance response over the box")
def unbalance_over_box(
    plant: Plant | Callable[[float], Plant],
    controller: LawLike,
    speeds: ArrayLike,
    residual: Unbalance | None = None,
    tolerances: Sequence[Tolerance] | None = None,
    bound: bool = True,
) -> BoxUnbalance:
    """Largest singular value of the compliance between the bearings times the unbalance force, the
    worst over the box.

    plant: frozen at its own speed, or speed [rad/s] -> Plant. speeds (w,) [rad/s]: of rotation,
    ascending. residual: default that of the machine's balance grade. Source: Lauridsen 2017, paper
    P3, (14). Raises InvalidInput and UnstableSystem.
    """
    speeds = check_shape(speeds, "speeds", "(w,)").astype(float)
    if not callable(plant):
        loop = _compliance(plant, controller, tolerances)
    rows = []
    for speed in speeds:
        check_positive(speed, "the speed of rotation [rad/s]", "unbalance needs one")
        if callable(plant):
            at = plant(float(speed))
            loop = _compliance(at, controller, tolerances)
        else:
            at = plant
        force = _residual(at, residual).force(speed)
        omega = np.array([speed])
        nominal = gains(loop.at(omega), loop, np.zeros((1, loop.parameters)))[0, 0]
        worst = worst_gain_at(loop, float(speed))
        least = max(worst.value, nominal)
        limit = gain_bound(loop, omega, least) if bound else np.nan
        rows.append((nominal * force, least * force, limit * force, worst.delta))
    nominal, largest, limits, delta = zip(*rows, strict=True)
    return BoxUnbalance(
        speeds, np.array(nominal), np.array(largest), np.array(limits), np.array(delta)
    )


def _compliance(
    plant: Plant, controller: LawLike, tolerances: Sequence[Tolerance] | None
) -> BoxLoop:
    return loop_over_box(
        plant, controller, plant.bearing_named("f"), plant.bearing_named("q"), tolerances
    )


def _residual(plant: Plant, residual: Unbalance | None) -> Unbalance:
    unbalance = residual_unbalance(plant.machine) if residual is None else residual
    if unbalance is None:
        raise InvalidInput(
            "no balancing speed is known; give requirements.balance_speed or a speed range"
        )
    return unbalance


@dataclass(frozen=True, slots=True, eq=False)
class PulseFamily:
    """time (t,) [s]; responses (d, p, t) of the members delta (d, k) at the named outputs; stable
    (d,).
    """

    time: np.ndarray
    responses: np.ndarray
    delta: np.ndarray
    stable: np.ndarray
    outputs: tuple[str, ...]

    def settling(self, band: float = 0.02, outputs: Sequence[str] | None = None) -> np.ndarray:
        """Time (d,) [s] after which the outputs stay within ``band`` [-] of the member's largest
        value; infinite if never.
        """
        keep = [self.outputs.index(name) for name in (self.outputs if outputs is None else outputs)]
        size = np.abs(self.responses[:, keep]).max(axis=1)
        outside = size > band * size.max(axis=1, keepdims=True)
        last = size.shape[1] - 1 - np.argmax(outside[:, ::-1], axis=1)
        step = self.time[1] - self.time[0]
        settled = np.where(outside.any(axis=1), self.time[last] + step, 0.0)
        return np.where(outside[:, -1] | ~self.stable, np.inf, settled)


@named_failure("the pulse responses over the box")
def pulse_family(
    plant: Plant,
    controller: LawLike,
    port: str,
    force: float,
    width: float,
    outputs: Sequence[str],
    delta: ArrayLike | None = None,
    *,
    duration: float = 0.06,
    step: float = 1e-4,
    tolerances: Sequence[Tolerance] | None = None,
) -> PulseFamily:
    """Responses to a rectangular force pulse at a port, of every member delta (d, k) of the box
    (default: ``box_points``).

    force [N], width [s] (infinite: a step). The pulse's edges and the samples, ``step`` [s] apart,
    are met exactly (matrix exponentials). Raises InvalidInput, UnstableSystem.
    """
    from scipy.linalg import expm

    loop = loop_over_box(plant, controller, [f"f_{port}"], outputs, tolerances)
    members = (
        box_points(loop.parameters)
        if delta is None
        else check_shape(delta, "delta", "(d, k)", k=loop.parameters)
    )
    n, s = len(loop.owner), loop.system
    on = round(min(width, 2 * duration) / step)
    if width < duration and abs(on * step - width) > 1e-6 * step:
        raise invalid(
            "the width of the pulse [s]",
            width,
            f"a multiple of the step, {step:g} s",
            "change the step",
        )
    time = np.arange(round(duration / step) + 1) * step
    responses = np.empty((len(members), len(outputs), len(time)))
    stable = np.empty(len(members), bool)
    for first in range(0, len(members), _BLOCK):
        block = members[first : first + _BLOCK]
        A = np.array([perturbed_matrix(loop, row) for row in block])
        stable[first : first + _BLOCK] = np.linalg.eigvals(A).real.max(axis=1) < 0
        wide = block[:, loop.owner][:, None, :]
        inner = np.linalg.inv(np.eye(n) - s.D[:n, :n] * wide)
        feed = inner @ s.D[:n, n:]
        B = s.B[:, n:] + (s.B[:, :n] * wide) @ feed
        C = s.C[n:] + (s.D[n:, :n] * wide) @ (inner @ s.C[:n])
        D = s.D[n:, n:] + (s.D[n:, :n] * wide) @ feed
        size = A.shape[1]
        both = np.zeros((len(block), size + 1, size + 1))
        both[:, :size, :size], both[:, :size, size:] = A * step, B * step
        moved = expm(both)
        x = np.zeros((len(block), size, 1))
        for k in range(len(time)):
            u = force if k < on else 0.0
            responses[first : first + _BLOCK, :, k] = (C @ x + D * u)[..., 0]
            x = moved[:, :size, :size] @ x + moved[:, :size, size:] * u
    return PulseFamily(time, responses, np.asarray(members, dtype=float), stable, tuple(outputs))
