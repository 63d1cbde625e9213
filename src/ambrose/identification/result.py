"""What an identification gives, whatever its method: parameters, findings, the updated machine,
plain data, provenance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import date
from typing import Any, NamedTuple

import numpy as np

from ambrose.core.presentation import Presented, data_frame, html_table, in_words, with_unit
from ambrose.identification.findings import Code, Finding
from ambrose.identification.frf_spectral import Frf
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.output_error.magnetic_force import MagneticForce
from ambrose.identification.parameters import COVERAGE, unit_of, update_machine
from ambrose.identification.seal.by_pressure import SealByPressure
from ambrose.identification.static_load import StaticLoad
from ambrose.identification.validation.places import Standing, load_remarks
from ambrose.identification.validation.repeatability import Repeats, SimulatedOutput
from ambrose.identification.youla import ResidualIdentification
from ambrose.law.law import LawLike
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY
from ambrose.machine.units import one_line
from ambrose.version import __version__


@dataclass(frozen=True, slots=True)
class Provenance:
    """Names of the records' files and of the controller's, the date (ISO, today if empty), and in
    words what part of the records was taken (empty: all of them).
    """

    records: tuple[str, ...] = ()
    controller: str = ""
    date: str = field(default_factory=lambda: date.today().isoformat())
    part: str = ""

    def __post_init__(self) -> None:
        # they stand in files of text
        object.__setattr__(self, "records", tuple(map(one_line, self.records)))
        object.__setattr__(self, "controller", one_line(self.controller))

    @property
    def of_records(self) -> str:
        return ", ".join(self.records) or "records in memory"


@dataclass(frozen=True, slots=True)
class IdentifiedParameter:
    """A parameter in SI: where its value began, where it ended, and the standard deviation that
    noise makes.
    """

    path: str
    unit: str
    start: float
    value: float
    standard_deviation: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        half = COVERAGE * self.standard_deviation
        return self.value - half, self.value + half

    def to_dict(self) -> dict[str, Any]:
        return {**asdict(self), "interval_95": list(self.interval)}


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Identification(Presented, ABC):
    """The result of ``identify``: a LoopIdentification or a StaticIdentification.

    given: the machine as it was; machine: with the identified values, and tolerances as wide as
    they are uncertain. result: values with their covariance, as the method left them. checks:
    findings about the records, and about what can be true of the result. repeats: what every record
    alone gives, where that was asked for.
    """

    given: Machine
    machine: Machine
    result: ParameterEstimate | StaticLoad
    checks: tuple[Finding, ...] = ()
    repeats: Repeats | None = None
    provenance: Provenance = field(default_factory=Provenance)

    @property
    @abstractmethod
    def method(self) -> str:
        """ "closed-loop", "youla" or "static"."""

    @property
    def parameters(self) -> tuple[IdentifiedParameter, ...]:
        """In the order of ``result.paths``."""
        result = self.result
        numbers = (
            result.start.tolist(),
            result.values.tolist(),
            result.standard_deviations.tolist(),
        )
        rows = zip(result.paths, *numbers, strict=True)
        return tuple(IdentifiedParameter(path, unit_of(path), *values) for path, *values in rows)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Everything that makes the result doubtful, each with its code."""
        return (*self.checks, *self.result.warnings)

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """The findings but for the verdict on the residuals."""
        return tuple(finding for finding in self.findings if finding.code != Code.RESIDUALS)

    @property
    def passed(self) -> bool:
        """Nothing doubtful: neither in the records nor in the result."""
        return not self.findings

    @property
    def verdict(self) -> str:
        """One sentence on the residuals, or on the straightness of force over current."""
        return self.result.verdict

    @property
    @abstractmethod
    def origin(self) -> str:
        """One line for the machine's ``source``."""

    @abstractmethod
    def _heading(self) -> list[str]:
        """The first lines of ``comment``."""

    def _remark(self, i: int) -> str:
        """What else the comment says of parameter number i."""
        return f"began at {self.result.start[i]:.6g}"

    def _appendix(self) -> list[str]:
        """A last paragraph of the comment."""
        return []

    @property
    def comment(self) -> str:
        """Where the values are from, as a comment to stand above the machine's file."""
        part = self.provenance.part
        lines = [
            *self._heading(),
            *([f"{part[:1].upper()}{part[1:]}."] if part else []),
            f"Verdict: {self.verdict}",
            *[f"Warning: {finding}" for finding in self.doubts],
        ]
        lines += [
            f"  {row.path} = {with_unit(row.value, row.unit, 6)}, standard deviation "
            f"{row.standard_deviation:.2g}, "
            f"{self._remark(i)}"
            for i, row in enumerate(self.parameters)
        ]
        appendix = self._appendix()
        return as_comment(lines) + (as_comment(appendix) if appendix else "")

    def updated(self) -> Identification:
        """The same with ``machine`` made from the result. Raises InvalidInput for what a machine
        file cannot hold.
        """
        return replace(
            self,
            machine=update_machine(self.given, self.result, origin=self.origin, keep_wider=True),
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, SI."""
        point = self.result.point
        return {
            "machine": self.result.machine,
            "method": self.method,
            "point": {"speed_rad_s": point.speed, "seal_pressure_pa": point.seal_pressure},
            "good": self.passed,
            "verdict": self.verdict,
            "parameters": [row.to_dict() for row in self.parameters],
            "findings": [{**asdict(one), "code": str(one.code)} for one in self.checks],
            "warnings": [str(finding) for finding in self.result.warnings],
            "repeats": None if self.repeats is None else self.repeats.to_dict(),
        }

    def to_frame(self) -> Any:
        """The parameters as a pandas DataFrame, a row each. Raises InvalidInput where pandas is not
        installed.
        """
        rows = [{**row.to_dict(), "interval_95": row.interval} for row in self.parameters]
        return data_frame({name: [row[name] for row in rows] for name in rows[0]}, "path")

    def facts(self) -> Mapping[str, Any]:
        return {
            "machine": self.result.machine,
            "method": self.method,
            "parameters": len(self.result.paths),
            "passed": self.passed,
            "findings": [str(finding.code) for finding in self.findings],
        }

    def _repr_html_(self) -> str:
        rows = [
            [
                row.path,
                *map(in_words, (row.start, row.value, COVERAGE * row.standard_deviation)),
                row.unit,
            ]
            for row in self.parameters
        ]
        table = html_table(rows, self.verdict, ("parameter", "start", "value", "± 95 %", "unit"))
        return (
            table + html_table([[str(finding)] for finding in self.doubts], "Findings")
            if self.doubts
            else table
        )


class ResponseFit(NamedTuple):
    """One measured path of a ``record.response.QUANTITIES`` and its model's values (w,) with the
    parameters found and with those at the start.
    """

    quantity: str
    measured: Frf
    identified: np.ndarray
    start: np.ndarray


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class LoopIdentification(Identification):
    """From closed-loop records. outputs: every record beside the model; controller, computing_delay
    [samples], bending_modes: how the loop was modelled. residual: what else the method "youla" gave
    (None: the method was "closed-loop"). seal: the seal's coefficients at every pressure, all else
    as in ``result``, where they were asked for. magnets: the nonlinearity that was taken out of the
    records beforehand (None: it was not certain, or the method another). seen_delay [samples]: of u
    behind the controller, taken as known although it was asked for. standing: where the rotor stood
    off the sensors' zero, to which the values are carried (None: it stood there). found_along: what
    numbers of the machine file were found along, in words. notes: what was not checked, and how
    the loop was modelled, in words. responses: measured and modelled, of frequency responses.
    """

    result: ParameterEstimate
    outputs: tuple[SimulatedOutput, ...]
    controller: LawLike
    computing_delay: float
    bending_modes: int
    residual: ResidualIdentification | None = None
    seal: SealByPressure | None = None
    magnets: MagneticForce | None = None
    seen_delay: int | None = None
    standing: Standing | None = None
    found_along: str = ""
    notes: tuple[str, ...] = ()
    responses: tuple[ResponseFit, ...] = ()

    @property
    def method(self) -> str:
        return "closed-loop" if self.residual is None else "youla"

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the reader must know of the values beside the file's, a sentence each without its
        stop; no doubts.
        """
        loads = {} if self.magnets is None else self.magnets.loads
        at_zero = {} if self.standing is None else self.standing.currents
        records = [output.record for output in self.outputs]
        remarks = load_remarks(self.given, records, loads, at_zero)
        if self.found_along:
            remarks = (self.found_along, *remarks)
        if self.standing is not None and self.standing.words:
            remarks = (self.standing.words, *remarks)
        if self.seen_delay is not None:
            remarks = (
                f"u follows the controller after {self.seen_delay} samples, which was taken as "
                "its delay",
                *remarks,
            )
        remarks = remarks if self.magnets is None else (self.magnets.words, *remarks)
        remarks = (self.provenance.part, *remarks) if self.provenance.part else remarks
        remarks = (*remarks, *self.notes)
        return remarks if self.seal is None or not self.seal.note else (*remarks, self.seal.note)

    @property
    def findings(self) -> tuple[Finding, ...]:
        findings = (*self.checks, *self.result.warnings)
        return findings if self.seal is None else (*findings, *self.seal.findings)

    @property
    def origin(self) -> str:
        how = "" if self.residual is None else " by the Youla residual"
        count, source = len(self.result.paths), self.provenance
        text = f"{count} parameters identified {source.date}{how} from {source.of_records}"
        text += f" with {source.controller}" if source.controller else ""
        text += "" if self.result.converged else " (NOT converged)"
        return text if self.seal is None else f"{text}; {self.seal.origin}"

    def _heading(self) -> list[str]:
        point, source = self.result.point, self.provenance
        with_controller = f" (controller {source.controller})" if source.controller else ""
        return [
            f"Identified {source.date} by ambrose {__version__} from "
            f"{source.of_records}{with_controller},",
            f"at {point.speed:g} rad/s and a seal pressure of {point.seal_pressure:g} Pa.",
            "The values below are in the file; its tolerances are their 95 % intervals, unless a "
            "seal's stated one is wider.",
        ]

    def _appendix(self) -> list[str]:
        return [] if self.seal is None else self.seal.lines

    def updated(self) -> Identification:
        if self.seal is None:
            with_values = Identification.updated(self)
            return replace(with_values, machine=self._with_delay_as_run(with_values.machine))
        with_seal = self.seal.update(self.given, self.result)
        return replace(
            self,
            machine=replace(
                with_seal,
                source="; ".join(part for part in (self.given.source, self.origin) if part),
            ),
        )

    def _with_delay_as_run(self, machine: Machine) -> Machine:
        """The machine whose [controller] has the delay of the one that ran; unchanged where the
        file states no rate, or another one than the records', or where the delay was identified.
        """
        settings = machine.controller
        if (
            settings is None
            or machine.whole is not machine  # whose settings are part of another file
            or settings.sample_time is None
            or CONTROLLER_DELAY in self.result.paths
            or not self.outputs
        ):
            return machine
        dt = self.outputs[0].record.dt

        # equal but for the rounding of a rate and of a delay that is written in seconds
        stated = settings.sample_time if settings.delay is None else settings.delay
        if (
            abs(settings.sample_time / dt - 1) > 1e-6
            or abs(stated / dt - self.computing_delay) < 1e-6
        ):
            return machine
        return replace(machine, controller=replace(settings, delay=self.computing_delay * dt))

    def to_dict(self) -> dict[str, Any]:
        result, residual = self.result, self.residual
        error = (
            None
            if residual is None or not np.isfinite(residual.controller_error)
            else residual.controller_error
        )
        data = Identification.to_dict(self) | {
            "correlation": result.correlation.tolist(),
            "column_cosine": result.column_cosine.tolist(),
            "fit_percent": [
                {"record": n, "signal": name, "fit": float(fit)} for n, name, fit in result.fit
            ],
            "residual_tests": [asdict(test) for test in result.tests],
            "turning": [asdict(wave) for wave in result.turning],
            "converged": result.converged,
            "iterations": result.iterations,
            "controller_error": error,
            "remarks": list(self.remarks),
        }
        return data if self.seal is None else data | {"seal": self.seal.to_dict()}


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class StaticIdentification(Identification):
    """From static loads: the result also holds the levels, and the slopes at the unloaded working
    point.
    """

    result: StaticLoad

    @property
    def method(self) -> str:
        return "static"

    @property
    def origin(self) -> str:
        source = self.provenance
        return (
            f"{len(self.result.paths)} values of K_i identified {source.date} by static loads from "
            f"{source.of_records}"
        )

    def _heading(self) -> list[str]:
        count = len(self.result.levels.loads)
        return [
            f"Identified {self.provenance.date} by ambrose {__version__} from static loads in "
            f"{self.provenance.of_records},",
            f"{count} steady levels. Slope of the line over these loads, and at the unloaded "
            "working point.",
        ]

    def _remark(self, i: int) -> str:
        return (
            f"at rest {self.result.at_rest[i]:.6g}, in the file before {self.result.start[i]:.6g}"
        )

    def to_dict(self) -> dict[str, Any]:
        data, result = Identification.to_dict(self), self.result
        columns = {
            "at_rest": result.at_rest,
            "at_rest_standard_deviation": result.at_rest_deviations,
            "share_by_displacement": result.stiffness_share,
            "linearity": result.linearity,
        }
        for i, row in enumerate(data["parameters"]):
            row.update({name: float(column[i]) for name, column in columns.items()})
        return data | {"levels": len(result.levels.loads)}


def as_comment(lines: Sequence[str]) -> str:
    """Lines for the head of a TOML file; those that begin with a space belong to the one above."""
    plain = (one_line(" ".join(line.splitlines()) if line[0] != " " else line) for line in lines)
    return "".join(f"#{'' if line[0] == ' ' else ' '}{line}\n" for line in plain) + "\n"
