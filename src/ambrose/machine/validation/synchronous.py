"""What a [[controller.synchronous]] must fulfil; what needs the plant is refused by
verification.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from ambrose.machine.description import MachineDescription
from ambrose.machine.messages import complaint, shown
from ambrose.machine.synchronous import (
    SYNCHRONOUS_COORDINATES,
    SYNCHRONOUS_MODES,
    SYNCHRONOUS_UPDATES,
    Synchronous,
)
from ambrose.machine.validation.signs import not_positive

_HARMONICS = 8  # of the turning; the speed's multiples that a block may follow


def synchronous(machine: MachineDescription) -> Iterator[str]:
    """Every block of [controller], and whether two blocks of one harmonic are on at once."""
    blocks = () if machine.controller is None else machine.controller.synchronous
    yield from synchronous_problems(
        blocks, len(machine.axes), len(machine.bearings), "[[controller.synchronous]]"
    )


def synchronous_problems(
    blocks: tuple[Synchronous, ...], axes: int, bearings: int, where: str
) -> Iterator[str]:
    """What is wrong with blocks for so many axes and bearings; ``where``: the name of their
    table.
    """
    for i, block in enumerate(blocks):
        inside = f"{where} {i + 1}"
        yield from not_positive(inside, block, "2/eps, in seconds", "time_constant")
        yield from not_positive(inside, block, "leave it out for the default", "limit", "release")
        yield from not_positive(
            inside, block, "zero switches it off", "hysteresis", "hold", "leak", zero=True
        )
        if block.mode not in SYNCHRONOUS_MODES:
            yield complaint(
                inside,
                "mode",
                shown(block.mode),
                f"one of {', '.join(SYNCHRONOUS_MODES)}",
                "choose one of them",
            )
        if block.update not in SYNCHRONOUS_UPDATES:
            known = f"one of {', '.join(SYNCHRONOUS_UPDATES)}"
            yield complaint(inside, "update", shown(block.update), known, "choose one of them")
        if block.coordinates not in SYNCHRONOUS_COORDINATES:
            known = f"one of {', '.join(SYNCHRONOUS_COORDINATES)}"
            yield complaint(
                inside, "coordinates", shown(block.coordinates), known, "choose one of them"
            )
        if block.coordinates == "tilt-translate" and bearings != 2:
            yield complaint(
                inside, "coordinates", '"tilt-translate"', '"axes"', "it needs two bearings"
            )
        if not 1 <= block.harmonic <= _HARMONICS:
            yield complaint(
                inside, "harmonic", block.harmonic, f"from 1 to {_HARMONICS}", "1 is the unbalance"
            )
        low, high = block.band
        if not 0 < low < high:
            yield complaint(
                inside,
                "band",
                f"[{low:g}, {high:g}] rad/s",
                "ascending, above 0",
                "swap or widen it",
            )
        elif not block.hysteresis < (high - low) / 2:
            yield complaint(
                inside,
                "hysteresis",
                f"{block.hysteresis:g} rad/s",
                "below half of the band's width",
                "narrow it",
            )
        if block.mode == "damping" and not block.leak:
            yield complaint(
                inside,
                "leak",
                "zero",
                'positive with mode "damping"',
                "it sets how fast it follows",
            )
        yield from _table_problems(inside, block, axes)
    for i, one in enumerate(blocks):
        for j in range(i):
            other = blocks[j]
            if (
                one.harmonic == other.harmonic
                and one.band[0] < other.band[1]
                and other.band[0] < one.band[1]
            ):
                yield (
                    f"{where} {i + 1}: its band overlaps that of entry {j + 1} at the same "
                    "harmonic; part them"
                )


def _table_problems(where: str, block: Synchronous, axes: int) -> Iterator[str]:
    speeds = block.speeds
    low, high = block.band
    if speeds is None:
        if (
            block.real is not None
            or block.imaginary is not None
            or (block.phase and len(block.phase) != 1)
        ):
            yield f"{where}: speeds are missing for its table; give the speed of every entry"
        return
    if any(b <= a for a, b in itertools.pairwise(speeds)):
        yield complaint(where, "speeds", "not ascending", "ascending", "sort them")
        return
    slack = 1e-9 * high
    if speeds[0] > low + slack or speeds[-1] < high - slack:
        covers = f"{speeds[0]:g} to {speeds[-1]:g} rad/s"
        remedy = "narrow the band, or extend the table"
        yield complaint(
            where,
            "speeds",
            covers,
            f"a range that covers the band of {low:g} to {high:g} rad/s",
            remedy,
        )
    if block.phase is not None:
        if block.real is not None or block.imaginary is not None:
            yield f"{where}: phase and matrices are both given; keep one of the two"
        if len(block.phase) != len(speeds):
            yield complaint(
                where,
                "phase",
                f"a list of {len(block.phase)}",
                f"one per speed, {len(speeds)}",
                "add or drop some",
            )
        return
    if block.real is None:
        yield f"{where}: real is missing for its speeds; give T's real part, or the phase alone"
        return
    for key in ("real", "imaginary"):
        value = getattr(block, key)
        if value is None:
            continue
        try:
            shape = np.array(value, float).shape
        except ValueError:
            shape = ()
        if shape != (len(speeds), axes, axes):
            size = " x ".join(map(str, shape)) if shape else "ragged"
            wanted = f"{len(speeds)} x {axes} x {axes} (speeds, rows, columns)"
            yield complaint(
                where, key, size, wanted, "one matrix per speed, a row and a column per axis"
            )
