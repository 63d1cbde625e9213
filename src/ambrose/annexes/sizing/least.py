"""The least that still guarantees all that is asked: control action, bias, magnet, amplifier; and
what robustness costs.

Lauridsen 2017, 7.3: synthesis "can be used to find the minimum control action required to guarantee
robust performance". Control action is taken as the largest gain of K S_o [A/m] over all
frequencies: what a micrometre of motion costs in current.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    check_positive,
    invalid,
    names_wrong_types,
)
from ambrose.core.presentation import Presented, data_frame
from ambrose.core.statespace import StateSpace
from ambrose.judge.loop_response import beyond_reach, unavoidable_sensitivity
from ambrose.judge.plants import envelope_of
from ambrose.judge.result import INTERRUPTED, Synthesis
from ambrose.judge.unbalance import capacity_margin
from ambrose.law.pid import first_settings, pid_controller
from ambrose.machine.criteria import SENSITIVITY, demand
from ambrose.machine.description import Amplifier, MagneticBearing, Tolerance
from ambrose.machine.machine import Machine, require_magnets
from ambrose.model.assemble import assemble
from ambrose.model.effects import magnet
from ambrose.model.effects.magnet import LoadedMagnet
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.magnetics import VACUUM_PERMEABILITY
from ambrose.model.plant import top_speed
from ambrose.model.static_load import operating_magnets, static_sag
from ambrose.synthesis.design import design
from ambrose.synthesis.fixed_order.job import Job, Law, first_law, prepare, with_states
from ambrose.synthesis.fixed_order.tuning import AGAIN, tuned
from ambrose.synthesis.methods import Mu, Tuned
from ambrose.synthesis.trade_off import lowest

# A machine with magnets of another size and bias current, and what those cost beside the machine
# file's own.
#
# A magnet grows along the shaft: pole area, volume and inductance with it, gap, turns, pole width
# and amplifier bandwidth stay (assumed). Its force follows from the magnet that the machine file
# states, iron included; where no iron is given the flux density may not rise above that of the
# machine file at its largest current, which somebody chose.


SIZES = "the sizes are those of radial magnets and of all amplifiers"
# over the machine file's: steps of about sqrt(2), in which inductance L ~ N^2 doubles
TURNS = (0.5, 0.7, 1.0, 1.4, 2.0)
_NOTHING = 1e-6  # of the largest control current: what is left where the static load takes it all


@dataclass(frozen=True, slots=True, order=True)
class Size:
    """Pole area, bias current and amplifier bandwidth, each over the machine file's."""

    area: float = 1.0
    bias: float = 1.0
    bandwidth: float = 1.0

    def __post_init__(self) -> None:
        for name in ("area", "bias", "bandwidth"):
            check_positive(getattr(self, name), name, "give it as a share of the machine file's")


@dataclass(frozen=True, slots=True)
class Costs:
    """Over the machine file's: copper loss of all coils, volt-amperes of the amplifiers, volume of
    the magnets. reserve [-]: the least force of a magnet at its largest control current over the
    static load that it carries; inf without weight.
    """

    copper_loss: float
    volt_amperes: float
    volume: float
    reserve: float


@dataclass(frozen=True, slots=True)
class Drive:
    """turns over the machine file's; bias and largest control current [A], inductance of a coil
    [H]; voltage [V] that the largest control current takes as a sine at top speed, or at the
    suspension's sqrt(sum k_s / m) where that is higher. Flux, force and loop stay; the controller's
    gains go with 1/turns.
    """

    turns: float
    bias_current: float
    current: float
    inductance: float
    voltage: float


def resized(machine: Machine, size: Size) -> Machine:
    """The machine with magnets and amplifiers of a size; the largest control current keeps its
    share of the bias, and what the static load takes of it is taken off. Its reference controller
    keeps the stiffness K_p k_i / k_s. Raises InvalidInput where no magnet follows from the machine
    file's coefficients.
    """
    # magnets of the size, then the currents that hold the static load in them
    by_file = operating_magnets(machine)
    bearings = tuple(
        _bearing(b, item.of_force, size) for b, item in zip(machine.bearings, by_file, strict=True)
    )
    sized = replace(machine, bearings=bearings, amplifier=_amplifier(machine.amplifier, size))
    magnets = operating_magnets(sized)
    free = []
    for bearing, item in zip(bearings, magnets, strict=True):
        # what the static load leaves of the largest control current, kept positive
        most = _most(bearing, machine.requirements.max_current)
        free.append(
            replace(
                bearing, max_current=max(most - float(np.abs(item.currents).max()), _NOTHING * most)
            )
        )

    # K_p k_i/k_s is kept: gains in the proportion of k_s/k_i, axis by axis, else by the mean
    settings = machine.reference or first_settings(machine)
    factors = np.concatenate(
        [need(after) / need(before) for before, after in zip(by_file, magnets, strict=True)]
    )
    controller = settings
    if settings.gain:  # chains of filters have their gains in their channels, and begin as they are
        gains = (
            settings.gain
            if len(settings.gain) == len(factors)
            else np.full(len(settings.gain), settings.gain[0])
        )
        of_gains = (
            factors
            if len(settings.gain) == len(factors)
            else np.full(len(settings.gain), factors.mean())
        )
        controller = replace(settings, gain=tuple((np.array(gains) * of_gains).tolist()))
    return replace(
        sized,
        bearings=tuple(free),
        controller=controller,
        requirements=replace(machine.requirements, max_current=None),
    )


def costs(machine: Machine, size: Size) -> Costs:
    """What magnets and amplifiers of a size cost, over those of the machine file."""
    sized = replace(
        machine,
        bearings=tuple(
            _bearing(b, item.of_force, size)
            for b, item in zip(machine.bearings, operating_magnets(machine), strict=True)
        ),
    )

    # resistive loss: all coil currents squared, times the length of a turn
    loss = [_squares(item) for item in (sized, machine)]

    # reserve: force at the largest control current over the weight along each axis, the
    # least of all
    weight = np.abs(static_sag(machine)[1])
    reserve = np.inf
    for bearing, item, load in zip(sized.bearings, operating_magnets(sized), weight, strict=True):
        most = _most(bearing)
        if item.parameters is None:
            reserve = 0.0
        elif load.max() > 0:
            force = [
                magnet.force(most, 0.0, 0.0, 0.0, item.parameters)[0],
                magnet.force(0.0, most, 0.0, 0.0, item.parameters)[1],
            ]
            reserve = min(reserve, float((np.array(force)[load > 0] / load[load > 0]).min()))
    # a square pole at the machine file's size (assumed), two of whose sides grow
    turn = (1 + size.area) / 2
    return Costs(
        loss[0] / loss[1] * turn, size.area * size.bias**2 * size.bandwidth, size.area, reserve
    )


def drives(machine: Machine, size: Size, turns: Sequence[float] = TURNS) -> tuple[Drive, ...]:
    """What the amplifiers must give for magnets of a size, for every number of turns over the
    machine file's.

    A coil's inductance is the machine file's; where it states none, that of the air gaps alone
    (assumed: no leakage), mu_0 N^2 A/(2 g) of a geometry, else k_i^2/(2 k_s), which is the same but
    for the poles' angle. The bearing that needs the highest voltage speaks for all.
    """
    magnets = [
        _bearing(b, item.of_force, size)
        for b, item in zip(machine.bearings, operating_magnets(machine), strict=True)
    ]
    slopes = [magnet.linearised(bearing) for bearing in magnets]

    # the frequency of the sine [rad/s]: top speed, or sqrt(sum k_s/m)
    stiffness = sum(max(item.negative_stiffness) for item in slopes)
    mass = mass_properties(finite_element_rotor(machine)).mass
    rate, needs = max(top_speed(machine), (stiffness / mass) ** 0.5), []
    for bearing, here in zip(magnets, slopes, strict=True):
        k_i = max(here.force_per_current)
        k_s = max(here.negative_stiffness)
        of = bearing.geometry

        # L with the turns of the machine file
        if machine.amplifier.inductance is not None:
            L = size.area * machine.amplifier.inductance
        elif of is not None:
            L = VACUUM_PERMEABILITY * of.turns**2 * of.pole_area / (2 * of.gap)
        else:
            L = k_i**2 / (2 * k_s) if k_s > 0 else 0.0
        needs.append((rate * L * _most(bearing), _most(bearing), bearing.bias_current, L))

    # n times the turns at the same flux: currents by 1/n, L by n^2, voltage w L i by n
    voltage, current, bias, inductance = max(needs)
    return tuple(Drive(n, bias / n, current / n, n**2 * inductance, n * voltage) for n in turns)


def flux_within(machine: Machine, size: Size) -> bool:
    """Whether the iron carries the flux: that of the machine file says so itself, else no more than
    the file's.
    """
    return size.bias <= 1 + 1e-9 or all(bearing.iron is not None for bearing in machine.bearings)


def _bearing(bearing: MagneticBearing, p: tuple[float, ...], size: Size) -> MagneticBearing:
    """A bearing whose magnet, ``magnet.parameters`` p, has another size: a force limit goes with
    the area, a current limit with the bias.
    """
    bias, area = size.bias * p[0], size.area
    here = magnet.of_size(p, bias, area)
    return replace(
        bearing,
        bias_current=bias,
        coefficients_at="no-load",
        measured=(),
        magnet=None,
        geometry=bearing.geometry
        and replace(bearing.geometry, pole_area=area * bearing.geometry.pole_area),
        force_per_current=here.force_per_current,
        negative_stiffness=here.negative_stiffness,
        max_current=None if bearing.max_current is None else size.bias * bearing.max_current,
        max_force=None if bearing.max_force is None else area * bearing.max_force,
    )


def _amplifier(by_file: Amplifier, size: Size) -> Amplifier:
    """The amplifier with its rates times the bandwidth's share; a coil's inductance goes with the
    area.
    """
    rates = {
        name: size.bandwidth * value
        for name in ("bandwidth", "natural_frequency", "damping")
        if (value := getattr(by_file, name)) is not None
    }
    inductance = None if by_file.inductance is None else size.area * by_file.inductance
    return replace(by_file, **rates, inductance=inductance)


def _most(bearing: MagneticBearing, wanted: float | None = None) -> float:
    """The largest control current [A] of a bearing, where none is stated the bias current; not
    above what is wanted.
    """
    most = bearing.bias_current if bearing.max_current is None else bearing.max_current
    return most if wanted is None else min(most, wanted)


def need(item: LoadedMagnet) -> np.ndarray:
    """The gain k_s/k_i (2,) [A/m] that holds the rotor at all."""
    return np.divide(item.coefficients.negative_stiffness, item.coefficients.force_per_current)


def _squares(machine: Machine) -> float:
    """The squares of all coil currents [A2]: two of an axis, i_0 + i and i_0 - i."""
    magnets = zip(machine.bearings, operating_magnets(machine), strict=True)
    return float(
        sum(4 * b.bias_current**2 + 2 * np.square(item.currents).sum() for b, item in magnets)
    )


# Whether a size can be held to all that is asked: limits that no controller passes first, then a
# controller tuned to it.


CAPACITY = "load capacity"
RESERVE = 2.0  # of force over static load: two to three are usual; assumed


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A size and what became of it. ratio: the largest of all requirements over their limits, on
    the full plants at all operating points and on the worst corners found of the tolerances; at
    most 1 where all are met (inf: nothing was tuned). binding: what stands against a smaller one,
    or against this one. ratios {requirement: over its limit}; sensitivity [-] and gain [A/m] of K
    S_o that were reached; capacity: the least margin of what unbalance and loads leave, of the
    ``demand`` named; controller None where none was tuned.
    """

    size: Size
    machine: Machine
    costs: Costs
    ratio: float
    binding: str
    ratios: dict[str, float] = field(default_factory=dict)
    sensitivity: float = float("inf")
    gain: float = float("inf")
    capacity: float = float("inf")
    demand: str = ""
    synthesis: Synthesis | None = None

    @property
    def met(self) -> bool:
        return self.ratio <= 1.0

    @property
    def controller(self) -> StateSpace | None:
        return None if self.synthesis is None else self.synthesis.controller


def tuning_job(
    machine: Machine, method: Tuned, time_limit: float, order: int | None = None
) -> tuple[Job, Law]:
    """What is tuned for a machine at all its operating points, and what to begin with; its order
    does not grow.
    """
    start = pid_controller(machine.reference or first_settings(machine), machine)
    plants = envelope_of(assemble(machine, machine.operation.design))
    states = method.order if order is None else order
    job = prepare(
        plants,
        start,
        method.timing(),
        states,
        method.structure,
        method.bending_modes,
        None,
        time_limit,
        None,
    )
    job.most_states = None
    return job, first_law(job, start, states, method.structure)


def attempt(
    machine: Machine,
    size: Size,
    method: Tuned,
    *,
    reserve: float = RESERVE,
    near: Trial | None = None,
    time_limit: float = 30.0,
    progress: Callable[[str], None] = lambda text: None,
) -> Trial:
    """Try a size of the machine's magnets and amplifiers. near: a trial whose controller is begun
    with; where that does not lead to one that meets all, the reference controller is.

    reserve [-]: force at the largest control current over static load, at least. time_limit [s] of
    computing. Raises InvalidInput where the machine file has no magnets to scale,
    KeyboardInterrupt.
    """
    price = costs(machine, size)
    sized = resized(machine, size)
    words = _screened(machine, sized, size, price, method, reserve)
    if words:
        return Trial(size, sized, price, float("inf"), words)

    # the neighbour's controller first; the reference where that does not meet all
    best = Trial(size, sized, price, float("inf"), "no controller was found")
    for start in (near, None) if near is not None else (None,):
        trial = _tuned(best, method, start, time_limit)
        if trial.ratio < best.ratio or best.synthesis is None:
            best = trial
        if best.met:
            break
    progress(
        f"{size.area:.3g} of the area, {size.bias:.3g} of the bias: {best.binding} at "
        f"{best.ratio:.3g} of its limit"
    )
    return best


def _tuned(before: Trial, method: Tuned, near: Trial | None, time_limit: float) -> Trial:
    """The trial with a controller, tuned from a neighbour's, or from the reference controller."""
    machine = before.machine
    try:
        job, law = tuning_job(machine, method, time_limit)
        synthesis = tuned(
            job,
            law if near is None else _scaled(near, machine),
            method.structure,
            again=0 if near is None else AGAIN,
        )
    except NumericalFailure as error:
        return replace(before, binding=f"no controller was found: {error}")
    if synthesis.stopped_early == INTERRUPTED:
        raise KeyboardInterrupt

    # unbalance and loads over what bias, current, force and voltage leave
    timing = method.timing(machine)
    margin, words = capacity_margin(machine, synthesis.controller, timing, weight_taken=True)

    # what binds: the largest ratio of a value to its limit
    ratios = synthesis.ratios
    if np.isfinite(margin):
        ratios[CAPACITY] = 1 / margin if margin else float("inf")
    binding = max(ratios, key=lambda name: ratios[name])
    return replace(
        before,
        ratio=ratios[binding],
        binding=binding,
        ratios=ratios,
        capacity=margin,
        demand=words,
        synthesis=synthesis,
        sensitivity=ratios["sensitivity"] * job.aims.sensitivity,
        gain=synthesis.certificate.margins["ratio_gain"] * job.aims.gain,
    )


def _screened(
    machine: Machine, sized: Machine, size: Size, price: Costs, method: Tuned, reserve: float
) -> str:
    """Why no controller can hold a machine ``sized`` as it is; "" where one may."""
    if not flux_within(machine, size):
        return (
            "flux density: the machine file states no iron, and its own largest current is passed"
        )
    if any(item.doubt for item in operating_magnets(sized)) or price.reserve < reserve:
        return (
            f"static load: the force at the largest current is {price.reserve:.3g} times it, "
            f"required {reserve:.3g}"
        )

    # the sensitivity that no controller avoids, given the unstable poles and the delay
    limit = (
        demand("maximum singular value of a sensitivity", sized.requirements).limit
        or SENSITIVITY.limits[0].value
    )
    try:
        return beyond_reach(
            *unavoidable_sensitivity(assemble(sized, sized.operation.design), method.timing(sized)),
            limit,
        )
    except (InvalidInput, NumericalFailure) as error:
        return str(error)


def _scaled(near: Trial, sized: Machine) -> StateSpace:
    """A neighbour's controller for another size: with the gain that gives the same force per
    displacement, over what the magnets need.
    """
    # K_p k_i/k_s is kept: the gain by the mean k_s/k_i after over before
    before, after = (
        np.mean([need(item) for item in operating_magnets(machine)])
        for machine in (near.machine, sized)
    )
    K = near.controller
    assert K is not None
    return StateSpace(K.A, K.B, after / before * K.C, after / before * K.D, K.inputs, K.outputs)


LEVERS = ("gain", "weight", "area", "bias", "bandwidth")
# The search goes down by _STEP at a time until a size fails, then bisects to a ratio of _CLOSE
# between what fails and what does; nothing below _LOWEST of the file's is tried. Assumed.
_STEP = 0.7
_CLOSE = 1.05
_LOWEST = 0.02
_AIMS = 8  # levels of gain that a tuned controller is asked for in turn; assumed
_PER_AXIS = (3, 4)  # states of the controllers that a gain is searched with
_BISECTED = "bisection over the weight; mu as D-K iteration with scalings of first order bounds it"
_BEGUN = ("the best with fewer",)  # starts that were tuned before


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Least(Presented):
    """The least of a lever that met all, what bound there, and the trials on the way.

    value: gain [A/m] of K S_o, or a share of the machine file's; inf where nothing met all (of the
    weight, which is as large as may be: 0). refused: the next one that was tried and did not (0:
    none). synthesis: the controller; None without one. searched: what the search went over, for it
    is the least of that alone.
    """

    _FACTS: ClassVar = (
        "lever",
        "least=value",
        "next smaller that failed=refused",
        "binding",
        "searched",
    )

    lever: str
    value: float
    refused: float
    binding: str
    synthesis: Synthesis | None = None
    machine: Machine | None = None
    searched: str = ""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Price(Presented):
    """What a tolerance costs: the least of a lever at every width of it."""

    parameter: str
    widths: tuple[float, ...]
    found: tuple[Least, ...]

    def facts(self) -> Mapping[str, Any]:
        rows = zip(self.widths, self.found, strict=True)
        return {
            "parameter": self.parameter,
            "least": [f"+-{100 * w:.3g} %: {item.value:.4g}" for w, item in rows],
        }

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row for each width."""
        columns = {
            "width": self.widths,
            "least": [f.value for f in self.found],
            "binding": [f.binding for f in self.found],
        }
        return data_frame(columns)


@names_wrong_types
def least(
    machine: Machine,
    lever: str = "gain",
    method: Tuned | None = None,
    *,
    reserve: float = RESERVE,
    time_limit: float = 30.0,
    progress: Callable[[str], None] = lambda text: None,
) -> Least:
    """The least of a lever with which a controller of fixed order meets every requirement of the
    machine file.

    lever: "gain" (of K S_o), or "area" of the magnets' poles, "bias" current or amplifier
    "bandwidth" as shares of the machine file's. What "meets" covers: ``map.size``. Smaller ones may
    exist: it is the smallest of what was searched, which ``Least.searched`` says. "gain" is
    searched at the method's order, without one at three and four states per axis, from the
    reference controller and, with more states, from the best with fewer. "weight" asks in the
    thesis' own terms: the largest factor on [weights] control_level at which mu of the design at
    its point is proved to be at most 1, so that performance is robust on the design model. Raises
    InvalidInput.
    """
    require_magnets(machine)
    method = (method or Tuned()).without_bank().on(machine)
    if lever not in LEVERS:
        raise invalid(
            "lever",
            repr(lever),
            f"one of {', '.join(LEVERS)}",
            "gain is the thesis' minimum control action",
        )
    if lever in {"area", "bias", "bandwidth"}:
        machine.across_the_shaft(SIZES)
    if lever == "gain":
        return _least_gain(machine, method, time_limit, progress)
    if lever == "weight":
        return _heaviest(machine, method, progress)
    return _stepped(machine, lever, method, reserve, time_limit, progress)


def _least_gain(
    machine: Machine, method: Tuned, time_limit: float, progress: Callable[[str], None]
) -> Least:
    """The least gain over orders and starts: a descent ends in the minimum next to its start, and
    more states reach a lower one.
    """
    axes = len(machine.axes)
    orders = _PER_AXIS if method.order is None else (method.order / axes,)
    # gain [A/m], whether all is met with it, what binds, the controller
    best: tuple[float, bool, str, Synthesis | None] = (float("inf"), False, "", None)
    searched: list[str] = []
    for order in (round(axes * states) for states in orders):
        # from the reference, then from the best so far with states that act weakly at first
        job, law = tuning_job(machine, method, time_limit, order)
        starts = [(job, law, "the reference controller")]
        if best[3] is not None and best[3].controller.n_states < order:
            job, _ = tuning_job(machine, method, time_limit, order)
            more = order - best[3].controller.n_states
            grown = with_states(best[3].controller, more, job.groups)
            job.aims = replace(job.aims, gain=best[0])
            starts.append((job, grown, "the best with fewer"))
        for job, law, start in starts:
            progress(f"{order} states, from {start}")
            here = lowest(
                job, law, method.structure, start in _BEGUN, time_limit, progress, "gain", _AIMS
            )
            searched.append(f"{order} states from {start}")
            if not searched[:-1] or (not here[1], here[0]) < (not best[1], best[0]):
                best = here
    value, met, binding, synthesis = best
    return Least(
        "gain",
        value if met else float("inf"),
        0.0,
        binding,
        synthesis,
        machine,
        ", ".join(searched),
    )


def _heaviest(machine: Machine, method: Tuned, progress: Callable[[str], None]) -> Least:
    """Bisection over the control weight of mu designs; mu grows with it."""
    weights = machine.weights
    if weights is None or weights.control_level is None or not machine.tolerances:
        needs = machine.in_file("[weights] with control_level, and a [[tolerance]]")
        raise InvalidInput(f"lever weight needs {needs}; add them, or take lever gain")
    designs: dict[float, Synthesis] = {}
    mu_method = Mu(
        rate=method.rate,
        delay_samples=method.delay_samples,
        bending_modes=method.bending_modes,
        match_reference=False,
    )

    def mu(factor: float) -> float:
        level = factor * weights.control_level
        plant = assemble(
            replace(machine, weights=replace(weights, control_level=level)),
            machine.operation.design,
        )
        designs[factor] = design(plant, mu_method)
        progress(f"{factor:.3g} of control_level: mu {designs[factor].gamma:.4g}")
        return designs[factor].gamma

    low = high = 1.0

    # mu(low) <= 1 < mu(high): halved down while mu is above 1, else doubled up while it is not
    while mu(low) > 1 and low > _LOWEST:
        high, low = low, low / 2
    while low == high and low < 1 / _LOWEST:
        low, high = (2 * low, 2 * low) if mu(2 * low) <= 1 else (low, 2 * low)
    if designs[low].gamma > 1:
        return Least("weight", 0.0, low, "mu", machine=machine, searched=_BISECTED)

    # the largest that is tried met it as well: none failed
    if low == high:
        return Least("weight", low, 0.0, "the largest that is tried", designs[low], machine)

    # bisection in the logarithm
    while high / low > _CLOSE:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if mu(middle) <= 1 else (low, middle)
    return Least("weight", low, high, "mu", designs[low], machine, _BISECTED)


def _stepped(
    machine: Machine,
    lever: str,
    method: Tuned,
    reserve: float,
    time_limit: float,
    progress: Callable[[str], None],
) -> Least:
    """The least share of area, bias or bandwidth: down by steps until one fails, then bisection;
    each size begins with the controller of the next larger one that met all.
    """
    best: Trial | None = None
    tried: list[Trial] = []

    def meets(share: float) -> bool:
        nonlocal best
        size = replace(Size(), **{lever: share})
        trial = attempt(
            machine,
            size,
            method,
            reserve=reserve,
            near=best,
            time_limit=time_limit,
            progress=progress,
        )
        tried.append(trial)
        if trial.met:
            best = trial
        return trial.met

    # share: the least that met all; low: the largest that failed (0: none did)
    share, low = 1.0, 0.0
    searched = (
        f"{3 * len(machine.axes) if method.order is None else method.order} states, from the "
        "reference controller and from the next larger size's"
    )
    if not meets(share):
        return Least(lever, float("inf"), share, tried[-1].binding, searched=searched)

    # down in steps of _STEP, then bisection in the logarithm
    while share > _LOWEST:
        if not meets(share * _STEP):
            low = share * _STEP
            break
        share *= _STEP
    while low and share / low > _CLOSE:
        middle = (share * low) ** 0.5
        if meets(middle):
            share = middle
        else:
            low = middle
    assert best is not None

    # what bound at the size that failed
    failed = [trial.binding for trial in tried if getattr(trial.size, lever) == low]
    return Least(
        lever,
        share,
        low,
        failed[0] if failed else best.binding,
        best.synthesis,
        best.machine,
        searched,
    )


@names_wrong_types
def price(
    machine: Machine,
    parameter: str,
    widths: Sequence[float],
    lever: str = "gain",
    method: Tuned | None = None,
    *,
    reserve: float = RESERVE,
    time_limit: float = 30.0,
    progress: Callable[[str], None] = lambda text: None,
) -> Price:
    """The ``least`` of a lever at every width (share of the value) of one tolerance, the others as
    in the machine file.

    Where a wider range was held with less, that controller and its value stand for the narrower one
    as well. Ctrl-C keeps the widths that are done. Raises InvalidInput.
    """
    if not len(widths):
        raise InvalidInput(
            "no widths of the tolerance were given; give shares of its value, such as 0.5 and 1"
        )

    # from the narrowest to the widest, each as a relative tolerance
    wanted = sorted({check_positive(width, "a width", "1 is +-100 %") for width in widths})
    others = tuple(item for item in machine.tolerances if item.parameter != parameter)
    stated = next(
        (item for item in machine.tolerances if item.parameter == parameter),
        Tolerance(parameter, relative=1.0),
    )
    minima: list[Least] = []
    sign = -1 if lever == "weight" else 1
    try:
        for width in wanted:
            progress(f"{parameter} +-{100 * width:.3g} %")
            widened = replace(
                machine, tolerances=(*others, replace(stated, absolute=None, relative=width))
            )
            minima.append(
                least(
                    widened,
                    lever,
                    method,
                    reserve=reserve,
                    time_limit=time_limit,
                    progress=progress,
                )
            )
    except KeyboardInterrupt:
        if not minima:
            raise

    # what holds a wider range holds a narrower one: from the widest down the better
    # of the two stays
    for i in range(len(minima) - 2, -1, -1):
        if sign * minima[i + 1].value < sign * minima[i].value:
            minima[i] = minima[i + 1]
    return Price(parameter, tuple(wanted[: len(minima)]), tuple(minima))


# Magnets over pole area and bias current: which sizes guarantee what is asked, what binds, which is
# the one to take.


# over the machine file's, each step about sqrt(2): pole areas down to an eighth, bias currents
AREAS, BIASES = (0.12, 0.18, 0.25, 0.35, 0.5, 0.7, 1.0), (0.5, 0.7, 1.0)
_MOST = 400  # cells


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sizing(Presented):
    """Every size that was tried, by area and bias; reserve: of force over static load, that was
    asked.
    """

    machine: Machine
    trials: tuple[Trial, ...]
    reserve: float

    @property
    def front(self) -> tuple[Trial, ...]:
        """Those that meet all and of which no other has both less volume and less copper loss, the
        smallest magnet first.
        """
        met = sorted(
            (t for t in self.trials if t.met), key=lambda t: (t.costs.volume, t.costs.copper_loss)
        )

        # by rising volume: a size is on the front where its loss is below all before it
        kept: list[Trial] = []
        for trial in met:
            if not kept or trial.costs.copper_loss < kept[-1].costs.copper_loss - 1e-12:
                kept.append(trial)
        return tuple(kept)

    @property
    def knee(self) -> Trial | None:
        """Of the front the one with the least product of volume and copper loss."""
        return min(self.front, key=lambda t: t.costs.volume * t.costs.copper_loss, default=None)

    @property
    def smaller(self) -> tuple[Trial, ...]:
        """What stands one step below the knee: the next smaller magnet, and the next lower bias."""
        knee = self.knee
        if knee is None:
            return ()
        areas = [
            t for t in self.trials if t.size.bias == knee.size.bias and t.size.area < knee.size.area
        ]
        biases = [
            t for t in self.trials if t.size.area == knee.size.area and t.size.bias < knee.size.bias
        ]
        return tuple(
            max(some, key=lambda t: (t.size.area, t.size.bias)) for some in (areas, biases) if some
        )

    @property
    def at_edge(self) -> bool:
        """Whether nothing smaller than the knee was tried, in area or in bias."""
        sizes, knee = [t.size for t in self.trials], self.knee
        return knee is not None and (
            knee.size.area == min(s.area for s in sizes)
            or knee.size.bias == min(s.bias for s in sizes) < max(s.bias for s in sizes)
        )

    def facts(self) -> Mapping[str, Any]:
        """How many sizes meet all, and the knee."""
        knee = self.knee
        meeting = f"{sum(t.met for t in self.trials)} of {len(self.trials)}"
        if knee is None:
            return {"sizes_that_meet_all": meeting, "knee": "none"}
        return {
            "sizes_that_meet_all": meeting,
            "knee": f"{knee.size.area:.3g} of the area at {knee.size.bias:.3g} of the bias",
            "copper_loss": knee.costs.copper_loss,
            "volt_amperes": knee.costs.volt_amperes,
        }

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row for each size."""
        rows = [
            (
                t.size.area,
                t.size.bias,
                t.met,
                t.ratio,
                t.sensitivity,
                t.gain,
                t.costs.copper_loss,
                t.costs.volt_amperes,
                t.costs.reserve,
                t.binding,
            )
            for t in self.trials
        ]
        names = (
            "area",
            "bias",
            "met",
            "ratio",
            "sensitivity",
            "gain [A/m]",
            "copper loss",
            "volt-amperes",
            "reserve",
            "binding",
        )
        return data_frame(dict(zip(names, zip(*rows, strict=True), strict=True)))


@names_wrong_types
def size(
    machine: Machine,
    areas: Sequence[float] = AREAS,
    biases: Sequence[float] = BIASES,
    method: Tuned | None = None,
    *,
    reserve: float = RESERVE,
    time_limit: float = 30.0,
    progress: Callable[[str], None] = lambda text: None,
) -> Sizing:
    """Try every pole area with every bias current, both over the machine file's.

    A size counts as sufficient where a controller of fixed order meets every requirement of the
    machine file at every operating point on the full plants, as the loop runs, and at the worst
    corners found of the tolerances around each; that none was found is no proof that there is none.
    reserve [-]: force at the largest control current over static load, at least. time_limit [s] of
    computing for each. Ctrl-C keeps the sizes that are done. Raises InvalidInput.
    """
    machine.across_the_shaft(SIZES)
    require_magnets(machine)
    method = (method or Tuned()).without_bank().on(machine)
    check_positive(
        reserve,
        "reserve",
        "2 is usual: as much force again as the static load takes",
        zero_allowed=True,
    )
    sizes = [
        Size(area, bias) for area in _sorted(areas, "areas") for bias in _sorted(biases, "biases")
    ]
    if len(sizes) > _MOST:
        raise invalid(
            "the number of sizes", len(sizes), f"at most {_MOST}", "take fewer areas or biases"
        )
    done: list[Trial] = []
    try:
        # from the machine file's size outwards, each begun with the nearest one's controller
        for item in sorted(sizes, key=_distance):
            near = min(
                (t for t in done if t.controller is not None),
                key=lambda t: _distance(t.size, item),
                default=None,
            )
            done.append(
                attempt(
                    machine,
                    item,
                    method,
                    reserve=reserve,
                    near=near,
                    time_limit=time_limit,
                    progress=progress,
                )
            )
    except KeyboardInterrupt:
        if not done:
            raise
    return Sizing(machine, tuple(sorted(done, key=lambda trial: trial.size)), reserve)


def _sorted(values: Sequence[float], what: str) -> list[float]:
    if not len(values):
        raise InvalidInput(
            f"no {what} were given; give shares of the machine file's, such as 0.5 and 1"
        )
    return sorted(
        {
            check_positive(value, f"one of the {what}", "give a share of the machine file's")
            for value in values
        }
    )


def _distance(one: Size, other: Size | None = None) -> float:
    # in the logarithms: a half is as far as the double
    other = other or Size()
    return float(np.hypot(np.log(one.area / other.area), np.log(one.bias / other.bias)))
