"""What a thrust bearing's magnets make of a record beyond their linear force, as the loop answers.

Currents i and displacements x of the linear loop drive both magnets' circuits about the working
point; what their force has beyond its linear part passes the loop, which moves i and x, and so on
until nothing changes. With flux phi = phi_0 + d, coil current I_0 + i and G(phi, g) = rho g phi +
R_f phi phi_s/(phi_s - phi), what the flux meets at once (``model.axial.magnet``):

    (R + c sqrt(s)) d = N i - (G(phi, g - x) - G(phi_0, g) - R d),    R = dG/dphi at rest,

solved by itself: the bracket is of second order and late by the core's lag at the working point.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.identification.excitation import signal_rows
from ambrose.law.loop import closed_loop
from ambrose.machine.axial import AxialMachine
from ambrose.machine.thrust import ThrustBearing
from ambrose.model.axial.found import with_found
from ambrose.model.axial.magnet import AtPoint, Side, closed_lags, core_lags, loaded, sides
from ambrose.model.plant import Plant
from ambrose.record.record import Record

_ROUNDS = 4  # of the flux, and of the loop: each is smaller by the share that is nonlinear
_FULL = 0.999  # of the flux limit: the linear loop knows none
_REACH = 0.9  # of a gap: what the linear loop may use for the circuit to have an answer


def thrust_responses(
    plant: Plant,
    law: StateSpace,
    record: Record,
    excitations: Sequence[str],
    signals: Sequence[str],
    coefficients: tuple[float, float],
    turning: Sequence[tuple[float, np.ndarray]] = (),
) -> np.ndarray:
    """(1, p, k): what the nonlinear magnets add to the signals (p,) of a record.

    plant: reduced, with the parameters that were found; law: the controller as it runs;
    coefficients: k_i [N/A] and k_s [N/m] that were found; turning: frequency [rad/s] and phasors
    (2,) of current and displacement that no excitation makes. Raises InvalidInput where no such
    magnets are found, or the linear loop leaves their gaps.
    """
    machine = plant.machine
    assert isinstance(machine, AxialMachine)
    (axis,), at = machine.axes, machine.condition(plant.point)
    part = with_found(machine.thrust, at.load, at.place, *coefficients)
    loop = closed_loop(plant, law)
    own = [f"i_{axis}", f"q_{axis}"]
    moved = simulate(select(loop, excitations, own), np.array(signal_rows(record, excitations)))
    t = record.dt * np.arange(moved.shape[1])
    for omega, phasors in turning:
        moved += (phasors[:, None] * np.exp(1j * omega * t)).real
    answer = select(loop, [f"f_{axis}"], [*own, *signals])
    made = np.zeros((len(own) + len(signals), moved.shape[1]))
    for _ in range(_ROUNDS):
        beyond = _beyond(part, at.load, at.place, moved + made[: len(own)], record.dt)
        # the working point is the record's mean, which the force's own mean is part of
        made = simulate(answer, _between(beyond - beyond.mean())[None])
    return made[None, len(own) :].astype(np.float32)


def _between(v: np.ndarray) -> np.ndarray:
    """A smooth signal (k,) as what a system that holds its input from sample to sample needs: the
    mean of each sample and the next.
    """
    return np.asarray((v + np.append(v[1:], v[-1:])) / 2)


def _beyond(
    part: ThrustBearing, load: float, place: float, moved: np.ndarray, dt: float
) -> np.ndarray:
    """Force (k,) [N] beyond the linear one for currents and displacements (2, k) about a working
    point, held from sample to sample.
    """
    at = loaded(part, load, place)
    gaps = part.gap[0] + place, part.gap[1] - place
    if np.abs(moved[1]).max(initial=0.0) > _REACH * min(gaps):
        raise InvalidInput(
            f"the linear loop leaves the gap of {part.name}; record with a smaller excitation"
        )
    left, right = (
        _side_beyond(side, coil, gap, point, lag, way * moved, dt)
        for side, coil, gap, point, lag, way in zip(
            sides(part),
            (-at.current, at.current),
            (place, -place),
            (at.left, at.right),
            core_lags(part),
            (-1.0, 1.0),
            strict=True,
        )
    )
    return right - left


def _side_beyond(
    side: Side,
    control: float,
    opened: float,
    at: AtPoint,
    model: object,
    moved: np.ndarray,
    dt: float,
) -> np.ndarray:
    """Force (k,) towards one side beyond its linear part: control current [A] and gap [m] added at
    the working point, current and displacement (2, k) towards the side.
    """
    gap = side.gap + opened
    phi_0 = side.flux(side.bias + control, gap)
    met = side.met(phi_0, gap)
    lag = None if model is None else _sampled_lag(model, at.ratio, dt)
    i, x = moved
    drive = side.turns * i

    def late(v: np.ndarray) -> np.ndarray:
        return v if lag is None else np.asarray(simulate(lag, _between(v)[None])[0])

    # linear: d = h (N i + rho phi_0 x)/R
    linear = late((drive + side.slope * phi_0 * x) / met)
    d = linear
    for _ in range(_ROUNDS):
        bracket = _meets(side, phi_0 + d, gap - x) - _meets(side, phi_0, gap) - met * d
        d = late((drive - bracket) / met)

    # F = rho phi^2/2, less its linear part rho phi_0 d
    return np.asarray(side.slope * (d**2 / 2 + phi_0 * (d - linear)))


def _meets(side: Side, flux: np.ndarray | float, gap: np.ndarray | float) -> np.ndarray:
    """G(phi, g) [A]."""
    iron: np.ndarray | float = side.iron
    if not np.isinf(side.flux_limit):
        iron = (
            side.iron
            * side.flux_limit
            / (side.flux_limit - np.minimum(flux, 0.999 * side.flux_limit))
        )
    return np.asarray((side.slope * gap + iron) * flux)


def _sampled_lag(model: object, ratio: float, dt: float) -> StateSpace:
    A, B, C = closed_lags(model, ratio)  # type: ignore[arg-type]
    return c2d(StateSpace(A, B[:, None], C[None], np.zeros((1, 1)), ["v"], ["h"]), dt)
