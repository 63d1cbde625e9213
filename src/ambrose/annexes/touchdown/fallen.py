"""The rotor as it falls: no magnets, in modes of the free rotor, and the touchdown bearings that it
meets, as numbers.

The rotor is that of the plant (``model.assemble.attached_rotor``) with the magnets' negative
stiffness taken out again: shaft, discs, gyroscopics, seals and couplings at an operating point, and
the supports. Seals with states have their static part here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import attached
from ambrose.machine.axial import AxialMachine
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import attached_rotor
from ambrose.model.basis import modes_of
from ambrose.model.effects.clearance import Clearance
from ambrose.model.effects.rotor import (
    displacement_row,
    finite_element_rotor,
    gravity_load,
    mass_properties,
)
from ambrose.model.effects.touchdown import Bearing, element_force, parameters
from ambrose.model.ports import measured_ports
from ambrose.model.static_load import magnet_coefficients


def stator_receptance(numbers: Bearing, w: float, load: float = 0.0) -> complex:
    """Displacement per force [m/N] of what the rotor touches, at w [rad/s]: race, elements, ring,
    mount. The elements count by their secant stiffness under a load [N] that turns with the whirl;
    at zero load by that of a thousandth of the contact's penetration.
    """
    behind = 0.0j  # of the ring
    if numbers.ring_mass:
        stiffness = numbers.mount_stiffness - numbers.ring_mass * w**2
        behind = 1 / (stiffness + 1j * w * numbers.mount_damping)
    if not numbers.race_mass:
        return behind
    # secant of the elements at their load; the race's own inertia is small beside it
    deflection = elements_deflection(numbers, max(load, 1.0))
    elements = max(load, 1.0) / deflection + 1j * w * numbers.element_damping
    return 1 / (1 / (behind + 1 / elements) - numbers.race_mass * w**2)


def elements_deflection(numbers: Bearing, load: float) -> float:
    """The deflection [m] of the rolling elements under a load [N] above zero, the inverse of
    ``element_force``.
    """
    K, p = numbers.hertz, numbers.preload
    alone = (load / K) ** (2 / 3) - p  # the row behind is off: F = K (p + d)^1.5
    if alone >= p:
        return alone
    # both rows: Newton's method from the slope at the centre, 3 K sqrt(p)
    deflection = load / (3 * K * math.sqrt(p))
    for _ in range(8):
        front, back = p + deflection, max(p - deflection, 0.0)
        slope = 1.5 * K * (math.sqrt(front) + math.sqrt(back))
        deflection -= (element_force(deflection, K, p) - load) / slope
    return deflection


@dataclass(frozen=True, slots=True, eq=False)
class FallenRotor:
    """M q'' + (D + W G) q' + K q = f in n coordinates, at touchdown bearings b.

    rows (b, 2, n): displacement along the global x and y at every touchdown bearing; weight (n,)
    [N] along its coordinates (zero without gravity); mass [kg] and polar_inertia [kg m2] of the
    rotor. speed [rad/s] of the operating point. seal_names, seal_gaps (s,) [m] (radial) and
    seal_rows (s, 2, n): where else it must not touch. sensor_rows (2b, n): what the sensors of
    every axis read.
    """

    names: tuple[str, ...]
    bearings: tuple[Bearing, ...]
    mass_matrix: np.ndarray
    damping: np.ndarray
    gyroscopic: np.ndarray
    stiffness: np.ndarray
    rows: np.ndarray
    weight: np.ndarray
    mass: float
    polar_inertia: float
    speed: float
    seal_names: tuple[str, ...]
    seal_gaps: np.ndarray
    seal_rows: np.ndarray
    sensor_rows: np.ndarray

    def receptance(self, w: float) -> np.ndarray:
        """Backward receptances (b, b) [m/N] at w [rad/s]: forces and displacements that circle
        against the spin.

        Against the spin: x = cos wt, y = -sin wt, the phasors (1, j). Of a rotor and stator alike
        in all directions the answer circles as well; else this is its part that does.
        """
        dynamic = (
            self.stiffness
            - w**2 * self.mass_matrix
            + 1j * w * (self.damping + self.speed * self.gyroscopic)
        )
        backward = self.rows[:, 0] + 1j * self.rows[:, 1]  # (1, j) of a force, as a row
        answer = np.linalg.solve(dynamic, backward.T)
        return 0.5 * backward.conj() @ answer


def fallen_rotor(
    machine: Machine, point: OperatingPoint, bending_modes: int | None = None
) -> FallenRotor:
    """The rotor of a machine at an operating point, without its magnets. bending_modes: per plane
    (None: the full model). Raises InvalidInput where a bearing has no touchdown_gap, or a seal is
    narrower than the touchdown gap.
    """
    refuse(machine)
    rotor = finite_element_rotor(machine)
    free = attached_rotor(machine, point, rotor, bending_modes)
    outputs = dict(zip(free.outputs, free.C, strict=True))
    axes = np.array([outputs[f"q_{axis}"] for axis in machine.axes])

    # the plant's -k_s N^T N out again
    k_s = magnet_coefficients(machine, point)[1]
    stiffness = free.stiffness + axes.T @ (k_s[:, None] * axes)

    # zeta, eta of each bearing to the global x, y
    rows = []
    for bearing, (zeta, eta) in zip(
        machine.bearings, axes.reshape(-1, 2, axes.shape[1]), strict=True
    ):
        c, s = math.cos(bearing.angle), math.sin(bearing.angle)
        rows.append([c * zeta - s * eta, s * zeta + c * eta])
    modes = modes_of(machine, rotor, bending_modes)
    count = free.n
    weight = np.zeros(count)
    weight[: modes.shapes.shape[1]] = modes.shapes.T @ gravity_load(
        rotor, machine.gravity_direction
    )
    seals = seal_gaps(machine)
    seal_rows = np.zeros((len(seals), 2, count))
    for i, (_, position, _) in enumerate(seals):
        for k, angle in enumerate((0.0, math.pi / 2)):
            line = displacement_row(rotor, position, angle) @ modes.shapes
            seal_rows[i, k, : len(line)] = line
    sensors = np.zeros((len(machine.axes), count))
    for i, port in enumerate(measured_ports(machine)):
        line = displacement_row(rotor, port.position, port.direction) @ modes.shapes
        sensors[i, : len(line)] = line
    properties = mass_properties(rotor)
    return FallenRotor(
        tuple(bearing.name for bearing in machine.bearings),
        tuple(parameters(machine, bearing) for bearing in machine.bearings),
        free.mass,
        free.damping,
        free.gyroscopic,
        stiffness,
        np.array(rows),
        weight,
        properties.mass,
        properties.polar_inertia,
        point.speed,
        tuple(name for name, _, _ in seals),
        np.array([gap for _, _, gap in seals]),
        seal_rows,
        sensors,
    )


def seal_gaps(machine: Machine) -> list[tuple[str, float, float]]:
    """(name, position [m], radial clearance [m]) of seals and of [[clearance]] whose file states
    one.
    """
    found = []
    for seal in machine.seals:
        part = seal if seal.geometry is None else seal.geometry
        sides = (getattr(part, "inlet_clearance", None), getattr(part, "exit_clearance", None))
        gaps = [gap for gap in sides if gap]
        if gaps:
            found.append((f"seal {seal.name}", seal.position, min(gaps)))
    for _, part in attached(machine):
        if isinstance(part, Clearance):
            found.append((f"clearance {part.name}", part.position, part.diametral / 2))
    return found


def refuse(machine: Machine) -> None:
    """What cannot land. Raises InvalidInput."""
    if isinstance(machine, AxialMachine):
        raise InvalidInput(
            f"{machine.name} is the axis along the shaft; take the machine without #axial, or let "
            "the axis fall in ambrose simulate with the scenario power-loss"
        )
    if not machine.bearings:
        raise InvalidInput(
            f"{machine.name} has no magnetic bearing to fall out of; give [[bearing]] with a "
            "touchdown_gap"
        )
    for bearing in machine.bearings:
        if bearing.touchdown_gap is None:
            raise InvalidInput(
                f"[[bearing]] {bearing.name} has no touchdown_gap to land in; add it to the "
                "machine file"
            )
    widest = max(machine.bearings, key=lambda bearing: bearing.touchdown_gap or 0.0)
    for name, _, gap in seal_gaps(machine):
        if widest.touchdown_gap is not None and widest.touchdown_gap > gap:
            raise InvalidInput(
                f"[[bearing]] {widest.name}: touchdown_gap {widest.touchdown_gap:g} m is above the "
                f"clearance {gap:g} m of {name}, in which the rotor would land first; make "
                "the touchdown gap smaller or that clearance larger"
            )
