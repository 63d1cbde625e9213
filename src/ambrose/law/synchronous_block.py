"""A synchronous block as it runs, sample by sample: angle from one pulse per turn, state machine,
amplitudes.

The generated C code does the same in the same order (its extension's block_code.py). Per sample:

1. angle: between pulses theta = W tau + W' tau^2/2, tau the time since the pulse, W and W' from the
   last two periods; a pulse sets it to zero. Without one for 1.5 turns the key phasor is lost;
2. cosine and sine of n theta, from a table of 256 and a remainder of third order (error below
   1e-9);
3. the state machine of every block (below);
4. c = Re(exp(j n theta) a) of all blocks together, added to the error that the base controller
   reads;
5. on: a += ramp eps Ts D(W) exp(-j n theta) s - leak Ts a, each amplitude projected onto its limit;
   of a block that moves once a turn, at the pulse and before 4, with the mean of exp(-j n theta) s
   over the turn and the turn's length in place of Ts (convergent control: Knospe et al.,
   Mechatronics 5 (1995) 385).

| state | what happens | left |
|---|---|---|
| OFF | a = 0 | to ON: speed within the band by the hysteresis, no fault |
| ON | eps ramps from 0 | to HOLD: a fault; to RELEASE: speed outside, switched off |
| HOLD | eps = 0, a is kept and goes on turning | to ON: fault gone; to RELEASE: after ``hold`` |
| RELEASE | a decays | to ON: as from OFF; to OFF: after 12 time constants |

A fault of the block never reaches the base controller: it gets its error plus c, and c is bounded
by the limits of the amplitudes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

import numpy as np

from ambrose.core.checks import check_positive, check_shape, invalid

SECTORS = 256  # of the table of sine and cosine
DECAY = 12  # time constants after which a released amplitude counts as zero
LOST_TURNS = 1.5  # without a pulse
JUMP = 0.1  # of the speed, beyond the fastest run-up, between two turns


class BlockState(IntEnum):
    """What a block does."""

    OFF = 0
    ON = 1
    HOLD = 2
    RELEASE = 3


class BlockFault(IntFlag):
    """Why a block is not on."""

    NONE = 0
    LOST = 1  # no pulse of the key phasor
    JUMP = 2  # a period that no run-up explains
    CONTACT = 4
    SATURATED = 8
    LIMIT = 16  # an amplitude at its limit
    OUTSIDE = 32  # the speed is outside the band
    DISABLED = 64
    INPUT = 128  # a reading that is not finite, or that the caller calls unusable


@dataclass(frozen=True, slots=True, eq=False)
class BlockLaw:
    """What a block computes with. speeds (s,) [rad/s]; drive D (s, n, m) complex, D[k] at
    speeds[k]; band [rad/s]; gain eps [1/s]; leak [1/s]; limit (n,) [m]; harmonic; hysteresis
    [rad/s]; hold, release, ramp [s].

    subtracts: whether it reads y - c, c of all blocks (else y); m = 2 n: it reads the currents [A]
    after the displacements; per_turn: it moves once a turn. Raises InvalidInput.
    """

    speeds: np.ndarray
    drive: np.ndarray
    band: tuple[float, float]
    gain: float
    limit: np.ndarray
    harmonic: int = 1
    leak: float = 0.0
    hysteresis: float = 5.0
    hold: float = 0.5
    release: float = 0.2
    ramp: float = 0.5
    subtracts: bool = True
    per_turn: bool = False

    def __post_init__(self) -> None:
        n = len(self.limit)
        check_shape(self.drive, "drive", "(s, n, m)", s=len(self.speeds), n=n)
        if self.drive.shape[2] not in (n, 2 * n):
            raise invalid(
                "the columns of drive",
                self.drive.shape[2],
                f"{n} or {2 * n}",
                "displacements, then currents",
            )
        check_positive(self.gain, "the block's gain", "give 2/time_constant")

    @property
    def reads_currents(self) -> bool:
        return self.drive.shape[2] != len(self.limit)


@dataclass(frozen=True, slots=True, eq=False)
class SynchronousLaw:
    """All blocks beside a controller. sample_time [s]; fastest [rad/s^2]: the fastest run-up of the
    machine.
    """

    blocks: tuple[BlockLaw, ...]
    sample_time: float
    fastest: float = 1e4

    @property
    def channels(self) -> int:
        return len(self.blocks[0].limit)


def circle() -> np.ndarray:
    """Cosine and sine (256, 2) at the sectors' middles."""
    angle = 2 * np.pi * np.arange(SECTORS) / SECTORS
    return np.column_stack([np.cos(angle), np.sin(angle)])


@dataclass(slots=True)
class Angle:
    """The angle of the rotor from one pulse per turn. dt [s]: of a sample; fastest [rad/s^2]: the
    fastest run-up.
    """

    dt: float
    fastest: float
    pulses: int = 0  # that came since the key phasor was lost, 3 at most; -1: lost in this turn
    tau: float = 0.0  # time since the last pulse [s]
    period: float = 0.0  # of the last turn [s]
    middle: float = 0.0  # speed in the middle of the last turn [rad/s]
    speed: float = 0.0  # W at the last pulse [rad/s]
    slope: float = 0.0  # W' [rad/s^2]
    now: float = 0.0  # W + W' tau [rad/s]
    theta: float = 0.0  # [rad], from 0 to 2 pi
    turned: bool = False  # a turn has ended in this sample, and its speed is known

    def follow(self, pulse: float) -> BlockFault:
        """One sample. pulse [s]: how long ago it came, within the last sample; negative: none. Sets
        theta and now.
        """
        fault = BlockFault.NONE
        self.tau += self.dt

        # a turn has ended: its mean speed is the speed in its middle
        came = 0 <= pulse < self.dt
        if came:
            period = self.tau - pulse
            self.tau = pulse
            if self.pulses > 0:
                middle = 2 * math.pi / period
                change = middle - self.middle
                if self.pulses > 1:
                    # W' between the middles of the last two turns
                    span = 0.5 * (period + self.period)
                    if abs(change) > self.fastest * span + JUMP * self.middle:
                        fault = BlockFault.JUMP
                        self.pulses = 0
                        self.slope = 0.0
                    else:
                        self.slope = min(max(change / span, -self.fastest), self.fastest)
                self.period, self.middle = period, middle
                # half a turn on, at the pulse
                self.speed = middle + 0.5 * self.slope * period
            self.pulses = min(self.pulses + 1, 3)

        # W + W' tau,   theta = W tau + W' tau^2/2
        self.now = self.speed + self.slope * self.tau
        turns = (self.speed * self.tau + 0.5 * self.slope * self.tau * self.tau) / (2 * math.pi)

        if self.pulses > 1 and self.tau * self.speed > LOST_TURNS * 2 * math.pi:
            # the last known speed, and no more of its slope
            self.slope = 0.0
            self.now = self.speed
            self.pulses = -1

        # a speed takes two pulses; the first one after a loss counts as the first
        if self.pulses < 2:
            fault |= BlockFault.LOST
            if came and self.pulses < 1:
                self.pulses = 1
        self.theta = 2 * math.pi * (turns - math.floor(turns))
        self.turned = came and not fault
        return fault


@dataclass(slots=True)
class _Running:
    """The state of one block."""

    state: BlockState = BlockState.OFF
    fault: BlockFault = BlockFault.NONE
    clock: int = 0  # samples in HOLD or RELEASE
    ramp: float = 0.0  # factor on eps, from 0 to 1
    a: np.ndarray = field(default_factory=lambda: np.zeros(0, complex))  # (n,) [m]
    # (m,) sum of exp(-j n theta) s since the last pulse, and its samples: of one per turn
    total: np.ndarray = field(default_factory=lambda: np.zeros(0, complex))
    count: int = 0


class SynchronousBlock:
    """All blocks of a law, running. ``step`` is one sample."""

    __slots__ = ("_circle", "_samples", "angle", "law", "running")

    def __init__(self, law: SynchronousLaw) -> None:
        self.law, self._circle = law, circle()
        dt = law.sample_time
        self._samples = [(round(b.hold / dt), round(DECAY * b.release / dt)) for b in law.blocks]
        self.begin()

    def begin(self) -> None:
        """At rest: no pulse yet, all off."""
        self.angle = Angle(self.law.sample_time, self.law.fastest)
        self.running = [
            _Running(
                a=np.zeros(self.law.channels, complex),
                total=np.zeros(block.drive.shape[2], complex),
            )
            for block in self.law.blocks
        ]

    def step(
        self,
        pulse: float,
        errors: np.ndarray,
        currents: np.ndarray | None = None,
        contact: bool = False,
        saturated: bool = False,
        enabled: bool = True,
        unusable: bool = False,
    ) -> np.ndarray:
        """c (n,) [m] of this sample, to be added to the errors [m]. pulse: as ``Angle.follow``;
        currents (n,) [A]: what the base controller gave a sample ago; contact, saturated: of the
        machine; enabled: the switch; unusable: whether the caller trusts no reading of the sample.
        """
        fault = self.angle.follow(pulse)
        fault |= BlockFault.CONTACT * contact | BlockFault.SATURATED * saturated
        readings = (errors,) if currents is None else (errors, currents)
        if unusable or not all(np.isfinite(values).all() for values in readings):
            fault |= BlockFault.INPUT
        # c = Re(sum e^{j n theta} a), of all blocks before any of them moves on
        total, turns = np.zeros(self.law.channels), []
        y = -np.asarray(errors, float)
        for block, run, samples in zip(self.law.blocks, self.running, self._samples, strict=True):
            cosine, sine = self.turn(block.harmonic)
            turns.append((cosine, sine))
            self._advance(block, run, samples, fault, enabled)
            self._end_of_turn(block, run)
            total += run.a.real * cosine - run.a.imag * sine

        for block, run, (cosine, sine) in zip(self.law.blocks, self.running, turns, strict=True):
            if run.state is BlockState.ON:
                s = y - total if block.subtracts else y
                if block.reads_currents:
                    s = np.concatenate([s, np.zeros(len(y)) if currents is None else currents])
                if block.per_turn:
                    run.total = run.total + s * complex(cosine, -sine)
                    run.count += 1
                else:
                    # a += ramp eps Ts D s e^{-j n theta} - leak Ts a
                    moved = (self._drive(block) @ s) * complex(cosine, -sine)
                    self._move(block, run, moved, self.law.sample_time)
            elif run.state is BlockState.RELEASE:
                run.a = run.a * (1 - self.law.sample_time / block.release)
        return total

    def _end_of_turn(self, block: BlockLaw, run: _Running) -> None:
        """Of a block that moves once a turn: a += ramp eps t D mean - leak t a, t the turn's
        length and mean that of exp(-j n theta) s over it.
        """
        if not block.per_turn:
            return
        if run.state is BlockState.ON and self.angle.turned and run.count > 0:
            moved = self._drive(block) @ (run.total / run.count)
            self._move(block, run, moved, run.count * self.law.sample_time)
        if run.state is not BlockState.ON or self.angle.turned:
            run.total = np.zeros_like(run.total)
            run.count = 0

    def _move(self, block: BlockLaw, run: _Running, moved: np.ndarray, time: float) -> None:
        """a += ramp eps time moved - leak time a, each amplitude back onto its limit, its phase
        kept.
        """
        run.a = run.a + (run.ramp * block.gain * time) * moved - (block.leak * time) * run.a
        size = np.abs(run.a)
        if (size > block.limit).any():
            run.a = np.where(
                size > block.limit, run.a * (block.limit / np.maximum(size, 1e-300)), run.a
            )
            run.fault |= BlockFault.LIMIT

    def turn(self, harmonic: int) -> tuple[float, float]:
        """Cosine and sine of n theta, from the table and a remainder of third order."""
        turns = harmonic * self.angle.theta * (SECTORS / (2 * math.pi))
        # sector's middle plus d, |d| <= pi/256:   cos d = 1 - d^2/2, sin d = d - d^3/6
        sector = math.floor(turns + 0.5)
        d = (turns - sector) * (2 * math.pi / SECTORS)
        cosine, sine = self._circle[sector % SECTORS]
        p, q = 1 - d * d / 2, d - d * d * d / 6
        return float(cosine * p - sine * q), float(sine * p + cosine * q)

    def _advance(
        self,
        block: BlockLaw,
        run: _Running,
        samples: tuple[int, int],
        fault: BlockFault,
        enabled: bool,
    ) -> None:
        """The state machine of one block; samples: at most in HOLD, and in RELEASE."""
        low, high = block.band
        edge = block.hysteresis if run.state is BlockState.OFF else 0.0
        inside = low + edge <= self.angle.now <= high - edge
        at_limit = bool(run.fault & BlockFault.LIMIT)
        run.fault = (
            fault
            | BlockFault.OUTSIDE * (not inside)
            | BlockFault.DISABLED * (not enabled)
            | BlockFault.LIMIT * (at_limit and run.state is not BlockState.OFF)
        )
        # counts in the states that end by it alone: no counter runs over
        run.clock += run.state in (BlockState.HOLD, BlockState.RELEASE)
        wanted = inside and enabled
        if run.state is BlockState.OFF:
            if wanted and not fault:
                run.state = BlockState.ON
                run.ramp = 0.0
                run.clock = 0
        elif run.state is BlockState.ON:
            run.ramp = min(run.ramp + self.law.sample_time / block.ramp, 1.0)
            if fault or at_limit:
                run.state, run.clock = BlockState.HOLD, 0
            elif not wanted:
                run.state, run.clock = BlockState.RELEASE, 0
        elif run.state is BlockState.HOLD:
            if not fault and not at_limit and wanted:
                run.state = BlockState.ON
                run.ramp = 0.0
                run.clock = 0
            elif run.clock >= samples[0] or (not fault and not wanted):
                run.state, run.clock = BlockState.RELEASE, 0
        elif wanted and not fault and not at_limit:
            run.state = BlockState.ON
            run.ramp = 0.0
            run.clock = 0
        elif run.clock >= samples[1]:
            run.state = BlockState.OFF
            run.a = np.zeros_like(run.a)
            run.clock = 0

    def _drive(self, block: BlockLaw) -> np.ndarray:
        """D (n, m) at the present speed, linear between the table's speeds and constant beyond."""
        speeds, now = block.speeds, self.angle.now
        if len(speeds) == 1:
            return np.asarray(block.drive[0])
        k = 0
        while k < len(speeds) - 2 and now >= speeds[k + 1]:
            k += 1
        share = min(max((now - speeds[k]) / (speeds[k + 1] - speeds[k]), 0.0), 1.0)
        return np.asarray(block.drive[k] + share * (block.drive[k + 1] - block.drive[k]))

    @property
    def states(self) -> tuple[BlockState, ...]:
        """The state of every block."""
        return tuple(run.state for run in self.running)

    @property
    def speed(self) -> float:
        """The speed as the angle's tracker has it [rad/s]."""
        return self.angle.now

    def amplitudes(self) -> np.ndarray:
        """a (blocks, n) complex [m]."""
        return np.array([run.a for run in self.running])


def key_phasor(
    times: Sequence[float], speeds: Sequence[float], dt: float, samples: int
) -> np.ndarray:
    """pulse (samples,) [s] as ``Angle.follow`` takes it, of a rotor whose speed is linear between
    (times, speeds).

    The angle is zero at time zero and a pulse comes whenever it is a whole number of turns (also at
    the start).
    """
    t = np.arange(samples) * dt
    knots = np.asarray(times, float)
    values = np.asarray(speeds, float)
    if len(knots) == 0:
        return np.full(samples, -1.0)
    # angle at the knots, then a quadratic in between
    total = np.concatenate([[0.0], np.cumsum(np.diff(knots) * (values[1:] + values[:-1]) / 2)])
    k = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 1)
    last = k >= len(knots) - 1
    nxt = np.minimum(k + 1, len(knots) - 1)
    slope = np.where(
        last, 0.0, (values[nxt] - values[k]) / np.where(last, 1.0, knots[nxt] - knots[k])
    )

    s = t - knots[k]
    angle = total[k] + values[k] * s + slope * s * s / 2
    speed = values[k] + slope * s

    # 1e-12: a pulse that falls on a sample belongs to it
    turns = np.floor(angle / (2 * np.pi) + 1e-12)
    new = np.concatenate([[True], turns[1:] > turns[:-1]])

    # how long ago the whole turn was: angle - 2 pi turns = W age - W' age^2/2
    left = np.maximum(angle - 2 * np.pi * turns, 0.0)
    age = np.where(speed > 0, left / np.maximum(speed, 1e-9), 0.0)

    # once more with the square of the first: the remainder is of third order
    age = np.where(speed > 0, (left + slope * age * age / 2) / np.maximum(speed, 1e-9), 0.0)
    return np.where(new, np.minimum(age, dt * (1 - 1e-9)), -1.0)
