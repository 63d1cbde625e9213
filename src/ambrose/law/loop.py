"""The closed loop of core/lft.py's diagram, around a plant and a controller; how a controller's
signals find their axes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ambrose.core.checks import SAME_CLOCK, InvalidInput, check_positive, invalid, same_clock
from ambrose.core.realisation import modal_form
from ambrose.core.sampling import Method, c2d, delayed, pade
from ambrose.core.scheduled import ScheduledSystem, grid_points
from ambrose.core.statespace import (
    ControllerLike,
    StateSpace,
    append,
    as_statespace,
    connect,
    poles,
    rename,
    select,
    series,
)
from ambrose.law.law import Law, LawLike, law_of
from ambrose.machine.machine import (
    RADIAL,
    SUFFIX,
    THRUST,
    Machine,
    require_magnets,
)
from ambrose.machine.ordinary_file import DELAY_SAMPLES
from ambrose.model.plant import Plant


def closed_loop(plant: Plant, controller: LawLike) -> StateSpace:
    """Everything that can be asked of the loop, as one system.

    Inputs: e_<axis> [A] excitation added to the controller's output, d_<axis> [m] output
    disturbance, r_<axis> [m] reference, f_<port> [N] force. Outputs: y_<axis> [m] measured
    displacement (d included), u_<axis> [A] controller output, i_<axis> [A] coil current, q_<port>
    [m], qdot_<port> [m/s]. A sampled controller closes the loop around the plant sampled with a
    zero-order hold. The controller is matched by ``match_controller``, which raises InvalidInput.
    """
    controller = match_controller(controller, plant)
    system = plant.system if controller.dt is None else c2d(plant.system, controller.dt)
    axes = plant.axes
    return connect(
        [
            rename(system, {f"u_{a}": f"v_{a}" for a in axes}, {f"y_{a}": f"g_{a}" for a in axes}),
            controller,
        ],
        inputs=[f"{kind}_{a}" for kind in "edr" for a in axes] + [f"f_{p}" for p in plant.ports],
        outputs=[f"{kind}_{a}" for kind in "yui" for a in axes]
        + [f"{kind}_{p}" for kind in ("q", "qdot") for p in plant.ports],
        sums={
            **{f"v_{a}": [f"u_{a}", f"e_{a}"] for a in axes},
            **{f"y_{a}": [f"g_{a}", f"d_{a}"] for a in axes},
            **{f"err_{a}": [f"r_{a}", f"-y_{a}"] for a in axes},
        },
    )


def loop_alone(plant: Plant, controller: LawLike) -> StateSpace:
    """The states of ``closed_loop`` without its signals: what poles are computed from."""
    controller = match_controller(controller, plant)
    part = select(plant.system, plant.named("u"), plant.named("y"))
    part = part if controller.dt is None else c2d(part, controller.dt)
    negative = {f"err_{axis}": [f"-y_{axis}"] for axis in plant.axes}
    return connect([part, controller], inputs=[], outputs=[], sums=negative)


def match_controller(controller: LawLike, plant: Plant) -> StateSpace:
    """The controller's law with inputs err_<axis> [m] and outputs u_<axis> [A], in the order of the
    plant's axes.

    Signals that are named after axes (err_A_zeta, y_A_zeta, u_A_zeta ...) are matched by name,
    whatever their order; a controller without such names is matched by place. A scheduled law is
    the one at the plant's speed or seal pressure. Raises InvalidInput where the size does not fit,
    or the names are those of other axes.
    """
    require_magnets(plant.machine)
    law = law_of(controller).at(plant.point)
    check_side(law.inputs, plant.machine)
    return match_axes(law, plant.axes, repr(plant.machine.name))


def laws_of(
    machine: Machine, law: Law, axial: LawLike | None = None, axes: str | None = None
) -> dict[str, tuple[Machine, Law]]:
    """{group of axes: its machine and its law}, of those asked for whose law is known.

    law: of the machine's own axes, perhaps with that of its thrust axis; axial: the latter, given
    apart; axes: the one group asked for (None: all). Raises InvalidInput for a group that the
    machine lacks, and for laws that are exchanged or given twice.
    """
    machine = machine.only(THRUST) if axes == THRUST else machine
    groups = machine.groups if axes is None else {axes: machine.only(axes)}
    along = None if axial is None else law_of(axial)
    if along is not None and (machine.group == THRUST or law.thrust is not None):
        twice = "the thrust axis has two controllers, one of them given as axial; leave it out"
        raise InvalidInput(twice)
    if along is not None and THRUST not in machine.groups:
        raise InvalidInput(
            f"axial is given, but {machine.name} has no thrust bearing; leave it out"
        )
    if along is not None:
        _check_exchanged(law.inputs, along.inputs, machine.groups)
    laws = {RADIAL: law, THRUST: law.thrust if along is None else along}
    if machine.group == THRUST:
        own = law.thrust or law
        check_side(own.inputs, machine)
        laws = {THRUST: own}
    return {
        name: (group, known)
        for name, group in groups.items()
        if (known := laws.get(name)) is not None
    }


def _check_exchanged(
    inputs: Sequence[str], along: Sequence[str], groups: Mapping[str, Machine]
) -> None:
    """Refuses controllers of the other group, by the names of their inputs. Raises InvalidInput."""
    radial, thrust = ({f"err_{axis}" for axis in item.axes} for item in groups.values())
    if set(inputs) == thrust and set(along) == radial:
        raise InvalidInput(
            "the controllers of the radial axes and of the thrust axis are exchanged; swap them"
        )
    if set(inputs) == thrust:
        raise InvalidInput(
            f"the controller is of {groups[THRUST].axes[0]}, as the one given as axial is; give "
            f"that of the radial axes {', '.join(groups[RADIAL].axes)}"
        )
    if set(along) == radial:
        raise InvalidInput(
            f"axial is a controller of the radial axes; give that of {groups[THRUST].axes[0]}"
        )


def check_side(inputs: Sequence[str], machine: Machine) -> None:
    """Refuses a controller of the axis along the shaft on the radial axes of its machine, and the
    other way round, by the names of its inputs. Raises InvalidInput.
    """
    whole = machine.whole
    if whole is None or THRUST not in whole.groups:
        return
    (axis,), across = whole.axial.axes, {f"err_{axis}" for axis in whole.axes}
    if whole is machine and set(inputs) == {f"err_{axis}"}:
        raise InvalidInput(
            f"this controller is of {axis}, the axis along the shaft; add "
            f'"{SUFFIX}" to the machine, {machine.name}{SUFFIX}'
        )
    if whole is not machine and set(inputs) == across:
        raise InvalidInput(
            f"this controller is of the radial axes {', '.join(whole.axes)}; take the machine "
            f'without "{SUFFIX}", {whole.name}'
        )


def match_axes(controller: ControllerLike, axes: Sequence[str], machine: str = "") -> StateSpace:
    """``match_controller`` for a fixed law and the axes themselves; machine: in words, for the
    message.
    """
    system = as_statespace(controller)
    n = len(axes)
    if system.D.shape != (n, n):
        requirement = f"({n}, {n}) for the axes {', '.join(axes)}"
        raise invalid(
            "the controller's size (outputs, inputs)",
            system.D.shape,
            requirement,
            "design it for this machine",
        )
    into, out = (axis_order(system, side, axes, machine) for side in ("inputs", "outputs"))
    if into != list(range(n)) or out != list(range(n)):
        system = select(system, [system.inputs[k] for k in into], [system.outputs[k] for k in out])
    return rename(system, [f"err_{axis}" for axis in axes], [f"u_{axis}" for axis in axes])


def axis_order(
    controller: StateSpace,
    side: Literal["inputs", "outputs"],
    axes: Sequence[str],
    machine: str = "",
) -> list[int]:
    """Which of the controller's inputs or outputs belongs to each axis: by its name, or by place
    without names of axes.

    Raises InvalidInput where the names are those of other axes.
    """
    names, prefix = (controller.inputs, "err_") if side == "inputs" else (controller.outputs, "u_")
    ways = ("_zeta", "_eta", *(f"_{axis.rpartition('_')[2]}" for axis in axes))
    if not any(name.startswith(prefix) or name.endswith(ways) for name in names):
        return list(range(len(axes)))
    axis_of = [_axis_named(name, axes) for name in names]
    if sorted(map(str, axis_of)) != sorted(axes):
        remedy = (
            f"this controller is for another machine: design one for {machine or 'this'}, or give "
            "its signals these names"
        )
        raise invalid(
            f"the list of the controller's {side}",
            ", ".join(names),
            ", ".join(prefix + axis for axis in axes),
            remedy,
        )
    return [axis_of.index(axis) for axis in axes]


def _axis_named(name: str, axes: Sequence[str]) -> str | None:
    """The axis that a signal's name ends with; generated code writes _ for a bearing's hyphens."""
    for spelled in (str, lambda text: text.replace("-", "_")):
        for axis in axes:
            if f"_{spelled(name)}".endswith(f"_{spelled(axis)}"):
                return axis
    return None


def running_law(law: LawLike, plant: Plant, timing: Timing | None) -> StateSpace:
    """The law in the loop of a plant: at its operating point, its signals matched and, with a
    timing, sampled and late.
    """
    fixed = match_controller(law, plant)
    return fixed if timing is None else timing.in_loop(fixed)


# A controller's sampled matrices (core/sampling.py has the methods), in modal form; of a schedule
# at every grid point.
#
# A slow pole is 1 - 1e-7 once sampled, which leaves A nine digits; so A - I is computed from the
# continuous matrices and kept beside the system.


_TINY = 2.0**-150  # weight of the states among the outputs, from which the transform is read
_RESIDUAL = 1e-8  # relative: what going to the block form and back may cost A
_FREQUENCIES = 200  # up to 0.98 of the Nyquist frequency


def whole_samples(delay: float, sample_time: float) -> int:
    """``delay`` [s] as a number of samples. Raises InvalidInput for a fraction."""
    check_positive(delay, "the computing delay", "give it in seconds", zero_allowed=True)
    count = round(delay / sample_time)
    if abs(delay - count * sample_time) > SAME_CLOCK * max(count, 1) * sample_time:
        remedy = "round it up: outputs are written when the next sample is taken"
        raise invalid(
            "the computing delay",
            f"{delay:g} s",
            f"a whole number of samples of {sample_time:g} s",
            remedy,
        )
    return count


def check_rate(source: StateSpace | ScheduledSystem, dt: float) -> None:
    """Refuse a sample time [s] that is too long for a continuous controller's fastest pole, which
    must lie below half the sample rate, and one that is not a sampled controller's own. Raises
    InvalidInput.
    """
    if source.dt is not None:
        if not same_clock(source.dt, dt):
            raise invalid(
                "the sample time",
                f"{dt:g} s",
                f"the controller's {source.dt:g} s",
                "it is sampled already",
            )
        return
    for K in source.systems if isinstance(source, ScheduledSystem) else (source,):
        needed = float(np.abs(poles(K)).max(initial=0.0) / np.pi)
        if 1 / dt < needed:
            remedy = (
                f"sample at {needed:.4g} Hz or more, or roll the controller off below "
                f"{np.pi / dt:.4g} rad/s"
            )
            fastest = f"{needed * np.pi:.4g} rad/s"
            raise invalid(
                "the sample rate",
                f"{1 / dt:.4g} Hz",
                f"at least {needed:.4g} Hz for a pole at {fastest}",
                remedy,
            )


def sample_controller(
    source: StateSpace, dt: float, method: Method, prewarp: float | None
) -> tuple[StateSpace, np.ndarray, tuple[int, ...]]:
    """The sampled controller in modal form, its A - I (n, n) and the sizes of its blocks. Raises
    InvalidInput.
    """
    check_rate(source, dt)
    form = modal_form(source)
    K, n = form.system, form.system.n_states
    if source.dt is not None:
        return K, K.A - np.eye(n), form.sizes

    sampled = c2d(K, dt, method, prewarp=prewarp)

    # A - I of a block-diagonal A is block diagonal: rounding outside the blocks is cut
    inside = np.zeros((n, n), bool)
    for start, k in zip(form.starts, form.sizes, strict=True):
        inside[start : start + k, start : start + k] = True
    increment = np.where(inside, _increment(K, dt, method, prewarp), 0.0)
    A = np.eye(n) + increment
    return (
        StateSpace(A, sampled.B, sampled.C, sampled.D, source.inputs, source.outputs, dt),
        increment,
        form.sizes,
    )


def sample_schedule(
    source: ScheduledSystem, dt: float, method: Method, prewarp: float | None
) -> tuple[ScheduledSystem, np.ndarray]:
    """The schedule sampled at its grid points, in its own states, and A - I (k, n, n) there. Raises
    InvalidInput.
    """
    check_rate(source, dt)
    n, eye = source.n_states, np.eye(source.n_states)
    if source.dt is not None:
        return source, np.array([s.A - eye for s in source.systems])
    increments = [_increment(K, dt, method, prewarp) for K in source.systems]
    sampled = [c2d(K, dt, method, prewarp=prewarp) for K in source.systems]
    systems = tuple(
        StateSpace(eye + E, K.B, K.C, K.D, source.inputs, source.outputs, dt)
        for E, K in zip(increments, sampled, strict=True)
    )
    return replace(source, systems=systems), np.array(increments).reshape(len(systems), n, n)


def _increment(K: StateSpace, dt: float, method: Method, prewarp: float | None) -> np.ndarray:
    """A - I (n, n) of the sampled K: A times what the held identity adds to the states."""
    n, eye = K.n_states, np.eye(K.n_states)
    # its A is that of the hold
    method, prewarp = ("zoh", None) if method == "matched" else (method, prewarp)
    # zoh: e^{A dt} - I = A int_0^dt e^{A s} ds, and the integral is B of the held identity
    return (
        K.A @ c2d(StateSpace(K.A, eye, eye, np.zeros((n, n))), dt, method, prewarp=prewarp).B
        if n
        else np.zeros((0, 0))
    )


def common_states(source: ScheduledSystem) -> tuple[ScheduledSystem, tuple[int, ...]]:
    """The schedule in the modal states of its middle grid point, the same at every point, and the
    sizes of their blocks.

    Where the transform is too ill-conditioned to give the other points back to 1e-8, the states
    stay as they are.
    """
    n = source.n_states
    if n == 0:
        return source, ()
    middle = source.systems[len(source.systems) // 2]

    # x = X x_modal: the outputs _TINY x of the modal form are _TINY X x_modal
    outputs = np.vstack([middle.C, _TINY * np.eye(n)])
    form = modal_form(
        StateSpace(
            middle.A, middle.B, outputs, np.zeros((len(outputs), len(source.inputs))), dt=middle.dt
        )
    )
    X = form.system.C[len(middle.C) :] / _TINY
    inverse = np.linalg.inv(X)

    # (X^-1 A X, X^-1 B, C X) at every grid point
    moved = [
        StateSpace(inverse @ s.A @ X, inverse @ s.B, s.C @ X, s.D, s.inputs, s.outputs, s.dt)
        for s in source.systems
    ]

    # what going there and back costs A, relative to its largest entry
    residual = max(
        np.abs(X @ new.A @ inverse - old.A).max() / max(np.abs(old.A).max(), 1e-300)
        for new, old in zip(moved, source.systems, strict=True)
    )
    return (
        (replace(source, systems=tuple(moved)), form.sizes)
        if residual <= _RESIDUAL
        else (source, (1,) * n)
    )


def interpolation_deviation(
    source: ScheduledSystem,
    sampled: ScheduledSystem,
    dt: float,
    method: Method,
    prewarp: float | None,
) -> tuple[float, Any]:
    """The largest distance [-], and where, between interpolating before and after sampling,
    half-way between grid points; relative to the gain at the same frequency.
    """
    if source.dt is not None:
        return 0.0, source.range[0]
    omega = np.geomspace(1e-5, 0.98, _FREQUENCIES) * np.pi / dt
    distances = []
    for value in grid_points([(axis[1:] + axis[:-1]) / 2 for axis in source.axes]):
        exact = response(c2d(source.at(value), dt, method, prewarp=prewarp), omega)
        size = np.linalg.norm(exact, 2, axis=(1, 2))
        # exact: interpolated, then sampled; against sampled, then interpolated
        distance = np.linalg.norm(response(sampled.at(value), omega) - exact, 2, axis=(1, 2))
        distances.append((float((distance / np.maximum(size, np.finfo(float).tiny)).max()), value))
    return max(distances)


def response(system: StateSpace, omega: np.ndarray) -> np.ndarray:
    """The frequency response (w, p, m) of a sampled system at omega (w,) [rad/s]."""
    z = np.exp(1j * omega * float(system.dt or 1.0))
    if not system.n_states:
        return np.broadcast_to(system.D, (len(omega), *system.D.shape)).astype(complex)
    inner = z[:, None, None] * np.eye(system.n_states) - system.A
    return (
        system.C @ np.linalg.solve(inner, np.broadcast_to(system.B, (len(omega), *system.B.shape)))
        + system.D
    )


# When a controller acts: its sample rate and its computing delay, one answer for design,
# verification, simulation and code.
#
# The displacements are read at sample k, the currents computed from them are set ``delay_samples``
# later and held. What is given by the caller goes before the controller's own rate, that before the
# rate it was designed for, and the machine file comes last.


_PADE_ORDER = 2  # 1.5 samples at 10 kHz: 1e-4 degrees off at 200 Hz, 0.3 at 1 kHz


@dataclass(frozen=True, slots=True)
class Timing:
    """A controller runs every ``sample_time`` [s]; its currents act ``delay_samples`` (0, 1, ...)
    later. source: who says so.

    Raises InvalidInput.
    """

    sample_time: float
    delay_samples: int = 1
    source: str = "given"

    def __post_init__(self) -> None:
        check_positive(self.sample_time, "the sample time", "give it in seconds")
        if (
            isinstance(self.delay_samples, bool)
            or not isinstance(self.delay_samples, int)
            or self.delay_samples < 0
        ):
            least = "a whole number of samples, zero or more"
            raise invalid(
                "the computing delay (delay_samples)", repr(self.delay_samples), least, "1 is usual"
            )
        if self.delay_samples > DELAY_SAMPLES:  # each is a state of every axis
            raise invalid(
                "delay_samples", self.delay_samples, f"at most {DELAY_SAMPLES}", "1 is usual"
            )

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return 1 / self.sample_time

    @property
    def lag(self) -> float:
        """By how much the currents are late on average [s]: computing, and half a sample of
        holding.
        """
        return (self.delay_samples + 0.5) * self.sample_time

    def in_loop(self, law: StateSpace) -> StateSpace:
        """A fixed law as the loop sees it: sampled by Tustin's map unless it is, and late. Raises
        InvalidInput.
        """
        if law.dt is not None and not same_clock(law.dt, self.sample_time):
            remedy = "leave the rate out, or give the continuous controller"
            raise invalid(
                "the controller's sample time", f"{law.dt:g} s", f"{self.sample_time:g} s", remedy
            )
        sampled = law if law.dt is not None else c2d(law, self.sample_time, "tustin")
        return delayed(sampled, self.delay_samples)

    def late(self, law: StateSpace) -> StateSpace:
        """A continuous law with the loop's mean delay as a second-order Pade all-pass on every
        input (two states each).
        """
        passes = append(*[pade(self.lag, _PADE_ORDER, name, name) for name in law.inputs])
        return series(passes, law)

    def __str__(self) -> str:
        delay = "1 sample" if self.delay_samples == 1 else f"{self.delay_samples} samples"
        return f"sampled at {self.rate:.6g} Hz, {delay} late ({self.source})"


_WRITTEN = re.compile(r"sampled at (\S+) Hz, (\d+) samples? late")
# whose rate it is, as files say it and as people read it
_SOURCES = {
    "(what it was designed for": "(design rate",
    "(the controller's own": "(from the controller file",
}


def timing_in_words(text: str) -> str:
    """A timing as results carry it, ``str(timing)``, for people: "sampled at 10 kHz, one sample of
    delay (design rate)"; other words stay.
    """

    def plain(found: re.Match[str]) -> str:
        rate, late = float(found[1]), int(found[2])
        shown = f"{rate / 1e3:.6g} kHz" if rate >= 1e3 else f"{rate:.6g} Hz"
        delay = {0: "no sample", 1: "one sample"}.get(late, f"{late} samples")
        return f"sampled at {shown}, {delay} of delay"

    for written, read in _SOURCES.items():
        text = text.replace(written, read)
    return _WRITTEN.sub(plain, text)


DEFAULT = Timing(1e-4, 1, "assumed: not stated")  # where a rate is needed and nobody knows one
STATE_RATE = "state the rate that it runs at, sample_time in [controller] or --rate-hz"


def machine_timing(machine: Machine | None) -> Timing | None:
    """What the machine file says: [controller] sample_time and delay (None: what the elements of
    [[chain]] take together, one sample without any); None where it states no rate.

    A fraction of a sample, as identification may find it, is rounded up: outputs are set when a
    sample is taken.
    """
    settings = None if machine is None else machine.controller
    if settings is None or settings.sample_time is None:
        return None
    seconds = settings.delay
    if seconds is None and machine is not None and machine.chain:
        seconds = sum(element.dead_time for element in machine.chain)
    delay = 1.0 if seconds is None else seconds / settings.sample_time
    whole = math.ceil(delay - SAME_CLOCK * max(delay, 1.0))
    rounded = (
        f", {delay:.3g} rounded up" if abs(delay - whole) > SAME_CLOCK * max(delay, 1.0) else ""
    )
    return Timing(settings.sample_time, whole, f"machine file{rounded}")


def timing_of(
    machine: Machine | None,
    law: LawLike | None = None,
    rate: float | None = None,
    delay_samples: int | None = None,
) -> Timing | None:
    """When a controller acts on a machine, None where nothing says it.

    law: what controls, such as a Synthesis, or None. rate [Hz], delay_samples: given by the caller,
    who is heard first; then the sample time of a sampled law, then the rate that it was designed
    for, then the machine file. A delay that is not given is that of the same source, else the
    machine's, else one sample. Raises InvalidInput.
    """
    of_machine = machine_timing(machine)
    timing = of_machine
    if rate is None and law is not None:
        timing = _timing_of_law(law_of(law), of_machine)
    elif rate is not None:
        program = None if law is None else law_of(law).program
        delay = _delay(of_machine) if program is None else program.delay
        timing = Timing(1 / check_positive(rate, "rate", "give the sample rate in Hz"), delay)
    if delay_samples is None:
        return timing
    if timing is None:
        raise invalid(
            "delay_samples",
            delay_samples,
            "given with a rate",
            "state the controller's sample rate [Hz]",
        )
    overridden = delay_samples != timing.delay_samples and timing.source != "given"
    return Timing(
        timing.sample_time,
        delay_samples,
        f"{timing.source}, delay given" if overridden else timing.source,
    )


def _timing_of_law(law: Law, of_machine: Timing | None) -> Timing | None:
    """What a law says of itself, else what the machine file says."""
    delay = _delay(of_machine) if law.program is None else law.program.delay
    delay = delay if law.delay_samples is None else law.delay_samples
    if law.sample_time is not None:
        return Timing(float(law.sample_time), delay, "the controller's own")
    if law.rate:
        return Timing(1 / law.rate, delay, "what it was designed for")
    return of_machine


def _delay(of_machine: Timing | None) -> int:
    return 1 if of_machine is None else of_machine.delay_samples


def check_clock(dt: float, timing: Timing, what: str) -> None:
    """Refuses records whose sample time dt [s] is not that of the loop; what: which records. Raises
    InvalidInput.
    """
    if same_clock(dt, timing.sample_time):
        return
    slower = dt > timing.sample_time
    remedy = "record every sample, or give" if slower else "give"
    raise invalid(
        f"the sample rate of {what}",
        f"{1 / dt:g} Hz",
        f"the controller's, {timing.rate:g} Hz",
        f"{remedy} the controller that ran, or its sample_time in [controller]",
    )
