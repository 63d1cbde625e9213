"""A controller of low order polished against the real uncertainty itself: several models of the
plant at once.

D-K iteration treats real parameters as complex and pays for D with states. Here a controller of
fixed order is moved downhill on the p-norm of the closed loop over frequency and over models of the
plant at given values of its real parameters, with exact gradients (multi-model H-infinity control,
Apkarian & Noll 2006; the p-norm instead of subgradients). The frequency grid reaches from near zero
to far above the plant and takes in the true peak of every loop, for what the grid does not see gets
exploited; after each round the true norms are computed and the worst parameter values searched, and
added to the models.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, NumericalFailure, check_shape, invalid, named_failure
from ambrose.core.frequency import frequency_response, largest_gain
from ambrose.core.hinf_riccati import check_plant
from ambrose.core.lft import (
    GeneralizedPlant,
    close_uncertainty,
    design_grid,
    lft,
)
from ambrose.core.mu.all_frequencies import proved_below
from ambrose.core.norms import hinf_norm
from ambrose.core.processes import TimeLimit
from ambrose.core.statespace import StateSpace, as_statespace, is_stable, poles, spectral_abscissa
from ambrose.judge.result import (
    CERTIFYING,
    INTERRUPTED,
    Certificate,
    Status,
    Synthesis,
    fastest_pole,
)
from ambrose.law.design_problem import PERFORMANCE, with_performance_block
from ambrose.synthesis.fixed_order.structure import decoupled_blocks, reduce_controller

# L-BFGS whose line search never leaves the set of stabilising controllers (Nocedal & Wright 2006,
# alg. 7.4, 3.1).


_MEMORY = 25  # steps that the approximation of the Hessian remembers; assumed
_HALVINGS = 25
_RENEWED = 10  # steps between two calls of ``renew``


def descend(
    cost: Callable[[np.ndarray], tuple[float, np.ndarray]],
    allowed: Callable[[np.ndarray], bool],
    x: np.ndarray,
    iterations: int,
    tolerance: float,
    proceed: Callable[[], bool],
    renew: Callable[[np.ndarray], bool] | None = None,
    least: float = -np.inf,
) -> tuple[np.ndarray, int]:
    """x (k,) with a lower cost, reached through allowed points only, and the iterations used.

    x (k,): allowed. Ends after ``iterations``, when ten of them gain less than ``tolerance``, when
    the cost is below ``least``, or when ``proceed`` says no. renew: called with x at the start,
    every ten steps and at the end, it may change what the cost leaves out. Where it says False the
    cost had left out that x is not allowed: the descent goes on from where it last said True.
    """
    if renew is not None:
        renew(x)
    safe = x
    value, g = cost(x)
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    values = [value]
    used = 0
    while used < iterations:
        used += 1
        if not proceed():
            break
        if renew is not None and used % _RENEWED == 0:
            # leaving out other parts changes the cost at the same x: earlier values move along, so
            # that gains can still be told
            if not renew(x):
                x = safe
                renew(x)
                pairs.clear()
            safe = x
            before = value
            value, g = cost(x)
            values = [item + value - before for item in values]

        # -H g; without descent (rounding, or a cost that was renewed) the memory is dropped.
        direction = _direction(g, pairs)
        slope = float(g @ direction)
        if slope >= 0:
            pairs.clear()
            direction, slope = -g, -float(g @ g)

        # The memory scales a direction itself; the bare gradient starts with 1 % of |x|, or of 1.
        step = (
            1.0
            if pairs
            else min(
                1.0,
                1e-2 * max(1.0, float(np.linalg.norm(x))) / max(float(np.linalg.norm(g)), 1e-300),
            )
        )
        for _ in range(_HALVINGS):
            trial = x + step * direction
            # sufficient decrease, among allowed points; where the cost is far higher (inf where a
            # loop is unstable) the step falls tenfold
            new, g_new = cost(trial)
            if new <= value + 1e-4 * step * slope and allowed(trial):
                break
            step *= 0.5 if np.isfinite(new) and new < value + 1 else 0.1
        else:
            # no step along -g itself gains: the end; otherwise once more along -g
            if not pairs:
                break
            pairs.clear()
            continue

        # Only a pair of positive curvature keeps H positive definite.
        s, y = trial - x, g_new - g
        if s @ y > 1e-10 * np.linalg.norm(s) * np.linalg.norm(y):
            pairs = [*pairs[-_MEMORY + 1 :], (s, y)]
        x = trial
        value = new
        g = g_new
        values.append(value)
        if value < least or (len(values) > 10 and values[-11] - value < tolerance):
            break
    return (x if renew is None or renew(x) else safe), used


def _direction(g: np.ndarray, pairs: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """-H g by the two-loop recursion."""
    # First loop, from the newest pair: q = V q with V = I - y s^T / s^T y.
    q, alphas = g.copy(), []
    for s, y in reversed(pairs):
        alpha = float(s @ q) / float(s @ y)
        q -= alpha * y
        alphas.append(alpha)

    # H_0 = (s^T y / y^T y) I of the newest pair
    if pairs:
        s, y = pairs[-1]
        q *= float(s @ y) / float(y @ y)

    # Second loop, from the oldest: q = V^T q + s alpha.
    for (s, y), alpha in zip(pairs, reversed(alphas), strict=True):
        q += s * (alpha - float(y @ q) / float(s @ y))
    return -q


# What polishing minimises: the p-norm, over frequencies and models of the plant, of the closed
# loop's singular values.
#
# For M = P11 + P12 K (I - P22 K)^-1 P21 and f = ln(sum sigma_i^p)/p, the derivative is exact: dM =
# L dK R with L = P12 (I - K P22)^-1, R = (I - P22 K)^-1 P21, and dK follows from the matrices of K
# (Apkarian & Noll 2006 work with the subgradients of the largest singular value; the p-norm is
# smooth).
#
# The controller is block-diagonal, 2 x 2 blocks (one 1 x 1 for an odd order): A_ij = sqrt(w_i w_j)
# a_ij, B_i = sqrt(w_i) b_i, C_j = sqrt(w_j) c_j with the modulus w of the block's first poles, and
# inputs and outputs scaled to comparable gains, so that all unknowns are numbers of similar size.


_PARALLEL = 1e8  # condition of the eigenvectors above which they give no form


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """The structure of the controller: mask (n, n) of A's free entries, rate (n,) [rad/s], u_scale
    (m,), y_scale (p,).
    """

    mask: np.ndarray
    rate: np.ndarray
    u_scale: np.ndarray
    y_scale: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def controller(self, x: np.ndarray) -> StateSpace:
        """The controller of the unknowns x (k,)."""
        return StateSpace(*self.matrices(x), self.inputs, self.outputs)

    def matrices(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        n = len(self.rate)
        m = len(self.u_scale)
        p = len(self.y_scale)
        count = int(self.mask.sum())
        a, b, c, d = np.split(x, np.cumsum([count, n * p, m * n]))
        root = np.sqrt(self.rate)
        A = np.zeros((n, n))
        A[self.mask] = a
        A *= root[:, None] * root
        B = root[:, None] * b.reshape(n, p) / self.y_scale
        C = self.u_scale[:, None] * c.reshape(m, n) * root
        return A, B, C, self.u_scale[:, None] * d.reshape(m, p) / self.y_scale

    def unknowns(self, A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> np.ndarray:
        """x (k,) of matrices in this form."""
        root = np.sqrt(self.rate)
        return np.concatenate(
            [
                (A / root[:, None] / root)[self.mask],
                (B / root[:, None] * self.y_scale).ravel(),
                (C / self.u_scale[:, None] / root).ravel(),
                (D / self.u_scale[:, None] * self.y_scale).ravel(),
            ]
        )

    def gradient(
        self, dA: np.ndarray, dB: np.ndarray, dC: np.ndarray, dD: np.ndarray
    ) -> np.ndarray:
        """df/dx from df/dA .. df/dD."""
        # df/da = df/dA dA/da: each slope times the size of its entry
        root = np.sqrt(self.rate)
        return np.concatenate(
            [
                (dA * root[:, None] * root)[self.mask],
                (dB * root[:, None] / self.y_scale).ravel(),
                (dC * self.u_scale[:, None] * root).ravel(),
                (dD * self.u_scale[:, None] / self.y_scale).ravel(),
            ]
        )


def block_form(controller: StateSpace) -> tuple[Form, np.ndarray]:
    """The form of a controller and its unknowns: poles in complex pairs, real ones paired by size;
    each block balanced.
    """
    n = controller.n_states
    values, V = np.linalg.eig(controller.A) if n else (np.zeros(0, complex), np.zeros((0, 0)))
    pairs = [i for i in np.argsort(np.abs(values)) if values[i].imag > 0]
    real = [i for i in np.argsort(np.abs(values)) if values[i].imag == 0]

    # Columns of T: Re v and Im v of every complex pair, then the real eigenvectors two by two.
    T = np.zeros((n, n))
    mask = np.zeros((n, n), bool)
    rate = np.zeros(n)
    k = 0
    for i in pairs:
        T[:, k], T[:, k + 1] = V[:, i].real, V[:, i].imag
        mask[k : k + 2, k : k + 2], rate[k : k + 2] = True, abs(values[i])
        k += 2
    for group in [real[j : j + 2] for j in range(0, len(real), 2)]:
        size = len(group)
        T[:, k : k + size] = V[:, group].real
        mask[k : k + size, k : k + size] = True
        rate[k : k + size] = np.maximum(
            np.abs(values[group]), 1e-9 * max(np.abs(values).max(initial=0.0), 1e-300)
        )
        k += size
    # equal poles in series: as 2 x 2 blocks they would be another controller
    if n and np.linalg.cond(T) > _PARALLEL:
        A, B, C, mask, rate = _merged(controller)
    else:
        A = np.linalg.solve(T, controller.A @ T)
        B = np.linalg.solve(T, controller.B)
        C = controller.C @ T

    # Largest gain (m, p) of every entry over the controller's own frequencies.
    omega = np.geomspace(max(rate.min(initial=1.0), 1e-6), max(rate.max(initial=1.0), 1.0), 40)
    gain = np.abs(frequency_response(controller, omega).values).max(axis=0)
    u_scale = np.sqrt(
        np.maximum(gain.max(axis=1), 1e-30) / np.maximum(gain.max(), 1e-30)
    ) * np.sqrt(max(gain.max(), 1e-30))
    y_scale = u_scale.max() / np.maximum(gain.max(axis=0), 1e-30)
    # every state: the same size of input and output in scaled units
    into = np.linalg.norm(B / np.sqrt(rate)[:, None] * y_scale, axis=1)
    out = np.linalg.norm(C / u_scale[:, None] / np.sqrt(rate), axis=0)
    # one number for all states of a block
    into, out = (np.array([np.linalg.norm(v[mask[i]]) for i in range(n)]) for v in (into, out))
    # x = diag(s) x'
    s = np.sqrt(np.maximum(into, 1e-30) / np.maximum(out, 1e-30))  # the same within a block
    A = A * s / s[:, None]
    B = B / s[:, None]
    C = C * s
    form = Form(mask, rate, u_scale, y_scale, controller.inputs, controller.outputs)
    return form, form.unknowns(np.where(mask, A, 0.0), B, C, controller.D)


def _merged(
    controller: StateSpace,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C, mask and rate, poles that cannot be separated in larger blocks
    (core/realisation/modal_form).
    """
    parts = decoupled_blocks(controller, np.arange(controller.n_states))
    A = sla.block_diag(*[p[0] for p in parts])
    B = np.vstack([p[1] for p in parts])
    C = np.hstack([p[2] for p in parts])
    mask = sla.block_diag(*[np.ones_like(p[0], bool) for p in parts])
    moduli = [np.abs(np.linalg.eigvals(p[0])) for p in parts]
    return (
        A,
        B,
        C,
        mask,
        np.maximum(np.concatenate(moduli), 1e-9 * max(size.max() for size in moduli)),
    )


class Cost:
    """f(x) and its gradient for a list of models without blocks, on one grid."""

    __slots__ = ("P11", "P12", "P21", "P22", "form", "omega", "systems")

    def __init__(self, form: Form, models: Sequence[GeneralizedPlant], omega: np.ndarray) -> None:
        first = models[0]
        nz, nw = len(first.z), len(first.w)
        values = np.stack([frequency_response(model.system, omega).values for model in models])
        self.form, self.omega = form, omega
        self.P11, self.P12 = values[..., :nz, :nw], values[..., :nz, nw:]
        self.P21, self.P22 = values[..., nz:, :nw], values[..., nz:, nw:]
        self.systems = [
            (m.system.A, m.system.B[:, nw:], m.system.C[nz:], m.system.D[nz:, nw:]) for m in models
        ]

    def _response(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """K (w, m, p), X = (sI - A)^-1 B (w, n, p), Y = C (sI - A)^-1 (w, m, n)."""
        A, B, C, D = self.form.matrices(x)
        n = len(A)
        inverse = np.linalg.inv(1j * self.omega[:, None, None] * np.eye(n) - A)
        X = inverse @ B
        return C @ X + D, X, C @ inverse

    def gains(self, x: np.ndarray) -> np.ndarray:
        """Largest singular values (models, w)."""
        K, _, _ = self._response(x)
        E = np.eye(K.shape[2]) - self.P22 @ K
        M = self.P11 + self.P12 @ K @ np.linalg.solve(E, self.P21)
        return largest_gain(M)

    def __call__(self, x: np.ndarray, power: float) -> tuple[float, np.ndarray]:
        """ln of the p-norm, and its gradient (k,)."""
        K, X, Y = self._response(x)

        # R = (I - P22 K)^-1 P21, L = P12 (I + K (I - P22 K)^-1 P22), M = P11 + P12 K R
        E = np.eye(K.shape[2]) - self.P22 @ K  # (models, w, p, p)
        R = np.linalg.solve(E, self.P21)
        L = self.P12 + self.P12 @ (K @ np.linalg.solve(E, self.P22))  # P12 (I - K P22)^-1
        M = self.P11 + self.P12 @ (K @ R)

        size = np.linalg.norm(M, axis=(2, 3))
        largest = float(largest_gain(M.reshape(-1, *M.shape[2:])[size.argmax()]))
        # the others add nothing: sigma_max <= |M|_F <= sqrt(8) sigma_max
        used = size >= max(0.35 * size.max(), largest * 1e-17 ** (1 / power))
        N = M[used]

        # sigma^2 and one side's singular vectors from the smaller of N N^H and N^H N.
        wide = N.shape[1] < N.shape[2]
        squares, V = np.linalg.eigh(
            N @ N.conj().swapaxes(1, 2) if wide else N.conj().swapaxes(1, 2) @ N
        )
        # what squaring loses lies far below the largest, and does not count
        s = np.sqrt(np.maximum(squares, 1e-300))

        # sum sigma^p over the largest sigma^p, for the powers to stay in range
        logs = power * np.log(s)
        top = logs.max()
        share = np.exp(logs - top)
        total = share.sum()

        # G = df/dM = U diag(sigma^(p-1)) V^H / sum sigma^p
        #   = U diag(sigma^(p-2)) U^H N / sum, or N V diag(sigma^(p-2)) V^H / sum
        V_weighted = (V * (share / total / s**2)[:, None, :]) @ V.conj().swapaxes(1, 2)
        G = np.zeros(M.shape, complex)
        G[used] = V_weighted @ N if wide else N @ V_weighted

        # dM = L dK R, all models with one K;   dK = dD + dC X + Y dB + Y dA X
        psi = (L.conj().swapaxes(2, 3) @ G @ R.conj().swapaxes(2, 3)).sum(axis=0)  # (w, m, p)
        XH, YH = X.conj().swapaxes(1, 2), Y.conj().swapaxes(1, 2)
        dA = (YH @ psi @ XH).sum(axis=0).real
        dB, dC = (YH @ psi).sum(axis=0).real, (psi @ XH).sum(axis=0).real
        gradient = self.form.gradient(dA, dB, dC, psi.sum(axis=0).real)
        return float((top + np.log(total)) / power), gradient

    def abscissa(self, x: np.ndarray) -> float:
        """The largest real part of any model's closed-loop pole [rad/s]."""
        A, B, C, D = self.form.matrices(x)
        largest = -np.inf
        for Ap, Bp, Cp, Dp in self.systems:
            E = np.linalg.inv(np.eye(len(D)) - D @ Dp)  # u = E (D C_p x + C x_k)
            into = E @ np.hstack([D @ Cp, C])

            # y = C_p x + D_p u
            y = np.hstack([Cp, np.zeros((len(Cp), len(A)))]) + Dp @ into

            # x' = A_p x + B_p u,   x_k' = A x_k + B y
            joint = np.vstack([np.hstack([Ap, np.zeros((len(Ap), len(A)))]) + Bp @ into, B @ y])
            joint[len(Ap) :, len(Ap) :] += A
            largest = max(largest, float(sla.eigvals(joint, check_finite=False).real.max()))
        return largest


# few long ones leave a smoother loop: sampled S_o on the seal rig 2.73, not 2.85; identified 2.65,
# not 3.01
JUDGED_ROUNDS = 2
_POWERS = (15.0, 40.0, 100.0, 250.0)
_SLOWEST = 0.1  # the least decay that is kept, as a fraction of the start's
# of the parameter values, when the start does not stabilise all models
_SCALES = (1.0, 0.75, 0.5, 0.25, 0.0)
_CORNERS = 6  # models of several parameters: corners tried in random order and kept when bad
_PROOF = (1.01, 1.05, 1.1, 1.25)  # levels, in worst norms, at which a proof is tried
Delta = tuple[float, ...]


@named_failure("the polished controller")
def polish_synthesis(
    plant: GeneralizedPlant,
    start: StateSpace,
    *,
    order: int | None = None,
    deltas: Sequence[float] = (-1.0, -0.5, 0.0, 0.5, 1.0),
    iterations: int = 1200,
    rounds: int = 6,
    time_limit: float = 60.0,
    judge: Callable[[StateSpace], float] | None = None,
    prove: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Synthesis:
    """The controller of lowest worst-case norm that descent finds from ``start``, verified on
    ``plant`` over its box.

    plant: with real blocks (a performance block may follow); remaining w and z are the performance.
    start: a controller u = K y of the nominal plant, such as that of mu_synthesis. order: reduce it
    to so many states first (closed-loop balanced, residualised; a pair of near-equal values is not
    cut), None keeps its order. deltas [-]: values of a single real parameter, within -1 and 1; with
    several parameters the centre and bad corners are models. iterations: of L-BFGS, all rounds
    together; rounds: of descent, each followed by the true norms and a search for the worst
    parameters; time_limit [s] of computing, and five times that on the wall (``core.processes``);
    judge: decides which round's controller is returned, the lowest of its values (the worst
    sensitivity of the sampled loop, say; None: the lowest worst-case norm); prove: False leaves
    "proved_norm" out, which may take longer than the descent; progress: called with one line of
    text per round.

    ``gamma`` and the certificate's norm: the largest H-infinity norm of the performance over all
    models and all parameter values searched (a search, no proof). certificate.margins:
    "start_norm", the same for ``start``; "reduced_norm", after the reduction; "nominal_norm";
    "proved_norm", a level proved for the whole box, stability included (inf where the proof fails);
    "models". Ctrl-C and the time limit return the best verified controller so far;
    ``stopped_early`` says which.

    Raises InvalidInput (no real blocks, complex blocks, a controller that does not fit) and
    NumericalFailure (the reduced controller does not even stabilise the nominal plant).
    """
    plant, controller = _box_problem(plant), as_statespace(start)
    if controller.D.shape != (len(plant.u), len(plant.y)) or controller.dt is not None:
        raise invalid(
            "start",
            repr(controller),
            f"continuous with {len(plant.y)} inputs, {len(plant.u)} outputs",
            "match",
        )
    for number, name in ((iterations, "iterations"), (rounds, "rounds")):
        if not isinstance(number, int | np.integer) or number < 1:
            raise invalid(name, number, "a whole number, at least 1", "leave the default")
    names = tuple(block.name for block in plant.blocks)
    job = _Job(
        plant,
        controller,
        controller.n_states if order is None else order,
        names,
        _first_models(len(names), deltas),
        max(1, iterations // rounds),
        TimeLimit(time_limit),
        progress or (lambda _: None),
    )
    reason: str | None = None
    best = _reduced(job)
    history = [_row(job, 0, best)]
    rounds_done = [best]
    try:
        for number in range(1, rounds + 1):
            polished = _round(job, best, number)
            history.append(_row(job, number, polished))
            rounds_done.append(polished)
            if polished.worst < best.worst:
                gain, best = best.worst - polished.worst, polished
                if np.isfinite(gain) and gain < 1e-4 * best.worst and number >= len(_POWERS):
                    break
            if job.clock.left <= 0:
                reason = job.clock.reached
                break
    except KeyboardInterrupt:
        reason = INTERRUPTED
        job.say(CERTIFYING)
    if not np.isfinite(best.worst):
        raise NumericalFailure(
            f"no controller of order {best.controller.n_states} that stabilises the whole box was "
            "found"
            f"{' (' + reason + ')' if reason else ''}; allow a higher order or more iterations"
        )
    if judge is not None:
        best = min(
            (point for point in rounds_done if np.isfinite(point.worst)),
            key=lambda point: judge(point.controller),
        )
    return _result(job, best, history, reason, prove)


@dataclass(slots=True, eq=False)
class _Job:
    """The task, and the models it has collected so far."""

    plant: GeneralizedPlant
    start: StateSpace
    order: int
    names: tuple[str, ...]
    models: list[Delta]
    iterations: int  # of a round
    clock: TimeLimit
    say: Callable[[str], None]
    extra: list[float] = field(default_factory=list)  # frequencies of true peaks [rad/s]
    start_worst: float = float("nan")
    reduced_worst: float = float("nan")

    def model(self, delta: Delta) -> GeneralizedPlant:
        """The plant at parameter values, without blocks."""
        system = close_uncertainty(self.plant, dict(zip(self.names, delta, strict=True)))
        n_w, n_z = self.plant.n_w_blocks, self.plant.n_z_blocks
        return GeneralizedPlant(
            system, self.plant.w[n_w:], self.plant.u, self.plant.z[n_z:], self.plant.y
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    controller: StateSpace
    worst: float  # inf where a model is unstable
    worst_delta: Delta
    nominal: float


def _box_problem(plant: GeneralizedPlant) -> GeneralizedPlant:
    """The plant without performance block. Raises InvalidInput unless real blocks and performance
    signals remain.
    """
    blocks = [b for b in check_plant(plant).blocks if not (b.full and b.name == PERFORMANCE)]
    if not blocks or not all(b.real for b in blocks):
        kinds = ", ".join(type(b).__name__ for b in blocks) or "none"
        raise invalid(
            "the plant's blocks",
            kinds,
            "real parameters, one at least",
            "complex blocks need mu_synthesis",
        )
    plant = GeneralizedPlant(plant.system, plant.w, plant.u, plant.z, plant.y, blocks)
    if len(plant.w) == plant.n_w_blocks or len(plant.z) == plant.n_z_blocks:
        raise InvalidInput(
            "the plant has no performance signals beyond its blocks; add w and z to be kept small"
        )
    return plant


def _first_models(count: int, deltas: Sequence[float]) -> list[Delta]:
    """All ``deltas`` of a single parameter; of several the centre and a few corners. Raises
    InvalidInput.
    """
    values = np.unique(np.append(check_shape(deltas, "deltas", "(k)").astype(float), 0.0))
    if np.abs(values).max() > 1:
        raise invalid(
            "deltas", values.tolist(), "within -1 and 1", "the plant's box is scaled to that"
        )
    if count == 1:
        return [(float(v),) for v in values]
    rng = np.random.default_rng(0)
    corners = [tuple(float(v) for v in rng.choice([-1.0, 1.0], count)) for _ in range(_CORNERS)]
    return [(0.0,) * count, (1.0,) * count, (-1.0,) * count, *dict.fromkeys(corners)]


def _norm(job: _Job, controller: StateSpace, delta: Delta) -> tuple[float, float]:
    """True norm and peak frequency at parameter values; inf where unstable."""
    loop = lft(job.model(delta), controller)
    if not is_stable(loop):
        return np.inf, 0.0
    found = hinf_norm(loop, tolerance=1e-4)
    return found.value, found.frequency


def _judge(job: _Job, controller: StateSpace) -> _Point:
    """The true worst case: all models, then a search of the box; bad values become models, peaks
    join the grid.
    """
    found = {delta: _norm(job, controller, delta) for delta in job.models}
    nominal = found[(0.0,) * len(job.names)][0]
    if len(job.names) == 1:
        more = [(float(v),) for v in np.linspace(-1, 1, 17)]
        found |= {delta: _norm(job, controller, delta) for delta in more if delta not in found}
    else:
        found |= _corner_search(job, controller, max(found, key=lambda delta: found[delta][0]))
    worst = max(found, key=lambda delta: found[delta][0])
    value = found[worst][0]

    # The worst parameter values join the models where they are worse than all; true peaks the grid.
    known = max(found[delta][0] for delta in job.models)
    if worst not in job.models and (value > 1.002 * known or not np.isfinite(value)):
        job.models.append(worst)
    job.extra += [found[delta][1] for delta in job.models if 0 < found[delta][1] < np.inf]
    return _Point(controller, value, worst, nominal)


def _corner_search(
    job: _Job, controller: StateSpace, start: Delta
) -> dict[Delta, tuple[float, float]]:
    """One coordinate after the other to the end that is worse, twice, from the worst model, or
    until it is unstable.
    """
    best, found = start, {start: _norm(job, controller, start)}
    for k in itertools.islice(itertools.cycle(range(len(start))), 2 * len(start)):
        for end in (-1.0, 1.0):
            trial = (*best[:k], end, *best[k + 1 :])
            if trial not in found:
                found[trial] = _norm(job, controller, trial)
            if found[trial][0] > found[best][0]:
                best = trial
        if not np.isfinite(found[best][0]):
            break
    return found


def _reduced(job: _Job) -> _Point:
    """The start brought to its order and judged."""
    given = _judge(job, job.start)
    job.start_worst = job.reduced_worst = given.worst
    job.say(
        f"start: order {job.start.n_states}, worst norm {given.worst:.4f} at "
        f"{_named(job, given.worst_delta)}"
    )
    if job.order == job.start.n_states:
        return given
    controller, _ = reduce_controller(
        [job.model(delta) for delta in job.models], job.start, job.order
    )
    point = _judge(job, controller)
    job.reduced_worst = point.worst
    job.say(
        f"reduced: order {controller.n_states}, worst norm {point.worst:.4f} at "
        f"{_named(job, point.worst_delta)}"
    )
    return point


def _named(job: _Job, delta: Delta) -> str:
    return ", ".join(f"{name} {value:+.3g}" for name, value in zip(job.names, delta, strict=True))


def _grid(job: _Job, controller: StateSpace) -> np.ndarray:
    """The plant's grid, the loops' resonances and true peaks, and one frequency far above
    everything.
    """
    grid = design_grid(job.plant)
    loops = [poles(lft(job.model(delta), controller)) for delta in job.models]

    # Every loop's lightly damped poles.
    resonances = np.abs(
        np.concatenate([p[(p.imag > 0) & (np.abs(p.real) < 0.5 * np.abs(p))].imag for p in loops])
    )

    # Above the plant's grid, for the descent not to exploit what lies there.
    top = 10 * max(grid[-1], fastest_pole(controller))
    more = np.concatenate(
        [resonances, np.array(job.extra), np.geomspace(grid[-1], top, 12), [1e3 * top]]
    )
    grid = np.unique(np.concatenate([grid, more]))
    # points less than 0.1 % apart are one
    return grid[np.append(True, np.diff(np.log(grid)) > 1e-3)]


def _round(job: _Job, point: _Point, number: int) -> _Point:
    """One descent at the round's power, judged."""
    form, x = block_form(point.controller)

    # From a start that loses some models, all parameter values are drawn in until it holds them.
    scale = 1.0
    if not np.isfinite(point.worst):
        scale = next((s for s in _SCALES if _all_stable(job, form, x, s)), np.nan)
        if np.isnan(scale):
            raise NumericalFailure(
                f"the controller of order {point.controller.n_states} does not stabilise the "
                "nominal plant; reduce less"
            )
    power = _POWERS[min(number, len(_POWERS)) - 1]
    cost = Cost(form, _models(job, scale), _grid(job, point.controller))

    # A loop may lose most of its decay but not all, nor the controller gain ever faster poles.
    limit = _SLOWEST * cost.abscissa(x)
    fastest = 3 * max(fastest_pole(point.controller), cost.omega[-2] / 10)

    def allowed(trial: np.ndarray) -> bool:
        A = form.matrices(trial)[0]
        return (
            cost.abscissa(trial) <= limit
            and float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)) <= fastest
        )

    x, used = descend(
        lambda v: cost(v, power), allowed, x, job.iterations, 1e-4, lambda: job.clock.left > 0
    )
    polished = _judge(job, form.controller(x))
    job.say(
        f"round {number}: {used} steps at p = {power:g}, norm on the grid "
        f"{cost.gains(x).max():.4f}, worst true norm "
        f"{polished.worst:.4f} at {_named(job, polished.worst_delta)}, {len(job.models)} models"
    )
    return polished


def _models(job: _Job, scale: float) -> list[GeneralizedPlant]:
    return [
        job.model(delta)
        for delta in dict.fromkeys(tuple(scale * v for v in delta) for delta in job.models)
    ]


def _all_stable(job: _Job, form: Form, x: np.ndarray, scale: float) -> bool:
    controller = form.controller(x)
    return all(is_stable(lft(model, controller)) for model in _models(job, scale))


def _proved(job: _Job, best: _Point) -> float:
    """A level that the norm is proved to stay below over the whole box, stability included; inf
    where no proof succeeds.

    Mixed mu below 1, at every frequency, of the loop with its performance divided by the level
    (main loop theorem; Zhou, Doyle & Glover 1996, thm 11.7).
    """
    loop = lft(job.plant, best.controller)
    n = job.plant.n_z_blocks
    for factor in _PROOF:
        if job.clock.left <= 0:
            break
        level = factor * best.worst
        # only the rows of the performance are divided by the level
        gain = np.concatenate([np.ones(n), np.full(len(job.plant.z) - n, 1 / level)])
        scaled = StateSpace(loop.A, loop.B, gain[:, None] * loop.C, gain[:, None] * loop.D)
        if proved_below(scaled, with_performance_block(job.plant).blocks, 1.0):
            return level
    return float("inf")


def _row(job: _Job, number: int, point: _Point) -> dict[str, float]:
    return {
        "iteration": float(number),
        "gamma": point.worst,
        "nominal_norm": point.nominal,
        "order": float(point.controller.n_states),
        "models": float(len(job.models)),
        "seconds": job.clock.elapsed,
    }


def _result(
    job: _Job, best: _Point, history: list[dict[str, float]], reason: str | None, prove: bool
) -> Synthesis:
    abscissa = max(
        spectral_abscissa(lft(job.model(delta), best.controller)) for delta in job.models
    )
    margins = {
        "start_norm": job.start_worst,
        "reduced_norm": job.reduced_worst,
        "nominal_norm": best.nominal,
        **({"proved_norm": _proved(job, best)} if prove else {}),
        "models": float(len(job.models)),
    }
    certificate = Certificate(
        abscissa < 0,
        abscissa,
        best.worst,
        fastest_pole(best.controller),
        margins,
        f"generalized plant with {job.plant.system.n_states} states, worst of {len(job.models)} "
        "models and a search of the box",
    )
    notes = [f"the worst norm is at {_named(job, best.worst_delta)}"]
    if best.controller.n_states < job.order:
        notes.append(
            f"order {best.controller.n_states} instead of {job.order}: the cut would have parted "
            "a pair"
        )
    return Synthesis(
        best.controller,
        "polish",
        best.worst,
        Status.VERIFIED if certificate.stable else Status.UNSTABLE,
        certificate,
        tuple(history),
        tuple(notes),
        stopped_early=reason,
    )
