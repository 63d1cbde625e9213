"""Tolerances -> (M, Delta): which physical parameter becomes which real block.

A changed parameter is a feedback around the plant: displacement or velocity at a port, times the
change, is a force at that port. The nominal plant already carries all ports (also through the
reduction's T_L and T_R), so every block is a row of signals: w enters a force sum (or an amplifier
state), z = half-width * signal leaves. delta = +1 is the upper end of the tolerance. A parameter
that acts in several places (k and -k; one bandwidth for all amplifiers) is one repeated block.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, NumericalFailure, check_shape, invalid, named_failure
from ambrose.core.frequency import largest_gain
from ambrose.core.lft import GeneralizedPlant, RealBlock, close_uncertainty
from ambrose.core.mechanical import SecondOrder, project, to_statespace, velocity_scales
from ambrose.core.statespace import (
    StateSpace,
    append,
    balance_matrix as balance,
    connect,
    rename,
    select,
    static_gain,
)
from ambrose.machine.attachment import attached
from ambrose.machine.description import Amplifier, Tolerance
from ambrose.machine.parameters import BENDING, Parameter, find_uncertain
from ambrose.machine.part import Seal
from ambrose.model.assemble import (
    attached_rotor,
    attached_statespace,
    bending_modes_of,
    force_sums,
    magnets,
    mode_ports,
    part_states,
    plant_inputs,
    plant_outputs,
    rotor_inputs,
    seal_coefficients,
    seal_model,
    state_scales,
    wire,
    with_states,
)
from ambrose.model.effects import amplifier as amplifiers, seal_rational, sensor
from ambrose.model.effects.rotor import free_modes
from ambrose.model.effects.seal_rational import has_states
from ambrose.model.effects.stations import foundation
from ambrose.model.plant import Plant, top_speed
from ambrose.model.static_load import each_magnet, magnet_coefficients, operating_magnets

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
        remedy = machine.in_file("add a [[tolerance]] with parameter and relative")
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
    tolerances = plant.machine.tolerances if tolerances is None else tuple(tolerances)
    kept = {
        offset.parameter: (offset, value)
        for offset, value in plant.offsets
        if offset.parameter not in delta
    }
    every = [
        *(t for t in tolerances if t.parameter not in kept),
        *(offset for offset, _ in kept.values()),
    ]
    values = {**{path: value for path, (_, value) in kept.items()}, **delta}
    system = close_uncertainty(uncertain(replace(plant, offsets=()), every), values)
    offsets = tuple((t, float(values[t.parameter])) for t in every if values.get(t.parameter))
    return replace(
        plant, system=select(system, plant.system.inputs, plant.system.outputs), offsets=offsets
    )


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
    machine, (axis,) = plant.machine, plant.axes
    if parameter.quantity == "core_scale":
        # (R_0 + (1 + d) c sqrt(s)) phi = v: as v less d times what the eddy currents take
        scale = machine.thrust.core_scale
        taken = [name for name in plant.rotor.outputs if name.startswith("core_")]
        return [
            Channel(f"F_{name.removeprefix('core_')}", scale, ((name, -1 / scale),))
            for name in taken
        ]
    by_place = parameter.quantity != "force_per_current"
    parts = each_magnet(machine, plant.point)[int(by_place), 0].tolist()
    return [
        Channel(f"F_{name}", sum(parts), ((f"{'iq'[by_place]}_{axis}", part / sum(parts)),))
        for name, part in zip(machine.magnets, parts, strict=True)
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
        # c q' and the circulatory k q of the other plane go with the ratio, as one; at zero as what
        # a ratio of 1 would be
        ratio = float(modes.damping_ratios(plant.machine)[-1])
        c, k = (float(of[-1]) for of in modes.damping(plant.machine, plant.point.speed))
        share = plant.machine.rotating_share
        brakes, drives = (
            (c / ratio, k / ratio) if ratio else (2 * omega, 2 * omega * share * plant.point.speed)
        )
        return [
            Channel(
                f"F_{p}",
                ratio,
                ((f"qdot_{p}", -brakes), *([(f"q_{other}", turn * drives)] if drives else [])),
            )
            for p, other, turn in zip(ports, reversed(ports), (-1.0, 1.0), strict=True)
        ]
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


# Reduction to rigid-body and a few bending modes, with real transforms and an error bound.
#
# Route: the lowest mass-orthonormal modes of the free rotor (symmetric eigenproblem) give a small
# intermediate model; an ordered real Schur form and one Sylvester equation then split off the slow
# invariant subspace (Bavely & Stewart 1979). No mode is paired with another and nothing becomes
# complex: the rigid-body poles on magnetic bearings are real or nearly repeated.


# bending modes per plane beyond those asked for: rigid-body poles good to 3e-4 rad/s, see tests
_EXTRA_MODES = 24


@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """A reduced plant and how it came about.

    plant: same type as the full one. T_L (r, n), T_R (n, r): x_r = T_L x, x = T_R x_r, T_L T_R = I,
    for the rotor's state x of ``assemble``; states of seals are kept as they are. ``residual``:
    what was cut off the rotor (with the constants of such seals), in decoupled first-order form;
    see ``error_bound``.
    """

    plant: Plant
    T_L: np.ndarray
    T_R: np.ndarray
    residual: StateSpace
    static_correction: bool

    def error_bound(self, omega: np.ndarray) -> np.ndarray:
        """Bound (w,) on the largest singular value of the rotor's displacement error at omega (w,)
        [rad/s], in m/N.

        The sum of the cut-off modes' own contributions, each pair of conjugate poles taken
        together; modes beyond the intermediate model enter by their static compliance only
        (exactly, when the static correction is on).
        """
        omega = check_shape(omega, "omega", "(w,)")
        # without velocities and the ports of single modes: displacements per force
        mode_suffixes = tuple(f"_{name}" for name in mode_ports(self.plant.machine))
        keep, used = (
            [
                i
                for i, name in enumerate(names)
                if not name.startswith("qdot_")
                and not (mode_suffixes and name.endswith(mode_suffixes))
            ]
            for names in (self.residual.outputs, self.residual.inputs)
        )
        residual = self.residual
        return modal_sum_bound(
            residual.A, residual.B[:, used], residual.C[keep], omega, self.static_correction
        )


def reduce(plant: Plant, bending_modes: int = 0, static_correction: bool = True) -> Plant:
    """The plant with its rotor reduced to the rigid-body modes and ``bending_modes`` per plane; see
    ``modal_reduction``.
    """
    return modal_reduction(plant, bending_modes, static_correction).plant


def reduce_from(plant: Plant, bending_modes: int) -> Plant:
    """``reduce`` with so many bending modes per plane, or up to three more where that would part
    modes that coincide. Where all do, as the slow poles of modes that Rayleigh's beta overdamps
    (near 1/beta), ``free_mode_reduction`` with the compliance of the others.
    """
    available = bending_modes_of(plant.rotor_model)
    for count in range(bending_modes, min(bending_modes + 3, available) + 1):
        with suppress(NumericalFailure):
            return reduce(plant, count)
    return free_mode_reduction(plant, min(bending_modes, available), residual=True)


def default_bending_modes(plant: Plant) -> int:
    """How many bending modes per plane matter: those up to twice the top speed or the amplifier's
    fastest lag, and one more.
    """
    if not plant.machine.lateral:
        return 0
    amplifier = plant.machine.amplifier
    lags = [
        rate
        for rate in (amplifier.bandwidth, amplifier.eddy_bandwidth, amplifier.natural_frequency)
        if rate is not None
    ]
    highest = max(2 * top_speed(plant.machine), *lags, 0.0)
    available = bending_modes_of(plant.rotor_model)
    bending = free_modes(plant.rotor_model, available).frequencies[4::2]
    return min(int((bending <= highest).sum()) + 1, available)


@named_failure("the reduction of the plant")
def modal_reduction(
    plant: Plant, bending_modes: int = 0, static_correction: bool = True
) -> Reduction:
    """Split off the slow modes of the rotor on its bearings, seals and couplings: 8 + 4
    bending_modes states, and the seals'.

    One more for every pole of a support that is slower than the first bending mode that is cut off.

    Offsets of a perturbed plant are applied to the reduced one; transforms and residual are those
    of the nominal rotor. ``static_correction`` adds the static compliance of all that was cut off
    as a feedthrough from force to displacement. Raises InvalidInput for more bending modes than the
    mesh has, NumericalFailure when the poles to keep are not separated from the rest.
    """
    machine, point = plant.machine, plant.point
    if not machine.lateral:
        return _whole(plant)
    rotor = plant.rotor_model
    available = bending_modes_of(rotor)
    if bending_modes not in range(available + 1):
        raise invalid(
            "bending_modes",
            bending_modes,
            f"a whole number from 0 to {available}",
            "refine the mesh or keep fewer modes",
        )

    # the lowest modes and the supports
    full = attached_rotor(machine, point, rotor)
    # all other modal coordinates are held at zero
    inner = 4 + 2 * min(available, bending_modes + _EXTRA_MODES)
    base = foundation(machine)
    kept = np.r_[:inner, full.n - len(base) : full.n]
    second_order = project(full, np.eye(full.n)[:, kept])
    small = to_statespace(second_order, point.speed)

    # A support's pole that is slower than the first mode cut off is kept: s^2 + d s + k = 0.
    fastest = (
        np.inf
        if bending_modes == available
        else free_modes(rotor, bending_modes + 1).frequencies[-1]
    )
    support_poles = [
        np.roots([1.0, d, k]) for d, k in zip(base.damping, base.stiffness, strict=True)
    ]
    slower = int((np.abs(support_poles) < fastest).sum())

    # slow and fast part, each x_r' = L A R x_r + L B u, y = C R x_r + D u
    T_L, T_R, L_res, R_res = split_slow(small.A, 8 + 4 * bending_modes + slower)
    slow, fast = (
        StateSpace(L @ small.A @ R, L @ small.B, small.C @ R, small.D, small.inputs, small.outputs)
        for L, R in ((T_L, T_R), (L_res, R_res))
    )
    reduced = with_static_correction(slow, full) if static_correction else slow

    # transforms from and to the full rotor's own states; those of seals and effects as they are
    lift_L, lift_R = _lift(second_order, full, state_scales(machine, rotor), kept)
    unchanged = np.eye(part_states(machine, point))
    left, right = sla.block_diag(T_L @ lift_L, unchanged), sla.block_diag(lift_R @ T_R, unchanged)
    reduced = with_states(machine, point, reduced)
    result = with_offsets_of(wire(machine, point, reduced, bending_modes), plant)
    return Reduction(result, left, right, fast, static_correction)


def _whole(plant: Plant) -> Reduction:
    """The plant of the axis along the shaft, of which nothing is cut off."""
    unchanged = np.eye(plant.rotor.n_states)
    nothing = StateSpace(
        np.zeros((0, 0)),
        np.zeros((0, len(plant.rotor.inputs))),
        np.zeros((len(plant.rotor.outputs), 0)),
        np.zeros(plant.rotor.D.shape),
        plant.rotor.inputs,
        plant.rotor.outputs,
    )
    return Reduction(replace(plant, bending_modes=0), unchanged, unchanged, nothing, True)


def with_static_correction(slow: StateSpace, full: SecondOrder) -> StateSpace:
    """``slow`` with the feedthrough that makes its displacement outputs exact at zero frequency."""
    D = slow.D.copy()
    count = len(full.outputs)
    # at s = 0 the full model has C K^-1 B, the slow one -C A^-1 B
    D[:count] += full.C @ np.linalg.solve(full.stiffness, full.B) + slow.C[
        :count
    ] @ np.linalg.solve(slow.A, slow.B)
    return StateSpace(slow.A, slow.B, slow.C, D, slow.inputs, slow.outputs)


def free_mode_reduction(plant: Plant, bending_modes: int = 0, residual: bool = False) -> Plant:
    """Galerkin projection on the free rotor's modes: states that depend on neither speed nor
    bearing nor seal (for scheduling).

    They are those of ``assemble``, see ``assemble.attached_statespace``, of the modes kept;
    residual: and of what the others yield at the ports, so that the compliance is that of all.
    """
    machine, point = plant.machine, plant.point
    if not machine.lateral:
        return _whole(plant).plant
    closed = attached_statespace(machine, point, plant.rotor_model, bending_modes, residual)
    return with_offsets_of(wire(machine, point, closed, bending_modes), plant)


def split_slow(A: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Real block-diagonalisation of A (n, n) into its ``count`` slowest poles (by modulus) and the
    rest.

    Returns T_L (count, n), T_R (n, count), L_res (n - count, n), R_res (n, n - count): ``[T_L;
    L_res] [T_R R_res] = I``.
    """
    n = A.shape[0]
    A, t = balance(A)
    modulus = np.sort(np.abs(np.linalg.eigvals(A)))
    if count < n and modulus[count] < 1.001 * modulus[count - 1]:
        raise NumericalFailure(
            f"poles {count} and {count + 1} have moduli {modulus[count - 1]:.6g} and "
            f"{modulus[count]:.6g} rad/s and cannot be "
            "parted; keep one bending mode more or fewer"
        )

    # Slow poles first: A = Q T Q^T, T = [T11, T12; 0, T22].
    threshold = np.inf if count == n else 0.5 * (modulus[count - 1] + modulus[count])
    T, Q, n_slow = sla.schur(A, sort=lambda re, im: np.hypot(re, im) < threshold)
    if n_slow != count:
        raise NumericalFailure(
            f"the ordered Schur form kept {n_slow} poles instead of {count}; keep another number "
            "of modes"
        )
    r = count

    # T11 X - X T22 = -T12: T [X; I] = [X; I] T22, so Q [I; 0] and Q [X; I] span the two invariant
    # subspaces and [I, -X; 0, I] Q^T is the inverse.
    X = sla.solve_sylvester(T[:r, :r], -T[r:, r:], -T[:r, r:]) if r < n else np.zeros((r, 0))
    T_R, R_res = Q[:, :r], Q[:, r:] + Q[:, :r] @ X
    T_L, L_res = (Q[:, :r] - Q[:, r:] @ X.T).T, Q[:, r:].T

    # states of the slow part of like size; both scalings undone in the transforms
    _, s = balance(T_L @ A @ T_R)
    return (T_L / s[:, None]) / t, (T_R * s) * t[:, None], L_res / t, R_res * t[:, None]


def _lift(
    small: SecondOrder, full: SecondOrder, scales: np.ndarray, kept: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """From ``assemble``'s rotor state (q, q'/s) with scales s (n,) to the state of
    ``to_statespace(small)``, and back.

    The latter is z = L^T q of the k coordinates kept, M = L L^T, and z' in scales of its own.
    Orthogonal in the full mass.
    """
    k, n = small.n, full.n

    # M = L L^T; K = L^-1 k L^-T, of which to_statespace takes its scales
    L = sla.cholesky(small.mass, lower=True)
    K = sla.solve_triangular(L, sla.solve_triangular(L, small.stiffness, lower=True).T, lower=True)
    velocity_scale = velocity_scales(K)[:, None]

    # q = L^-T z at the kept coordinates, zero elsewhere; z = L^-1 M q, its inverse in the full mass
    up, down = np.zeros((n, k)), sla.solve_triangular(L, full.mass[kept], lower=True)
    up[kept] = sla.solve_triangular(L, np.eye(k), lower=True).T

    # velocity states q'/s and z'/own
    return (
        sla.block_diag(down, down * scales / velocity_scale),
        sla.block_diag(up, up * velocity_scale.T / scales[:, None]),
    )


def modal_sum_bound(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, omega: np.ndarray, static: bool
) -> np.ndarray:
    """Sum over the modes of A of the norm of their contributions to C (j omega - A)^-1 B (minus its
    value at 0), (w,).
    """
    # C (s - A)^-1 B = sum over the poles of residue/(s - pole)
    values, V = np.linalg.eig(A)
    W = np.linalg.solve(V, B)
    CV = C @ V
    bound = np.zeros(len(omega))
    s = 1j * omega
    for i in np.flatnonzero(values.imag >= 0):
        residue = np.outer(CV[:, i], W[i])
        part = residue[None] / (s - values[i])[:, None, None]
        at_zero = -residue / values[i]

        # the conjugate pole with it, so that the two count as one mode
        if values[i].imag > 0:
            conjugate = residue.conj()
            part = part + conjugate[None] / (s - values[i].conj())[:, None, None]
            at_zero = 2 * at_zero.real
        bound += largest_gain(part - (at_zero if static else 0))
    return bound
