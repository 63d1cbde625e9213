"""The kinds of magnets as networks with their drive."""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import check_positive
from ambrose.machine.magnet import Magnet
from ambrose.model.magnetics.driven import DrivenMagnet
from ambrose.model.magnetics.iron import Froehlich
from ambrose.model.magnetics.network import Branch, MagneticNetwork

_QUADRANTS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
# mean radius of the flux's way through the journal over the journal's (assumed: laminations from
# half the radius outwards)
_JOURNAL = 0.75
# first numbers of the network's nodes: stator (yoke), rotor (journal), pole tips; numbers only tell
# nodes apart, and magnets have fewer than 1,000 poles
_S, _R = 0, 1000
_TIP = 2000
_ZERO = 1e-12  # sine or cosine of a right angle, whose rounding is taken off


def magnet_of(part: Magnet) -> DrivenMagnet:
    """The magnet of a [bearing.magnet]."""
    return homopolar(part) if part.kind == "homopolar" else heteropolar(part)


def heteropolar(part: Magnet, *, separate: bool = False) -> DrivenMagnet:
    """Poles around the journal; coils: one per half-axis (zeta, eta, -zeta, -eta), all its poles in
    series; ``separate``: one per pole.

    With 8 poles at +-22.5 deg, ideal iron and N turns on each pole: k_i = 4 mu_0 N^2 A i_0
    cos(a)/s_0^2 and k_s = 4 mu_0 N^2 A i_0^2/s_0^3. The horseshoe alone would have cos(a)^2 of
    that, k_i^2/(2 L_0); the rest, sin(a)^2, is of the neighbours across the motion, whose poles
    share the journal: the sum over all poles does not depend on the direction.
    """
    p = part.pole_count
    m = p // 4
    within = (np.arange(m) - (m - 1) / 2) * 2 * np.pi / p
    angles = (np.arange(4)[:, None] * np.pi / 2 + within).ravel()
    share = np.ones(m)
    if part.kind == "e-core":
        # the middle pole alone carries turns, and has twice the face
        areas, signs = np.array([1.0, 2.0, 1.0]), np.array([0.0, 1.0, 0.0])
    else:
        areas, signs = share, _signs(m, part.polarity)
    turned = np.array([1.0, -1.0, 1.0, -1.0])  # from quadrant to quadrant
    alternate = m == 3 or (m == 2 and part.polarity == "NNSS")
    sense = np.outer(turned if alternate else np.ones(4), signs).ravel()
    areas = np.tile(areas, 4) * part.pole_area

    branches: list[Branch] = []
    coils: list[int] = []
    _ring(part, branches, coils, angles, areas)
    turns = np.zeros((len(branches), p))
    for pole, branch in enumerate(coils):
        turns[branch, pole] = part.turns * sense[pole]
    series = np.kron(np.eye(4), np.ones((m, 1)))
    if separate:
        drive = series @ _QUADRANTS
        return DrivenMagnet(MagneticNetwork(branches, turns), np.ones(p), drive)
    return DrivenMagnet(MagneticNetwork(branches, turns @ series), np.ones(4), _QUADRANTS.copy())


def _signs(m: int, polarity: str) -> np.ndarray:
    """Senses (m,), +1 or -1, of the m poles of one half-axis: in turn, but N S S N for four with
    ``polarity`` "NNSS".
    """
    if m == 4 and polarity == "NNSS":
        return np.array([1.0, -1.0, -1.0, 1.0])
    return np.where(np.arange(m) % 2 == 0, 1.0, -1.0)


def _ring(
    part: Magnet,
    branches: list[Branch],
    coils: list[int],
    angles: np.ndarray,
    areas: np.ndarray,
) -> None:
    """Poles between a yoke and a journal; ``coils`` receives the branch of every pole's coil."""
    p = len(angles)
    iron = Froehlich(part.iron_permeability, part.iron_flux_density)
    rings = part.back_iron_area is not None
    for k, (angle, area) in enumerate(zip(angles, areas, strict=True)):
        yoke, journal = (_S + k * rings, _R + k * rings)
        tip = yoke
        coils.append(len(branches))
        if part.iron_path is not None:
            tip = _TIP + k
            branches.append(Branch(yoke, tip, area, part.iron_path, f"pole {k + 1}", curve=iron))
        normal = (float(np.cos(angle)), float(np.sin(angle)))
        branches.append(Branch(tip, journal, area, part.gap, f"pole {k + 1}", normal))
        if part.leakage > 0 and part.iron_path is not None:
            branches.append(Branch(tip, journal, part.leakage * area, part.gap, f"leakage {k + 1}"))
    if part.back_iron_area is not None:
        assert part.journal_radius is not None and part.iron_path is not None
        outer = part.journal_radius + part.gap + part.iron_path
        for first, radius, name in (
            (_S, outer, "yoke"),
            (_R, _JOURNAL * part.journal_radius, "journal"),
        ):
            for k in range(p):
                along = Branch(
                    first + k,
                    first + (k + 1) % p,
                    part.back_iron_area,
                    2 * np.pi * radius / p,
                    f"{name} {k + 1}",
                    curve=iron,
                )
                branches.append(along)


def homopolar(part: Magnet) -> DrivenMagnet:
    """Two planes of p poles; coils: one per pole of a plane, in series with the other plane's, and
    the bias coil around the shaft where there is one, last.

    Pole k at the angle a_k gets i_zeta cos(a_k) + i_eta sin(a_k). With 4 poles and ideal iron, per
    plane k_i = 2 N A B_0/s_0, k_s = 2 A B_0^2/(mu_0 s_0).
    """
    p = part.pole_count
    angles = np.arange(p) * 2 * np.pi / p
    iron = Froehlich(part.iron_permeability, part.iron_flux_density)
    permanent = part.bias == "permanent-magnet"
    branches: list[Branch] = []
    columns: list[np.ndarray] = []
    for plane, sense in enumerate((1.0, -1.0)):
        stator = _S + plane * permanent
        for k, angle in enumerate(angles):
            # the bias flux leaves the stator in one plane and enters it in the other: the control
            # coils are wound so that it is raised on the same side
            coil = np.zeros(p + 1)
            coil[k] = sense * part.turns
            coil[p] = 0.0 if permanent or plane else float(part.bias_turns or 0.0)
            normal = (float(np.cos(angle)), float(np.sin(angle)))
            name = f"pole {k + 1} of plane {plane + 1}"
            tip = stator
            if part.iron_path is not None:
                tip = _TIP + plane * p + k
                branches.append(
                    Branch(stator, tip, part.pole_area, part.iron_path, name, curve=iron)
                )
                columns.append(coil)
            branches.append(Branch(tip, _R, part.pole_area, part.gap, name, normal))
            columns.append(np.zeros(p + 1) if part.iron_path is not None else coil)
            if part.leakage > 0 and not permanent and part.iron_path is not None:
                area = part.leakage * part.pole_area
                branches.append(Branch(tip, _R, area, part.gap, f"leakage of {name}"))
                columns.append(np.zeros(p + 1))
    if permanent:
        assert part.magnet_area is not None and part.magnet_length is not None
        source = Branch(
            _S + 1,
            _S,
            part.magnet_area,
            part.magnet_length,
            "permanent magnet",
            remanence=float(part.remanence or 0.0),
            permeability=part.magnet_permeability,
        )
        branches.append(source)
        columns.append(np.zeros(p + 1))
        if part.leakage > 0:
            area = part.leakage * part.magnet_area
            branches.append(Branch(_S, _S + 1, area, part.magnet_length, "leakage"))
            columns.append(np.zeros(p + 1))
    drive = np.column_stack([np.cos(angles), np.sin(angles)])
    drive[np.abs(drive) < _ZERO] = 0.0
    turns = np.array(columns)
    if permanent:
        return DrivenMagnet(MagneticNetwork(branches, turns[:, :p]), np.zeros(p), drive)
    bias = np.zeros(p + 1)
    bias[p] = 1.0
    return DrivenMagnet(
        MagneticNetwork(branches, turns), bias, np.vstack([drive, np.zeros((1, 2))])
    )


def three_pole(turns: float, pole_area: float, gap: float) -> DrivenMagnet:
    """Three poles at 90, 210 and 330 deg, one coil each, without another path for the flux.

    The force is the square of a single complex flux, so that it is linear about a static load
    only: bias currents (1, -1/2, -1/2) pull along +eta, f_eta = (9/16) mu_0 N^2 A i_0^2/s_0^2 2/3,
    and k_i is diagonal there. Source: Chen and Hsu, IEEE/ASME Trans. Mechatronics 7 (2002).
    """
    angles = np.pi / 2 + np.arange(3) * 2 * np.pi / 3
    branches = [
        Branch(_S, _R, pole_area, gap, f"pole {k + 1}", (float(np.cos(a)), float(np.sin(a))))
        for k, a in enumerate(angles)
    ]
    network = MagneticNetwork(branches, turns * np.eye(3))
    # One complex flux phi = phi_zeta + j phi_eta makes the force f_zeta + j f_eta ~ -j conj(phi)^2.
    # Bias puts phi along eta; a small change d of it adds -2 j conj(phi) conj(d), so that currents
    # in the pattern -cos(a) add force along zeta, and sin(a) along eta.
    drive = np.column_stack([-np.cos(angles), np.sin(angles)])
    return DrivenMagnet(network, np.array([1.0, -0.5, -0.5]), drive)


def thrust(
    turns: tuple[float, float],
    inner_area: float,
    outer_area: float,
    gaps: tuple[float, float],
    outer_gap_share: float = 1.0,
) -> DrivenMagnet:
    """A collar between two ring magnets (towards +z, towards -z), each with an inner and an outer
    pole in series; turns and gaps [m] of the two sides may differ.

    With equal sides, areas A_1 and A_2: k_i = 4 i_0 N^2/(R_0^2 mu_0) (1/A_1 + 1/A_2)/2 with R_0 =
    s/(mu_0 A_1) + s/(mu_0 A_2), and k_s = k_i^2/(2 L_0), L_0 = N^2/R_0.
    """
    check_positive(outer_gap_share, "the outer gap over the inner one", "1 is usual")
    branches: list[Branch] = []
    coils = np.zeros((4, 2))
    for side, (gap, way) in enumerate(zip(gaps, (1.0, -1.0), strict=True)):
        word = "+z" if side == 0 else "-z"
        branches.append(Branch(side, _R, inner_area, gap, f"inner pole of {word}", (way,)))
        outer = outer_gap_share * gap
        branches.append(Branch(_R, side, outer_area, outer, f"outer pole of {word}", (way,)))
        coils[2 * side, side] = turns[side]
    network = MagneticNetwork(branches, coils, 1)
    return DrivenMagnet(network, np.ones(2), np.array([[1.0], [-1.0]]), ("z",))
