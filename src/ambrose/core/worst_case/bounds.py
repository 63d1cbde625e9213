"""What cannot happen in a box of real parameters: bounds by the structured singular value, at all
frequencies or on a grid.

The searches beside it (``crossing``, ``search``) give what does happen. Both sides are meant to be
reported together, and each is a start for the other: the frequency at which a bound is reached is
one at which to search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import AmbroseError, named_failure
from ambrose.core.lft import Block, ComplexBlock, FullBlock
from ambrose.core.mu.all_frequencies import least_level, proved_level
from ambrose.core.mu.structure import structure_of
from ambrose.core.worst_case.crossing import LARGEST_BOX
from ambrose.core.worst_case.loop import BoxLoop

# of a proof: they never take a result with them
FAILURES = (AmbroseError, ArithmeticError, np.linalg.LinAlgError)
COMPLEX_PART = 0.01  # of each parameter, in the proof of stability
_CLOSE = 0.99  # of the factor found, at which the proof begins
_ROOM = 3e-3  # of a level above the bound at one frequency; the nearer, the shorter the intervals
_LEAST_FACTOR = 0.05  # of the factor found, below which no proof is tried


@dataclass(frozen=True, slots=True, eq=False)
class Proved:
    """A bound proved at all frequencies: value, the frequency [rad/s] that decides it (NaN: none),
    and why there is none (else empty; value is then 0 for a margin, infinite for a gain).
    """

    value: float
    frequency: float = float("nan")
    why: str = ""


def proved_margin(loop: BoxLoop, most: float) -> Proved:
    """A factor by which the box may grow with stability proved for every point of it; 0 when
    nothing could be proved.

    Near ``most`` (see ``box_margin``) where the proof is that sharp. With real parameters alone mu
    is discontinuous and its scalings grow without bound; each parameter is therefore allowed to be
    complex by 1 % of its size besides, which makes the proof a little stronger than needed.
    """
    n, e = len(loop.owner), COMPLEX_PART

    # w + w_c = (delta + e delta_c) z: M11 with outputs (z, e z) and inputs w, w_c that add
    left, right = np.eye(n, loop.system.D.shape[0]), np.eye(loop.system.D.shape[1], n)
    both = loop.model.between(np.vstack([left, e * left]), np.hstack([right, right]))
    blocks: list[Block] = [
        *loop.blocks,
        *(ComplexBlock(f"{block.name} complex", block.repeat) for block in loop.blocks),
    ]

    # mu < level proves the box up to the factor 1 / level
    start = 1 / (_CLOSE * min(most, LARGEST_BOX))
    try:
        proved = proved_level(both, blocks, start, room=_ROOM, highest=start / _LEAST_FACTOR)
    except FAILURES as error:
        return Proved(0.0, why=str(error))
    return Proved(1 / proved.level, proved.frequency)


def proved_gain(loop: BoxLoop, start: float, omega: np.ndarray | None = None) -> Proved:
    """An upper bound of the gain over the whole box and all frequencies; infinite when nothing
    could be proved.

    The smallest gamma found >= ``start`` (a gain known from below) with mu(diag(I, I/gamma) M) < 1
    at every frequency, mu with the parameters' real blocks and one full block (skewed structured
    singular value; Fan & Tits 1992). omega (w,) [rad/s]: frequencies at which the gain comes near
    its worst.
    """
    blocks, skew = _with_gain(loop)
    try:
        proved = proved_level(
            loop.model, blocks, start * (1 + _ROOM), skew=skew, room=_ROOM, omega=omega
        )
    except FAILURES as error:
        return Proved(float("inf"), why=str(error))
    return Proved(proved.level, proved.frequency)


@named_failure("the bound of the gain in the box")
def gain_bound(loop: BoxLoop, omega: np.ndarray, start: float) -> float:
    """An upper bound of the largest gain over the box at the frequencies omega (w,) [rad/s], and
    nowhere between.

    As ``proved_gain``, frequency by frequency. Infinite when 100 times ``start`` does not suffice:
    the bound then cannot exclude instability in the box.
    """
    blocks, skew = _with_gain(loop)
    return least_level(loop.at(omega), structure_of(blocks), skew, start, 2e-3)[0]


def _with_gain(loop: BoxLoop) -> tuple[list[Block], np.ndarray]:
    """The blocks with a full one for the gain, and the rows that it owns."""
    n, (rows, columns) = len(loop.owner), loop.system.D.shape
    return [*loop.blocks, FullBlock("gain", columns - n, rows - n)], np.arange(rows) >= n
