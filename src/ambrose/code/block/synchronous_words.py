"""Synchronous blocks in whole numbers: Q formats in which no sum overflows, and what rounding does.

Every signal is a part of its limit (errors, c and amplitudes of the channel's error limit, currents
of their limit), a word of 2^30 for one; a controller with words of 16 bits has its signals shifted
in and out. A turn is 2^32, so that angles wrap as unsigned numbers do. Times are counted in
2^-time_bits of a sample, speeds in 2^-40 of a turn a sample. With Q the bits behind the point:

    theta = (2 W + W' tau) tau/2       modulo a turn            W Q40, tau Q time_bits, W' Q slope
    D(W) = D_k + share (D_{k+1} - D_k)                          share Q30, D Q drive_bits
    x = exp(-j n theta) D s                                     s Q30 (twice its limit), x Q(30-h)
    a += ramp eps Ts x - leak Ts a                              a Q amplitude_bits in 64 bits

The stored amplitude has the bits below the signal's resolution, so that an increment eps Ts T e is
not lost (no dead zone). Cosine and sine come from the table of 256 sectors and a remainder d of
third order:

    |error| <= d^4/24 + d^5/120 + rounding of table, remainder and product,   d = pi/256
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import check_shape, invalid
from ambrose.law.synchronous_block import (
    DECAY,
    LOST_TURNS,
    SECTORS,
    BlockLaw,
    SynchronousLaw,
    circle,
)

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
