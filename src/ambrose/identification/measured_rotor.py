"""A rotor without a drawing: its rigid body and bending modes from frequency responses.

Of a machine with a [measured_rotor] the places of magnets and sensors and the mass are known; the
centre of mass, the inertia, and of every mode frequency, damping and deflections at the places are
found beside the usual unknowns. The modes are seen in the plant that the responses are of, beside
a rigid rotor, as the poles of a rational fit; all numbers are then fitted at once. Both planes have
the same modes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ambrose.core.rational_fit import fit_rational
from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace, poles
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
_DAMPING = 0.01  # of which a steel shaft's modes are, within a decade or two
_SMALL = 1e-2  # of the size of a deflection, at which a mode's part of the responses is linear
# how many times its usual size a number may be, and a gyroscopic one: a pump's ended at 10
_FAR, _FARTHER = 10.0, 100.0
RINGS = 0.1  # damping ratio above which nothing is a mode
_YIELDING, _HELD = 0.5**0.5, 0.001  # damping of a compliance, and how closely its logarithms stay
_SHARP = 0.03  # of the logarithm of a damping ratio that is held
_TIMES = 1.0  # of the file's values, by which they may be off
_DECADES = 2.0  # of the logarithm of a damping ratio
_APART = 0.3  # of the logarithm of the ratio of deflections at a magnet and at a sensor
_WITHIN, _BEYOND = 1.05, 2.5  # times the highest line, to where modes are, and those beyond it
_YIELDS = 3.0  # times it, what higher ones yield
_PLACES = 30  # at which that one is tried
_STEPPED = 0.1  # relative, by which those at one place stand apart
_ORDER = 16  # poles of the look, of which noise and the rigid body take some; turning twice
_FROM = 0.3  # of the lines, by the logarithm of frequency, from where it looks
_CLEAR, _TOLD = 100.0, 10.0  # times the noise of all lines: a mode's part, and what is beyond them
_RANK = 0.3  # of a mode's largest singular value, its others
OWN = 0.15, 0.03  # of the logarithm of frequency, about the rigid rotor's poles, look by look
_WHIRLS = 0.5  # of the direct response, a whirl's cross response
_SPLIT = 2.0  # times the backward whirl's frequency, the forward one's


@dataclass(frozen=True, slots=True)
class Layout:
    """What stands where in theta (q,): the paths' values, then of the rotor the centre, the
    diametral and (turning) the polar inertia, then of each mode the logarithms of frequency and
    damping, (turning) its gyroscopic pair and p numbers x of its deflections phi at p places.

    Where no sensor stands at a magnet, responses tell little but products of the deflections there:
    phi = x e^(+-gamma), + at sensors, - at magnets; of one magnet, of which x is +-1 times that of
    one sensor, x stands for gamma. values (r,): of the file, at the paths. ties: per mode (sensor,
    magnet, sign), None where any does. compliances: the frequencies [rad/s] of the last modes,
    which are none, but what all higher ones yield. highest: the highest line [rad/s]. held: what of
    the modes stays where it is, "rates" (frequencies and damping), "all" or nothing.
    """

    machine: Machine
    point: OperatingPoint
    paths: tuple[str, ...]
    places: tuple[float, ...]
    values: tuple[float, ...] = ()
    ties: tuple[tuple[int, int, float] | None, ...] = ()
    compliances: tuple[float, ...] = ()
    highest: float = np.inf
    held: str = ""

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
            if self.held:
                known[first : first + 2] = theta[first : first + 2]
                precision[first : first + 2] = _HELD**-2, _SHARP**-2
            if self.held == "all":
                known[self.mode(k)], precision[self.mode(k)] = theta[self.mode(k)], 1.0
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
        most = _FAR * self.usual(len(theta))
        for k in range(self.modes):
            most[self.mode(k)][2 : 2 + self.whirling] = _FARTHER
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
            and max(rates, default=0.0) < np.log(_BEYOND * self.highest)
            and all(mode[1] < np.log(RINGS) for mode in modes[: self.true_modes])
            and all(mode[1] < 0 for mode in modes)
            and bool((np.abs(theta) <= most).all())
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

    def within(self, theta: np.ndarray) -> int:
        """How many of the modes lie within the lines."""
        rates = np.exp([theta[self.mode(k)][0] for k in range(self.true_modes)])
        return int((rates < _WITHIN * self.highest).sum())

    def reported(self, theta: np.ndarray) -> tuple[tuple[str, ...], list[int]]:
        """The paths of a machine's parameters among theta, and where they stand."""
        modes = [
            (f"rotor.{BENDING}{k + 1}.{name}", self.mode(k).start + place)
            for k in range(self.within(theta))
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
            f"{1e3 * centre:.4g} mm, diametral inertia {inertia:.4g} kg m^2, "
            f"{self.within(theta)} bending modes with their deflections at {places} mm; "
            f"{self.modes - self.within(theta)} entries beyond the lines stand for what all higher "
            "ones yield"
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
        modes.sort(key=lambda one: (float(one[0][1]) > np.log(RINGS), float(one[0][0])))
        ties = tuple(tie for _, tie in modes)
        added = (float(np.exp(mode[0])),) if mode[1] > np.log(RINGS) else ()
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
        for k in range(first, min(q, self.layout.rigid.stop) if self.layout.held == "all" else q):
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
    noise: np.ndarray,
    plant: Callable[[MeasuredLoop, np.ndarray], np.ndarray],
    nearest: int,
    own: float,
) -> list[np.ndarray]:
    """The modes (numbers as ``Layout.with_mode`` takes them) that a plant measured between all axes
    shows beside a rigid rotor at theta, the clearest first, and last what higher ones yield.

    omega (w,) [rad/s], G (w, a, a), noise (w,) of G; plant(model, theta) (w, a, a): the same as G
    of a model; nearest: so many modes at most at one frequency beyond the lines; own: of the
    logarithm of frequency, about the rigid rotor's poles, where no other is. What a mode adds is
    dG_ij = D_ij s_i m_j/(w_k^2 - w^2 + 2 j zeta w_k w); D, the way through amplifier, hold and
    sensor, is told by a mode far above. Its poles are those of dG/D by vector fitting
    (``core.rational_fit``), and s m' the residues' first singular pair.
    """
    layout = model.layout
    b, far = len(layout.machine.bearings), _YIELDS * omega[-1]
    bare, small = plant(model, theta), _SMALL * layout.unit
    trial = np.array([far, _YIELDING, *np.zeros(layout.whirling), *[small] * len(layout.places)])
    larger, beside = layout.with_mode(theta, trial, tied=False)
    added = plant(replace(model, layout=larger), beside) - bare
    told = omega > omega[0] * (omega[-1] / omega[0]) ** _FROM
    order = _ORDER * (1 + layout.turning)
    if told.sum() < 2 * order:
        return []

    # of a plane by its own currents and, turning, by the other's, over the way through
    rest = (G - bare)[told]
    way = (added[told, 0::2, 0::2] + added[told, 1::2, 1::2]) / 2
    omega, way = omega[told], way * _divisor(omega[told], far, _YIELDING)[:, None, None] / small**2
    direct = (rest[:, 0::2, 0::2] + rest[:, 1::2, 1::2]) / (2 * way)
    cross = (rest[:, 1::2, 0::2] - rest[:, 0::2, 1::2]) / (2 * way)
    noise = noise[told] / np.abs(way).min(axis=(1, 2))
    both = np.concatenate([direct, cross][: 1 + layout.turning], axis=1).reshape(len(omega), -1).T
    fit = fit_rational(omega, both, order, noise=noise)
    noise = noise * np.sqrt(np.mean(np.abs((fit.response(omega) - both) / noise) ** 2))

    # r/(s - p) + r*/(s - p*) is s m'/(w_k^2 + 2 zeta w_k s + s^2) where r = s m'/(2 j Im p)
    upper = fit.poles.imag > 0
    shapes = (2j * fit.poles.imag * fit.residues)[:, upper].T.reshape(upper.sum(), -1, b, b)
    rigid = poles(layout.plant(theta).system)
    rigid = rigid[(rigid.imag > 0) & (-rigid.real < RINGS * np.abs(rigid))]
    found = []
    for pole, shape in zip(fit.poles[upper], shapes, strict=True):
        w, zeta = float(np.abs(pole)), float(-pole.real / np.abs(pole))
        sizes = np.linalg.svd(shape[0].real)[1]
        clear = float(np.linalg.norm(sizes[0] / _divisor(omega, w, zeta) / noise))
        of_body = rigid.size and np.abs(np.log(np.abs(rigid) / w)).min() < own
        one_mode = clear > _CLEAR and sizes[1:].sum() < _RANK * sizes[0] and not of_body
        if one_mode and zeta < RINGS and w < _WITHIN * omega[-1]:
            found.append(_Seen(w, zeta, shape, clear))
            direct = direct - shape[0].real / _divisor(omega, w, zeta)[:, None, None]
    found.sort(key=lambda one: -one.clear)
    seen = [_numbers(layout, *one) for one in _modes(found, layout.point.speed)]

    # what is left is of higher modes, and of the rigid body: 1/s^2 and 1/s^4
    def explained(*modes: tuple[float, float]) -> tuple[float, np.ndarray]:
        columns = [1 / _divisor(omega, *mode) for mode in modes]
        basis = _parts(np.stack([*columns, omega**-2.0, omega**-4.0], axis=1) / noise[:, None])
        parts = _parts(direct.reshape(len(omega), -1) / noise[:, None])
        size = np.linalg.norm(basis, axis=0)
        held = np.linalg.lstsq(basis / size, parts, rcond=None)[0]
        return float(np.linalg.norm(parts - basis / size @ held)), held / size[:, None]

    yields = far, _YIELDING
    tries = [(w, _DAMPING) for w in np.geomspace(_WITHIN, _BEYOND, _PLACES) * omega[-1]]
    cost, one = min((explained(one, yields)[0], one) for one in tries)
    beyond = [one] if explained(yields)[0] ** 2 - cost**2 > _TOLD**2 else []
    for (w, zeta), most in (*((one, nearest) for one in beyond), (yields, b)):
        U, sizes, V = np.linalg.svd(explained((w, zeta), yields)[1][0].reshape(b, b))
        for k, size in enumerate(sizes[:most]):
            if np.linalg.norm(size / _divisor(omega, w, zeta) / noise) > _TOLD:
                shape, apart = size * np.outer(U[:, k], V[k]), 1 + _STEPPED * k
                seen.append(_numbers(layout, w * apart, zeta, 0.0, apart**2 * shape))
                direct = direct - shape / _divisor(omega, w, zeta)[:, None, None]
    return seen


class _Seen(NamedTuple):
    """A pole [rad/s] with its residues: direct and, turning, cross (1 or 2, b, b)."""

    w: float
    zeta: float
    shape: np.ndarray
    clear: float


def _modes(
    found: Sequence[_Seen], speed: float
) -> Iterator[tuple[float, float, float, np.ndarray]]:
    """Frequency, damping, gyroscopic number of itself and s m' (b, b) of the modes with these
    poles.

    Turning, with z = x + j y: z'' - j g z' + w_k^2 z = m' f has the forward pole w_f and the
    backward one w_b, w_k^2 = w_f w_b, g = w_f - w_b. Of the direct response they have the parts
    s m' w_f/(w_f + w_b) and s m' w_b/(w_f + w_b); the cross ones are -j and j times these.
    """
    if speed == 0:
        yield from ((one.w, one.zeta, 0.0, one.shape[0].real) for one in found)
        return

    def turns(one: _Seen) -> float:
        return float((np.vdot(one.shape[0], one.shape[1]) / np.vdot(*one.shape[[0, 0]])).imag)

    backward = [one for one in found if turns(one) > _WHIRLS]
    for ahead in found:
        if abs(turns(ahead)) <= _WHIRLS:  # both whirls in one pole
            yield ahead.w, ahead.zeta, 0.0, ahead.shape[0].real
        if turns(ahead) >= -_WHIRLS:
            continue
        near = [one for one in backward if one.w <= ahead.w <= _SPLIT * one.w]
        if not near:
            continue
        back = max(near, key=lambda one: _alike(ahead.shape[0].real, one.shape[0].real))
        backward.remove(back)
        w, zeta = float(np.sqrt(ahead.w * back.w)), (ahead.zeta + back.zeta) / 2
        yield w, zeta, (ahead.w - back.w) / speed, (ahead.shape[0] + back.shape[0]).real


def _alike(X: np.ndarray, Y: np.ndarray) -> float:
    """The cosine between two arrays."""
    return float(np.vdot(X, Y) / (np.linalg.norm(X) * np.linalg.norm(Y)))


def _divisor(omega: np.ndarray, w: float, zeta: float) -> np.ndarray:
    return np.asarray(w**2 - omega**2 + 2j * zeta * w * omega)


def _parts(X: np.ndarray) -> np.ndarray:
    """Real and imaginary parts one below the other."""
    return np.concatenate([X.real, X.imag])


def _numbers(layout: Layout, w: float, zeta: float, g: float, shape: np.ndarray) -> np.ndarray:
    """Of a mode with s m' (b, b): as ``Layout.with_mode`` takes them."""
    U, sizes, V = np.linalg.svd(shape)
    phi, root = np.zeros(len(layout.places)), np.sqrt(sizes[0])
    sensors, bearings = layout.machine.sensor_pairs, layout.machine.bearings
    at = [layout.nearest(pair.position) for pair in sensors]
    of = [bearing.name for bearing in bearings]
    for place, pair in zip(at, sensors, strict=True):
        phi[place] = root * U[of.index(pair.bearing), 0]
    for bearing, value in zip(bearings, root * V[0], strict=True):
        place = layout.nearest(bearing.position)
        phi[place] = (phi[place] + value) / 2 if place in at else value
    return np.array([w, zeta, *[0.0, g][: layout.whirling], *phi])
