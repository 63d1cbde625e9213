"""The undamped critical-speed map: where the rotor alone, on equal springs k at its journals,
whirls forward as fast as it spins, over k; and the stiffness that its bearings have.

In one plane, z = x + j y and z = v e^{j W t}:

    (K + k N^T N) v = W^2 (M - G) v,

M, K, G of the free rotor's modes, N its displacements at the journals. K + k N^T N is positive
definite, so that 1/W^2 are the positive eigenvalues of the pencil (M - G, K + k N^T N); how many
there are does not depend on k (Sylvester). Seals, stages, couplings and supports are left out.

A film's stiffness is K_xx or K_yy of its table at the speed. A magnet's is what it holds an axis
with that alone moves, at the frequency of the speed:

    K(jW) = k_i (A(jW) C(jW) S(jW) - E(jW) jW) - k_s,

with S the sensor, C the law as it runs (sampled, late, held), i = A u + E q' the amplifier. Its
modulus is drawn over the map; the real part is the spring in it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigvalsh, null_space

from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.stations import Layout, rigid_support_critical
from ambrose.core.frequency import frequency_response
from ambrose.law.law import SPEED, LawLike, law_of
from ambrose.machine.machine import Machine
from ambrose.model.assemble import in_plane, modes_of
from ambrose.model.effects import amplifier, sensor
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties, plane_rows
from ambrose.model.effects.stations import JournalBearing, coefficients
from ambrose.model.plant import QUARTER, sensor_ports
from ambrose.model.static_load import magnet_coefficients

_COUNT = (2, 5)  # critical speeds, at least and at most
_TO = 3.0  # times the top speed: what lies above it on soft supports is left out
_SOFT, _HARD = 1e-3, 1e2  # of the stiffness at which support and shaft yield alike
_PER_DECADE = 20  # values of k
_SPEEDS = 120  # of a bearing's curve
_SAME = 1e-6  # of the stiffness: curves that differ by less are one


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """The stiffness of a bearing over the speed.

    axes: of which it is ("A_zeta", "DE K_xx"); magnetic: whether of a magnet. speeds (w,) [rad/s];
    stiffness (w,) complex [N/m]: of a film the table's, real.
    """

    axes: tuple[str, ...]
    magnetic: bool
    speeds: np.ndarray
    stiffness: np.ndarray

    @property
    def name(self) -> str:
        return ", ".join(self.axes)


@dataclass(frozen=True, slots=True)
class Crossing:
    """An undamped critical speed [rad/s] with all journals on the stiffness [N/m] that the bearing
    ``support`` has at that speed; number: of the critical speed, from 1.
    """

    support: str
    number: int
    speed: float
    stiffness: float


@dataclass(frozen=True, slots=True, eq=False)
class CriticalMap:
    """stiffness (n,) [N/m], ascending; speeds (m, n) [rad/s]: the m lowest forward critical speeds;
    rigid (m,) [rad/s]: on supports that do not move.
    """

    stiffness: np.ndarray
    speeds: np.ndarray
    rigid: np.ndarray
    supports: tuple[Support, ...]
    crossings: tuple[Crossing, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Free:
    """One plane of the free rotor in its modes: stiffness (p,), inertia M - G (p, p), and the
    journals' displacements N (j, p).
    """

    stiffness: np.ndarray
    inertia: np.ndarray
    journals: np.ndarray


def critical_map(
    layout: Layout,
    at_top: ShaftLoop,
    loop_at: Callable[[float], ShaftLoop],
    controller: LawLike | None,
    speeds: tuple[float, float],
) -> CriticalMap:
    """The map of a machine, with its bearings' stiffness from one speed to another [rad/s].

    loop_at: speed -> loop, for a law that follows the speed; others are those of ``at_top``.
    """
    free = _free(layout)
    scheduled = controller is not None and law_of(controller).follows(SPEED)
    omega = np.linspace(*speeds, _SPEEDS)
    supports = tuple(
        _joined([*_magnets(at_top, loop_at if scheduled else None, omega), *_films(layout, omega)])
    )
    # the stiffness that yields as much as the shaft between rigid supports does
    mass = mass_properties(finite_element_rotor(layout.machine)).mass
    even = mass * rigid_support_critical(layout) ** 2 / len(layout.journals)
    sizes = [np.abs(item.stiffness) for item in supports]
    lowest = min([_SOFT * even, *(float(size.min()) for size in sizes if size.min() > 0)])
    highest = max([_HARD * even, *(float(size.max()) for size in sizes)])
    ends = np.floor(np.log10(max(lowest, 1e-6 * even))), np.ceil(np.log10(highest))
    stiffness = np.logspace(*ends, int(_PER_DECADE * (ends[1] - ends[0])) + 1)

    rows = [undamped_criticals(free, k) for k in stiffness]
    within = int((rows[0] <= _TO * speeds[1]).sum())
    count = min(max(within, _COUNT[0]), _COUNT[1], *(len(row) for row in rows))
    curves = np.array([row[:count] for row in rows]).T
    crossings = tuple(
        crossing for support in supports for crossing in _crossings(free, support, count)
    )
    return CriticalMap(stiffness, curves, _on_rigid(free)[:count], supports, crossings)


def _free(layout: Layout) -> _Free:
    """The free rotor of a layout; both planes are alike."""
    machine = layout.machine
    rotor = finite_element_rotor(machine)
    modes = modes_of(machine, rotor, None)
    shapes = in_plane(modes)
    gyroscopic = shapes.T @ rotor.plane_gyroscopic @ shapes
    places = [journal.position for journal in layout.journals]
    rows = plane_rows(rotor, places)[0] @ shapes
    return _Free(modes.frequencies[0::2] ** 2, np.eye(len(gyroscopic)) - gyroscopic, rows)


def undamped_criticals(free: _Free, stiffness: float) -> np.ndarray:
    """The forward critical speeds [rad/s], ascending, on springs of one stiffness [N/m] > 0."""
    springs = np.diag(free.stiffness) + stiffness * free.journals.T @ free.journals
    return _speeds(free.inertia, springs)


def _on_rigid(free: _Free) -> np.ndarray:
    """The same with the journals at rest: v = Z c with N Z = 0."""
    Z = null_space(free.journals)
    return _speeds(Z.T @ free.inertia @ Z, Z.T @ (free.stiffness[:, None] * Z))


def _speeds(inertia: np.ndarray, springs: np.ndarray) -> np.ndarray:
    """W, ascending, of springs v = W^2 inertia v with positive definite springs."""
    inverse_squares = eigvalsh(inertia, springs)  # 1/W^2
    return np.sort(inverse_squares[inverse_squares > 0] ** -0.5)


def _crossings(free: _Free, support: Support, count: int) -> Iterator[Crossing]:
    """Where W_n(|K(W)|) = W, by bisection between the speeds of the support's curve."""
    from scipy.optimize import brentq

    def excess(speed: float, number: int) -> float:
        size = float(np.interp(speed, support.speeds, np.abs(support.stiffness)))
        return float(undamped_criticals(free, size)[number] - speed)

    size = np.abs(support.stiffness)
    curve = np.array(
        [undamped_criticals(free, k)[:count] if k > 0 else np.zeros(count) for k in size]
    )
    for number in range(count):
        above = curve[:, number] - support.speeds
        for k in np.flatnonzero((above[:-1] > 0) != (above[1:] > 0)):
            if min(size[k], size[k + 1]) <= 0:
                continue
            low, high = support.speeds[k : k + 2]
            speed = float(brentq(excess, low, high, args=(number,)))
            stiffness = float(np.interp(speed, support.speeds, size))
            yield Crossing(support.name, number + 1, speed, stiffness)


def _magnets(
    at_top: ShaftLoop, loop_at: Callable[[float], ShaftLoop] | None, omega: np.ndarray
) -> Iterator[Support]:
    """K(jW) (w,) of every control axis."""
    if at_top.law is None:
        return
    machine = at_top.plant.machine
    K = dynamic_stiffness(machine, at_top, loop_at, omega)
    for a, axis in enumerate(machine.axes):
        yield Support((axis,), True, omega, K[:, a, a])


def dynamic_stiffness(
    machine: Machine,
    at_top: ShaftLoop,
    loop_at: Callable[[float], ShaftLoop] | None,
    omega: np.ndarray,
) -> np.ndarray:
    """K(jW) (w, a, a) [N/m] from the displacements of all control axes at their magnets to the
    forces against them; sensors move as their magnet does. omega (w,) [rad/s].
    """
    axes, point = machine.axes, at_top.point
    k_i, k_s = magnet_coefficients(machine, point)
    sensed = frequency_response(sensor.linearised(machine.sensor_pairs, axes), omega).values
    # every sensor reads its magnet's motion along its own direction
    channels = sensor.channels(machine.sensor_pairs, axes)
    spread = np.zeros((len(channels), len(axes)))
    angle = {bearing.name: bearing.angle for bearing in machine.bearings}
    for row, port in enumerate(sensor_ports(machine)):
        bearing = channels[row][1].bearing
        for axis, way in (("zeta", 0.0), ("eta", QUARTER)):
            turned = np.cos(port.direction - angle[bearing] - way)
            spread[row, axes.index(f"{bearing}_{axis}")] = turned
    drive = frequency_response(amplifier.linearised(machine.amplifier, axes, k_i), omega).values
    count = len(axes)
    stiffness = np.empty((len(omega), count, count), complex)
    for n, w in enumerate(omega):
        law = at_top if loop_at is None else loop_at(float(w))
        current = drive[n][:, :count] @ law.gain(1j * w) @ sensed[n] @ spread
        if drive.shape[2] > count:  # a current loop: what motion drives, back-EMF
            current = current - drive[n][:, count:] * 1j * w
        stiffness[n] = k_i[:, None] * current - np.diag(k_s)
    return stiffness


def _films(layout: Layout, omega: np.ndarray) -> Iterator[Support]:
    """K_xx and K_yy of every journal bearing at the speeds that its table covers."""
    for part in layout.machine.parts(JournalBearing):
        ends = (part.speed[0], part.speed[-1]) if part.speed else (0.0, np.inf)
        speeds = omega[(omega >= ends[0]) & (omega <= ends[1])]
        tables = [coefficients(part, float(speed))[0] for speed in speeds]
        for k, axis in enumerate("xy"):
            values = np.array([table[k, k] for table in tables], complex)
            yield Support((f"{part.name} K_{axis}{axis}",), False, speeds, values)


def _joined(supports: list[Support]) -> Iterator[Support]:
    """Supports of one stiffness as one."""
    kept: list[Support] = []
    for support in supports:
        for k, other in enumerate(kept):
            same = len(other.speeds) == len(support.speeds) and np.allclose(
                other.stiffness, support.stiffness, rtol=_SAME, atol=0.0
            )
            if same and other.magnetic is support.magnetic:
                kept[k] = Support(
                    (*other.axes, *support.axes), other.magnetic, other.speeds, other.stiffness
                )
                break
        else:
            kept.append(support)
    yield from kept
