"""What a unit is driven with where nothing was recorded: random samples that meet every branch."""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.supervised import SupervisedBlock
from ambrose.code.processor.unit import Unit
from ambrose.code.synchronous import RunUnit

SEED = 20240229  # any number; the run is the same everywhere
_CORNER = 0.02  # of the error's bandwidth: the share of a new value in every sample
# shares of the run in which something is wrong
_LIMITED = (0.2, 0.3)
_WILD = (0.4, 0.42)
_LOST = (0.45, 0.5)
_NONE = (0.55, 0.57)
_CONTACT = (0.6, 0.62)
_OFF = (0.7, 0.75)
_NO_PULSE = (0.8, 0.84)
_CONTACT_BIT, _OFF_BIT = 4, 64


def stimulus(unit: Unit, count: int, seed: int = SEED) -> np.ndarray:
    """Samples (count,) as ``Unit.given`` has them, the same for a seed everywhere.

    Coloured noise of a third of the limit; a stretch near it, in which currents are limited;
    readings beyond it, flagged as lost, and not a number; what the step is told passes through its
    range and beyond, is lost, jumps; pulses of a run-up, contact, and blocks switched off.
    """
    rng = np.random.default_rng(seed)
    base = unit.base
    m = len(base.inputs)
    share = np.arange(count) / count

    def within(window: tuple[float, float]) -> np.ndarray:
        return (share >= window[0]) & (share < window[1])

    # errors: first-order coloured noise, variance one
    noise = rng.normal(size=(count, m))
    wave = np.zeros(m)
    errors = np.zeros((count, m))
    for k in range(count):
        wave = (1 - _CORNER) * wave + np.sqrt(_CORNER * (2 - _CORNER)) * noise[k]
        errors[k] = wave / 3
    errors[within(_LIMITED)] = 0.97 * np.sign(errors[within(_LIMITED)])
    errors[within(_WILD), 0] = 2.5
    counted = unit.counts(errors * base.error_limit, unit.metre)
    if counted.dtype.kind == "f":
        counted[within(_NONE), -1] = np.nan
    valid = np.ones((count, m), np.uint8)
    valid[within(_LOST), -1] = 0
    rows = np.zeros(count, unit.given("="))
    rows["error"], rows["valid"] = counted, valid
    for name, values in {**_told(unit, share, rng), **_pulses(unit, count, share)}.items():
        rows[name] = values
    return rows


def _told(unit: Unit, share: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    base = unit.base
    if not isinstance(base, ScheduledBlock):
        return {}
    columns: dict[str, Any] = {}
    for i, (axis, one) in enumerate(zip(base.axes, base.along.each, strict=True)):
        low, high = float(axis[0]), float(axis[-1])
        # two passes through the range, from a twentieth below it to a twentieth above
        turns = np.abs((share * (2 + i) * 2) % 2 - 1)
        value = low + (high - low) * (1.1 * turns - 0.05)
        if isinstance(base, SupervisedBlock):
            value += 0.01 * base.watch.noise * rng.normal(size=len(share))
            value[int(0.35 * len(share))] += 0.5 * (high - low)
        value[(share > 0.88) & (share < 0.9)] = np.nan
        columns[one.name] = value
    if isinstance(base, SupervisedBlock):
        pressure = next(iter(columns.values()))
        columns["estimate"] = pressure + 0.1 * base.watch.band
        known = (share > 0.36) & (share < 0.7)
        columns["half_width"] = np.where(known, 0.2 * base.watch.band, -1.0)
    return columns


def _pulses(unit: Unit, count: int, share: np.ndarray) -> dict[str, Any]:
    if not isinstance(unit.law, RunUnit):
        return {}
    first, dt = unit.law.law.blocks[0], unit.base.sample_time
    low, high = first.band
    # a run-up within the first block's band, no faster than the blocks believe
    start = low + first.hysteresis + 0.1 * (high - low)
    slope = min(0.2 * unit.law.law.fastest, 0.5 * (high - low) / (count * dt))
    speed = start + slope * dt * np.arange(count)
    turned = np.cumsum(speed) * dt / (2 * np.pi)
    passed = turned % 1.0
    came = passed * 2 * np.pi / speed
    quiet = (share >= _NO_PULSE[0]) & (share < _NO_PULSE[1])
    fresh = (came < dt) & ~quiet
    pulses = np.where(fresh, came, -1.0)
    if np.dtype(unit.given("=")["pulse"]).kind == "i":
        # whole numbers: the limit is one sample, as an error's limit is one
        one = np.rint(unit.base.error_limit[0] / unit.metre[0])
        pulses = np.where(fresh, np.floor(came / dt * one), -1.0)
    contact = (share >= _CONTACT[0]) & (share < _CONTACT[1])
    off = (share >= _OFF[0]) & (share < _OFF[1])
    return {"pulse": pulses, "flags": _CONTACT_BIT * contact + _OFF_BIT * off}
