"""The reference controller: decentralised PID or filter bank, as vendors ship them, certified on
the plant it is meant for.

With e_y = r - y and u = K e_y (loop diagram in core/lft.py) and the bearing's force f = k_i i + k_s
x, a positive gain pulls the rotor back: it must exceed k_s / k_i before the loop has any stiffness
at all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.core.statespace import StateSpace
from ambrose.law.filters import bank, chain, check_sections, section_matrix
from ambrose.machine.axial import in_file
from ambrose.machine.controller import (
    CONTROLLER_COORDINATES,
    MODES,
    PidSettings,
    Section,
    modal_channels,
)
from ambrose.machine.machine import Machine
from ambrose.machine.validation.controller import channel_problems
from ambrose.model.effects import sensor
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.ports import measured_ports, sensor_turn
from ambrose.model.static_load import magnet_coefficients


def pid_controller(settings: PidSettings, machine: Machine) -> StateSpace:
    """The continuous controller: inputs err_<axis> [m], outputs u_<axis> [A], axes in the machine's
    order.

    Coordinates "axes" treat every actuator's axis alone, its displacement from the sensors at their
    angle; "tilt-translate" splits the displacements into those of the parallel and of the conical
    mode first and scales the conical part by tilt_gain (``modes``). Channels with a chain of their
    own run that instead. Raises InvalidInput.
    """
    if settings.coordinates not in CONTROLLER_COORDINATES:
        raise invalid(
            "coordinates",
            repr(settings.coordinates),
            " or ".join(CONTROLLER_COORDINATES),
            "choose one of them",
        )
    return axes_controller(settings, machine.axes, mixings(settings, machine))


def mixings(settings: PidSettings, machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """From measured displacements to channels, and from channels to currents, [-] (``modes``).

    Axes: sensors' directions are turned to the actuators' (``sensor_turn``), which is the identity
    where they are the same.
    """
    if settings.coordinates == "axes":
        return sensor_turn(machine), np.eye(len(machine.axes))
    into, out = modes(machine)
    known = modal_channels(len(machine.bearings))
    used = [known.index(name) for name in channel_names(settings, machine.axes)]
    return into[used], out[:, used]


def first_settings(machine: Machine) -> PidSettings:
    """A PID to start from where the machine file has none: twice the magnets' negative stiffness,
    half critically damped.

    Per axis K_p = 2 k_s / k_i leaves the stiffness k_s; with the rotor's mass shared by the
    bearings that gives w_0, and T_d = 1 / (2 w_0), T_i = 20 / w_0. Nothing is promised of it;
    tuning starts from there. Raises InvalidInput.
    """
    k_i, k_s = magnet_coefficients(machine, machine.operation.design)
    if not (k_i > 0).all() or not (k_s > 0).all():
        remedy = in_file(machine, "add a [controller] table")
        raise InvalidInput(
            f"machine {machine.name!r} has magnets without force or stiffness; {remedy}"
        )
    # w_0^2 = n k_s/m, of the axis along the shaft n = 1
    mass = mass_properties(finite_element_rotor(machine)).mass
    rate = float(np.sqrt(k_s.mean() * (len(machine.bearings) or 1) / mass))
    return PidSettings(tuple(2 * k_s / k_i), integral_time=20 / rate, derivative_time=0.5 / rate)


def axes_controller(
    settings: PidSettings,
    axes: tuple[str, ...],
    mixing: tuple[np.ndarray, np.ndarray] | None = None,
) -> StateSpace:
    """The channels' chains between two mixings (``mixings``; None: every axis is a channel); no
    machine needed.

    Raises InvalidInput.
    """
    into, out = axes_mixings(settings, axes, mixing)
    chains = [
        chain(gain, [section_matrix(item) for item in sections])
        for gain, sections in channel_chains(settings, axes)
    ]
    return theta_system(bank(chains, into, out), axes)


def axes_mixings(
    settings: PidSettings,
    axes: tuple[str, ...],
    mixing: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """From displacements to channels and back (``mixings``; None: every axis is a channel), with
    gains that are of the axes.
    """
    into, out = (np.eye(len(axes)),) * 2 if mixing is None else mixing
    gains = check_finite(settings.gain, "the controller's gain").ravel()
    return into, gains[:, None] * out if gains.size == len(
        axes
    ) and settings.coordinates != "axes" else out


def theta_system(theta: np.ndarray, axes: tuple[str, ...], dt: float | None = None) -> StateSpace:
    """The controller of Theta = [[D, C], [B, A]] (law/filters.py); dt [s]: it is sampled."""
    m = len(axes)
    parts = theta[m:, m:], theta[m:, :m], theta[:m, m:], theta[:m, :m]
    return StateSpace(*parts, [f"err_{a}" for a in axes], [f"u_{a}" for a in axes], dt)


def channel_chains(
    settings: PidSettings, axes: tuple[str, ...]
) -> list[tuple[float, tuple[Section, ...]]]:
    """Gain and sections of every channel, in their order, all checked. Raises InvalidInput."""
    check_finite(
        [settings.tilt_gain, *settings.gain, *(item.gain for item in settings.channels)],
        "gain and tilt_gain",
    )
    for problem in channel_problems(settings, axes):
        raise InvalidInput(problem)
    common, modal = common_sections(settings), settings.coordinates == "tilt-translate"
    for sections in (common, *(item.sections for item in settings.channels)):
        check_sections(sections)
    chain_of = {
        name: (item.gain, item.sections) for item in settings.channels for name in item.names
    }
    if modal:
        gain = settings.gain[0] if len(settings.gain) == 1 else 1.0
        gains = [gain, gain, *[settings.tilt_gain * gain] * len(axes)]
    else:
        gains = list(settings.gain) * (1 if len(settings.gain) == len(axes) else len(axes))
    return [
        chain_of[name] if name in chain_of else (gains[i], common)
        for i, name in enumerate(channel_names(settings, axes))
    ]


def channel_names(settings: PidSettings, axes: tuple[str, ...]) -> tuple[str, ...]:
    """The channels in their order; those of bending only where they have a chain of their own."""
    if settings.coordinates != "tilt-translate":
        return axes
    named = {name for item in settings.channels for name in item.names}
    return tuple(name for name in modal_channels(len(axes) // 2) if name in MODES or name in named)


def common_sections(settings: PidSettings) -> tuple[Section, ...]:
    """What [controller] says for all channels as a chain: PID, then notches, lead and low pass as
    far as they are set.
    """
    sections = []
    if settings.integral_time is not None or settings.derivative_time is not None:
        sections.append(
            Section(
                "pid", settings.integral_time, settings.derivative_time, settings.derivative_filter
            )
        )
    for item in settings.notches:
        w = item.frequency
        sections.append(
            Section(
                "notch",
                zero_frequency=w,
                zero_damping=item.zero_damping,
                pole_frequency=w,
                pole_damping=item.pole_damping,
            )
        )
    if settings.lead is not None:
        sections.append(
            Section("lead-lag", zero_frequency=settings.lead[0], pole_frequency=settings.lead[1])
        )
    if settings.low_pass is not None:
        sections.append(
            Section("low-pass", frequency=settings.low_pass, damping=settings.low_pass_damping)
        )
    return tuple(sections)


def modes(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """From measured displacements to the rotor's coordinates, (c, 2 n) [-], and from these to
    currents, (2 n, c) [-].

    In the order of ``modal_channels``, n bearings: the translation of the point midway between the
    outermost bearings, (t_x, t_y) [m], and the displacement at these that tilting causes, (p_x,
    p_y) [m]. S maps them to the sensors' readings; its pseudo-inverse gives the rigid motion
    nearest to what is measured. V gives all bearings equal currents for t, and for p in proportion
    to their lever. Of three bearings and more each further channel bend_k is what is left, along
    the k-th of the orthonormal polynomials of degree two and more over the places. All channels
    together, with sensors at the bearings, are the identity; tilt and translate alone are exact for
    every rigid motion. Raises InvalidInput for bearings at one place.
    """
    places = np.array([bearing.position for bearing in machine.bearings])
    sensors = measured_ports(machine)[0::2]
    readings = np.array([port.position for port in sensors])
    for what, values in (("bearing", places), ("sensor", readings)):
        if (np.diff(np.sort(values)) < 1e-6).any():
            raise invalid(
                f"the {what} positions",
                values.tolist(),
                "apart from each other",
                "use coordinates 'axes'",
            )

    # lever: -1 and 1 at the outermost bearings, growing from the first to the last
    middle, half = (
        (places.max() + places.min()) / 2,
        np.ptp(places) / 2 * (1 if places[-1] >= places[0] else -1),
    )

    def shapes(at: np.ndarray, angles: Sequence[float]) -> np.ndarray:
        lever = (at - middle) / (half or 1.0)
        rigid = np.column_stack([np.ones(len(at)), lever])[:, : len(at)]
        # orthonormal polynomials over the places, leading coefficients positive, from degree two
        bent, R = np.linalg.qr(np.vander(lever, len(at), increasing=True))
        whole = np.hstack([rigid, (bent * np.sign(np.diag(R)))[:, 2:]])
        # a place's row, each entry a rotation from x, y into its axes
        return np.vstack(
            [
                np.kron(row, sensor.rotation(-angle))
                for row, angle in zip(whole, angles, strict=True)
            ]
        )

    S = shapes(readings, [port.direction for port in sensors])
    return np.linalg.inv(S), shapes(places, [bearing.angle for bearing in machine.bearings])
