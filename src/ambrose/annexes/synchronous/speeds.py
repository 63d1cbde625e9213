"""The speeds of a block's band at which a loop with it is worst: least far from instability, and
most sensitive.

A few speeds show neither: near a transmission zero of what the block reads, and near a lightly
damped mode, the loop changes within a few bandwidths eps |D R| of the block. Therefore

1. the plant is taken at some speeds of the band (``_BASES``), and around each the blocks'
   frequency alone is moved, which is cheap: over an even grid, every speed of the table of T and
   between them, and packed around every pole of the loop and every minimum of |R| (a zero, where T
   is largest);
2. the worst are looked at again with the plant at that very speed, twice, each time nearer;
3. there the poles are computed exactly.

Blocks of other harmonics that are on at the same speed are on here, too.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ambrose.annexes.synchronous.block_loop import Condition, SynchronousLoop
from ambrose.core.frequency import SchurForm, evaluate, schur_form
from ambrose.core.statespace import StateSpace
from ambrose.core.synchronous import around_resonators, turn_map_of, with_resonators
from ambrose.judge.loop_response import frequency_grid

# A loop with synchronous blocks on, at one speed: its sensitivity as it is measured in operation
# (ISO 14839-3), how near to instability it is, and its exact poles.
#
# With M(z) from what the blocks add, c, to all signals s = (e, y, u), and d a disturbance at the
# sensors, s = M c + M_d d with M_d = -M + (0, 1, 0): d enters as -c does, and y is e + c. The
# blocks are c = Q(z) s, block j at the frequency W_j with the gain eps and D as it runs,
#
#     Q_j = (eps Ts/2) (D t/(z - k t) + its conjugate part),  t = exp(j W_j Ts),  k = 1 - leak Ts
#
# so that e = (S + M_e (1 - Q M)^-1 Q M_d) d, S = -M_e. The poles of the whole are the zeros of
# det(1 - Q M): for a loop that is stable without the blocks, those outside the unit circle are
# counted by the phase of this determinant along it. A block that moves once a turn (of time t_n)
# has the factor of its mean and of its hold, and exp(j d t_n) in place of z/t, d the distance from
# W_j; its images about other multiples of the turning are in the exact multipliers alone.


_PER_DECADE = 40  # frequencies of the grid, beside those packed around poles
_LOWEST = 3.0  # rad/s
_OUTSIDE = 0.01  # of eps: the growth from which a pole counts as unstable in the count by phase
_BESIDE = 36  # frequencies on either side of a block's own
_NEAREST, _FARTHEST = 2e-3, 60.0  # of eps, of the block's bandwidth: how near, and how far
_MATTERS = 0.02  # ||Q M||, below which a block changes nothing
# of 1 - Q M between two frequencies, relative: above it a third is put between. Every eigenvalue
# turns by less than 60 degrees then, so that no turn of the determinant is missed
_STEP = 0.85
_ROUNDS = 8  # of such
_ZOOMS, _ZOOM = 3, 24  # rounds, and frequencies of each, around the largest sensitivity


@dataclass(frozen=True, slots=True, eq=False)
class Resonator:
    """One block at one speed. drive D (a, 3 a) complex, of (e, y, u); frequency [rad/s]; gain eps,
    leak [1/s]; turn [s]: of a block that moves once a turn (0: every sample).
    """

    drive: np.ndarray
    frequency: float
    gain: float
    leak: float = 0.0
    turn: float = 0.0

    def transfer(self, z: np.ndarray, dt: float) -> np.ndarray:
        """Q (w, a, 3 a) at the points z (w,)."""
        ahead, behind = self._half(z, dt, self.frequency), self._half(z, dt, -self.frequency)
        return np.asarray(
            self.drive * ahead[:, None, None] + self.drive.conj() * behind[:, None, None]
        )

    def _half(self, z: np.ndarray, dt: float, frequency: float) -> np.ndarray:
        """The scalar factor (w,) of D in Q, of the pole at one frequency."""
        t = np.exp(1j * frequency * dt)
        if not self.turn:
            return np.asarray(self.gain * dt / 2 * t / (z - (1 - self.leak * dt) * t))
        # d = ln(z/t)/(j Ts): the mean over a turn (e^{jdT} - 1)/(jdT), held (1 - e^{-jdT})/(jdT)
        exponent = np.log(z / t) / dt * self.turn
        mean, held = np.expm1(exponent) / exponent, -np.expm1(-exponent) / exponent
        keep = 1 - self.leak * self.turn
        return np.asarray(self.gain * self.turn / 2 * mean * held / (np.exp(exponent) - keep))


@dataclass(frozen=True, eq=False)
class FrozenLoop:
    """A loop from c to (e, y, u), sampled, with its response made cheap: the plant of one speed,
    while the blocks' frequency may be another one near it.

    omega (w,) [rad/s]: a grid packed around its poles (n,) [rad/s], which are continuous.
    """

    system: StateSpace
    form: SchurForm
    poles: np.ndarray
    omega: np.ndarray

    @cached_property
    def M(self) -> np.ndarray:
        """(w, 3 a, a) on the grid."""
        return self.at(self.omega)

    @cached_property
    def S(self) -> np.ndarray:
        """Every axis' sensitivity (w, a) on the grid without a block."""
        n = self.M.shape[2]
        return np.asarray(np.abs(np.einsum("waa->wa", self.M[:, :n])))

    def at(self, omega: np.ndarray, growth: float = 0.0) -> np.ndarray:
        """M (w, 3 a, a) at exp((growth + j omega) Ts)."""
        assert self.system.dt is not None
        return evaluate(self.form, np.exp((growth + 1j * omega) * self.system.dt))

    def on_axis(self, omega: np.ndarray) -> np.ndarray:
        """M (w, 3 a, a) at omega, from the grid where that has it."""
        k = np.minimum(np.searchsorted(self.omega, omega), len(self.omega) - 1)
        known = self.omega[k] == omega
        M = np.empty((len(omega), *self.M.shape[1:]), complex)
        M[known] = self.M[k[known]]
        M[~known] = self.at(omega[~known])
        return M


def frozen(loop: SynchronousLoop, speed: float, condition: Condition) -> FrozenLoop:
    """The loop of the plant at a speed [rad/s] and condition; the latest are remembered."""
    return loop.remembered(
        ("frozen", float(speed), condition), lambda: _frozen(loop, speed, condition)
    )


def _frozen(loop: SynchronousLoop, speed: float, condition: Condition) -> FrozenLoop:
    system = loop.sampled(speed, condition)
    assert system.dt is not None
    form = schur_form(system.A, system.B, system.C, system.D, expand=True)
    z = form.poles
    poles = np.log(z[np.abs(z) > 1e-6]) / system.dt
    omega = frequency_grid(poles, _LOWEST, 0.98 * np.pi / system.dt, _PER_DECADE)
    return FrozenLoop(system, form, poles, omega)


@dataclass(frozen=True, slots=True)
class Look:
    """What a loop with its blocks on does at one speed [rad/s]. unstable: poles outside; nearness:
    the largest singular value of (1 - Q M)^-1, infinite at the border of stability; sensitivity,
    and its frequency [rad/s]: the largest one of an axis; alone: without a
    block. convergence: the smallest real part of the eigenvalues of D R of the first block.
    """

    speed: float
    unstable: int
    nearness: float
    sensitivity: float
    frequency: float
    alone: float
    convergence: float


def look(frozen: FrozenLoop, speed: float, blocks: Sequence[Resonator], zoom: bool = True) -> Look:
    """A frozen loop with its blocks. zoom: whether the largest sensitivity is refined over the
    frequency.
    """
    n = frozen.M.shape[2]
    dt = frozen.system.dt
    assert dt is not None
    strength = sum(_bound(block, frozen.omega, frozen.M) for block in blocks)
    base = frozen.S.max(axis=1)
    kept = (strength > _MATTERS) | (base > 0.8 * base.max())

    # beside every block's frequency, to 60 of its bandwidths eps ||D M||
    centres = np.array([block.frequency for block in blocks])
    here = frozen.at(centres)
    spread = [
        block.gain * max(1.0, float(np.linalg.norm(block.drive @ M, 2)))
        for block, M in zip(blocks, here, strict=True)
    ]
    slowest = float(np.linalg.eigvals(-blocks[0].drive @ here[0]).real.min())
    alone = float(base.max())
    beside = [
        c + sign * np.geomspace(_NEAREST * block.gain, _FARTHEST * w, _BESIDE)
        for block, c, w in zip(blocks, centres, spread, strict=True)
        for sign in (-1, 1)
    ]
    # from a standing pole to the highest frequency, so that no half turn is missed at the ends
    ends = _LOWEST * np.array([0.0, 0.01, 0.05, 0.2, 0.5, 1.0])
    omega = np.concatenate([ends, frozen.omega[kept], *beside, [np.pi / dt]])
    omega = np.unique(omega[(omega >= 0) & (omega <= np.pi / dt)])

    # the count of poles outside: half the turns of the phase, the other half is its conjugate
    growth = _OUTSIDE * min(block.gain for block in blocks)
    inner = _difference(frozen, blocks, omega, growth)
    inverse = np.linalg.inv(inner)
    for _ in range(_ROUNDS):
        ratio = inner[1:] @ inverse[:-1] - np.eye(n)
        wide = np.flatnonzero((np.abs(ratio) ** 2).sum(axis=(1, 2)) > _STEP**2)
        if not len(wide):
            break
        more = (omega[wide] + omega[wide + 1]) / 2
        order = np.argsort(np.concatenate([omega, more]), kind="stable")
        omega = np.concatenate([omega, more])[order]
        inner = np.concatenate([inner, _difference(frozen, blocks, more, growth)])[order]
        inverse = np.linalg.inv(inner)
    turned = float(np.angle(np.linalg.det(inner[1:] @ inverse[:-1])).sum())
    nearness = float(np.sqrt((np.abs(inverse) ** 2).sum(axis=(1, 2)).max() / n))

    sensitivities = _axes(frozen, blocks, omega)
    k = int(np.argmax(sensitivities))
    worst, at = float(sensitivities[k]), float(omega[k])
    for _ in range(_ZOOMS if zoom else 0):
        around = np.linspace(omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)], _ZOOM)
        omega, sensitivities = around, _axes(frozen, blocks, around)
        k = int(np.argmax(sensitivities))
        if sensitivities[k] > worst:
            worst, at = float(sensitivities[k]), float(omega[k])
    return Look(speed, abs(round(turned / np.pi)), nearness, worst, at, alone, slowest)


def _bound(block: Resonator, omega: np.ndarray, M: np.ndarray) -> np.ndarray:
    """About ||Q M|| (w,) away from the block's frequency."""
    near = 1 / np.maximum(np.abs(omega - block.frequency), 1e-9)
    size = np.sqrt((np.abs(block.drive[None] @ M) ** 2).sum(axis=(1, 2)))
    return np.asarray(block.gain / 2 * size * (near + 1 / (omega + block.frequency)))


def _transfer(blocks: Sequence[Resonator], z: np.ndarray, dt: float) -> np.ndarray:
    return np.asarray(sum(block.transfer(z, dt) for block in blocks))


def _difference(
    frozen: FrozenLoop, blocks: Sequence[Resonator], omega: np.ndarray, growth: float
) -> np.ndarray:
    """1 - Q M (w, a, a) at exp((growth + j omega) Ts)."""
    dt = frozen.system.dt
    assert dt is not None
    z = np.exp((growth + 1j * omega) * dt)
    M = frozen.at(omega, growth)
    return np.asarray(np.eye(M.shape[2]) - _transfer(blocks, z, dt) @ M)


def sensitivity(frozen: FrozenLoop, blocks: Sequence[Resonator], omega: np.ndarray) -> np.ndarray:
    """S (w, a, a) at omega (w,) [rad/s], from a disturbance of the measured displacements to what
    the controller sees, with the blocks on (none: without).
    """
    M = frozen.on_axis(omega)
    n = M.shape[2]
    S = -M[:, :n]
    if not blocks:
        return np.asarray(S)
    dt = frozen.system.dt
    assert dt is not None
    # exactly at a block's frequency its gain is infinite: a rounding error beside it stands for it
    Q = _transfer(blocks, np.exp(1j * omega * dt) * (1 + 1e-13), dt)
    M_d = -M
    M_d[:, n : 2 * n] += np.eye(n)
    # e = (S + M_e (1 - Q M)^-1 Q M_d) d
    return np.asarray(S + M[:, :n] @ np.linalg.solve(np.eye(n) - Q @ M, Q @ M_d))


def _axes(frozen: FrozenLoop, blocks: Sequence[Resonator], omega: np.ndarray) -> np.ndarray:
    """The largest modulus of an axis' own sensitivity (w,), other loops closed (ISO 14839-3)."""
    return np.asarray(np.abs(np.einsum("waa->wa", sensitivity(frozen, blocks, omega))).max(axis=1))


def sensitivity_peak(
    loop: SynchronousLoop,
    mode: str,
    speed: float,
    condition: Condition,
    T: np.ndarray | None,
    gain: float,
    leak: float = 0.0,
) -> tuple[float, float]:
    """The largest modulus of an axis' own sensitivity with a block on (T None: without), and its
    frequency [rad/s]; T (a, a) at the speed [rad/s], gain eps and leak [1/s].
    """
    here = frozen(loop, speed, condition)
    if T is None or gain == 0:
        k = int(np.argmax(here.S.max(axis=1)))
        return float(here.S[k].max()), float(here.omega[k])
    D = T @ loop.weights(mode, speed, replace(condition, delta=()))
    found = look(here, speed, (resonator(loop, mode, D, speed, gain, leak),))
    return found.sensitivity, found.frequency


def resonator(
    loop: SynchronousLoop,
    mode: str,
    D: np.ndarray,
    speed: float,
    gain: float,
    leak: float = 0.0,
    update: str = "sample",
) -> Resonator:
    """A block of a mode at a speed [rad/s], with D (a, m) as it runs on what the mode reads."""
    rows = [f"{kind}_{axis}" for kind in "eyu" for axis in loop.axes]
    drive = np.zeros((len(D), len(rows)), complex)
    drive[:, [rows.index(name) for name in loop.reads(mode)]] = D
    turn = 2 * np.pi / speed if update == "turn" else 0.0
    return Resonator(drive, loop.harmonic * speed, gain, leak, turn)


def growth(system: StateSpace, blocks: Sequence[Resonator]) -> float:
    """ln|z|/Ts [rad/s] of the outermost exact pole of a sampled loop from c to (e, y, u) with its
    blocks; with any that moves once a turn, of its multipliers over one.
    """
    return growth_by_gain(system, blocks)(blocks[0].gain)


def growth_by_gain(system: StateSpace, blocks: Sequence[Resonator]) -> Callable[[float], float]:
    """``growth`` as a function of the first block's gain eps [1/s]."""
    assert system.dt is not None
    first, dt = blocks[0], system.dt
    # the others that move with every sample are part of the loop
    still = [(b.drive, b.frequency, b.gain, b.leak) for b in blocks[1:] if not b.turn]
    turning = [b for b in blocks if b.turn]
    if not turning:

        def by_poles(gain: float) -> float:
            own = (first.drive, first.frequency, gain, first.leak)
            z = np.linalg.eigvals(with_resonators(system, [own, *still]))
            return float(np.log(max(np.abs(z).max(), 1e-300)) / dt)

        return by_poles
    rows = [(b.drive, round(b.frequency * b.turn / (2 * np.pi))) for b in turning]
    speed = 2 * np.pi / turning[0].turn

    def over_a_turn(gain: float) -> Callable[[float], float]:
        if not first.turn:
            own = (first.drive, first.frequency, gain, first.leak)
            closed = around_resonators(system, [own, *still])
        else:
            closed = around_resonators(system, still) if still else system
        over = turn_map_of(closed, rows, speed)
        leaks = [b.leak for b in turning]

        def of(gain: float) -> float:
            gains = [gain if b is first else b.gain for b in turning]
            size = np.abs(over.multipliers(gains, leaks)).max()
            return float(np.log(max(size, 1e-300)) / over.time)

        return of

    if first.turn:
        return over_a_turn(first.gain)
    return lambda gain: over_a_turn(gain)(gain)


SETTLED = 3.0  # time constants in which a block has to settle: 95 %
MINUTE = 60.0  # s, for a run-up through the band where none is known
_BASES = 7  # speeds of a band at which the plant is taken
_FEWER = 3  # with tolerances, three of those
_EVEN = 7  # speeds around each of them, evenly
# beside a pole or zero, of its damping and of the block's eps
_AROUND = np.array([-8.0, -2.5, -0.8, -0.25, 0.0, 0.25, 0.8, 2.5, 8.0])
_LIGHT = 0.15  # damping ratio below which a pole is a narrow one
_WORST = 2  # candidates of either kind that are refined
_LEAST = 6  # minima of ``least`` that are refined
_DOUBTED = 40  # looks that are repeated, about
_WIDTHS = 1 / 4, 1 / 32  # of a base's share of the band: what a refinement looks at

Blocks = Callable[[float], tuple[Resonator, ...]]


@dataclass(frozen=True, slots=True)
class Found:
    """A speed at which a loop was looked at with its own plant. growth [rad/s]: its outermost exact
    pole.
    """

    look: Look
    condition: Condition
    growth: float

    @property
    def stable(self) -> bool:
        return self.growth < 0


@dataclass(frozen=True, slots=True)
class Least:
    """The smallest of a quantity and where it was found; count: of how many speeds."""

    value: float
    speed: float
    condition: Condition
    count: int


@dataclass(frozen=True, slots=True)
class Survey:
    """What was looked at. places: the worst ones, refined; looks: ascending in speed, the most
    sensitive of all conditions at each; slowest: the smallest real part of D R; count: how many
    looks.
    """

    places: tuple[Found, ...]
    looks: tuple[Look, ...]
    slowest: Least
    count: int

    @property
    def least_stable(self) -> Found:
        """An unstable place, else the one nearest to instability."""
        return max(self.places, key=lambda item: (not item.stable, item.look.nearness))

    @property
    def most_sensitive(self) -> Found:
        return max(self.places, key=lambda item: item.look.sensitivity)


def bad_parts(
    found: Survey, band: tuple[float, float], bad: Callable[[Look], bool]
) -> list[tuple[float, float, float]]:
    """The parts (low, high, worst) of a band [rad/s] between good looks in which a look is bad."""
    speeds = [one.speed for one in found.looks]
    wrong = [bad(one) for one in found.looks]
    parts: list[tuple[float, float, float]] = []
    for is_wrong, alike in itertools.groupby(range(len(speeds)), wrong.__getitem__):
        numbers = [*alike]
        if is_wrong:
            first, last = numbers[0], numbers[-1]
            low = speeds[first - 1] if first else band[0]
            high = speeds[last + 1] if last + 1 < len(speeds) else band[1]
            worst = max(found.looks[first : last + 1], key=_stability)
            parts.append((low, high, worst.speed))
    return parts


def bases(band: tuple[float, float], count: int = _BASES) -> np.ndarray:
    """The speeds [rad/s] of a band at which the plant is taken, its ends among them."""
    return np.linspace(*band, count)


def unstable(one: Look) -> bool:
    return one.unstable > 0


def survey(
    loop: SynchronousLoop,
    band: tuple[float, float],
    knots: Sequence[float],
    blocks: Blocks,
    conditions: Sequence[Condition],
    members: bool = False,
    doubt: Callable[[Look], bool] = unstable,
) -> Survey:
    """The worst speeds of a band [rad/s] over conditions. knots: speeds of the table; blocks: those
    that are on at a speed; members: the conditions are corners of tolerances, at fewer plants;
    doubt: looks that are repeated with the plant of their own speed.
    """
    every: list[tuple[Look, Condition]] = []
    count = _FEWER if members else _BASES
    half = (band[1] - band[0]) / (count - 1) / 2
    for condition in conditions:
        for base in bases(band, count):
            here = frozen(loop, float(base), condition)
            # half a part further on either side: a mode moves with the speed
            low, high = max(band[0], base - 2 * half), min(band[1], base + 2 * half)
            even = np.linspace(max(band[0], base - half), min(band[1], base + half), _EVEN)
            for w in _grid(here, low, high, even, knots, blocks):
                every.append((look(here, float(w), blocks(float(w)), zoom=False), condition))

    def refined(kind: Callable[[Look], float]) -> list[Found]:
        return [
            _refined(loop, band, knots, blocks, condition, found, kind, 2 * half)
            for found, condition in _worst(every, kind, half)
        ]

    # a plant of another speed may call what is stable unstable: asked again, and no worse than so;
    # where the worst is exactly unstable, only if somebody asks for more than that
    places = refined(_stability)
    doubted = [i for i, (one, _) in enumerate(every) if doubt(one)]
    if doubted and (doubt is not unstable or all(place.stable for place in places)):
        for i in doubted[:: max(1, len(doubted) // _DOUBTED)]:
            one, condition = every[i]
            own = frozen(loop, one.speed, condition)
            every[i] = look(own, one.speed, blocks(one.speed), zoom=False), condition
        places = refined(_stability)
    places += refined(_sensitivity)
    drawn: dict[float, Look] = {}
    for one in (*(one for one, _ in every), *(place.look for place in places)):
        known = drawn.get(one.speed)
        if known is None or one.sensitivity > known.sensitivity:
            drawn[one.speed] = one
    slowest = least(loop, band, knots, blocks, conditions, _slowest, count)
    return Survey(tuple(places), tuple(drawn[w] for w in sorted(drawn)), slowest, len(every))


def least(
    loop: SynchronousLoop,
    band: tuple[float, float],
    knots: Sequence[float],
    blocks: Blocks,
    conditions: Sequence[Condition],
    value: Callable[[np.ndarray], np.ndarray],
    count: int = _FEWER,
) -> Least:
    """The smallest value of D R (w, a, a) of the first block over a band [rad/s] and conditions:
    the plant at ``count`` speeds of it, its frequency around each; the worst again, each time
    nearer, with the plant of their own speed.
    """
    looked = 0
    cells = list(itertools.pairwise(bases(band, count).tolist()))
    found: list[Least] = []

    def smallest(
        plants: Sequence[tuple[float, FrozenLoop]], condition: Condition, low: float, high: float
    ) -> list[Least]:
        """All minima, with the response linear between those of two plants, or of one."""
        nonlocal looked
        even = np.linspace(low, high, _EVEN)
        grids = [_grid(here, low, high, even, knots, blocks) for _, here in plants]
        speeds = np.unique(np.concatenate(grids))
        on = [blocks(float(w))[0] for w in speeds]
        frequencies = np.array([block.frequency for block in on])
        (first, here), (last, other) = plants[0], plants[-1]
        R = here.at(frequencies)
        if last > first:
            share = ((speeds - first) / (last - first))[:, None, None]
            R = (1 - share) * R + share * other.at(frequencies)
        values = value(np.array([block.drive for block in on]) @ -R)
        looked += len(speeds)
        around = np.pad(values, 1, constant_values=np.inf)
        lowest = np.flatnonzero((values <= around[:-2]) & (values <= around[2:]))
        return [Least(float(values[k]), float(speeds[k]), condition, looked) for k in lowest]

    exact: list[Least] = []
    for condition in conditions:
        plants = [(w, frozen(loop, w, condition)) for w in bases(band, count).tolist()]
        for plant in plants:
            exact += smallest([plant], condition, plant[0], plant[0])
        for k, (low, high) in enumerate(cells):
            found += smallest(plants[k : k + 2], condition, low, high)
    part = (band[1] - band[0]) / (count - 1)
    waiting = sorted(found, key=lambda item: item.value)
    for _ in range(_LEAST):
        if not waiting:
            break
        place = waiting[0]
        # of one minimum one
        waiting = [
            item
            for item in waiting
            if item.condition != place.condition or abs(item.speed - place.speed) > part / 8
        ]
        worst = place
        for width in (*_WIDTHS, 0.0):
            reach, speed = width * part, worst.speed
            ends = max(band[0], speed - reach), min(band[1], speed + reach)
            own = [(speed, frozen(loop, speed, worst.condition))]
            worst = min(smallest(own, worst.condition, *ends), key=lambda item: item.value)
        exact.append(worst)
    worst = min(exact, key=lambda item: item.value)
    return Least(worst.value, worst.speed, worst.condition, looked)


def _slowest(DR: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.eigvals(DR).real.min(axis=-1))


def _stability(one: Look) -> float:
    return one.nearness * (1e6 if one.unstable else 1.0)


def _sensitivity(one: Look) -> float:
    return one.sensitivity


def _worst(
    every: Sequence[tuple[Look, Condition]], kind: Callable[[Look], float], apart: float
) -> list[tuple[Look, Condition]]:
    """The worst of all looks, ``apart`` [rad/s] from each other."""
    chosen: list[tuple[Look, Condition]] = []
    for one, condition in sorted(every, key=lambda item: -kind(item[0])):
        if all(abs(one.speed - other.speed) > apart for other, _ in chosen):
            chosen.append((one, condition))
        if len(chosen) == _WORST:
            break
    return chosen


def _refined(
    loop: SynchronousLoop,
    band: tuple[float, float],
    knots: Sequence[float],
    blocks: Blocks,
    condition: Condition,
    found: Look,
    kind: Callable[[Look], float],
    part: float,
) -> Found:
    """The worst near a look, with the plant of its own speed, and the exact poles there."""
    for width in _WIDTHS:
        here = frozen(loop, found.speed, condition)
        low, high = (
            max(band[0], found.speed - width * part),
            min(band[1], found.speed + width * part),
        )
        even = np.append(np.linspace(low, high, _EVEN), found.speed)
        looks = [
            look(here, float(w), blocks(float(w)), zoom=False)
            for w in _grid(here, low, high, even, knots, blocks)
        ]
        found = max(looks, key=kind)
    speed = found.speed
    here = frozen(loop, speed, condition)
    found = look(here, speed, blocks(speed))
    return Found(found, condition, growth(here.system, blocks(speed)))


def _grid(
    here: FrozenLoop,
    low: float,
    high: float,
    even: np.ndarray,
    knots: Sequence[float],
    blocks: Blocks,
) -> np.ndarray:
    """Speeds from low to high [rad/s]: even ones, the table's and between them, and around every
    light pole and zero.
    """
    inside = [low, *(w for w in knots if low < w < high), high]
    between = [(a + b) / 2 for a, b in itertools.pairwise(inside)]
    speeds = [*even, *inside, *between]
    for block in blocks((low + high) / 2):
        multiple = block.frequency / ((low + high) / 2)
        own = here.poles[(here.poles.imag > 0) & (-here.poles.real < _LIGHT * here.poles.imag)]
        places = [(float(p.imag), abs(float(p.real))) for p in own]
        places += [(w, 0.0) for w in zeros(here, block, multiple * low, multiple * high)]
        for frequency, damping in places:
            if low <= frequency / multiple <= high:
                for width in {max(damping, 1e-6 * frequency), block.gain}:
                    speeds += list((frequency + width * _AROUND) / multiple)
    every = np.unique(np.array(speeds))
    return np.asarray(every[(every >= low) & (every <= high)])


def zeros(here: FrozenLoop, block: Resonator, low: float, high: float) -> list[float]:
    """Frequencies [rad/s] where what a block drives to zero has a transmission zero near the axis:
    minima of its smallest singular value, each refined.
    """
    # D = T Z: whatever T is, an orthonormal basis of its rows is one of those of Z
    basis = np.linalg.qr(block.drive.conj().T)[0].conj().T
    grid = np.unique(
        np.concatenate(
            [
                np.linspace(low, high, 40),
                here.omega[(here.omega > low) & (here.omega < high)],
            ]
        )
    )

    def smallest(omega: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.svd(basis @ here.at(omega), compute_uv=False)[:, -1])

    values = smallest(grid)
    found = []
    for k in range(1, len(grid) - 1):
        if values[k] <= min(values[k - 1], values[k + 1]):
            a, b = grid[k - 1], grid[k + 1]
            for _ in range(4):
                around = np.linspace(a, b, 12)
                m = int(np.argmin(smallest(around)))
                a, b = around[max(m - 1, 0)], around[min(m + 1, 11)]
            found.append(float((a + b) / 2))
    return found
