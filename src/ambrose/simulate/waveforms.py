"""A scenario's disturbances as cubics between the samples: exact for pulses, to (w dt)^4/384 for sines and unbalance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.response import hermite
from ambrose.core.statespace import index_of
from ambrose.simulate.scenario import Pulse, Scenario, Sine, Unbalance

FASTEST = 0.32  # largest (w dt) of a sine between samples: an error of 3e-5


def waveforms(
    scenario: Scenario, inputs: Sequence[str], dt: float, k: int, mass: float | None = None
) -> tuple[list[str], np.ndarray]:
    """The driven inputs' names, and the cubics c (4, m, k) they follow from sample to sample (core/response.py: hermite).

    inputs: the names that the loop has. dt [s], k samples; mass [kg] of the rotor. Raises InvalidInput for an unknown signal
    (listing the known ones), an edge that is no multiple of dt, or a sine too fast for dt.
    """
    rows: dict[str, np.ndarray] = {}

    def row(name: str) -> np.ndarray:
        index_of(name, inputs, "input")
        return rows.setdefault(name, np.zeros((4, k)))

    for pulse in scenario.pulses:
        for first, last in _windows(pulse, dt, k):
            row(pulse.signal)[0, first:last] += pulse.amplitude
    for sine in scenario.sines:
        _check_smooth(sine.frequency, dt, f"the sine on {sine.signal}")
        for first, last in _windows(sine, dt, k):
            angle = sine.frequency * np.arange(last - first + 1) * dt + sine.phase
            value, slope = sine.amplitude * np.sin(angle), sine.amplitude * sine.frequency * np.cos(angle)
            row(sine.signal)[:, first:last] += hermite(value[None], slope[None], dt)[:, 0]
    for unbalance in scenario.unbalances:
        names = _directions(unbalance.port, inputs)
        for first, last, force, rate in _turning(scenario, unbalance, dt, k, mass):
            for name, part in zip(names, (np.real, np.imag), strict=True):
                row(name)[:, first:last] += hermite(part(force)[None], part(rate)[None], dt)[:, 0]
    driven = [name for name in inputs if name in rows]
    return driven, np.stack([rows[name] for name in driven], axis=1) if driven else np.zeros((4, 0, k))


def _windows(item: Pulse | Sine, dt: float, k: int) -> Iterator[tuple[int, int]]:
    """First and past-the-last sample of a disturbance and of its repetitions."""

    def sample(time: float) -> int:
        index = round(time / dt)
        if abs(index - time / dt) > 1e-6 * max(1.0, index):
            remedy = "move it or choose another sample time"
            raise invalid(f"an edge of the disturbance on {item.signal}", f"{time:g} s", f"a multiple of dt = {dt:g} s", remedy)
        return index

    first = sample(item.start)
    length = k if item.duration is None else sample(item.duration)
    every = sample(item.every) if isinstance(item, Pulse) and item.every is not None else k
    while first < k:
        yield first, min(first + length, k)
        first += every


def _check_smooth(frequency: float, dt: float, what: str) -> None:
    if frequency * dt > FASTEST * (1 + 1e-9):
        requirement = f"at most {FASTEST / dt:g} rad/s at dt = {dt:g} s"
        raise invalid(f"the frequency of {what}", f"{frequency:g} rad/s", requirement, "sample faster")


def _directions(port: str, inputs: Sequence[str]) -> tuple[str, str]:
    for first, second in (("zeta", "eta"), ("x", "y")):
        if f"f_{port}_{first}" in inputs and f"f_{port}_{second}" in inputs:
            return f"f_{port}_{first}", f"f_{port}_{second}"
    known = sorted({name[2:].rpartition("_")[0] for name in inputs if name.startswith("f_")})
    raise InvalidInput(f"the unbalance is at port {port!r}, which the loop has not; it has {', '.join(known) or 'none'}")


def _turning(
    scenario: Scenario, unbalance: Unbalance, dt: float, k: int, mass: float | None
) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
    """Stretches of constant angular acceleration a: first and past-the-last sample, force and its rate (complex) at all ends.

    F = U (W^2 - j a) exp(j phi), real part in the first direction and imaginary part in the second: minus the mass times the
    acceleration of a point that turns with phi'' = a.
    """
    amount = unbalance.mass_times_radius(mass)
    to_speed = scenario.speed_at(scenario.duration)
    _check_smooth(max(abs(scenario.speed_at(0.0)), abs(to_speed)), dt, f"the unbalance at {unbalance.port}")
    turn = min(round((scenario.ramp or scenario.duration) / dt), k) if scenario.runs_up else 0
    a = (scenario.speed_at(turn * dt) - scenario.speed_at(0.0)) / (turn * dt) if turn else 0.0
    start, angle = scenario.speed_at(0.0), unbalance.phase
    for first, last, acceleration in ((0, turn, a), (turn, k, 0.0)):
        if first < last:
            t = np.arange(last - first + 1) * dt
            W, phi = start + acceleration * t, angle + start * t + acceleration * t**2 / 2
            size = W**2 - 1j * acceleration
            turned = amount * np.exp(1j * phi)
            yield first, last, turned * size, turned * (2 * W * acceleration + 1j * W * size)
            start, angle = W[-1], phi[-1]
