"""The least log decrement of each mode over the tolerances, found by a search: every tolerance at
both its ends, then the corner to which all of them pull together.

A search finds a member, it proves nothing about the others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.result import ModeRow
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.model.uncertainty import perturbed


def least_decrements(loop: ShaftLoop, table: tuple[ModeRow, ...]) -> tuple[ModeRow, ...]:
    """The rows with the least log decrement found and the member that has it."""
    names = [tolerance.parameter for tolerance in loop.plant.machine.tolerances]
    members = [{name: side} for name in names for side in (-1.0, 1.0)]
    found = [dict[str, float]() for _ in table]
    best = [(row.mode.log_decrement, "nominal") for row in table]
    slopes = np.zeros((len(table), len(names)))
    for k, member in enumerate(members):
        moved = _moved(loop, member)
        if moved is None:
            continue
        for j, row in enumerate(table):
            value = _decrement(moved, row)
            if value is None:
                continue
            (name,) = member
            slopes[j, k // 2] += value * member[name]
            if value < best[j][0]:
                best[j] = (value, f"{name} {member[name]:+g}")
    for j, row in enumerate(table):
        corner = {
            name: float(-np.sign(slope))
            for name, slope in zip(names, slopes[j], strict=True)
            if slope
        }
        found[j] = corner
        moved = _moved(loop, corner) if corner else None
        value = None if moved is None else _decrement(moved, row)
        if value is not None and value < best[j][0]:
            words = ", ".join(f"{name} {side:+g}" for name, side in corner.items())
            best[j] = (value, words)
    return tuple(
        replace(row, least=float(value), member=words)
        for row, (value, words) in zip(table, best, strict=True)
    )


def _moved(loop: ShaftLoop, member: dict[str, float]) -> ShaftLoop | None:
    """The loop with parameters moved within their tolerances; None where one does not hold around
    this point.
    """
    try:
        plant = perturbed(loop.plant, member)
    except InvalidInput:
        return None
    system = plant.system
    if system.n_states != len(loop.A):
        return None
    u = [system.inputs.index(name) for name in plant.named("u")]
    y = [system.outputs.index(name) for name in plant.named("y")]
    return replace(loop, plant=plant, A=system.A, B=system.B[:, u], C=system.C[y])


def _decrement(loop: ShaftLoop, row: ModeRow) -> float | None:
    try:
        pole, _ = loop.mode_near(row.mode.pole, row.mode.states)
    except NumericalFailure:
        return None
    if not pole.imag:
        return None
    return float(-2 * np.pi * pole.real / abs(pole.imag))
