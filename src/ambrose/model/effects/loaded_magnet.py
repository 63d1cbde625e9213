"""A bearing's magnets while they carry a static load off their centre: currents, and the
coefficients of small motion there.

A pair of magnets is bent in current and place: at a load of half the bias current k_s is larger by
a quarter. A data sheet or a geometry states coefficients without load; what was identified while
the rotor levitated holds the load already. Whichever the machine file says (``coefficients_at``),
one magnet follows from it: the linear plant takes its slopes at the load, the virtual rig its
force.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.description import MagneticBearing, Pair
from ambrose.model.effects.magnet import (
    MagnetCoefficients,
    force,
    from_geometry,
    linearised,
    parameters,
)

_STEP = 1e-3  # of bias current and gap, in differences of fourth order: 1e-12 of a slope
_ITERATIONS = 200  # of a fixed point, at most
_EXACT = 1e-12  # relative


@dataclass(frozen=True, slots=True)
class LoadedMagnet:
    """coefficients: slopes of the force at the load; currents (zeta, eta) [A] that carry it;
    parameters: what ``magnet.force`` needs. doubt: why no magnet has the stated coefficients, or
    none carries the load; they then act as stated, and parameters are None.
    """

    coefficients: MagnetCoefficients
    currents: Pair
    parameters: tuple[float, ...] | None
    doubt: str = ""

    @property
    def of_force(self) -> tuple[float, ...]:
        """The parameters. Raises InvalidInput where there are none."""
        if self.parameters is None:
            raise InvalidInput(self.doubt)
        return self.parameters


def carrying(
    bearing: MagneticBearing,
    load: Pair,
    place: Pair = (0.0, 0.0),
    bias_current: float | None = None,
) -> LoadedMagnet:
    """The magnets at a load (zeta, eta) [N] on the rotor and a place [m] from the sensors' zero, at
    a bias current [A] (None: the bearing's own).

    Raises InvalidInput as ``magnet.linearised`` does.
    """
    stated = linearised(bearing, bias_current)
    try:
        return _found(bearing, stated, load, place, parameters(bearing, bias_current))
    except InvalidInput as error:
        return LoadedMagnet(stated, (0.0, 0.0), None, str(error))


def _found(
    bearing: MagneticBearing,
    stated: MagnetCoefficients,
    load: Pair,
    place: Pair,
    p: tuple[float, ...],
) -> LoadedMagnet:
    if not any((*load, *place, *bearing.magnetic_offset)):
        return LoadedMagnet(stated, (0.0, 0.0), p)

    # The coefficients are those without load: the load finds its currents, the slopes are taken
    # there.
    if bearing.coefficients_at == "no-load" or from_geometry(bearing, p[0]):
        currents = balance(p, load, place, bearing.name)
        return LoadedMagnet(slopes(p, currents, place), currents, p)

    # The stated coefficients are those under load. Fixed point: scale those without load by stated
    # over found until the slopes under load are the stated ones.
    scale, wanted = np.ones((2, 2)), _array(stated)
    for _ in range(_ITERATIONS):
        k_i, k_s = (scale * wanted).tolist()
        p = parameters(
            replace(
                bearing,
                force_per_current=tuple(k_i),
                negative_stiffness=tuple(k_s),
                bias_current=p[0],
                measured=(),
            )
        )
        currents = balance(p, load, place, bearing.name)
        ratio = wanted / _array(slopes(p, currents, place))
        if np.abs(ratio - 1).max() < _EXACT:
            return LoadedMagnet(stated, currents, p)
        scale *= ratio
    raise invalid(
        f"the coefficients of bearing {bearing.name} at its static load of {np.hypot(*load):.3g} N",
        f"k_i = {stated.force_per_current[0]:.4g} N/A and k_s = "
        f"{stated.negative_stiffness[0]:.4g} N/m",
        "those of a magnet",
        'correct them, or write coefficients_at = "no-load" if they are of the magnet without load',
    )


def balance(p: tuple[float, ...], load: Pair, place: Pair, name: str) -> Pair:
    """The control currents (zeta, eta) [A] whose force, at a place [m], carries a load [N]; p: of
    ``magnet.force``.

    Newton's method, damped. Raises InvalidInput where the magnets cannot carry the load.
    """
    i, weight = np.zeros(2), np.array(load)

    def missing(i: np.ndarray) -> np.ndarray:
        return np.array(force(i[0], i[1], place[0], place[1], p)) + weight

    left, size = missing(i), max(float(np.abs(weight).max()), 1e-6)
    for _ in range(_ITERATIONS):
        if np.abs(left).max() <= _EXACT * size:
            return float(i[0]), float(i[1])
        # Newton: J step = -left, J by central differences of 1e-4 i_0; halved until less is missing
        J = np.column_stack(
            [(missing(i + e) - missing(i - e)) for e in 1e-4 * p[0] * np.eye(2)]
        ) / (2e-4 * p[0])
        step = -np.linalg.lstsq(J, left)[0]
        share = min(1.0, p[0] / max(float(np.abs(step).max()), 1e-300))  # one bias current at most
        while share > 1e-6 and np.abs(missing(i + share * step)).max() >= np.abs(left).max():
            share /= 2
        if share <= 1e-6:
            break
        i = i + share * step
        left = missing(i)

    # rounding may keep it from the tighter tolerance
    if np.abs(left).max() <= 1e-9 * size:
        return float(i[0]), float(i[1])
    raise invalid(
        f"the static load of bearing {name}",
        f"{np.hypot(*load):.4g} N",
        f"what its magnets carry at a bias of {p[0]:.3g} A",
        "raise the bias current, correct iron and coefficients, or leave gravity_direction out "
        "for a rotor that stands upright",
    )


def slopes(p: tuple[float, ...], currents: Pair, place: Pair = (0.0, 0.0)) -> MagnetCoefficients:
    """k_i and k_s of each axis by differences of ``magnet.force`` about currents [A] and a place
    [m].
    """
    at = np.array([*currents, *place])
    rows = []
    for way in range(4):
        # over i_zeta, i_eta, then zeta, eta, the force along the same axis
        h = _STEP * (p[0] if way < 2 else min(p[5], p[8]))
        two, one, less, least = (
            force(v[0], v[1], v[2], v[3], p)[way % 2]
            for v in (at + n * h * np.eye(4)[way] for n in (2, 1, -1, -2))
        )
        # f' = (8 (f_1 - f_-1) - (f_2 - f_-2))/(12 h), fourth order
        rows.append((8 * (one - less) - (two - least)) / (12 * h))
    return MagnetCoefficients((rows[0], rows[1]), (rows[2], rows[3]))


def with_coefficients(
    bearing: MagneticBearing, bias: float, here: MagnetCoefficients
) -> MagneticBearing:
    """The bearing at a bias current [A] with coefficients that act at its static load."""
    return replace(
        bearing,
        bias_current=bias,
        measured=(),
        coefficients_at="static-load",
        force_per_current=here.force_per_current,
        negative_stiffness=here.negative_stiffness,
    )


def _array(item: MagnetCoefficients) -> np.ndarray:
    """(2, 2): k_i, then k_s of both axes."""
    return np.array([item.force_per_current, item.negative_stiffness])
