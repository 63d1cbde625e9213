"""T of a synchronous block over speed, on the machine's axes, however its table is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import invalid
from ambrose.law.pid import modes
from ambrose.law.synchronous import SynchronousLoop, conditions
from ambrose.law.synchronous_block import BlockLaw, SynchronousLaw
from ambrose.machine.machine import Machine
from ambrose.machine.messages import listed
from ambrose.machine.synchronous import Synchronous
from ambrose.machine.validation.synchronous import synchronous_problems


@dataclass(frozen=True, slots=True, eq=False)
class BlockTable:
    """T (s, n, n), or D (s, n, m), complex at speeds (s,) [rad/s], linear between and constant
    beyond.
    """

    speeds: np.ndarray
    T: np.ndarray

    def at(self, speed: float) -> np.ndarray:
        """T at a speed [rad/s]."""
        if len(self.speeds) == 1:
            return np.asarray(self.T[0])
        speed = min(max(speed, float(self.speeds[0])), float(self.speeds[-1]))
        k = min(int(np.searchsorted(self.speeds, speed, side="right")) - 1, len(self.speeds) - 2)
        share = (speed - self.speeds[k]) / (self.speeds[k + 1] - self.speeds[k])
        return np.asarray((1 - share) * self.T[k] + share * self.T[k + 1])


def block_table(block: Synchronous, machine: Machine) -> BlockTable:
    """The table of a block on the machine's axes. Raises InvalidInput for a T that does not fit the
    machine.
    """
    check_blocks((block,), machine)
    speeds, T = block.table(len(machine.axes))
    if block.coordinates == "tilt-translate" and block.real is not None:
        # channels = into y, c = into^-1 T (into y)
        into = modes(machine)[0]
        T = np.linalg.inv(into) @ T @ into
    return BlockTable(speeds, T)


def running_table(table: BlockTable, loop: SynchronousLoop, mode: str) -> BlockTable:
    """D = T Z (s, n, m) at a table's speeds: what runs is linear between them, and not T Z."""
    at = conditions(loop.machine)[0]
    weighed = [
        T @ loop.weights(mode, float(w), at) for w, T in zip(table.speeds, table.T, strict=True)
    ]
    return BlockTable(table.speeds, np.array(weighed))


def check_blocks(blocks: Sequence[Synchronous], machine: Machine) -> None:
    """Raises InvalidInput for blocks that do not fit the machine's axes, cover their bands or
    exclude each other.
    """
    lines = tuple(
        synchronous_problems(
            tuple(blocks), len(machine.axes), len(machine.bearings), "synchronous block"
        )
    )
    if lines:
        raise invalid(
            "the synchronous blocks",
            listed("", lines).lstrip(": "),
            "blocks for this machine",
            "correct them",
        )


def block_of(
    mode: str,
    band: tuple[float, float],
    time_constant: float,
    table: BlockTable,
    **more: float | str | None,
) -> Synchronous:
    """A block with the part of a table that covers its band; more: further fields of
    ``Synchronous``.
    """
    low, high = band
    inside = [float(w) for w in table.speeds if low < w < high]
    speeds = (low, *inside, high)
    T = np.array([table.at(w) for w in speeds])
    return Synchronous(
        mode=mode,
        band=(float(low), float(high)),
        time_constant=float(time_constant),
        speeds=speeds,
        real=_nested(T.real),
        imaginary=_nested(T.imag),
        **more,  # type: ignore[arg-type]
    )


def _nested(values: np.ndarray) -> tuple[tuple[tuple[float, ...], ...], ...]:
    return tuple(tuple(tuple(float(x) + 0.0 for x in row) for row in matrix) for matrix in values)


def running_law(
    blocks: Sequence[Synchronous], loop: SynchronousLoop, fastest: float = 1e4
) -> SynchronousLaw:
    """The blocks as they run beside the loop's controller, D = T Z over speed at the design point's
    pressure.

    fastest [rad/s^2]: the fastest run-up. Raises InvalidInput for blocks that do not fit the
    machine.
    """
    machine = loop.machine
    check_blocks(blocks, machine)
    gaps = [bearing.touchdown_gap or bearing.gap for bearing in machine.bearings]
    usual = 0.25 * min((gap for gap in gaps if gap), default=4e-4)
    laws = []
    for block in blocks:
        at = replace(loop, harmonic=block.harmonic)
        table = running_table(block_table(block, machine), at, block.mode)
        laws.append(
            BlockLaw(
                table.speeds,
                table.T,
                block.band,
                block.gain,
                np.full(len(machine.axes), block.limit or usual),
                block.harmonic,
                block.leak,
                block.hysteresis,
                block.hold,
                block.release,
                block.time_constant,
                block.mode == "current-free",
                block.update == "turn",
            )
        )
    return SynchronousLaw(tuple(laws), loop.timing.sample_time, fastest)
