"""Magnetic bearing force: linear, f = k_i i + k_s x per axis with k_s > 0 destabilising, and
nonlinear (``force``).

One horseshoe with coil current I at a gap s carries the flux b = B 2/(mu_0 N) [A/m] that solves

    I = s b + l b b_s/(b_s - b),

air gap and iron in series: without iron b = I/s; with iron, l is the equivalent gap of the
unsaturated iron and b_s the flux it never passes (B of the iron's H as Froehlich's hyperbola, H ~
B/(B_s - B)). A pair pulls with f = c (b_1^2 - b_2^2), which without iron is the usual c ((i_0 +
i)^2/(s_0 - x)^2 - (i_0 - i)^2/(s_0 + x)^2). Of every pair, k_s/k_i = b_0: the ratio of the two
coefficients is the bias flux whatever the iron does, which is how ``parameters`` finds c and s_0
from them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.machine.description import BiasPoint, MagnetGeometry, MagneticBearing, MagnetIron, Pair
from ambrose.model.magnetics import VACUUM_PERMEABILITY, coefficients_of


@dataclass(frozen=True, slots=True)
class MagnetCoefficients:
    """force_per_current k_i (zeta, eta) [N/A] and negative_stiffness k_s (zeta, eta) [N/m]."""

    force_per_current: Pair
    negative_stiffness: Pair


def linearised(bearing: MagneticBearing, bias_current: float | None = None) -> MagnetCoefficients:
    """The coefficients of a bearing as they are stated, at a bias current [A] (None: the bearing's
    own).

    At the bearing's own bias the given values win. Elsewhere measured rows are interpolated
    linearly (the given values count as one more row) and never extrapolated; without rows the
    geometry decides. Raises InvalidInput where nothing applies.
    """
    bias = bearing.bias_current if bias_current is None else bias_current
    bias = check_positive(
        bias, f"the bias current [A] of bearing {bearing.name}", "give the premagnetisation current"
    )
    stated = _given(bearing)
    if stated is not None and _same(bias, stated.bias_current):
        return MagnetCoefficients(stated.force_per_current, stated.negative_stiffness)
    if bearing.measured:
        rows = [
            row
            for row in bearing.measured
            if stated is None or not _same(row.bias_current, stated.bias_current)
        ]
        return _interpolated(bearing.name, [*rows, *([stated] if stated else [])], bias)
    if bearing.magnet is not None:
        return network_coefficients(bearing, bias)[0]
    if bearing.geometry is not None:
        return _from_geometry(bearing.geometry, bearing.iron, bias)
    if stated is not None:
        raise invalid(
            f"the bias current of bearing {bearing.name}",
            f"{bias:g} A",
            f"the {stated.bias_current:g} A at which its coefficients are given",
            "add its geometry, or measured rows at other bias currents",
        )
    raise InvalidInput(
        f"bearing {bearing.name} has no coefficients; give force_per_current and "
        "negative_stiffness, measured rows or geometry"
    )


def of_size(p: tuple[float, ...], bias: float, area: float = 1.0) -> MagnetCoefficients:
    """Coefficients without load of magnets p (``parameters``) at another bias current [A], poles
    ``area`` times as large.
    """
    fitting = []
    for c, gap in ((p[4], p[5]), (p[7], p[8])):
        # k_i = 4 c b_0 db/dI, k_s = b_0 k_i
        b, slope = _flux(bias, gap, p[2], p[3])
        fitting.append((4 * area * c * b * slope, 4 * area * c * b**2 * slope))
    return MagnetCoefficients((fitting[0][0], fitting[1][0]), (fitting[0][1], fitting[1][1]))


def from_geometry(bearing: MagneticBearing, bias: float) -> bool:
    """Whether the coefficients at a bias current [A] are not stated, but those of the geometry,
    which has no load.
    """
    stated = _given(bearing)
    return not bearing.measured and (stated is None or not _same(bias, stated.bias_current))


def network_coefficients(bearing: MagneticBearing, bias: float) -> tuple[MagnetCoefficients, float]:
    """The coefficients of a [bearing.magnet] at a bias current [A], and the bias current [A] of the
    opposing pair that has them: of a heteropolar magnet the same, of a homopolar one k_s s_0/k_i.

    Raises InvalidInput where a permanent magnet is stated with another bias current than that pair.
    """
    assert bearing.magnet is not None
    k_i, k_s, pair = coefficients_of(bearing.magnet, bias, bearing.name)
    return MagnetCoefficients(k_i, k_s), pair


def force_constant(geometry: MagnetGeometry) -> float:
    """k = mu_0 N^2 A/4 [N m2/A2] of an opposing pair: f = k ((i_1/s_1)^2 - (i_2/s_2)^2) cos(a)
    (Schweitzer & Maslen 2009).
    """
    return VACUUM_PERMEABILITY * geometry.turns**2 * geometry.pole_area / 4


def parameters(bearing: MagneticBearing, bias_current: float | None = None) -> tuple[float, ...]:
    """What ``force`` needs, at a bias current [A] (None: the bearing's own): the magnet whose
    derivatives are ``linearised``.

    (i_0 [A], cross-coupling [-], b_s [A/m], l [m], then for zeta and for eta: c [N m2/A2], s_0 [m],
    offset [m]); b_s is 0 without iron. s_0 is an effective gap: without iron s_0 = k_s i_0/k_i.
    Raises InvalidInput as ``linearised`` does, and where the iron cannot carry the flux k_s/k_i
    that the coefficients imply.
    """
    bias = bearing.bias_current if bias_current is None else bias_current
    at = linearised(bearing, bias)
    if bearing.magnet is not None and from_geometry(bearing, bias):
        bias = network_coefficients(bearing, bias)[1]
    limit, path = _iron(bearing.iron)
    fitted: list[float] = []
    for axis, k_i, k_s, offset in zip(
        ("zeta", "eta"),
        at.force_per_current,
        at.negative_stiffness,
        bearing.magnetic_offset,
        strict=True,
    ):
        c, gap = _fitted(f"{bearing.name}_{axis}", bias, k_i, k_s, limit, path)
        fitted += [c, gap, offset]
    return (float(bias), float(bearing.cross_coupling), limit, path, *fitted)


def force(
    i_zeta: float, i_eta: float, x_zeta: float, x_eta: float, p: tuple[float, ...]
) -> tuple[float, float]:
    """Force (zeta, eta) [N] on the rotor at control currents [A] and displacements [m]; p from
    ``parameters``.

    Coil currents i_0 +- i stop at zero. A gap below 2 % of the effective one is held there: the
    rotor is then far inside the touchdown bearing. Compiles with numba as it stands.
    """
    i_0 = p[0]
    cross = p[1]
    b_s = p[2]
    path = p[3]
    f_zeta, f_eta = 0.0, 0.0
    for axis in range(2):
        if axis == 0:
            # axis by axis: its own current and a share of the other's, its displacement from the
            # magnetic centre
            i = i_zeta + cross * i_eta
            x = x_zeta - p[6]
            c = p[4]
            s_0 = p[5]
        else:
            i = i_eta + cross * i_zeta
            x = x_eta - p[9]
            c = p[7]
            s_0 = p[8]
        total = 0.0
        for side in (1.0, -1.0):
            # the two horseshoes of the pair: i_0 +- i over s_0 -+ x
            coil = max(i_0 + side * i, 0.0)
            s = max(s_0 - side * x, 0.02 * s_0)
            if b_s > 0.0:
                # I (b_s - b) = s b (b_s - b) + l b b_s: s b^2 - q b + I b_s = 0, the root below
                # b_s, written without cancellation
                q = coil + (s + path) * b_s
                b = 2.0 * coil * b_s / (q + math.sqrt(max(q * q - 4.0 * s * coil * b_s, 0.0)))
            else:
                b = coil / s
            total += side * c * b * b
        if axis == 0:
            f_zeta = total
        else:
            f_eta = total
    return f_zeta, f_eta


def _iron(iron: MagnetIron | None) -> tuple[float, float]:
    """b_s [A/m] and l [m]; (0, 0) without iron."""
    return (
        (0.0, 0.0)
        if iron is None
        else (2 * iron.flux_density / (VACUUM_PERMEABILITY * iron.turns), iron.equivalent_gap)
    )


def _flux(current: float, gap: float, limit: float, path: float) -> tuple[float, float]:
    """Flux b [A/m] of a horseshoe and its derivative db/dI [1/m]; -db/ds is b times that."""
    if limit <= 0.0:
        return current / gap, 1 / gap
    # s b^2 - q b + I b_s = 0 as in ``force``; differentiated, (q - 2 s b) db/dI = b_s - b
    q = current + (gap + path) * limit
    b = 2 * current * limit / (q + math.sqrt(q * q - 4 * gap * current * limit))
    return b, (limit - b) / (gap * (limit - b) + current - gap * b + path * limit)


def _fitted(
    name: str, bias: float, k_i: float, k_s: float, limit: float, path: float
) -> tuple[float, float]:
    """c and s_0 of the pair whose derivatives at zero are k_i = 4 c b_0 db/dI and k_s = b_0 k_i."""
    b_0 = k_s / k_i
    if b_0 <= 0.0:
        raise invalid(
            f"the negative stiffness of {name}",
            f"{k_s:g} N/m",
            "positive",
            "the nonlinear force follows from its ratio to k_i",
        )

    # I = s b + l b b_s/(b_s - b) solved for s at b = b_0
    if limit <= 0.0:
        gap = bias / b_0
    elif b_0 < limit:
        gap = bias / b_0 - path * limit / (limit - b_0)
    else:
        gap = 0.0
    if gap <= 0.0:
        raise invalid(
            f"the bias flux k_s/k_i of {name}",
            f"{b_0:g} A/m at {bias:g} A",
            f"one that the iron carries: below {limit:g} A/m, its equivalent gap below "
            f"{bias / b_0:g} m",
            "correct bearing.iron or the coefficients",
        )
    return k_i / (4 * b_0 * _flux(bias, gap, limit, path)[1]), gap


def _from_geometry(
    geometry: MagnetGeometry, iron: MagnetIron | None, bias: float
) -> MagnetCoefficients:
    """k_i = 4 k b db/dI cos(a), k_s = b k_i; without iron 4 k i_0 cos(a)/s_0^2 and 4 k i_0^2
    cos(a)/s_0^3.

    No leakage. Source: Schweitzer & Maslen 2009, chapter 4; the iron as above.
    """
    b, slope = _flux(bias, geometry.gap, *_iron(iron))
    k_i = float(4 * force_constant(geometry) * np.cos(geometry.pole_half_angle) * b * slope)
    return MagnetCoefficients((k_i, k_i), (k_i * b, k_i * b))


def _given(bearing: MagneticBearing) -> BiasPoint | None:
    """The given coefficients as a row at the bearing's own bias current."""
    k_i, k_s = bearing.force_per_current, bearing.negative_stiffness
    return None if k_i is None or k_s is None else BiasPoint(bearing.bias_current, k_i, k_s)


def _interpolated(name: str, rows: list[BiasPoint], bias: float) -> MagnetCoefficients:
    rows = sorted(rows, key=lambda row: row.bias_current)
    currents = [row.bias_current for row in rows]
    if not (
        currents[0] <= bias <= currents[-1] or _same(bias, currents[0]) or _same(bias, currents[-1])
    ):
        raise invalid(
            f"the bias current of bearing {name}",
            f"{bias:g} A",
            f"within the measured {currents[0]:g} to {currents[-1]:g} A",
            "measure there, or choose a bias current inside",
        )
    k_i = [
        float(np.interp(bias, currents, [row.force_per_current[axis] for row in rows]))
        for axis in (0, 1)
    ]
    k_s = [
        float(np.interp(bias, currents, [row.negative_stiffness[axis] for row in rows]))
        for axis in (0, 1)
    ]
    return MagnetCoefficients((k_i[0], k_i[1]), (k_s[0], k_s[1]))


def _same(a: float, b: float) -> bool:
    return bool(np.isclose(a, b, rtol=1e-9, atol=0.0))


# A bearing's magnets while they carry a static load off their centre: currents, and the
# coefficients of small motion there.
#
# A pair of magnets is bent in current and place: at a load of half the bias current k_s is larger
# by a quarter. A data sheet or a geometry states coefficients without load; what was identified
# while the rotor levitated holds the load already. Whichever the machine file says
# (``coefficients_at``), one magnet follows from it: the linear plant takes its slopes at the load,
# the virtual rig its force.


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
        "for a vertical rotor",
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
