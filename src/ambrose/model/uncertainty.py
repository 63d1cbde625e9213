"""Tolerances -> (M, Delta): which physical parameter becomes which real block.

A changed parameter is a feedback around the plant: displacement or velocity at a port, times the
change, is a force at that port. The nominal plant already carries all ports (also through the
reduction's T_L and T_R), so every block is a row of signals: w enters a force sum (or an amplifier
state), z = half-width * signal leaves. delta = +1 is the upper end of the tolerance. A parameter
that acts in several places (k and -k; one bandwidth for all amplifiers) is one repeated block.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.lft import GeneralizedPlant, RealBlock, close_uncertainty
from ambrose.core.statespace import StateSpace, append, connect, rename, select, static_gain
from ambrose.machine.attachment import attached
from ambrose.machine.axial import AxialMachine, in_file
from ambrose.machine.description import Amplifier, Tolerance
from ambrose.machine.parameters import BENDING, Parameter, find_uncertain
from ambrose.machine.seals import Seal
from ambrose.model.assemble import (
    force_sums,
    magnets,
    mode_ports,
    plant_inputs,
    plant_outputs,
    rotor_inputs,
    seal_coefficients,
    seal_model,
)
from ambrose.model.axial.magnet import at_point
from ambrose.model.axial.wiring import SIDES
from ambrose.model.effects import amplifier as amplifiers
from ambrose.model.effects import seal_rational, sensor
from ambrose.model.effects.rotor import free_modes
from ambrose.model.effects.seal_rational import has_states
from ambrose.model.plant import Plant
from ambrose.model.static_load import magnet_coefficients, operating_magnets

NEXT = "next"


@dataclass(frozen=True, slots=True)
class Channel:
    """One occurrence of a parameter: nominal value * (gradient . signals) acts on ``target``.

    target: "F_<port>" (a force sum), "x_<axis>_<state>" (an amplifier's state derivative) or ""
    (nothing). gradient: signal -> factor; the signal NEXT is what the parameter's next channel
    gives, for a parameter that enters by its square.
    """

    target: str
    nominal: float
    gradient: tuple[tuple[str, float], ...]


def uncertain(plant: Plant, tolerances: Sequence[Tolerance] | None = None) -> GeneralizedPlant:
    """The plant with its uncertain parameters pulled out: one RealBlock per tolerance, named by the
    parameter's path.

    w and z are the blocks' signals, u all inputs and y all outputs of ``plant.system``. Default:
    the machine's tolerances. The centre of the box is the plant as it is, also where it is
    perturbed; the widths are those of the nominal values. Raises InvalidInput for a path that leads
    nowhere, and for a relative tolerance of a parameter whose value is zero.
    """
    machine = plant.machine
    tolerances = machine.tolerances if tolerances is None else tuple(tolerances)
    if not tolerances:
        remedy = in_file(machine, "add a [[tolerance]] with parameter and relative")
        raise InvalidInput(f"machine {machine.name!r} has no tolerance; {remedy}")
    rows, sums = [], force_sums(machine)
    moved: list[RealBlock] = []
    blocks: list[RealBlock] = []
    members = [(offset, f"offset {offset.parameter}", moved) for offset, _ in plant.offsets]

    # Per occurrence z = width * gradient . signals, and w = delta z joins the target's sum. Offsets
    # that the plant has come first.
    for tolerance, label, group in [
        *members,
        *((tolerance, tolerance.parameter, blocks) for tolerance in tolerances),
    ]:
        places = channels(plant, tolerance.parameter)
        for j, (channel, width) in enumerate(
            zip(places, _half_widths(tolerance, places), strict=True)
        ):
            name, follows = f"{label}_{j + 1}", f"w_{label}_{j + 2}"
            gradient = {
                follows if signal == NEXT else signal: width * factor
                for signal, factor in channel.gradient
            }
            rows.append((f"z_{name}", gradient))
            if channel.target:
                sums.setdefault(channel.target, []).append(f"w_{name}")
        group.append(RealBlock(label, len(places)))
    w = [f"w_{name[2:]}" for name, _ in rows]
    z = [name for name, _ in rows]
    k_i = magnet_coefficients(machine, plant.point)[0]
    drive = open_amplifier(machine.amplifier, machine.axes, k_i)

    # inputs that no parameter acts on get empty sums
    idle = [
        *(name for name in drive.inputs if name.startswith("x_")),
        *(f"F_{name}" for name in mode_ports(machine)),
    ]
    unused: dict[str, list[str]] = {name: [] for name in idle if name not in sums}
    inner = [
        rename(plant.rotor, rotor_inputs(machine)),
        drive,
        magnets(machine, plant.point),
        sensor.linearised(machine.sensor_pairs, machine.axes),
    ]
    u, y = plant_inputs(machine.axes, plant.ports), plant_outputs(machine.axes, plant.ports)
    gain = _rows_as_gain(rows)
    taps = {name: [name.removeprefix("port ")] for name in gain.inputs}
    system = connect(
        [*inner, gain], inputs=[*w, *u], outputs=[*z, *y], sums={**sums, **unused, **taps}
    )

    # the offsets' blocks closed with their values; those of the tolerances stay open
    if moved:
        around = GeneralizedPlant(system, w, u, z, y, moved)
        system = close_uncertainty(
            around, {f"offset {offset.parameter}": delta for offset, delta in plant.offsets}
        )
        w, z = w[around.n_w_blocks :], z[around.n_z_blocks :]
    return GeneralizedPlant(system, w, u, z, y, blocks)


def perturbed(
    plant: Plant, delta: Mapping[str, float], tolerances: Sequence[Tolerance] | None = None
) -> Plant:
    """The plant with parameters moved within their tolerances: delta maps the path to -1..1
    (absent: where the plant has it).

    The offsets are kept in the plant, so that its reduction and its uncertainty are those of the
    perturbed plant. The reduction's basis stays the nominal one. Raises InvalidInput for a path
    without tolerance.
    """
    return family(plant, delta, tolerances)(delta)


def family(
    plant: Plant, paths: Collection[str], tolerances: Sequence[Tolerance] | None = None
) -> Callable[[Mapping[str, float]], Plant]:
    """``perturbed`` of one plant for many values of the same parameters ``paths``: what the members
    share is made once.
    """
    tolerances = plant.machine.tolerances if tolerances is None else tuple(tolerances)
    kept = {
        offset.parameter: (offset, value)
        for offset, value in plant.offsets
        if offset.parameter not in paths
    }
    nominal = replace(plant, offsets=())
    every = [
        *(t for t in tolerances if t.parameter not in kept),
        *(offset for offset, _ in kept.values()),
    ]
    model = uncertain(nominal, every)

    def member(delta: Mapping[str, float]) -> Plant:
        values = {**{path: value for path, (_, value) in kept.items()}, **delta}
        system = close_uncertainty(model, values)
        offsets = tuple((t, float(values[t.parameter])) for t in every if values.get(t.parameter))
        return replace(
            plant, system=select(system, plant.system.inputs, plant.system.outputs), offsets=offsets
        )

    return member


def in_tolerances(delta: Mapping[str, float]) -> str:
    """Offsets in words, each in units of its tolerance's half width: "seal.center.k +1 (in
    tolerances)".
    """
    return ", ".join(f"{name} {value:+.3g}" for name, value in delta.items()) + " (in tolerances)"


def with_offsets_of(plant: Plant, source: Plant) -> Plant:
    """A nominal plant with the parameter offsets of another one of the same machine."""
    if not source.offsets:
        return plant
    return perturbed(
        plant, {t.parameter: delta for t, delta in source.offsets}, [t for t, _ in source.offsets]
    )


def tolerances_around(
    plant: Plant, tolerances: Sequence[Tolerance] | None = None
) -> tuple[Tolerance, ...]:
    """The tolerances (None: the machine's) that hold around the plant's operating point.

    Left out are those that the machine file gives for other points (``around``), and relative ones
    of what is zero here, such as a seal without pressure. Raises InvalidInput for a path that leads
    nowhere.
    """
    chosen = plant.machine.tolerances if tolerances is None else tuple(tolerances)
    local = (item for item in chosen if not item.around or plant.point.label in item.around)
    return tuple(
        t
        for t in local
        if t.relative is None or any(c.nominal != 0 for c in channels(plant, t.parameter))
    )


def not_varied(plant: Plant) -> tuple[str, ...]:
    """The machine's tolerances that do not hold around the plant's operating point, each with the
    reason, in words.
    """
    label, tolerances = plant.point.label or "the point", tolerances_around(plant)
    names = []
    for item in plant.machine.tolerances:
        if item not in tolerances:
            elsewhere = item.around and plant.point.label not in item.around
            why = f"given for {', '.join(item.around)} only" if elsewhere else "zero here"
            names.append(f"{label}: {item.parameter} ({why})")
    return tuple(names)


def _half_widths(tolerance: Tolerance, places: Sequence[Channel]) -> list[float]:
    if tolerance.absolute is not None:
        # The same absolute change in every occurrence, with the sign that the occurrence gives the
        # parameter.
        return [tolerance.absolute for _ in places]
    relative = tolerance.relative
    if relative is None:
        raise invalid(
            f"tolerance {tolerance.parameter}",
            "without width",
            "relative or absolute",
            "give one of the two",
        )
    if all(channel.nominal == 0 for channel in places):
        raise invalid(
            f"the nominal value of {tolerance.parameter}",
            0,
            "non-zero for a relative tolerance",
            "give an absolute one",
        )
    return [relative * channel.nominal for channel in places]


def channels(plant: Plant, path: str) -> list[Channel]:
    """Every place where the parameter at ``path`` acts; raises InvalidInput naming the part of the
    path that is unknown.
    """
    parameter = find_uncertain(plant.machine, path)
    return _FORMS.get(parameter.table, _effect_channels)(plant, parameter)


# Signs of the seal's force on the rotor, f = -([[K, k], [-k, K]] q + [[C, c], [-c, C]] q'): entry
# -> (row, column, sign).
_SEAL_ENTRIES = {
    "xx": ("x", "x", -1.0),
    "yy": ("y", "y", -1.0),
    "xy": ("x", "y", -1.0),
    "yx": ("y", "x", 1.0),
}


def _seal_channels(plant: Plant, parameter: Parameter) -> list[Channel]:
    letter, name = parameter.quantity, parameter.name
    item = next(item for item in plant.machine.seals if item.name == name)
    if letter == "pressure":
        return _pressure_channels(plant, item)
    if has_states(item) and plant.point.seal_pressure > 0:
        nominal, factors = _impedance(plant, item, letter)
    else:
        nominal = float(getattr(seal_coefficients(item, plant.point), letter))
        factors = {"q" if letter in {"K", "k"} else "qdot": 1.0}
    both = ["xx", "yy"] if letter in {"K", "C"} else ["xy", "yx"]
    entries = [
        _SEAL_ENTRIES[entry] for entry in ([parameter.component] if parameter.component else both)
    ]
    return [
        Channel(
            f"F_{name}_{row}",
            nominal,
            tuple((f"{kind}_{name}_{column}", sign * x) for kind, x in factors.items()),
        )
        for row, column, sign in entries
    ]


def _pressure_channels(plant: Plant, item: Seal) -> list[Channel]:
    """The pressure [Pa] of a seal: all that follows it as one force per direction, K x + k y + C x'
    + c y' per Pa, two signals.

    ``find_uncertain`` made sure that the force is a straight line over the pressure.
    """
    name, pressure = item.name, plant.point.seal_pressure
    if has_states(item):
        if pressure == 0:
            raise invalid(
                f"the pressure of seal {name} with states",
                0,
                "positive for a tolerance",
                "centre it on a point under pressure",
            )
        # through the origin: K/p, k/p, C/p, c/p and the states' forces over p
        s = seal_model(plant.machine, item, plant.point).static
        direct = {"q": s.K / pressure, "qdot": s.C / pressure, "d": 1 / pressure}
        cross = {"q": s.k / pressure, "qdot": s.c / pressure, "e": 1 / pressure}
    else:
        # slope between the ends of the table, or from zero to the reference pressure
        axes = {} if item.table is None else dict(item.table.axes)
        ends = axes.get("pressure", (0.0, item.reference_pressure or 1.0))
        low, high = (
            seal_coefficients(item, replace(plant.point, seal_pressure=end))
            for end in (ends[0], ends[-1])
        )
        slope = {
            x: (getattr(high, x) - getattr(low, x)) / (ends[-1] - ends[0])
            for x in ("K", "k", "C", "c")
        }
        direct, cross = {"q": slope["K"], "qdot": slope["C"]}, {"q": slope["k"], "qdot": slope["c"]}
    gradients: dict[str, list[tuple[str, float]]] = {"x": [], "y": []}
    for row, column, sign in _SEAL_ENTRIES.values():
        factors = direct if row == column else cross
        gradients[row] += [
            (f"{kind}_{name}_{column}", sign * factor) for kind, factor in factors.items()
        ]
    return [
        Channel(f"F_{name}_{row}", pressure, tuple(gradient)) for row, gradient in gradients.items()
    ]


def _impedance(plant: Plant, item: Seal, letter: str) -> tuple[float, dict[str, float]]:
    """Nominal value and factors on the signals of a seal with states.

    K, k are the static stiffness H(0); C, c scale H(s) - H(0), all that comes with motion. Damping
    and the stiffness that rises with frequency are one mechanism and cannot change alone (Kramers
    and Kronig). A C or c of the size of the coefficient at the whirl frequency is the whole of H(s)
    - H(0).
    """
    model = seal_model(plant.machine, item, plant.point)
    cross = letter in {"k", "c"}
    still, lacking = (pair[cross] for pair in seal_rational.parts(model))
    if letter in {"K", "k"}:
        return still, {"q": 1.0}
    nominal = float(getattr(seal_coefficients(item, plant.point), letter))
    slope = model.static.c if cross else model.static.C
    # d (s - A)^-1 b + lacking + C_0 s, in units of the nominal C or c
    unit = nominal if nominal else 1.0
    return nominal, {"e" if cross else "d": 1 / unit, "q": lacking / unit, "qdot": slope / unit}


def _bearing_channels(plant: Plant, parameter: Parameter) -> list[Channel]:
    magnets = zip(
        plant.machine.bearings,
        operating_magnets(plant.machine, plant.point.bias_current),
        strict=True,
    )
    coefficients = next(
        magnet.coefficients for bearing, magnet in magnets if bearing.name == parameter.name
    )
    if parameter.quantity != "force_per_current":
        return _pair(parameter, getattr(coefficients, parameter.quantity), "q", 1.0)
    found = _pair(parameter, coefficients.force_per_current, "i", 1.0)
    drive = plant.machine.amplifier
    if drive.order == amplifiers.LOOP:
        # the back-EMF is half of it, too: i' = ... - k_i/(2 L) x'
        by_motion = float(amplifiers.back_emf(drive, [1.0])[0])
        axes = [channel.target.removeprefix("F_") for channel in found]
        found += [
            Channel(f"x_{axis}_0", channel.nominal, ((f"qdot_{axis}", -by_motion),))
            for axis, channel in zip(axes, found, strict=True)
        ]
    return found


def _thrust_channels(plant: Plant, parameter: Parameter) -> list[Channel]:
    """k_i i or k_s x of both magnets, each side's share of it before its core."""
    assert isinstance(plant.machine, AxialMachine)
    (axis,), at = plant.axes, at_point(plant.machine, plant.point)
    if parameter.quantity == "core_scale":
        # (R_0 + (1 + d) c sqrt(s)) phi = v: as v less d times what the eddy currents take
        scale = plant.machine.thrust.core_scale
        taken = [name for name in plant.rotor.outputs if name.startswith("core_")]
        return [Channel(name.removeprefix("core_"), scale, ((name, -1 / scale),)) for name in taken]
    by_current = parameter.quantity == "force_per_current"
    parts = [
        item.force_per_current if by_current else item.stiffness for item in (at.left, at.right)
    ]
    return [
        Channel(
            f"{side}_{axis}",
            sum(parts),
            ((f"{'i' if by_current else 'q'}_{axis}", part / sum(parts)),),
        )
        for side, part in zip(SIDES, parts, strict=True)
    ]


def _effect_channels(plant: Plant, parameter: Parameter) -> list[Channel]:
    """Where a quantity of a registered effect acts, along the axis that the path names or all."""
    effect, item = next(
        (effect, part)
        for effect, part in attached(plant.machine)
        if effect.table == parameter.table and part.name == parameter.name
    )
    return [
        Channel(f"F_{action.port}", action.nominal, action.gradient)
        for action in effect.actions(item, plant.point, parameter.quantity)
        if parameter.component in {"", action.port.rpartition("_")[2]}
    ]


def _rotor_channels(plant: Plant, parameter: Parameter) -> list[Channel]:
    """A free bending mode in both planes: its frequency w, force -(w^2) q on the mode, or its
    damping ratio, -2 zeta w q'.

    (w + D)^2 - w^2 = (2 w + D) D is two channels: D q, and D (2 w q + D q). The damping coefficient
    2 zeta w keeps its w.
    """
    ports = [f"{parameter.name}_{plane}" for plane in "xy"]
    if f"f_{ports[0]}" not in plant.rotor.inputs:
        raise InvalidInput(
            f'parameter "{parameter.path}" has no port in this plant; name it in a [[tolerance]] '
            "of the machine file"
        )
    modes = free_modes(plant.rotor_model, int(parameter.name.removeprefix(BENDING)))
    omega = float(modes.frequencies[-1])
    if parameter.quantity == "damping":
        ratio = float(modes.damping_ratios(plant.machine)[-1])
        return [Channel(f"F_{p}", ratio, ((f"qdot_{p}", -2 * omega),)) for p in ports]
    return [
        channel
        for p in ports
        for channel in (
            Channel(f"F_{p}", omega, ((f"q_{p}", -2 * omega), (NEXT, -1.0))),
            Channel("", omega, ((f"q_{p}", 1.0),)),
        )
    ]


def _pair(parameter: Parameter, values: Sequence[float], signal: str, sign: float) -> list[Channel]:
    """The zeta and eta channels of an attachment, or the one that the path names."""
    return [
        Channel(
            f"F_{parameter.name}_{axis}",
            float(value),
            ((f"{signal}_{parameter.name}_{axis}", sign),),
        )
        for axis, value in zip(("zeta", "eta"), values, strict=True)
        if parameter.component in {"", axis}
    ]


def _rows_as_gain(rows: Sequence[tuple[str, Mapping[str, float]]]) -> StateSpace:
    """The z signals as a static gain on the plant's signals, its inputs called "port <signal>"."""
    signals = sorted({signal for _, row in rows for signal in row})
    gain = np.array([[row.get(signal, 0.0) for signal in signals] for _, row in rows])
    return static_gain(gain, [f"port {signal}" for signal in signals], [name for name, _ in rows])


# Each amplifier is a sum of terms: parameter * (a . x + b u) added to the derivative of one state;
# the last is the current.
def _amplifier_terms(
    amplifier: Amplifier,
) -> tuple[int, list[tuple[str, float, int, tuple[float, ...], float]]]:
    """Number of states and the terms (parameter, value, state, a, b) of one axis; the current is
    state 0.
    """
    if amplifier.order == "first":
        return 1, [("bandwidth", amplifier.bandwidth or 0.0, 0, (-1.0,), 1.0)]
    if amplifier.order == "twice-first":
        return 2, [
            ("eddy_bandwidth", amplifier.eddy_bandwidth or 0.0, 0, (-1.0, 1.0), 0.0),
            ("bandwidth", amplifier.bandwidth or 0.0, 1, (0.0, -1.0), 1.0),
        ]
    if amplifier.order == "second":
        w = amplifier.natural_frequency or 0.0
        return 2, [  # i' = w p, p' = w (u - i) - d p
            ("natural_frequency", w, 0, (0.0, 1.0), 0.0),
            ("natural_frequency", w, 1, (-1.0, 0.0), 1.0),
            ("damping", amplifier.damping or 0.0, 1, (0.0, -1.0), 0.0),
        ]
    if amplifier.order == amplifiers.LOOP:
        w, decay = amplifier.bandwidth or 0.0, amplifiers.decay(amplifier)
        return 2, [  # i' = w (u - i) + R/L (s - i), s' = w (u - i)
            ("bandwidth", w, 0, (-1.0, 0.0), 1.0),
            ("bandwidth", w, 1, (-1.0, 0.0), 1.0),
            ("", decay, 0, (-1.0, 1.0), 0.0),
        ]
    return 0, []


def open_amplifier(
    amplifier: Amplifier, axes: Sequence[str], force_per_current: np.ndarray
) -> StateSpace:
    """All amplifiers with their state derivatives open: inputs u_<axis>, x_<axis>_<state>, of a
    "current-loop" qdot_<axis>; outputs i_<axis> and the terms t_<axis>_<term> that the parameters
    multiply.
    """
    moving = amplifiers.back_emf(amplifier, force_per_current)
    n, terms = _amplifier_terms(amplifier)
    parts = []
    for axis, by_motion in zip(axes, moving, strict=True):
        if n == 0:
            parts.append(static_gain([[1.0]], [f"u_{axis}"], [f"i_{axis}"]))
            continue
        # nominal terms close the states; x_<state> adds to their derivatives
        A, B = np.zeros((n, n)), np.hstack([np.zeros((n, 1)), np.eye(n)])
        for _, value, state, a, b in terms:
            A[state] += value * np.array(a)
            B[state, 0] += value * b
        C = np.vstack([np.eye(n)[:1], *[np.array(a)[None] for *_, a, _ in terms]])
        D = np.zeros((1 + len(terms), 1 + n))
        D[1:, 0] = [b for *_, b in terms]
        names = [f"u_{axis}", *(f"x_{axis}_{k}" for k in range(n))]
        if amplifier.order == amplifiers.LOOP:
            B = np.hstack([B, [[-by_motion], [0.0]]])
            D = np.hstack([D, np.zeros((len(D), 1))])
            names.append(f"qdot_{axis}")
        parts.append(
            StateSpace(
                A, B, C, D, names, [f"i_{axis}", *(f"t_{axis}_{k}" for k in range(len(terms)))]
            )
        )
    return append(*parts)


def _amplifier_channels(plant: Plant, parameter: Parameter) -> list[Channel]:
    _, terms = _amplifier_terms(plant.machine.amplifier)
    return [
        Channel(f"x_{axis}_{state}", value, ((f"t_{axis}_{k}", 1.0),))
        for axis in plant.axes
        for k, (name, value, state, *_) in enumerate(terms)
        if name == parameter.quantity
    ]


_FORMS = {
    "seal": _seal_channels,
    "bearing": _bearing_channels,
    "amplifier": _amplifier_channels,
    "rotor": _rotor_channels,
    "thrust_bearing": _thrust_channels,
}
