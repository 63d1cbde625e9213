"""What a requirement costs: the lowest sensitivity that a tuned controller reaches while a demand
becomes harder.

For every value of the demand the sensitivity aimed at is moved until the worst of all ratios is 1:
everything else is then met as asked, and sigma_max(S_o) stands at what is left. Each value starts
from the controller of the one before it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from ambrose.core.checks import InvalidInput, NumericalFailure, check_positive, invalid
from ambrose.core.presentation import Presented, data_frame, with_unit
from ambrose.core.processes import TimeLimit
from ambrose.core.statespace import StateSpace
from ambrose.judge.plants import envelope_of
from ambrose.judge.result import INTERRUPTED, Synthesis
from ambrose.law.pid import first_settings, pid_controller
from ambrose.machine.machine import Machine
from ambrose.machine.units import DIMENSIONS, read_quantity, suggestion
from ambrose.model.assemble import assemble
from ambrose.synthesis.fixed_order.channels import aims_of
from ambrose.synthesis.fixed_order.job import Job, Law, first_law, prepare, with_states
from ambrose.synthesis.fixed_order.tuning import AGAIN, tuned
from ambrose.synthesis.methods import Tuned

ORDER = "order"
# what can be traded -> its dimension; all but the log decrement are easier to meet at larger values
TRADED: Mapping[str, str] = {
    "settling_time": "time",
    "unbalance_orbit": "length",
    "max_current": "current",
    "compliance_peak": "compliance",
    "control_gain": "current per displacement",
    "log_decrement": "plain number",
    ORDER: "plain number",
}
_EXACT = 0.02  # how far the worst ratio may be from 1
_AIMS = 3  # sensitivities aimed at, for each value
_HIGHEST = 12.0  # sensitivity aimed at; what is not met there is not met
# of what is aimed at; the gain in A/m
_RANGES = {"sensitivity": (1.02, _HIGHEST), "gain": (1e-3, float("inf"))}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TradeOff(Presented):
    """over: the requirement, or "order"; values (k,) in ``unit``, easiest first; controllers (k,):
    for each value the one with the lowest sensitivity among those that meet all else, or that come
    nearest; None where nothing holds every point.

    sensitivity (k,) [-]: the largest H-infinity norm of S_o at the operating points, on the full
    plants as the loop runs, and of the worst corners found; inf without a controller. met (k,):
    whether all else was met. binding (k,): what binds.
    """

    over: str
    unit: str
    values: tuple[float, ...]
    sensitivity: tuple[float, ...]
    met: tuple[bool, ...]
    binding: tuple[str, ...]
    controllers: tuple[Synthesis | None, ...]

    def facts(self) -> Mapping[str, Any]:
        """The lowest sensitivity at every value."""
        rows = zip(self.values, self.sensitivity, self.met, strict=True)
        told = [
            f"{with_unit(value, self.unit)}: {peak:.3g}{'' if met else ' (not met)'}"
            for value, peak, met in rows
        ]
        return {"over": self.over, "lowest_sensitivity": told}

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row for each value."""
        columns = {
            f"{self.over} [{self.unit}]": self.values,
            "sensitivity [-]": self.sensitivity,
            "met": self.met,
        }
        return data_frame({**columns, "binding": self.binding})


def trade_off(
    machine: Machine,
    over: str,
    values: Sequence[float],
    method: Tuned | None = None,
    *,
    time_limit: float = 180.0,
    progress: Callable[[str], None] = lambda text: None,
) -> TradeOff:
    """The lowest sensitivity of a tuned controller against the values of one requirement, or
    against its order.

    over: a key of [requirements] (``TRADED``) or "order"; values: SI; method: how each controller
    is tuned (no bank); time_limit [s] of computing for each sensitivity aimed at. Ctrl-C keeps the
    values that are done. Raises InvalidInput.
    """
    if over == "unbalance_orbit":
        machine.across_the_shaft("unbalance turns across it")
    method = (method or Tuned()).without_bank().on(machine)
    wanted = _checked(over, values)
    start = pid_controller(machine.reference or first_settings(machine), machine)
    plants = envelope_of(assemble(machine, machine.operation.design))
    order = int(wanted[0]) if over == ORDER else method.order
    job = prepare(
        plants,
        start,
        method.timing(),
        order,
        method.structure,
        method.bending_modes,
        None,
        time_limit,
        None,
    )
    job.most_states = None  # every value at one order
    groups, usual = job.groups, job.aims.sensitivity
    law = first_law(job, start, order, method.structure)
    aim = usual
    again = False
    rows: list[tuple[float, float, bool, str, Synthesis | None]] = []
    try:
        for value in wanted:
            changed: dict[str, Any] = {} if over == ORDER else {over: value}
            demanded = replace(machine.requirements, **changed)
            job.aims = replace(
                aims_of(replace(machine, requirements=demanded), start),
                sensitivity=aim,
                highest=job.aims.highest,
            )
            if not again:  # the first one, or the one before has nothing to go on from
                job.groups = groups
                law = first_law(
                    job, start, int(value) if over == ORDER else order, method.structure
                )
            elif over == ORDER:
                law = with_states(
                    cast(StateSpace, law), int(value) - cast(StateSpace, law).n_states, job.groups
                )
            progress(f"{over} {value:.4g} {unit_of(over)}")
            best = lowest(job, law, method.structure, again, time_limit, progress)
            rows.append((value, *best))
            again, found = best[1], best[-1]
            if again and found is not None:
                law, aim = found.controller, min(max(best[0], 1.05), _HIGHEST)
            else:
                aim = usual
    except KeyboardInterrupt:
        if not rows:
            raise
    columns = list(zip(*rows, strict=True))
    return TradeOff(over, unit_of(over), *columns)


def unit_of(over: str) -> str:
    """The SI unit of what is traded."""
    return DIMENSIONS[TRADED[over]].unit


def read_value(over: str, text: str) -> float:
    """A value as written in a file, "20 ms", in SI. Raises InvalidInput."""
    try:
        if over in {ORDER, "log_decrement"}:
            return float(text)
        return read_quantity(text, DIMENSIONS[TRADED[over]])
    except ValueError as error:
        told = (
            str(error)
            if TRADED[over] != "plain number"
            else f'is "{text}", but must be a plain number'
        )
        raise InvalidInput(f"a value of {over} {told}") from None


def _checked(over: str, values: Sequence[float]) -> list[float]:
    """The values, easiest first. Raises InvalidInput."""
    if over not in TRADED:
        raise invalid(
            "over", repr(over), f"one of {', '.join(TRADED)}", suggestion(str(over), TRADED)
        )
    for value in values:
        check_positive(value, f"a value of {over}", f"give it in {unit_of(over)}")
        if over == ORDER and value != int(value):
            raise invalid("order", value, "a whole number", "round it")
    if len(set(values)) < 2:
        raise InvalidInput(f"a trade-off needs two different values of {over} at least; give more")
    return sorted(set(map(float, values)), reverse=over not in {ORDER, "log_decrement"})


def lowest(
    job: Job,
    law: Law,
    structure: str,
    again: bool,
    time_limit: float,
    progress: Callable[[str], None],
    lever: str = "sensitivity",
    trials: int = _AIMS,
) -> tuple[float, bool, str, Synthesis | None]:
    """The lowest sensitivity, or the lowest "gain" [A/m] of K S_o, as ``lever``; whether all else
    is met, what binds, and the controller, of the best of so many aims.
    """
    best: tuple[float, bool, str, Synthesis | None] = (
        float("inf"),
        False,
        "no stable controller for all points",
        None,
    )
    least, most = _RANGES[lever]
    for _ in range(trials):
        job.clock, aim = TimeLimit(time_limit), getattr(job.aims, lever)
        try:
            found = tuned(job, law, structure, again=AGAIN * again)
        except NumericalFailure as error:
            progress(str(error))
            break
        if found.stopped_early == INTERRUPTED:  # the value at work has not come to its end
            raise KeyboardInterrupt
        # the lever itself may be a guard of the search; of the others requirements count
        ratios = found.ratios | {lever: found.certificate.margins[f"ratio_{lever}"]}
        peak = aim * ratios[lever]
        others = max(value for name, value in ratios.items() if name != lever)
        here = peak, others <= 1 + _EXACT, max(ratios, key=lambda name: ratios[name]), found
        early = f" ({found.stopped_early})" if found.stopped_early else ""
        progress(
            f"aimed at {aim:.3g}: {lever} {peak:.3g}, {here[2]} binds at {found.gamma:.3f} of its "
            f"limit{early}"
        )
        if (not here[1], here[0]) < (not best[1], best[0]):
            best = here
        law, again = found.controller, True
        if abs(found.gamma - 1) <= _EXACT or (aim >= most and not here[1]):
            break
        # the guard of the gain may be far off
        begin = aim if lever == "sensitivity" else min(peak, aim)
        aim = min(
            max(aim * found.gamma**1.5 if found.gamma > 1 else begin * found.gamma, least), most
        )
        job.aims = replace(job.aims, **{lever: aim})
    return best
