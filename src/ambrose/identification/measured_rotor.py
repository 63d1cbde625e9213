"""A rotor without a drawing: its rigid body and bending modes from frequency responses.

Of a machine with a [measured_rotor] the places of magnets and sensors and the mass are known; the
centre of mass, the inertia, and of every mode frequency, damping and deflections at the places are
found beside the usual unknowns. Modes are added one by one, where the responses ask for one, as
long as they explain a part of what is left. Both planes have the same modes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from ambrose.core.rational_fit import fit_rational
from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error.loop_model import LoopModel, loop_model
from ambrose.identification.parameters import nominal_values
from ambrose.machine.attachment import NEAR
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import BENDING
from ambrose.machine.part import BendingMode, MeasuredRotor
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant

_STEP = 1e-6  # of a parameter's size, of the differences: the model is a low polynomial in all
_DAMPING = 0.01  # at which a mode begins
_SMALL = 1e-2  # of the size of a deflection, at which a mode's part of the responses is linear
_FAR = 10.0  # times its usual size, that nothing is
_WIDE = 0.1  # damping ratio above which nothing is a mode
_YIELDING, _HELD = 0.5**0.5, 0.001  # damping of a compliance, and how closely its logarithms stay
_TIMES = 1.0  # of the file's values, by which they may be off
_DECADES = 2.0  # of the logarithm of a damping ratio
_APART = 0.3  # of the logarithm of the ratio of deflections at a magnet and at a sensor
_HIGHEST = 1.05  # times the highest line, above which no mode is told
_BEYOND = 3.0  # times the highest line, of what yields
_SIZES = 0.03, 1.0  # of the deflections from which a mode's are sought
_ROUNDING = 1e-13  # of the largest square, of what changes of responses tell
_WORTH = 0.1  # of what the best explains, from which another place is tried
_COARSE = 12  # frequencies, evenly by their logarithm, at which a mode is tried beside the peaks
_PEAKS = 6
_ORDER = 12  # poles of the first look, of which noise takes some
_FROM = 0.5  # of the lines, by the logarithm of frequency, from where it looks
_BAND = 0.2  # of the logarithm of frequency, about a pole
_ONE = 0.02  # of the logarithm of frequency, within which poles are one mode's
_CLEAR = 10.0  # times what the first look leaves about it, that a mode's peak has


@dataclass(frozen=True, slots=True)
class Layout:
    """What stands where in theta (q,): the paths' values, then of the rotor the centre, the
    diametral and (turning) the polar inertia, then of each mode the logarithms of frequency and
    damping, (turning) its gyroscopic pair and p numbers x of its deflections phi at p places.

    Where no sensor stands at a magnet, responses tell little but products of the deflections there:
    phi = x e^(+-gamma), + at sensors, - at magnets; of one magnet, of which x is +-1 times that of
    one sensor, x stands for gamma. values (r,): of the file, at the paths. ties: per mode (sensor,
    magnet, sign), None where any does. compliances: the frequencies [rad/s] of the last modes,
    which are none, but what all higher ones yield. highest: the highest line [rad/s].
    """

    machine: Machine
    point: OperatingPoint
    paths: tuple[str, ...]
    places: tuple[float, ...]
    values: tuple[float, ...] = ()
    ties: tuple[tuple[int, int, float] | None, ...] = ()
    compliances: tuple[float, ...] = ()
    highest: float = np.inf

    @property
    def modes(self) -> int:
        return len(self.ties)

    @property
    def true_modes(self) -> int:
        return self.modes - len(self.compliances)

    def nearest(self, position: float) -> int:
        """The place nearest to a position [m]."""
        return int(np.argmin(np.abs(np.array(self.places) - position)))

    @property
    def sensed(self) -> np.ndarray:
        """Which of the places (p,) are a sensor's."""
        near = NEAR * self.machine.length
        at = [pair.position for pair in self.machine.sensor_pairs]
        return np.array([min(abs(place - one) for one in at) <= near for place in self.places])

    @property
    def driven(self) -> np.ndarray:
        """Which of the places (p,) are a magnet's."""
        near = NEAR * self.machine.length
        at = [bearing.position for bearing in self.machine.bearings]
        return np.array([min(abs(place - one) for one in at) <= near for place in self.places])

    def shape(self, k: int, theta: np.ndarray) -> np.ndarray:
        """The deflections (p,) of mode k."""
        phi, tie = theta[self.mode(k)][2 + self.whirling :].copy(), self.ties[k]
        if tie is None:
            return phi
        sensor, magnet, sign = tie
        gamma = phi[magnet]
        phi[magnet] = sign * phi[sensor]
        return phi * np.exp(np.where(self.sensed, gamma, -gamma))

    @property
    def turning(self) -> bool:
        return self.point.speed > 0

    @property
    def whirling(self) -> int:
        """Gyroscopic numbers of a mode."""
        return 2 * self.turning

    @property
    def rigid(self) -> slice:
        first = len(self.paths)
        return slice(first, first + 2 + self.turning)

    @property
    def each(self) -> int:
        """Numbers of a mode."""
        return 2 + self.whirling + len(self.places)

    def mode(self, k: int) -> slice:
        first = self.rigid.stop + k * self.each
        return slice(first, first + self.each)

    @property
    def unit(self) -> float:
        """The size of a deflection [kg^-1/2]: that of a uniform bar."""
        return float(self.body.mass**-0.5)

    @property
    def body(self) -> MeasuredRotor:
        body = self.machine.measured_rotor
        assert body is not None
        return body

    def scale(self, theta: np.ndarray) -> np.ndarray:
        """The size (q,) of every number."""
        usual = self.usual(len(theta))
        return np.where(usual < np.inf, usual, np.where(theta == 0, 1.0, np.abs(theta)))

    def usual(self, count: int) -> np.ndarray:
        """The usual size (q,) of the centre and of what shapes consist of; inf: of all else."""
        size = np.full(count, np.inf)
        size[self.rigid.start] = self.machine.length
        for k, tie in enumerate(self.ties):
            numbers = size[self.mode(k)]
            numbers[2 + self.whirling :] = self.unit
            numbers[2 : 2 + self.whirling] = 1.0
            if tie is not None:
                numbers[2 + self.whirling + tie[1]] = 1.0
        return size

    def prior(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is known before, (q,), and its precision: the paths' values are of the size of the
        file's, every gamma is small, a damping ratio
        within a decade or two of a steel shaft's, a frequency near where it began, and a
        compliance stays what it is.
        """
        known, precision = np.zeros(len(theta)), np.zeros(len(theta))
        stated = np.array(self.values)
        known[: len(stated)] = stated
        precision[: len(stated)] = (_TIMES * np.where(stated == 0, np.inf, stated)) ** -2
        for k, tie in enumerate(self.ties):
            first = self.mode(k).start
            if tie is not None:
                precision[first + 2 + self.whirling + tie[1]] = _APART**-2
            known[first], precision[first] = theta[first], 1.0
            known[first + 1], precision[first + 1] = np.log(_DAMPING), _DECADES**-2
            if k >= self.true_modes:
                known[first : first + 2] = np.log(
                    [self.compliances[k - self.true_modes], _YIELDING]
                )
                precision[first : first + 2] = _HELD**-2
        return known, precision

    def allowed(self, theta: np.ndarray) -> bool:
        """Inertias are positive, the modes ascend, a bending mode rings."""
        centre, *inertias = theta[self.rigid]
        modes = [theta[self.mode(k)] for k in range(self.modes)]
        rates = [mode[0] for mode in modes[: self.true_modes]]
        return (
            0 < centre < self.machine.length
            and inertias[0] > 0
            and (not self.turning or 0 <= inertias[1] <= 2 * inertias[0])
            and all(
                one > 0
                for path, one in zip(self.paths, theta, strict=False)
                if path.startswith("amplifier.") or "force_per_current" in path
            )
            and bool((np.diff(rates) > 0).all())
            and max(rates, default=0.0) < np.log(_HIGHEST * self.highest)
            and all(mode[1] < np.log(_WIDE) for mode in modes[: self.true_modes])
            and all(mode[1] < 0 for mode in modes)
            and bool((np.abs(theta) <= _FAR * self.usual(len(theta))).all())
        )

    def begin(self, values: np.ndarray) -> np.ndarray:
        """theta of the machine file's own values beside those of the paths."""
        body, length = self.body, self.machine.length
        bar = body.mass * length**2 / 12
        rigid = [
            length / 2 if body.centre is None else body.centre,
            bar if body.diametral_inertia is None else body.diametral_inertia,
            *([body.polar_inertia] * self.turning),
        ]
        return np.concatenate([values, rigid])

    def damping_of(self, mode: BendingMode) -> float:
        """Its damping ratio, as the machine file has it."""
        return self.machine.modal_damping if mode.damping is None else mode.damping

    @property
    def reported(self) -> tuple[tuple[str, ...], list[int]]:
        """The paths of a machine's parameters among theta, and where they stand."""
        modes = [
            (f"rotor.{BENDING}{k + 1}.{name}", self.mode(k).start + place)
            for k in range(self.true_modes)
            for place, name in enumerate(("frequency", "damping"))
        ]
        names = (*self.paths, *(name for name, _ in modes))
        return names, [*range(len(self.paths)), *(place for _, place in modes)]

    def stated(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The values (r,) of ``reported``, of those in theta, and their derivatives."""
        logarithms = np.arange(len(values)) >= len(self.paths)
        whole = np.where(logarithms, np.exp(np.where(logarithms, values, 0.0)), values)
        return whole, np.where(logarithms, whole, 1.0)

    def words(self, theta: np.ndarray) -> str:
        """What was found of the rotor beside the paths, in a sentence without its stop."""
        centre, inertia, *_ = theta[self.rigid].tolist()
        places = ", ".join(f"{1e3 * place:.4g}" for place in self.places)
        return (
            f"the rotor is as measured at {self.point.speed * 30 / np.pi:.4g} rpm and holds at no "
            f"other speed: {self.body.mass:.4g} kg as stated, centre of mass at "
            f"{1e3 * centre:.4g} mm, diametral inertia {inertia:.4g} kg m^2, {self.true_modes} "
            f"bending modes with their deflections at {places} mm, and what higher ones yield as "
            f"{len(self.compliances)} entries that do not ring"
        )

    def machine_of(self, theta: np.ndarray) -> Machine:
        """``machine`` with rotor and modes of theta; the paths' values are its own."""
        centre, diametral, *polar = theta[self.rigid].tolist()
        body = replace(
            self.body,
            centre=centre,
            diametral_inertia=diametral,
            polar_inertia=polar[0] if polar else self.body.polar_inertia,
            places=self.places,
        )
        modes = []
        for k in range(self.modes):
            frequency, damping = np.exp(theta[self.mode(k)][:2]).tolist()
            rest = theta[self.mode(k)][2:].tolist()
            whirl = (rest[0], rest[1]) if self.turning else (0.0, 0.0)
            shape = tuple(self.shape(k, theta).tolist())
            modes.append(BendingMode(k + 1, frequency, damping, shape, whirl))
        return replace(self.machine, measured_rotor=body, bending_modes=tuple(modes))

    def plant(self, theta: np.ndarray) -> Plant:
        """The plant with the rotor of theta; the paths' values are the machine file's."""
        return assemble(self.machine_of(theta), self.point)

    def without_compliances(self, theta: np.ndarray) -> tuple[Layout, np.ndarray]:
        """With true modes alone."""
        alone = replace(self, ties=self.ties[: self.true_modes], compliances=())
        return alone, theta[: self.rigid.stop + alone.modes * self.each]

    def with_mode(
        self, theta: np.ndarray, mode: np.ndarray, tied: bool = True
    ) -> tuple[Layout, np.ndarray]:
        """With one more mode (frequency, damping, gyroscopic pair if turning, deflections), in the
        order of frequencies; of such damping that it does not ring, a compliance. tied: so that
        responses tell its numbers apart.
        """
        mode, phi, tie = mode.copy(), mode[2 + self.whirling :], None
        mode[:2] = np.log(mode[:2])
        if tied and not (self.sensed & self.driven).any():
            # the two that move most
            sensor, magnet = (
                int(np.argmax(np.abs(phi) * those)) for those in (self.sensed, self.driven)
            )
            floor = _SMALL * self.unit
            size = np.maximum(np.abs(phi[[sensor, magnet]]), floor)
            gamma = float(np.log(size[0] / size[1]) / 2)
            tie = sensor, magnet, float(np.sign(phi[sensor] * phi[magnet]) or 1.0)
            numbers = phi * np.exp(np.where(self.sensed, -gamma, gamma))
            numbers[sensor] = np.sqrt(size[0] * size[1]) * (np.sign(phi[sensor]) or 1.0)
            numbers[magnet] = gamma
            mode[2 + self.whirling :] = numbers
        modes = [(theta[self.mode(k)], tie) for k, tie in enumerate(self.ties)] + [(mode, tie)]
        modes.sort(key=lambda one: (float(one[0][1]) > np.log(_WIDE), float(one[0][0])))
        ties = tuple(tie for _, tie in modes)
        added = (float(np.exp(mode[0])),) if mode[1] > np.log(_WIDE) else ()
        larger = replace(self, ties=ties, compliances=tuple(sorted(self.compliances + added)))
        return larger, np.concatenate([theta[: self.rigid.stop], *(one for one, _ in modes)])


@dataclass(frozen=True, eq=False)
class MeasuredLoop:
    """The sampled loop of a measured rotor and a controller (delay within) in theta (q,)."""

    layout: Layout
    controller: StateSpace
    excitations: tuple[str, ...]
    signals: tuple[str, ...]
    slopes: bool = True  # else without derivatives

    def matrices(self, theta: np.ndarray) -> tuple[np.ndarray, ...]:
        """A (n, n), B (n, 2a), C (2a, n) of the continuous plant, and d/dtheta of A and B for the
        paths.
        """
        layout = self.layout
        paths, names = layout.paths, (self.excitations, self.signals)
        plant = layout.plant(theta)
        model = loop_model(plant, self.controller, paths, nominal_values(plant, paths), *names)
        A, B, dA, dB = model.plant(theta[: len(paths)])
        return A, B, model.C, dA, dB

    def loop(self, theta: np.ndarray) -> tuple[StateSpace, list[SystemDerivative]]:
        """The loop from excitations to signals, and its derivative for each number of theta."""
        *own, by_A, by_B = self.matrices(theta)
        q = len(theta) if self.slopes else 0
        first, scale = len(self.layout.paths), self.layout.scale(theta)
        dA, dB, dC = (np.zeros((q, *one.shape)) for one in own)
        dA[:first], dB[:first] = by_A[:q], by_B[:q]

        # of the rotor's numbers by a step forward
        for k in range(first, q):
            ahead = theta.copy()
            ahead[k] += (step := _STEP * scale[k])
            moved = self.matrices(ahead)
            dA[k], dB[k], dC[k] = (
                (new - old) / step for new, old in zip(moved[:3], own, strict=True)
            )
        A, B, C = own
        names = self.excitations, self.signals
        model = LoopModel(theta[:q], A, B, C, dA, dB, self.controller, *names, np.ones(q))
        closed, directions = model.loop(theta[:q])

        # what the rows of y do beside: B_u = Gamma, x+ -= B_u D_K dC x, z+ -= B_K dC x
        n, K = len(A), self.controller
        a = len(K.outputs)
        held = closed.B[:n, :a]
        for k in np.flatnonzero(np.abs(dC).max(axis=(1, 2), initial=0.0)).tolist():
            change = directions[k].A.copy()
            change[:n, :n] -= held @ K.D @ dC[k][:a]
            change[n:, :n] -= K.B @ dC[k][:a]
            rows = np.hstack([dC[k][:a], np.zeros((a, K.n_states))])
            directions[k] = SystemDerivative(change, directions[k].B, rows, directions[k].D)
        return closed, directions


def places_of(machine: Machine) -> tuple[float, ...]:
    """The places [m] of magnets and sensors, ascending; of two that are one to the mesh the
    first.
    """
    found: list[float] = []
    near = NEAR * machine.length
    for place in sorted(
        [bearing.position for bearing in machine.bearings]
        + [sensor.position for sensor in machine.sensor_pairs]
    ):
        if not found or place - found[-1] > near:
            found.append(place)
    return tuple(found)


def first_modes(
    model: MeasuredLoop,
    theta: np.ndarray,
    omega: np.ndarray,
    G: np.ndarray,
    plant: Callable[[MeasuredLoop, np.ndarray], np.ndarray],
) -> list[np.ndarray]:
    """The modes (numbers as ``Layout.with_mode`` takes them) that a plant measured between all axes
    shows beside a rigid rotor at theta, of planes that are not coupled.

    omega (w,) [rad/s], G (w, a, a); plant(model, theta) (w, a, a): the same of a model. What a mode
    adds is dG_ij = D_ij s_i m_j/(w_k^2 - w^2 + 2 j zeta w_k w); D, the way through amplifier, hold
    and sensor, is told by a mode far above. The poles of dG/D by vector fitting
    (``core.rational_fit``), s and m by the largest singular value of their residues.
    """
    layout = model.layout
    count, bearings = len(layout.places), layout.machine.bearings
    own = plant(model, theta)
    small, far = _SMALL * layout.unit, _BEYOND * omega[-1]
    trial = np.array([far, _YIELDING, *np.zeros(layout.whirling), *np.full(count, small)])
    larger, beside = layout.with_mode(theta, trial, tied=False)
    added = plant(replace(model, layout=larger), beside) - own
    by_mode = small**2 / (far**2 - omega**2 + 2j * _YIELDING * far * omega)

    # the planes' mean, over the way through
    left, way = (
        (X[:, 0::2, 0::2] + X[:, 1::2, 1::2]) / 2 for X in (G - own, added / by_mode[:, None, None])
    )
    b = len(bearings)
    told = omega > omega[0] * (omega[-1] / omega[0]) ** _FROM
    if told.sum() < 2 * _ORDER:
        return []
    # times w^2, which weighs the lines evenly: the noise of a displacement falls with it
    data = (omega[told] ** 2)[:, None] * (left / way)[told].reshape(-1, b * b)
    fit = fit_rational(omega[told], data.T, _ORDER)

    # noise: what a line is off the straight one between its neighbours
    off = np.abs(data[:-2] - 2 * data[1:-1] + data[2:]).max(axis=1) / np.sqrt(6)
    found = []
    for k in np.flatnonzero(fit.poles.imag > 0):
        pole = fit.poles[k]
        w, zeta = float(np.abs(pole)), float(-pole.real / np.abs(pole))

        # r/(s - p) + r*/(s - p*) is -s^2 s m'/(s^2 + 2 zeta w s + w^2) beside a constant, for
        # r = -p^2 s m'/(2 j Im p)
        shapes = (-2j * pole.imag / pole**2 * fit.residues[:, k]).real.reshape(b, b)
        left_, sizes, right = np.linalg.svd(shapes)
        near = np.abs(np.log(omega[told][1:-1] / w)) < _BAND
        noise = float(np.median(off[near])) if near.any() else np.inf
        if zeta > _WIDE or sizes[0] / (2 * zeta) < _CLEAR * noise:
            continue
        phi = np.zeros(count)
        root = np.sqrt(sizes[0])
        at = [layout.nearest(pair.position) for pair in layout.machine.sensor_pairs]
        of = [bearing.name for bearing in bearings]
        for place, pair in zip(at, layout.machine.sensor_pairs, strict=True):
            phi[place] = root * left_[of.index(pair.bearing), 0]
        for bearing, value in zip(bearings, root * right[0], strict=True):
            place = layout.nearest(bearing.position)
            phi[place] = (phi[place] + value) / 2 if place in at else value
        mode = np.array([w, zeta, *np.zeros(layout.whirling), *phi])
        found.append((sizes[0] / (2 * zeta) / noise, mode))

    # of poles that share a resonance the clearest
    kept: list[np.ndarray] = []
    for _, mode in sorted(found, key=lambda one: -one[0]):
        if all(abs(np.log(mode[0] / other[0])) > _ONE for other in kept):
            kept.append(mode)
    return kept


Residuals = Callable[["MeasuredLoop", np.ndarray], np.ndarray]


def candidates(
    model: MeasuredLoop,
    theta: np.ndarray,
    residuals: Residuals,
    slopes: np.ndarray,
    lines: np.ndarray,
    most: int,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The modes (numbers as ``Layout.with_mode`` takes them) that explain most of what a loop at
    theta leaves, the best first, and the compliance of higher ones; with each the step (q,) of
    theta that goes with it.

    residuals(model, theta) (r,): all that is left, over its noise; slopes (r, q): its derivatives,
    which explain their part without a mode; lines (w,) [rad/s]: where one is tried.

    A mode of small deflections phi changes the responses by a quadratic form in them, which is told
    by phi = e_p and e_p + e_q: r(phi) = r - sum phi_p phi_q Q_pq.
    """
    layout, left = model.layout, residuals(model, theta)
    known_by, upper = np.linalg.qr(slopes)
    count, small = len(layout.places), _SMALL * layout.unit
    pairs = [(p, q) for p in range(count) for q in range(p, count)]
    known = np.exp([theta[layout.mode(k)][0] for k in range(layout.modes)])
    highest = lines.max()
    beyond = [_BEYOND * highest * (1 + 0.1 * len(layout.compliances))]
    beyond *= len(layout.compliances) < len(layout.machine.bearings)
    found: list[tuple[float, np.ndarray, np.ndarray]] = []
    for w, damping in [*((w, _DAMPING) for w in lines), *((w, _YIELDING) for w in beyond)]:
        if known.size and np.abs(known / w - 1).min() < _ONE:
            continue
        mode = np.zeros(layout.each)
        mode[:2] = w, damping
        changes = {}
        for p, q in pairs:
            mode[-count:] = 0.0
            mode[-count:][[p, q]] = small
            larger, beside = layout.with_mode(theta, mode, tied=False)
            changes[p, q] = (left - residuals(replace(model, layout=larger), beside)) / small**2

        # Q_pq + Q_qp = change(e_p + e_q) - change(e_p) - change(e_q)
        columns = np.array(
            [changes[p, q] - (changes[p, p] + changes[q, q]) * (p != q) for p, q in pairs]
        )
        alone = columns - (columns @ known_by) @ known_by.T
        gain, phi = _best_shape(alone @ alone.T, alone @ left, pairs, count, layout.unit)
        mode[-count:] = phi

        # with it what is known moves by the least squares of what it leaves
        rest = left - np.array([phi[p] * phi[q] for p, q in pairs]) @ columns
        step = np.linalg.lstsq(upper, known_by.T @ rest, rcond=None)[0]
        found.append((gain, mode.copy(), step))
    ringing = sorted((one for one in found if one[1][1] < _WIDE), key=lambda one: -one[0])
    kept = [one for one in ringing[:most] if one[0] >= _WORTH * ringing[0][0]]
    return [(mode, step) for _, mode, step in (*kept, *found[len(ringing) :])]


def _best_shape(
    gram: np.ndarray,
    towards: np.ndarray,
    pairs: Sequence[tuple[int, int]],
    count: int,
    unit: float,
) -> tuple[float, np.ndarray]:
    """How much of the sum of squares a mode's deflections (p,) explain, and those that do so
    best.
    """
    first, second = np.array(pairs).T

    # gram = V W V', so that the sum of squares is |W^1/2 V' x - W^-1/2 V' b|^2, x = phi_p phi_q
    sizes, V = np.linalg.eigh(gram)
    told = sizes > _ROUNDING * sizes[-1]
    root = np.sqrt(sizes[told])
    A, b = root[:, None] * V[:, told].T, V[:, told].T @ towards / root

    def rest(phi: np.ndarray) -> np.ndarray:
        return np.asarray(A @ (phi[first] * phi[second]) - b)

    def slope(phi: np.ndarray) -> np.ndarray:
        by = np.zeros((len(first), count))
        rows = np.arange(len(first))
        np.add.at(by, (rows, first), phi[second])
        np.add.at(by, (rows, second), phi[first])
        return np.asarray(A @ by)

    best: tuple[float, np.ndarray] = 0.0, np.full(count, _SMALL * unit)
    for number in range(2 ** (count - 1)):
        signs = np.array([1.0, *(1.0 - 2.0 * (number >> k & 1) for k in range(count - 1))])
        for size in _SIZES:
            # as many numbers as A has rows, at least: what nothing tells stays small
            found = least_squares(
                lambda phi: np.append(rest(phi), 1e-6 * phi / unit),
                size * unit * signs,
                lambda phi: np.vstack([slope(phi), 1e-6 / unit * np.eye(count)]),
                method="lm",
                max_nfev=60,
            )
            gain = float(b @ b - rest(found.x) @ rest(found.x))
            best = max(best, (gain, found.x), key=lambda one: one[0])
    return best


def tried_at(omegas: Sequence[np.ndarray], left: Sequence[np.ndarray]) -> np.ndarray:
    """Where a mode is tried [rad/s]: at the peaks of what is left (each (w,) at omegas), and evenly
    between. None is tried beyond the lines: of such a mode its compliance alone is told.
    """
    lines = sorted(
        (
            (float(abs(r[k])), float(omega[k]))
            for omega, r in zip(omegas, left, strict=True)
            for k in np.argsort(np.abs(r))[-_PEAKS:]
        ),
        reverse=True,
    )
    peaks = list(dict.fromkeys(w for _, w in lines))[:_PEAKS]
    low, high = min(o[0] for o in omegas), max(o[-1] for o in omegas)
    between = np.geomspace(max(low, high / 100), high, _COARSE)
    return np.array([*peaks, *between])
