"""What the axis along the shaft can do at a glance, and what about it is implausible."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import poles
from ambrose.judge.static_stiffness import below_stiffness, stiffness_margin
from ambrose.judge.unavoidable import beyond_reach, unavoidable_sensitivity
from ambrose.machine.axial import AxialMachine, in_file
from ambrose.machine.criteria import demand
from ambrose.machine.machine import Machine
from ambrose.machine.thrust import ThrustBearing
from ambrose.machine.validation.ranges import implausible
from ambrose.model.assemble import assemble
from ambrose.model.axial.half_order import CORNER
from ambrose.model.axial.magnet import at_point, core_lags, sides, tilt_stiffness
from ambrose.model.axial.wiring import rotor_mass
from ambrose.model.plant import top_speed

# [m/s] of a steel collar's rim, assumed: a turning disc carries (3 + nu)/8 rho v^2 at its centre
# and about twice that at a bore, here 0.8 and 1.6 GPa, the strength of quenched steel
_RIM = 500.0
# [T] at which usual electrical steel leaves the straight part of its B-H curve, assumed; a magnet
# whose file gives no flux_density is computed with straight iron
_FLUX = 1.5
# static capacity over the process thrust, assumed: the rest is for what changes fast
_SPARE = 1.5


def axial_facts(machine: AxialMachine) -> dict[str, Any]:
    """What `ambrose check file#axial` tells, SI units: mass, coefficients, core, unstable pole,
    capacity against load, doubts.

    Coefficients and poles are those of the design point, capacities and loads over all points.
    """
    part, plant = machine.thrust, assemble(machine, machine.operation.design)
    design = at_point(machine, machine.operation.design)
    mass, margin = rotor_mass(machine), stiffness_margin(machine)
    least, pole, delay = unavoidable_sensitivity(plant)
    lags = [model for model in core_lags(part) if model is not None]

    # without eddy currents m s^2 = k_s - k_c (magnet less coupling), s = sqrt((k_s - k_c)/m)
    spring = design.stiffness - part.coupling_stiffness
    rows = [at_point(machine, point) for point in machine.operation.points]
    limit = demand("sensitivity of an axis", machine.requirements).limit
    reach = "" if limit is None else beyond_reach(least, pole, delay, limit)
    return {
        "machine": machine.name,
        "description": machine.description,
        "axis": machine.axes[0],
        "mass_kg": mass,
        "at": {"point": machine.operation.design.label, "load_N": design.load},
        "k_i": design.force_per_current,
        "k_s": design.stiffness,
        # -3 dB of 1/(1 + tau sqrt(j w)) lies at tau sqrt(w) = CORNER (model/axial/half_order.py)
        "core_corner_rad_s": [
            (CORNER / side.tau) ** 2 if side.core else None for side in sides(part)
        ],
        "core_states": sum(len(model.poles) for model in lags),
        "core_error_db": max((model.gain_error for model in lags), default=0.0),
        "core_error_deg": max((model.phase_error for model in lags), default=0.0),
        "unstable_poles_rad_s": [
            [float(p.real), float(p.imag)] for p in poles(plant.rotor) if p.real > 0
        ],
        "laminated_pole_rad_s": math.sqrt(max(spring, 0.0) / mass),
        "capacity_N": [min(row.capacity[k] for row in rows) for k in (0, 1)],
        "load_N": [min(row.load for row in rows), max(row.load for row in rows)],
        "place_m": [min(row.place for row in rows), max(row.place for row in rows)],
        "static_current_A": max(abs(row.current) for row in rows),
        "tilt_stiffness_N_m_rad": -tilt_stiffness(part),
        "stiffness_margin": margin,
        "least_sensitivity": least,
        "plant_states": plant.system.n_states,
        "operating_points": [point.label for point in machine.operation.points],
        "tolerances": [item.parameter for item in machine.tolerances],
        "assumed": len(machine.assumed),
        "doubts": [
            *(line for line in implausible(machine) if line.startswith("[[thrust_bearing]]")),
            *_doubts(machine, margin),
            *([reach] if reach else []),
        ],
        "remarks": [],
    }


def along_doubts(machine: Machine) -> list[str]:
    """What is implausible along the shaft of a machine with a thrust bearing, for those who check
    the radial axes; nothing without one.
    """
    if not any(isinstance(part, ThrustBearing) for part in machine.effects):
        return []
    try:
        axial: Any = machine.axial
        lines = [*_doubts(axial, stiffness_margin(axial))]
    except InvalidInput as error:
        lines = [str(error)]
    return [f"along the shaft: {line}" for line in lines]


def _doubts(machine: AxialMachine, margin: float | None) -> Iterator[str]:
    """Gaps, flux, rim speed, capacity and static stiffness (``margin``, K_p k_i/k_s; None without a
    reference controller) that a machine along its shaft hardly has, a sentence each.
    """
    part = machine.thrust
    for name, side in zip(("left", "right"), sides(part), strict=True):
        # B = Phi/A at the smaller of the two poles, at the largest current of the coil
        largest_current = side.bias + (part.max_current or 0.0)
        flux = side.flux(largest_current, side.gap)
        density = flux / min(side.inner_area, side.outer_area)
        if math.isinf(side.flux_limit) and density > _FLUX:
            yield (
                f"the {name} magnet would reach {density:.3g} T at {largest_current:g} A, "
                "more than iron carries; add flux_density, or lower turns or currents"
            )
    rim = top_speed(machine) * part.collar_radius
    if rim > _RIM:
        yield (
            f"the collar's rim runs at {rim:.4g} m/s, where {_RIM:g} m/s are the end for steel; "
            "check collar_radius and speed"
        )
    for point in machine.operation.points:
        row = at_point(machine, point)
        largest = row.capacity[row.load < 0]
        if row.load and largest < _SPARE * abs(row.load):
            yield (
                f"{point.label}: {abs(row.load):,.4g} N of thrust leave little of {largest:,.4g} "
                f"N; {_SPARE:g} times the load and more is usual"
            )
    if margin is not None and margin < 1:
        yield in_file(machine, below_stiffness(margin))


def axial_rows(facts: dict[str, Any], quantity: Any) -> list[tuple[str, str]]:
    """Rows (what, value) of the table that `ambrose check` prints, from ``axial_facts``.

    quantity(value, unit): writes a number in the unit that people read, for example rad/s as Hz.
    """
    corners = [w for w in facts["core_corner_rad_s"] if w is not None]
    core = "laminated"
    if corners:
        core = f"-3 dB at {', '.join(dict.fromkeys(quantity(w, 'rad/s') for w in corners))}"
        core += f"; {facts['core_states']} states, {facts['core_error_db']:.2g} dB and "
        core += f"{facts['core_error_deg']:.2g} deg off"
    unstable = ", ".join(f"{re:.1f}" for re, _ in facts["unstable_poles_rad_s"]) or "none"
    left, right = facts["capacity_N"]
    low, high = facts["load_N"]
    margin, least = facts["stiffness_margin"], facts["least_sensitivity"]
    point, thrust = facts["at"]["point"], facts["at"]["load_N"]
    where = f"at {point or 'the design point'} under {thrust:.4g} N"
    return [
        ("rotor mass", quantity(facts["mass_kg"], "kg")),
        ("magnets", f"k_i {facts['k_i']:.4g} N/A, k_s {facts['k_s'] / 1e6:.4g} N/um, {where}"),
        ("core", core),
        (
            "unstable pole",
            f"{unstable} rad/s, laminated {facts['laminated_pole_rad_s']:.1f} rad/s",
        ),
        ("static capacity", f"{left:.4g} N to the left, {right:.4g} N to the right"),
        (
            "process thrust",
            f"{low:.4g} to {high:.4g} N, which takes {facts['static_current_A']:.3g} A",
        ),
        (
            "collar off centre by thermal growth",
            f"{1e6 * facts['place_m'][0]:.3g} to {1e6 * facts['place_m'][1]:.3g} um",
        ),
        (
            "stiffness of the collar's tilting, in the radial plant",
            f"{facts['tilt_stiffness_N_m_rad']:.4g} N m/rad",
        ),
        (
            "static stiffness margin, K_p k_i / k_s",
            "no reference controller" if margin is None else f"{margin:.3g}",
        ),
        ("least sensitivity that the delay allows", f"{least:.3g}"),
        ("plant states", f"{facts['plant_states']}"),
        ("operating points", ", ".join(facts["operating_points"])),
        ("uncertain parameters", ", ".join(facts["tolerances"]) or "none"),
    ]
