"""A schedule over pressure with a fixed controller to fall back to, as one block: both laws in
every sample, one in charge.

    u_i = C_i x_i + D_i e                       what either asks for
    us  = limited(u_charge + share left)        what acts; ``left`` of the difference at the last
                                                change fades with ``share``
    x_i += increment_i x_i + B_i e + L_i cut    cut = us - u_i of the one that waits,
                                                limited(us - share left) - u_i of the one in charge:
                                                zero within the limits

L is the anti-windup gain of either block: to wait is to have what one asks for replaced by what
acts. Therefore the bounds on the states of block/fixed.py and block/scheduled.py hold, whoever is
in charge: what replaces u never leaves the limits. Who is in charge, and why: law/supervision.py,
which is also the block's twin in Python (``supervised_twin``).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from ambrose.code.block.fixed import ControlBlock
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.core.checks import invalid
from ambrose.law.supervision import Limits, Matrices, SupervisedLaws, SupervisedProgram


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SupervisedBlock(ScheduledBlock):
    """What runs: a scheduled block, the fixed one that takes over, and what a reading has to keep
    to.
    """

    fallback: ControlBlock
    watch: Limits

    @property
    def transfers(self) -> bool:
        return self.passes > 0 and self.fallback.transfers

    def single(self) -> Self:
        """The block with limits and grid that single precision holds. Raises InvalidInput where
        grid points fall together.
        """
        return replace(
            ScheduledBlock.single(self), fallback=self.fallback.single(), watch=_single(self.watch)
        )

    def samples(self, duration: float) -> int | None:
        """The least number of samples that last so long [s]; None where that is for ever."""
        if not np.isfinite(duration):
            return None

        # counted up by the product itself: the rounded quotient may be one off
        count = max(0, round(duration / self.sample_time) - 2)
        while count * self.sample_time < duration:
            count += 1
        return count


def supervise(block: ScheduledBlock, fallback: ControlBlock, watch: Limits) -> SupervisedBlock:
    """One block of two with the same signals, rate and delay. Raises InvalidInput."""
    for what, own, other in (
        ("inputs", ", ".join(block.inputs), ", ".join(fallback.inputs)),
        ("outputs", ", ".join(block.outputs), ", ".join(fallback.outputs)),
        ("sample time", f"{block.sample_time:g} s", f"{fallback.sample_time:g} s"),
        ("delay", f"{block.delay} samples", f"{fallback.delay} samples"),
    ):
        if own != other:
            raise invalid(
                f"the {what} of the fallback",
                other,
                f"the schedule's, {own}",
                "make both for one machine and loop",
            )
    if np.isfinite(block.rate_limits).any():
        raise invalid(
            "rate_limit of a supervised block",
            block.rate_limit,
            "left out",
            "its readings have a rate of their own",
        )
    parts = {item.name: getattr(block, item.name) for item in fields(ScheduledBlock)}
    return SupervisedBlock(**parts, fallback=fallback, watch=watch)


def supervised_twin(block: SupervisedBlock, kind: Any = np.float64) -> SupervisedProgram:
    """The block as a program in Python: what the code is compared with. kind: of its numbers.
    Raises NumericalFailure.
    """
    fixed, axes = block.fallback, tuple(name.removeprefix("err_") for name in block.inputs)
    points = zip(block.increment, block.B, block.C, block.D, block.unwind, strict=True)
    pair = SupervisedLaws(
        block.grid,
        tuple(_law(point, kind) for point in points),
        _law((fixed.increment, fixed.B, fixed.C, fixed.D, fixed.unwind), kind),
        (
            fixed.from_error.astype(kind) * block.transfers,
            fixed.from_output.astype(kind) * block.transfers,
        ),
        block.current_limit.astype(kind),
        axes,
        block.sample_time,
        block.delay,
        True,
    )
    return SupervisedProgram(pair, block.watch)


def _law(matrices: tuple[np.ndarray, ...], kind: Any) -> Matrices:
    return tuple(x.astype(kind) for x in matrices)


def _single(limits: Limits) -> Limits:
    times = {"dwell", "fade", "stuck"}  # counted in samples
    values = {
        item.name: getattr(limits, item.name) for item in fields(Limits) if item.name not in times
    }
    return replace(limits, **{name: float(np.float32(value)) for name, value in values.items()})
