"""Is the recorded excitation what acted? Its size and its time, told from what the model may have
wrong.

Of an excitation that is recorded at 1/(1 + delta) of its size and tau too late the responses T of
the loop become

    X = (1 + delta) exp(j w tau) T,    T = S_o G = T_0 + sum_p a_p dT/dp                      (1)

with the parameters p of the model as far off as they may be: a_p has a normal prior, one standard
deviation being half of p's half-width. delta and tau have none. They are told apart from gains and
lags inside the loop because the loop answers: a change of G enters by S_o dG S_i, and with integral
action S_i(0) = 0, so that the response to slow excitations is the same whatever the magnets do.
u = -K y holds whatever e is, so that u adds nothing to y.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import AmbroseError
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d, hold
from ambrose.core.statespace import StateSpace, poles, select
from ambrose.identification.findings import ERROR, WARNING, Code, Finding
from ambrose.identification.frf.local import local_response
from ambrose.identification.frf.spectral import Frf
from ambrose.identification.parameters import COVERAGE, magnet_paths
from ambrose.law.loop import closed_loop
from ambrose.machine.description import AMPLIFIER_PARAMETERS, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import parse_parameter
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import channels, tolerances_around, uncertain
from ambrose.record.record import Record

# relative half-widths of what a machine file states without a tolerance: within what it may be at
# all, as a file before its identification, and within what it is taken to be known; assumed
DOUBTS: Mapping[str, float] = {
    "force_per_current": 0.3,
    "negative_stiffness": 0.4,
    "amplifier": 0.3,
    "seal": 0.5,
}
KNOWN: Mapping[str, float] = {
    "force_per_current": 0.05,
    "negative_stiffness": 0.1,
    "amplifier": 0.2,
    "seal": 0.2,
}
_LEAST = 0.005  # of a response, by which converters and logger may be off whatever is told
_FITS = 0.1  # relative error of a model that tells: one that is further off has other faults
_SURE = 1.5  # times a 95 % interval: 99.7 %, of several axes and two quantities at once
_FAR = 3.0  # times that of a size: a structure that the model lacks is in no interval
_SMALL, _GREAT = 0.03, 0.2  # of the size: no matter, and no number can be trusted
_ROUNDS = 8
_FEWEST, _TRIED = 20, 150  # lines that must tell, and that are asked for
_LOWEST = 10.0  # [rad/s] of them
_CLEAR = 4.0  # power of a line over that of its noise
_ANGLE = 1.0  # [rad] of a sample, up to which lines count
_LAGS = 6  # samples, the longest delay that is tried
_OVERLAP = 3.0  # neighbouring lines of a local response that err together, about
_PER_OCTAVE = 3  # errors of a model are alike over a third of an octave; assumed


@dataclass(frozen=True, slots=True, eq=False)
class ExcitationFit:
    """delta (r,) [-] and tau (r,) [s] of (1) for every distinct excitation with their 95 %
    half-widths; common: tau of all of them, if it is one, with its half-width; misfit: the relative
    error of the model that is left.
    """

    delta: np.ndarray
    delta_half: np.ndarray
    tau: np.ndarray
    tau_half: np.ndarray
    common: tuple[float, float]
    misfit: float


def excitation_findings(
    plant: Plant,
    law: StateSpace,
    records: Sequence[Record],
    doubts: Mapping[str, float] = DOUBTS,
    others: Sequence[Plant] = (),
) -> list[Finding]:
    """law: sampled, its delay included; records at the plant's operating point; doubts: relative
    half-widths by quantity, or "seal"; others: plants that it may be as well, with another number
    of bending modes.
    """
    fit, dt = fit_excitation(plant, law, records, doubts, others), records[0].dt
    if fit is None or fit.misfit > _FITS:
        return []
    sizes, times = [], []
    late = [*zip(fit.tau.tolist(), fit.tau_half.tolist(), strict=True)]
    if _off(*fit.common, dt) and max(abs(t - fit.common[0]) - _SURE * h for t, h in late) <= 0:
        late = [fit.common] * len(late)  # each agrees with one delay of all, which is told better
    for r, axis in enumerate(plant.axes):
        names = f"e_{axis}"
        size = 1 / (1 + fit.delta[r])
        if abs(fit.delta[r]) > _SMALL + _FAR * fit.delta_half[r]:
            sizes.append((names, size, fit.delta_half[r] * size**2))
        if _off(*late[r], dt):
            times.append((names, late[r][0] / dt, late[r][1] / dt))
    remedy = (
        "check the scale and the time of the recorded e, and that it is added between controller "
        "and amplifier"
    )
    found = []
    if sizes:
        told = ", ".join(f"{n} is {s:.3g} ± {h:.2g} times what acted" for n, s, h in sizes)
        great = any(abs(1 - s) - h > _GREAT for _, s, h in sizes)
        what = "the recorded excitation is not of the size that the loop answered"
        severity = ERROR if great else WARNING
        found.append(Finding(Code.EXCITATION, severity, what, told, remedy))
    if times:
        told = ", ".join(
            f"{n} is {abs(t):.2g} ± {h:.1g} samples {'late' if t > 0 else 'early'}"
            for n, t, h in times
        )
        what = "the recorded excitation is not of the time at which the loop answered"
        found.append(Finding(Code.EXCITATION, WARNING, what, told, remedy))
    return found


def _off(tau: float, half: float, dt: float) -> bool:
    """Whether an excitation is late or early by a sample: recorders err by whole ones."""
    return abs(tau) > max(dt / 2, _SURE * half)


def fit_excitation(
    plant: Plant,
    law: StateSpace,
    records: Sequence[Record],
    doubts: Mapping[str, float] = DOUBTS,
    others: Sequence[Plant] = (),
) -> ExcitationFit | None:
    """delta and tau of (1); None where an axis is not excited, or excited as another one, and where
    records are too short.
    """
    dt, axes = records[0].dt, plant.axes
    e, y = ([f"{kind}_{axis}" for axis in axes] for kind in "ey")
    if any(name not in record.signals for record in records for name in y):
        return None
    try:
        at = np.geomspace(_LOWEST, _ANGLE / dt, _TRIED)
        measured = local_response(records, e, y, at=at.tolist(), sparse=True)
        told = _lines(measured)
        omega, r = measured.omega[told], len(axes)
        if np.abs(poles(closed_loop(plant, law))).max() > 1:
            return None  # it shows no response
        loop = LoopModel.of(plant, law, omega, doubted(plant, doubts))
        base = loop.at(np.zeros(len(loop.blocks)))[0]

        # another plant is within a standard deviation, which is half a half-width
        further = [2 * (LoopModel.of(item, law, omega, ()).at(())[0] - base) for item in others]
        beside = np.reshape(further, (-1, *base.shape))
    except AmbroseError:  # which those explain that need the response or the model
        return None
    X, noise = measured.values[told], measured.variance[told]
    q = len(loop.blocks)
    p = q + len(beside)
    if len(told) < _FEWEST:
        return None

    # every line counts by its own size: what a model has wrong is a share of the response
    size = np.sqrt(np.mean(np.abs(X) ** 2, axis=1, keepdims=True))
    delta, tau = np.zeros(r), np.full(r, _first_delay(omega, X, base, dt))
    a = np.zeros(p)
    covariance, misfit = np.eye(2 * r + p), _LEAST
    prior = np.r_[np.zeros(2 * r), np.full(p, 4.0)]  # a_p: 1/2 of a half-width
    for _ in range(_ROUNDS):
        # left = X - (1 + delta) exp(j w tau) T, and its slopes
        T, slopes = loop.at(a[:q])
        T = T + np.einsum("p,pwar->war", a[q:], beside)
        slopes = np.concatenate([slopes, beside])
        turn = np.exp(1j * omega[:, None] * tau)[:, None, :]
        whole = (1 + delta) * turn * T
        left = X - whole
        columns = np.zeros((2 * r + p, *X.shape), complex)
        for k in range(r):
            columns[k, :, :, k] = (turn * T)[:, :, k]
            columns[r + k, :, :, k] = 1j * omega[:, None] * whole[:, :, k]
        for k, slope in enumerate(slopes):
            columns[2 * r + k] = (1 + delta) * turn * slope
        scale = np.r_[np.ones(r), np.full(r, 1 / omega.max()), np.ones(p)]  # unknowns of order one
        misfit = _misfit(left, noise, size)
        weight = 1 / np.sqrt(noise + (misfit * size) ** 2)
        J = (columns * scale[:, None, None, None] * weight).reshape(len(scale), -1)
        b = (left * weight).ravel()
        J, b = np.hstack([J.real, J.imag]), np.hstack([b.real, b.imag])

        # sum |left|^2 / (variance / 2 per part) over how many lines err together + a^2 / (1/4)
        together = _together(omega, misfit)
        normal = 2 * J @ J.T / together + np.diag(prior)
        right = 2 * J @ b / together - prior * np.r_[np.zeros(2 * r), a]
        covariance = np.linalg.pinv(normal)
        step = scale * (covariance @ right)
        delta, tau = delta + step[:r], tau + step[r : 2 * r]
        a = a + step[2 * r :]
        delta, a = np.clip(delta, -0.95, 20.0), np.clip(a, -2.0, 2.0)
        if not np.isfinite(step).all():
            return None
    covariance = scale[:, None] * covariance * scale
    half = COVERAGE * np.sqrt(np.diag(covariance))

    # one tau by the weights of its covariance C: 1' C^-1 tau over 1' C^-1 1
    weights = np.linalg.pinv(covariance[r : 2 * r, r : 2 * r]).sum(axis=1)
    common = float(weights @ tau / weights.sum()), float(COVERAGE / np.sqrt(weights.sum()))
    return ExcitationFit(delta, half[:r], tau, half[r : 2 * r], common, misfit)


def _lines(measured: Frf) -> np.ndarray:
    """The lines whose response stands out of its noise; the best ones where few do, whose interval
    is then wide.
    """
    noise = measured.variance.sum(axis=(1, 2))
    ratio = np.sum(np.abs(measured.values) ** 2, axis=(1, 2)) / np.maximum(noise, 1e-300)
    least = min(_CLEAR, float(np.sort(ratio)[::-1][:_FEWEST].min(initial=np.inf)))
    return np.flatnonzero(ratio >= least)


@dataclass(frozen=True, slots=True, eq=False)
class LoopModel:
    """The loop at frequencies (w,), its parameters open: P (w, z + a, w + a) of z, y from w, u;
    held (w, 1, 1); G (w, a, a) sampled, K (w, a, a); blocks: the signals of each parameter, w and
    z alike.
    """

    P: np.ndarray
    held: np.ndarray
    G: np.ndarray
    K: np.ndarray
    blocks: tuple[slice, ...]

    @staticmethod
    def of(
        plant: Plant, law: StateSpace, omega: np.ndarray, moved: Sequence[Tolerance]
    ) -> LoopModel:
        """Raises InvalidInput."""
        u, y = list(plant.named("u")), list(plant.named("y"))
        dt = law.dt or 0.0
        G = frequency_response(c2d(select(plant.system, u, y), dt), omega).values
        K = frequency_response(law, omega).values
        held = hold(omega, dt)[:, None, None]
        if not moved:
            return LoopModel(G, held, G, K, ())
        general = uncertain(plant, moved)
        w, z = general.w[: general.n_w_blocks], general.z[: general.n_z_blocks]
        P = frequency_response(select(general.system, [*w, *u], [*z, *y]), omega).values
        ends = np.cumsum([0, *(block.n_w for block in general.blocks)]).tolist()
        return LoopModel(P, held, G, K, tuple(map(slice, ends[:-1], ends[1:])))

    def at(self, a: np.ndarray | Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """T (w, a, a), y per e, with each parameter a_p half-widths off, and its slopes (p, w, a,
        a).
        """
        n, unit = len(self.P[0]) - len(self.G[0]), np.eye(len(self.G[0]))
        delta = np.zeros(n)
        for block, value in zip(self.blocks, a, strict=True):
            delta[block] = value
        P_zw, P_zu = self.P[:, :n, :n], self.P[:, :n, n:]
        P_yw = self.P[:, n:, :n]

        # G = G_0 + P_yw D (I - P_zw D)^-1 P_zu with D the parameters, each u held over a sample
        inner = np.linalg.inv(np.eye(n) - P_zw * delta)
        G = self.G + (P_yw * delta) @ inner @ P_zu * self.held

        # T = S_o G = (I + G K)^-1 G, and dT = S_o dG S_i with S_i = I - K T
        S = np.linalg.inv(unit + G @ self.K)
        T = S @ G

        # dG = P_yw (I - D P_zw)^-1 E (I - P_zw D)^-1 P_zu, E the parameter's part of I
        left = P_yw @ np.linalg.inv(np.eye(n) - delta[:, None] * P_zw)
        right = inner @ P_zu * self.held
        S_i = unit - self.K @ T
        slopes = [S @ left[:, :, b] @ right[:, b] @ S_i for b in self.blocks]
        return T, np.reshape(slopes, (-1, *T.shape))


def _first_delay(omega: np.ndarray, X: np.ndarray, model: np.ndarray, dt: float) -> float:
    """The whole number of samples [s] by which the responses are turned, about."""
    size = np.mean(np.abs(X) ** 2, axis=(1, 2))
    cross = np.sum(X * model.conj(), axis=(1, 2)) / size
    lags = np.arange(-_LAGS, _LAGS + 1) * dt
    return float(lags[np.argmax((cross @ np.exp(-1j * omega[:, None] * lags)).real)])


def doubted(plant: Plant, doubts: Mapping[str, float] = DOUBTS) -> list[Tolerance]:
    """The machine's tolerances around the point, and what it states without one."""
    machine = plant.machine
    found = list(tolerances_around(plant))
    stated = [
        Tolerance(path, relative=doubts[path.split(".")[2]]) for path in magnet_paths(machine)
    ]
    stated += [
        Tolerance(f"amplifier.{name}", relative=doubts["amplifier"])
        for name in AMPLIFIER_PARAMETERS[machine.amplifier.order]
    ]
    stated += _of_seals(machine, doubts["seal"])
    for item in stated:
        same = [
            t
            for t in found
            if parse_parameter(t.parameter).overlaps(parse_parameter(item.parameter))
        ]
        if any(t.relative is None or t.relative >= (item.relative or 0.0) for t in same):
            continue
        try:
            nominal = any(channel.nominal for channel in channels(plant, item.parameter))
        except AmbroseError:  # a seal of its own kind has no such coefficient
            continue
        if nominal:
            found = [t for t in found if t not in same] + [item]
    return found


def _of_seals(machine: Machine, width: float) -> list[Tolerance]:
    return [
        Tolerance(f"seal.{item.name}.{quantity}", relative=width)
        for item in machine.seals
        for quantity in ("K", "k", "C", "c")
    ]


def _misfit(left: np.ndarray, noise: np.ndarray, size: np.ndarray) -> float:
    """The relative error of the model with which noise explains what is left: the mean of |left|^2
    over its variance is one (Paule & Mandel 1982).
    """
    power, share = np.abs(left) ** 2, size**2 + 0 * noise

    # a mean of so many squares is above one by chance: three standard deviations are no misfit
    chance = 1 + 3 / np.sqrt(power.size / _OVERLAP)

    def ratio(error: float) -> float:
        return float(np.mean(power / np.maximum(noise + error**2 * share, 1e-300)))

    low, high = _LEAST, 10.0
    if ratio(low) <= chance:
        return low
    for _ in range(50):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if ratio(middle) > chance else (low, middle)
    return float(high)


def _together(omega: np.ndarray, misfit: float) -> float:
    """How many lines err together."""
    if misfit <= _LEAST:
        return _OVERLAP
    octaves = float(np.log2(omega[-1] / omega[0]))
    return max(_OVERLAP, len(omega) / max(_PER_OCTAVE * octaves, 1.0))
