"""A synchronous block that damps: through a resonance in which no signal may be driven to zero.

The block reads y, c = D y once it has settled, D = g T with T(W) = R(W)^-1 and R from c to -y:

    y = y_0 - R c    =>    (I + g R T) y = y_0,    y = y_0/(1 + g)                          (1)

Near a critical speed P^-1 is c_d j W there (stiffness and inertia cancel), so that the force which
(1) adds opposes the velocity: it raises the damping of the mode by g. Far from it the same D pushes
against stiffness or inertia, which costs current; hence the band stays narrow, and g as small as
the orbit's limit allows. The leak of the amplitude sets g = eps/(2 leak): it is convergent control
with leakage (Knospe et al., Mechatronics 5 (1995) 385).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.judge.synchronous_bands import (
    converged_at,
    forbidden_bands,
    unbalance_of,
    worst_signal,
)
from ambrose.law.synchronous import Condition, SynchronousLoop
from ambrose.law.synchronous_table import BlockTable, block_of
from ambrose.machine.synchronous import Synchronous
from ambrose.synthesis.synchronous_gain import (
    SHARE,
    TURNS,
    gain_limit,
    sensitive_gain,
    within_sensitivity,
)
from ambrose.synthesis.synchronous_inverse import usable_tables

MODE = "damping"
_SHARES = 0.25 * np.sqrt(2.0) ** np.arange(13)  # g that are tried, 0.25 to 16
_CURRENT = 0.5  # of the smallest limit of a coil's current, for the 1x current
_POINTS = 9  # of a band, at which the current is looked at


def damping_blocks(
    loop: SynchronousLoop,
    band: tuple[float, float],
    at: Sequence[Condition],
    corners: Sequence[Condition],
    clear: float,
    time_constant: float | None = None,
    update: str = "sample",
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[tuple[Synchronous, ...], float]:
    """Blocks of mode "damping" that keep the orbit within ``clear`` of its limit all over the band
    [rad/s], at the conditions ``at`` and the corners of their tolerances; and g [-], by which they
    divide 1x, less one.

    time_constant [s]: 2/eps; None: as short as poles and sensitivity allow. update: "sample" or
    "turn". Raises InvalidInput
    where no g up to 16 keeps the orbit within its limit and the current within half of the coils',
    or where no T converges, poles or sensitivity are lost.
    """
    progress(f"damping from {band[0]:.4g} to {band[1]:.4g} rad/s")
    tables: list[tuple[tuple[float, float], BlockTable]] = []
    for where, table, refused in usable_tables(loop, MODE, band, at):
        if refused is not None:
            raise InvalidInput(f"damping is not possible there: {refused}")
        tables.append((where, table))

    g = _least_share(loop, tables, at, corners, clear)

    # leak = eps/(2 g):   c = eps/(2 leak) T y = g T y
    leak_per_gain = 1 / (2 * g)
    kept, lost = within_sensitivity(loop, MODE, tables, at, leak_per_gain)
    if lost:
        raise InvalidInput(f"damping is not possible there: {lost[0]}")
    limit = min(gain_limit(loop, MODE, where, table, at, update) for where, table in kept)
    gain = min(SHARE * limit, TURNS * band[0])
    if time_constant is not None:
        gain = min(gain, 2 / time_constant)
    gain, _ = sensitive_gain(loop, MODE, kept, at, gain, leak_per_gain)
    blocks = tuple(
        block_of(MODE, where, 2 / gain, table, leak=gain * leak_per_gain, update=update)
        for where, table in kept
    )
    return blocks, g


def _least_share(
    loop: SynchronousLoop,
    tables: Sequence[tuple[tuple[float, float], BlockTable]],
    at: Sequence[Condition],
    corners: Sequence[Condition],
    clear: float,
) -> float:
    """The smallest g of ``_SHARES`` that keeps orbit and current. Raises InvalidInput."""
    available = _available_current(loop)
    why = "no g was tried"
    for g in _SHARES:
        trial = float(g)
        why = ""
        for where, table in tables:

            def drive(speed: float, table: BlockTable = table, trial: float = trial) -> np.ndarray:
                return trial * table.at(speed)

            broken = forbidden_bands(loop, MODE, where, (*at, *corners), drive, share=clear)
            if broken:
                why = str(broken[0])
                break
            current = _largest_current(loop, where, at, drive)
            if current > available:
                # more g takes more current
                raise InvalidInput(
                    f"damping by {trial:.3g} takes {current:.3g} A at 1x, more than half of a "
                    f"coil's limit, {available:.3g} A; balance the rotor better"
                )
        if not why:
            return trial
    raise InvalidInput(f"damping by up to {_SHARES[-1]:.3g} does not keep the orbit: {why}")


def _available_current(loop: SynchronousLoop) -> float:
    """What 1x may take of a coil's current [A]; inf where no limit is known."""
    limits = [b.max_current for b in loop.machine.bearings if b.max_current is not None]
    return _CURRENT * min(limits, default=np.inf)


def _largest_current(
    loop: SynchronousLoop,
    band: tuple[float, float],
    at: Sequence[Condition],
    drive: Callable[[float], np.ndarray],
) -> float:
    """The largest 1x control current [A] over a band under the residual unbalance."""
    residual = unbalance_of(loop.machine)
    return max(
        worst_signal(
            converged_at(loop, MODE, float(w), condition, drive).u, float(residual.force(w))
        )
        for condition in at
        for w in np.linspace(*band, _POINTS)
    )
