"""The unbalance of a rotor from the amplitudes of a converged synchronous block: no trial weights.

Once a block of mode current-free has converged the control current has no 1x part, so that what is
measured is the rotor's own response, y = c = Re(exp(j theta) a):

    a(W) = sum_p G_p(W) W^2 U_p + L(W) R                                                 (1)
    G_p: displacement per forward force in plane p;  R: run-out of the sensors, L their lag

with the plant's G at the speed, magnets' negative stiffness included. Amplitudes of several speeds
are one linear least-squares problem in the complex U_p [kg m] (Fang et al., Sensors 13 (2013)
16000, balance from coil currents in one start-up). Run-out does not grow with W^2 and is solved for
beside the unbalance where the speeds are apart. No controller enters: its current is zero.

The change since an earlier table is a problem of the same form, of the difference of amplitudes:
run-out and what both have in common drop out. It tells an unbalance that grows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.annexes.site.balancing.amplitude_table import AmplitudeTable
from ambrose.annexes.site.balancing.correction import Balancing, Row
from ambrose.annexes.site.balancing.vectors import UNBALANCE
from ambrose.annexes.site.balancing.weighted_fit import ILL, LEAST, circle_of_95, weighted_fit
from ambrose.core.checks import InvalidInput, check_positive, check_shape, invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import select
from ambrose.identification.parameters import COVERAGE
from ambrose.law.law import LawLike, law_of
from ambrose.law.synchronous import Condition, SynchronousLoop
from ambrose.machine.axial import across_the_shaft
from ambrose.machine.machine import Machine
from ambrose.machine.messages import suggestion
from ambrose.model.assemble import assemble
from ambrose.model.effects.sensor import runout_phasors
from ambrose.model.plant import Plant, beyond_top_speed
from ambrose.model.ports import ports
from ambrose.model.unbalance import residual_unbalance
from ambrose.model.uncertainty import perturbed, tolerances_around

APART = 1.3  # least ratio of speeds that tells run-out from unbalance
_NO_CURRENT = (
    "the amplitudes are taken as those of converged blocks of mode current-free: no 1x current"
)


_UNCHECKED = "that one was on is not checked (--controller names the one that ran)"
_RPM = 30 / np.pi  # rpm per rad/s


@dataclass(frozen=True, slots=True, eq=False)
class UnbalanceEstimate:
    """moments (planes,) complex [kg m], the angle that of the mass from x at the key phasor's
    pulse; planes: the ports; residual [-]: what is left of the amplitudes, as a share of their
    size; runout (a,) complex [m] (None: not asked).
    """

    moments: np.ndarray
    planes: tuple[str, ...]
    residual: float
    runout: np.ndarray | None = None

    def corrections(self, radius: Sequence[float]) -> tuple[tuple[float, float], ...]:
        """Mass [g] and angle [deg] to add in every plane at these radii [m], opposite to the
        unbalance.
        """
        if len(radius) != len(self.planes):
            raise invalid(
                "the number of radii",
                len(radius),
                f"one per plane, {len(self.planes)}",
                "give each its own",
            )
        added = -self.moments / np.asarray(radius, float)
        return tuple((float(1e3 * abs(m)), float(np.degrees(np.angle(m)) % 360)) for m in added)


def balance_amplitudes(
    machine: Machine,
    amplitudes: AmplitudeTable,
    planes: Mapping[str, float],
    *,
    before: AmplitudeTable | None = None,
    pressure: float | None = None,
    controller: LawLike | None = None,
) -> Balancing:
    """Correction masses from amplitudes of converged current-free blocks.

    planes: bearings, couplings, seals or discs, each with the radius [m] where masses go. before:
    an earlier table; what is balanced is then what has come since, and ``grown`` of the result
    tells whether it is more than its own uncertainty. pressure [Pa]: of the seals (None: the design
    point's). controller: whose blocks they are (None: the machine file's). The covariance holds the
    scatter of the readings, the misfit between axes and speeds, and the tolerances of the machine
    file. Raises InvalidInput, also for a speed at which no current-free block is on.
    """
    across_the_shaft(machine, UNBALANCE)
    radii = {
        name: check_positive(r, f"the radius of plane {name}", "give it in m")
        for name, r in planes.items()
    }
    if not radii:
        raise InvalidInput(
            "no correction plane is given; name a bearing, disc, seal or coupling of the machine, "
            "and a radius"
        )
    known = _check_speeds(machine, amplitudes, controller)
    names, table = tuple(radii), amplitudes if before is None else amplitudes.since(before)
    design = machine.operation.design
    at = replace(
        design, label="", seal_pressure=design.seal_pressure if pressure is None else pressure
    )
    plants = [assemble(machine, replace(at, speed=float(speed))) for speed in table.speeds]

    # run-out: in no difference; an unknown where speeds are apart; else as the machine file has it
    axes, speeds = len(machine.axes), table.speeds
    free = before is None and float(speeds.max()) > APART * float(speeds.min())
    R = np.zeros(axes, complex)
    if before is None and not free:
        R = runout_phasors(machine.sensor_pairs, machine.axes)

    first = _fit(plants, names, table, R, free)
    spread = np.zeros((len(names), len(names)), complex)
    for path in dict.fromkeys(t.parameter for plant in plants for t in tolerances_around(plant)):
        # dU with a parameter at the end of its tolerance, COVERAGE standard deviations
        moved = _fit([_moved(plant, path) for plant in plants], names, table, R, free)
        change = (moved.unbalance - first.unbalance) / COVERAGE
        spread += np.outer(change, change.conj())
    covariance = first.covariance + spread

    # each axis and speed: what unbalance makes now, and what is left of it, with its 95 % circle
    rows = []
    for k, speed in enumerate(speeds):
        A = first.influence[k]
        turning = table.values[k] - (0 if before is not None else 1) * first.runout
        C = A @ covariance @ A.conj().T + np.diag(first.variance[k])
        radius = first.factor * np.sqrt(np.real(np.diag(C)))
        left = turning - A @ first.unbalance
        for axis, b, c, r in zip(machine.axes, turning, left, radius, strict=True):
            rows.append(Row(axis, float(speed), complex(b), complex(c), float(r)))

    notes = [_NO_CURRENT if known else f"{_NO_CURRENT}; {_UNCHECKED}"]
    if first.condition > ILL:
        notes.append(
            f"the unknowns are hardly told apart (condition {first.condition:.3g}): read another "
            "speed, or use fewer planes"
        )
    if before is None and not free:
        what = "from the machine file" if R.any() else "zero, and balanced as if it were unbalance"
        notes.append(
            f"the amplitudes are of one speed: run-out was taken as {what}; a reading at another "
            "speed tells it"
        )
    result = Balancing(
        machine.name,
        names,
        tuple(radii.values()),
        -first.unbalance,
        covariance,
        first.factor,
        first.condition,
        first.model_error,
        "model",
        "y, current-free",
        tuple(rows),
        first.runout,
        free or before is not None,
        None,
        residual_unbalance(machine),
        tuple(notes),
    )
    if before is None:
        return result
    # a change has no balance quality: what was there before is not known
    return replace(result, allowed=None, notes=(*notes, *_growth(result)))


def _check_speeds(machine: Machine, table: AmplitudeTable, controller: LawLike | None) -> bool:
    """Whether it is known where the blocks are on; every speed of the table is there then.

    Raises InvalidInput for a speed that no current-free block is on at, or that is above the
    machine's own.
    """
    settings = machine.controller
    if controller is not None:
        blocks, whose = law_of(controller).synchronous, "the controller"
    else:
        blocks, whose = () if settings is None else settings.synchronous, "the machine file"
    for speed in map(float, table.speeds):
        if beyond := beyond_top_speed(machine, speed):
            raise InvalidInput(
                f"the amplitudes hold a speed above the machine's own: {beyond}; correct speed_rpm"
            )
    if controller is None and not blocks:
        return False
    free = [b for b in blocks if b.mode == "current-free" and b.harmonic == 1]
    if not free:
        raise InvalidInput(
            f"{whose} has no current-free block, and other amplitudes are not the rotor's own; "
            "balance from records, or give the controller that ran"
        )
    for speed in map(float, table.speeds):
        if not any(block.band[0] <= speed <= block.band[1] for block in free):
            bands = ", ".join("{:.5g} to {:.5g}".format(*np.array(b.band) * _RPM) for b in free)
            raise InvalidInput(
                f"a line of the amplitudes is at {speed * _RPM:.5g} rpm, where no current-free "
                f"block of {whose} is on ({bands} rpm); leave it out, or give the controller that "
                "ran"
            )
    return True


def grown(result: Balancing) -> bool:
    """Whether the unbalance that a balancing found is more than its own 95 %, in any plane."""
    return bool((np.abs(result.correction) > result.uncertainty).any())


def unbalance_from_amplitudes(
    loop: SynchronousLoop,
    condition: Condition,
    speeds: Sequence[float],
    amplitudes: np.ndarray,
    planes: Sequence[str] | None = None,
    *,
    runout: bool = False,
) -> UnbalanceEstimate:
    """The unbalance in each plane from amplitudes a (s, n) complex [m] at speeds (s,) [rad/s],
    block current-free; least squares without weights.

    planes: ports with two directions (bearings, discs, seals; None: the bearings). runout: solve
    for a constant 1x run-out of every sensor as well. Raises InvalidInput where there are fewer
    equations than unknowns.
    """
    a = check_shape(
        np.asarray(amplitudes, complex), "amplitudes", "(s, n)", s=len(speeds), n=len(loop.axes)
    )
    names = (
        tuple(bearing.name for bearing in loop.machine.bearings)
        if planes is None
        else tuple(planes)
    )
    n, count = len(loop.axes), len(names)
    unknowns = count + n * runout
    if a.size < unknowns:
        raise invalid(
            "the number of speeds",
            len(speeds),
            f"enough for {unknowns} unknowns",
            "give more of them",
        )

    # rows: every speed's amplitudes; columns: U of the planes, then the run-out of the axes
    rows = np.zeros((len(speeds) * n, unknowns), complex)
    for k, speed in enumerate(speeds):
        part = slice(k * n, (k + 1) * n)
        rows[part, :count] = per_unbalance(loop.plant(float(speed), condition), names, float(speed))
        if runout:
            # run-out enters every speed as itself
            rows[part, count:] = np.eye(n)
    # columns of one size, so that neither unbalance nor run-out is cut off
    scale: np.ndarray = np.linalg.norm(rows, axis=0)
    solution = np.linalg.lstsq(rows / scale, a.ravel(), rcond=1e-8)[0] / scale

    # residual as a share of the amplitudes
    left = float(np.linalg.norm(rows @ solution - a.ravel())) / max(
        float(np.linalg.norm(a)), 1e-300
    )
    return UnbalanceEstimate(solution[:count], names, left, solution[count:] if runout else None)


def per_unbalance(plant: Plant, planes: Sequence[str], speed: float) -> np.ndarray:
    """A (a, p) complex [m per kg m]: y per unbalance of each plane, no control current."""
    direction = {port.name: port.direction for port in ports(plant.machine)}
    columns = []
    for name in planes:
        pair = [port for port in plant.ports if port.rpartition("_")[0] == name]
        if len(pair) != 2:
            known = dict.fromkeys(port.rpartition("_")[0] for port in plant.ports)
            raise invalid(
                "a balancing plane",
                repr(name),
                "a bearing, disc, seal or coupling",
                suggestion(name, known),
            )
        # a forward force of phase zero at x is (1, -j) along x and y, and exp(-j b) times that
        # along ports turned by b
        pattern = np.exp(-1j * direction[pair[0]]) * np.array([1.0, -1j])
        system = select(plant.system, [f"f_{port}" for port in pair], plant.named("y"))
        G = frequency_response(system, np.array([speed])).values[0]
        columns.append(speed**2 * (G @ pattern))
    return np.array(columns).T


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """U (p,) with its covariance, run-out (a,), and with what they were found; influence and
    variance by speed.
    """

    unbalance: np.ndarray
    covariance: np.ndarray
    runout: np.ndarray
    influence: np.ndarray
    variance: np.ndarray
    condition: float
    model_error: float
    factor: float


def _fit(
    plants: Sequence[Plant],
    names: tuple[str, ...],
    table: AmplitudeTable,
    R: np.ndarray,
    free: bool,
) -> _Fit:
    """(1) by weighted least squares; R (a,): the run-out where it is no unknown."""
    p, a = len(names), table.values.shape[1]
    A = np.array(
        [per_unbalance(one, names, float(w)) for one, w in zip(plants, table.speeds, strict=True)]
    )
    eye = np.broadcast_to(np.eye(a), (len(plants), a, a))
    X = np.concatenate([A, eye], axis=2) if free else A
    target = table.values if free else table.values - R
    freedom = target.size - X.shape[2]
    if freedom < 0:
        raise invalid(
            "the number of unknowns",
            X.shape[2],
            f"at most {target.size}, that of amplitudes",
            "read another speed, or use fewer planes",
        )

    # the model's relative error is of |A U|; U is not known at first, so that |a| begins
    size = np.sqrt(np.mean(np.abs(target) ** 2, axis=1))
    for _ in range(2):
        error, x, C, condition = weighted_fit(X, target, table.noise, size, freedom, LEAST)
        size = np.sqrt(np.mean(np.abs(A @ x[:p]) ** 2, axis=1))
    return _Fit(
        x[:p],
        C[:p, :p],
        x[p:] if free else R,
        A,
        table.noise + (error * size[:, None]) ** 2,
        condition,
        error,
        circle_of_95(freedom),
    )


def _moved(plant: Plant, path: str) -> Plant:
    """The plant with one parameter at the upper end of its tolerance, where it has one."""
    held = [item for item in tolerances_around(plant) if item.parameter == path]
    return perturbed(plant, {path: 1.0}, held) if held else plant


def _growth(result: Balancing) -> tuple[str, ...]:
    """What has come since the earlier table, plane by plane."""
    lines = []
    for plane, u, limit in zip(result.planes, result.correction, result.uncertainty, strict=True):
        at = round(float(np.degrees(np.angle(-u)))) % 360
        verdict = "more than" if abs(u) > limit else "within"
        lines.append(
            f"unbalance of {plane} since the earlier table: {1e6 * abs(u):.3g} g mm at {at}°, "
            f"{verdict} its 95 % of {1e6 * limit:.2g} g mm"
        )
    return tuple(lines)
