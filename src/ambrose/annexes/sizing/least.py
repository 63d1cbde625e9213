"""The least that still guarantees all that is asked: control action, bias, magnet, amplifier; and
what robustness costs.

Lauridsen 2017, 7.3: synthesis "can be used to find the minimum control action required to guarantee
robust performance". Control action is taken as the largest gain of K S_o [A/m] over all
frequencies: what a micrometre of motion costs in current.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from ambrose.annexes.sizing.guarantee import RESERVE, Trial, attempt, tuning_job
from ambrose.annexes.sizing.magnets import SIZES, Size
from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.presentation import Presented, data_frame
from ambrose.judge.result import Synthesis
from ambrose.machine.axial import across_the_shaft, in_file
from ambrose.machine.description import Tolerance
from ambrose.machine.machine import Machine, require_magnets
from ambrose.model.assemble import assemble
from ambrose.synthesis.design import design
from ambrose.synthesis.fixed_order.job import with_states
from ambrose.synthesis.methods.mu import Mu
from ambrose.synthesis.methods.tuned import Tuned
from ambrose.synthesis.trade_off import lowest

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
        across_the_shaft(machine, SIZES)
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
    value, met, binding, found = best
    return Least(
        "gain",
        value if met else float("inf"),
        0.0,
        binding,
        found,
        machine,
        ", ".join(searched),
    )


def _heaviest(machine: Machine, method: Tuned, progress: Callable[[str], None]) -> Least:
    """Bisection over the control weight of mu designs; mu grows with it."""
    weights = machine.weights
    if weights is None or weights.control_level is None or not machine.tolerances:
        needs = in_file(machine, "[weights] with control_level, and a [[tolerance]]")
        raise InvalidInput(f"lever weight needs {needs}; add them, or take lever gain")
    found: dict[float, Synthesis] = {}
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
        found[factor] = design(plant, mu_method)
        progress(f"{factor:.3g} of control_level: mu {found[factor].gamma:.4g}")
        return found[factor].gamma

    low = high = 1.0

    # mu(low) <= 1 < mu(high): halved down while mu is above 1, else doubled up while it is not
    while mu(low) > 1 and low > _LOWEST:
        high, low = low, low / 2
    while low == high and low < 1 / _LOWEST:
        low, high = (2 * low, 2 * low) if mu(2 * low) <= 1 else (low, 2 * low)
    if found[low].gamma > 1:
        return Least("weight", 0.0, low, "mu", machine=machine, searched=_BISECTED)

    # the largest that is tried met it as well: none failed
    if low == high:
        return Least("weight", low, 0.0, "the largest that is tried", found[low], machine)

    # bisection in the logarithm
    while high / low > _CLOSE:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if mu(middle) <= 1 else (low, middle)
    return Least("weight", low, high, "mu", found[low], machine, _BISECTED)


def _stepped(
    machine: Machine,
    lever: str,
    method: Tuned,
    reserve: float,
    time_limit: float,
    progress: Callable[[str], None],
) -> Least:
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
    found: list[Least] = []
    sign = -1 if lever == "weight" else 1
    try:
        for width in wanted:
            progress(f"{parameter} +-{100 * width:.3g} %")
            own = replace(
                machine, tolerances=(*others, replace(stated, absolute=None, relative=width))
            )
            found.append(
                least(own, lever, method, reserve=reserve, time_limit=time_limit, progress=progress)
            )
    except KeyboardInterrupt:
        if not found:
            raise

    # what holds a wider range holds a narrower one: from the widest down the better
    # of the two stays
    for i in range(len(found) - 2, -1, -1):
        if sign * found[i + 1].value < sign * found[i].value:
            found[i] = found[i + 1]
    return Price(parameter, tuple(wanted[: len(found)]), tuple(found))
