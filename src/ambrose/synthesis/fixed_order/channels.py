"""The responses that tuning holds below limits: closed-loop channels T = A - B Q C, and the
settling of a pulse in time.

A channel's rows are divided by their limits, so that sigma_max(T) is a ratio; with Q = K (I + G
K)^-1 both are affine in Q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_banded
from scipy.sparse import csr_array

from ambrose.core.aliasing import FastModes, fast_modes
from ambrose.core.frequency import SchurForm, evaluate, frequency_response, schur_form
from ambrose.core.sampling import c2d, delayed, hold
from ambrose.core.statespace import StateSpace, balance_system, select
from ambrose.judge.measured import MEASURED
from ambrose.law.loop import Timing
from ambrose.machine.criteria import CLEARANCE, CURRENT_PULSE as PULSE, SENSITIVITY, demand
from ambrose.machine.machine import Machine
from ambrose.model.effects.rotor import finite_element_rotor, free_modes
from ambrose.model.plant import Plant, highest_verified, top_speed
from ambrose.model.static_load import magnet_coefficients, residual_unbalance

# What tuning aims at: the requirements of the machine file and the standards' defaults, as limits
# of a loop's responses.
#
# Limits that the file leaves out are those that verification judges by (machine/criteria.py). Three
# are guards of ours, without which a search exploits what nobody looks at: the controller's gain,
# the damping of modes above the running speed, and a sensitivity that falls towards zero frequency,
# so that an integral action is kept.


# assumed: sigma_max(S_o) below 2 rad/s falls to 0.01; with a settling time t_s below 1/t_s
_BANDWIDTH, _STIFF = 2.0, 0.01
_GAIN = 1.5  # assumed: times the largest gain of the controller that tuning starts from
_GUARD = 0.3  # assumed: of the rotor's modal damping, for modes above the top speed
DAMPING_GUARD = "damping_above"  # the ratio of that guard
SENSITIVITY_GUARD = "sensitivity_low"  # and of the one towards zero frequency,
FALLS = 0.99  # which stands where the limit is below this share of that of the sensitivity
MARGIN = 1.05  # of dampings, which are judged on the full plant, and by its peaks
_ROLLED = 8.0  # the grid reaches this many times past the roll-off
_BEYOND = 2.4  # the grid reaches this many times past the range of ISO 14839-3


@dataclass(frozen=True, slots=True)
class Aims:
    """Limits; None asks for nothing.

    sensitivity M, bandwidth w_B [rad/s], stiff A [-]: sigma_max(S_o) stays below |(s + w_B A)/(s/M
    + w_B)|. gain [A/m]: of K S_o, falling above roll_off [rad/s]. unbalance U [kg m] up to
    ``unbalance_to`` [rad/s]: orbit [m], currents (a,) [A] and forces (a,) [N] (nan: none), voltage:
    (largest [V], inductance [H]) of a coil. compliance [m/N]. settling [s] after the current pulse.
    damping [-] of modes below ``damped_to`` [rad/s], guard [-] of those above. running [rad/s]:
    lowest and highest speed, near which modes are damped as API 617's separation margin asks.
    highest [rad/s]: end of the grid. gain_asked, damping_asked: whether the machine file asks for
    the gain and for the damping of modes above; tame [A/m]: the guard of the gain where it does
    not.
    """

    sensitivity: float
    gain: float
    currents: tuple[float, ...]
    forces: tuple[float, ...]
    damping: float
    damped_to: float
    guard: float
    highest: float
    unbalance: float = 0.0
    unbalance_to: float = 0.0
    orbit: float | None = None
    compliance: float | None = None
    settling: float | None = None
    bandwidth: float = _BANDWIDTH
    stiff: float = _STIFF
    roll_off: float | None = None
    running: tuple[float, float] | None = None
    gain_asked: bool = False
    damping_asked: bool = False
    tame: float = np.inf
    voltage: tuple[float, float] | None = None

    @property
    def guards(self) -> dict[str, str]:
        """The ratios that no requirement asks for, each in words: what a search is kept from."""
        words = {
            SENSITIVITY_GUARD: "sensitivity that falls towards zero frequency, so that an integral "
            f"action is kept: to {self.stiff:g} below {self.bandwidth:.3g} rad/s"
        }
        if not self.damping_asked:
            words[DAMPING_GUARD] = (
                f"damping of modes above the top speed, {_GUARD:g} of the rotor's own; a "
                "damping_above of the file replaces it"
            )
        if not self.gain_asked:
            words["gain"] = (
                f"gain of K S_o, {_GAIN:g} times the largest of the start's; a control_gain of the "
                "file replaces it"
            )
        return words

    def sensitivity_limit(self, omega: np.ndarray) -> np.ndarray:
        """The limit of sigma_max(S_o) at omega (w,) [rad/s]."""
        s = 1j * omega
        return np.abs((s + self.bandwidth * self.stiff) / (s / self.sensitivity + self.bandwidth))

    def gain_limit(self, omega: np.ndarray) -> np.ndarray:
        """The limit of sigma_max(K S_o) at omega (w,) [rad/s], (w,) [A/m]."""
        return self.gain / (
            np.ones(len(omega)) if self.roll_off is None else np.hypot(1, omega / self.roll_off)
        )


def aims_of(machine: Machine, start: StateSpace) -> Aims:
    """The aims of a machine; start: the controller that tuning starts from, for the guard of the
    gain. Raises InvalidInput.
    """
    wanted = machine.requirements
    residual = residual_unbalance(machine)
    top = top_speed(machine)
    peak = (
        demand("maximum singular value of a sensitivity", wanted).limit
        or SENSITIVITY.limits[0].value
    )

    # sigma_max(S_o) <= g / (g - 1) leaves a gain margin g, and 1 / (2 sin(phi / 2)) a phase margin
    # phi.
    margins = [peak]
    if wanted.gain_margin is not None and wanted.gain_margin > 1:  # both follow from sigma_max(S_o)
        margins.append(wanted.gain_margin / (wanted.gain_margin - 1))
    if wanted.phase_margin is not None and 0 < wanted.phase_margin < np.pi:
        margins.append(1 / (2 * np.sin(wanted.phase_margin / 2)))
    gaps = [gap for b in machine.bearings if (gap := b.touchdown_gap or b.gap) is not None]
    orbits = [
        value
        for value in (wanted.unbalance_orbit, *(CLEARANCE.limits[0].value * gap for gap in gaps))
        if value is not None
    ]
    decrement = demand("log decrement", wanted).limit or 0.0

    # zeta = decrement / sqrt(4 pi^2 + decrement^2)
    damping = MARGIN * decrement / np.hypot(2 * np.pi, decrement)
    bearings = machine.axis_bearings
    allowed = [wanted.max_current or b.max_current for b in bearings]
    coil = machine.amplifier
    largest = np.abs(frequency_response(start, np.geomspace(1, 1e6, 60)).values).max()
    tame = _GAIN * float(largest)
    above = wanted.damping_above
    modes = free_modes(finite_element_rotor(machine), 1)
    bending = modes.frequencies[-1]
    return Aims(
        sensitivity=min(margins),
        gain=wanted.control_gain or tame,
        tame=tame,
        currents=tuple(np.nan if value is None else float(value) for value in allowed),
        forces=tuple(np.nan if b.max_force is None else float(b.max_force) for b in bearings),
        damping=damping,
        damped_to=max(1.1 * top, 0.5 * float(bending)) if above is None else top,
        guard=_GUARD * float(modes.damping_ratios(machine)[-1]) if above is None else above,
        highest=max(_BEYOND * highest_verified(machine), _ROLLED * (wanted.roll_off or 0.0)),
        unbalance=0.0 if residual is None else residual.moment,
        unbalance_to=wanted.unbalance_to or top or (0.0 if residual is None else residual.speed),
        orbit=min(orbits, default=None),
        compliance=wanted.compliance_peak,
        settling=wanted.settling_time,
        bandwidth=_BANDWIDTH
        if wanted.settling_time is None
        else max(_BANDWIDTH, 1 / wanted.settling_time),
        roll_off=wanted.roll_off,
        running=wanted.running_speeds,
        damping_asked=above is not None,
        gain_asked=wanted.control_gain is not None,
        voltage=None
        if coil.max_voltage is None or coil.inductance is None
        else (coil.max_voltage, coil.inductance),
    )


# The loop that is tuned: a plant at one operating point with the controller as it runs there,
# sampled and late.
#
# The sampled loop is exact and yet rational in a continuous variable: with w = (2/T) (z - 1)/(z +
# 1) Tustin's map leaves the controller as it is, and the plant, sampled behind its hold and late by
# whole samples, becomes another continuous plant (Franklin, Powell & Workman 1998, sec. 7.3).
# Frequency responses are taken at true frequencies: the plant's times hold and delay, the
# controller's at (2/T) tan(w T/2); aliasing is left out, as in verification.


@dataclass(frozen=True, slots=True, eq=False)
class LoopModel:
    """A, B, C, D: currents u to displacements y in the variable w; form: u, f at the bearings -> y,
    q at the bearings, i.

    magnet: k_i (a,) [N/A] and k_s (a,) [N/m]. speed [rad/s]: of the operating point. fast: the
    plant's modes above half the sample rate in these states, right (N, h), left (h, N); None
    without any. off: omega (w,) [rad/s] and by how much a measured plant is off this one there (w,
    a, a), with hold and delay; responses are then the measured plant's, poles the model's.
    """

    label: str
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    form: SchurForm
    magnet: tuple[np.ndarray, np.ndarray]
    timing: Timing | None
    speed: float
    fast: FastModes | None = None
    off: tuple[np.ndarray, np.ndarray] | None = None

    def response(self, omega: np.ndarray) -> np.ndarray:
        """u, f -> y, q, i at omega (w,) [rad/s]: (w, 3a, 2a), with hold and delay on u."""
        P = evaluate(self.form, 1j * omega)
        if self.timing is not None:
            P[:, :, : P.shape[1] // 3] *= lateness(omega, self.timing)[:, None, None]
        if self.off is not None:
            at, more = self.off
            a = more.shape[1]
            for i, j in np.ndindex(a, a):  # straight between lines, nothing where none is
                P[:, i, j] += np.interp(omega, at, more[:, i, j], left=0.0, right=0.0)
        return P

    def as_measured(self, omega: np.ndarray, G: np.ndarray) -> LoopModel:
        """The same whose responses u -> y are those of a measured plant G (w, a, a) at omega (w,)
        [rad/s], with the hold and without the delay of a sampled loop.
        """
        a, G = G.shape[1], G.copy()
        if self.timing is not None:
            late = self.timing.sample_time * self.timing.delay_samples
            G *= np.exp(-1j * omega * late)[:, None, None]
        off = G - self.response(omega)[:, :a, :a]
        return replace(self, label=f"{self.label}{MEASURED}", off=(omega, off))


def loop_model(plant: Plant, timing: Timing | None, label: str = "") -> LoopModel:
    """The model of a plant, full or reduced, for a controller that runs with ``timing`` (None:
    continuous).
    """
    part = select(plant.system, plant.named("u"), plant.named("y"))
    A = part.A
    B = part.B
    C = part.C
    D = part.D
    fast = None
    if timing is not None:
        T = timing.sample_time
        fast = fast_modes(A, T)

        # z = (1 + w T/2) / (1 - w T/2) in C (zI - A)^-1 B + D, with E = (A + I)^-1:
        # A_w = 2/T E (A - I),  B_w = 2/sqrt(T) E B,  C_w = 2/sqrt(T) C E,  D_w = D - C E B.
        late = delayed(c2d(part, T), timing.delay_samples)
        E = np.linalg.inv(late.A + np.eye(late.n_states))
        A, B = (2 / T) * E @ (late.A - np.eye(late.n_states)), E @ late.B * (2 / np.sqrt(T))
        C, D = late.C @ E * (2 / np.sqrt(T)), late.D - late.C @ E @ late.B
    A, B, C, t = balance_system(A, B, C)
    if fast is not None:
        # Tustin's map keeps the states but for a factor that they all share: the delay's come
        # first, then the plant's, and the controller's whatever its own are.
        fast = fast.behind(len(A) - len(fast.right)).scaled(t)

    # Responses come from the plant in s, at true frequencies; A to D above serve the poles.
    outer = select(
        plant.system,
        [*plant.named("u"), *plant.bearing_named("f")],
        [*plant.named("y"), *plant.bearing_named("q"), *plant.named("i")],
    )
    form = schur_form(outer.A, outer.B, outer.C, outer.D, expand=True)
    magnet = magnet_coefficients(plant.machine, plant.point)
    return LoopModel(
        label or plant.point.label, A, B, C, D, form, magnet, timing, plant.point.speed, fast
    )


def lateness(omega: np.ndarray, timing: Timing) -> np.ndarray:
    """Hold and delay of the currents at omega (w,) [rad/s], (w,)."""
    T = timing.sample_time
    return np.asarray(hold(omega, T) * np.exp(-1j * omega * T * timing.delay_samples))


def warped(omega: np.ndarray, timing: Timing | None) -> np.ndarray:
    """Where on the w axis a frequency [rad/s] of the sampled loop lies; continuous loops:
    unchanged.
    """
    if timing is None:
        return omega
    T = timing.sample_time
    return np.asarray(2 / T * np.tan(omega * T / 2))


def unwarped(omega: np.ndarray, timing: Timing | None) -> np.ndarray:
    """The inverse of ``warped``."""
    if timing is None:
        return omega
    T = timing.sample_time
    return np.asarray(2 / T * np.arctan(omega * T / 2))


_TIMED_TO = 2e4  # rad/s; what is faster than that does not matter for settling
# rad/s; below it a step of the quadrature turns the latest time by this phase, above it 4 pulse
# durations:
_SLOW_TO = 2000.0
_PHASE = 0.15  # rad
SETTLING_POWER = 0.4  # of the settling ratio: an exponential decay enters about as a rate


S_O, DRIVE = "S_o", "Q"


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """T = A - B Q C: A (m, w, r, c), B (m, w, r, a), C (m, w, a, c), rows divided by their limits;
    at: which frequencies of the grid.
    """

    name: str
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    at: np.ndarray

    def response(self, S: np.ndarray, Q: np.ndarray) -> np.ndarray:
        """T (m, w, r, c) at the channel's frequencies; S = S_o and Q (m, w, a, a) at all."""
        return np.asarray(self.A - self.B @ Q[:, self.at] @ self.C)


@dataclass(frozen=True, slots=True, eq=False)
class Scaled:
    """T = factor S_o, or factor Q: of says which; factor (w,), one over the limit; at: as there."""

    name: str
    of: str
    factor: np.ndarray
    at: np.ndarray

    def response(self, S: np.ndarray, Q: np.ndarray) -> np.ndarray:
        """As of a channel."""
        whole = S if self.of == S_O else Q
        return np.asarray(whole * self.factor[None, :, None, None])


def channels_of(
    P: np.ndarray, a: int, omega: np.ndarray, aims: Aims, models: Sequence[LoopModel]
) -> list[Channel | Scaled]:
    """Sensitivity, gain, compliance, and under unbalance orbit, currents and forces, each over its
    limit. P (m, w, 3a, 2a): ``LoopModel.response`` of the models at omega (w,) [rad/s], a axes.
    """
    # Columns of P: u, f; rows: y, q, i. With u = -K y: y = G u + G_yf f gives u = -Q G_yf f,
    # G the rows y and columns u.
    u, f = slice(0, a), slice(a, 2 * a)
    G_yf = P[:, :, u, f]
    q, i = slice(a, 2 * a), slice(2 * a, None)
    G_qu = P[:, :, q, u]
    G_qf = P[:, :, q, f]
    G_iu = P[:, :, i, u]
    G_if = P[:, :, i, f]
    every = np.arange(len(omega))

    # S_o = I - G Q,   K S_o = Q
    channels: list[Channel | Scaled] = [
        Scaled("sensitivity", S_O, 1 / aims.sensitivity_limit(omega), every),
        Scaled("gain", DRIVE, 1 / aims.gain_limit(omega), every),
    ]

    # f -> q: G_qf - G_qu Q G_yf
    if aims.compliance is not None:
        channels.append(
            Channel("compliance", G_qf / aims.compliance, G_qu / aims.compliance, G_yf, every)
        )
    at = np.flatnonzero(omega <= aims.unbalance_to * (1 + 1e-9))
    if not aims.unbalance or not len(at):
        return channels

    # Under unbalance f = U omega^2, up to the speed at which it is asked for.
    force = aims.unbalance * omega[at, None, None] ** 2

    def under_unbalance(name: str, A: np.ndarray, B: np.ndarray, limits: np.ndarray) -> None:
        rows = np.isfinite(limits)
        if rows.any():
            by = force / limits[rows][:, None]
            channels.append(
                Channel(name, A[:, at][:, :, rows] * by, B[:, at][:, :, rows] * by, G_yf[:, at], at)
            )

    if aims.orbit is not None:
        under_unbalance("orbit", G_qf, G_qu, np.full(a, aims.orbit))
    under_unbalance("current", G_if, G_iu, np.array(aims.currents))
    if aims.voltage is not None:
        most, inductance = aims.voltage

        # |v| = omega L |i|
        swing = (inductance * omega)[:, None, None]
        under_unbalance("voltage", swing * G_if, swing * G_iu, np.full(a, most))

    # bearing force k_i i + k_s q
    k_i, k_s = (
        np.stack(values)[:, None, :, None]
        for values in zip(*(model.magnet for model in models), strict=True)
    )
    under_unbalance(
        "force", k_i * G_if + k_s * G_qf, k_i * G_iu + k_s * G_qu, np.array(aims.forces)
    )
    return channels


class Settling:
    """|y(t)| after the pulse over the band around zero, from frequency responses by quadrature
    of a cubic spline.

    at (f,): which frequencies of the grid are used; late (t, f), early (t, f): weights of their
    responses at times from the settling time on, and at those where the peak lies; settling [s].
    """

    __slots__ = ("at", "early", "late")

    def __init__(self, omega: np.ndarray, settling: float) -> None:
        self.at = np.flatnonzero(omega < min(_TIMED_TO, omega[-1] * (1 + 1e-9)))
        w = omega[self.at]

        # A step turns exp(j w t) by _PHASE: up to _SLOW_TO at the latest time, above it at 4 pulse
        # durations.
        last = PULSE.duration + 8 * settling
        slow = np.linspace(0, _SLOW_TO, int(np.ceil(_SLOW_TO * last / _PHASE)) + 1)
        fast = np.linspace(
            _SLOW_TO,
            max(w[-1], _SLOW_TO + 1),
            int(np.ceil(w[-1] * 4 * PULSE.duration / _PHASE)) + 2,
        )
        fine = np.unique(np.concatenate([slow, fast]))
        fine = fine[fine <= w[-1]]

        # Trapezoidal rule on steps that differ; the end of the range fades out as half a cosine,
        # for a sharp end would ring in time.
        step = np.gradient(fine)
        step[[0, -1]] /= 2
        edge = 0.8 * w[-1]
        taper = np.where(
            fine > edge, 0.5 + 0.5 * np.cos(np.pi * (fine - edge) / (w[-1] - edge)), 1.0
        )
        jw = 1j * np.maximum(fine, 1e-6)

        def weights(time: np.ndarray) -> np.ndarray:
            # y(t) = 1/pi Re int H(jw) (exp(jw t) - exp(jw (t - d))) / jw dw after a pulse of
            # duration d; while it lasts (t < d), the second exponent is 0.
            rise = np.exp(jw * time[:, None]) - np.exp(
                jw * (time - np.minimum(PULSE.duration, time))[:, None]
            )
            return _by_samples(rise / jw * step * taper / np.pi, fine, w)

        # late: from the settling time on; early: where the peak lies, of which the band is taken.
        after = settling * np.concatenate([np.linspace(1, 2.2, 16), np.geomspace(2.4, 8, 8)])
        self.late = weights(PULSE.duration + after)
        self.early = weights(PULSE.duration * np.linspace(0.1, 2.5, 24))

    def ratios(
        self, H: np.ndarray, peak: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """|y| over its band (t, m, axis, pulsed axis), y itself, the band (m, pulsed axis), and the
        peaks it is taken of.

        H (w, m, a, a): S_o G = G - G Q G, a pulse of u -> y in the closed loop, at the frequencies
        ``at``. peak (m, pulsed axis): None takes those of the response itself.
        """
        flat = H.reshape(len(H), -1)
        if peak is None:
            early = (self.early @ flat).real.reshape(-1, *H.shape[1:])
            peak = np.abs(early).max(axis=(0, 2))
        y = (self.late @ flat).real.reshape(-1, *H.shape[1:])
        band = PULSE.band * peak
        return np.abs(y) / band[None, :, None, :], y, band, peak

    def slope(
        self, timed: tuple[np.ndarray, ...], top: float, power: float
    ) -> tuple[float, np.ndarray]:
        """The part of the p-norm's sum, and the conjugate transpose (w, m, a, a) of its slope by
        H; timed: what ``ratios`` returned.
        """
        ratio, y, band, _ = timed

        # d share / p = share 0.4 / ratio d ratio,   d ratio = sign(y) dy / band (the band is held)
        share = (ratio**SETTLING_POWER / top) ** power
        weight = (
            share * SETTLING_POWER / np.maximum(ratio, 1e-300) * np.sign(y) / band[None, :, None, :]
        )

        # y = Re sum_w late H: the slope is late* weight, its conjugate transpose late weight^T
        turned = np.ascontiguousarray(weight.swapaxes(2, 3))
        slope = self.late.T @ turned.reshape(len(turned), -1)
        return float(share.sum()), slope.reshape(-1, *turned.shape[1:])


def _by_samples(weights: np.ndarray, fine: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The weights (t, n) at the knots w (n,) of a quadrature (t, f) at fine (f,) of their natural
    cubic spline.
    """
    # Within interval i, with left + right = 1 and bends M = y'':
    # y = left y_i + right y_i+1 + h^2/6 ((left^3 - left) M_i + (right^3 - right) M_i+1).
    i = np.clip(np.searchsorted(w, fine, side="right") - 1, 0, len(w) - 2)
    # below the first frequency: its value
    h, at = np.diff(w), np.maximum(fine, w[0])
    left, right = (w[i + 1] - at) / h[i], (at - w[i]) / h[i]
    rows, size = np.arange(len(fine)), (len(fine), len(w))

    def spread(on_left: np.ndarray, on_right: np.ndarray) -> np.ndarray:
        places = np.concatenate([rows, rows]), np.concatenate([i, i + 1])
        return np.asarray(
            (csr_array((np.concatenate([on_left, on_right]), places), size).T @ weights.T).T
        )

    # natural: no bend at the two ends
    by_values = spread(left, right)
    bend = h[i] ** 2 / 6
    by_bends = spread(bend * (left**3 - left), bend * (right**3 - right))[:, 1:-1]
    # bends (n-2,) from values
    # h_i-1 M_i-1 + 2 (h_i-1 + h_i) M_i + h_i M_i+1 = 6 ((y_i+1 - y_i)/h_i - (y_i - y_i-1)/h_i-1);
    # the matrix is symmetric: it acts on the weights as on the bends
    banded = np.array([np.append(0, h[1:-1]), 2 * (h[1:] + h[:-1]), np.append(h[1:-1], 0)])
    inner = solve_banded((1, 1), banded, by_bends.T).T * 6
    by_values[:, :-2] += inner / h[:-1]
    by_values[:, 1:-1] -= inner * (1 / h[:-1] + 1 / h[1:])
    by_values[:, 2:] += inner / h[1:]
    return by_values
