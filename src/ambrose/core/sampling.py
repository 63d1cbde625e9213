"""Sampling: zero-order hold, Tustin, backward Euler, matched poles and zeros, with delay.

States keep their meaning; the matrices are balanced for the work.
"""

from typing import Any, Literal, get_args

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    check_positive,
    invalid,
    named_failure,
)
from ambrose.core.realisation import invariant_zeros
from ambrose.core.statespace import (
    StateSpace,
    as_statespace,
    balance_matrix as balance,
    series,
    transfer_function,
)

Method = Literal["zoh", "tustin", "backward-euler", "matched"]
_NO_PREWARP = ("zoh", "backward-euler")
MOST_SAMPLES = 1000  # by which ``delayed`` makes a system late
_UNSEEN = 1e-12  # of the largest state's response
# of the largest gain: between channels that are apart; by which poles and zeros may be missed
_MIXING, _MATCHED = 1e-9, 1e-8


@named_failure("the sampled system")
def c2d(
    system: Any, dt: float, method: Method = "zoh", delay: float = 0.0, prewarp: float | None = None
) -> StateSpace:
    """The sampled equivalent of a continuous system.

    dt [s]; ``zoh`` is exact for an input held between samples (plants), ``tustin`` the bilinear map
    (controllers), exact at the frequency ``prewarp`` [rad/s] if given, ``backward-euler`` s = (z -
    1)/(z dt); all to rounding (1e-11 of the largest sample of the impulse response). ``matched``
    maps every channel's poles and zeros by z = exp(s dt), those at infinity to -1, with the gain at
    rest, or at ``prewarp``, as before (Franklin, Powell & Workman 1998, sec. 6.2); its channels
    must not mix. ``delay`` [s] acts on the input: any value for ``zoh`` (the fractional part
    exactly, the same, sec. 4.3.4), whole samples for the others. Raises InvalidInput.
    """
    system = as_statespace(system)
    if system.dt is not None:
        raise invalid("the system's dt", system.dt, "None (continuous)", "it is sampled already")
    check_positive(dt, "dt", "give the sample time in seconds")
    check_positive(delay, "delay", "give it in seconds", zero_allowed=True)

    # Whole samples and the rest; what is off by rounding (1e-9 of a sample) counts as whole.
    whole = int(np.floor(delay / dt + 1e-9))
    fraction = max(delay - whole * dt, 0.0)
    if fraction < 1e-9 * dt:
        fraction = 0.0
    if method not in get_args(Method):
        raise invalid(
            "method", repr(method), f"one of {', '.join(get_args(Method))}", "choose one of them"
        )
    if method in _NO_PREWARP and prewarp is not None:
        raise invalid("prewarp", prewarp, f"None with method {method!r}", "use method='tustin'")
    if (
        prewarp is not None
        and check_positive(prewarp, "prewarp", "give a frequency in rad/s") * dt >= np.pi
    ):
        raise invalid(
            "prewarp", f"{prewarp:g} rad/s", f"below Nyquist {np.pi / dt:g} rad/s", "sample faster"
        )
    if method == "zoh":
        return delayed(_zoh(system, dt, fraction), whole)
    if fraction:
        raise invalid(
            "delay",
            f"{delay:g} s",
            f"a whole number of samples of {dt:g} s",
            "use method='zoh' for fractions",
        )
    if method == "matched":
        sampled = _matched(system, dt, prewarp)
    elif method == "backward-euler":
        sampled = _mapped(system, dt, dt, 0.0)
    else:
        # s = j prewarp at z = exp(j prewarp dt): j tan(prewarp dt/2) = s half
        half = dt / 2 if prewarp is None else float(np.tan(prewarp * dt / 2)) / prewarp
        sampled = _mapped(system, dt, half, half)
    return delayed(sampled, whole)


def delayed(system: Any, samples: int) -> StateSpace:
    """A sampled system that receives its input ``samples`` samples late, 0 to ``MOST_SAMPLES``.
    Raises InvalidInput.
    """
    system = as_statespace(system)
    if (
        isinstance(samples, bool)
        or not isinstance(samples, int | np.integer)
        or not 0 <= samples <= MOST_SAMPLES
    ):
        remedy = "every sample is a state for each input; take a slower model for a longer delay"
        raise invalid("samples", repr(samples), f"a whole number from 0 to {MOST_SAMPLES}", remedy)
    if system.dt is None:
        raise InvalidInput("a continuous system has no samples; sample it with c2d first")

    # A unit delay for every input, x[k+1] = u[k], y = x, as often as asked for.
    names, one = system.inputs, np.eye(len(system.inputs))
    for _ in range(samples):
        system = series(StateSpace(0 * one, one, one, 0 * one, names, names, system.dt), system)
    return system


def _zoh(system: StateSpace, dt: float, fraction: float) -> StateSpace:
    A = system.A
    B = system.B
    C = system.C
    D = system.D
    # the part of the interval in which the newest input acts
    early, gain_early = held(A, B, dt - fraction)
    if fraction == 0.0:
        return StateSpace(early, gain_early, C, D, system.inputs, system.outputs, dt)

    # With fraction f the input u[k-1] acts for f, then u[k] for dt - f; states (x, u[k-1]), Gam(t)
    # the integral of exp(A s) B over 0..t:
    # x[k+1] = exp(A (dt - f)) (exp(A f) x + Gam(f) u[k-1]) + Gam(dt - f) u[k],   y = C x + D u[k-1]
    n, m = B.shape
    held_A, gain_late = held(A, B, fraction)
    return StateSpace(
        np.block([[early @ held_A, early @ gain_late], [np.zeros((m, n + m))]]),
        np.vstack([gain_early, np.eye(m)]),
        np.hstack([C, D]),
        np.zeros_like(D),
        system.inputs,
        system.outputs,
        dt,
    )


def held(A: np.ndarray, B: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """exp(A t) and the integral of exp(A s) B over 0..t, for A (..., n, n) and B (..., n, m), from
    one exponential (Van Loan 1978) of the balanced matrix.

    B is scaled to the size of A: without both scalings large entries cost as many squarings, and
    digits.
    """
    n, m = B.shape[-2:]
    A, t = balance(A)
    B = B / t[:, None]

    # A power of two that makes B as large as A, or as 1/time where A is smaller.
    largest, wanted = (float(np.abs(X).sum(axis=-2).max(initial=0.0)) for X in (B, A))
    size = np.exp2(np.round(np.log2(max(wanted, 1 / time) / max(largest, 1e-280))))

    # exp([[A, B], [0, 0]] t) = [[exp(A t), integral of exp(A s) B], [0, I]]; x = diag(t) z
    joint = np.zeros((*A.shape[:-2], n + m, n + m))
    joint[..., :n, :n], joint[..., :n, n:] = A * time, B * size * time
    E = sla.expm(joint)
    return E[..., :n, :n] * t[:, None] / t, E[..., :n, n:] * t[:, None] / size


def _mapped(system: StateSpace, dt: float, ahead: float, behind: float) -> StateSpace:
    """s = (z - 1)/(ahead z + behind): Tustin's map with half the sample time twice, backward Euler
    with all of it ahead.
    """
    n = system.n_states
    A, t = balance(system.A)
    B, C = system.B / t[:, None], system.C * t

    # E = I - ahead A is singular where ahead s = 1 for a pole s: z would be infinite.
    if n and np.abs(1 - ahead * np.linalg.eigvals(A)).min() < 1e-12:
        raise InvalidInput(
            f"a pole at {1 / ahead:g} rad/s has no sampled equivalent by this map; change the "
            "sample time"
        )

    # (z - 1) x = (ahead z + behind)(A x + B u); with the states E x - ahead B u, which need no
    # input of the next sample:
    # Ad = E^-1 (I + behind A), Bd = (ahead + behind) E^-1 B, C E^-1, D + ahead C E^-1 B
    E = np.eye(n) - ahead * A
    Ad = np.linalg.solve(E, np.eye(n) + behind * A)
    Bd = np.linalg.solve(E, B) * (ahead + behind)
    CE = np.linalg.solve(E.T, C.T).T
    D = system.D + ahead * CE @ B
    return StateSpace(
        Ad * t[:, None] / t, Bd * t[:, None], CE / t, D, system.inputs, system.outputs, dt
    )


def _matched(system: StateSpace, dt: float, prewarp: float | None) -> StateSpace:
    """Every channel with the states, A and B of its zero-order hold, and the C and D that give it
    the zeros it must have.
    """
    sampled = _zoh(system, dt, 0.0)
    n = system.n_states
    m = len(system.inputs)
    C, D = np.zeros((m, n)), np.zeros((m, m))

    # Enough points for C and D of every channel (n + 1 unknowns), up to just below Nyquist.
    omega = np.geomspace(1e-5, 0.99, 8 * n + 40) * np.pi / dt
    before = _responses(system, 1j * omega)
    if before.shape[1] != m or np.abs(before * (1 - np.eye(m))).max(initial=0.0) > _MIXING * np.abs(
        before
    ).max(initial=0.0):
        raise InvalidInput(
            "'matched' maps poles and zeros of one channel at a time, and here channels mix; use "
            "'tustin'"
        )
    z = np.exp(1j * omega * dt)
    for i in range(m):
        # Channel i alone: the states between its input and its output.
        inner_states = between(system, i)
        A = system.A[np.ix_(inner_states, inner_states)]
        b = system.B[inner_states, i : i + 1]
        c = system.C[i : i + 1, inner_states]
        d = system.D[i : i + 1, i : i + 1]
        target = _matched_response(StateSpace(A, b, c, d), before[:, i, i], omega, dt, prewarp)

        # (z - Ad)^-1 Bd of the hold: the channel's response is C times this + D, linear in C and D.
        states = _responses(
            StateSpace(
                sampled.A[np.ix_(inner_states, inner_states)],
                sampled.B[inner_states, i : i + 1],
                np.eye(len(inner_states)),
                np.zeros((len(inner_states), 1)),
            ),
            z,
        )

        # Relative errors: every row over the magnitude of the target.
        known = (
            np.hstack([states[:, :, 0], np.ones((len(z), 1))])
            / np.maximum(np.abs(target), 1e-300)[:, None]
        )

        # Columns of length one; states that the input hardly moves stay out, with C = 0.
        size = np.linalg.norm(known, axis=0)
        visible = size > _UNSEEN * size.max()
        wanted = target / np.maximum(np.abs(target), 1e-300)

        # C and D are real: real and imaginary parts one below the other.
        rows, right = (
            np.vstack([known.real, known.imag])[:, visible] / size[visible],
            np.concatenate([wanted.real, wanted.imag]),
        )
        coefficients = np.linalg.lstsq(rows, right, rcond=None)[0]

        # The zeros asked for are met only if the fit is exact.
        if np.abs(rows @ coefficients - right).max() > _MATCHED:
            raise NumericalFailure(
                "'matched' misses its zeros: the channel's poles are too close for that; use "
                "'tustin'"
            )
        values = np.zeros(len(size))
        values[visible] = coefficients / size[visible]
        C[i, inner_states], D[i, i] = values[:-1], values[-1]
    return StateSpace(sampled.A, sampled.B, C, D, system.inputs, system.outputs, dt)


def between(system: StateSpace, i: int) -> np.ndarray:
    """The states that input i drives, directly or through others, and that output i sees."""
    # Links of one step or none; squared, of 2, 4, ... steps, up to n.
    linked = (system.A != 0) | np.eye(system.n_states, dtype=bool)
    for _ in range(system.n_states.bit_length()):
        linked = linked @ linked  # as truth values
    return np.flatnonzero((linked @ (system.B[:, i] != 0)) & ((system.C[i] != 0) @ linked))


def _responses(system: StateSpace, points: np.ndarray) -> np.ndarray:
    """C (s - A)^-1 B + D at the points s (k,): (k, p, m)."""
    inner = points[:, None, None] * np.eye(system.n_states) - system.A
    return (
        system.C @ np.linalg.solve(inner, np.broadcast_to(system.B, (len(points), *system.B.shape)))
        + system.D
    )


def _matched_response(
    channel: StateSpace, before: np.ndarray, omega: np.ndarray, dt: float, prewarp: float | None
) -> np.ndarray:
    """The sampled channel at omega (k,) [rad/s]; before (k,): the continuous one."""
    below, above = np.linalg.eigvals(channel.A).astype(complex), invariant_zeros(channel)
    s = 1j * omega

    # G = gain prod(s - zeros)/prod(s - poles): the same gain at every s, but for rounding.
    gain = np.median(
        (before * np.prod(s[:, None] - below, axis=1) / np.prod(s[:, None] - above, axis=1)).real
    )

    def sampled(z: np.ndarray) -> np.ndarray:
        """With unit gain of s at rest: (s - a) stands for (z - exp(a dt)) a/expm1(a dt), and 1 for
        (z + 1)/2.
        """
        factors = [
            _slope(roots, dt) * (z[:, None] - np.exp(roots * dt)) for roots in (above, below)
        ]
        return (
            ((z + 1) / 2) ** (len(below) - len(above))
            * np.prod(factors[0], axis=1)
            / np.prod(factors[1], axis=1)
        )

    if prewarp is not None:
        at = np.array([prewarp])
        gain *= float(
            np.abs(
                _responses(channel, 1j * at)[0, 0, 0] / (gain * sampled(np.exp(1j * at * dt))[0])
            )
        )
    return np.asarray(gain * sampled(np.exp(1j * omega * dt)))


def _slope(roots: np.ndarray, dt: float) -> np.ndarray:
    """a/expm1(a dt), 1/dt at a = 0."""
    moving = np.abs(roots) * dt > 1e-12
    return np.where(moving, roots / np.where(moving, np.expm1(roots * dt), 1.0), 1 / dt)


def hold(omega: np.ndarray, dt: float) -> np.ndarray:
    """Zero-order hold over dt [s] at omega (w,) [rad/s], unit gain at zero frequency: sinc(w T/2)
    exp(-j w T/2), (w,).
    """
    half = omega * dt / 2
    return np.sinc(half / np.pi) * np.exp(-1j * half)


def pade(delay: float, order: int, input: str = "u1", output: str = "y1") -> StateSpace:
    """All-pass approximation of a pure delay [s] (diagonal Pade), for continuous loop models."""
    check_positive(delay, "delay", "leave the delay out if there is none")
    if not isinstance(order, int | np.integer) or not 1 <= order <= 12:
        raise invalid(
            "order", order, "a whole number from 1 to 12", "2 suits a delay of one sample"
        )

    # sum_k c_k (s delay)^k below, sum_k c_k (-s delay)^k above,
    # c_k/c_(k-1) = (order - k + 1)/(k (2 order - k + 1))
    c = np.ones(order + 1)
    for k in range(1, order + 1):
        c[k] = c[k - 1] * (order - k + 1) / (k * (2 * order - k + 1))
    powers = np.arange(order + 1)
    denominator = (c * delay**powers)[::-1]
    return transfer_function(denominator * (-1.0) ** powers[::-1], denominator, input, output)
