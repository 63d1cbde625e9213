"""What tuning aims at: the requirements of the machine file and the standards' defaults, as limits
of a loop's responses.

Limits that the file leaves out are those that verification judges by (machine/criteria.py). Three
are guards of ours, without which a search exploits what nobody looks at: the controller's gain, the
damping of modes above the running speed, and a sensitivity that falls towards zero frequency, so
that an integral action is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace
from ambrose.machine.criteria import (
    CLEARANCE,
    SENSITIVITY,
    demand,
)
from ambrose.machine.machine import Machine
from ambrose.model.effects.rotor import finite_element_rotor, free_modes
from ambrose.model.plant import highest_verified, top_speed
from ambrose.model.unbalance import residual_unbalance

# assumed: sigma_max(S_o) below 2 rad/s falls to 0.01; with a settling time t_s below 1/t_s
_BANDWIDTH, _STIFF = 2.0, 0.01
_GAIN = 1.5  # assumed: times the largest gain of the controller that tuning starts from
_GUARD = 0.3  # assumed: of the rotor's modal damping, for modes above the top speed
DAMPING_GUARD = "damping_above"  # the ratio of that guard
SENSITIVITY_GUARD = "sensitivity_low"  # and of the one towards zero frequency,
FALLS = 0.99  # which stands where the limit is below this share of that of the sensitivity
_MARGIN = 1.05  # of the log decrement, which is judged on the full plant
_ROLLED = 8.0  # the grid reaches this many times past the roll-off
_BEYOND = 2.4  # the grid reaches this many times past the range of ISO 14839-3


@dataclass(frozen=True, slots=True)
class Aims:
    """Limits; None asks for nothing.

    sensitivity M, bandwidth [rad/s], stiff: sigma_max(S_o) stays below |(s + w_B A)/(s/M + w_B)|.
    gain [A/m]: of K S_o, falling above roll_off [rad/s]. unbalance U [kg m] up to ``unbalance_to``
    [rad/s]: orbit [m], currents (a,) [A] and forces (a,) [N] (nan: none), voltage: (largest [V],
    inductance [H]) of a coil. compliance [m/N]. settling [s] after the current pulse. damping [-]
    of modes below ``damped_to`` [rad/s], guard [-] of those above. running [rad/s]: lowest and
    highest speed, near which modes are damped as API 617's separation margin asks. highest [rad/s]:
    end of the grid. gain_asked, damping_asked: whether the machine file asks for the
    gain and for the damping of modes above; tame [A/m]: the
    guard of it where the file does not.
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
    damping = _MARGIN * decrement / np.hypot(2 * np.pi, decrement)
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
