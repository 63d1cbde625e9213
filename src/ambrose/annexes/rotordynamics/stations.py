"""Where a lateral analysis looks: stations all along the shaft, and everything that must not touch.

The rotor's motion is read in its modes, anywhere along the shaft, so that the plant stays the
machine's own.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigvalsh, null_space

from ambrose.core.checks import InvalidInput
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import FINE_MESH_MODES
from ambrose.model.effects.rotor import displacement_row, finite_element_rotor, free_modes
from ambrose.model.effects.stations import Clearance, JournalBearing, Probe
from ambrose.model.static_load import weight_in_plane

GRAVITY = 9.80665  # [m/s^2]
_MOST = 120  # stations along the shaft


@dataclass(frozen=True, slots=True)
class Journal:
    """A radial bearing that carries the rotor: magnetic or with an oil film.

    weight [kg]: the static load that it carries of the rotor lying horizontally. magnetic: whether
    it is a magnet.
    """

    name: str
    position: float
    weight: float
    magnetic: bool


@dataclass(frozen=True, slots=True)
class Reading:
    """A vibration probe: its place and the direction it reads along [rad]; None: both, the major
    axis counts.
    """

    name: str
    position: float
    direction: float | None


@dataclass(frozen=True, slots=True)
class Gap:
    """A place where rotor and stator must not touch.

    diametral [m]; share: of it that peak-to-peak motion may take; kind: "seal", "touchdown",
    "magnet" or "clearance".
    """

    name: str
    kind: str
    position: float
    diametral: float
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """A machine with its stations at ``positions`` (s,) [m] in order along the shaft."""

    machine: Machine
    positions: np.ndarray
    journals: tuple[Journal, ...]
    readings: tuple[Reading, ...]
    gaps: tuple[Gap, ...]

    def nearest(self, position: float) -> int:
        """The station nearest to an axial position [m]."""
        return int(np.argmin(np.abs(self.positions - position)))

    @property
    def overhang_right(self) -> np.ndarray:
        """Which stations (s,) lie outboard of the rightmost journal."""
        return self.positions > max(j.position for j in self.journals)


def lay_out(machine: Machine) -> Layout:
    """The stations of a machine. Raises InvalidInput where fewer than two journals carry it, or
    all at one place: then there is no span.
    """
    journals = journals_of(machine)
    if len({round(j.position, 9) for j in journals}) < 2:
        raise InvalidInput(
            f"{machine.name} has {len(journals)} radial bearing(s) at one place, but a lateral "
            "analysis needs two along the shaft; add [[bearing]] or [[journal_bearing]]"
        )
    readings, gaps = tuple(_readings(machine)), tuple(_gaps(machine))
    rotor = finite_element_rotor(machine)
    places = list(rotor.positions)
    if len(places) > _MOST:
        places = list(np.linspace(places[0], places[-1], _MOST))
    places += [journal.position for journal in journals]
    places += [reading.position for reading in readings]
    places += [gap.position for gap in gaps]
    places += [disc.position for disc in machine.discs]
    left, right = (f(j.position for j in journals) for f in (min, max))
    places.append(0.5 * (left + right))
    positions = _distinct(np.array(places), 1e-6 * machine.length)
    return Layout(machine, positions, journals, readings, gaps)


def _distinct(places: np.ndarray, slack: float) -> np.ndarray:
    ordered = np.sort(places)
    return ordered[np.concatenate([[True], np.diff(ordered) > slack])]


def journals_of(machine: Machine) -> tuple[Journal, ...]:
    """The radial bearings in order along the shaft, each with the weight [kg] that it carries."""
    found = [(b.name, b.position, True) for b in machine.bearings]
    found += [(oil.name, oil.position, False) for oil in machine.parts(JournalBearing)]
    found.sort(key=lambda item: item[1])
    if not found:
        return ()
    places = tuple(position for _, position, _ in found)
    # K w = W + B^T f with w = 0 at every journal: the shaft on rigid supports
    load = weight_in_plane(finite_element_rotor(machine), places, places, places)[1]
    return tuple(
        Journal(name, position, float(force) / GRAVITY, magnetic)
        for (name, position, magnetic), force in zip(found, load, strict=True)
    )


def rigid_support_critical(layout: Layout) -> float:
    """The first undamped critical speed [rad/s] of the shaft at rest on supports that do not move.

    In modes q of the free rotor, M = I and K = diag(w^2), the journals stand still: R q = 0. With
    q = N z, N an orthonormal basis of R's null space: omega^2 = least eigenvalue of N^T K N.
    """
    rotor = finite_element_rotor(layout.machine)
    modes = free_modes(rotor, min(rotor.most_bending, FINE_MESH_MODES))
    w, shapes = modes.frequencies[0::2], modes.shapes[:, 0::2]
    rows = np.array([displacement_row(rotor, j.position, 0.0) for j in layout.journals])
    N = null_space(rows @ shapes)
    return float(np.sqrt(eigvalsh(N.T @ (w[:, None] ** 2 * N))[0]))


def _readings(machine: Machine) -> Iterator[Reading]:
    """The displacement sensors of magnetic bearings, and the file's own probes."""
    for pair in machine.sensor_pairs:
        angle = pair.angle or 0.0
        for axis, turn in (("zeta", 0.0), ("eta", np.pi / 2)):
            yield Reading(f"{pair.bearing} {axis}", pair.position, angle + turn)
    for probe in machine.parts(Probe):
        yield Reading(probe.name, probe.position, probe.direction)


def _gaps(machine: Machine) -> Iterator[Gap]:
    from ambrose.annexes.rotordynamics.standard import CLEARANCE_SHARE

    for bearing in machine.bearings:
        if bearing.touchdown_gap:
            yield Gap(
                f"touchdown {bearing.name}",
                "touchdown",
                bearing.position,
                2 * bearing.touchdown_gap,
                CLEARANCE_SHARE,
            )
        if bearing.gap:
            yield Gap(
                f"magnet {bearing.name}",
                "magnet",
                bearing.position,
                2 * bearing.gap,
                CLEARANCE_SHARE,
            )
    for seal in machine.seals:
        sides = [
            radial
            for name in ("inlet_clearance", "exit_clearance")
            if (radial := getattr(seal.geometry, name, None))
        ]
        if sides:
            yield Gap(f"seal {seal.name}", "seal", seal.position, 2 * min(sides), CLEARANCE_SHARE)
    for part in machine.parts(Clearance):
        yield Gap(part.name, "clearance", part.position, part.diametral, part.limit_share)
