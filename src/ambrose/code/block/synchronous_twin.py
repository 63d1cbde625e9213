"""Synchronous blocks in whole numbers, sample by sample: what the fixed-point C code does, bit by
bit.

The steps are those of ``law.synchronous_block`` in the same order; formats and bounds are in
synchronous_twin.py. Python's integers have no end: the code agrees because no sum of it leaves 64
bits.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from ambrose.core.checks import check_shape, invalid
from ambrose.law.synchronous_block import (
    DECAY,
    LOST_TURNS,
    SECTORS,
    BlockFault,
    BlockLaw,
    BlockState,
    SynchronousLaw,
    circle,
)

# Synchronous blocks in whole numbers: Q formats in which no sum overflows, and what rounding does.
#
# Every signal is a part of its limit (errors, c and amplitudes of the channel's error limit,
# currents of their limit), a word of 2^30 for one; a controller with words of 16 bits has its
# signals shifted in and out. A turn is 2^32, so that angles wrap as unsigned numbers do. Times are
# counted in 2^-time_bits of a sample, speeds in 2^-40 of a turn a sample. With Q the bits behind
# the point:
#
#     theta = (2 W + W' tau) tau/2       modulo a turn            W Q40, tau Q time_bits, W' Q slope
#     D(W) = D_k + share (D_{k+1} - D_k)                          share Q30, D Q drive_bits
#     x = exp(-j n theta) D s                                     s Q30 (twice its limit), x Q(30-h)
#     a += ramp eps Ts x - leak Ts a                              a Q amplitude_bits in 64 bits
#
# The stored amplitude has the bits below the signal's resolution, so that an increment eps Ts T e
# is not lost (no dead zone). Cosine and sine come from the table of 256 sectors and a remainder d
# of third order:
#
#     |error| <= d^4/24 + d^5/120 + rounding of table, remainder and product,   d = pi/256


SIGNAL = 30  # bits of a word behind the point
ONE = 1 << SIGNAL
LARGEST = (1 << 31) - 1  # of a word
SPEED = 40  # of a speed [turns a sample]
PLACE = 31  # of a speed in a table
MOST_AMPLITUDE = 58  # of a stored amplitude: twice its limit fits 64 bits
_MOST_TIME = 20  # of a time [samples]: 1.5 turns and a sample, times the speed, fit 64 bits
_LEAST_TIME = 12
REMAINDER = 36  # of the angle within a sector [rad]
# of a remainder: d = rest 2 pi/2^32 in Q36, rest a whole number up to 2^23
PER_REST = round(2 * math.pi * 2**28)
SIXTH = round(2**30 / 6)


@dataclass(frozen=True, slots=True, eq=False)
class BlockWords:
    """One block in whole numbers. speeds (s,) Q31 with the reciprocals (s - 1,) of their distances
    and their bits; re, im (s, n, m): D in Q ``drive_bits``; headroom h of x; limit (n,) Q30;
    low, high, hysteresis Q31; gain, leak and fade with gain_bits, leak_bits and fade_bits; ramp:
    Q30 a sample; hold, release, most [samples]: most, of a turn within the band.

    relative [-]: bound on how much rounding changes D at any speed, over its smallest gain.
    """

    law: BlockLaw
    speeds: np.ndarray
    reciprocals: np.ndarray
    reciprocal_bits: np.ndarray
    re: np.ndarray
    im: np.ndarray
    drive_bits: int
    headroom: int
    amplitude_bits: int
    limit: np.ndarray
    low: int
    high: int
    hysteresis: int
    gain: int
    gain_bits: int
    leak: int
    leak_bits: int
    fade: int
    fade_bits: int
    ramp: int
    hold: int
    release: int
    most: int
    relative: float


@dataclass(frozen=True, slots=True, eq=False)
class SynchronousWords:
    """All blocks in whole numbers. time_bits, slope_bits: see above; fastest Q slope_bits; table
    (256, 2) Q30; error_limit, current_limit (n,): of the controller beneath.
    """

    law: SynchronousLaw
    blocks: tuple[BlockWords, ...]
    time_bits: int
    slope_bits: int
    fastest: int
    table: np.ndarray
    error_limit: np.ndarray
    current_limit: np.ndarray

    @property
    def table_error(self) -> float:
        """Bound on the error of a cosine or sine of an angle in 2^-32 turns."""
        d = math.pi / SECTORS
        # table and p at most 1, the products' remainders, and the result, half a unit each
        return d**4 / 24 + d**5 / 120 + 3 * 2.0 ** -(SIGNAL + 1) + 4 * 2.0**-REMAINDER

    @property
    def angle_error(self) -> float:
        """Bound on the error of an angle [rad] between two pulses, in a band, from the same
        pulses at the resolution of time: of tau and of two periods, of W and of W'.
        """
        dt = self.law.sample_time
        fastest = max(block.band[1] for block in self.law.blocks) * dt / (2 * math.pi)
        slowest = min(block.band[0] for block in self.law.blocks) * dt / (2 * math.pi)
        turn = LOST_TURNS / slowest
        # d(W tau): W of two periods half a count off each, times 1.5 turns; W', rounded
        times = (1 + 4 * LOST_TURNS) * fastest * 2.0**-self.time_bits
        rounding = turn * 2.0**-SPEED + turn**2 * 2.0 ** -(self.slope_bits + 1) + 2.0**-32
        return 2 * math.pi * (times + rounding)

    def reading_error(self, block: BlockWords) -> float:
        """Bound on what rounding of x does in one sample, as a reading [-] (a part of the error
        limit) that would do the same: half a unit of x, turned, over the smallest gain of D.
        """
        n = self.law.channels
        # x and y half a unit of Q(30 - h) each, and half of a unit after turning
        off = 2.0 ** (block.headroom - SIGNAL) * math.sqrt(2 * n)
        return off / _smallest(_normalised(block.law, self.error_limit, self.current_limit))


def to_words(
    law: SynchronousLaw, error_limit: np.ndarray, current_limit: np.ndarray
) -> SynchronousWords:
    """The blocks beside a controller whose errors and currents have these limits (n,) [m] and [A].

    Raises InvalidInput for what whole numbers cannot hold: an amplitude's limit beyond the error's,
    a band whose turns are too long to be counted.
    """
    n, dt = law.channels, law.sample_time
    e = check_shape(error_limit, "error_limit", "(n,)", n=n).astype(float)
    u = check_shape(current_limit, "current_limit", "(n,)", n=n).astype(float)
    slowest = min(block.band[0] for block in law.blocks)
    longest = LOST_TURNS * 2 * math.pi / (slowest * dt) if slowest > 0 else math.inf

    # 1.5 turns are fewer than 2^31 counts
    time_bits = min(_MOST_TIME, 30 - math.ceil(math.log2(longest))) if longest < 2**31 else 0
    if time_bits < _LEAST_TIME:
        least = LOST_TURNS * 2 * math.pi / (dt * 2 ** (30 - _LEAST_TIME))
        raise invalid(
            "the band of a synchronous block",
            f"from {slowest:g} rad/s",
            f"from {least:.3g} rad/s at least in fixed point at {1 / dt:g} Hz",
            "begin it there, or use double or float",
        )
    change = min(law.fastest * dt * dt / (2 * math.pi), 1.0)
    slope_bits = min(60, math.floor(30 - math.log2(change)) - 1)
    blocks = tuple(_block(block, law, e, u) for block in law.blocks)
    return SynchronousWords(
        law,
        blocks,
        time_bits,
        slope_bits,
        max(1, round(change * 2.0**slope_bits)),
        np.rint(circle() * ONE).astype(np.int64),
        e,
        u,
    )


def place(speed: float, dt: float) -> int:
    """A speed [rad/s] in Q31 of turns a sample, within a word."""
    return min(max(round(speed * dt / (2 * math.pi) * 2**PLACE), 0), LARGEST)


def _block(block: BlockLaw, law: SynchronousLaw, e: np.ndarray, u: np.ndarray) -> BlockWords:
    dt = law.sample_time
    if (block.limit > e).any():
        k = int(np.argmax(block.limit / e))
        raise invalid(
            "the limit of a synchronous block's amplitude",
            f"{block.limit[k]:.3g} m",
            f"at most the controller's error limit in fixed point, {e[k]:.3g} m",
            "lower it, or use double or float",
        )
    speeds = np.array([place(float(w), dt) for w in block.speeds], np.int64)
    steps = np.diff(speeds)
    if (steps <= 0).any():
        raise invalid(
            "the speeds of a synchronous block's table",
            f"{2 * math.pi / dt * 2.0**-PLACE:.2g} rad/s apart or less",
            "further apart in fixed point",
            "leave one out, or use double or float",
        )
    bits = np.array([int(step).bit_length() - 1 for step in steps], np.int64)
    reciprocals = np.array(
        [
            ((1 << (SIGNAL + bit)) + step // 2) // step
            for step, bit in zip(steps.tolist(), bits.tolist(), strict=True)
        ],
        np.int64,
    )

    # |x| <= sum |D| 2 < 2^(h + 1); sum |coefficient| 2^drive_bits 2^31 <= 2^62
    drive = _normalised(block, e, u)
    parts = np.maximum(np.abs(drive.real), np.abs(drive.imag)).max(axis=0).sum(axis=1).max()
    modulus = np.abs(drive).sum(axis=2).max()
    headroom = max(0, math.ceil(math.log2(modulus * (1 + 1e-6))))
    drive_bits = math.floor(math.log2((2**31 - 64) / parts))
    re, im = (np.rint(part * 2.0**drive_bits).astype(np.int64) for part in (drive.real, drive.imag))
    off = np.linalg.norm((re + 1j * im) * 2.0**-drive_bits - drive, 2, axis=(1, 2)).max()
    if len(steps):
        # between two speeds: both and the present one rounded, the reciprocal and the share
        shares = (2 / steps + 2.0**-28) * np.linalg.norm(np.diff(drive, axis=0), 2, axis=(1, 2))
        off += 2.0 ** -(drive_bits + 1) * drive.shape[2] + shares.max()

    gain, gain_bits = _mantissa(block.gain * dt)
    # the stored amplitude: no increment is shifted to the left
    amplitude_bits = min(MOST_AMPLITUDE, gain_bits + SIGNAL - headroom)
    leak, leak_bits = _mantissa(block.leak * dt) if block.leak else (0, amplitude_bits)
    fade, fade_bits = _mantissa(dt / block.release)
    return BlockWords(
        law=block,
        speeds=speeds,
        reciprocals=reciprocals,
        reciprocal_bits=bits,
        re=re,
        im=im,
        drive_bits=drive_bits,
        headroom=headroom,
        amplitude_bits=amplitude_bits,
        limit=np.floor(block.limit / e * ONE).astype(np.int64),
        low=place(block.band[0], dt),
        high=place(block.band[1], dt),
        hysteresis=place(block.hysteresis, dt),
        gain=gain,
        gain_bits=gain_bits,
        leak=leak,
        leak_bits=leak_bits,
        fade=fade,
        fade_bits=fade_bits,
        ramp=max(1, round(dt / block.ramp * ONE)),
        hold=round(block.hold / dt),
        release=round(DECAY * block.release / dt),
        most=math.ceil(LOST_TURNS * 2 * math.pi / (block.band[0] * dt)) + 2,
        relative=float(off / _smallest(drive)),
    )


def _normalised(block: BlockLaw, e: np.ndarray, u: np.ndarray) -> np.ndarray:
    """D (s, n, m) between parts of limits: columns of displacements, then of currents."""
    columns = np.concatenate([e, u]) if block.reads_currents else e
    return np.asarray(block.drive * columns / e[:, None])


def _smallest(drive: np.ndarray) -> float:
    """The smallest gain of D over its table."""
    return float(np.linalg.svd(drive, compute_uv=False)[:, -1].min())


def _mantissa(value: float) -> tuple[int, int]:
    """A positive number as a whole one of 31 bits and the bits behind its point."""
    bits = 30 - math.floor(math.log2(value))
    whole = round(value * 2.0**bits)
    return (whole, bits) if whole <= LARGEST else (whole // 2, bits - 1)


_STILL = 1 << 62  # counts beyond which time stands still
_FARTHEST = 1 << 31  # counts beyond which a turn counts as that long
_FASTEST = 1 << SPEED  # one turn a sample


def shifted(value: int, bits: int) -> int:
    """value / 2^bits to the nearest, halves away from zero."""
    half = 1 << (bits - 1) if bits > 0 else 0
    return (value + half) >> bits if value >= 0 else -((half - value) >> bits)


def limited(value: int, limit: int) -> int:
    """value within +-limit."""
    return min(max(value, -limit), limit)


@dataclass(slots=True)
class AngleWords:
    """The rotor's angle: theta in 2^-32 turns, now in Q31 turns a sample, the rest as ``Angle``."""

    time_bits: int
    slope_bits: int
    fastest: int
    pulses: int = 0
    tau: int = 0
    period: int = 0
    middle: int = 0
    speed: int = 0
    slope: int = 0
    now: int = 0
    theta: int = 0
    turned: bool = False

    def follow(self, pulse: int) -> BlockFault:
        """One sample. pulse: how long ago it came in Q30 samples, 0 to 2^30 - 1; else none."""
        fault, tb = BlockFault.NONE, self.time_bits
        if self.tau < _STILL:
            self.tau += 1 << tb

        # a turn has ended: 2^40 turns a sample over its length
        came = 0 <= pulse < ONE
        if came:
            ago = pulse >> (SIGNAL - tb)
            period = min(self.tau - ago, _FARTHEST - 1)
            self.tau = ago
            if self.pulses > 0:
                middle = min((1 << (SPEED + tb)) // period, _FASTEST)
                if self.pulses > 1:
                    fault = self._slope(middle, (period + self.period) // 2)
                self.period, self.middle = period, middle
                half = shifted(self.slope * period, self.slope_bits + tb + 1 - SPEED)
                self.speed = min(max(middle + half, 0), _FASTEST)
            self.pulses = min(self.pulses + 1, 3)

        # W' tau,   theta = (2 W + W' tau) tau/2 modulo a turn, and W + W' tau
        recent = min(self.tau, _FARTHEST - 1)
        gained = shifted(self.slope * recent, self.slope_bits + tb - SPEED)
        twice = (2 * self.speed + gained) * self.tau
        self._place(self.speed + gained)
        if self.pulses > 1 and self.speed * self.tau > 3 << (SPEED + tb - 1):
            self.slope = 0
            self._place(self.speed)
            self.pulses = -1
        if self.pulses < 2:
            fault |= BlockFault.LOST
            if came and self.pulses < 1:
                self.pulses = 1
        if self.tau < _STILL:
            self.theta = (twice >> (SPEED + tb + 1 - 32)) & 0xFFFFFFFF
        self.turned = came and not fault
        return fault

    def _slope(self, middle: int, span: int) -> BlockFault:
        """W' of the last two turns, whose middles are ``span`` apart; a jump is none."""
        change = middle - self.middle
        explained = (self.fastest * span) >> (self.slope_bits + self.time_bits - SPEED)
        if abs(change) > explained + self.middle // 10:
            self.pulses = self.slope = 0
            return BlockFault.JUMP
        if abs(change) >= explained:
            self.slope = self.fastest if change > 0 else -self.fastest if change < 0 else 0
        else:
            size = (abs(change) << (self.slope_bits + self.time_bits - SPEED)) // span
            self.slope = limited(size if change > 0 else -size, self.fastest)
        return BlockFault.NONE

    def _place(self, speed: int) -> None:
        self.now = min(max(speed >> (SPEED - PLACE), 0), LARGEST)


@dataclass(slots=True)
class _Running:
    state: BlockState = BlockState.OFF
    fault: BlockFault = BlockFault.NONE
    clock: int = 0
    ramp: int = 0
    re: list[int] = field(default_factory=list)
    im: list[int] = field(default_factory=list)
    sum_re: list[int] = field(default_factory=list)
    sum_im: list[int] = field(default_factory=list)
    count: int = 0


class SynchronousTwin:
    """All blocks in whole numbers, running. ``step`` is one sample. up: by how many bits its
    signals are shorter than Q30.
    """

    __slots__ = ("angle", "running", "up", "words")

    def __init__(self, words: SynchronousWords, up: int = 0) -> None:
        self.words, self.up = words, up
        self.begin()

    def begin(self) -> None:
        """At rest: no pulse yet, all off."""
        words = self.words
        self.angle = AngleWords(words.time_bits, words.slope_bits, words.fastest)
        n = words.law.channels
        self.running = [
            _Running(re=[0] * n, im=[0] * n, sum_re=[0] * (2 * n), sum_im=[0] * (2 * n))
            for _ in words.blocks
        ]

    @property
    def states(self) -> tuple[BlockState, ...]:
        """The state of every block."""
        return tuple(run.state for run in self.running)

    def amplitudes(self) -> np.ndarray:
        """a (blocks, n) complex [m], the stored whole numbers in metres."""
        return np.array(
            [
                (np.array(run.re, float) + 1j * np.array(run.im, float))
                * 2.0**-block.amplitude_bits
                * self.words.error_limit
                for block, run in zip(self.words.blocks, self.running, strict=True)
            ]
        )

    def step(
        self,
        pulse: int,
        errors: Iterable[int],
        currents: Iterable[int],
        contact: bool = False,
        saturated: bool = False,
        enabled: bool = True,
        unusable: bool = False,
    ) -> list[int]:
        """c (n,) of this sample, Q(30 - up) of the error limits; pulse: as ``AngleWords.follow``;
        errors, currents (n,): all Q(30 - up); the flags as of ``SynchronousBlock.step``.
        """
        errors, currents = (
            [int(value) << self.up for value in part] for part in (errors, currents)
        )
        fault = self.angle.follow(pulse << self.up)
        fault |= BlockFault.CONTACT * contact | BlockFault.SATURATED * saturated
        if unusable or any(abs(e) > ONE for e in errors):
            fault |= BlockFault.INPUT
        n, turns = self.words.law.channels, []
        total = [0] * n
        for block, run in zip(self.words.blocks, self.running, strict=True):
            cosine, sine = self.turn(block.law.harmonic)
            turns.append((cosine, sine))
            self._advance(block, run, fault, enabled)
            if block.law.per_turn:
                self._end_of_turn(block, run)
            to_word = block.amplitude_bits - SIGNAL
            for i in range(n):
                re, im = shifted(run.re[i], to_word), shifted(run.im[i], to_word)
                total[i] += shifted(re * cosine - im * sine, SIGNAL)
        c = [limited(value, LARGEST) for value in total]
        for block, run, turn in zip(self.words.blocks, self.running, turns, strict=True):
            self._learn(block, run, turn, errors, c, currents)
        return [limited(shifted(value, self.up), LARGEST >> self.up) for value in c]

    def turn(self, harmonic: int) -> tuple[int, int]:
        """Cosine and sine of n theta in Q30."""
        turn = (harmonic * self.angle.theta) & 0xFFFFFFFF
        # sector's middle plus d, |d| <= pi/256:   cos d = 1 - d^2/2, sin d = d - d^3/6
        sector = (turn + (1 << 23)) >> 24
        d = shifted((turn - (sector << 24)) * PER_REST, 24)
        square = shifted(d * d, REMAINDER)
        p = ONE - shifted(square, REMAINDER + 1 - SIGNAL)
        q = d - shifted(shifted(square * d, REMAINDER) * SIXTH, 30)
        cosine, sine = (int(value) for value in self.words.table[sector & 255])
        small = REMAINDER - SIGNAL
        return (
            shifted(cosine * p - shifted(sine * q, small), SIGNAL),
            shifted(sine * p + shifted(cosine * q, small), SIGNAL),
        )

    def _learn(
        self,
        block: BlockWords,
        run: _Running,
        turn: tuple[int, int],
        errors: list[int],
        c: list[int],
        currents: list[int],
    ) -> None:
        """What a sample does to the amplitudes."""
        if run.state is BlockState.RELEASE:
            for part in (run.re, run.im):
                for i, value in enumerate(part):
                    part[i] = value - _share(block, block.fade, block.fade_bits, value)
        if run.state is not BlockState.ON:
            return
        cosine, sine = turn
        own = c if block.law.subtracts else [0] * len(c)
        s = [limited(-e - added, LARGEST) for e, added in zip(errors, own, strict=True)]
        if block.law.reads_currents:
            s = [*s, *currents]
        if block.law.per_turn:
            for i, value in enumerate(s):
                run.sum_re[i] += shifted(value * cosine, SIGNAL)
                run.sum_im[i] -= shifted(value * sine, SIGNAL)
            run.count += 1
            return
        x, y = self._drive(block, s)
        ahead = [shifted(a * cosine + b * sine, SIGNAL) for a, b in zip(x, y, strict=True)]
        beside = [shifted(b * cosine - a * sine, SIGNAL) for a, b in zip(x, y, strict=True)]
        self._move(block, run, 1, ahead, beside)

    def _end_of_turn(self, block: BlockWords, run: _Running) -> None:
        """a += ramp eps t D mean, the mean of exp(-j n theta) s over the turn."""
        on = run.state is BlockState.ON
        if on and self.angle.turned and run.count > 0:
            mean_re, mean_im = (
                [_divided(value, run.count) for value in part] for part in (run.sum_re, run.sum_im)
            )
            x, y = self._drive(block, mean_re)
            u, v = self._drive(block, mean_im)
            # (x + j y) + j (u + j v)
            real = [a - b for a, b in zip(x, v, strict=True)]
            imaginary = [a + b for a, b in zip(y, u, strict=True)]
            self._move(block, run, min(run.count, block.most), real, imaginary)
        if not on or self.angle.turned:
            run.count = 0
            run.sum_re = [0] * len(run.sum_re)
            run.sum_im = [0] * len(run.sum_im)

    def _drive(self, block: BlockWords, s: list[int]) -> tuple[list[int], list[int]]:
        """D(W) s in Q(30 - headroom), real and imaginary part."""
        speeds, now = block.speeds, self.angle.now
        k = 0
        share = after = 0
        if len(speeds) > 1:
            while k < len(speeds) - 2 and now >= speeds[k + 1]:
                k += 1
            beyond = max(now - int(speeds[k]), 0)
            beyond = min(beyond, int(speeds[k + 1] - speeds[k]))
            share = min((beyond * int(block.reciprocals[k])) >> int(block.reciprocal_bits[k]), ONE)
            after = 1
        found = []
        for part in (block.re, block.im):
            first, second = part[k].tolist(), part[k + after].tolist()
            found.append(
                [
                    shifted(
                        sum(
                            (a + shifted(share * (b - a), SIGNAL)) * value
                            for a, b, value in zip(row, other, s, strict=False)
                        ),
                        block.drive_bits + block.headroom,
                    )
                    for row, other in zip(first, second, strict=True)
                ]
            )
        return found[0], found[1]

    def _move(
        self, block: BlockWords, run: _Running, count: int, x: list[int], y: list[int]
    ) -> None:
        """a += ramp eps t (x + j y) - leak t a, t = count samples, each amplitude within its
        limit.
        """
        # an increment of more than the whole range counts as the range
        gain = shifted(run.ramp * block.gain, SIGNAL)
        most = (1 << block.amplitude_bits) // count
        down = block.gain_bits + SIGNAL - block.headroom - block.amplitude_bits
        for part, moved in ((run.re, x), (run.im, y)):
            for i, value in enumerate(moved):
                lost = _share(block, block.leak, block.leak_bits, part[i])
                gained = limited(shifted(gain * value, down), most)
                part[i] += count * gained - count * limited(lost, most)
        to_word = block.amplitude_bits - SIGNAL
        for i, limit in enumerate(block.limit.tolist()):
            re, im = shifted(run.re[i], to_word), shifted(run.im[i], to_word)
            square = re * re + im * im
            if square > limit * limit:
                # limit/|a|, rounded down, so that the amplitude is not beyond its limit again
                factor = (limit << SIGNAL) // (math.isqrt(square) + 1)
                run.re[i] = shifted(re * factor, 2 * SIGNAL - block.amplitude_bits)
                run.im[i] = shifted(im * factor, 2 * SIGNAL - block.amplitude_bits)
                run.fault |= BlockFault.LIMIT

    def _advance(self, block: BlockWords, run: _Running, fault: BlockFault, enabled: bool) -> None:
        """The state machine of one block, as of ``SynchronousBlock``."""
        edge = block.hysteresis if run.state is BlockState.OFF else 0
        inside = block.low + edge <= self.angle.now <= block.high - edge
        at_limit = bool(run.fault & BlockFault.LIMIT)
        run.fault = (
            fault
            | BlockFault.OUTSIDE * (not inside)
            | BlockFault.DISABLED * (not enabled)
            | BlockFault.LIMIT * (at_limit and run.state is not BlockState.OFF)
        )
        run.clock += run.state in (BlockState.HOLD, BlockState.RELEASE)
        wanted, before = inside and enabled, run.state
        clear = wanted and not fault and not at_limit
        if before is BlockState.ON:
            run.ramp = min(run.ramp + block.ramp, ONE)
            if fault or at_limit:
                run.state = BlockState.HOLD
            elif not wanted:
                run.state = BlockState.RELEASE
        elif (wanted and not fault) if before is BlockState.OFF else clear:
            run.state, run.ramp = BlockState.ON, 0
        elif before is BlockState.HOLD and (run.clock >= block.hold or not (fault or wanted)):
            run.state = BlockState.RELEASE
        elif before is BlockState.RELEASE and run.clock >= block.release:
            run.state = BlockState.OFF
            run.re, run.im = [0] * len(run.re), [0] * len(run.im)
        if run.state is not before:
            run.clock = 0


def _share(block: BlockWords, factor: int, bits: int, value: int) -> int:
    """factor value in the amplitude's format, of the amplitude's leading bits."""
    word = shifted(value, block.amplitude_bits - SIGNAL)
    return shifted(factor * word, bits + SIGNAL - block.amplitude_bits)


def _divided(value: int, count: int) -> int:
    """value / count toward zero, as C divides."""
    return value // count if value >= 0 else -(-value // count)
