"""A machine's gas seal at an operating point: its geometry and gas through the bulk-flow model,
each flow computed once.

The pressure drop across the seal is the operating point's; the absolute pressure on one side is the
seal's own. At drops below ``LEAST_DROP`` of it the model has no turbulent flow to work with: there
the coefficients fall to zero in proportion to the drop.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.machine.messages import as_written
from ambrose.machine.seals import GasSealGeometry, Seal
from ambrose.model.effects.bulkflow import (
    BulkFlow,
    Friction,
    Gas,
    SealCondition,
    SealGeometry,
    air,
    bulk_flow,
)

COMPUTED = ("K", "k", "C", "c")
LEAST_DROP = 0.05  # of the side whose pressure is given
_CELLS = (100, 400)  # the second where the first is too coarse
_SLOWEST = 1.0  # rad/s; the coefficients are even functions of the frequency, and flat there
_SLACK = 1e-9  # of the highest frequency, rounding
_COLD = 150.0  # [K], assumed: just above air's critical point, and 150 degC hardly leave a seal


def gas_coefficients(
    seal: Seal, pressure: float, speed: float, frequency: float
) -> dict[str, float]:
    """K, k [N/m], C, c [N s/m] at a pressure drop [Pa], spin speed [rad/s] and whirl frequency
    [rad/s].

    Raises InvalidInput, naming the seal: a frequency above its ``max_frequency``, a choked or
    reverse flow, a drop larger than the inlet pressure. Raises NumericalFailure where no grid is
    fine enough.
    """
    flow, share = gas_flow(seal, pressure, speed, (float(frequency),))
    return (
        {name: share * float(getattr(flow, name)[0]) for name in COMPUTED}
        if flow
        else dict.fromkeys(COMPUTED, 0.0)
    )


def gas_flow(
    seal: Seal, pressure: float, speed: float, frequencies: tuple[float, ...]
) -> tuple[BulkFlow | None, float]:
    """The flow at whirl frequencies [rad/s], and the factor on its coefficients, below 1 at very
    small drops; None at no drop.

    Raises as ``gas_coefficients``.
    """
    geometry = seal.geometry
    if geometry is None:
        raise InvalidInput(f"seal {seal.name} has no geometry; add [seal.geometry]")
    where = f"[[seal]] {seal.name}, [seal.geometry]"
    low, high = min(frequencies), max(frequencies)
    if not low >= 0 or high > geometry.max_frequency * (1 + _SLACK):
        worst = low if not low >= 0 else high
        within = f"from 0 to its max_frequency, {geometry.max_frequency:g} rad/s"
        raise invalid(
            f"the whirl frequency [rad/s] of seal {seal.name}",
            f"{worst:g}",
            within,
            "raise max_frequency there",
        )
    if pressure == 0:
        return None, 0.0

    # below the least drop the coefficients fall in proportion to it
    least = LEAST_DROP * (geometry.exit_pressure or geometry.inlet_pressure or 0.0)
    spin = speed if geometry.speed is None else geometry.speed
    used_frequencies = tuple(max(w, _SLOWEST) for w in frequencies)
    try:
        return _flow(geometry, max(pressure, least), spin, used_frequencies), min(
            pressure / least, 1.0
        )
    except (InvalidInput, NumericalFailure) as error:
        cold = celsius_for_kelvin(geometry)
        text = f"{cold} (as it stands, {error})" if cold else str(error)
        raise type(error)(f"{where}: {text}") from error


def celsius_for_kelvin(geometry: GasSealGeometry) -> str:
    """What to say of a temperature that is probably one in degrees Celsius; "" else.

    A gas with air's viscosity is none below air's critical temperature, 132 K.
    """
    if geometry.viscosity is not None or geometry.temperature >= _COLD:
        return ""
    return (
        f"temperature is {geometry.temperature:g} K, which looks like degrees Celsius; write "
        f'"{geometry.temperature:g} degC", or for a cold gas its viscosity'
    )


@lru_cache(maxsize=2048)
def _flow(
    geometry: GasSealGeometry, pressure: float, speed: float, frequencies: tuple[float, ...]
) -> BulkFlow:
    # a finer grid where the first is too coarse
    seal, condition = described(geometry, pressure, speed)
    try:
        return bulk_flow(seal, condition, np.array(frequencies), _CELLS[0])
    except NumericalFailure:
        return bulk_flow(seal, condition, np.array(frequencies), _CELLS[1])


def described(
    geometry: GasSealGeometry, pressure: float, speed: float
) -> tuple[SealGeometry, SealCondition]:
    """What ``bulk_flow`` takes, at a pressure drop [Pa] and a spin speed [rad/s]. Raises
    InvalidInput.
    """
    g = geometry
    if g.inlet_pressure is not None and pressure >= g.inlet_pressure:
        raise invalid(
            "the seal_pressure",
            as_written(pressure, "pressure"),
            f"below the inlet_pressure, {as_written(g.inlet_pressure, 'pressure')}",
            "lower it",
        )
    inlet, outlet = (
        (g.inlet_pressure, g.inlet_pressure - pressure)
        if g.inlet_pressure is not None
        else ((g.exit_pressure or 0.0) + pressure, g.exit_pressure or 0.0)
    )
    usual = air(g.temperature)
    gas = Gas(
        g.gas_constant, usual.viscosity if g.viscosity is None else g.viscosity, g.compressibility
    )
    seal = SealGeometry(
        g.length,
        g.diameter,
        g.inlet_clearance,
        g.exit_clearance,
        g.hole_depth,
        g.hole_area_ratio,
        Friction(*g.rotor_friction),
        Friction(*g.stator_friction),
        g.inlet_loss,
        g.exit_recovery,
    )
    return seal, SealCondition(
        inlet, outlet, g.temperature, speed, gas, g.preswirl if speed else 0.0
    )
