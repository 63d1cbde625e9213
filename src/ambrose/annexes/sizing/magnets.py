"""A machine with magnets of another size and bias current, and what those cost beside the machine
file's own.

A magnet grows along the shaft: pole area, volume and inductance with it, gap, turns, pole width and
amplifier bandwidth stay (assumed). Its force follows from the magnet that the machine file states,
iron included; where no iron is given the flux density may not rise above that of the machine file
at its largest current, which somebody chose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import check_positive
from ambrose.law.pid import first_settings
from ambrose.machine.description import Amplifier, MagneticBearing
from ambrose.machine.machine import Machine
from ambrose.model.effects import magnet
from ambrose.model.effects.loaded_magnet import LoadedMagnet
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.magnetics.vacuum import VACUUM_PERMEABILITY
from ambrose.model.plant import top_speed
from ambrose.model.static_load import operating_magnets, static_sag

SIZES = "the sizes are those of radial magnets and of all amplifiers"
# over the machine file's: steps of about sqrt(2), in which inductance L ~ N^2 doubles
TURNS = (0.5, 0.7, 1.0, 1.4, 2.0)
_NOTHING = 1e-6  # of the largest control current: what is left where the static load takes it all


@dataclass(frozen=True, slots=True, order=True)
class Size:
    """Pole area, bias current and amplifier bandwidth, each over the machine file's."""

    area: float = 1.0
    bias: float = 1.0
    bandwidth: float = 1.0

    def __post_init__(self) -> None:
        for name in ("area", "bias", "bandwidth"):
            check_positive(getattr(self, name), name, "give it as a share of the machine file's")


@dataclass(frozen=True, slots=True)
class Costs:
    """Over the machine file's: copper loss of all coils, volt-amperes of the amplifiers, volume of
    the magnets. reserve [-]: the least force of a magnet at its largest control current over the
    static load that it carries; inf without weight.
    """

    copper_loss: float
    volt_amperes: float
    volume: float
    reserve: float


@dataclass(frozen=True, slots=True)
class Drive:
    """turns over the machine file's; bias and largest control current [A], inductance of a coil
    [H]; voltage [V] that the largest control current takes as a sine at top speed, or at the
    suspension's sqrt(sum k_s / m) where that is higher. Flux, force and loop stay; the controller's
    gains go with 1/turns.
    """

    turns: float
    bias_current: float
    current: float
    inductance: float
    voltage: float


def resized(machine: Machine, size: Size) -> Machine:
    """The machine with magnets and amplifiers of a size; the largest control current keeps its
    share of the bias, and what the static load takes of it is taken off. Its reference controller
    keeps the stiffness K_p k_i / k_s. Raises InvalidInput where no magnet follows from the machine
    file's coefficients.
    """
    # magnets of the size, then the currents that hold the static load in them
    given = operating_magnets(machine)
    bearings = tuple(
        _bearing(b, item.of_force, size) for b, item in zip(machine.bearings, given, strict=True)
    )
    found = replace(machine, bearings=bearings, amplifier=_amplifier(machine.amplifier, size))
    held = operating_magnets(found)
    free = []
    for bearing, item in zip(bearings, held, strict=True):
        # what the static load leaves of the largest control current, kept positive
        most = _most(bearing, machine.requirements.max_current)
        free.append(
            replace(
                bearing, max_current=max(most - float(np.abs(item.currents).max()), _NOTHING * most)
            )
        )

    # K_p k_i/k_s is kept: gains in the proportion of k_s/k_i, axis by axis, else by the mean
    settings = machine.reference or first_settings(machine)
    factors = np.concatenate(
        [need(after) / need(before) for before, after in zip(given, held, strict=True)]
    )
    controller = settings
    if settings.gain:  # chains of filters have their gains in their channels, and begin as they are
        gains = (
            settings.gain
            if len(settings.gain) == len(factors)
            else np.full(len(settings.gain), settings.gain[0])
        )
        own = (
            factors
            if len(settings.gain) == len(factors)
            else np.full(len(settings.gain), factors.mean())
        )
        controller = replace(settings, gain=tuple((np.array(gains) * own).tolist()))
    return replace(
        found,
        bearings=tuple(free),
        controller=controller,
        requirements=replace(machine.requirements, max_current=None),
    )


def costs(machine: Machine, size: Size) -> Costs:
    """What magnets and amplifiers of a size cost, over those of the machine file."""
    found = replace(
        machine,
        bearings=tuple(
            _bearing(b, item.of_force, size)
            for b, item in zip(machine.bearings, operating_magnets(machine), strict=True)
        ),
    )

    # resistive loss: all coil currents squared, times the length of a turn
    loss = [_squares(item) for item in (found, machine)]

    # reserve: force at the largest control current over the weight along each axis, the
    # least of all
    weight = np.abs(static_sag(machine)[1])
    reserve = np.inf
    for bearing, item, load in zip(found.bearings, operating_magnets(found), weight, strict=True):
        most = _most(bearing)
        if item.parameters is None:
            reserve = 0.0
        elif load.max() > 0:
            force = [
                magnet.force(most, 0.0, 0.0, 0.0, item.parameters)[0],
                magnet.force(0.0, most, 0.0, 0.0, item.parameters)[1],
            ]
            reserve = min(reserve, float((np.array(force)[load > 0] / load[load > 0]).min()))
    # a square pole at the machine file's size (assumed), two of whose sides grow
    turn = (1 + size.area) / 2
    return Costs(
        loss[0] / loss[1] * turn, size.area * size.bias**2 * size.bandwidth, size.area, reserve
    )


def drives(machine: Machine, size: Size, turns: Sequence[float] = TURNS) -> tuple[Drive, ...]:
    """What the amplifiers must give for magnets of a size, for every number of turns over the
    machine file's.

    A coil's inductance is the machine file's; where it states none, that of the air gaps alone
    (assumed: no leakage), mu_0 N^2 A/(2 g) of a geometry, else k_i^2/(2 k_s), which is the same but
    for the poles' angle. The bearing that needs the highest voltage speaks for all.
    """
    magnets = [
        _bearing(b, item.of_force, size)
        for b, item in zip(machine.bearings, operating_magnets(machine), strict=True)
    ]
    slopes = [magnet.linearised(bearing) for bearing in magnets]

    # the frequency of the sine [rad/s]: top speed, or sqrt(sum k_s/m)
    stiffness = sum(max(item.negative_stiffness) for item in slopes)
    rate, found = (
        max(
            top_speed(machine),
            (stiffness / mass_properties(finite_element_rotor(machine)).mass) ** 0.5,
        ),
        [],
    )
    for bearing, here in zip(magnets, slopes, strict=True):
        k_i = max(here.force_per_current)
        k_s = max(here.negative_stiffness)
        of = bearing.geometry

        # L with the turns of the machine file
        if machine.amplifier.inductance is not None:
            L = size.area * machine.amplifier.inductance
        elif of is not None:
            L = VACUUM_PERMEABILITY * of.turns**2 * of.pole_area / (2 * of.gap)
        else:
            L = k_i**2 / (2 * k_s) if k_s > 0 else 0.0
        found.append((rate * L * _most(bearing), _most(bearing), bearing.bias_current, L))

    # n times the turns at the same flux: currents by 1/n, L by n^2, voltage w L i by n
    voltage, current, bias, inductance = max(found)
    return tuple(Drive(n, bias / n, current / n, n**2 * inductance, n * voltage) for n in turns)


def flux_within(machine: Machine, size: Size) -> bool:
    """Whether the iron carries the flux: that of the machine file says so itself, else no more than
    the file's.
    """
    return size.bias <= 1 + 1e-9 or all(bearing.iron is not None for bearing in machine.bearings)


def _bearing(bearing: MagneticBearing, p: tuple[float, ...], size: Size) -> MagneticBearing:
    # a force limit goes with the area, a current limit with the bias
    bias, area = size.bias * p[0], size.area
    here = magnet.of_size(p, bias, area)
    return replace(
        bearing,
        bias_current=bias,
        coefficients_at="no-load",
        measured=(),
        magnet=None,
        geometry=bearing.geometry
        and replace(bearing.geometry, pole_area=area * bearing.geometry.pole_area),
        force_per_current=here.force_per_current,
        negative_stiffness=here.negative_stiffness,
        max_current=None if bearing.max_current is None else size.bias * bearing.max_current,
        max_force=None if bearing.max_force is None else area * bearing.max_force,
    )


def _amplifier(given: Amplifier, size: Size) -> Amplifier:
    rates = {
        name: size.bandwidth * value
        for name in ("bandwidth", "natural_frequency", "damping")
        if (value := getattr(given, name)) is not None
    }
    inductance = None if given.inductance is None else size.area * given.inductance
    return replace(given, **rates, inductance=inductance)


def _most(bearing: MagneticBearing, wanted: float | None = None) -> float:
    """The largest control current [A] of a bearing, where none is stated the bias current; not
    above what is wanted.
    """
    most = bearing.bias_current if bearing.max_current is None else bearing.max_current
    return most if wanted is None else min(most, wanted)


def need(item: LoadedMagnet) -> np.ndarray:
    """The gain k_s/k_i (2,) [A/m] that holds the rotor at all."""
    return np.divide(item.coefficients.negative_stiffness, item.coefficients.force_per_current)


def _squares(machine: Machine) -> float:
    """The squares of all coil currents [A2]: two of an axis, i_0 + i and i_0 - i."""
    magnets = zip(machine.bearings, operating_magnets(machine), strict=True)
    return float(
        sum(4 * b.bias_current**2 + 2 * np.square(item.currents).sum() for b, item in magnets)
    )
