"""A whole machine from a rotor: magnets, sensors, amplifiers, a PID that holds it, points,
requirements and weights.

What is not known is chosen by the rules of this file and written down as assumed, for a new machine
and for an imported rotor alike. The rules are those of thumb of Schweitzer & Maslen 2009, chapters
2, 4 and 9.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ambrose.chain.check import shares
from ambrose.core.checks import InvalidInput, check_positive, invalid, named_failure
from ambrose.core.frequency import frequency_response
from ambrose.core.processes import TimeLimit
from ambrose.judge.loop_response import unavoidable_sensitivity
from ambrose.judge.result import certify
from ambrose.law.loop import machine_timing
from ambrose.law.pid import first_settings, pid_controller
from ambrose.machine.description import (
    Amplifier,
    DesignWeights,
    MachineDescription,
    MagnetGeometry,
    MagneticBearing,
    OperatingPoint,
    Operation,
    Requirements,
)
from ambrose.machine.file.ross import parse_ross, rotor_of_ross
from ambrose.machine.file.stations import read_rotor
from ambrose.machine.file.toml import (
    bundled_machines,
    loads_machine,
    read_machine_text,
    read_toml,
)
from ambrose.machine.file.update import annotated_machine, machine_text, save_machine
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import TOML_BYTES, file_name, read_text
from ambrose.machine.part import Disc, Notch, PidSettings, RotorModel, Sensor, ShaftSection
from ambrose.machine.units import DIMENSIONS, quoted, read_quantity
from ambrose.model.assemble import assemble, bending_modes_of, in_plane
from ambrose.model.effects.magnet import linearised
from ambrose.model.effects.rotor import (
    STANDARD_GRAVITY,
    finite_element_rotor,
    free_modes,
    mass_properties,
    plane_rows,
)
from ambrose.model.magnetics import VACUUM_PERMEABILITY
from ambrose.model.static_load import magnet_coefficients
from ambrose.model.uncertainty import reduce_from
from ambrose.synthesis.fixed_order.channels import LoopModel, loop_model, unwarped, warped
from ambrose.synthesis.fixed_order.job import bending_modes_for

# A PID that holds a machine at all its operating points, as sampled: the best of a grid around a
# first guess.


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


BIAS_FLUX = 0.6  # [T] half of what the iron carries
NOT_HELD = "NO SUCH PID STABILISES THE MACHINE"
_LOADS = 3.0  # times its share of the weight a bearing carries
_GRADE = 2.5e-3  # [m/s] balance grade G2.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What is known beside the rotor, SI; None: chosen. load [N]: of a bearing, the force that it
    must reach; gap [m] of the magnets; force_per_current [N/A], negative_stiffness [N/m] and
    bias_current [A] of every bearing; rate [Hz] of the controller. vertical: the rotor stands, and
    its weight loads no radial bearing. sensors [m]: a place for each bearing (empty: chosen).
    """

    load: float | None = None
    gap: float | None = None
    bias_current: float | None = None
    force_per_current: float | None = None
    negative_stiffness: float | None = None
    rate: float | None = None
    vertical: bool = False
    sensors: tuple[float, ...] = ()


_DIMENSIONS = {
    **dict.fromkeys(("length", "diameter", "gap", "bearings", "sensors"), "length"),
    "speed": "angular rate",
    "load": "force",
    "bias_current": "current",
    "force_per_current": "force per current",
    "negative_stiffness": "stiffness",
}
_DISC = ("length", "mass", "length")
_MODES = 8  # bending modes that are looked at
_REACH = 2 * math.pi * 500  # [rad/s], a third of the usual amplifier's corner
_SLENDER = 100  # length over diameter that is a wire rather than a rotor


def quantity_of(key: str, value: Any) -> float:
    """A number [SI], or a text with a unit. Raises InvalidInput."""
    try:
        number = read_quantity(value, DIMENSIONS[_DIMENSIONS[key]])
    except ValueError as error:
        raise InvalidInput(f"{key} {error}") from None
    return check_positive(
        number, key, "give its size", zero_allowed=key in {"speed", "bearings", "sensors"}
    )


def quantities_of(key: str, text: str) -> tuple[float, ...]:
    """Several texts with a unit, separated by commas. Raises InvalidInput."""
    return tuple(quantity_of(key, part.strip()) for part in text.split(","))


def new_machine(
    name: str = "my machine",
    *,
    length: float | str,
    diameter: float | str,
    speed: float | str = 0.0,
    discs: Sequence[Sequence[Any]] = (),
    bearings: Sequence[float | str] = (),
    sensors: Sequence[float | str] = (),
    vertical: bool = False,
    rate: float | None = None,
    **known: Any,
) -> Machine:
    """A machine of a plain steel shaft with discs on magnetic bearings, all the rest chosen so that
    it levitates.

    Numbers in SI, or texts with a unit ("600 mm", "12000 rpm"). length and diameter of the shaft,
    speed: the highest; discs: (position, mass, diameter) each; bearings: their positions (none:
    two, near the ends); sensors: one for each bearing (none: beside them). known: load [N] that a
    bearing must reach, gap [m], bias_current [A], force_per_current [N/A], negative_stiffness
    [N/m]; rate [Hz] of the controller. What was chosen is marked in ``machine.assumed`` with its
    reason; ``save_machine`` writes the file with comments and units. Raises InvalidInput.
    """
    unknown = [key for key in known if key not in _DIMENSIONS]
    if unknown:
        raise InvalidInput(
            f"new_machine has no option {unknown[0]!r}; it takes {', '.join(_DIMENSIONS)}, discs, "
            "vertical, rate"
        )
    long, thick = quantity_of("length", length), quantity_of("diameter", diameter)
    wheels = tuple(_disc(number, long, entry) for number, entry in enumerate(discs, 1))
    rotor = RotorModel(
        name,
        (ShaftSection(0.0, long, thick, elements=_elements(long, thick), label="shaft"),),
        wheels,
        tuple(quantity_of("bearings", place) for place in bearings),
        quantity_of("speed", speed),
    )
    quantities = {key: quantity_of(key, value) for key, value in known.items() if value is not None}
    seen = tuple(quantity_of("sensors", place) for place in sensors)
    return machine_of_rotor(rotor, Known(vertical=vertical, rate=rate, sensors=seen, **quantities))


def machine_from_ross(
    rotor: Any,
    *,
    speed: float | str | None = None,
    bearings: Sequence[float | str] = (),
    vertical: bool = False,
) -> Machine:
    """The machine of a ``ross.Rotor``, or of a file that its ``save`` wrote (*.toml, *.json).

    Active magnetic bearings keep their magnets; in the place of others magnets are chosen as by
    ``new_machine``. speed [rad/s, or a text with a unit]: the highest; bearings [m, or texts]: the
    magnets' places instead of the rotor's. ``machine.assumed`` names what was chosen, and under
    "rotor" and "seal" every key and element of the rotor that was not used (as many as 5,000
    characters hold). Raises InvalidInput.
    """
    if isinstance(rotor, (str, Path)):
        model = read_rotor(rotor)
    elif callable(getattr(rotor, "save", None)):
        with TemporaryDirectory() as folder:
            rotor.save(file := Path(folder) / "rotor.toml")
            text = read_text(file, "rotor model", TOML_BYTES)
        model = rotor_of_ross(parse_ross(text, "the rotor", ".toml"), "the rotor")
        model = replace(model, name=file_name(str(getattr(rotor, "tag", None) or "rotor")))
    else:
        raise InvalidInput(
            f"the rotor is {quoted(rotor)}, but must be a ross.Rotor; give one, or the path of a "
            "file that its save wrote"
        )
    places = tuple(quantity_of("bearings", place) for place in bearings)
    fastest = model.speed if speed is None else quantity_of("speed", speed)
    model = replace(model, speed=fastest, bearings=places or model.bearings)
    return machine_of_rotor(model, Known(vertical=vertical))


def text_of_file(path: Path, speed: str = "") -> str:
    """The text of the machine file that a file gives: its own, or that of a rotor alone (a model of
    ROSS, a table of stations) on magnets chosen for it; speed: its highest one, where it has none.
    Raises InvalidInput.
    """
    if path.suffix.lower() == ".toml" and "machine" in read_toml(path, "machine file"):
        return read_machine_text(path)
    rotor = read_rotor(path)
    known = quantity_of("speed", speed) if speed else rotor.speed
    return machine_text(machine_of_rotor(replace(rotor, speed=known or rotor.speed)))


def is_machine(source: str | Path) -> bool:
    """Whether it is a machine file or a bundled machine's name, no rotor model. Raises
    InvalidInput.
    """
    if str(source) in bundled_machines():
        return True
    return Path(source).suffix.lower() == ".toml" and "machine" in read_toml(source, "file")


def rotor_with(source: Path, speed: str | None, bearings: str | None) -> RotorModel:
    """The rotor model of a file, its highest speed and its magnets' places as stated. Raises
    InvalidInput.
    """
    rotor = read_rotor(source)
    return replace(
        rotor,
        speed=rotor.speed if speed is None else quantity_of("speed", speed),
        bearings=rotor.bearings if bearings is None else quantities_of("bearings", bearings),
    )


def machine_file_of(
    source: str, output: Path, speed: str | None, bearings: str | None
) -> tuple[str, str]:
    """The path of a machine file as it is, or of the one that was made of a rotor model, and what
    of the model was left out, in words. Raises InvalidInput.
    """
    if is_machine(source):
        if speed is not None or bearings is not None:
            raise InvalidInput("--speed and --bearings are of a rotor model; leave them out")
        return source, ""
    rotor = rotor_with(Path(source), speed, bearings)
    machine = machine_of_rotor(rotor)
    if output.is_file() and read_machine_text(output) != machine_text(machine):
        raise InvalidInput(
            f"{output} is there already, with other numbers; take that file in place of {source}, "
            "or remove it"
        )
    save_machine(machine, output)
    return str(output), ", ".join(rotor.left_out) or "nothing"


@named_failure("the new machine")
def machine_of_rotor(rotor: RotorModel, known: Known | None = None) -> Machine:
    """The rotor on magnetic bearings: what neither says is chosen, and marked in ``assumed``.
    Raises InvalidInput.
    """
    known = known or Known()
    bare = MachineDescription(
        rotor.name, rotor.shaft, (), (), discs=rotor.discs, beam_theory=rotor.beam_theory
    )
    reasons = dict(rotor.assumed)
    speed = rotor.speed or 0.0
    model = finite_element_rotor(bare)
    mass, centre = mass_properties(model).mass, mass_properties(model).centre
    places = rotor.bearings or _places(bare, reasons)
    for place in places:
        if not 0 <= place <= bare.length:
            raise invalid(
                "bearings",
                f"{place:g} m",
                f"on the shaft, from 0 to {bare.length:g} m",
                "count from the left end",
            )
    if len(places) > 1 and np.diff(np.sort(places)).min() < 1e-3 * bare.length:
        raise invalid(
            "bearings",
            f"{len(places)} with two at one place",
            "apart from each other",
            "name every place once",
        )
    if known.sensors and len(known.sensors) != len(places):
        raise invalid(
            "sensors",
            f"{len(known.sensors)} places",
            f"{len(places)}, one for each bearing",
            "name them in the order of the bearings",
        )
    slim = bare.length / max(section.outer_diameter for section in bare.shaft)
    if slim > _SLENDER:
        raise invalid(
            "the rotor",
            f"{slim:.3g} diameters long",
            f"at most {_SLENDER}",
            "check the units of length and diameter",
        )
    if known.rate is not None:
        check_positive(known.rate, "rate", "10000 Hz is usual")
    loads = shares(mass * STANDARD_GRAVITY, centre, places)
    bearing = _magnet(known, bare, float(max(loads)), mass / len(places) * _GRADE * speed, reasons)
    names = [chr(ord("A") + i) if len(places) <= 26 else f"B{i + 1}" for i in range(len(places))]
    bearings = tuple(
        _placed(replace(bearing, name=name, position=place), rotor.magnets.get(place))
        for name, place in zip(names, places, strict=True)
    )
    if all(place in rotor.magnets for place in places):
        own = {f"bearing.{key}" for key in ("geometry", "gap", "bias_current")}
        reasons = {key: why for key, why in reasons.items() if key not in own}
        reasons["bearing.max_force"] = "all the current in one of two opposite coils"
    pole = math.sqrt(sum(map(_stiffness, bearings)) / mass)
    fast = max(speed, pole) / (2 * math.pi)
    sampling = known.rate or (10e3 if fast <= 400 else 5e3 * math.ceil(fast * 25 / 5e3))
    reasons |= {
        "amplifier.bandwidth": "1.5 kHz is usual; at least three times the top speed, and ten "
        "times the unstable pole",
        "modal_damping": "0.5 %, usual for a steel shaft with shrunk-on parts",
    }
    if known.rate is None:
        reasons["controller.sample_time"] = (
            "10 kHz is usual; 25 times the top speed or the unstable pole where that is more"
        )
    corner = in_hertz(max(2 * math.pi * 1500, 3 * speed, 10 * pole), 2)
    points = (OperatingPoint(label="standstill"),)
    machine = Machine(
        name=rotor.name,
        shaft=rotor.shaft,
        discs=rotor.discs,
        bearings=bearings,
        sensors=tuple(map(Sensor, names, known.sensors))
        if known.sensors
        else _sensors(bare, names, places, reasons),
        amplifier=Amplifier("first", corner),
        operation=Operation(
            (OperatingPoint(speed, label="top speed"), *points) if speed else points, (0.0, speed)
        ),
        beam_theory=rotor.beam_theory,
        source=rotor.source,
        gravity_direction=None if known.vertical else -math.pi / 2,
        controller=PidSettings(sample_time=1 / sampling, delay=1 / sampling),
    )
    settings, peak = holding_pid(machine)
    if peak == math.inf and not known.sensors:  # the sign of the two lowest modes alone
        again = dict[str, str]()
        other = replace(machine, sensors=_sensors(bare, names, places, again, reach=0.0))
        tried, least = holding_pid(other)
        if least < math.inf:
            machine, reasons = other, reasons | again
            settings, peak = tried, least
    k_i, k_s = magnet_coefficients(machine, machine.operation.design)
    reasons["controller"] = (
        f"K_p = {settings.gain[0] / float((k_s / k_i).max()):.2g} k_s/k_i, T_d from the "
        "unstable rigid-body pole; "
        + (
            f"stable at all points, sensitivity peak {peak:.2g}"
            if peak < math.inf
            else f"{NOT_HELD}, design another"
        )
    )
    machine = replace(machine, controller=settings)
    machine = _with_aims(machine, reasons)
    written = annotated_machine(replace(machine, assumed=tuple(sorted(reasons.items()))), _TITLE)
    return loads_machine(written, rotor.name)


_TITLE = (
    "A machine for Ambrose: numbers have units, what was chosen and not measured is marked "
    '"assumed" and listed\n'
    "with its reason. Replace it by what you know, then: ambrose check, ambrose synthesize, "
    "ambrose simulate."
)


def _elements(length: float, diameter: float) -> int:
    return int(min(max(math.ceil(length / diameter), 12), 60))


def _disc(number: int, length: float, entry: Sequence[Any]) -> Disc:
    what = f"disc {number}"
    if isinstance(entry, str) or not isinstance(entry, Sequence) or len(entry) != 3:
        raise invalid(
            what, repr(entry), "position, mass and diameter", 'such as ("300 mm", "8 kg", "250 mm")'
        )
    try:
        at, heavy, thick = (
            read_quantity(value, DIMENSIONS[kind]) for value, kind in zip(entry, _DISC, strict=True)
        )
    except ValueError as error:
        raise InvalidInput(f"{what} {error}") from None
    check_positive(heavy, f"the mass of {what}", "give it in kg")
    check_positive(thick, f"the diameter of {what}", "give it in m")
    if not 0 <= at <= length:
        raise invalid(
            f"the position of {what}",
            f"{at:g} m",
            f"on the shaft, from 0 to {length:g} m",
            "correct it",
        )
    polar = rounded(heavy * thick**2 / 8, 4)
    return Disc(f"disc{number}", at, heavy, polar, polar / 2)


def _places(bare: MachineDescription, reasons: dict[str, str]) -> tuple[float, float]:
    """Two bearings, an eighth of the free length inside of what overhangs at the ends."""
    long = bare.length
    low = max((d.position for d in bare.discs if d.position < 0.25 * long), default=0.0)
    high = min((d.position for d in bare.discs if d.position > 0.75 * long), default=long)
    reasons["bearing.position"] = (
        "an eighth of the free length from the ends, or from the discs that overhang there"
    )
    inset = rounded((high - low) / 8, 3)
    return rounded(low + inset, 4), rounded(high - inset, 4)


def _magnet(
    known: Known, bare: MachineDescription, share: float, unbalance: float, reasons: dict[str, str]
) -> MagneticBearing:
    """A bearing without name and place, of the force that the heaviest loaded one needs."""
    force = known.load or rounded(max(_LOADS * share, 2 * share + 3 * unbalance), 2)
    if known.load is None:
        rule = f"{_LOADS:g} times the larger share of the rotor's weight, {share:.3g} N"
        reasons["bearing.max_force"] = (
            f"{rule}; or twice that and three times the unbalance force of G2.5 at top speed"
        )
    thick = max(section.outer_diameter for section in bare.shaft)
    gap = known.gap or min(max(round((0.3e-3 + 2e-3 * thick) / 5e-5) * 5e-5, 2.5e-4), 1e-3)
    gap = rounded(gap, 6)
    if known.gap is None:
        reasons["bearing.gap"] = "0.3 mm and 2 thousandths of the shaft's diameter"
    reasons["bearing.touchdown_gap"] = "half of the magnets' gap, as usual"
    bias = known.bias_current
    if bias is None:
        if known.force_per_current is not None and known.negative_stiffness is not None:
            bias = known.negative_stiffness * gap / known.force_per_current
            reasons["bearing.bias_current"] = "k_s gap / k_i"
        else:
            bias = 2.5 * (force / 500) ** (1 / 3)
            reasons["bearing.bias_current"] = "a usual current for a magnet of this force"
        bias = rounded(bias, 2)
    reasons["bearing.max_current"] = (
        "the bias current: beyond, one of the two opposite coils is off"
    )
    bearing = MagneticBearing(
        "A",
        0.0,
        bias,
        angle=0.0 if known.vertical else math.pi / 4,
        gap=gap,
        touchdown_gap=rounded(gap / 2, 6),
        max_current=bias,
        max_force=force,
    )
    if known.force_per_current is not None or known.negative_stiffness is not None:
        k_i = known.force_per_current or rounded((known.negative_stiffness or 0.0) * gap / bias, 3)
        k_s = known.negative_stiffness or rounded(k_i * bias / gap, 3)
        if known.force_per_current is None:
            reasons["bearing.force_per_current"] = "k_s gap / bias"
        if known.negative_stiffness is None:
            reasons["bearing.negative_stiffness"] = "k_i bias / gap"
        return replace(bearing, force_per_current=(k_i, k_i), negative_stiffness=(k_s, k_s))
    geometry = MagnetGeometry(1.0, 1.0, gap)
    turns = max(float(round(2 * BIAS_FLUX * gap / (VACUUM_PERMEABILITY * bias))), 1.0)
    flux = VACUUM_PERMEABILITY * turns * bias / (2 * gap)
    area = (
        rounded(
            force * VACUUM_PERMEABILITY / (4 * flux**2 * math.cos(geometry.pole_half_angle)) * 1e6,
            3,
        )
        * 1e-6
    )
    reasons["bearing.geometry"] = (
        f"eight poles whose bias flux is {flux:.2g} T, half of what iron carries, and whose area "
        "gives max_force with all the "
        "current in one of two opposite coils"
    )
    return replace(bearing, geometry=replace(geometry, turns=turns, pole_area=float(f"{area:.9g}")))


def _placed(bearing: MagneticBearing, stated: Mapping[str, float] | None) -> MagneticBearing:
    """The bearing, of the magnets that the rotor's source states for its place."""
    if not stated:
        return bearing
    bias, gap = stated["bias_current"], stated["gap"]
    shape = {key: value for key, value in stated.items() if key not in {"bias_current", "angle"}}
    made = replace(
        bearing,
        bias_current=bias,
        angle=stated.get("angle", bearing.angle),
        geometry=MagnetGeometry(**shape),
        force_per_current=None,
        negative_stiffness=None,
        gap=gap,
        touchdown_gap=rounded(gap / 2, 6),
        max_current=bias,
    )
    return replace(made, max_force=rounded(linearised(made).force_per_current[0] * bias, 3))


def _stiffness(bearing: MagneticBearing) -> float:
    if bearing.negative_stiffness is not None:
        return bearing.negative_stiffness[0]
    return linearised(bearing).negative_stiffness[0]


def _sensors(
    bare: MachineDescription,
    names: Sequence[str],
    places: Sequence[float],
    reasons: dict[str, str],
    reach: float = _REACH,
) -> tuple[Sensor, ...]:
    """Beside each bearing, on the side where all bending modes up to ``reach`` [rad/s] move as at
    the magnet, two at least; else at its middle, as a pair on both its sides reads it.
    """
    rotor = finite_element_rotor(bare)
    modes = free_modes(rotor, min(_MODES, bending_modes_of(rotor)))
    count = max(2, int((modes.frequencies[4::2] <= reach).sum()))
    plane = in_plane(modes)[:, 2 : 2 + count]
    long, positions = bare.length, list[Sensor]()
    between = list[str]()
    for name, place in zip(names, places, strict=True):
        outward = -1.0 if place < long / 2 else 1.0
        sides = [
            place + side * outward * share * long for share in (0.04, 0.02) for side in (1.0, -1.0)
        ]
        clear = [at for at in sides if 0.01 * long <= at <= 0.99 * long]
        w = plane_rows(rotor, [place, *clear])[0] @ plane
        at = next(
            (at for at, row in zip(clear, w[1:], strict=True) if (w[0] * row > 0).all()), None
        )
        between += [name] * (at is None)
        positions.append(Sensor(name, rounded(place if at is None else at, 4)))
    reasons["sensor.position"] = (
        f"next to the bearing, where the lowest {count} bending modes move in the direction of the "
        "magnet"
        + f"; of {', '.join(between)} nowhere: at its middle, the mean of a pair on both its sides"
        * bool(between)
    )
    return tuple(positions)


def _with_aims(machine: Machine, reasons: dict[str, str]) -> Machine:
    """Requirements after the standards' zone A, and weights in the proportions of the seal rig
    (P5).
    """
    top, bearing = machine.operation.speed_range[1], machine.bearings[0]
    settings = machine.controller
    assert (
        settings is not None
        and bearing.touchdown_gap is not None
        and bearing.max_current is not None
    )
    k_i, k_s = magnet_coefficients(machine, machine.operation.design)
    least = unavoidable_sensitivity(assemble(machine, machine.operation.design))[0]
    orbit = rounded(0.3 * bearing.touchdown_gap, 2)
    peak = max(3.0, rounded(1.5 * least, 2))
    turning: dict[str, Any] = (
        {}
        if not top
        else {
            "balance_grade": _GRADE,
            "balance_speed": top,
            "unbalance_orbit": orbit,
            "unbalance_to": top,
        }
    )
    reasons["requirements.sensitivity_peak"] = "zone A of ISO 14839-3" + (
        ", beyond its reach here" if peak > 3 else ""
    )
    if turning:
        reasons["requirements.unbalance_orbit"] = (
            "zone A of ISO 14839-2, 0.3 times the touchdown gap, for G2.5 at top speed"
        )
    error = rounded(0.1 * bearing.touchdown_gap, 2)
    reasons["weights"] = (
        "a tenth of the touchdown gap, a current in the proportion of P5's test rig, the PID's "
        "integral time"
    )
    return replace(
        machine,
        requirements=Requirements(
            sensitivity_peak=peak, max_current=bearing.max_current, **turning
        ),
        weights=DesignWeights(
            error,
            rounded(7.5 * float((k_s / k_i).mean()) * error, 2),
            in_hertz(1 / (3 * (settings.integral_time or 1.0)), 2),
            0.3,
        ),
    )
