"""Closed-loop poles with damping and whirl direction.

| check | what | unit |
|---|---|---|
| stability.abscissa | largest real part of the closed-loop poles; must be negative | rad/s |
| poles.log_decrement.lowest | smallest log dec to the first forward mode or top speed | - |
| poles.log_decrement.least | smallest log dec of all poles, bending and controller included | - |
| poles.damping.above | smallest damping ratio above top speed, for a damping_above | - |
| poles.damping.least | smallest damping ratio of all poles | - |

The curve "poles" holds every closed-loop pole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.aliasing import continuous_poles
from ambrose.core.checks import named_failure
from ambrose.core.statespace import StateSpace, index_of
from ambrose.judge.checks import Check, Curve
from ambrose.judge.criteria import information, judge
from ambrose.machine.criteria import SENSITIVITY_RANGE, TWO_PI, Demand, demand
from ambrose.machine.description import Requirements

# below this modulus of the whirl measure a mode has no direction; assumed: at 0.1 the backward
# circle has 0.9 of the forward one's amplitude, sqrt((1 - 0.1)/(1 + 0.1))
PLANAR = 0.1
# a damping ratio below this counts as a mode that can ring: at 1/sqrt(2) and above the response of
# a second-order system has no resonance peak
OSCILLATORY = 0.7071067811865476
_LISTED = 5  # least damped modes of the standard's range that a detail lists
_NAMED = 4  # unstable poles that a detail names
_ROUNDING = 1e-9  # relative, so that the mode that sets a limit lies within it
# |Im|/|pole| up to which a pole is real: rounding splits a double real pole by about the root of
# 1e-16
_REAL = 1e-7
_KILO = 9999.5  # Hz: from here four digits do not reach the unit


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """Poles (n,) [rad/s] with Im >= 0, by ascending modulus, and how the rotor moves in each.

    whirl (n,): +1 forward circle, -1 backward circle, 0 a line; shapes (ports, n): complex
    displacements at ``ports``. A pole with Im = 0 stands for itself, every other for a conjugate
    pair.
    """

    poles: np.ndarray
    whirl: np.ndarray
    shapes: np.ndarray
    ports: tuple[str, ...]

    def __getitem__(self, kept: np.ndarray) -> Modes:
        return Modes(self.poles[kept], self.whirl[kept], self.shapes[:, kept], self.ports)

    @property
    def frequency(self) -> np.ndarray:
        """Damped natural frequency |Im| (n,) [rad/s]."""
        return self.poles.imag

    @property
    def damping(self) -> np.ndarray:
        """Damping ratio -Re/|pole| (n,)."""
        return damping_ratio(self.poles)

    @property
    def log_decrement(self) -> np.ndarray:
        """2 pi (-Re)/|Im| (n,), infinite for real stable poles."""
        return log_decrement(self.poles)


def damping_ratio(poles: np.ndarray) -> np.ndarray:
    """-Re/|pole|, 0 for a pole at the origin."""
    modulus = np.abs(poles)
    return np.divide(-poles.real, modulus, out=np.zeros(poles.shape), where=modulus > 0)


def log_decrement(poles: np.ndarray) -> np.ndarray:
    """2 pi zeta/sqrt(1 - zeta^2) = 2 pi (-Re)/|Im|: the log of the ratio of two successive maxima;
    +-inf on the real axis.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        value = TWO_PI * -poles.real / np.abs(poles.imag)
    return np.where(np.isnan(value), 0.0, value)


def direction(whirl: float) -> str:
    """The whirl measure in a word."""
    return "planar" if abs(whirl) < PLANAR else "forward" if whirl > 0 else "backward"


@named_failure("the modes of the loop")
def modes(system: StateSpace, ports: tuple[str, ...], plant: StateSpace | None = None) -> Modes:
    """Eigenvalues of the system and the displacement shapes at its outputs q_<port>.

    plant: the continuous system that a sampled loop was closed around (``law.loop.closed_loop``):
    sampled poles are mapped by ln(z)/dt, those of the plant's modes above half the sample rate on
    the branch of their true frequency (core/aliasing.py); None: all within half the sample rate.

    Whirl: with X, Y a port pair's complex amplitudes, (|X + jY|^2 - |X - jY|^2) / (sum of both),
    summed over the pairs; spin is positive from the first direction to the second.
    """
    values, vectors = continuous_poles(system.A, system.dt, None if plant is None else plant.A)
    real = np.abs(values.imag) <= _REAL * np.abs(values)
    values = np.where(real, values.real, values)
    keep = values.imag >= 0
    values, vectors = values[keep], vectors[:, keep]
    order = np.lexsort((values.imag, np.abs(values)))
    values, vectors = values[order], vectors[:, order]
    shapes = system.C[index_of([f"q_{port}" for port in ports], system.outputs, "output")] @ vectors
    return Modes(values, whirl_measure(shapes, ports), shapes, ports)


def whirl_measure(shapes: np.ndarray, ports: tuple[str, ...]) -> np.ndarray:
    """The measure of ``modes`` for shapes (ports, n) complex, in [-1, 1]."""
    first, second = pairs(ports)
    X, Y = shapes[first], shapes[second]
    forward, backward = (np.abs(X + 1j * Y) ** 2).sum(axis=0), (np.abs(X - 1j * Y) ** 2).sum(axis=0)
    total = forward + backward
    return np.divide(forward - backward, total, out=np.zeros(len(total)), where=total > 0)


def pairs(ports: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Positions of the two directions of every place: <place>_zeta with _eta, <place>_x with _y."""
    first, second = [], []
    for one, other in (("_zeta", "_eta"), ("_x", "_y")):
        for i, port in enumerate(ports):
            if port.endswith(one) and port.removesuffix(one) + other in ports:
                first.append(i)
                second.append(ports.index(port.removesuffix(one) + other))
    return first, second


def pole_checks(eigenmodes: Modes, requirements: Requirements, top_speed: float) -> list[Check]:
    """The checks of this file's table.

    top_speed [rad/s]: modes up to it are held against the log decrement, whatever their direction;
    so is the first mode that can ring and does not whirl backward. A detail lists the five least
    damped modes of the standard's range.
    """
    listed_to = SENSITIVITY_RANGE.limits[0].value
    worst = int(np.argmax(eigenmodes.poles.real))
    abscissa = float(eigenmodes.poles[worst].real)
    stability = judge(
        "stability.abscissa",
        "Stability: largest real part of the closed-loop poles",
        abscissa,
        "rad/s",
        Demand(0.0, "<", "asymptotic stability"),
        _stability_detail(eigenmodes, worst),
    )
    ringing = np.flatnonzero((eigenmodes.poles.imag > 0) & (eigenmodes.damping < OSCILLATORY))
    if not ringing.size:
        return [stability]
    checks = [stability]
    forward = ringing[eigenmodes.whirl[ringing] > -PLANAR]
    ceiling = max(top_speed, float(eigenmodes.frequency[forward[0]]) if forward.size else 0.0)
    low = ringing[eigenmodes.frequency[ringing] <= ceiling * (1 + _ROUNDING)]
    if low.size:
        k = low[np.argmin(eigenmodes.log_decrement[low])]
        title = "Log decrement of the modes up to the top speed"
        where = (
            f"{describe(eigenmodes, k)}; modes up to {ceiling / TWO_PI:.4g} Hz, "
            "the first forward one included"
        )
        wanted = demand("log decrement", requirements)
        checks.append(
            judge(
                "poles.log_decrement.lowest", title, eigenmodes.log_decrement[k], "-", wanted, where
            )
        )
    order = ringing[np.argsort(eigenmodes.damping[ringing])]
    above = order[eigenmodes.frequency[order] > top_speed * (1 + _ROUNDING)]
    if requirements.damping_above is not None and above.size:
        checks.append(
            judge(
                "poles.damping.above",
                "Damping ratio of the modes above the top speed",
                eigenmodes.damping[above[0]],
                "-",
                demand("damping above the top speed", requirements),
                f"at {_place(eigenmodes, above[0])}",
            )
        )
    near = [k for k in order if eigenmodes.frequency[k] <= listed_to][:_LISTED]
    least = order[0]
    where = f"at {_place(eigenmodes, least)}"
    listed = (
        ", ".join(f"{_place(eigenmodes, k)} {eigenmodes.damping[k]:.3g}" for k in near) or "none"
    )
    detail = f"{where}; least up to {listed_to / TWO_PI:.4g} Hz: {listed}"
    return [
        *checks,
        information(
            "poles.log_decrement.least",
            "Least log decrement of all poles",
            eigenmodes.log_decrement[least],
            "-",
            where,
            ">=",
        ),
        information(
            "poles.damping.least",
            "Least damping ratio of all poles",
            eigenmodes.damping[least],
            "-",
            detail,
            ">=",
        ),
    ]


def describe(eigenmodes: Modes, k: int) -> str:
    """One pole in words: "pole at 49.2 Hz forward, damping ratio -0.171"."""
    pole = eigenmodes.poles[k]
    if pole.imag == 0:
        return f"real pole at {pole.real:.4g} rad/s"
    return f"pole at {_place(eigenmodes, k)}, damping ratio {eigenmodes.damping[k]:.3g}"


def _place(eigenmodes: Modes, k: int) -> str:
    hertz = eigenmodes.frequency[k] / TWO_PI
    place = f"{hertz:.4g} Hz" if hertz < _KILO else f"{hertz / 1e3:.4g} kHz"
    return f"{place} {direction(eigenmodes.whirl[k])}"


def _stability_detail(eigenmodes: Modes, worst: int) -> str:
    unstable = np.flatnonzero(eigenmodes.poles.real >= 0)
    if not unstable.size:
        return f"rightmost: {describe(eigenmodes, worst)}"
    unstable = unstable[np.argsort(-eigenmodes.poles[unstable].real)]
    named = "; ".join(describe(eigenmodes, k) for k in unstable[:_NAMED])
    return named + (f"; and {unstable.size - _NAMED} more" if unstable.size > _NAMED else "")


def pole_curve(eigenmodes: Modes) -> Curve:
    """All closed-loop poles, both halves of the plane."""
    both = np.concatenate([eigenmodes.poles, eigenmodes.poles[eigenmodes.poles.imag > 0].conj()])
    return Curve(
        "poles",
        "Closed-loop poles",
        "poles",
        both.real,
        both.imag[None, :],
        ("poles",),
        "rad/s",
        "rad/s",
    )
