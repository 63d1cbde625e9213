"""The machine with its synchronous blocks on: the unbalance response with each block converged, and
what ``ambrose verify`` says of the block.

The block adds c to the error, u = -K (y - c), and once it has converged c = D z, or z = 0 where it
does not leak (law/synchronous.py). With the states under the forces and c, both linear,

    x = T(s)^-1 (f + B (I + K D_p)^-1 K c),    z = z_f + Z c,
    c = -Z^-1 z_f,    of a block that leaks    c = (I - D Z)^-1 D z_f.

A block at another multiple of the speed leaves the response to unbalance as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ambrose.annexes.rotordynamics import items as rows
from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.capacity import binding, unbalance_demands, unbalance_limits
from ambrose.annexes.rotordynamics.clearances import largest_reading, rubs
from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.response import Response, Solve, respond
from ambrose.annexes.rotordynamics.result import OWN, Item
from ambrose.core.checks import InvalidInput
from ambrose.judge.capacity import together
from ambrose.judge.synchronous import VANISHED, BlockLoop, block_loops, check_block
from ambrose.law.law import Law
from ambrose.law.synchronous import at_bearings
from ambrose.machine.machine import Machine
from ambrose.model.static_load import magnet_coefficients


def with_blocks(
    machine: Machine,
    law: Law,
    sampled: tuple[float | None, int | None],
    off: Response,
    loop_at: Callable[[float], ShaftLoop],
    speeds: tuple[float, float, float],
    scale: float,
    through: Sequence[float],
    progress: Callable[[str], None],
) -> Iterator[Item]:
    """Rows of every block of the controller's file, else of the machine's, on; none without one.

    sampled: rate [Hz] and delay [samples] as stated; off: the response without blocks; speeds
    [rad/s]: running range and trip; scale: of the clearances; through: see ``respond``.
    """
    settings = machine.controller
    blocks = law.synchronous or (() if settings is None else settings.synchronous)
    if not blocks:
        return
    try:
        items = block_loops(machine, law, blocks, *sampled)
    except InvalidInput as error:
        yield _undone("synchronous", f"synchronous blocks: {error}")
        return
    for k, item in enumerate(items, 1):
        name = f"synchronous.{k}"
        words = f", {item.label} on"
        progress(f"unbalance response with the {item.label}")
        found = [*_unbalance(item, off, loop_at, speeds, scale, through, words)]
        try:
            found += _judged(item, words, progress)
        except InvalidInput as error:
            found.append(_undone("stability", f"{item.label}: {error}"))
        yield from (replace(row, name=f"{name}.{row.name}") for row in found)


def _undone(name: str, why: str) -> Item:
    return Item(
        name,
        "Machine with its synchronous blocks on",
        "Ambrose",
        "synchronous block",
        OWN,
        None,
        "-",
        passed=False,
        note=f"not judged, {why}",
    )


def _judged(item: BlockLoop, words: str, progress: Callable[[str], None]) -> Iterator[Item]:
    """What verify says of the block: convergence, gain, sensitivity with it on."""
    checks = check_block(item, progress)
    if not checks.stable:
        yield _undone("stability", f"{item.label}: {' '.join(checks.notes)}")
    for check in checks.checks:
        yield Item(
            check.name.removeprefix("synchronous."),
            f"{check.title}{words}",
            "Ambrose",
            "synchronous block, as ambrose verify judges it",
            OWN,
            check.value,
            check.unit,
            check.relation or "<=",
            check.limit,
            check.passed,
            check.detail,
        )


def _unbalance(
    item: BlockLoop,
    off: Response,
    loop_at: Callable[[float], ShaftLoop],
    speeds: tuple[float, float, float],
    scale: float,
    through: Sequence[float],
    words: str,
) -> Iterator[Item]:
    """Critical speeds, vibration, clearances and capacity within the block's band."""
    lowest, highest, trip = speeds
    low = max(item.block.band[0], float(off.speeds[0]))
    high = min(item.block.band[1], float(off.speeds[-1]))
    if item.loop.harmonic != 1 or low >= high:
        return
    response = respond(
        off.layout, loop_at, off.cases, low, high, through=(*through, trip), solve=_solve(item)
    )
    yield from rows.criticals_of(response, lowest, highest, words)
    if low <= highest and high >= lowest:
        ends = max(low, lowest), min(high, highest)
        reading = largest_reading(response, *ends)
        yield rows.vibration(reading, *ends, words, highest)
    if low < trip:
        below = response.upto(trip)
        yield from rows.clearances(rubs(below, scale), words)
        yield _capacity(loop_at(highest), below, words)


def _capacity(loop: ShaftLoop, response: Response, words: str) -> Item:
    """The least margin of unbalance of all axes."""
    axes = loop.plant.machine.axes
    worst, axis = min(
        (
            (together(limits, demand, ())[0], axes[a])
            for a, limits in enumerate(unbalance_limits(loop))
            for demand in unbalance_demands(loop, response, a, "at the end of the band")
        ),
        key=lambda row: row[0].value,
    )
    asked = worst.value < np.inf
    return Item(
        "capacity.unbalance",
        f"Load capacity divided by the demand of unbalance{words}",
        standard.EDITION,
        "annex E, load capacity",
        OWN,
        worst.value if asked else None,
        "-",
        ">=",
        1.0 if asked else None,
        worst.value >= 1.0,
        f"axis {axis}: {binding(worst)}" if asked else "the block leaves no current to carry",
    )


def _solve(item: BlockLoop) -> Solve:
    """States and currents with the block converged."""

    def solve(loop: ShaftLoop, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s = 1j * loop.point.speed
        K = loop.gain(s)
        inner = np.linalg.solve(np.eye(len(K)) + K @ loop.D, K)
        x_f = loop.states(s, forces)
        x_c = np.linalg.solve(loop.matrix(s), loop.B @ inner)
        # u = -(I + K D)^-1 K (C x - c),   y = C x + D u,   i
        u_f, u_c = -inner @ loop.C @ x_f, -inner @ (loop.C @ x_c - np.eye(len(K)))
        i_f, i_c = loop.coil(x_f, u_f), loop.coil(x_c, u_c)
        z_f, Z = loop.C @ x_f + loop.D @ u_f, loop.C @ x_c + loop.D @ u_c
        if item.mode == "current-free":
            Z = Z - np.eye(len(K))
        elif item.mode == "force-free":
            machine = loop.plant.machine
            k_i, k_s = magnet_coefficients(machine, loop.point)
            z_f, Z = (
                at_bearings(machine) @ y + (k_i / k_s)[:, None] * i
                for y, i in ((z_f, i_f), (Z, i_c))
            )
        if item.gain is None:
            c = np.linalg.solve(Z, -z_f)
        else:
            D = item.gain(loop.point.speed)
            c = np.linalg.solve(np.eye(len(D)) - D @ Z, D @ z_f)
        i = i_f + i_c @ c
        return x_f + x_c @ c, np.where(np.abs(i) <= VANISHED * np.abs(i_f), 0.0, i)

    return solve
