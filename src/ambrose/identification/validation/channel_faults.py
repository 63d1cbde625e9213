"""What a measuring chain and its magnets may do that no parameter of the machine file stands for,
as further unknowns of the loop, all zero in the model:

    gain of y_j     what is measured is (1 + g) y_j
    lag of y_j      what is measured is y_j - tau dy_j/dt: a filter, to first order
    gain of e_j     what acts is (1 + g) e_j
    turned sensors  y_zeta gains phi y_eta, y_eta loses phi y_zeta: a pair mounted askew
    cross of a bearing    each axis' force gains a share of the other's current
    turned bearing        one axis' force gains it, the other's loses it

The controller takes what is measured. As the outputs' map may not depend on an unknown, the
measured values are states of their own: s(k) = M C x(k), with M the identity in the model,

    x+ = Ad x + Bu u + Be e,    z+ = A_K z - B_K s,    u = C_K z - D_K s,    s+ = M C x+

so that a change of M shows in the rows of s alone. Their first values are estimated with the rest
of the first state: the first sample tells nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.response import SystemDerivative, held_derivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error.loop_model import LoopModel

# [%], [deg], [samples] up to which a fault is harmless, assumed: less than a channel is calibrated
# to, and a part is mounted to
_GAIN, _ANGLE = 2.0, 2.0
_LAG = 0.1
# [%], [deg], [samples]: a longer step is no correction of a channel, but another wiring; assumed
_MOST_GAIN, _MOST_ANGLE = 50.0, 30.0
_MOST_LAG = 3.0
_RANK_ONE = 1e-6  # second over first singular value of a magnet's direction, at most


@dataclass(frozen=True, slots=True)
class Fault:
    """A further unknown: what to call it, its unit, the size [unit] up to which it is harmless, and
    that of one that is no longer a correction.
    """

    name: str
    unit: str
    harmless: float
    most: float


@dataclass(frozen=True, slots=True, eq=False)
class FaultyLoop:
    """A sampled loop over its weights with the derivatives for its model's parameters, then for
    every fault.
    """

    loop: StateSpace
    directions: list[SystemDerivative]
    faults: tuple[Fault, ...]


def faulty_loop(
    model: LoopModel, theta: np.ndarray, paths: Sequence[str], sizes: np.ndarray
) -> FaultyLoop:
    """The loop at theta (q,) of the parameters ``paths``, whose signals are y_<axis> alone, over
    their weights ``sizes`` (p,), with every fault that can be tried on it.
    """
    A, B, dA, dB = model.plant(theta)
    K = model.controller
    assert K.dt is not None
    crossed, cross_A, cross_B = _crossed(dA, dB, theta, paths)
    Ad, Bd, dAd, dBd = held_derivative(
        A, B, np.concatenate([dA, cross_A]), np.concatenate([dB, cross_B]), K.dt
    )
    n, nk = len(Ad), K.n_states
    axes = [name.removeprefix("u_") for name in K.outputs]
    a = len(axes)
    y = model.C[:a]

    # rows of x+ on the states (x, z, s) and on e; those of s+ are M C times them, M = 1
    on_state = np.hstack([Ad, Bd[:, :a] @ K.C, -Bd[:, :a] @ K.D])
    on_e = Bd[:, a:]
    of_z = np.hstack([np.zeros((nk, n)), K.A, -K.B])
    closed = np.vstack([on_state, of_z, y @ on_state])
    driven = np.vstack([on_e, np.zeros((nk, on_e.shape[1])), y @ on_e])
    C = np.zeros((len(model.signals), len(closed)))
    for row, name in enumerate(model.signals):
        C[row, n + nk + axes.index(name[2:])] = 1 / sizes[row]
    D = np.zeros((len(C), driven.shape[1]))

    def moved(changed: np.ndarray, pushed: np.ndarray) -> SystemDerivative:
        return SystemDerivative(changed, pushed, np.zeros_like(C), D)

    # the model's own parameters and the crossed magnets move Ad and Bd
    directions = []
    for of_A, of_B in zip(dAd, dBd, strict=True):
        rows = np.hstack([of_A, of_B[:, :a] @ K.C, -of_B[:, :a] @ K.D])
        pushed = of_B[:, a:]
        still = np.zeros((nk, len(closed)))
        directions.append(
            moved(
                np.vstack([rows, still, y @ rows]),
                np.vstack([pushed, np.zeros((nk, pushed.shape[1])), y @ pushed]),
            )
        )

    # the sensors' faults move the rows of s by dM C x+, a lag by -C A x+
    faults = list(crossed)
    for fault, rows in _sensor_faults(axes, y, A, K.dt):
        faults.append(fault)
        changed, pushed = np.zeros_like(closed), np.zeros_like(driven)
        changed[n + nk :], pushed[n + nk :] = rows @ on_state, rows @ on_e
        directions.append(moved(changed, pushed))

    # an excitation's own column
    for column, name in enumerate(model.excitations):
        faults.append(_gain(f"gain of {name}"))
        pushed = np.zeros_like(driven)
        pushed[:, column] = driven[:, column] / 100
        directions.append(moved(np.zeros_like(closed), pushed))
    loop = StateSpace(closed, driven, C, D, model.excitations, model.signals, K.dt)
    return FaultyLoop(loop, directions, tuple(faults))


def _sensor_faults(
    axes: Sequence[str], y: np.ndarray, A: np.ndarray, dt: float
) -> list[tuple[Fault, np.ndarray]]:
    """What the sensors may do, and per unit of it the rows (a, n) on x+ that s+ gains."""
    found = []
    for j, axis in enumerate(axes):
        only = np.zeros((len(axes), 1))
        only[j] = 1.0
        found.append((_gain(f"gain of y_{axis}"), only * y[j] / 100))

        # y(t - tau) = y - tau dy/dt, and C B = 0: forces move no place at once
        lag = Fault(f"lag of y_{axis}", "us", 1e6 * _LAG * dt, 1e6 * _MOST_LAG * dt)
        found.append((lag, only * (-1e-6 * y[j] @ A)))
    for j, k, bearing in _pairs(axes):
        turned = np.zeros((len(axes), y.shape[1]))
        turned[j], turned[k] = np.radians(1) * y[k], -np.radians(1) * y[j]
        found.append((_angle(f"sensors of {bearing} turned by"), turned))
    return found


def _gain(name: str) -> Fault:
    return Fault(name, "%", _GAIN, _MOST_GAIN)


def _angle(name: str) -> Fault:
    return Fault(name, "deg", _ANGLE, _MOST_ANGLE)


def _pairs(axes: Sequence[str]) -> list[tuple[int, int, str]]:
    """The places of zeta and eta of every bearing, and its name."""
    bearings = [axis.removesuffix("_zeta") for axis in axes if axis.endswith("_zeta")]
    return [
        (axes.index(f"{name}_zeta"), axes.index(f"{name}_eta"), name)
        for name in bearings
        if f"{name}_eta" in axes
    ]


def _crossed(
    dA: np.ndarray, dB: np.ndarray, theta: np.ndarray, paths: Sequence[str]
) -> tuple[list[Fault], np.ndarray, np.ndarray]:
    """The faults of magnets whose K_i of both axes are among ``paths``, and their directions."""
    n = dA.shape[1]
    faults = []
    found = []
    for zeta, path in enumerate(paths):
        if not (path.startswith("bearing.") and path.endswith(".force_per_current.zeta")):
            continue
        other = path.removesuffix("zeta") + "eta"
        if other not in paths:
            continue
        eta, name = paths.index(other), path.split(".")[1]

        # dK_i of an axis is b c': its force pushes along b (n,), c picks its current
        parts = [_rank_one(np.hstack([dA[i], dB[i]])) for i in (zeta, eta)]
        if None in parts:
            continue
        (b1, c1), (b2, c2) = (part for part in parts if part is not None)
        one, two = theta[zeta] * np.outer(b1, c2), theta[eta] * np.outer(b2, c1)
        faults.append(_gain(f"cross of the currents in {name}"))
        found.append((one + two) / 100)
        faults.append(_angle(f"magnets of {name} turned by"))
        found.append((one - two) * np.radians(1))
    both = np.array(found).reshape(len(found), n, n + dB.shape[2])
    return faults, both[:, :, :n], both[:, :, n:]


def _rank_one(M: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """b and c of M = b c', c of length one and with its largest entry positive; None where M is no
    such product.
    """
    u, s, v = np.linalg.svd(M)
    if not s[0] or s[1] > _RANK_ONE * s[0]:
        return None
    sign = np.sign(v[0][np.argmax(np.abs(v[0]))])
    return sign * s[0] * u[:, 0], sign * v[0]
