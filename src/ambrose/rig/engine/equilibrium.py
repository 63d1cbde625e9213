"""Where the virtual rig starts, and whether its step is short enough: all from its own equations,
differentiated.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.linalg

from ambrose.core.checks import NumericalFailure, check_positive, invalid
from ambrose.model.effects import magnet
from ambrose.rig.engine.controller import SampledLaw
from ambrose.rig.engine.inputs import Drive
from ambrose.rig.engine.products import COLUMNS, ROWS, filled, in_blocks
from ambrose.rig.engine.state import Rig, compiled

# The linear part of the virtual rig, moved exactly through a step: the matrices that
# rig/engine/exponential.py applies.


# longest step over an amplifier's shortest time: within it the current, exact in the linear part,
# bends by so little that the force is a parabola in time; assumed (a scenario's dt overrules it)
_SHORT = 0.5
# [rad/s] taken for amplifiers that are slower or ideal: steps of 0.5 ms at most; assumed
_SLOWEST = 1e3
_ROUNDING = 1e-9  # relative, so that a quotient that is whole but for rounding is no step more
_IDEAL, _TWICE_FIRST = 0.0, 2.0  # orders of an amplifier, places in AMPLIFIER_ORDERS
# [A] and [m] of the central differences of the force, small beside any bias current and gap;
# assumed, as what the differences miss is left to F, which is exact
_CURRENT_STEP, _DISPLACEMENT_STEP = 1e-4, 1e-7
# places in the rows of parameters that ``_linear_parts`` changes
_BIAS_AND_FORCES = [0, 4, 7]  # of model.effects.magnet: i_0, c of zeta, c of eta
_CLEARANCE = 0  # of model.effects.touchdown
_SLOPE_AND_CURRENT = slice(3, 5)  # of model.effects.amplifier: their limits
_OFFSET = 1  # of model.effects.sensor


class Propagator(NamedTuple):
    """n states in use, k outputs, f forces, columns: states, a commands, 1, unbalance (x, y), four
    per driven force.

    Matrices stand in blocks, n and k filled up to whole ones of rows and f and columns to those of
    columns (products.py). turns and seals: whether speed and seals may differ from those here,
    among the forces. Arrays from ``y`` on are scratch.
    """

    # False: the seals' added mass or the reaction of registered effects changes within the stretch,
    # or one of these is not linear
    usable: bool
    steps: int  # of a control sample
    # (n + 3 k, columns): states after a step; outputs at its start, middle and end
    linear: np.ndarray
    half: np.ndarray  # (k, f) outputs in the middle, of the forces held
    whole: np.ndarray  # (k, f) outputs at the end
    weights: np.ndarray  # (n, 3 f) states after a step of the forces at its start, middle and end
    states: np.ndarray  # (n,) of the rig's state
    # (b, 2, 4) what of the magnets' force is linear: by x, y and the two currents
    magnet: np.ndarray
    turns: bool
    speed: float  # [rad/s]
    # (3, 2) cosine and sine of what that turns by until a step's start, middle and end
    turn: np.ndarray
    seals: bool
    seal: np.ndarray  # (2, seals, 5 + 2 l) the coefficients here; scratch
    mass_inverse: np.ndarray
    reaction: np.ndarray  # of registered effects, here
    y: np.ndarray  # (k,)
    F: np.ndarray  # (3, f)
    known: np.ndarray  # (columns,)
    out: np.ndarray  # (n + 3 k,)
    start: np.ndarray  # (2,)


def propagator(
    rig: Rig, drive: Drive, at: Drive, steps: int, near: np.ndarray, last: Propagator | None = None
) -> Propagator:
    """For a stretch, with speed and seals of the sample ``at``, in so many steps per control
    sample; last if it still holds.

    The magnets are linear around the state near (n,).
    """
    turns = bool((drive.speed != at.speed[0]).any())
    varies = bool((drive.seal != at.seal[0]).any())
    if last is not None and _covers(rig, last, drive, at, turns, varies):
        return last
    quiet = at._replace(
        speed=np.full(2, at.speed[0]),
        angle=np.zeros(2),
        seal=at.seal[:1],
        mass_inverse=drive.mass_inverse[:1],
        reaction=at.reaction[:1],
        unbalance=np.zeros((0, 2)),
        force=np.zeros((4, 0, 1)),
        force_at=np.zeros((0, 2), dtype=np.int64),
        powered=np.ones((len(rig.axes), 1)),
    )
    return _built(rig, drive, quiet, steps, near, turns, varies)


def steps_within(rig: Rig, sample_time: float, dt: float | None) -> int:
    """The propagator's steps in a control sample [s]: of dt [s] at most, or (None) short beside the
    amplifiers' times.
    """
    # order, w [rad/s], second rate [rad/s] of every amplifier
    order, first, second = rig.constants.amplifier[:, :3].T
    rate = np.where(
        order == _TWICE_FIRST, np.maximum(first, second), np.maximum(first, _SLOWEST)
    ).max()

    # the steps in a sample, of _SHORT / rate [s] each
    per_second = rate / _SHORT if dt is None else 1 / dt
    return int(np.ceil(sample_time * per_second * (1 - _ROUNDING)))


def _covers(rig: Rig, last: Propagator, drive: Drive, at: Drive, turns: bool, varies: bool) -> bool:
    """Whether a propagator is the one for a stretch: unbalance and driven forces are the same all
    the time.
    """
    return (
        last.usable == _usable(rig, drive)
        and np.array_equal(last.reaction, at.reaction[:1])
        and np.array_equal(last.mass_inverse[:1], drive.mass_inverse[:1])
        and last.speed == at.speed[0]
        and np.array_equal(last.seal[0], at.seal[0])
        and last.turns >= turns
        and last.seals >= varies
    )


def _usable(rig: Rig, drive: Drive) -> bool:
    """``Propagator.usable``: added mass and reactions stand still, and no registered effect has a
    force that is not linear.
    """
    steady = len(drive.reaction) <= 1 or not np.ptp(drive.reaction, axis=0).any()
    return _same_mass(drive) and steady and not rig.constants.force_at.any()


def _same_mass(drive: Drive) -> bool:
    return len(drive.mass_inverse) <= 1 or not np.ptp(drive.mass_inverse, axis=0).any()


def _built(
    rig: Rig, drive: Drive, quiet: Drive, steps: int, near: np.ndarray, turns: bool, varies: bool
) -> Propagator:
    k = rig.constants
    a = len(rig.axes)
    p = rig.modes
    n = rig.coordinates
    b, first = len(k.magnet), len(k.magnet) + rig.attached_stations

    # 1. the linear rig: z' = L z + Bu u + w without the magnets
    L, Bu, w = _linear_parts(rig, quiet)

    # M^-1 of the added mass over all coordinates
    inverse = np.eye(n)
    if len(quiet.mass_inverse):
        inverse = quiet.mass_inverse[0]
        inverse = inverse if len(inverse) == n else _both_planes(inverse, n)

    # 2. (S, 2, n) displacements of the stations in x and y over the coordinates; ``pushes`` is
    # their transpose through M^-1, what a force there does to the velocities.
    rows = np.concatenate(
        [np.einsum("sp,de->sdpe", k.shape, np.eye(2)).reshape(-1, 2, 2 * p), -k.support_shape],
        axis=2,
    )
    places, speeds, pushes = (np.zeros((len(rows), 2, rig.states)) for _ in range(3))
    places[:, :, :n] = rows
    speeds[:, :, n : 2 * n] = rows
    pushes[:, :, n : 2 * n] = rows @ inverse.T
    modal = np.zeros((2 * p, rig.states))
    modal[:, n : 2 * n] = inverse[:, : 2 * p].T  # acceleration of all coordinates by a modal force

    # 3. the currents that make force: over the states, or over the commands where the amplifier is
    # ideal
    currents, direct = np.zeros((a, rig.states)), np.zeros((a, a))
    for i in range(a):
        if k.amplifier[i, 0] == _IDEAL:
            direct[i, i] = 1.0
        else:
            # two states per amplifier; the current is the second one of two lags in a row
            currents[i, 2 * n + 2 * i + (k.amplifier[i, 0] == _TWICE_FIRST)] = 1.0

    # 4. f = by (x, y, i_zeta, i_eta) at every bearing joins L and Bu
    by = _magnets(
        rig,
        places[:b].reshape(2 * b, -1) @ near,
        np.clip(currents @ near, -k.amplifier[:, 4], k.amplifier[:, 4]),
    )
    for i in range(b):
        push = pushes[i].T
        L += push @ (by[i, :, :2] @ places[i] + by[i, :, 2:] @ currents[2 * i : 2 * i + 2])
        Bu += push @ by[i, :, 2:] @ direct[2 * i : 2 * i + 2]

    # 5. F, in this order: magnets (2 b), then if the speed varies unbalance (2) and modal forces (2
    # p), then if the seals vary theirs (2 each). y: displacements at the bearings (2 b), currents
    # (a), modal velocities (2 p), with rotating damping modal displacements (2 p), per seal
    # displacement, velocity and states.
    forces, outputs = [pushes[:b].reshape(2 * b, -1)], [places[:b].reshape(2 * b, -1), currents]
    unbalance = np.zeros((0, rig.states))
    if len(drive.unbalance):
        # modal forces of a unit force along x and along y: (a, b) and (-b, a) per mode
        turned = np.stack(
            [drive.unbalance, np.column_stack([-drive.unbalance[:, 1], drive.unbalance[:, 0]])]
        )
        unbalance = turned.reshape(2, -1) @ modal
        forces += [unbalance] if turns else []
    if turns:
        forces.append(modal)
        outputs.append(np.eye(rig.states)[n : n + 2 * p])
        outputs.append(np.eye(rig.states)[: 2 * len(k.rotating)])
    if varies:
        lags = 2 * k.seal_lags.shape[1]
        for i in range(len(k.seal_lags)):
            start = rig.sensed.stop + lags * i
            outputs += [
                places[first + i],
                speeds[first + i],
                np.eye(rig.states)[start : start + lags],
            ]
            forces.append(pushes[first + i])

    # a unit force along a station's axis, in modes
    driven = np.zeros((len(drive.force_at), rig.states))
    for m, (s, axis) in enumerate(drive.force_at):
        c, d = k.direction[s]
        driven[m] = np.kron(k.shape[s], [c, d] if axis == 0 else [-d, c]) @ modal

    # 6. states without a row or column in L stay out; the bias stands still
    used = (L != 0).any(axis=0) | (L != 0).any(axis=1)
    used[rig.bias] = False
    used[rig.behind] = False
    B, C = np.vstack(forces).T[used], np.vstack(outputs)[:, used]

    # y = C z + D u; columns after u do not reach y directly
    D = np.zeros((len(C), a))
    D[2 * b : 2 * b + a] = direct
    inputs = np.column_stack([Bu, w])[used]
    speed, h = float(quiet.speed[0]), quiet.dt / steps

    # 7. the step, and half of it
    whole = _propagated(
        L[np.ix_(used, used)], B, inputs, unbalance.T[used], driven.T[used], speed, h
    )
    middle = _propagated(
        L[np.ix_(used, used)], B, inputs, unbalance.T[used], driven.T[used], speed, h, 0.5
    )
    states = used.sum()
    linear, half = whole[0], middle[0]
    D = np.hstack([np.zeros((len(C), states)), D, np.zeros((len(C), linear.shape[1] - states - a))])
    begin = np.hstack([C, np.zeros((len(C), linear.shape[1] - states))])

    # rows: states after the step; y at its start, middle and end, less what F does
    parts = [linear, begin + D, C @ half + D, C @ linear + D]
    linear = np.vstack([np.pad(part, ((0, -len(part) % ROWS), (0, 0))) for part in parts])

    # F as a parabola through its values at start, middle and end: F_0 + t (-3 F_0 + 4 F_m - F_1) +
    # t^2/2 (4 F_0 - 8 F_m + 4 F_1) gives the weights. Of the stages, the middle sees F_0 held for
    # half a step, the end 2 F_m - F_0 held for a whole one.
    one, two, three = whole[1]  # h phi_1 B, h phi_2 B, h phi_3 B
    ends = (one - 3 * two + 4 * three, 4 * two - 8 * three, 4 * three - two)
    padding = ((0, 0), (0, -B.shape[1] % COLUMNS))
    weights = np.hstack([np.pad(end, padding) for end in ends])
    angle = speed * h * np.array([0.0, 0.5, 1.0])
    seal = np.stack([quiet.seal[0], np.zeros_like(quiet.seal[0])])
    return Propagator(
        _usable(rig, drive),
        steps,
        in_blocks(linear),
        in_blocks(C @ middle[1][0]),
        in_blocks(C @ one),
        in_blocks(weights),
        np.flatnonzero(used),
        by,
        turns,
        speed,
        np.column_stack([np.cos(angle), np.sin(angle)]),
        varies,
        seal,
        quiet.mass_inverse,
        quiet.reaction,
        np.zeros(filled(len(C), ROWS)),
        np.zeros((3, filled(B.shape[1], COLUMNS))),
        np.zeros(filled(linear.shape[1], COLUMNS)),
        np.zeros(len(linear)),
        np.zeros(2),
    )


def _both_planes(inverse: np.ndarray, n: int) -> np.ndarray:
    """The inverse mass of one plane (p, p) for all n coordinates, x and y in turn, then the
    supports'.
    """
    return np.asarray(
        scipy.linalg.block_diag(np.kron(inverse, np.eye(2)), np.eye(n - 2 * len(inverse)))
    )


def _linear_parts(rig: Rig, drive: Drive) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (n, n), B (n, a) and the constant slope (n,) of the rig without magnets, contact, limits:
    exact, as all is linear.
    """
    k, a = rig.constants, len(rig.axes)
    idle = k.magnet.copy()
    free = k.touchdown.copy()
    endless = k.amplifier.copy()

    # magnets without bias current or force constant, touchdown bearings out of reach, no limits of
    # slope and current, no run-out
    idle[:, _BIAS_AND_FORCES] = 0.0
    free[:, _CLEARANCE] = np.inf
    endless[:, _SLOPE_AND_CURRENT] = np.inf
    smooth = k._replace(
        magnet=idle,
        touchdown=free,
        amplifier=endless,
        force_at=np.zeros_like(k.force_at),
        runout=k.runout[:0],
        runout_start=np.zeros_like(k.runout_start),
    )
    straight = Rig(rig.machine, rig.point, smooth, rig.port_names, rig.mass)

    # at z = 0, u = 0: what weight and sensors' offsets do
    nothing, silent = np.zeros(rig.states), np.zeros(a)
    w = slope(straight, drive, nothing, silent)

    # without these the slope is homogeneous: a column for every unit vector
    sensor = k.sensor.copy()
    sensor[:, _OFFSET] = 0.0
    straight = Rig(
        rig.machine,
        rig.point,
        smooth._replace(weight=0 * k.weight, sensor=sensor),
        rig.port_names,
        rig.mass,
    )
    A = slopes(straight, drive, np.eye(rig.states), silent[None]).T
    return A, slopes(straight, drive, nothing[None], np.eye(a)).T, w


def _magnets(rig: Rig, places: np.ndarray, currents: np.ndarray) -> np.ndarray:
    """(b, 2, 4): derivatives of the magnets' force in x and y by displacements in x and y and by
    the two currents.
    """
    result = np.empty((len(rig.constants.magnet), 2, 4))
    steps = 2 * (_CURRENT_STEP,) + 2 * (_DISPLACEMENT_STEP,)
    for i, p in enumerate(rig.constants.magnet):
        c, s = rig.constants.direction[i]
        turn = np.array([[c, -s], [s, c]])
        # in the bearing's axes (i_zeta, i_eta, zeta, eta), central differences; columns end as
        # (zeta, eta, i_zeta, i_eta)
        at = np.concatenate([currents[2 * i : 2 * i + 2], turn.T @ places[2 * i : 2 * i + 2]])
        for j, size in enumerate(steps):
            step = size * np.eye(4)[j]
            ends = [
                np.array(magnet.force(v[0], v[1], v[2], v[3], tuple(p)))
                for v in (at + step, at - step)
            ]
            result[i, :, (j + 2) % 4] = turn @ (ends[0] - ends[1]) / (2 * size)

        # displacements back to x and y; the forces are turned already
        result[i, :, :2] = result[i, :, :2] @ turn.T
    return result


def _propagated(
    A: np.ndarray,
    B: np.ndarray,
    held: np.ndarray,
    turning: np.ndarray,
    driven: np.ndarray,
    speed: float,
    h: float,
    part: float = 1,
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """After a part of a step of h [s]: states from (states, held, turning at its start, driven and
    three derivatives over h); and what forces B that grow as 1, t, t^2/2 (t over h) have moved.
    """
    # Blocks: 0 states; 1, 2, 3 forces B growing as 1, t, t^2/2; 4 held; 5 turning (x, y); 6 to 9
    # driven forces and three derivatives. Time counts in steps.
    n = len(A)
    f = B.shape[1]
    m = driven.shape[1]
    sizes = [n, f, f, f, held.shape[1], turning.shape[1], m, m, m, m]
    at = np.cumsum([0, *sizes])
    Z = np.zeros((at[-1], at[-1]))
    part_of = [slice(at[i], at[i + 1]) for i in range(len(sizes))]
    for block, columns in ((0, A), (1, B), (4, held), (5, turning), (6, driven)):
        Z[:n, part_of[block]] = h * columns

    # a block's derivative is the next one
    for block in (1, 2, 6, 7, 8):
        Z[part_of[block], part_of[block + 1]] = np.eye(sizes[block])
    if turning.shape[1]:
        Z[part_of[5], part_of[5]] = speed * h * np.array([[0.0, -1.0], [1.0, 0.0]])

    # first rows of exp(part Z): exp(part h A), and the integrals of exp(h A s) with what drives
    X = scipy.linalg.expm(part * Z)[:n]
    order = [X[:, part_of[0]], X[:, part_of[4]], X[:, part_of[5]]]

    # per driven force its value and three derivatives side by side
    growth = np.stack([X[:, part_of[i]] for i in (6, 7, 8, 9)], axis=2).reshape(n, 4 * m)
    return np.hstack([*order, growth]), (X[:, part_of[1]], X[:, part_of[2]], X[:, part_of[3]])


# (Fastest pole) times step: chosen at most (error 3e-6 in the tests), and refused above; unstable
# from 2.6 on.
_COMFORTABLE, _LARGEST = 0.2, 1.0
_ITERATIONS = 50  # of Newton's method, at most
_DOWN = -np.pi / 2  # where a weightless rotor rests


def slope(rig: Rig, drive: Drive, z: np.ndarray, u: np.ndarray) -> np.ndarray:
    """dz/dt (n,) with the amplifiers told u (a,), at the start of the drive."""
    return slopes(rig, drive, z[None], u[None])[0]


def slopes(rig: Rig, drive: Drive, Z: np.ndarray, U: np.ndarray) -> np.ndarray:
    """``slope`` (p, n) of states Z (p or 1, n) with U (p or 1, a)."""
    count = max(len(Z), len(U))
    Z, U = (np.array(np.broadcast_to(X, (count, X.shape[1])), dtype=float) for X in (Z, U))
    compiled()[1](rig.constants, drive, 0, U, Z, rig.work(), dZ := np.zeros_like(Z))
    return dZ


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

    def force(Q: np.ndarray, U: np.ndarray) -> np.ndarray:
        Z = np.array([state_at_rest(rig, q, u) for q in Q for u in U])
        return slopes(rig, drive, Z, U)[:, n : 2 * n]

    for _ in range(_ITERATIONS):
        u = law.C @ x + law.D @ (aim - S @ q)
        # unknowns (q, x): accelerations f(q, u) = 0 and (A - I) x + B e = 0, with u = C x + D e
        at, told = q[None], u[None]
        moved = (law.A - np.eye(m)) @ x + law.B @ (aim - S @ q)
        missing = np.concatenate([force(at, told)[0], moved])

        # Jacobian by (q, x): du = C dx - D S dq, de = -S dq
        by_place = _differences(lambda Q, told=told: force(Q, told), q, 1e-8)  # type: ignore[misc]
        by_current = _differences(lambda U, at=at: force(at, U), u, 1e-6)  # type: ignore[misc]
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
            f"{np.abs(u).max():.3g} A needed); reduce the static load, raise max_current or the "
            "bias, or start with initial = "
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
    A = _differences(lambda Z: slopes(rig, drive, Z, u[None]), z, size)
    return A, _differences(lambda U: slopes(rig, drive, z[None], U), u, 1e-5)


def _differences(
    function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, size: float | np.ndarray
) -> np.ndarray:
    """The derivative (m, n) at a point (n,) of a function of points (p, n) with values (p, m), by
    central differences of ``size``.
    """
    size = np.broadcast_to(size, at.shape)
    steps = np.diag(size)
    low, high = np.split(function(np.concatenate([at - steps, at + steps])), 2)
    return ((high - low) / (2 * size[:, None])).T


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
