"""A controller of another program on the machine that it is for: do its axes, sign and units hold
the loop?
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import pi
from typing import Any

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace
from ambrose.judge.certificate import certify_envelope
from ambrose.judge.result import Synthesis
from ambrose.law.loop import match_axes
from ambrose.law.pid import modes
from ambrose.law.sampling import check_rate
from ambrose.law.timing import timing_of
from ambrose.machine.controller import modal_channels
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant

_UNITS = {
    1.0: "",
    1e3: "in mm (--input-unit mm)",
    1e6: "in um (--input-unit um)",
    1e-3: "with a gain 1e3 times smaller",
    1e-6: "with a gain 1e6 times smaller",
}
_FALLEN = 0.2  # of the largest real part, to which another unit must lower it to be worth a word
_SIGNS = {1.0: "", -1.0: "of the other sign (--input displacement turns it)"}


def named_for(machine: Machine, system: StateSpace) -> StateSpace:
    """The controller with the machine's axes in their order; one whose channels are translate_x,
    tilt_y ... (machine/controller.py) with the rotor's coordinates around it. Raises InvalidInput
    where its channels are others.
    """
    own = [name.removeprefix("err_") for name in system.inputs]
    modal = modal_channels(len(machine.bearings))
    if own and set(own) <= set(modal) and not set(own) & set(machine.axes):
        return _between_modes(machine, system, own, modal)
    if missing := [axis for axis in machine.axes if axis not in own]:
        remedy = f"name its channels in their order (--axes), or add those of {', '.join(missing)}"
        raise invalid(
            "the axes of the controller",
            ", ".join(own),
            f"those of {machine.name}, {', '.join(machine.axes)}",
            remedy,
        )
    return match_axes(system, machine.axes, machine.name)


def _between_modes(
    machine: Machine, system: StateSpace, own: Sequence[str], modal: Sequence[str]
) -> StateSpace:
    """Behind measured displacements to channels, before channels to currents; a channel that it
    lacks is not controlled. Raises InvalidInput.
    """
    given = [name.removeprefix("u_") for name in system.outputs]
    if sorted(given) != sorted(own):
        raise invalid(
            "the outputs of the controller",
            ", ".join(given),
            f"those of its inputs, {', '.join(own)}",
            "name both alike",
        )

    # u = out K into err, the rows and columns of the channels that it has
    into, out = modes(machine)
    into = into[[modal.index(name) for name in own]]
    out = out[:, [modal.index(name) for name in given]]
    return StateSpace(
        system.A,
        system.B @ into,
        out @ system.C,
        out @ system.D @ into,
        [f"err_{axis}" for axis in machine.axes],
        [f"u_{axis}" for axis in machine.axes],
        system.dt,
    )


def resampled(
    law: Synthesis, rate: float | None, method: Any, prewarp_hz: float | None
) -> Synthesis:
    """A continuous controller sampled at a rate [Hz]. Raises InvalidInput."""
    if rate is None:
        raise InvalidInput(
            "--sampling needs the rate at which the controller will run; give it with --rate-hz"
        )
    if law.scheduled is not None:
        raise InvalidInput(
            "a scheduled controller is sampled as it is exported; leave --sampling out"
        )
    dt = 1 / check_positive(rate, "the sample rate", "give it in Hz")
    prewarp = None if prewarp_hz is None else 2 * pi * prewarp_hz
    check_rate(law.controller, dt)
    if law.controller.dt is not None:
        raise InvalidInput(
            f"it is sampled already, at {1 / law.controller.dt:g} Hz; leave --sampling out"
        )
    note = f"sampled at {rate:g} Hz by {method}" + (
        "" if prewarp_hz is None else f", exact at {prewarp_hz:g} Hz"
    )
    sampled = c2d(law.controller, dt, method, prewarp=prewarp)
    settings = {
        key: value
        for key, value in (law.provenance.settings or {}).items()
        if key == "delay_samples"
    }
    made = replace(law.provenance, settings=settings or None, digest=None)
    return Synthesis(sampled, law.method, notes=(*law.notes, note), provenance=made)


def not_held(
    machine: Machine,
    law: Synthesis,
    progress: Callable[[str], None] = lambda stage: None,
    other_feedback: Callable[[], Synthesis] | None = None,
) -> list[str]:
    """Where the loop, as it runs on the full plant, is unstable; with the sign and the unit that
    would hold it, in a sentence.

    other_feedback: the controller with a1 and a2 of the other sign. Empty: it is stable at every
    operating point. Raises InvalidInput.
    """
    progress("closing the loop at every operating point")
    plants = [assemble(machine, point) for point in machine.operation.envelope]
    lost = _lost(plants, law, machine)
    if not lost:
        return []
    progress("trying other signs and units")
    others = [(sign, unit) for unit in _UNITS for sign in _SIGNS if (sign, unit) != (1.0, 1.0)]
    points = ", ".join(f"{label} ({abscissa:+.4g} rad/s)" for label, abscissa in lost.items())
    if other_feedback is not None and len(_lost(plants, other_feedback(), machine)) < len(lost):
        return [
            f"the loop is unstable at {points}, and not with a1 and a2 of the other sign, as "
            "CMSIS-DSP and SigmaDSP write them; turn the sign of a1 and a2 in the file"
        ]
    counts = {pair: _lost(plants, _scaled(law, pair[0] * pair[1]), machine) for pair in others}
    best = min(others, key=lambda pair: (len(counts[pair]), max(counts[pair].values(), default=0)))
    before, after = (max(of.values(), default=0.0) for of in (lost, counts[best]))
    check = (
        "check the order of the axes, the rate and the delay"
        if len(lost) == len(plants)
        else "it holds the others"
    )
    words = " and ".join(filter(None, (_SIGNS[best[0]], _UNITS[best[1]])))
    if len(counts[best]) >= len(lost):
        if len(counts[best]) == len(lost) and after < _FALLEN * before:
            return [
                f"the loop is unstable at {points}; were the controller {words}, still, but with "
                f"{after:+.4g} rad/s at most: if that is its unit, {check}"
            ]
        return [
            f"the loop is unstable at {points}, and no other sign or unit of length (m, mm, um) "
            f"does better; {check}"
        ]
    where = "everywhere" if not counts[best] else f"but for {', '.join(counts[best])}"
    return [
        f"the loop is unstable at {points}; were the controller {words}, it would be stable "
        f"{where}: u = K (r - y) in A and m"
    ]


def _lost(plants: Sequence[Plant], law: Synthesis, machine: Machine) -> dict[str, float]:
    """Spectral abscissa [rad/s] at the operating points where the loop is unstable."""
    envelope = certify_envelope(plants, law, timing_of(machine, law)).certificate.envelope
    return {label: abscissa for label, abscissa in envelope.items() if not abscissa < 0}


def _scaled(law: Synthesis, factor: float) -> Synthesis:
    K = law.controller
    return replace(
        law, controller=StateSpace(K.A, K.B * factor, K.C, K.D * factor, K.inputs, K.outputs, K.dt)
    )
