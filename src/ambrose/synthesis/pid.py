"""The reference controller: decentralised PID with the usual industrial additions, certified on the plant it is meant for.

With e_y = r - y and u = K e_y (loop diagram in core/lft.py) and the bearing's force f = k_i i + k_s x, a positive gain
pulls the rotor back: it must exceed k_s / k_i before the loop has any stiffness at all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, invalid, named_failure
from ambrose.core.statespace import StateSpace, append, rename, series, static_gain
from ambrose.machine.description import MagneticBearing, PidSettings
from ambrose.machine.machine import Machine
from ambrose.physics.rotor import finite_element_rotor, mass_properties
from ambrose.plant.assemble import magnet_coefficients
from ambrose.plant.model import Plant
from ambrose.plant.timing import Timing, machine_timing
from ambrose.synthesis.as_it_runs import certify_as_it_runs
from ambrose.synthesis.certificate import certify
from ambrose.synthesis.filters import lead, low_pass, notch, pid_term
from ambrose.synthesis.result import Status, Synthesis

COORDINATES = ("axes", "tilt-translate")


@named_failure("the PID controller")
def pid_synthesis(plant: Plant, settings: PidSettings | None = None, timing: Timing | None = None) -> Synthesis:
    """The PID controller of the settings (None: of the plant's machine), certified on the plant.

    The controller returned is continuous. With a timing (None: that of the settings) the sampled and delayed one is certified
    as well (``certify_as_it_runs``), and both must be stable for the status "verified"; otherwise it is "unstable", which
    is a verdict and raises nothing. Raises InvalidInput for settings that describe no controller.
    """
    settings = plant.machine.controller if settings is None else settings
    if settings is None:
        raise InvalidInput(
            f"machine {plant.machine.name!r} has no controller settings; add a [controller] table or pass PidSettings"
        )
    design = pid_controller(settings, plant.machine)
    certificate = certify(plant, design)
    status = Status.VERIFIED if certificate.stable else Status.UNSTABLE
    result = Synthesis(design, "pid", float("nan"), status, certificate)
    return certify_as_it_runs(plant, result, timing or machine_timing(replace(plant.machine, controller=settings)))


def pid_controller(settings: PidSettings, machine: Machine) -> StateSpace:
    """The continuous controller: inputs err_<axis> [m], outputs u_<axis> [A], axes in the machine's order.

    Coordinates "axes" treat every axis alone; "tilt-translate" splits the displacements into those of the parallel and of the
    conical mode first and scales the conical part by tilt_gain (``tilt_translate``). Raises InvalidInput.
    """
    if settings.coordinates not in COORDINATES:
        raise invalid("coordinates", repr(settings.coordinates), " or ".join(COORDINATES), "choose one of them")
    mixing = None if settings.coordinates == "axes" else tilt_translate(machine, settings.tilt_gain)
    return axes_controller(settings, machine.axes, mixing)


def first_settings(machine: Machine) -> PidSettings:
    """A PID to start from where the machine file has none: twice the magnets' negative stiffness, half critically damped.

    Per axis K_p = 2 k_s / k_i leaves the stiffness k_s; with the rotor's mass shared by the bearings that gives w_0, and
    T_d = 1 / (2 w_0), T_i = 20 / w_0. Nothing is promised of it; tuning starts from there. Raises InvalidInput.
    """
    k_i, k_s = magnet_coefficients(machine, machine.operation.design)
    if not (k_i > 0).all() or not (k_s > 0).all():
        raise InvalidInput(f"machine {machine.name!r} has magnets without force or stiffness; add a [controller] table")
    rate = float(np.sqrt(k_s.mean() * len(machine.bearings) / mass_properties(finite_element_rotor(machine)).mass))
    return PidSettings(tuple(2 * k_s / k_i), integral_time=20 / rate, derivative_time=0.5 / rate)


def axes_controller(settings: PidSettings, axes: tuple[str, ...], mixing: np.ndarray | None = None) -> StateSpace:
    """diag(gain) times ``mixing`` (axes, axes) [-] (None: identity) times the same dynamics on every axis; no machine needed.

    Raises InvalidInput.
    """
    gain = check_finite(settings.gain, "the controller's gain").ravel()
    if gain.size not in {1, len(axes)}:
        raise invalid("the number of gains", gain.size, f"1 or {len(axes)}", f"give one per axis: {', '.join(axes)}")
    gain = np.broadcast_to(gain, len(axes))
    matrix = np.diag(gain) if mixing is None else gain[:, None] * mixing
    dynamics = channel(settings)
    if dynamics.n_states == 0:
        return static_gain(matrix * dynamics.D[0, 0], [f"err_{a}" for a in axes], [f"u_{a}" for a in axes])
    channels = append(*[rename(dynamics, [f"err_{a}"], [f"c_{a}"]) for a in axes])
    return series(channels, static_gain(matrix, outputs=[f"u_{a}" for a in axes]))


def channel(settings: PidSettings) -> StateSpace:
    """The dynamics of one axis for gain 1: PID, then notches, lead and low pass as far as they are set. Raises InvalidInput."""
    result = pid_term(settings.integral_time, settings.derivative_time, settings.derivative_filter)
    for item in settings.notches:
        result = series(result, notch(item.frequency, item.pole_damping, item.zero_damping))
    if settings.lead is not None:
        result = series(result, lead(*settings.lead))
    if settings.low_pass is not None:
        result = series(result, low_pass(settings.low_pass, settings.low_pass_damping))
    return result


def tilt_translate(machine: Machine, tilt_gain: float) -> np.ndarray:
    """V diag(1, 1, tilt_gain, tilt_gain) S^-1, (4, 4) [-]: from sensor displacements to currents, by rigid-body coordinates.

    The rigid rotor's coordinates are the translation of the point midway between the bearings, (t_x, t_y) [m], and the
    displacement at the bearings that its tilting causes, (p_x, p_y) [m]. S maps them to the sensors' readings, from the
    sensors' positions; V gives both bearings equal currents for t and opposite ones for p. With sensors at the bearings and
    tilt_gain 1 the product is the identity. Raises InvalidInput unless the machine has two bearings and two sensor planes.
    """
    gain = float(check_finite(tilt_gain, "tilt_gain"))
    if len(machine.bearings) != 2:
        raise invalid("the number of bearings", len(machine.bearings), "2 for tilt-translate coordinates", "use 'axes'")
    places = np.array([bearing.position for bearing in machine.bearings])
    readings = np.array([next(s.position for s in machine.sensors if s.bearing == b.name) for b in machine.bearings])
    for what, values in (("bearing", places), ("sensor", readings)):
        if abs(values[1] - values[0]) < 1e-6:
            raise invalid(f"the {what} positions", values.tolist(), "apart from each other", "use coordinates 'axes'")
    middle, half = places.mean(), (places[1] - places[0]) / 2
    directions = [_directions(bearing) for bearing in machine.bearings]
    S = np.vstack([np.hstack([d, d * (z - middle) / half]) for d, z in zip(directions, readings, strict=True)])
    V = np.vstack([np.hstack([d, d * (z - middle) / half]) for d, z in zip(directions, places, strict=True)])
    return np.linalg.solve(S.T, (V * [1, 1, gain, gain]).T).T


def _directions(bearing: MagneticBearing) -> np.ndarray:
    """The unit vectors of zeta and eta as rows, in x and y."""
    c, s = np.cos(bearing.angle), np.sin(bearing.angle)
    return np.array([[c, s], [-s, c]])
