"""A PID that holds a machine at all its operating points, as sampled: the best of a grid around a
first guess.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.core.time_limit import TimeLimit
from ambrose.judge.certificate import certify
from ambrose.law.pid import first_settings, pid_controller
from ambrose.law.timing import machine_timing
from ambrose.machine.controller import Notch, PidSettings
from ambrose.machine.machine import Machine
from ambrose.machine.units import DIMENSIONS, read_quantity
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import finite_element_rotor, free_modes
from ambrose.model.reduce import reduce_from
from ambrose.model.static_load import magnet_coefficients
from ambrose.synthesis.fixed_order.job import bending_modes_for
from ambrose.synthesis.fixed_order.loops import LoopModel, loop_model, unwarped, warped

# the grid that is searched for a first PID; assumed
_GAINS = (1.5, 2.0, 3.0, 4.0)  # K_p k_i/k_s; at 1 the static stiffness is zero
_TIMES = (0.35, 0.5, 0.75, 1.0, 1.5)  # T_d w_0
_FILTERS = (0.05, 0.1, 0.2)  # eps, the filter's time over T_d
_GOOD = 2.6  # sensitivity peak from which no notch is tried
_GRID = np.geomspace(1.0, 2e5, 80)  # rad/s
_SHARP = 0.1  # damping ratio
_SECONDS = 15.0  # that the search may take; assumed
_SURE = 3  # of the best, until one holds the full plants


def holding_pid(machine: Machine) -> tuple[PidSettings, float]:
    """Settings with the machine's sample time and delay, and the largest sigma_max(S_o) on the full
    plants at all points.

    inf where nothing of the grid holds them: then the first guess. One gain for all axes; K_p in
    multiples of k_s/k_i, T_d of 1/w_0 (``first_settings``), numbers rounded; notches at the lowest
    bending modes where that is better.
    """
    full = [assemble(machine, point) for point in machine.operation.envelope]
    timing = machine_timing(machine)
    small = [loop_model(reduce_from(plant, bending_modes_for(plant)), timing) for plant in full]
    models = [(model, _responses(model, _GRID, len(machine.axes))) for model in small]
    clock = TimeLimit(_SECONDS)
    ranked: list[tuple[float, PidSettings]] = []
    for candidates in _candidates(machine):
        ranked += [(_peak(models, tried, machine), tried) for tried in candidates]
        ranked.sort(key=lambda item: item[0])
        if ranked[0][0] < _GOOD or clock.left <= 0:
            break
    for _, settings in ranked[:_SURE]:
        law = pid_controller(settings, machine)
        found = [
            certify(plant, law if timing is None else timing.in_loop(law), margins=False)
            for plant in full
        ]
        if all(item.stable for item in found):
            return settings, max(item.closed_loop_norm for item in found)
    return ranked[0][1], math.inf


def _candidates(machine: Machine) -> Iterator[list[PidSettings]]:
    """Without notch, with one, with two."""
    first = first_settings(machine)
    rate = 0.5 / (first.derivative_time or 1.0)
    k_i, k_s = magnet_coefficients(machine, machine.operation.design)
    least = float((k_s / k_i).max())
    runs = machine.controller or PidSettings()
    bending = free_modes(finite_element_rotor(machine), 2).frequencies[4::2]
    for notched in range(3):
        notches = tuple(Notch(in_hertz(w), 0.5, 0.1) for w in bending[:notched])
        yield [
            replace(
                runs,
                gain=(rounded(gain * least, 3),),
                integral_time=rounded(20 / rate, 2),
                derivative_time=rounded(time / rate, 2),
                derivative_filter=eps,
                notches=notches,
            )
            for gain, time, eps in product(_GAINS, _TIMES, _FILTERS)
        ]


_Responses = tuple[np.ndarray, np.ndarray]


def _responses(model: LoopModel, omega: np.ndarray, axes: int) -> _Responses:
    """Frequencies below half the rate, and currents to displacements there."""
    top = math.inf if model.timing is None else 0.97 * math.pi / model.timing.sample_time
    omega = omega[(omega > 0) & (omega < top)]
    return omega, model.response(omega)[:, :axes, :axes]


def _peak(
    models: Sequence[tuple[LoopModel, _Responses]], settings: PidSettings, machine: Machine
) -> float:
    """The largest sigma_max(S_o) over the models, on a grid and at the loops' sharp poles; inf
    where one is unstable.
    """
    law, worst = pid_controller(settings, machine), 0.0
    for model, (base, response) in models:
        m = len(law.D)
        # y = inner (C x + D C_k x_k), u = C_k x_k - D_k y
        inner = np.linalg.inv(np.eye(m) + model.D @ law.D)
        y = inner @ np.hstack([model.C, model.D @ law.C])
        u = np.hstack([np.zeros((m, len(model.A))), law.C]) - law.D @ y
        n = len(model.A)
        loop = np.vstack(
            [
                np.hstack([model.A, np.zeros((n, len(law.A)))]),
                np.hstack([np.zeros((len(law.A), n)), law.A]),
            ]
        )
        loop[:n] += model.B @ u
        loop[n:] -= law.B @ y
        values = np.linalg.eigvals(loop)
        if values.real.max() >= 0:
            return math.inf
        sharp = values[(values.imag > 0) & (-values.real < _SHARP * np.abs(values))]
        for omega, G in (
            (base, response),
            _responses(model, unwarped(sharp.imag, model.timing), m),
        ):
            K = frequency_response(law, warped(omega, model.timing)).values
            worst = max(
                worst,
                float(
                    1
                    / np.linalg.svd(np.eye(m) + G @ K, compute_uv=False)[:, -1].min(
                        initial=math.inf
                    )
                ),
            )
    return worst


def rounded(value: float, digits: int) -> float:
    """So many significant digits."""
    return float(f"{value:.{digits}g}")


def in_hertz(rate: float, digits: int = 3) -> float:
    """A rate [rad/s] that is a round number in Hz."""
    return read_quantity(
        f"{rounded(rate / (2 * math.pi), digits):g} Hz", DIMENSIONS["angular rate"]
    )
