"""Stability, Level II: every mode with seals, stages and controller as it runs, and what each
component takes out of it, or puts in.

For a mode q(t) = Re(q e^{s t}) with s = sigma + j omega the mean energy of rotor (and supports),
E = (|s q|^2_M + |q|^2_K)/4, changes at 2 sigma E: that is the sum of the mean powers of all other
forces on it,

    2 sigma E = sum_c P_c,    P_c = Re((s q_c)^H f_c)/2,

with f_c the force of component c at its ports and q_c the motion there. The log decrement
delta = -2 pi sigma/omega is therefore a sum, delta_c = -pi P_c/(omega E). Gyroscopic forces do no
work; the negative stiffness of a magnet belongs to the magnet.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.loop import ShaftLoop, forces_of_components
from ambrose.annexes.rotordynamics.placement import ShaftMode, shaft_modes
from ambrose.core.checks import NumericalFailure
from ambrose.judge.campbell import OSCILLATORY
from ambrose.model.assemble import modes_of
from ambrose.model.effects.stations import foundation

# Stability, Level I: cross-coupled stiffness Q at mid-span (or at each overhung impeller), from 0
# to ten times the anticipated Q_A, and the border Q0 at which the loop loses its damping (recalled,
# see ``standard``).
#
# The machine is taken without seals and stages: Q stands for all of them. The standard follows the
# first forward mode. A rotor on magnets can lose another one first, or have none that rings at Q =
# 0, so that no mode is followed for the border: it is where the largest real part of all poles of
# the loop as it runs crosses zero, refined within the first step of the sweep at whose end it has.
# Forward modes are followed for the picture, and to name the one that crosses.


_STEPS = 20  # of the sweep
_BESIDE = 0.02  # of Q0: how far beyond it the mode that crosses is followed from
_SAME = 1e-6  # of Q0: the border of a mode followed that is the loop's
# log decrement at the damping ratio up to which a mode can ring: 2 pi z/sqrt(1 - z^2)
OVERDAMPED = 2 * math.pi * OSCILLATORY / math.sqrt(1 - OSCILLATORY**2)
_LARGEST = 1e11  # [N/m]: how far a border is looked for without an anticipated value


@dataclass(frozen=True, slots=True, eq=False)
class Branch:
    """A forward mode over the sweep: the mode at Q = 0 (or, of one that is no forward mode there,
    just beyond Q0: ``late``), its log_decrement (n,), frequency (n,) [rad/s], log decrement at Q_A,
    and the Q [N/m] at which it loses its damping (inf: none).

    Log decrements end at ``OVERDAMPED``: beyond it no mode can ring.
    """

    mode: ShaftMode
    log_decrement: np.ndarray
    frequency: np.ndarray
    at_anticipated: float
    border: float
    late: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class LevelOne:
    """A sweep over cross_coupling (n,) [N/m] in all.

    anticipated Q_A and border Q0 [N/m] (inf: stable up to the end of the sweep); at_anticipated:
    the least log decrement of all forward modes that ring there. branches: by frequency, the first
    is what the standard follows; last that which crosses first, where it is no forward mode at
    Q = 0. binding: the index of the branch that loses its damping first, or else has least of it at
    Q_A; None where the mode that crosses could not be followed. crossing: frequency [rad/s] of the
    mode that crosses at the border (nan: none). stations: where Q acts, in equal parts. screening:
    whether Level I is enough; None without an anticipated value. least: frequency [rad/s] of the
    mode that has the least log decrement at Q_A (nan: of none that rings there). speed_ratio:
    maximum continuous speed over the first critical speed on rigid supports.
    """

    cross_coupling: np.ndarray
    anticipated: float | None
    border: float
    at_anticipated: float
    branches: tuple[Branch, ...]
    binding: int | None
    crossing: float
    stations: tuple[int, ...]
    screening: standard.Screening | None
    least: float = math.nan
    speed_ratio: float | None = None

    @property
    def end(self) -> float:
        """The largest cross-coupling of the sweep [N/m]: a border that was not met lies beyond."""
        return float(self.cross_coupling[-1])

    @property
    def least_at_end(self) -> float:
        """The least log decrement of the modes followed, at the end of the sweep."""
        return min((float(b.log_decrement[-1]) for b in self.branches), default=OVERDAMPED)


def sweep(
    loop: ShaftLoop,
    stations: Sequence[int],
    anticipated: float | None,
    highest: float,
    speed_ratio: float | None = None,
    density: float | None = None,
) -> LevelOne:
    """The sweep of a loop (without seals and stages) at the maximum continuous speed.

    anticipated Q_A [N/m], positive; None: unknown, then the sweep ends beyond the border and there
    is no screening; highest [rad/s]: up to where modes are followed. speed_ratio,
    density: for the screening, see ``standard.screen``. Raises NumericalFailure where the loop is
    unstable without Q.
    """

    def coupled(q: float) -> ShaftLoop:
        moved = loop
        for station in stations:
            moved = moved.coupled(station, q / len(stations))
        return moved

    def abscissa(q: float) -> float:
        return float(coupled(q).all_modes().poles.real.max())

    if abscissa(0.0) >= 0:
        raise NumericalFailure(
            "the loop is unstable without cross-coupling (no seals, no stages), so that Level I "
            "has no stability limit to find; give a controller that stabilises the bare rotor"
        )
    if anticipated is None:
        end = 1e4
        while abscissa(end) < 0 and end < _LARGEST:
            end *= 4
    else:
        end = standard.SWEEP * anticipated
    grid = np.linspace(0.0, end, _STEPS + 1)
    border = _border(abscissa, grid)
    branches = tuple(
        branch
        for mode in shaft_modes(loop, highest)
        if mode.forward and (branch := _follow(coupled, mode, grid, anticipated or 0.0))
    )
    binding: int | None = None
    crossing = math.nan
    if math.isfinite(border):
        poles = coupled(border).all_modes().poles
        crossing = abs(float(poles[np.argmax(poles.real)].imag))
        near = [k for k, b in enumerate(branches) if abs(b.border - border) <= _SAME * border]
        if near:
            binding = near[0]
        elif late := _late(coupled, grid, anticipated or 0.0, border, highest):
            branches, binding = (*branches, late), len(branches)
    elif branches:
        binding = int(np.argmin([branch.at_anticipated for branch in branches]))
    at_anticipated = min((branch.at_anticipated for branch in branches), default=OVERDAMPED)
    least = math.nan
    if anticipated is not None:
        # a mode that is overdamped or backward without Q can ring forwards at Q_A
        ringing = [m for m in shaft_modes(coupled(anticipated), highest) if m.forward]
        weakest = min(ringing, key=lambda mode: mode.log_decrement, default=None)
        if weakest is not None:
            at_anticipated = min(at_anticipated, weakest.log_decrement)
            least = weakest.frequency
    screening = None
    if anticipated is not None:
        screening = standard.screen(anticipated, border, at_anticipated, speed_ratio, density)
    return LevelOne(
        grid,
        anticipated,
        border,
        at_anticipated,
        branches,
        binding,
        crossing,
        tuple(stations),
        screening,
        least,
        speed_ratio,
    )


def _border(abscissa: Callable[[float], float], grid: np.ndarray) -> float:
    """The Q [N/m] at which the loop first becomes unstable over the grid (n,); inf: nowhere."""
    for low, high in pairwise(map(float, grid)):
        if abscissa(high) >= 0:
            return float(brentq(abscissa, low, high, xtol=1e-9 * grid[-1]))
    return math.inf


def _follow(
    coupled: Callable[[float], ShaftLoop], mode: ShaftMode, grid: np.ndarray, anticipated: float
) -> Branch | None:
    """One mode over the sweep, coupled: Q -> loop; None where it cannot be followed."""
    path = [(mode.pole, mode.states)]
    border = math.inf
    try:
        for q in grid[1:]:
            path.append(coupled(q).mode_near(*path[-1]))
        poles = np.array([pole for pole, _ in path])
        near = path[int(np.argmin(np.abs(grid - anticipated)))]
        at = coupled(anticipated).mode_near(*near)[0]
        beyond = np.flatnonzero(poles.real >= 0)
        if beyond.size:
            k = int(beyond[0])
            start = path[k - 1]
            border = float(
                brentq(
                    lambda q: coupled(q).mode_near(*start)[0].real,
                    grid[k - 1],
                    grid[k],
                    xtol=1e-9 * grid[-1],
                )
            )
    except (NumericalFailure, ValueError):  # lost on the way, or another one at an end
        return None
    return _branch(mode, poles, at, border)


def _late(
    coupled: Callable[[float], ShaftLoop],
    grid: np.ndarray,
    anticipated: float,
    border: float,
    highest: float,
) -> Branch | None:
    """The mode that crosses at the border, followed from there to both ends of the sweep, down to
    where it no longer rings; None where it cannot be followed.
    """
    beyond = border * (1 + _BESIDE)
    modes = shaft_modes(coupled(beyond), highest)
    mode = max(modes, key=lambda item: item.pole.real, default=None)
    if mode is None or mode.pole.real < 0:
        return None
    poles = np.full(len(grid), complex(-1.0))  # does not ring
    split = int(np.searchsorted(grid, beyond))
    at = complex(-1.0)
    try:
        here = mode.pole, mode.states
        for k in range(split, len(grid)):
            here = coupled(float(grid[k])).mode_near(*here)
            poles[k] = here[0]
        here = coupled(border).mode_near(mode.pole, mode.states)
        for k in range(split - 1, -1, -1):
            if grid[k] <= anticipated <= min(border, grid[min(k + 1, len(grid) - 1)]):
                at = coupled(anticipated).mode_near(*here)[0]
            here = coupled(float(grid[k])).mode_near(*here)
            if _decrement(here[0]) >= OVERDAMPED:
                break
            poles[k] = here[0]
    except NumericalFailure:
        return None
    return replace(_branch(mode, poles, at, border), late=True)


def _branch(mode: ShaftMode, poles: np.ndarray, at: complex, border: float) -> Branch:
    decrements = np.array([_decrement(pole) for pole in poles])
    return Branch(mode, decrements, np.abs(poles.imag), _decrement(at), border)


def _decrement(pole: complex) -> float:
    """2 pi (-Re)/|Im|, to ``OVERDAMPED``: without limit where a root meets the real axis."""
    if -pole.real >= OSCILLATORY * abs(pole):
        return OVERDAMPED
    return float(-2 * np.pi * pole.real / abs(pole.imag))


INTERNAL = "rotor's own damping"


@dataclass(frozen=True, slots=True)
class Share:
    """What a component adds to a mode's log decrement; negative: it destabilises."""

    component: str
    log_decrement: float


def shares(loop: ShaftLoop, mode: ShaftMode) -> tuple[Share, ...]:
    """The share of every component; their sum is the mode's log decrement.

    Supports and casing modes count with the rotor: their energy is in E, their damping in
    "supports".
    """
    plant = loop.plant
    machine = plant.machine
    s, x = mode.pole, mode.states
    modes = modes_of(machine, plant.rotor_model, None)
    base = foundation(machine)
    count = len(modes.frequencies) + len(base)
    q = x[:count]  # modal displacements: the plant's first states
    stiffness = np.concatenate([modes.frequencies**2, base.stiffness])
    energy = float((abs(s) ** 2 * np.abs(q) ** 2 + stiffness * np.abs(q) ** 2).sum()) / 4
    # -Re(q'^H (c q' + k [[0, 1], [-1, 0]] q))/2 of every mode
    damping, circulatory = modes.damping(machine, loop.point.speed)
    q_rotor = q[: len(damping)]
    turned = np.empty_like(q_rotor)
    turned[0::2], turned[1::2] = q_rotor[1::2], -q_rotor[0::2]
    resisting = damping * s * q_rotor + circulatory * turned
    power = {INTERNAL: -float(np.real((s * q_rotor).conj() @ resisting)) / 2}
    if len(base):
        power["supports"] = -float((base.damping * np.abs(s * q[-len(base) :]) ** 2).sum()) / 2

    for component in forces_of_components(loop, s, x):
        work = float(np.real((s * component.motion).conj() @ component.force)) / 2
        power[component.name] = power.get(component.name, 0.0) + work

    omega = abs(s.imag)
    return tuple(
        Share(name, float(-np.pi * value / (omega * energy))) for name, value in power.items()
    )
