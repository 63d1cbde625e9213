"""What a model may lack, and what that would do to its values: one more unknown at a time, by one
step from the optimum.

With a further parameter c the normal equations of a fit grow by a column; eliminating the others
leaves S_c = H_cc - H_cp H_pp^-1 H_pc and g_c: the best step is d = g_c / S_c (Gauss-Newton), the
cost falls by g_c^2 / S_c, and the fitted values would move by -H_pp^-1 H_pc d. The score, |g_c|
over its standard deviation under the colour of the residuals, says how sure that is (a score test;
Rao 1948): it sees what the correlation of residuals and excitation, spread over a hundred lags,
does not. And residuals that follow the excitation say only that something is missing, the move how
much it matters. What is missing need not be one of the suspects: the largest move is a measure of
the effect, no bound.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import AmbroseError
from ambrose.core.response import SystemDerivative, held_derivative
from ambrose.core.sampling import Method, c2d
from ambrose.core.statespace import StateSpace
from ambrose.identification.findings import WARNING, Code, Finding
from ambrose.identification.output_error.closed_loop import LeastSquares, Loop, ParameterEstimate
from ambrose.identification.output_error.loop_model import LoopModel
from ambrose.identification.output_error.magnetic_force import MagneticForce
from ambrose.identification.output_error.normal_equations import (
    jacobian_pieces,
    normal_equations,
    synchronised,
)
from ambrose.identification.output_error.problem import (
    FURTHER_MODES,
    Experiment,
    FitOptions,
    build_experiment,
)
from ambrose.identification.output_error.statistics import (
    coloured_products,
    residual_scores,
    step_with_prior,
    verdict_of,
)
from ambrose.identification.parameters import plant_at, unit_of
from ambrose.law.law import LawLike
from ambrose.law.loop import match_controller
from ambrose.machine.description import AMPLIFIER_PARAMETERS
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import BENDING, TIMING, bending_modes_of_mesh, parse_parameter
from ambrose.record.record import Record

# What a measuring chain and its magnets may do that no parameter of the machine file stands for, as
# further unknowns of the loop, all zero in the model:
#
#     gain of y_j     what is measured is (1 + g) y_j
#     lag of y_j      what is measured is y_j - tau dy_j/dt: a filter, to first order
#     gain of e_j     what acts is (1 + g) e_j
#     turned sensors  y_zeta gains phi y_eta, y_eta loses phi y_zeta: a pair mounted askew
#     cross of a bearing    each axis' force gains a share of the other's current
#     turned bearing        one axis' force gains it, the other's loses it
#
# The controller takes what is measured. As the outputs' map may not depend on an unknown, the
# measured values are states of their own: s(k) = M C x(k), with M the identity in the model,
#
#     x+ = Ad x + Bu u + Be e,    z+ = A_K z - B_K s,    u = C_K z - D_K s,    s+ = M C x+
#
# so that a change of M shows in the rows of s alone. Their first values are estimated with the rest
# of the first state: the first sample tells nothing.


# [%], [deg], [samples] up to which a fault is harmless, assumed: less than a channel is calibrated
# to, and a part is mounted to
_GAIN, _ANGLE = 2.0, 2.0
_LAG = 0.1
# [%], [deg], [samples]: a longer step is no correction of a channel, but another wiring; assumed
_MOST_GAIN, _MOST_ANGLE = 50.0, 30.0
_MOST_LAG = 3.0
_RANK_ONE = 1e-6  # second over first singular value of a magnet's direction, at most


@dataclass(frozen=True, slots=True)
class Fault:
    """A further unknown: what to call it, its unit, the size [unit] up to which it is harmless, and
    that of one that is no longer a correction.
    """

    name: str
    unit: str
    harmless: float
    most: float


@dataclass(frozen=True, slots=True, eq=False)
class FaultyLoop:
    """A sampled loop over its weights with the derivatives for its model's parameters, then for
    every fault.
    """

    loop: StateSpace
    directions: list[SystemDerivative]
    faults: tuple[Fault, ...]


def faulty_loop(
    model: LoopModel, theta: np.ndarray, paths: Sequence[str], sizes: np.ndarray
) -> FaultyLoop:
    """The loop at theta (q,) of the parameters ``paths``, whose signals are y_<axis> alone, over
    their weights ``sizes`` (p,), with every fault that can be tried on it.
    """
    A, B, dA, dB = model.plant(theta)
    K = model.controller
    assert K.dt is not None
    crossed, cross_A, cross_B = _crossed(dA, dB, theta, paths)
    Ad, Bd, dAd, dBd = held_derivative(
        A, B, np.concatenate([dA, cross_A]), np.concatenate([dB, cross_B]), K.dt
    )
    n, nk = len(Ad), K.n_states
    axes = [name.removeprefix("u_") for name in K.outputs]
    a = len(axes)
    y = model.C[:a]

    # rows of x+ on the states (x, z, s) and on e; those of s+ are M C times them, M = 1
    on_state = np.hstack([Ad, Bd[:, :a] @ K.C, -Bd[:, :a] @ K.D])
    on_e = Bd[:, a:]
    of_z = np.hstack([np.zeros((nk, n)), K.A, -K.B])
    closed = np.vstack([on_state, of_z, y @ on_state])
    driven = np.vstack([on_e, np.zeros((nk, on_e.shape[1])), y @ on_e])
    C = np.zeros((len(model.signals), len(closed)))
    for row, name in enumerate(model.signals):
        C[row, n + nk + axes.index(name[2:])] = 1 / sizes[row]
    D = np.zeros((len(C), driven.shape[1]))

    def moved(changed: np.ndarray, pushed: np.ndarray) -> SystemDerivative:
        return SystemDerivative(changed, pushed, np.zeros_like(C), D)

    # the model's own parameters and the crossed magnets move Ad and Bd
    directions = []
    for of_A, of_B in zip(dAd, dBd, strict=True):
        rows = np.hstack([of_A, of_B[:, :a] @ K.C, -of_B[:, :a] @ K.D])
        pushed = of_B[:, a:]
        still = np.zeros((nk, len(closed)))
        directions.append(
            moved(
                np.vstack([rows, still, y @ rows]),
                np.vstack([pushed, np.zeros((nk, pushed.shape[1])), y @ pushed]),
            )
        )

    # the sensors' faults move the rows of s by dM C x+, a lag by -C A x+
    faults = list(crossed)
    for fault, rows in _sensor_faults(axes, y, A, K.dt):
        faults.append(fault)
        changed, pushed = np.zeros_like(closed), np.zeros_like(driven)
        changed[n + nk :], pushed[n + nk :] = rows @ on_state, rows @ on_e
        directions.append(moved(changed, pushed))

    # an excitation's own column
    for column, name in enumerate(model.excitations):
        faults.append(_gain(f"gain of {name}"))
        pushed = np.zeros_like(driven)
        pushed[:, column] = driven[:, column] / 100
        directions.append(moved(np.zeros_like(closed), pushed))
    loop = StateSpace(closed, driven, C, D, model.excitations, model.signals, K.dt)
    return FaultyLoop(loop, directions, tuple(faults))


def _sensor_faults(
    axes: Sequence[str], y: np.ndarray, A: np.ndarray, dt: float
) -> list[tuple[Fault, np.ndarray]]:
    """What the sensors may do, and per unit of it the rows (a, n) on x+ that s+ gains."""
    found = []
    for j, axis in enumerate(axes):
        only = np.zeros((len(axes), 1))
        only[j] = 1.0
        found.append((_gain(f"gain of y_{axis}"), only * y[j] / 100))

        # y(t - tau) = y - tau dy/dt, and C B = 0: forces move no place at once
        lag = Fault(f"lag of y_{axis}", "us", 1e6 * _LAG * dt, 1e6 * _MOST_LAG * dt)
        found.append((lag, only * (-1e-6 * y[j] @ A)))
    for j, k, bearing in _pairs(axes):
        turned = np.zeros((len(axes), y.shape[1]))
        turned[j], turned[k] = np.radians(1) * y[k], -np.radians(1) * y[j]
        found.append((_angle(f"sensors of {bearing} turned by"), turned))
    return found


def _gain(name: str) -> Fault:
    return Fault(name, "%", _GAIN, _MOST_GAIN)


def _angle(name: str) -> Fault:
    return Fault(name, "deg", _ANGLE, _MOST_ANGLE)


def _pairs(axes: Sequence[str]) -> list[tuple[int, int, str]]:
    """The places of zeta and eta of every bearing, and its name."""
    bearings = [axis.removesuffix("_zeta") for axis in axes if axis.endswith("_zeta")]
    return [
        (axes.index(f"{name}_zeta"), axes.index(f"{name}_eta"), name)
        for name in bearings
        if f"{name}_eta" in axes
    ]


def _crossed(
    dA: np.ndarray, dB: np.ndarray, theta: np.ndarray, paths: Sequence[str]
) -> tuple[list[Fault], np.ndarray, np.ndarray]:
    """The faults of magnets whose K_i of both axes are among ``paths``, and their directions."""
    n = dA.shape[1]
    faults = []
    found = []
    for zeta, path in enumerate(paths):
        if not (path.startswith("bearing.") and path.endswith(".force_per_current.zeta")):
            continue
        other = path.removesuffix("zeta") + "eta"
        if other not in paths:
            continue
        eta, name = paths.index(other), path.split(".")[1]

        # dK_i of an axis is b c': its force pushes along b (n,), c picks its current
        parts = [_rank_one(np.hstack([dA[i], dB[i]])) for i in (zeta, eta)]
        if None in parts:
            continue
        (b1, c1), (b2, c2) = (part for part in parts if part is not None)
        one, two = theta[zeta] * np.outer(b1, c2), theta[eta] * np.outer(b2, c1)
        faults.append(_gain(f"cross of the currents in {name}"))
        found.append((one + two) / 100)
        faults.append(_angle(f"magnets of {name} turned by"))
        found.append((one - two) * np.radians(1))
    both = np.array(found).reshape(len(found), n, n + dB.shape[2])
    return faults, both[:, :, :n], both[:, :, n:]


def _rank_one(M: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """b and c of M = b c', c of length one and with its largest entry positive; None where M is no
    such product.
    """
    u, s, v = np.linalg.svd(M)
    if not s[0] or s[1] > _RANK_ONE * s[0]:
        return None
    sign = np.sign(v[0][np.argmax(np.abs(v[0]))])
    return sign * s[0] * u[:, 0], sign * v[0]


# standard deviations of a step, below which noise may make it; assumed: of 50 suspects chance
# brings one beyond 4 in 3 of 1,000 records (2 (1 - Phi(4)) = 6.3e-5 each)
_CERTAIN = 4.0
_HARMLESS = 0.02  # of a value; assumed: less than a tolerance of a magnet's coefficients ever is
_NOT_THESE = (  # what is left once every suspect was tried in vain
    "the model lacks something that no one of delays, gains, stiffnesses, amplifier, seals and "
    "bending modes explains; "
    "likeliest first: magnets beyond their linear range, a different controller"
)
BENDING_MODES = "bending modes"
SAMPLING = "controller sampled by"
_SAMPLINGS: tuple[Method, ...] = ("backward-euler", "zoh", "matched")
# part of what the model leaves that another structure must explain to be told by the records, or
# leave over to be excluded by them; assumed: far beyond what noise makes of some thousand samples
_TELLS = 0.01
# a response over what the magnets' nonlinearity made, below which it may be the rest of that;
# assumed: loop and terms are known to less, the second order of a series
_REST = 0.2
# of a number that the machine file gives and the fit takes, one standard deviation; assumed
FILE = 0.03
# standard deviations of a value that further modes must move it by to be named; assumed: 0.3
# widens an interval by hypot(1, 0.3) = 1.04
_SEEN = 0.3
_MODES = 2  # bending modes that may be wrong; assumed: those beyond hardly show
# The longest step that still corrects a parameter, relative; one of a delay, in samples; assumed:
# beyond, the linear step is no estimate, and the machine another one
_LONGEST, _LONGEST_DELAY = 0.5, 3.0
# the same of a bending mode's damping, which no drawing gives; where the mode's frequency is far
# off, the first step damps it away
_LONGEST_DAMPING = 3.0
_TINY = 1e-300  # keeps a division by zero from a value that is zero
# part of a suspect's column that the others leave over (S_c of a scaled H), below which rounding
# makes it: no record tells it from the others
_INSEPARABLE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """One more unknown: by how much it would change (``step``, SI) and how surely (``score``
    standard deviations), which part of the residuals' energy that explains, and by how much the
    fitted values (q,) would move (``shift``, SI). unit: of the step, where ``path`` is no path of
    the machine; harmless: up to which step it is none of anybody's concern. held: noise can make
    the step; step and shift are then what the machine file's own number may be off by, and what
    that does.
    """

    path: str
    step: float
    score: float
    explains: float
    shift: np.ndarray
    unit: str = ""
    harmless: float = np.inf
    held: bool = False


def suspects(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    result: ParameterEstimate,
    options: FitOptions,
    prior: np.ndarray | None = None,
) -> tuple[Suspect, ...]:
    """The suspects that noise cannot make, the best explanation first, then those held by the file;
    none where no further unknown can be tried.

    Tried are the delays of controller and excitation, the amplifier's other parameters, gains and
    stiffnesses of bearings and couplings, the seals' coefficients and the first two bending modes,
    as far as the fit took them as known; the faults of channels and magnets (suspects.py);
    further bending modes; and other samplings of a continuous controller that nothing recorded
    checks. prior (q,): the standard deviations about ``result.start`` with which its
    values were held in the fit (None: they were free).
    """
    options = replace(options, period=None)
    otherwise = _structures(machine, records, controller, result, options, prior)
    modes = min(options.bending_modes + FURTHER_MODES, bending_modes_of_mesh(machine))
    options = replace(options, bending_modes=max(modes, options.bending_modes))
    paths = [
        path
        for path in (*TIMING, *_others(machine, options.bending_modes))
        if not _known(path, result.paths)
    ]
    timing, rest = (
        [path for path in paths if path in TIMING],
        [path for path in paths if path not in TIMING],
    )

    def scored(extra: list[str]) -> list[Suspect]:
        if not extra:
            return []
        try:
            return _scores(
                build_experiment(machine, records, controller, (*result.paths, *extra), options),
                result,
            )
        except AmbroseError:  # one of them cannot be an unknown here
            half = len(extra) // 2
            return [] if not half else scored(extra[:half]) + scored(extra[half:])

    suspected = [
        *scored(timing),
        *scored(rest),
        *_faults(machine, records, controller, result, options),
        *otherwise,
    ]
    return tuple(sorted(suspected, key=lambda item: (item.held, -item.explains)))


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """One step of Gauss and Newton (q,) from fitted values in a loop of another structure, and the
    cost that it leaves.
    """

    step: np.ndarray
    cost: float


def _trial(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    result: ParameterEstimate,
    options: FitOptions,
    prior: np.ndarray | None = None,
) -> _Trial | None:
    """d = H^-1 g (with ``prior`` by ``step_with_prior``) and the cost after it; None
    where the loop cannot be built, or shows nothing of a parameter.
    """
    try:
        experiment = build_experiment(machine, records, controller, result.paths, options)
        H, g, cost, middle = equations_at(experiment, result.values, coloured=prior is not None)
        size = np.sqrt(np.diag(H))
        if not (size > 0).all():
            return None
        if prior is None:
            # H d = g with rows and columns scaled to a diagonal of ones
            step = np.linalg.solve(H / size / size[:, None], g / size) / size
        else:
            step = step_with_prior(H, g, middle, prior, result.values - result.start)[0]
    except (AmbroseError, np.linalg.LinAlgError):
        return None
    # |r - J d|^2, which is r'r - g'd for the step of the data alone and no less with a prior's
    return _Trial(step, cost - float(2 * g @ step - step @ H @ step))


def chosen_modes(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    result: ParameterEstimate,
    options: FitOptions,
) -> int:
    """How many bending modes per plane the records tell: those of ``options``, and a few more as
    long as they explain a part of what is left (_TELLS) and move a value (_SEEN).
    """
    options = replace(options, period=None)
    fewest, most = options.bending_modes, bending_modes_of_mesh(machine)
    trials: dict[int, _Trial] = {}

    def tried(count: int) -> _Trial:
        if count not in trials:
            how = replace(options, bending_modes=count)
            found = _trial(machine, records, controller, result, how)
            nothing = _Trial(np.zeros(len(result.paths)), np.inf)
            trials[count] = nothing if found is None or np.isnan(found.cost) else found
        return trials[count]

    count = fewest
    while count < most:
        now, further = tried(count), tried(min(count + FURTHER_MODES, most))
        moved = np.abs(further.step - now.step) > _SEEN * result.standard_deviations
        if not further.cost < (1 - _TELLS) * now.cost or not moved.any():
            break
        count = min(count + FURTHER_MODES, most)
    # the last few may hold some that explain nothing
    first = max(count - max(FURTHER_MODES - 1, 0), fewest)
    return min(range(first, count + 1), key=lambda count: tried(count).cost)


def _structures(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    result: ParameterEstimate,
    options: FitOptions,
    prior: np.ndarray | None,
) -> list[Suspect]:
    """What further bending modes, and where u is not recorded another sampling of a continuous
    controller, would do to the values; those that noise hides, or that leave clearly more of the
    records than the model does, are none.
    """
    others: list[tuple[str, LawLike, FitOptions]] = []
    modes = min(options.bending_modes + FURTHER_MODES, bending_modes_of_mesh(machine))
    if modes > options.bending_modes:
        name = f"{modes} {BENDING_MODES}"
        others.append((name, controller, replace(options, bending_modes=modes)))
    others += [
        (f"{SAMPLING} {method}", law, options)
        for method, law in _other_samplings(machine, records, controller)
    ]
    own = _trial(machine, records, controller, result, options, prior) if others else None
    found = []
    for name, law, how in others if own is not None else ():
        assert own is not None
        tried = _trial(machine, records, law, result, how, prior)
        if tried is None or not tried.cost < (1 + _TELLS) * own.cost:
            continue
        if np.any(np.abs(tried.step) > _SEEN * result.standard_deviations):
            explains = max(1 - tried.cost / own.cost, 0.0)
            found.append(Suspect(name, 0.0, np.inf, explains, tried.step, held=not explains))
    return found


def _other_samplings(
    machine: Machine, records: Sequence[Record], controller: LawLike
) -> list[tuple[str, StateSpace]]:
    """A continuous controller sampled otherwise than by Tustin's map, which the model takes; none
    where every u is recorded, for it is checked then.
    """
    if all(is_checked(machine, record) for record in records):
        return []
    try:
        law = match_controller(controller, plant_at(machine, records[0].point, {}))
    except AmbroseError:
        return []
    sampled: list[tuple[str, StateSpace]] = []
    for method in _SAMPLINGS if law.dt is None else ():
        with suppress(AmbroseError):
            sampled.append((method, c2d(law, records[0].dt, method)))
    return sampled


def is_checked(machine: Machine, record: Record) -> bool:
    """Whether a record has what the controller's file is checked against: every u_<axis>."""
    return all(f"u_{axis}" in record.signals for axis in machine.axes)


def rest_of(magnets: MagneticForce | None) -> float:
    """Which part of the residuals' energy may be the rest of the magnets' nonlinearity that was
    taken out of the records.

    With E of the linear model's residuals explained by it, 1 - E is left; a response of _REST times
    its size has the energy _REST^2 E.
    """
    if magnets is None:
        return 0.0
    return _REST**2 * magnets.explains / max(1 - magnets.explains, _TINY)


def judged(
    result: ParameterEstimate, suspected: Sequence[Suspect], dt: float, rest: float = 0.0
) -> ParameterEstimate:
    """The result with intervals that hold the largest move that a suspect would make; the verdict
    names cause and effect.

    Where no value would move by more than 2 % (a delay: of a sample ``dt`` [s]) and more than its
    standard deviation, what the residuals hold is no doubt about the values: the warning goes,
    unless a fault of a channel or a magnet is as large: one step from the wrong structure does not
    tell where the values end in the right one. Nor is a doubt what explains no more than ``rest``
    of the residuals (rest_of): the interval includes it.
    """
    # what the file holds and the records hardly see: as much as it may be off, all independent
    held = np.sum([item.shift**2 for item in suspected if item.held], axis=0)
    result = result.widened(np.sqrt(result.standard_deviations**2 + held))
    suspected = [item for item in suspected if not item.held]
    if not suspected:
        if all(test.passed for test in result.tests):
            return result
        verdict = verdict_of(result.tests, result.converged, _NOT_THESE)
        findings = [
            replace(item, what=verdict) if item.code == Code.RESIDUALS else item
            for item in result.warnings
        ]
        return replace(result, verdict=verdict, warnings=tuple(findings))
    moves = np.abs([item.shift for item in suspected])
    sizes = [
        dt if path in TIMING else abs(value)
        for path, value in zip(result.paths, result.values, strict=True)
    ]
    # what noise hides is in the interval, whatever it is of a value near zero
    significant = moves > result.standard_deviations
    significant &= np.array([item.explains > rest for item in suspected])[:, None]
    relative = np.where(significant, moves / np.maximum(sizes, _TINY), 0.0)
    k = int(relative.max(axis=0).argmax())
    effect = float(relative[:, k].max())
    named = causes(suspected)
    moved = f"up to {100 * effect:.2g} % of {result.paths[k]}"
    if not effect:
        moved = "within a standard deviation of every value"
        if (moves > result.standard_deviations).any():
            moved = "no larger than the magnets' nonlinearity explains"
    lacking = (
        f"one more unknown may be missing, the likeliest first: {named}; the intervals include its "
        f"effect, {moved}"
    )
    verdict = verdict_of(result.tests, result.converged, lacking)
    warnings = [finding for finding in result.warnings if finding.code != Code.RESIDUALS]
    if effect > _HARMLESS or any(abs(item.step) > item.harmless for item in suspected):
        warnings.append(Finding(Code.RESIDUALS, WARNING, verdict))
    wider = result.widened(np.hypot(result.standard_deviations, moves.max(axis=0)))
    return replace(wider, verdict=verdict, warnings=tuple(warnings))


def explained(finding: Finding, suspected: Sequence[Suspect]) -> Finding:
    """A finding that the model misses a response, with the suspects before the causes that no
    single unknown stands for.
    """
    suspected = [item for item in suspected if not item.held]
    if finding.code != Code.MISSING_RESPONSE or not suspected:
        return finding
    return replace(
        finding,
        remedy=f"likeliest first, with the part each would explain: {causes(suspected)}; else "
        f"{finding.remedy}",
    )


def causes(suspected: Sequence[Suspect]) -> str:
    """The three suspects that explain most, the likeliest first, each with its step and the share
    of the energy it explains.
    """
    return ", ".join(
        f"{item.path} {_sized(item)} ({100 * item.explains:.2g} %)" for item in suspected[:3]
    )


def _sized(item: Suspect) -> str:
    if item.unit:
        return f"{item.step:+.3g} {item.unit}"
    if item.path.startswith(SAMPLING):
        return "instead of Tustin's rule"
    if item.path.endswith(BENDING_MODES):
        return f"instead of {int(item.path.split()[0]) - FURTHER_MODES}"
    return (
        f"{1e6 * item.step:+.3g} us"
        if item.path in TIMING
        else f"{item.step:+.3g} {unit_of(item.path)}"
    )


def file_numbers(machine: Machine, paths: Sequence[str]) -> list[str]:
    """The paths of the numbers that the machine file states and a fit of ``paths`` takes as they
    are.
    """
    return [path for path in _parts(machine) if not _known(path, paths)]


def _others(machine: Machine, bending_modes: int) -> list[str]:
    paths = _parts(machine)
    if not machine.lateral:
        return paths
    modes = range(1, 1 + min(_MODES, bending_modes, bending_modes_of_mesh(machine)))
    return paths + [
        f"rotor.{BENDING}{k}.{quantity}" for k in modes for quantity in ("frequency", "damping")
    ]


def _parts(machine: Machine) -> list[str]:
    paths = [f"amplifier.{name}" for name in AMPLIFIER_PARAMETERS[machine.amplifier.order]]
    paths += machine.magnet_paths
    paths += [
        f"coupling.{item.name}.stiffness.{axis}"
        for item in machine.couplings
        for axis in ("zeta", "eta")
    ]
    plain = [item for item in machine.seals if item.geometry is None and item.table is None]
    return paths + [f"seal.{item.name}.{letter}" for item in plain for letter in "kKCc"]


def _known(path: str, paths: Sequence[str]) -> bool:
    return path in paths or any(
        path not in TIMING
        and other not in TIMING
        and parse_parameter(path).overlaps(parse_parameter(other))
        for other in paths
    )


def equations_at(
    experiment: Experiment,
    theta: np.ndarray,
    coloured: bool = False,
    loops: Sequence[Loop] | None = None,
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """J'J (q, q), J'r (q,), r'r at theta (q,), and, ``coloured``, the covariance of J'r (q, q)
    under the colour of the residuals (otherwise zeros): the middle of the sandwich H^-1 cov H^-1.
    loops: of the experiment's models (None: as they are), with more directions perhaps.
    """
    if loops is None:
        loops = LeastSquares(experiment, normal_equations).loops(theta)
    count = len(loops[0][1])
    H = np.zeros((count, count))
    middle = np.zeros((count, count))
    g = np.zeros(count)
    cost = 0.0
    for task in experiment.tasks:
        loop, directions = loops[task.place]
        task = synchronised(loop, task)  # noqa: PLW2901
        part = normal_equations(loop, directions, task)
        if coloured:
            covariance = residual_scores(
                loop, task, part, ["e"] * len(task.e), experiment.signals, 1
            ).covariance
            middle += coloured_products(jacobian_pieces(loop, directions, task, part), covariance)
        H = H + part.equations.H
        g = g + part.equations.g
        cost = cost + part.equations.cost
    return H, g, cost, middle


def _scores(experiment: Experiment, result: ParameterEstimate) -> list[Suspect]:
    theta, positions = (
        experiment.nominal.copy(),
        [experiment.paths.index(path) for path in result.paths],
    )
    theta[positions] = result.values
    H, g, cost, middle = equations_at(experiment, theta, coloured=True)
    scores = []
    for c, path in enumerate(experiment.paths):
        if c in positions:
            continue
        most = (
            _LONGEST_DELAY
            if path in TIMING
            else _LONGEST_DAMPING
            if path.startswith("rotor.") and path.endswith("damping")
            else _LONGEST
        ) * max(experiment.scale[c], abs(theta[c]))
        held = 0.0 if path in TIMING or path.startswith("rotor.") else FILE * abs(theta[c])
        what = Fault(path, "", np.inf, most)
        scores.append(_score(H, g, cost, middle, positions, c, what, held))
    return [item for item in scores if item is not None]


def _faults(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    result: ParameterEstimate,
    options: FitOptions,
) -> list[Suspect]:
    """The faults of channels and magnets that noise cannot make; none where the delay is no whole
    number of samples, or where other signals than displacements were fitted.
    """
    try:
        experiment = build_experiment(machine, records, controller, result.paths, options)
    except AmbroseError:
        return []
    models = [model for model in experiment.models if isinstance(model, LoopModel)]
    displacements = all(name.startswith("y_") for name in experiment.signals)
    if len(models) < len(experiment.models) or not displacements:
        return []
    q = len(result.paths)
    tried = [
        faulty_loop(model, np.asarray(result.values), experiment.paths, experiment.sizes)
        for model in models
    ]
    loops = [(item.loop, item.directions) for item in tried]
    H, g, cost, middle = equations_at(experiment, result.values, coloured=True, loops=loops)
    scores = [
        _score(H, g, cost, middle, list(range(q)), c, one)
        for c, one in enumerate(tried[0].faults, q)
    ]
    return [item for item in scores if item is not None]


def _score(
    H: np.ndarray,
    g: np.ndarray,
    cost: float,
    middle: np.ndarray,
    positions: list[int],
    c: int,
    what: Fault,
    held: float = 0.0,
) -> Suspect | None:
    """The unknown at place ``c`` beside those at ``positions``; where noise can make it None, or,
    where its number is known to ``held``, what that does.

    H (n, n), g (n,), cost: J'J, J'r and r'r of all unknowns; middle (n, n): covariance of J'r.
    held [unit of the unknown]: standard deviation of the machine file's own number; 0: none.
    """
    # every unknown in units of 1/sqrt(H_ii), so that H has a diagonal of ones
    size = np.sqrt(np.maximum(np.diag(H), _TINY))
    H = H / size / size[:, None]
    g = g / size
    middle = middle / size / size[:, None]

    # x = H_pp^-1 H_pc, S_c = H_cc - H_cp x (``left``), g_c less what the others explain (``slope``)
    x = np.linalg.solve(H[np.ix_(positions, positions)], H[positions, c])
    left, slope = H[c, c] - H[c, positions] @ x, g[c] - g[positions] @ x
    if left <= _INSEPARABLE and not held:
        return None
    left = max(float(left), 0.0)

    # slope = (-x, 1)' g, its variance (-x, 1)' middle (-x, 1); d = slope/S_c
    weights = np.append(-x, 1.0)
    spread = float(weights @ middle[np.ix_([*positions, c], [*positions, c])] @ weights)
    step, score = slope / max(left, _INSEPARABLE), abs(slope) / np.sqrt(max(spread, _TINY))
    if held and (score <= _CERTAIN or left <= _INSEPARABLE):
        # known by the file to ``held``, by the records to sqrt(spread) / left: both together, about
        # a middle that leaves the file's number by the records' part of the step
        by_file, by_records = 1 / (held * size[c]), left / np.sqrt(max(spread, _TINY))
        known = 1 / np.hypot(by_file, by_records)
        middle_off = step * (known * by_records) ** 2
        moved = -x * np.hypot(known, middle_off) / size[positions]
        return Suspect(what.name, known / size[c], float(score), 0.0, moved, held=True)
    if score <= _CERTAIN or abs(step) / size[c] >= what.most:
        return None
    # the fitted values follow by -H_pp^-1 H_pc d, the cost falls by slope^2/S_c
    shift = -x * step / size[positions]
    explains = float(slope**2 / left / cost)
    own = step / size[c]
    return Suspect(what.name, own, float(score), explains, shift, what.unit, what.harmless)
