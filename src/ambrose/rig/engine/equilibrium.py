"""Where the virtual rig starts, and whether its step is short enough: all from its own equations,
differentiated.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from ambrose.core.checks import NumericalFailure, check_positive, invalid
from ambrose.rig.engine.controller import SampledLaw
from ambrose.rig.engine.inputs import Drive
from ambrose.rig.engine.state import Rig, compiled

# (Fastest pole) times step: chosen at most (error 3e-6 in the tests), and refused above; unstable
# from 2.6 on.
_COMFORTABLE, _LARGEST = 0.2, 1.0
_ITERATIONS = 50  # of Newton's method, at most
_DOWN = -np.pi / 2  # where a weightless rotor rests


def slope(rig: Rig, drive: Drive, z: np.ndarray, u: np.ndarray) -> np.ndarray:
    """dz/dt (n,) with the amplifiers told u (a,), at the start of the drive."""
    dz = np.zeros_like(z)
    compiled()[1](rig.constants, drive, 0, np.asarray(u, dtype=float), z, rig.work(), dz)
    return dz


def measurement(rig: Rig) -> np.ndarray:
    """Matrix (a, n): what the sensors show of the state, without offset and run-out."""
    k, C = rig.constants, np.zeros((len(rig.constants.sensor), rig.states))
    for c in range(len(C)):
        if k.sensor[c, 2] > 0:
            C[c, rig.sensed.start + c] = 1.0
        else:
            C[c, : rig.coordinates] = _seen(rig)[c]
    return np.asarray(k.mean @ C)


def state_at_rest(rig: Rig, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The state at rest at displacements q (n,) with all currents settled at u (a,)."""
    n, a = rig.coordinates, len(rig.axes)
    z = np.zeros(rig.states)
    z[:n] = q

    # both lags in turn of "twice-first" settle at u, and both states of "current-loop"; else the
    # second state is at rest at zero
    currents = z[2 * n : 2 * n + 2 * a].reshape(a, 2)
    currents[:, 0] = u
    if rig.machine.amplifier.order in ("twice-first", "current-loop"):
        currents[:, 1] = u
    z[rig.bias] = np.repeat(rig.constants.magnet[:, 0], 2)
    z[rig.sensed] = _seen(rig) @ q + rig.constants.sensor[:, 1]

    # seals' states: A x + b q = 0
    first = len(rig.machine.bearings) + rig.attached_stations
    everywhere = _places(rig, q)
    places = everywhere[first : first + len(rig.machine.seals)]
    lags = rig.constants.seal_lags
    # states per displacement
    settled = -np.linalg.solve(lags[..., :-1], lags[..., -1:]) if lags.size else lags[..., -1:]
    z[rig.sensed.stop : rig.attached.start] = (settled * places[:, None]).ravel()
    z[rig.attached] = _attached_at_rest(rig, everywhere[len(rig.machine.bearings) : first])
    return z


def _attached_at_rest(rig: Rig, places: np.ndarray) -> np.ndarray:
    """The states (e,) of registered effects at rest at displacements places (t, 2) in x and y:
    A x + B q = 0.
    """
    ports = 2 * rig.attached_stations
    A, B = (rig.constants.reaction[ports:, i:j] for i, j in ((2 * ports, None), (0, ports)))
    if not len(A):
        return np.zeros(0)
    c, s = rig.constants.direction[len(rig.machine.bearings) :][: rig.attached_stations].T
    x, y = places.T
    q = np.column_stack([c * x + s * y, c * y - s * x]).ravel()
    return np.asarray(np.linalg.lstsq(A, -B @ q, rcond=None)[0])


@lru_cache(maxsize=4)
def _seen(rig: Rig) -> np.ndarray:
    """The single sensors over the displacements (c, n), with gain."""
    k, rows = rig.constants, []
    for a in range(len(k.sensor)):
        c, s = np.cos(k.sensor_angle[a // 2]), np.sin(k.sensor_angle[a // 2])
        weights = np.array([c, s] if a % 2 == 0 else [-s, c])
        moved = np.concatenate(
            [np.kron(k.sensor_shape[a // 2], weights), -(weights @ k.sensor_support[a // 2])]
        )
        rows.append(k.sensor[a, 0] * moved)
    return np.array(rows)


def _places(rig: Rig, q: np.ndarray) -> np.ndarray:
    """Displacements (S, 2) of the stations, relative to what they stand on, at displacements q
    (n,).
    """
    k, n = rig.constants, 2 * rig.modes
    return np.asarray(k.shape @ q[:n].reshape(-1, 2) - k.support_shape @ q[n:])


def levitated_state(
    rig: Rig, drive: Drive, law: SampledLaw
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State z (n,) of the machine, state x of the controller and its output u (a,), in equilibrium
    at the drive's start.

    Newton's method on the rig's own forces; run-out and what turns are left out. Raises
    NumericalFailure where weight and loads need more current than there is.
    """
    n, m = rig.coordinates, len(law.A)

    # y = S q + offset with r = 0: e = aim - S q
    mean = rig.constants.mean
    S = mean @ _seen(rig)
    aim = -mean @ rig.constants.sensor[:, 1]
    q, x = np.zeros(n), np.zeros(m)

    def force(q: np.ndarray, u: np.ndarray) -> np.ndarray:
        return slope(rig, drive, state_at_rest(rig, q, u), u)[n : 2 * n]

    for _ in range(_ITERATIONS):
        u = law.C @ x + law.D @ (aim - S @ q)
        # unknowns (q, x): accelerations f(q, u) = 0 and (A - I) x + B e = 0, with u = C x + D e
        missing = np.concatenate([force(q, u), (law.A - np.eye(m)) @ x + law.B @ (aim - S @ q)])

        # Jacobian by (q, x): du = C dx - D S dq, de = -S dq
        by_place = _differences(lambda q, u=u: force(q, u), q, 1e-8)  # type: ignore[misc]
        by_current = _differences(lambda u, q=q: force(q, u), u, 1e-6)  # type: ignore[misc]
        matrix = np.block(
            [
                [by_place - by_current @ law.D @ S, by_current @ law.C],
                [-law.B @ S, law.A - np.eye(m)],
            ]
        )

        # Rows and columns scaled to norm one; the smallest step where the matrix is singular.
        rows = np.linalg.norm(matrix, axis=1)
        columns = np.linalg.norm(matrix / np.where(rows == 0, 1.0, rows)[:, None], axis=0)
        rows, columns = np.where(rows == 0, 1.0, rows), np.where(columns == 0, 1.0, columns)
        step = (
            -np.linalg.lstsq(matrix / rows[:, None] / columns, missing / rows, rcond=1e-13)[0]
            / columns
        )
        q, x = q + step[:n], x + step[n:]

        # displacements to 1e-14 m and the step's current to 1e-12 A
        still = np.abs(step[:n]).max() < 1e-14 and np.abs(law.C @ step[n:]).max() < 1e-12
        if still:
            break
    u = law.C @ x + law.D @ (aim - S @ q)
    if not still or (np.abs(u) >= law.limit).any() or _penetration(rig, q) >= 0:
        raise NumericalFailure(
            "the rotor has no levitated equilibrium in this scenario (currents up to "
            f"{np.abs(u).max():.3g} A were asked for); "
            "reduce the static load, raise max_current or the bias, or start with initial = "
            '"resting"'
        )
    return state_at_rest(rig, q, u), x, u


def landed_state(rig: Rig, law: SampledLaw) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As ``levitated_state``, the rotor lying in the touchdown bearings, no current in the coils,
    the controller at zero.
    """
    gaps = rig.constants.touchdown[:, 0]
    if not np.isfinite(gaps).all():
        raise invalid(
            "the touchdown_gap of a bearing",
            "missing",
            "given for a start from rest",
            "add it to every bearing",
        )
    direction = rig.machine.gravity_direction
    direction = _DOWN if direction is None else direction
    z = _displaced(rig, gaps, [np.cos(direction), np.sin(direction)])
    z[rig.bias] = 0.0
    return z, np.zeros(len(law.A)), np.zeros(len(rig.axes))


def _displaced(rig: Rig, distance: np.ndarray, direction: list[float]) -> np.ndarray:
    """The state at rest without current, moved rigidly by distances (b,) [m] at the bearings in a
    direction (2,).
    """
    plane = np.zeros(rig.modes)
    # the two rigid modes of a plane, fitted to the distances
    plane[:2] = np.linalg.lstsq(rig.constants.shape[: len(distance), :2], distance, rcond=None)[0]
    q = np.concatenate([np.kron(plane, direction), np.zeros(len(rig.constants.support))])
    return state_at_rest(rig, q, np.zeros(len(rig.axes)))


def _penetration(rig: Rig, q: np.ndarray) -> float:
    """How far [m] the rotor is inside the touchdown bearing where it is farthest; negative: free
    everywhere.
    """
    k, b = rig.constants, len(rig.machine.bearings)
    place = _places(rig, q)[:b]
    return float((np.hypot(place[:, 0], place[:, 1]) - k.touchdown[:, 0]).max())


def linear_view(
    rig: Rig, drive: Drive, z: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A = d(dz/dt)/dz (n, n) and B = d(dz/dt)/du (n, a) by central differences."""
    n, a = rig.coordinates, len(rig.axes)
    # steps: displacements 1e-8 m, velocities 1e-5 m/s, amplifiers and bias 1e-5 A, then sensors,
    # seals and effects
    size = np.concatenate(
        [
            np.full(n, 1e-8),
            np.full(n, 1e-5),
            np.full(3 * a, 1e-5),
            np.full(rig.states - rig.sensed.start, 1e-8),
        ]
    )
    A = _differences(lambda z: slope(rig, drive, z, u), z, size)
    return A, _differences(lambda u: slope(rig, drive, z, u), u, 1e-5)


def _differences(
    function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, size: float | np.ndarray
) -> np.ndarray:
    size = np.broadcast_to(size, at.shape)
    columns = []
    for i, h in enumerate(size):
        low, high = at.copy(), at.copy()
        low[i] -= h
        high[i] += h
        columns.append((function(high) - function(low)) / (2 * h))
    return np.column_stack(columns)


def fastest_pole(rig: Rig, drives: list[Drive]) -> float:
    """The largest modulus [rad/s] of a pole of the rig, free and touching the touchdown bearings,
    in all of the drives.
    """
    gaps, u = rig.constants.touchdown[:, 0], np.zeros(len(rig.axes))

    # free, and 5 % beyond every clearance: in contact
    states = [state_at_rest(rig, np.zeros(rig.coordinates), u)]
    # race and ring have a step of their own (contact_step)
    if np.isfinite(gaps).all() and not rig.constants.behind:
        states.append(_displaced(rig, 1.05 * gaps, [1.0, 0.0]))
    magnitudes = [
        np.abs(np.linalg.eigvals(linear_view(rig, drive, z, u)[0])).max()
        for drive in drives
        for z in states
    ]
    return float(max(magnitudes))


def steps_per_sample(dt: float | None, sample_time: float, fastest: float) -> int:
    """Integration steps in a control sample: of dt [s] at most (None: a fifth of the fastest pole's
    time).

    Raises InvalidInput where dt is too long for the fastest pole [rad/s].
    """
    if dt is None:
        return int(np.ceil(sample_time * fastest / _COMFORTABLE * (1 - 1e-9)))
    check_positive(dt, "dt", "give the integration step in seconds")
    if min(dt, sample_time) * fastest > _LARGEST:
        raise invalid(
            "the integration step",
            f"{dt:g} s",
            f"at most {_LARGEST / fastest:.3g} s: the machine's fastest pole has {fastest:.4g} "
            "rad/s",
            "give a shorter dt, or None to have it chosen",
        )
    return int(np.ceil(sample_time / dt * (1 - 1e-9)))
