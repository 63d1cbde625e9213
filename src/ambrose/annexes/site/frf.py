"""Frequency responses of the running machine, open and closed loop, with their intervals and beside
the model's.

Excitation currents e_<axis> give y/e, and with recorded currents S_i = v/e (v = u + e), hence the
open loop 1/S_i - 1 of every axis driven by itself, and with all axes driven the plant y/v: no
controller need be known. References give y/r and S_o = 1 - y/r; forces f_<port> the compliance.

found = respond(machine, ["chirp.h5"])
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.site.acceptance import phase_margin, share, telling, where
from ambrose.core.checks import InvalidInput, as_several
from ambrose.core.frequency import FrequencyResponse, frequency_response
from ambrose.core.presentation import Presented
from ambrose.core.statespace import StateSpace, select
from ambrose.identification.data_quality.signals import signal_findings
from ambrose.identification.findings import WARNING, Code, Finding, refuse
from ambrose.identification.frf import (
    DISAGREES,
    IN_WORDS,
    LoopFrf,
    Validity,
    compare,
    measure,
    model_response,
)
from ambrose.identification.frf_spectral import Frf
from ambrose.identification.validation.places import machine_at_load
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import Timing, closed_loop, running_law, timing_of
from ambrose.machine.criteria import TWO_PI
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.record.files import names_of_files, read_record
from ambrose.record.record import Record
from ambrose.record.response import Path as MeasuredPath, Response

_UNSURE = 0.3  # 95 % radius over the largest response, from which a line tells little
_FEW = 0.1  # of the lines that may do so without a word
_NEAR_SPEED = 1.0  # [Hz]


@dataclass(frozen=True, slots=True, eq=False)
class ComparedResponse:
    """One transfer matrix: measured, and the model's on the same lines (None: nothing to compare
    with); what: "motion", "plant", "sensitivity" (of each axis driven by itself, 1x1); title: in
    words.
    """

    what: str
    title: str
    measured: Frf
    model: FrequencyResponse | None

    @property
    def validity(self) -> Validity | None:
        """Line by line whether the model agrees within 10 % and 10 degrees."""
        return None if self.model is None else compare(self.measured, self.model)

    @property
    def agreement(self) -> np.ndarray | None:
        """Share (p, m) of the lines at which the model does not disagree."""
        validity = self.validity
        return None if validity is None else (validity.verdict != DISAGREES).mean(axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class PointResponse:
    """The loop at one operating point."""

    point: OperatingPoint
    loop: LoopFrf
    responses: tuple[ComparedResponse, ...]
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]

    @property
    def label(self) -> str:
        """The point's label, else its speed and pressure."""
        return (
            self.point.label
            or f"{self.point.speed / TWO_PI:.4g} Hz, {self.point.seal_pressure / 1e5:.4g} bar"
        )

    def of(self, what: str) -> list[ComparedResponse]:
        """The responses of one kind."""
        return [item for item in self.responses if item.what == what]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Responses(Presented):
    """Frequency responses at every operating point of the records; timing: of the loop that was
    modelled, in words; controller: what a page calls the one that ran.
    """

    machine: Machine
    points: tuple[PointResponse, ...]
    timing: str = ""
    records: tuple[str, ...] = ()
    controller: str = ""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What makes any of it doubtful."""
        return tuple(finding for point in self.points for finding in point.findings)

    def facts(self) -> dict[str, Any]:
        """How they were measured, and how many lines there are."""
        return {
            "machine": self.machine.name,
            "points": [
                f"{p.label}: {len(p.loop.closed.omega)} lines, {p.loop.method}" for p in self.points
            ],
            "findings": len(self.findings),
        }

    def rows(self) -> Iterator[tuple[str, str, str, str, float, complex, float, float]]:
        """Operating point, response, input, output, frequency [Hz], value, 95 % radius, coherence
        of the output; SI.
        """
        for point in self.points:
            for item in point.responses:
                frf, radius = item.measured, item.measured.radius()
                for j, source in enumerate(frf.inputs):
                    for i, target in enumerate(frf.outputs):
                        for w, omega in enumerate(frf.omega):
                            yield (
                                point.label,
                                item.what,
                                source,
                                target,
                                float(omega / TWO_PI),
                                complex(frf.values[w, i, j]),
                                float(radius[w, i, j]),
                                float(frf.coherence[w, i]),
                            )

    def to_response(self) -> Response:
        """The motion under excitation currents, as ``identify`` takes it. Raises InvalidInput for
        several operating points, and for other excitations.
        """
        axes, frf = self.machine.axes, self.points[0].loop.motion
        names = {f"e_{axis}": axis for axis in axes}
        if len(self.points) > 1 or not set(frf.inputs) <= set(names):
            raise InvalidInput(
                "responses of one operating point under currents e_<axis>, each by itself, can be "
                "kept as a file of responses; write the table as *.csv"
            )
        paths = [
            MeasuredPath(
                "motion", target[2:], names[source], frf.values[:, i, j], frf.variance[:, i, j]
            )
            for j, source in enumerate(frf.inputs)
            for i, target in enumerate(frf.outputs)
            if target.startswith("y_")
        ]
        point, rate = self.points[0].point, 1 / frf.dt
        return Response(self.machine.name, frf.omega, tuple(paths), point, sample_rate_hz=rate)

    def to_csv(self) -> str:
        """The rows as text, a line each."""
        head = (
            "point,response,input,output,frequency_hz,real,imag,magnitude,phase_deg,radius_95,"
            "coherence"
        )
        lines = [
            f'"{label}",{what},{source},{target},{f:.8g},{G.real:.8g},{G.imag:.8g},{abs(G):.8g},'
            f"{np.degrees(np.angle(G)):.6g},{radius:.4g},{coherence:.6g}"
            for label, what, source, target, f, G, radius, coherence in self.rows()
        ]
        return "\n".join([head, *lines, ""])

    def to_dict(self) -> dict[str, Any]:
        """Everything measured, SI, ready for JSON."""
        return {
            "machine": self.machine.name,
            "timing": self.timing,
            "records": list(self.records),
            "points": [
                {
                    "label": p.label,
                    "method": p.loop.method,
                    "periods": p.loop.periods,
                    "excitations": [list(group) for group in p.loop.together],
                    "notes": list(p.notes),
                    "findings": [str(finding) for finding in p.findings],
                    "axes": summary(p),
                    "responses": [_plain(item) for item in p.responses],
                }
                for p in self.points
            ],
        }


def respond(
    machine: Machine,
    records: Record | str | Path | Sequence[Record | str | Path],
    controller: LawLike | None = None,
    *,
    method: str | None = None,
    band: tuple[float, float] = (0.0, np.inf),
    harmonics: int = 3,
    settle: float | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> Responses:
    """The frequency responses that records of the running machine tell, at every operating point
    among them.

    records: as they are or their files, with displacements y_<axis> and any of the excitations
    e_<axis> [A], r_<axis> [m] and f_<port> [N]; chirps, binary sequences, multisines, stepped sines
    and noise. controller: the one that ran (None: only the plant is compared with the model's).
    method "sines", "periods" or "polynomials" (None: what suits the excitation); band [rad/s]:
    kept; harmonics: multiples of the speed taken out; settle [s]: left out of each sine. Raises
    InvalidInput.
    """
    several = as_several(records)
    if not several:
        raise InvalidInput("no record was given; record y_<axis> with an excitation e_<axis>")
    progress(f"reading {len(several)} record{'s' * (len(several) > 1)}")
    read, names = [read_record(item) for item in several], names_of_files(several)
    findings: list[Finding] = []
    for number, record in enumerate(read, 1):
        missing = [f"y_{axis}" for axis in machine.axes if f"y_{axis}" not in record.signals]
        if missing:
            raise InvalidInput(
                f"record {number} lacks {', '.join(missing)}; record every displacement together"
            )
        findings += [
            one
            for one in signal_findings(machine, record, number)
            if one.code != Code.NO_EXCITATION
        ]
    refuse(findings)

    # records of one operating point go together, whatever their label
    groups: dict[OperatingPoint, list[Record]] = {}
    for record in read:
        groups.setdefault(replace(record.point, label=""), []).append(record)
    timing = Timing(read[0].dt)
    if controller is not None:
        timing = timing_of(machine, controller, 1 / read[0].dt) or timing
    done = []
    for group in groups.values():
        progress(f"measuring at {group[0].point.label or 'the operating point of the records'}")
        loop = measure(
            group, machine.axes, method=method, band=band, harmonics=harmonics, settle=settle
        )
        model = _Model(machine, group, controller, timing)
        responses = tuple(_responses(machine, loop, model))
        done.append(
            PointResponse(
                group[0].point,
                loop,
                responses,
                tuple(_doubts(loop, group[0].point)),
                tuple(_notes(loop, group[0])),
            )
        )
    done[0] = replace(done[0], findings=(*findings, *done[0].findings))
    if controller is None:
        return Responses(machine, tuple(done), "", names)
    return Responses(machine, tuple(done), str(timing), names, law_of(controller).named)


class _Model:
    """The machine at the static load of the records: its plant, and its loop where the controller
    is known, sampled.
    """

    def __init__(
        self,
        machine: Machine,
        records: Sequence[Record],
        controller: LawLike | None,
        timing: Timing,
    ) -> None:
        self.plant = assemble(machine_at_load(machine, records), records[0].point)
        self.loop: StateSpace | None = None
        if controller is not None:
            law = running_law(controller, self.plant, timing)
            self.loop = closed_loop(self.plant, law)
        self.dt = timing.sample_time

    def plant_response(self, measured: Frf) -> FrequencyResponse:
        return model_response(measured, self.plant.system)

    def loop_response(
        self, measured: Frf, together: Sequence[tuple[str, ...]]
    ) -> FrequencyResponse | None:
        """From all excitations of each group at once; v is u + e."""
        if self.loop is None or any(
            name not in self.loop.inputs for group in together for name in group
        ):
            return None

        # v = u + e: the response of u, and 1 from its own e
        inputs = [name for group in together for name in group]
        outputs = [f"u_{name[2:]}" if name.startswith("v_") else name for name in measured.outputs]
        values = frequency_response(select(self.loop, inputs, outputs), measured.omega).values
        for j, source in enumerate(inputs):
            for i, target in enumerate(measured.outputs):
                values[:, i, j] += target.startswith("v_") and source == f"e_{target[2:]}"

        # axes driven alike: the sum of their columns
        starts = np.cumsum([0, *(len(group) for group in together)])
        summed = np.stack(
            [values[:, :, a:b].sum(axis=2) for a, b in pairwise(starts.tolist())], axis=2
        )
        return FrequencyResponse(summed, measured.omega, measured.inputs, measured.outputs)


def _responses(machine: Machine, loop: LoopFrf, model: _Model) -> Iterator[ComparedResponse]:
    """Of one operating point, measured beside the model: the motion, the sensitivity of every axis
    that is driven by itself, and the plant where currents drive all axes apart.
    """
    motion = loop.motion
    yield ComparedResponse(
        "motion",
        "Closed loop: excitation to displacement",
        motion,
        model.loop_response(motion, loop.together),
    )
    for group in loop.together:
        # S_o of an axis: v/e directly, or 1 - y/r; not told where axes are driven alike
        kind, axis = group[0][:2], group[0][2:]
        if len(group) > 1 or axis not in machine.axes or (kind == "e_" and not loop.commanded):
            continue
        measured = loop.closed.select(group[0], f"v_{axis}" if kind == "e_" else f"y_{axis}")
        predicted = model.loop_response(measured, [group])
        if kind == "r_":  # S_o = 1 - T_o
            measured = replace(measured, values=1 - measured.values)
            predicted = (
                None if predicted is None else replace(predicted, values=1 - predicted.values)
            )
        yield ComparedResponse(
            "sensitivity", f"Sensitivity of {axis}, the other loops closed", measured, predicted
        )

    # the plant needs currents as excitations throughout
    plant = loop.plant
    if plant is not None and all(
        name.startswith("e_") for group in loop.together for name in group
    ):
        yield ComparedResponse(
            "plant", "Plant: current command to displacement", plant, model.plant_response(plant)
        )


def open_loop(sensitivity: Frf) -> Frf:
    """L = 1/S - 1 of a sensitivity (w, 1, 1), with |dL| = |dS|/|S|^2."""
    S = sensitivity.values
    return replace(sensitivity, values=1 / S - 1, variance=sensitivity.variance / np.abs(S) ** 4)


def heard(sensitivity: Frf) -> np.ndarray:
    """The lines (w,) at which a sensitivity (w, 1, 1) tells anything."""
    S = np.abs(sensitivity.values[:, 0, 0])
    return telling(S, sensitivity.radius()[:, 0, 0], None)


def summary(point: PointResponse) -> list[dict[str, Any]]:
    """What an axis driven by itself tells: the largest sensitivity with its 95 % interval and
    where, the phase margin and the frequency of unit gain, SI, of the lines that tell anything;
    told: which part of the band they are; predicted: the model's largest.
    """
    rows = []
    for item in point.of("sensitivity"):
        frf = item.measured
        S, radius = np.abs(frf.values[:, 0, 0]), frf.radius()[:, 0, 0]
        clear = heard(frf)
        margin, at = phase_margin(frf.omega, open_loop(frf).values[:, 0, 0], clear)
        size = np.where(clear, S, -np.inf)
        k = int(np.argmax(size))
        some = bool(clear.any())
        rows.append(
            {
                "axis": frf.inputs[0][2:],
                "told": share(frf.omega, clear),
                "silent": where(frf.omega, clear),
                "peak": float(S[k]) if some else None,
                "peak_95": [float((size - radius).max()), float((size + radius).max())]
                if some
                else None,
                "at": float(frf.omega[k]) if some else None,
                "phase_margin": margin if np.isfinite(margin) else None,
                "unit_gain_at": at if np.isfinite(at) else None,
                "predicted": None if item.model is None else float(np.abs(item.model.values).max()),
            }
        )
    return rows


def _doubts(loop: LoopFrf, point: OperatingPoint) -> Iterator[Finding]:
    """Responses that are poorly known at many lines, and sines at the speed of the rotor."""
    motion = loop.motion

    # the largest entry of each column: small ones beside it may well be unsure
    size, radius = np.abs(motion.values).max(axis=1), motion.radius().max(axis=1)
    for j, group in enumerate(loop.together):
        weak = radius[:, j] > _UNSURE * size[:, j]
        if weak.mean() > _FEW:
            f = motion.omega[weak] / TWO_PI
            what = (
                f"the response to {' with '.join(group)} is poorly known at {weak.sum()} of "
                f"{len(weak)} lines"
            )
            evidence = (
                f"{f.min():.4g} to {f.max():.4g} Hz, 95 % radius over {100 * _UNSURE:g} % of the "
                "largest displacement"
            )
            remedy = "excite more there, record longer, or leave the band out"
            yield Finding(Code.UNCERTAIN_LINES, WARNING, what, evidence, remedy)
    if loop.method == "sines" and point.speed:
        for f in motion.omega / TWO_PI:
            if abs(f - point.speed / TWO_PI) < _NEAR_SPEED:
                what = f"the step at {f:.4g} Hz lies at the speed of {point.speed / TWO_PI:.4g} Hz"
                remedy = "leave it out, or take records with and without excitation"
                yield Finding(Code.AT_SPEED, WARNING, what, "unbalance answers too", remedy)


def _notes(loop: LoopFrf, record: Record) -> Iterator[str]:
    """How it was measured, and what could not be, a sentence each."""
    f = loop.closed.omega / TWO_PI
    averaged = f", {loop.periods} averaged" if loop.periods else ""
    yield f"{IN_WORDS[loop.method]}{averaged}: {len(f)} lines from {f[0]:.4g} to {f[-1]:.4g} Hz"
    for group in loop.together:
        if len(group) > 1:
            yield (
                f"{' and '.join(group)} are driven by the same signal: the response is to both "
                f"together, per "
                "ampere of each"
            )
    driven = {name for group in loop.together for name in group}
    axes = [name[2:] for name in loop.closed.outputs if name.startswith("y_")]
    missing = [axis for axis in axes if f"e_{axis}" not in driven]
    if not loop.commanded:
        yield (
            "no u_<axis> in the records: open loop and plant are not measured; record the "
            "controller's "
            "currents, too"
        )
    elif any(len(group) > 1 for group in loop.together) or (
        missing and any(name.startswith("e_") for name in driven)
    ):
        alone = f"; {', '.join(missing)} not driven" if missing else ""
        yield (
            "the plant needs every axis driven by a pattern of its own, in one record or "
            f"several{alone}"
        )
    if record.point.speed:
        yield (
            "what turns with the rotor is taken out of every signal"
            if loop.method != "sines"
            else "unbalance was not taken out"
        )


def _plain(item: ComparedResponse) -> dict[str, Any]:
    """A compared response as plain data, SI."""
    frf, agreement = item.measured, item.agreement
    return {
        "response": item.what,
        "title": item.title,
        "inputs": list(frf.inputs),
        "outputs": list(frf.outputs),
        "omega": frf.omega.tolist(),
        "real": frf.values.real.tolist(),
        "imag": frf.values.imag.tolist(),
        "radius_95": frf.radius().tolist(),
        "coherence": frf.coherence.tolist(),
        "model_agrees": None if agreement is None else agreement.tolist(),
    }
