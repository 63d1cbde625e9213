"""The free rotor: finite elements of a stepped shaft with rigid discs, and its modes.

Coordinates per node: [x, y, alpha, beta], alpha and beta the rotations about x and y, so that x' =
beta and y' = -alpha where there is no shear. M q'' + Omega G q' + K q = f, spin positive from x to
y, G skew. Every part of a machine stands on a node (``machine.attachment``); anywhere else the
elements' shape functions interpolate. The planes decouple at standstill; ``plane_*`` matrices act
on [w, theta] per node.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import check_finite, invalid, named_failure
from ambrose.core.mechanical import undamped_modes
from ambrose.core.presentation import Presented
from ambrose.machine.attachment import Piece, finer, mesh, node_positions, stations
from ambrose.machine.description import MachineDescription
from ambrose.machine.ordinary_file import FINE_MESH_MODES
from ambrose.machine.part import BendingMode, Disc, MeasuredRotor, ShaftSection
from ambrose.model.effects.beam import BeamElement, beam_element, conical_element, shape

STANDARD_GRAVITY = 9.80665  # [m/s2]

# plane -> index of the deflection and of the rotation within a node, sign of the rotation (y' =
# -alpha)
_PLANES = {"x": (0, 3, 1.0), "y": (1, 2, -1.0)}
_SMALL_MESH = 200  # elements, up to which four times as many are quickly solved
_RESIDUAL_SHIFT = 0.01  # of the first bending mode's square
_DEPENDENT = 1e-8  # of a load's own part of the residual displacements, below which it has none
# of a mode's frequency, to either side: spin speeds within which hysteretic rotating damping turns
# over from braking to driving; assumed, a step in the theory
TURN_OVER = 0.02
_NOTHING = 1e-10  # of a load, below which its part in the residual modes is rounding
# rotations at both ends, of their difference and their sum
_CHORD = 0.5 * np.array([[-1.0, 1.0], [1.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Rotor(Presented):
    """A rotor of N nodes without bearings.

    positions (N,) [m]: the nodes. plane_mass, plane_gyroscopic, plane_stiffness (2N, 2N), all
    symmetric, in [w, theta] per node: with z = w_x + j w_y they give M z'' - j Omega G z' + K z =
    f. shear (N-1,) [-]: phi of the elements' shape functions (beam.shape). bending (N-1, 2, 2) [N
    m]: the elements' stiffness against the difference and the sum of the rotations at their ends,
    as seen from their chords. corrected (2N, m), correction (m,) [1/s2]: M phi of the m bending
    modes of which the machine states a measured frequency, and by how much its square is above that
    of shaft and discs; plane_stiffness has it, so that the modes keep their shapes. stated: of a
    measured rotor the frequencies (n,) [rad/s] and the mass-orthonormal shapes (2N, n) of one
    plane, and no others.

    mass, gyroscopic, stiffness (4N, 4N) in [x, y, alpha, beta] per node are made anew at every
    reading: nothing but tests needs them.
    """

    positions: np.ndarray
    plane_mass: np.ndarray
    plane_gyroscopic: np.ndarray
    plane_stiffness: np.ndarray
    shear: np.ndarray
    bending: np.ndarray
    corrected: np.ndarray
    correction: np.ndarray
    stated: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def n_nodes(self) -> int:
        return len(self.positions)

    @property
    def most_bending(self) -> int:
        """How many bending modes it has in a plane."""
        return 2 * self.n_nodes - 2 if self.stated is None else len(self.stated[0])

    @property
    def mass(self) -> np.ndarray:
        """The mass matrix of both planes."""
        return _in_both(self.plane_mass)

    @property
    def gyroscopic(self) -> np.ndarray:
        """The gyroscopic matrix, skew: from one plane into the other."""
        from_y = to_plane(to_plane(self.plane_gyroscopic, "x").T, "y").T
        return from_y - from_y.T

    @property
    def stiffness(self) -> np.ndarray:
        """The stiffness of both planes."""
        return _in_both(self.plane_stiffness)


@dataclass(frozen=True, slots=True, repr=False)
class MassProperties(Presented):
    """mass [kg], centre [m] axial coordinate of the centre of mass, diametral_inertia about it and
    polar_inertia [kg m2].

    As the rotor's matrices have them: "bernoulli-euler" leaves the rotary inertia of the shaft out
    of diametral_inertia.
    """

    mass: float
    centre: float
    diametral_inertia: float
    polar_inertia: float


@dataclass(frozen=True, slots=True, eq=False)
class FreeModes:
    """Modes of the free rotor at standstill, real and mass-orthonormal.

    shapes (4N, 4 + 2 n): translation along x and y, tilting of the x and y planes about the centre
    of mass (exact; the right end moves in the positive direction), then the n bending shapes by
    ascending frequency, each in x and in y (the left end moves in the positive direction).
    frequencies (4 + 2 n,) [rad/s]: zeros for the rigid modes. compliance: how many of the last
    stand for the compliance of many others, and do not ring.
    """

    shapes: np.ndarray
    frequencies: np.ndarray
    compliance: int = 0

    def damping_ratios(self, machine: MachineDescription) -> np.ndarray:
        """Of every mode (4 + 2 n,): what was measured, else Rayleigh's and hysteretic damping, else
        modal_damping. Rigid modes, of frequency 0, have none; compliances have 1/sqrt(2).
        """
        return self._ratios(machine).sum(axis=0)

    def damping(self, machine: MachineDescription, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """Of every mode at a spin speed [rad/s]: damping c (n,) [rad/s] and circulatory stiffness
        k (n,) [rad2/s2], c q' + k [[0, 1], [-1, 0]] q in x and y (``rotating_force``).
        """
        still = 2 * self.frequencies * self.damping_ratios(machine)
        if not machine.rotating_share:
            return still, np.zeros(len(still))
        # by a unit velocity and a unit displacement along x
        parts = [*zip(self.frequencies.tolist(), self.rotating(machine).tolist(), strict=True)]
        less = [rotating_force((0, 0), (1, 0), speed, w, (a, b))[0] for w, (a, b) in parts]
        drives = [rotating_force((1, 0), (0, 0), speed, w, (a, b))[1] for w, (a, b) in parts]
        return still - less, np.array(drives)

    def rotating(self, machine: MachineDescription) -> np.ndarray:
        """The damping [rad/s] that turns with the rotor (n, 2): viscous, and hysteretic at rest."""
        parts = self._ratios(machine)[1:] * machine.rotating_share
        return np.asarray(2 * self.frequencies * parts).T

    def _ratios(self, machine: MachineDescription) -> np.ndarray:
        """Damping ratios (3, n): against the surroundings alone, viscous and hysteretic ones, which
        may turn with the rotor.
        """
        # C = alpha M + beta K: 2 zeta w = alpha + beta w^2; loss factor: K (1 + j eta) at s = j w
        alpha, beta = machine.rayleigh_alpha, machine.rayleigh_beta
        eta = machine.loss_factor
        w = np.where(self.frequencies > 0, self.frequencies, np.inf)
        ratios = np.zeros((3, len(w)))
        ratios[1] = machine.modal_damping
        if alpha or beta or eta:
            ratios[0], ratios[1] = alpha / (2 * w), beta * self.frequencies / 2
            ratios[2] = eta / 2
        for mode in machine.bending_modes:
            if mode.damping is not None:
                of_mode = slice(2 + 2 * mode.number, 4 + 2 * mode.number)
                ratios[:, of_mode] = np.array([[0.0], [mode.damping], [0.0]])
        compliances = slice(len(w) - self.compliance, None)
        ratios[:, compliances] = np.array([[np.sqrt(0.5)], [0.0], [0.0]])
        return ratios


def turn_over_speeds(machine: MachineDescription, highest: float) -> set[float]:
    """Between which speeds [rad/s] the hysteretic rotating damping of bending modes up to
    ``highest`` [rad/s] turns over.
    """
    if not (machine.loss_factor and machine.rotating_share):
        return set()
    rotor = finite_element_rotor(machine)
    modes = free_modes(rotor, min(2 * rotor.n_nodes - 2, FINE_MESH_MODES))
    w = modes.frequencies[modes.rotating(machine)[:, 1] > 0]
    return {float(x) for side in (-1, 0, 1) for x in w[w <= highest] * (1 + side * TURN_OVER)}


def rotating_force(
    place: tuple[float, float],
    velocity: tuple[float, float],
    speed: float,
    w: float,
    known: tuple[float, float],
) -> tuple[float, float]:
    """What the spin changes of a mode's damping force: (fx, fy) on its coordinates in x and y.

    place: x and y, velocity: x' and y', spin speed [rad/s], the mode's frequency w [rad/s]; known:
    viscous and hysteretic rotating damping at rest [rad/s] (``FreeModes.rotating``). What turns
    with the rotor sees z' - j W z of z = x + j y in place of z': viscous c z' drives with j W c z
    (Genta 2005, sec. 3.3). A loss factor gives w^2 (1 +- j eta), + for whirl faster than the spin:
    eta w z' below w, -j eta w^2 z above, turned over within ``TURN_OVER``.
    """
    less = 0.0
    if w > 0.0:
        less = known[1] * min(max(0.5 + 0.5 * (speed / w - 1.0) / TURN_OVER, 0.0), 1.0)
    k = speed * known[0] + w * less
    return less * velocity[0] - k * place[1], less * velocity[1] + k * place[0]


def finite_element_rotor(machine: MachineDescription) -> Rotor:
    """Assemble the shaft (``elements`` equal elements per section, divided where a part stands) and
    the discs of a machine; N = all elements + 1.

    Bending modes of which the machine states a measured frequency have it. Assembled once: machines
    of the same shaft, discs and places of parts share one rotor, whose arrays are read-only. Raises
    InvalidInput where a measured frequency would change the order of the modes. A measured rotor
    has a node at every place of a part, too.
    """
    if machine.measured_rotor is not None:
        return _measured_rotor(
            machine.shaft, stations(machine), machine.measured_rotor, machine.bending_modes
        )
    rotor = _rotor(machine.shaft, machine.discs, stations(machine), machine.beam_theory)
    measured = tuple(
        (mode.number, mode.frequency)
        for mode in machine.bending_modes
        if mode.frequency is not None
    )
    return _with_frequencies(rotor, tuple(sorted(measured))) if measured else rotor


@lru_cache(maxsize=8)
def _with_frequencies(rotor: Rotor, measured: tuple[tuple[int, float], ...]) -> Rotor:
    """The rotor with bending modes (number, frequency [rad/s]) as measured: K + sum (w^2 - w_0^2) M
    phi phi' M.
    """
    # one mode above the highest that was measured, as its upper neighbour
    numbers = [number for number, _ in measured]
    own, shapes = _plane_bending(rotor, min(max(numbers) + 1, 2 * rotor.n_nodes - 2))
    found = own.copy()
    for number, frequency in measured:
        found[number - 1] = frequency

    # the first pair out of order; the measured one of the two is named
    for k in np.flatnonzero(np.diff(found) <= 0)[:1]:
        number, frequency = next(one for one in measured if one[0] in {k + 1, k + 2})
        low = found[number - 2] if number > 1 else 0.0
        high = found[number] if number < len(found) else np.inf
        raise invalid(
            f"the frequency of [[bending_mode]] {number}",
            f"{frequency / (2 * np.pi):g} Hz",
            f"between those of its neighbours, {low / (2 * np.pi):.4g} and "
            f"{high / (2 * np.pi):.4g} Hz",
            "check which mode was measured, or correct the shaft",
        )

    # M phi and w^2 - w_0^2
    places = [number - 1 for number in numbers]
    corrected, correction = (
        rotor.plane_mass @ shapes[:, places],
        found[places] ** 2 - own[places] ** 2,
    )
    stiffness = rotor.plane_stiffness + (corrected * correction) @ corrected.T
    for array in (corrected, correction, stiffness):
        array.flags.writeable = False
    return replace(rotor, plane_stiffness=stiffness, corrected=corrected, correction=correction)


@lru_cache(maxsize=64)
def _measured_rotor(
    shaft: tuple[ShaftSection, ...],
    places: tuple[float, ...],
    body: MeasuredRotor,
    modes: tuple[BendingMode, ...],
) -> Rotor:
    """The matrices that have the rigid body's and the stated modes, and nothing else.

    Between the places a shape is assumed: the Legendre polynomial of its order, which has the nodes
    of a uniform free bar's mode and none of a rigid motion, and what is left at the places as a
    natural spline beside it, straight beyond them.
    """
    nodes = np.array(node_positions(mesh(shaft, (*places, *body.places))))
    length = nodes[-1] - nodes[0]
    centre = nodes[0] + length / 2 if body.centre is None else body.centre
    tilting = (
        body.mass * length**2 / 12 if body.diametral_inertia is None else body.diametral_inertia
    )
    translation, tilt = _rigid_motions(nodes, centre)
    rigid = np.stack([translation / np.sqrt(body.mass), tilt / np.sqrt(tilting)], axis=1)
    bending = np.zeros((2 * len(nodes), len(modes)))
    for k, mode in enumerate(modes):
        bending[0::2, k], bending[1::2, k] = _shape(nodes, body, np.array(mode.shape), k + 2)

    # Phi = [rigid, bending], P Phi = 1:  M = P' P,  K = P' diag(w^2) P,  G = P' W P; of W the
    # tilting's own entry J_p/J_d, and of each mode that with tilting and its own
    frequencies = np.array([mode.frequency for mode in modes], dtype=float)
    P = np.linalg.pinv(np.hstack([rigid, bending]))
    whirl = np.zeros((2 + len(modes), 2 + len(modes)))
    whirl[1, 1] = body.polar_inertia / tilting
    for k, mode in enumerate(modes, 2):
        whirl[1, k] = whirl[k, 1] = mode.gyroscopic[0]
        whirl[k, k] = mode.gyroscopic[1]
    squares = np.concatenate([np.zeros(2), frequencies**2])
    arrays = (nodes, P.T @ P, P.T @ whirl @ P, (P.T * squares) @ P, np.zeros(len(nodes) - 1))
    for array in (*arrays, frequencies, bending):
        array.flags.writeable = False
    nothing = np.zeros((len(nodes) - 1, 2, 2)), np.zeros((2 * len(nodes), 0)), np.zeros(0)
    return Rotor(*arrays, *nothing, stated=(frequencies, bending))


def _shape(
    nodes: np.ndarray, body: MeasuredRotor, stated: np.ndarray, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Deflection and slope (N,) at the nodes [m] of a shape (p,) stated at the body's places."""
    from scipy.interpolate import CubicSpline  # of rotors without a drawing alone

    span = nodes[0], nodes[-1]
    own = np.polynomial.Legendre.basis(order, domain=span) * np.sqrt((2 * order + 1) / body.mass)
    at, slope = np.array(body.places), own.deriv()
    own, slope = (f * (-1.0 if own(at) @ stated < 0 else 1.0) for f in (own, slope))
    if len(at) == 1:
        return own(nodes) + (stated - own(at)), slope(nodes)
    rest = CubicSpline(at, stated - own(at), bc_type="natural")
    inside = np.clip(nodes, at[0], at[-1])
    steep = rest(inside, 1)
    return own(nodes) + rest(inside) + steep * (nodes - inside), slope(nodes) + steep


@lru_cache(maxsize=8)
def _rotor(
    shaft: tuple[ShaftSection, ...],
    discs: tuple[Disc, ...],
    places: tuple[float, ...],
    theory: str,
) -> Rotor:
    positions, element = _elements(mesh(shaft, places), theory)
    mass, gyroscopic = _add_discs(element, positions, discs)

    # stiffness against theta_2 - theta_1 and theta_1 + theta_2 in place of theta_1, theta_2
    bending = _CHORD.T @ element.stiffness[:, 1::2, 1::2] @ _CHORD
    arrays = (
        positions,
        *(_assemble(part) for part in (mass, gyroscopic, element.stiffness)),
        element.shear,
        bending,
        np.zeros((2 * len(positions), 0)),
        np.zeros(0),
    )
    for array in arrays:
        array.flags.writeable = False
    return Rotor(*arrays)


def mesh_error(machine: MachineDescription, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The lowest ``count`` free bending frequencies (count,) [rad/s] of shaft and discs, and by how
    much each is above that of a mesh with 4 times the elements (2 times: of more than 200), as a
    fraction.

    Measured frequencies are left out of both: they hide a mesh, they do not mend it. A measured
    rotor has no mesh, and no error (0,). Raises
    InvalidInput when ``count`` exceeds what the mesh has.
    """
    if machine.measured_rotor is not None:  # without a mesh
        return free_modes(finite_element_rotor(machine), count).frequencies[4::2], np.zeros(0)
    places, theory = stations(machine), machine.beam_theory
    factor = 4 if len(mesh(machine.shaft)) <= _SMALL_MESH else 2
    own, fine = (
        free_bending_frequencies(_rotor(shaft, machine.discs, places, theory), count)
        for shaft in (machine.shaft, finer(machine.shaft, factor))
    )
    return own, own / fine - 1


def displacement_row(rotor: Rotor, position: float, direction_angle: float) -> np.ndarray:
    """The row (4N,) that reads the displacement [m] at an axial position [m] along a direction;
    transposed, it applies a force.

    direction_angle [rad] from x towards y. Raises InvalidInput off the shaft.
    """
    w = plane_rows(rotor, [position])[0][0]
    return np.cos(direction_angle) * to_plane(w, "x") + np.sin(direction_angle) * to_plane(w, "y")


def plane_rows(rotor: Rotor, positions: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Rows that read deflection w (p, 2N) and cross-section rotation theta (p, 2N) from [w, theta]
    per node, anywhere.

    positions (p,) [m]. Raises InvalidInput off the shaft.
    """
    # the four columns of the element's two nodes
    e, *local = _local_rows(rotor.positions, rotor.shear, positions)
    w, theta = np.zeros((2, len(e), 2 * rotor.n_nodes))
    for rows, values in zip((w, theta), local, strict=True):
        np.put_along_axis(rows, 2 * e[:, None] + np.arange(4), values, axis=1)
    return w, theta


def _local_rows(
    nodes: np.ndarray, shear: np.ndarray, positions: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The element (p,) in which each axial position [m] lies, and its rows w (p, 4) and theta (p,
    4) there.
    """
    at = np.atleast_1d(check_finite(positions, "the axial position [m]")).astype(float)
    start, end = nodes[0], nodes[-1]
    slack = 1e-9 * (end - start)
    off = (at < start - slack) | (at > end + slack)
    if off.any():
        place, span = f"{at[off][0]:g} m", f"on the shaft, from {start:g} to {end:g} m"
        raise invalid(
            "the axial position", place, span, "move the attachment or lengthen the shaft"
        )
    e = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    length = np.diff(nodes)[e]
    return e, *shape(np.clip((at - nodes[e]) / length, 0.0, 1.0), length, shear[e])


def to_plane(vector: np.ndarray, plane: str) -> np.ndarray:
    """Coordinates (2N, ...) in [w, theta] per node of the "x" or "y" plane, as coordinates (4N,
    ...) of the whole rotor.
    """
    whole = np.zeros((2 * vector.shape[0], *vector.shape[1:]))
    deflection, rotation, sign = _PLANES[plane]
    whole[deflection::4] = vector[0::2]
    whole[rotation::4] = sign * vector[1::2]
    return whole


def mass_properties(rotor: Rotor) -> MassProperties:
    """Mass, centre of mass and inertias that the rotor's own matrices imply."""
    # first moment over mass, then the moments about that centre
    translation, tilt = _rigid_motions(rotor.positions, 0.0)
    mass = translation @ rotor.plane_mass @ translation
    centre = translation @ rotor.plane_mass @ tilt / mass
    _, tilt = _rigid_motions(rotor.positions, centre)
    return MassProperties(
        float(mass),
        float(centre),
        float(tilt @ rotor.plane_mass @ tilt),
        float(tilt @ rotor.plane_gyroscopic @ tilt),
    )


def gravity_load(
    rotor: Rotor, direction: float | None, acceleration: float = STANDARD_GRAVITY
) -> np.ndarray:
    """The rotor's weight (4N,) [N, N m] on its coordinates: M times the acceleration of free fall
    [m/s2].

    direction [rad] from x towards y, -pi/2 for down along y; None: no weight. In modes: shapes.T
    times it.
    """
    load = np.zeros(4 * rotor.n_nodes)
    if direction is not None:
        translation, _ = _rigid_motions(rotor.positions, 0.0)
        for plane, part in (("x", np.cos(direction)), ("y", np.sin(direction))):
            load += acceleration * part * to_plane(rotor.plane_mass @ translation, plane)
    return load


def free_bending_frequencies(rotor: Rotor, count: int) -> np.ndarray:
    """The lowest ``count`` free-free bending frequencies at standstill (count,) [rad/s], each once
    though both planes have it.

    Raises InvalidInput when ``count`` exceeds what the mesh has (2N - 2).
    """
    return _plane_bending(rotor, count)[0]


@lru_cache(maxsize=16)
def free_modes(rotor: Rotor, n_bending: int) -> FreeModes:
    """Rigid modes (exact) and the lowest ``n_bending`` bending modes of each plane of the free
    rotor at standstill.

    Computed once for a rotor; the arrays are read-only. Raises InvalidInput when ``n_bending``
    exceeds what the mesh has (2N - 2).
    """
    rigid = _rigid_modes(rotor)
    frequencies, bending = (
        _plane_bending(rotor, n_bending) if n_bending else (np.zeros(0), np.zeros((len(rigid), 0)))
    )
    plane = np.hstack([rigid, bending])

    # columns in turn: a mode in x, the same in y
    shapes = np.stack([to_plane(plane, "x"), to_plane(plane, "y")], axis=2).reshape(
        2 * len(plane), -1
    )
    both = np.repeat(np.concatenate([np.zeros(2), frequencies]), 2)
    for array in (shapes, both):
        array.flags.writeable = False
    return FreeModes(shapes, both)


@named_failure("the residual compliance of the rotor")
def residual_modes(rotor: Rotor, kept: int, loads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What all bending modes of one plane but the lowest ``kept`` yield to loads, as modes:
    frequencies (r,) [rad/s] among themselves, ascending, and mass-orthonormal shapes (2N, r), r <=
    l.

    loads (l, 2N): rows as of ``plane_rows``, a load each. The static displacement X that they leave
    in those modes solves K X = L - M Phi Phi^T L, Phi the rigid and the kept modes, within the
    complement of Phi, where K is regular; a shift far below the kept modes makes the factorised
    matrix definite everywhere, and two corrections take it out again. Loads that leave nothing in
    those modes give none.
    """
    # K of shaft and discs alone: banded, which the corrections of measured modes would undo
    M, K = (
        rotor.plane_mass,
        rotor.plane_stiffness - (rotor.corrected * rotor.correction) @ rotor.corrected.T,
    )
    frequencies, bending = _plane_bending(rotor, kept)
    Phi = np.hstack([_rigid_modes(rotor), bending])

    # diagonals 0 to 3 below the main one: two coordinates per node, neighbours coupled
    shifted = K + _RESIDUAL_SHIFT * frequencies[0] ** 2 * M
    factor = sla.cholesky_banded(
        [np.append(np.diag(shifted, -i), np.zeros(i)) for i in range(4)], lower=True
    )

    # L - M Phi Phi^T L; each pass solves (K + shift M) dX = left - K X and projects dX onto the
    # complement of Phi, so that the shift's error falls pass by pass.
    left = loads.T - M @ (Phi @ (Phi.T @ loads.T))

    # forces and moments by the inertia they act on; what is left of some is rounding
    unit = np.sqrt(np.diag(M))[:, None]
    own = np.linalg.norm(left / unit, axis=0) > _NOTHING * np.linalg.norm(loads.T / unit, axis=0)
    if not own.any():
        return np.zeros(0), np.zeros((len(M), 0))
    left = left[:, own]
    X = np.zeros_like(left)
    for _ in range(3):
        step = sla.cho_solve_banded((factor, True), left - K @ X)
        X += step - Phi @ (Phi.T @ (M @ step))

    # Each X to norm one; directions that depend on the others drop out. Rayleigh-Ritz in the rest.
    left, size, _ = np.linalg.svd(X / np.linalg.norm(X, axis=0), full_matrices=False)
    X = left[:, size > _DEPENDENT * size[0]]
    return _modes_within(rotor, X)


def _plane_bending(rotor: Rotor, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (count,) [rad/s] and mass-orthonormal shapes (2N, count) of the bending modes of
    one plane.
    """
    available = rotor.most_bending
    if not 0 < count <= available:
        raise invalid(
            "the number of bending modes",
            count,
            f"between 1 and {available}",
            "refine the mesh or ask for fewer",
        )
    if rotor.stated is not None:
        return rotor.stated[0][:count], rotor.stated[1][:, :count]
    # once, however few are asked for
    frequencies, shapes = _lowest_bending(rotor, max(count, min(available, FINE_MESH_MODES)))
    return frequencies[:count], shapes[:, :count]


@lru_cache(maxsize=16)
def _lowest_bending(rotor: Rotor, count: int) -> tuple[np.ndarray, np.ndarray]:
    M, K = rotor.plane_mass, rotor.plane_stiffness
    # Rounding of K moves the rigid modes off zero, to either side; a shift far below the bending
    # modes keeps them positive.
    shift = 1e-10 * np.max(np.diag(K) / np.diag(M))
    _, shapes = undamped_modes(M, K + shift * M, count + 2)

    # the rigid modes are known exactly
    known = _rigid_modes(rotor)
    shapes = shapes[:, 2:]
    frequencies = np.zeros(0)
    # all 156 at once round the first by 3e-8, where 10, 26 and 64 agree to 2e-10
    if count > FINE_MESH_MODES:
        frequencies, lowest = _lowest_bending(rotor, FINE_MESH_MODES)
        known, shapes = np.hstack([known, lowest]), shapes[:, FINE_MESH_MODES:]

    # M-orthogonal to what is known; the left end moves in the positive direction.
    found, shapes = _modes_within(rotor, shapes - known @ (known.T @ (M @ shapes)))
    shapes = np.hstack([known[:, 2:], shapes])
    return np.append(frequencies, found), shapes * np.where(shapes[0] < 0, -1.0, 1.0)


def _modes_within(rotor: Rotor, shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (k,) [rad/s], ascending, and mass-orthonormal shapes (2N, k) that the rotor has
    within the span of ``shapes`` (2N, k), which holds the corrected modes or is orthogonal to them.

    The frequencies are the singular values of the elements' strains, not roots of eigenvalues of K:
    rounding leaves eps times the highest frequency in the lowest, not eps times its square. A disc
    or a sensor near a node leaves a piece whose modes are 1e7 times as high as the first.
    """
    # shapes^T M shapes = L L^T, Q = shapes L^-T, F Q = U diag(w) V^T, modes Q V
    L = np.linalg.cholesky(shapes.T @ rotor.plane_mass @ shapes)
    basis = sla.solve_triangular(L, shapes.T, lower=True).T
    _, own, Vt = np.linalg.svd(_strains(rotor, basis), full_matrices=False)
    own, modes = own[::-1], basis @ Vt[::-1].T

    # a corrected mode keeps its shape and has w_0^2 + (w^2 - w_0^2); (M phi)^T modes is 1 for it
    share = (rotor.corrected.T @ modes) ** 2
    return np.sqrt(own**2 + rotor.correction @ share), modes


def _strains(rotor: Rotor, shapes: np.ndarray) -> np.ndarray:
    """F shapes (2 (N - 1), k) [J^1/2], with K = F^T F for shaft and discs: every element's two
    deformations, formed from differences of ``shapes`` (2N, k), so that rigid motions give none.
    """
    w = shapes[0::2]
    theta = shapes[1::2]
    length = np.diff(rotor.positions)[:, None]
    left, right = theta[:-1], theta[1:]

    # theta_2 - theta_1 and theta_1 + theta_2 - 2 (w_2 - w_1)/L, as ``bending`` = R R^T takes them
    e = np.stack([right - left, right + left - 2 * np.diff(w, axis=0) / length], axis=1)
    root = np.linalg.cholesky(rotor.bending)
    return (root.swapaxes(1, 2) @ e).reshape(-1, shapes.shape[1])


def _rigid_modes(rotor: Rotor) -> np.ndarray:
    """Mass-orthonormal translation and tilting (2N, 2) of one plane."""
    properties = mass_properties(rotor)
    translation, tilt = _rigid_motions(rotor.positions, properties.centre)
    return np.stack(
        [translation / np.sqrt(properties.mass), tilt / np.sqrt(properties.diametral_inertia)],
        axis=1,
    )


def _rigid_motions(positions: np.ndarray, about: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit translation and unit tilting about an axial position, (2N,) each."""
    translation, tilt = np.zeros((2, 2 * len(positions)))
    translation[0::2] = 1.0
    tilt[0::2], tilt[1::2] = positions - about, 1.0
    return translation, tilt


def _elements(pieces: tuple[Piece, ...], theory: str) -> tuple[np.ndarray, BeamElement]:
    """Node positions (N,) [m] and the matrices of all elements."""
    materials = [piece.section.material for piece in pieces]
    lengths = np.array([piece.length for piece in pieces])
    outer, inner, heavy = np.array(
        [piece.section.diameters((piece.left + piece.right) / 2) for piece in pieces]
    ).T
    element = beam_element(
        lengths,
        outer,
        inner,
        density=np.array([material.density for material in materials]),
        youngs_modulus=np.array([material.youngs_modulus for material in materials]),
        poisson_ratio=np.array([material.poisson_ratio for material in materials]),
        mass_diameter=heavy,
        theory=theory,
    )
    _make_conical(element, pieces, theory)
    return np.array(node_positions(pieces)), element


def _make_conical(element: BeamElement, pieces: tuple[Piece, ...], theory: str) -> None:
    """The elements of conical sections in place of the cylinders of their mean diameters."""
    for number, piece in enumerate(pieces):
        section, material = piece.section, piece.section.material
        if not section.conical:
            continue
        cone = conical_element(
            piece.length,
            *zip(section.diameters(piece.left), section.diameters(piece.right), strict=True),
            density=material.density,
            youngs_modulus=material.youngs_modulus,
            poisson_ratio=material.poisson_ratio,
            theory=theory,
        )
        for name in ("translational", "rotary", "gyroscopic", "stiffness", "shear"):
            getattr(element, name)[number] = getattr(cone, name)


def _add_discs(
    element: BeamElement, positions: np.ndarray, discs: tuple[Disc, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Mass and gyroscopic matrices (e, 4, 4) of the elements with the discs spread onto them."""
    mass, gyroscopic = element.mass, element.gyroscopic.copy()
    if discs:
        at, w, theta = _local_rows(positions, element.shear, [disc.position for disc in discs])
        kilograms, diametral, polar = np.array(
            [[d.mass, d.diametral_inertia, d.polar_inertia] for d in discs]
        ).T[..., None, None]

        # m w^T w + J_d theta^T theta and J_p theta^T theta; several discs may lie in one element
        tilting = theta[:, :, None] * theta[:, None, :]
        np.add.at(mass, at, kilograms * (w[:, :, None] * w[:, None, :]) + diametral * tilting)
        np.add.at(gyroscopic, at, polar * tilting)
    return mass, gyroscopic


def _assemble(blocks: np.ndarray) -> np.ndarray:
    """The chain of element matrices (e, 2k, 2k), k coordinates per node, as one matrix (k (e + 1),
    k (e + 1)).
    """
    e, k = len(blocks), blocks.shape[1] // 2
    whole = np.zeros((e + 1, k, e + 1, k))
    left = np.arange(e)
    right = left + 1
    whole[left, :, left] += blocks[:, :k, :k]
    whole[left, :, right] += blocks[:, :k, k:]
    whole[right, :, left] += blocks[:, k:, :k]
    whole[right, :, right] += blocks[:, k:, k:]
    return whole.reshape(k * (e + 1), k * (e + 1))


def _in_both(plane: np.ndarray) -> np.ndarray:
    """A symmetric matrix (2N, 2N) of one plane, in each of both (4N, 4N)."""
    return to_plane(to_plane(plane, "x").T, "x") + to_plane(to_plane(plane, "y").T, "y")
