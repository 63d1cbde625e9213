"""The records of an identification, checked, beside the models of the loops they were recorded
from.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import InvalidInput, as_several, check_finite, invalid, same_clock
from ambrose.core.sampling import c2d, delayed
from ambrose.core.statespace import StateSpace, poles
from ambrose.identification.findings import excitation_order, signal_rows
from ambrose.identification.output_error.loop_model import (
    ParametricModel,
    TimedLoop,
    loop_model,
    timed,
)
from ambrose.identification.output_error.normal_equations import Task, distinct
from ambrose.identification.output_error.synchronous import synchronous_of
from ambrose.identification.parameters import nominal_values, ratios, reduced_plant, split_timing
from ambrose.law.law import LawLike
from ambrose.law.loop import match_controller
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY, EXCITATION_DELAY
from ambrose.model.plant import Plant
from ambrose.record.record import Record

_WINDOW = 16_384  # samples in which an excitation is judged at a time


# bending modes beyond those modelled, which are tried together; assumed: each further one is
# stiffer, and pulls at the static response by less
FURTHER_MODES = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class FitOptions:
    """How a closed loop is modelled and fitted.

    signals: those fitted (None: every y_<axis>); u_ and i_<axis> are possible. weights: signal ->
    size of its noise [m] or [A] (None: the signal's rms). bending_modes: per plane, as many as the
    rotor has at most. computing_delay [samples]: from measured errors to acting currents.
    initial_state, offset: estimated per record, else zero. harmonics: up to which multiple of its
    speed a record's signals may turn with the rotor (unbalance, run-out); tones [Hz]: others that
    they may hold, as from the mains. period [s], or "auto": the excitation is periodic, and the fit
    goes over the lines of its spectrum (output_error/periodic.py), much faster.
    """

    signals: Sequence[str] | None = None
    weights: Mapping[str, float] | None = None
    bending_modes: int = 3
    computing_delay: float = 1
    initial_state: bool = True
    offset: bool = True
    harmonics: int = 3
    tones: Sequence[float] = ()
    period: float | str | None = None
    max_iterations: int = 50


def modelled_modes(count: int) -> list[str]:
    """A note where more bending modes per plane are modelled than by default."""
    return [f"{count} bending modes per plane are modelled"] * (count > FitOptions().bending_modes)


@dataclass(frozen=True, slots=True, eq=False)
class Experiment:
    """What is to be found and from what: paths (q,) of ``machine`` with their values nominal (q,)
    at the reference ``point``, SI, and their sizes scale (q,).

    tasks: one per record, sampled every dt [s]; ``place`` of each is that of its loop in
    ``models``, one per operating point. sizes (p,): the weights of the fitted ``signals``.
    """

    machine: str
    dt: float
    options: FitOptions
    paths: tuple[str, ...]
    nominal: np.ndarray
    scale: np.ndarray
    point: OperatingPoint
    models: tuple[ParametricModel, ...]
    tasks: tuple[Task, ...]
    sizes: np.ndarray
    signals: tuple[str, ...]


def build_experiment(
    machine: Machine,
    records: Record | Sequence[Record],
    controller: LawLike,
    unknown: Sequence[str],
    options: FitOptions,
) -> Experiment:
    """The experiment that ``closed_loop.identify`` describes; the same arguments. Raises
    InvalidInput.
    """
    records, computing_delay = as_several(records), options.computing_delay
    points, dt = operating_points(machine, records)
    _check_delay(computing_delay)
    reference = max(points, key=lambda point: abs(point.seal_pressure))
    paths, timing = split_timing(machine, unknown)
    plants = [reduced_plant(machine, point, options.bending_modes, paths) for point in points]
    main = plants[points.index(reference)]
    fitted = fitted_signals(main, records, options.signals)
    excitations = driven_inputs(main, records, -(-(len(paths) + len(timing)) // len(fitted)))

    # A whole, known delay is part of the controller; any other one is TimedLoop's.
    exact = not timing and float(computing_delay).is_integer()
    law = deployed_controller(main, controller, dt, int(computing_delay) if exact else 0)

    # theta is that of the reference point: at the others the parameters are factor theta
    factors = [
        np.ones(len(paths)) if plant is main else ratios(main, plant, paths) for plant in plants
    ]
    values = nominal_values(main, paths)
    loops = [
        loop_model(plant, law, paths, factor * values, excitations, fitted, factor)
        for plant, factor in zip(plants, factors, strict=True)
    ]
    models = loops if exact else [timed(loop, computing_delay, timing) for loop in loops]
    sizes = _sizes(records, fitted, options.weights)
    places = [points.index(replace(record.point, label="")) for record in records]
    if EXCITATION_DELAY in timing and not options.initial_state:
        text = "the loop has then begun before the first sample that is used"
        raise invalid("initial_state", False, f"True where {EXCITATION_DELAY} is unknown", text)
    tasks = []
    for record, place in zip(records, places, strict=True):
        waves, measured = signal_rows(record, excitations), signal_rows(record, fitted)
        tail = np.zeros(0)
        alike = 0
        turning = synchronous_of(record, options.harmonics, options.tones)

        # what turns begins with the first sample that is fitted
        model = models[place]
        if isinstance(model, TimedLoop):
            waves, measured, tail = model.aligned(waves, measured)
            alike, turning = model.old_commands, turning and replace(turning, first=model.skipped)
        tasks.append(
            Task(
                *distinct(waves),
                measured,
                options.initial_state,
                options.offset,
                sizes,
                place,
                tail,
                alike,
                turning,
            )
        )
    reference = next(
        record.point for record in records if replace(record.point, label="") == reference
    )

    # theta: the paths' values, then the delays, whose size is a sample
    begin = {CONTROLLER_DELAY: computing_delay * dt, EXCITATION_DELAY: 0.0}
    nominal = np.concatenate([values, [begin[name] for name in timing]])
    scale = np.where(nominal == 0, 1.0, np.abs(nominal))
    scale[len(paths) :] = dt
    return Experiment(
        machine.name,
        dt,
        options,
        (*paths, *timing),
        nominal,
        scale,
        reference,
        tuple(models),
        tuple(tasks),
        sizes,
        fitted,
    )


def start_values(
    paths: tuple[str, ...], nominal: np.ndarray, start: Mapping[str, float] | None
) -> np.ndarray:
    """The values (q,) to begin at: the machine's, but for those given by path."""
    values = nominal.copy()
    for path, value in (start or {}).items():
        if path not in paths:
            raise invalid(
                "a start value's path",
                repr(path),
                f"one of {', '.join(paths)}",
                "write it as in unknown, without *",
            )
        values[paths.index(path)] = float(check_finite(value, f"the start value of {path}"))
    return values


def slowest(loops: Iterable[StateSpace]) -> float:
    """The largest modulus of the poles of sampled loops."""
    return max(float(np.abs(poles(loop)).max()) for loop in loops)


def admitted(models: Sequence[ParametricModel], theta: np.ndarray) -> bool:
    """Whether every delay at theta (q,) is within what its loop can hold."""
    return all(model.admits(theta) for model in models if isinstance(model, TimedLoop))


def check_start(models: Sequence[ParametricModel], begin: np.ndarray) -> None:
    """Refuse a start at which a model's loop is unstable."""
    worst = slowest(one.loop(begin)[0] for one in models) if admitted(models, begin) else np.inf
    if not worst < 1:
        raise invalid(
            "the loop at the start values",
            f"unstable (pole of modulus {worst:.6g})",
            "stable, as the recorded loop was",
            "begin with a smaller negative_stiffness or a larger force_per_current, and check "
            "controller and computing_delay",
        )


def check_records(
    machine: Machine, records: Sequence[Record], one_rate: bool = True
) -> tuple[OperatingPoint, float]:
    """The one operating point and the sample time [s] that all records share, which are of this
    machine; else InvalidInput.
    """
    points, dt = operating_points(machine, records, one_rate)
    for number, record in enumerate(records, 1):
        if replace(record.point, label="") != points[0]:
            requirement = f"{points[0]}, that of the first"
            raise invalid(
                f"the operating point of record {number}",
                record.point,
                requirement,
                "identify each on its own",
            )
    return records[0].point, dt


def check_machine(machine: Machine, record: Record, what: str) -> None:
    """Raises InvalidInput for a record of another machine."""
    if record.machine != machine.name:
        remedy = "take that machine's file, or correct the record's attribute machine"
        raise invalid(f"the machine of {what}", repr(record.machine), repr(machine.name), remedy)


def operating_points(
    machine: Machine, records: Sequence[Record], one_rate: bool = True
) -> tuple[list[OperatingPoint], float]:
    """The distinct operating points, without labels, and the sample time [s] of records of this
    machine; else InvalidInput.

    one_rate: whether all must be sampled alike.
    """
    if not records:
        raise InvalidInput("no record was given; identification needs at least one")
    first, points = records[0], []
    for number, record in enumerate(records, 1):
        check_machine(machine, record, f"record {number}")
        if one_rate and not same_clock(record.dt, first.dt):
            raise invalid(
                f"the sample rate of record {number}",
                f"{record.sample_rate_hz:g} Hz",
                f"{first.sample_rate_hz:g} Hz, that of the first",
                "identify them one by one",
            )
        point = replace(record.point, label="")
        if point not in points:
            points.append(point)
    return points, first.dt


def fitted_signals(
    plant: Plant, records: Sequence[Record], signals: Sequence[str] | None
) -> tuple[str, ...]:
    """The names of the signals to fit, every y_<axis> for None. Raises InvalidInput for those that
    no record has.
    """
    possible = [f"{kind}_{axis}" for kind in "yui" for axis in plant.axes]
    wanted = tuple(f"y_{axis}" for axis in plant.axes) if signals is None else tuple(signals)
    for name in wanted:
        if name not in possible or wanted.count(name) > 1:
            raise invalid(
                "a fitted signal",
                repr(name),
                f"one of {', '.join(possible)}, once",
                "correct signals",
            )
        for number, record in enumerate(records, 1):
            if name not in record.signals:
                known = ", ".join(record.signals)
                raise InvalidInput(
                    f"record {number} has no signal {name}; it has {known}; list the signals to "
                    "fit (signals)"
                )
    if not wanted:
        raise InvalidInput("no signal is fitted; name at least one in signals")
    return wanted


def driven_inputs(plant: Plant, records: Sequence[Record], order: int) -> tuple[str, ...]:
    """The inputs driven in any record, after checking that each record excites enough."""
    possible = [f"e_{axis}" for axis in plant.axes] + [f"f_{port}" for port in plant.ports]
    driven = [
        name for name in possible if any(name in r.signals and r[name].any() for r in records)
    ]
    for number, record in enumerate(records, 1):
        for name in record.signals:
            if name.startswith("e_") and name not in possible:
                known = f"one of {', '.join(possible[: len(plant.axes)])}"
                raise invalid(
                    f"the excitation {name!r} of record {number}",
                    "unknown",
                    known,
                    "rename it, or leave it out",
                )
        active = [name for name in driven if name in record.signals and np.ptp(record[name]) > 0]
        if not active:
            raise InvalidInput(
                f"record {number} has no excitation: none of e_<axis>, f_<port> changes in it, "
                "and noise alone does not identify the machine; add a PRBS or chirp to the "
                "controller's output and record it "
                "as e_<axis>"
            )
        orders = {name: _order(record[name], order) for name in active}
        best = max(active, key=orders.__getitem__)
        if orders[best] < order:
            raise invalid(
                f"the order of persistent excitation of {best}",
                orders[best],
                f"at least {order}",
                "excite with a PRBS, a chirp or more sines, and each axis on its own",
            )
    return tuple(driven)


def _order(signal: np.ndarray, order: int) -> int:
    """The order of persistent excitation of a signal (k,), at most ``order``, in its best
    window.
    """
    best = 0
    for start in range(0, len(signal), _WINDOW):
        best = max(best, excitation_order(signal[None, start : start + _WINDOW], order))
        if best >= order:
            break
    return best


def deployed_controller(plant: Plant, controller: LawLike, dt: float, delay: float) -> StateSpace:
    """The controller as it runs every ``dt`` [s]: sampled by Tustin's map if it is continuous,
    ``delay`` samples late.

    Raises InvalidInput for a controller of another size or rate.
    """
    _check_delay(delay)
    if not float(delay).is_integer():
        raise invalid(
            "computing_delay",
            delay,
            "a whole number of samples",
            "take closed_loop.identify for parts of a sample",
        )
    law = match_controller(controller, plant)
    if law.dt is None:
        law = c2d(law, dt, method="tustin")
    elif not same_clock(law.dt, dt):
        raise invalid(
            "the records' sample rate",
            f"{1 / dt:g} Hz",
            f"the controller's {1 / law.dt:g} Hz",
            "record at the controller's rate, or pass the continuous controller",
        )
    return delayed(StateSpace(law.A, law.B, law.C, law.D, law.inputs, law.outputs, dt), int(delay))


def _check_delay(delay: float) -> None:
    if (
        isinstance(delay, bool)
        or not isinstance(delay, int | float | np.integer)
        or not 0 <= delay <= 20
    ):
        raise invalid(
            "computing_delay", repr(delay), "a number of samples, 0 to 20", "0 or 1 is usual"
        )


def _sizes(
    records: Sequence[Record], signals: tuple[str, ...], weights: Mapping[str, float] | None
) -> np.ndarray:
    sizes = np.array([max(_spread(record[name]) for record in records) for name in signals])
    for name, value in (weights or {}).items():
        if name not in signals or not value > 0:
            raise invalid(
                f"the weight {name!r}",
                value,
                f"positive, for one of {', '.join(signals)}",
                "correct weights",
            )
        sizes[signals.index(name)] = value
    for name, size in zip(signals, sizes, strict=True):
        if size == 0:
            raise InvalidInput(
                f"signal {name} never changes: a dead sensor or channel; leave it out of signals"
            )
    return sizes


def _spread(signal: np.ndarray) -> float:
    """The standard deviation, without a copy of a long signal."""
    mean = float(signal.mean())
    squares = sum(
        float(np.sum((signal[i : i + _WINDOW] - mean) ** 2)) for i in range(0, len(signal), _WINDOW)
    )
    return float(np.sqrt(squares / len(signal)))
