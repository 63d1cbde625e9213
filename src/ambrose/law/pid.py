"""The reference controller: decentralised PID or filter bank, as vendors ship them, certified on
the plant it is meant for.

With e_y = r - y and u = K e_y (loop diagram in core/lft.py) and the bearing's force f = k_i i + k_s
x, a positive gain pulls the rotor back: it must exceed k_s / k_i before the loop has any stiffness
at all.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.core.statespace import StateSpace
from ambrose.machine.machine import Machine
from ambrose.machine.part import (
    CONTROLLER_COORDINATES,
    MODES,
    SECTIONS,
    PidSettings,
    Section,
    modal_channels,
)
from ambrose.machine.validation.controller import channel_problems, section_problems
from ambrose.model.effects import sensor
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.plant import measured_ports, sensor_turn
from ambrose.model.static_load import magnet_coefficients

# Filter banks: sections of a controller as matrices, chained per channel, channels mixed with the
# bearing axes.
#
# Every part is Theta = [[D, C], [B, A]], so that (output, x') = Theta (input, x): sections in
# series are a product of such matrices, each the identity on the others' states. All formulas are
# analytic in their parameters and take complex ones: derivatives are exact by a complex step
# (fixed_order/bank.py).


DERIVATIVE_FILTER = 0.1  # time constant over the derivative's, where none is stated
# of a section's numbers by a part of their keys: factor from SI, unit
SECTION_UNITS = {
    "time": (1e3, "ms"),
    "frequency": (0.5 / np.pi, "Hz"),
    "phase": (180 / np.pi, "deg"),
}


def pid(
    integral_time: Any = None, derivative_time: Any = None, derivative_filter: Any = None
) -> np.ndarray:
    """1 + 1/(T_i s) + T_d s/(eps T_d s + 1), parallel form (Lauridsen 2017, paper P5, eq. 6); times
    [s], None: no such term.
    """
    D = 1.0
    C = list[Any]()
    B = list[Any]()
    A = list[Any]()
    if integral_time is not None:
        A = [0.0]
        B = [1 / integral_time]
        C = [1.0]
    if derivative_time is not None:
        eps = DERIVATIVE_FILTER if derivative_filter is None else derivative_filter
        # T_d s/(eps T_d s + 1) = (1 - corner/(s + corner))/eps
        corner = 1 / (eps * derivative_time)
        A = [*A, -corner]
        B = [*B, corner]
        C = [*C, -1 / eps]
        D = D + 1 / eps
    return (
        np.block([[np.array([[D]]), np.array([C])], [np.array([B]).T, np.diag(A)]])
        if A
        else np.array([[D]])
    )


def notch(
    zero_frequency: Any, zero_damping: Any, pole_frequency: Any, pole_damping: Any
) -> np.ndarray:
    """(s^2/w_z^2 + 2 d_z s/w_z + 1)/(s^2/w_p^2 + 2 d_p s/w_p + 1): 1 at DC, far off (w_p/w_z)^2;
    frequencies [rad/s].
    """
    w, ratio = pole_frequency, pole_frequency / zero_frequency
    # x1' = w x2, x2' = -w x1 - 2 d_p w x2 + w u: both states have the size of the input.
    C = 1 - ratio**2, 2 * ratio * (zero_damping - ratio * pole_damping)
    return np.array([[ratio**2, *C], [0, 0, w], [w, -w, -2 * pole_damping * w]])


def phase_bump(frequency: Any, phase: Any, damping: Any) -> np.ndarray:
    """A notch of one damping d, zeros at w/r and poles at w r, that turns w by ``phase`` [rad]: r -
    1/r = 2 d tan(phase/2).
    """
    # r - 1/r = 2 t with t = d tan(phase/2): r = t + sqrt(1 + t^2)
    turn = damping * np.tan(phase / 2)
    ratio = turn + np.sqrt(1 + turn**2)
    return notch(frequency / ratio, damping, frequency * ratio, damping)


def lead_lag(zero_frequency: Any, pole_frequency: Any) -> np.ndarray:
    """(s/w_z + 1)/(s/w_p + 1): a lead where the zero is slower than the pole [rad/s], else a
    lag.
    """
    # w_p/w_z + (1 - w_p/w_z) w_p/(s + w_p)
    ratio = pole_frequency / zero_frequency
    return np.array([[ratio, 1 - ratio], [pole_frequency, -pole_frequency]])


def low_pass(frequency: Any, damping: Any) -> np.ndarray:
    """w^2/(s^2 + 2 d w s + w^2): unit gain at DC, 1/(2 d) at the frequency w [rad/s]."""
    # x1' = w x2, x2' = -w x1 - 2 d w x2 + w u, output x1
    w = frequency
    return np.array([[0, 1, 0], [0, 0, w], [w, -w, -2 * damping * w]])


def sos(numerator: Sequence[float], denominator: Sequence[float]) -> np.ndarray:
    """(b2 s^2 + b1 s + b0)/(a2 s^2 + a1 s + a0), or with fewer coefficients of lower order."""
    b, a = (
        np.concatenate([np.zeros(3 - len(values)), np.asarray(values, float)])
        for values in (numerator, denominator)
    )

    # leading coefficient of the denominator 1:   b0 + (b - b0 a)/a
    degree = 2 - int(np.flatnonzero(a)[0])
    b, a = b[2 - degree :] / a[2 - degree], a[2 - degree :] / a[2 - degree]
    rest = b[1:] - b[0] * a[1:]

    if degree == 0:
        return np.array([[b[0]]])
    if degree == 1:
        return np.array([[b[0], rest[0]], [1.0, -a[1]]])

    # x1' = w x2, x2' = -(a2/w) x1 - a1 x2 + w u:   x1 = w^2 u/a, x2 = w s u/a.
    # w = sqrt|a2| makes the states the size of the input; a pole at zero leaves |a1| or 1
    w = float(np.sqrt(abs(a[2]))) or abs(a[1]) or 1.0
    return np.array([[b[0], rest[1] / w**2, rest[0] / w], [0, 0, w], [w, -a[2] / w, -a[1]]])


_FORMS: Mapping[str, Callable[..., np.ndarray]] = {
    "pid": pid,
    "notch": notch,
    "phase-bump": phase_bump,
    "lead-lag": lead_lag,
    "low-pass": low_pass,
    "sos": sos,
}


def section_matrix(section: Section, values: Mapping[str, Any] | None = None) -> np.ndarray:
    """Theta of a section, by its own numbers or by ``values`` under some of its keys."""
    numbers = {key: getattr(section, key) for key in SECTIONS[section.kind]}
    return _FORMS[section.kind](**{**numbers, **(values or {})})


def filter_rows(settings: PidSettings) -> list[tuple[str, str, str]]:
    """Channels, kind and parameters of every section of the chains, in everyday units, for a
    table.
    """
    rows = []
    for channel in settings.channels:
        rows.append((", ".join(channel.names), "gain", f"{channel.gain / 1e3:.4g} A/mm"))
        for section in channel.sections:
            rows.append(("", section.kind, section_text(section)))
    return rows


def section_text(section: Section, numbers: Mapping[str, Any] | None = None) -> str:
    """The parameters of a section, or the numbers given under some of its keys, in everyday
    units.
    """
    numbers = (
        {key: getattr(section, key) for key in SECTIONS[section.kind]}
        if numbers is None
        else numbers
    )
    return ", ".join(_told(key, value) for key, value in numbers.items() if value is not None)


def _told(key: str, value: Any) -> str:
    """A parameter with its unit: times in ms, frequencies in Hz, phases in degrees."""
    scale, unit = next((pair for part, pair in SECTION_UNITS.items() if part in key), (1.0, ""))
    numbers = value if isinstance(value, tuple) else [value]
    values = " ".join(f"{scale * number:.4g}" for number in numbers)
    return f"{key.replace('_', ' ')} {values} {unit}".rstrip()


def check_sections(sections: Sequence[Section]) -> None:
    """Raises InvalidInput for the first section that describes no filter."""
    for i, section in enumerate(sections, 1):
        for key, value in section.to_dict().items():
            if key != "kind":
                check_finite(value, f"{key} of a section ({section.kind})")
        for problem in section_problems(f"section {i}", section):
            raise InvalidInput(problem)


def chain(gain: Any, parts: Sequence[np.ndarray]) -> np.ndarray:
    """Theta of sections in series, the first one next to the input, times a gain."""
    result = np.eye(1 + sum(len(part) - 1 for part in parts))
    start = 1
    for part in parts:
        # (signal, x_i') = Theta_i (signal, x_i): row 0 carries the signal to the next section
        at = [0, *range(start, start + len(part) - 1)]
        result[at] = part @ result[at]
        start += len(part) - 1
    result[0] *= gain
    return result


def embedded(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The sections of a chain as matrices of the signal and all states, each the identity on the
    others' states.
    """
    size = 1 + sum(len(part) - 1 for part in parts)
    start = 1
    matrices = []
    for part in parts:
        whole = np.eye(size, dtype=part.dtype)
        at = [0, *range(start, start + len(part) - 1)]
        whole[np.ix_(at, at)] = part
        matrices.append(whole)
        start += len(part) - 1
    return matrices


def bank(chains: Sequence[np.ndarray], into: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Theta of chains side by side between two mixings: into (channels, axes), out (axes,
    channels).
    """
    # chains side by side, block diagonal; u = out (D into e + C x), x' = B into e + A x
    D = np.diag([part[0, 0] for part in chains])
    C, B = (
        sla.block_diag(*rows)
        for rows in ([part[:1, 1:] for part in chains], [part[1:, :1] for part in chains])
    )
    A = sla.block_diag(*[part[1:, 1:] for part in chains])
    return np.block([[out @ D @ into, out @ C], [B @ into, A]])


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
        remedy = machine.in_file("add a [controller] table")
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
    """The controller of Theta = [[D, C], [B, A]] (law/pid.py); dt [s]: it is sampled."""
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
