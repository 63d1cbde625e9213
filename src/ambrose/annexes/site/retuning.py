"""Retuning on site: from a record of the running machine to the change that is signed."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date as calendar
from itertools import chain as joined
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.site.acceptance import Acceptance, accept
from ambrose.api import controller_of, machine_of
from ambrose.chain.stages import resume_or_design
from ambrose.code.pipeline import Delivery, export as write_code
from ambrose.code.sampled import checksum_of
from ambrose.code.targets import C
from ambrose.core.checks import (
    AmbroseError,
    InvalidInput,
    NumericalFailure,
    UnstableSystem,
    as_several,
    invalid,
)
from ambrose.core.presentation import Presented, to_plain
from ambrose.identification.findings import Code
from ambrose.identification.output_error.problem import check_machine
from ambrose.identification.parameters import COVERAGE, half_width
from ambrose.identification.pipeline import identify
from ambrose.identification.responses import as_responses
from ambrose.identification.result import LoopIdentification, Provenance
from ambrose.judge.checks import Checks, Verification
from ambrose.judge.controller_file import write_controller
from ambrose.judge.measured import MEASURED, lines_of
from ambrose.judge.result import Status, Synthesis, synthesis_of
from ambrose.judge.verdict import verify_controller
from ambrose.law.law import LawLike
from ambrose.law.loop import Timing, check_clock, timing_of
from ambrose.law.pid import first_settings, pid_controller
from ambrose.machine.file.toml import machine_hash
from ambrose.machine.file.update import machine_text
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import claimed, make_folder, set_aside, write_json, write_text
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.static_load import residual_unbalance
from ambrose.record.files import read_record
from ambrose.record.record import Record
from ambrose.record.response import Measured, Response, digest_of, usable
from ambrose.record.response_files import write_response
from ambrose.rig.scenario import Scenario, Unbalance
from ambrose.rig.trace import Trace
from ambrose.rig.trial import simulate_scenario
from ambrose.synthesis.fixed_order.job import STATES_PER_AXIS
from ambrose.synthesis.methods import Tuned
from ambrose.version import __version__

# What a retuning gives: its steps with their verdicts, and what each of them made.


RETUNED = "retuned"
UNCHANGED = "no change needed"
STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the chain. name: its key; title: what was asked; passed: whether it holds (None:
    for information); words: the answer, with its figures; files: what it left in the folder.
    """

    name: str
    title: str
    passed: bool | None
    words: str
    files: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Moved:
    """A parameter that was identified: the file's value [SI], the one found with its 95 %
    half-width, and that of the file's own tolerance (None: it states none).
    """

    path: str
    unit: str
    file: float
    value: float
    half: float
    tolerance: float | None

    @property
    def change(self) -> float:
        """Relative to the file's value; NaN for a value of zero."""
        return self.value / self.file - 1 if self.file else float("nan")

    @property
    def certain(self) -> bool:
        """Whether the file's value lies outside the interval."""
        return abs(self.value - self.file) > self.half

    @property
    def beyond(self) -> bool:
        """Whether it moved by more than the file's own tolerance and the interval."""
        return (
            self.tolerance is not None and abs(self.value - self.file) > self.tolerance + self.half
        )


@dataclass(frozen=True, slots=True)
class Switch:
    """A change of the running controller on the rig.

    forward: from the running one to the new one (else the way back); trace: the run; bump,
    before [m]: the largest displacement from the mean in the half second after the change, and
    before it; allowed [m]: how far it may go.
    """

    forward: bool
    trace: Trace
    bump: float
    before: float
    allowed: float

    @property
    def passed(self) -> bool:
        """Whether the rotor stayed free; on the way forward, and hardly moved."""
        return self.trace.passed and (
            not self.forward or self.bump <= max(self.before, self.allowed)
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Retuning(Presented):
    """The steps of a retuning and what they made; what was not come to is None or empty.

    given: the machine file's; identification: its ``machine`` is the one that was designed for,
    with the intervals as its tolerances; moved: what differs from the file. running, new: the
    controllers; before, after: their verifications over the intervals of the identified machine.
    delivery: the new one's code, and the difference from the running one's. switches: the change
    and the way back, on the rig. acceptance: of the change, from records after it.
    """

    given: Machine
    running: Synthesis
    timing: Timing
    steps: tuple[Step, ...]
    folder: Path
    identification: LoopIdentification | None = None
    moved: tuple[Moved, ...] = ()
    before: Verification | None = None
    new: Synthesis | None = None
    after: Verification | None = None
    delivery: Delivery | None = None
    switches: tuple[Switch, ...] = ()
    acceptance: Acceptance | None = None
    unchanged: bool = False

    @property
    def machine(self) -> Machine:
        """As identified, else as given."""
        return self.given if self.identification is None else self.identification.machine

    @property
    def stopped_at(self) -> Step | None:
        """The first step that does not hold."""
        return next((step for step in self.steps if step.passed is False), None)

    @property
    def outcome(self) -> str:
        """ "retuned", "no change needed" or "stopped"."""
        if self.stopped_at is not None:
            return STOPPED
        return UNCHANGED if self.unchanged else RETUNED

    @property
    def passed(self) -> bool:
        """Whether every step holds."""
        return self.stopped_at is None

    @property
    def text(self) -> str:
        """The outcome in a sentence."""
        step = self.stopped_at
        if step is not None:
            return f"stopped: {step.title.lower()}: {step.words}"
        return f"{self.outcome}: {self.decided}"

    @property
    def decided(self) -> str:
        """What the outcome rests on: the sensitivities before and after, and on which plant."""
        named = {step.name: step for step in self.steps}
        if "compared" not in named:
            return self.steps[-1].words
        words, last = named["compared"].words, self.steps[-1]
        if "new measured" in named:
            alone = named["new measured"].words.startswith(_ALONE)
            words += (
                "; on the identified model alone, the responses do not decide"
                if alone
                else "; the measured plant decides where it was swept"
            )
        return words if last.name == "compared" else f"{words}; {last.words}"

    def facts(self) -> Mapping[str, Any]:
        return {
            "machine": self.given.name,
            "outcome": self.outcome,
            "steps": [step.name for step in self.steps],
        }

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data: the steps, what moved, the worst sensitivities before and after."""
        return to_plain(
            {
                "machine": self.given.name,
                "outcome": self.outcome,
                "timing": str(self.timing),
                "steps": [
                    {
                        "name": step.name,
                        "title": step.title,
                        "passed": step.passed,
                        "words": step.words,
                        "files": list(step.files),
                    }
                    for step in self.steps
                ],
                "parameters": [
                    {
                        "path": item.path,
                        "unit": item.unit,
                        "file": item.file,
                        "value": item.value,
                        "half_width_95": item.half,
                        "change": item.change,
                        "certain": item.certain,
                    }
                    for item in self.moved
                ],
                "before": None if self.before is None else dict(self.before.facts()),
                "after": None if self.after is None else dict(self.after.facts()),
                "folder": str(self.folder),
            }
        )


# Retuning in one call: READ FIRST. A record of the running machine -> what it is now -> whether its
# controller still does -> another one, proved, coded, changed without a bump, accepted.
#
#     done = retune("seal-rig", "running.h5", "running.json", "change")
#     done.outcome, done.text, done.steps
#
# Every step is what a command of its own does (identify, verify, synthesize, verify, export
# --replaces, simulate with switch_at, accept); the chain ends at the first that does not hold and
# keeps what was done.


IDENTIFIED, CONTROLLER = "identified.toml", "controller.json"
RUNNING = "running.json"  # beside what was measured while it ran
SAME_ORDER = "same-order.json"  # what exceeds a limit with as many states as before
CODE = "code"
_PEAK = "sensitivity.output.max"
STATE, PAGE = "retuning.json", "retuning.html"
UNDER_WAY = "under way"  # in the state of a chain that has not ended, or was cut off
_ALONE = "judged by the identified model alone"  # how a step begins whose responses do not tell
_HALF = 0.5  # s on either side of a change of controllers on the rig
_BUMP = 0.1  # of the gap, how far the rotor may go when its controllers change; assumed
_NARROW = 1e-4  # m, the gap where the machine file states none; assumed
_MOST = 3  # failed checks that are named
# what a machine shows that is known to have changed. One factor of all K_i and K_s may be the mass
# instead; currents and displacements, and so the loop, are the same then
_AS_CHANGED = {Code.FAR_FROM_FILE, Code.COMMON_FACTOR}
Progress = Callable[[str], None]
Records = Measured | Sequence[Measured]


def _quiet(stage: str) -> None:
    """Progress that nobody watches."""


@dataclass(slots=True)
class _Chain:
    """What was made so far."""

    given: Machine
    running: Synthesis
    timing: Timing
    folder: Path
    progress: Progress
    began: dict[str, Any]
    steps: list[Step]
    made: dict[str, Any]
    responses: tuple[Response, ...] = ()
    untold: str = ""  # why the last verification is not of the measured plant

    def keep(self, outcome: str | None = None) -> Retuning:
        """The state as it is now, kept in the folder; outcome: None as the steps say."""
        done = self.result()
        said = {} if outcome is None else {"outcome": outcome}
        kept = {"began": self.began, **done.to_dict(), **said}
        write_json(self.folder / STATE, kept, "state of the retuning")
        return done

    def say(self, name: str, title: str, passed: bool | None, words: str, *files: str) -> bool:
        """Note a step, so that it stays whatever comes; whether the chain goes on."""
        self.steps.append(Step(name, title, passed, words, files))
        self.keep(UNDER_WAY)
        return passed is not False

    def result(self) -> Retuning:
        return Retuning(
            given=self.given,
            running=self.running,
            timing=self.timing,
            steps=tuple(self.steps),
            folder=self.folder,
            **self.made,
        )


def retune(
    machine: Machine | str,
    records: Records,
    controller: LawLike | str | Path,
    directory: str | Path,
    *,
    unknown: str | Sequence[str] = (),
    bending_modes: int | None = None,
    accept_from: Records = (),
    anyway: bool = False,
    changed: bool = False,
    progress: Progress = _quiet,
) -> Retuning:
    """What a machine is now, whether its controller still does, and the proved, coded and tried
    change where it does not.

    machine: or a name or a file. records: with excitations e_<axis> [A] and displacements y_<axis>
    [m] of the running machine, with u_<axis> [A] best; or frequency responses of one operating
    point: then controllers are judged there on the measured plant. controller: the one that ran, a
    file or a law, fixed. directory: keeps identified.toml, controller.json, code/ and
    retuning.json; a run with the same arguments takes the design up again. unknown: what to
    identify, as for ``identify`` (empty: what is usual); bending_modes: per plane in the model that
    is fitted (None: as many as the data tell). accept_from: records with the new controller
    running, by which the change is accepted. changed: the machine is known to have changed beyond
    the file's own tolerances (a magnet exchanged, a seal worn), so that values there are no doubt.
    anyway: design a new one also where the running one meets every limit over the intervals. The
    identified intervals are the box that the controllers are judged over. Raises InvalidInput for
    what cannot be begun: a record of another machine or controller, one that carries nothing, a
    schedule in place of a fixed controller.
    """
    given = machine_of(machine)
    law = controller_of(controller, given)
    if law.fixed is None:
        raise invalid(
            "the running controller",
            "a schedule or a program",
            "a fixed one",
            "identify and synthesize step by step",
        )
    running = synthesis_of(law)
    if running.synchronous:
        raise InvalidInput(
            "the running controller has synchronous blocks; switch them off for the "
            "record, give the controller without them, and add them to the new one "
            "(synthesize --synchronous --base)"
        )
    read, responses, names = _read(records)
    timing = _timing(given, running, read, responses)
    folder = Path(directory)
    with claimed(folder, "folder"):
        make_folder(folder)
        wanted = as_several(unknown)
        began = _begun(folder, given, running, names, (*wanted, f"{bending_modes} modes"))
        chain = _Chain(given, running, timing, folder, progress, began, [], {}, responses)
        fit = {"unknown": unknown, "bending_modes": bending_modes}
        files = tuple(name for name, _ in names)
        _identified(chain, read, files, fit, changed=changed)
        if chain.steps[-1].passed is not False and _needed(chain, anyway):
            _changed(chain)
        if chain.steps[-1].passed is not False and as_several(accept_from):
            _accepted(chain, accept_from)
        return chain.keep()


def _read(
    records: Records,
) -> tuple[tuple[Record, ...], tuple[Response, ...], tuple[tuple[str, str], ...]]:
    """The records, or the responses, and of each its name and SHA-256."""
    several = as_several(records)
    if not several:
        raise InvalidInput("no record was given; record the machine running, with an excitation")
    responses = as_responses(several)
    read = () if responses else tuple(map(read_record, several))
    found = [digest_of(response, number) for number, response in enumerate(responses, 1)]
    for number, record in enumerate(read, 1):
        digest = hashlib.sha256(np.ascontiguousarray(record.values).tobytes()).hexdigest()
        found.append((f"record {number}", digest))
    names = tuple(
        (Path(item).name if isinstance(item, str | Path) else name, digest)
        for item, (name, digest) in zip(several, found, strict=True)
    )
    return read, responses, names


def _timing(
    machine: Machine,
    running: Synthesis,
    records: Sequence[Record],
    responses: Sequence[Response],
) -> Timing:
    """When the running controller acts; the rate of the records where nothing else says one.
    Raises InvalidInput where it is another than the records'.
    """
    timing = timing_of(machine, running, responses[0].sample_rate_hz if responses else None)
    if timing is None and records:
        timing = Timing(records[0].dt, 1, "the record's rate")
    if timing is None:
        raise InvalidInput(
            "nothing says how often the controller runs; state sample_rate_hz with the responses, "
            "or sample_time in [controller] of the machine file"
        )
    for number, record in enumerate(records, 1):
        check_machine(machine, record, f"record {number}")
        check_clock(record.dt, timing, f"record {number}")
    return timing


def _begun(
    folder: Path,
    machine: Machine,
    running: Synthesis,
    names: Sequence[tuple[str, str]],
    asked: Sequence[str],
) -> dict[str, Any]:
    """What the chain began from, with the day of the first run with the very same: it stands in
    the identified machine, which the design is made for.
    """
    began: dict[str, Any] = {
        "package": __version__,
        "machine": machine_hash(machine),
        "records": [digest for _, digest in names],
        "controller": running.digest,
        "asked": list(asked),
    }
    today = calendar.today().isoformat()
    try:
        kept = json.loads((folder / STATE).read_text("utf-8"))["began"]
        same = {key: kept.get(key) for key in began} == began
        return {**began, "date": str(kept["date"]) if same else today}
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return {**began, "date": today}


_UNSEEN = (
    "no record holds u_<axis>, so that another controller than the given one is not seen, and it "
    "looks like a wrong scale of e and far values: give the one that ran, or record u"
)


def _identified(
    chain: _Chain,
    records: Sequence[Record],
    names: tuple[str, ...],
    fit: dict[str, Any],
    *,
    changed: bool,
) -> None:
    """The record judged, the machine identified and written back with its intervals."""
    origin = Provenance(names, "the running controller", chain.began["date"])
    delay = chain.timing.delay_samples
    done = identify(
        chain.given,
        list(records or chain.responses),
        chain.running,
        computing_delay=delay,
        provenance=origin,
        progress=chain.progress,
        **fit,
    )
    assert isinstance(done, LoopIdentification)  # its method is the closed loop
    text = done.comment + machine_text(done.machine)
    write_text(chain.folder / IDENTIFIED, text, "machine file")
    chain.made["identification"] = done
    chain.made["moved"] = tuple(_moved(chain.given, done))
    known = [item for item in done.findings if item.code in _AS_CHANGED]
    left = [item for item in done.findings if not (changed and item in known)]
    doubts = "; ".join(str(finding) for finding in left)
    if left and all(item in known for item in left):
        doubts += "; where the machine is known to have changed so, go on with --changed"
    commands = {f"u_{axis}" for axis in chain.given.axes}
    if doubts and records and not any(commands & set(record.signals) for record in records):
        doubts += f"; {_UNSEEN}"
    count = len(done.result.paths)
    beyond = "".join(f"; as is known: {finding}" for finding in known)
    good = f"{count} parameters, {_widest(done)}; {done.verdict}{beyond}"
    title = "The record is good and the machine is identified"
    if not chain.say("identified", title, not left, doubts or good, IDENTIFIED):
        return
    title = "What changed against the machine file"
    chain.say("changed", title, None, _in_words(chain.made["moved"]))


def _moved(machine: Machine, done: LoopIdentification) -> list[Moved]:
    stated = {item.parameter: item for item in machine.tolerances}
    rows = []
    for row in done.parameters:
        tolerance = stated.get(row.path)
        wide = None if tolerance is None else half_width(tolerance, row.start)
        half = COVERAGE * row.standard_deviation
        rows.append(Moved(row.path, row.unit, row.start, row.value, half, wide))
    return rows


def _widest(done: LoopIdentification) -> str:
    shares = [
        COVERAGE * row.standard_deviation / abs(row.value) for row in done.parameters if row.value
    ]
    return f"95 % intervals of {100 * min(shares):.2g} to {100 * max(shares):.2g} %"


def _in_words(moved: Sequence[Moved]) -> str:
    """The largest certain changes first; those beyond the file's tolerance are counted."""
    certain = sorted(
        (item for item in moved if item.certain), key=lambda item: -abs(np.nan_to_num(item.change))
    )
    if not certain:
        return "nothing beyond the intervals: the file's values lie within all of them"
    largest = ", ".join(f"{item.path} {100 * item.change:+.2g} %" for item in certain[:_MOST])
    more = f" and {len(certain) - _MOST} more" if len(certain) > _MOST else ""
    beyond = sum(item.beyond for item in moved)
    wide = f"; {beyond} beyond the file's own tolerance" if beyond else ""
    return f"{largest}{more}{wide}"


def _verified(chain: _Chain, law: Synthesis, *, tolerances: bool = True) -> Verification:
    """A controller over the identified intervals, at the rate and delay it runs with."""
    done: LoopIdentification = chain.made["identification"]
    timing = chain.timing

    def judged(**measured: Any) -> Verification:
        return verify_controller(
            done.machine,
            law,
            axes=done.machine.group,
            tolerances=tolerances,
            everywhere=True,
            informed=False,
            rate=timing.rate,
            delay_samples=timing.delay_samples,
            progress=chain.progress,
            **measured,
        )

    chain.untold = ""
    if chain.responses:
        try:
            axes, dt = done.machine.axes, timing.sample_time
            for one in chain.responses:
                lines_of(usable(one, axes, dt), axes)
            return judged(measured=chain.responses, running=chain.running)
        except InvalidInput as error:
            chain.untold = str(error)
    return judged()


def _say_measured(chain: _Chain, name: str, title: str, verification: Verification) -> None:
    """What the measured plant makes of a controller beside the model, where responses were given:
    the step that follows is judged by it.
    """
    if not chain.responses:
        return
    if chain.untold:
        words = f"{_ALONE}: {chain.untold}"
        chain.say(name, title, None, words)
        return
    found = []
    for checks in (item for item in verification.points if item.label.endswith(MEASURED)):
        rows = [check for check in checks.checks if check.name.startswith("sensitivity.output.")]
        if not checks.stable:
            found.append(f"{checks.label}: unstable; {checks['stability.measured'].detail}")
            continue
        worst = max(rows, key=lambda check: check.value)
        limit = "" if worst.limit is None else f", limit {worst.limit:g}"
        name = worst.name.rpartition(".")[2]
        found.append(f"{checks.label}: at most {worst.value:.3g} ({name}{limit}), {worst.detail}")
        found.append(checks.notes[0].rstrip("."))
    chain.say(name, title, None, "; ".join(found))


def _needed(chain: _Chain, anyway: bool) -> bool:
    """Whether the running controller does no longer do what is asked for."""
    chain.progress("the running controller on the identified machine")
    before = _verified(chain, chain.running, tolerances=False)
    if before.passed:
        # no need to look between them where it fails at the operating points
        before = _verified(chain, chain.running)
    chain.made["before"] = before
    _say_measured(chain, "running measured", "The running controller as measured", before)
    title = "The running controller on the identified machine"
    words = figures(before)
    if before.passed and not anyway:
        chain.say("running", title, True, f"it meets every limit over the intervals: {words}")
        chain.made["unchanged"] = True
        return False
    failed = "it meets every limit" if before.passed else f"it does not do: {misses(before)}"
    chain.say("running", title, None, f"{failed}; {words}")
    return True


def figures(verification: Verification) -> str:
    """The worst sensitivities: at the points, over the intervals as found, and what is proved."""
    held = [checks for checks in verification.points if checks.stable]
    if not held:
        return "stable at no operating point"
    peak = max(held, key=lambda checks: checks[_PEAK].value)
    words = f"largest sensitivity {peak[_PEAK].value:.3g} ({peak.label})"
    proved = []
    for box in verification.boxes:
        named = {check.name: check for check in box.checks}
        where = box.label.rpartition(" around ")[2]
        found, bound = named.get("sampled.sensitivity.box"), named.get("robust.sensitivity.bound")
        least = "" if found is None else f"found as it runs {found.value:.3g}, "
        if bound is None or not np.isfinite(bound.value):
            proved.append(f"around {where} {least}nothing proved")
            continue
        how = bound.title.rpartition(", ")[2]
        proved.append(f"around {where} {least}at most {bound.value:.3g} {how}")
    return "; ".join([words, *proved])


def misses(verification: Verification) -> str:
    """The limits that are missed, each with its figure and where; the first few."""
    rows = []
    for label, checks in verification.labelled:
        rows += [f"{_why(check)} ({label})" for check in checks.failed]
    rows += [f"{label} is left out" for label in verification.left_out]
    more = f" and {len(rows) - _MOST} more" if len(rows) > _MOST else ""
    return "; ".join(rows[:_MOST]) + more


def _why(check: Any) -> str:
    limit = "" if check.limit is None else f", asked for {check.relation} {check.limit:.4g}"
    return f"{check.title[0].lower()}{check.title[1:]} {check.value:.4g}{limit}"


def method_like(running: Synthesis, timing: Timing, machine: Machine) -> Tuned:
    """The tuned method with the structure of the running controller, so that only parameters of
    its code change: as many states, and the axes kept apart as they were where it was tuned.

    order: None where it would have as many by itself; it takes more then where a limit needs it.
    """
    settings = running.provenance.settings or {}
    structure = str(settings.get("structure", "free")) if running.method == "tuned" else "free"
    start = machine.reference or first_settings(machine)
    states, usual = running.controller.n_states, STATES_PER_AXIS * len(running.inputs)
    usual = max(usual, pid_controller(start, machine).n_states)
    by_itself = structure in {"pid", "filters"} or states == usual
    return Tuned(
        rate=timing.rate,
        delay_samples=timing.delay_samples,
        structure=structure,
        order=None if by_itself else states,
    )


def _on_measured(chain: _Chain, plant: Plant, method: Tuned) -> Tuned:
    """The method that tunes on the measured plant, too, where the responses are of all axes; they
    and the controller that ran lie in the folder then.
    """
    try:
        for response in chain.responses:
            lines_of(usable(response, plant.axes, chain.timing.sample_time), plant.axes)
    except InvalidInput:
        return method  # single axes tell no plant
    if not chain.responses:
        return method
    files = [chain.folder / f"measured-{k}.json" for k, _ in enumerate(chain.responses, 1)]
    for path, response in zip(files, chain.responses, strict=True):
        write_response(response, path)
    running = chain.folder / RUNNING
    if not running.exists():  # its date would make it another one
        write_controller(running, chain.running)
    return replace(method, measured=tuple(map(str, files)), running=str(running))


def _tuned(chain: _Chain, plant: Plant) -> tuple[Synthesis, str]:
    """The new controller, with as many states as the running one where that meets what is asked
    for, else with as many as that takes; and how many. Raises NumericalFailure.
    """
    method = method_like(chain.running, chain.timing, plant.machine)
    method = _on_measured(chain, plant, method)
    before = chain.running.controller.n_states
    path, fewer = chain.folder / CONTROLLER, chain.folder / SAME_ORDER
    if method.order is not None:
        # where an earlier run set it aside, it is taken up from there
        kept = fewer if fewer.exists() else path
        try:
            new = resume_or_design(plant, method, kept, chain.progress)
        except NumericalFailure as error:
            chain.progress(f"{error}; another one, with as many states as it takes")
        else:
            if not new.missed or new.undecided:  # more states show nothing more
                if kept is fewer:
                    set_aside(path)
                    fewer.replace(path)
                return new, f"{before} states as before"
            if kept is path:
                path.replace(fewer)
            chain.progress(
                f"with {before} states a limit is exceeded {new.gamma:.3g} times: another one, "
                "with as many as it takes"
            )
    new = resume_or_design(plant, replace(method, order=None), path, chain.progress)
    states = new.controller.n_states
    return new, f"{states} states {'as before' if states == before else f'in place of {before}'}"


def _changed(chain: _Chain) -> None:
    """Another controller: designed, judged over the intervals, compared, coded, tried."""
    done: LoopIdentification = chain.made["identification"]
    plant = assemble(done.machine, done.machine.operation.design)
    title = "A controller tuned for the identified machine"
    try:
        new, states = _tuned(chain, plant)
    except NumericalFailure as error:
        chain.say("designed", title, False, str(error))
        return
    chain.made["new"] = new
    words = designed_in_words(new)
    good: bool | None = new.status is Status.VERIFIED and not new.lost
    if good and new.missed:
        good = None  # some aims are guards of the search: the limits are judged by what follows
    if not chain.say("designed", title, good, f"{words}; {states}, {chain.timing}", CONTROLLER):
        return

    chain.progress("the new controller over the identified intervals")
    after = _verified(chain, new, tolerances=False) if new.missed else None
    if after is None or after.passed:
        # no need to look between them where it fails at the operating points
        after = _verified(chain, new)
    chain.made["after"] = after
    _say_measured(chain, "new measured", "The new controller on the measured plant", after)
    title = "It meets the requirements over the identified intervals"
    words = f"every limit is met: {figures(after)}" if after.passed else misses(after)
    if not chain.say("proved", title, after.passed, words):
        return
    title = "The new and the running controller"
    chain.say("compared", title, None, _beside(chain.made["before"], after))
    if not _coded(chain, new, done.machine):
        return
    _switched(chain, new, done.machine)


def designed_in_words(new: Synthesis) -> str:
    """What the search ended with, and nothing of requirements where its aims, which are stricter,
    are not all met: whether those are is the verification's word.
    """
    if not new.missed or new.status is not Status.VERIFIED or new.lost or new.lost_as_assumed:
        return new.verdict
    ended = f"; the search ended at {new.gamma:.3g} of its aims" if new.method == "tuned" else ""
    return f"certified as stable{ended}; the limits are judged next"


def at_point(verification: Verification, label: str) -> Checks:
    """The checks at the operating point of a label, measured or not."""
    name = label.removesuffix(MEASURED)
    return next(item for item in verification.points if item.label.removesuffix(MEASURED) == name)


def _beside(before: Verification, after: Verification) -> str:
    """The largest sensitivity at every operating point, before and after."""
    rows = []
    for old in before.points:
        own = at_point(after, old.label)
        was = f"{old[_PEAK].value:.3g}" if old.stable else "unstable"
        if old.label != own.label:  # measured, and the responses do not tell the new one
            was += f" ({old.label.rpartition(', ')[2]})"
        rows.append(f"{own.label} {was} to {own[_PEAK].value:.3g}")
    return f"largest output sensitivity: {', '.join(rows)}"


def _coded(chain: _Chain, new: Synthesis, machine: Machine) -> bool:
    """The code as a full unit and, for the same structure, as a difference of parameters; its way
    back leads to the very tables that run.
    """
    chain.progress("writing the code")
    target = C(rate=chain.timing.rate, delay_samples=chain.timing.delay_samples)
    title = "The code, and what of it changes"
    # the intervals were judged above
    alone = replace(machine, tolerances=())
    try:
        delivery = write_code(
            new,
            chain.folder / CODE,
            to=target,
            machine=alone,
            replaces=chain.running,
            progress=chain.progress,
        )
    except (InvalidInput, UnstableSystem) as error:
        return chain.say("coded", title, False, str(error))
    chain.made["delivery"] = delivery
    files = [f"{CODE}/{path.name}" for path in delivery.paths]
    return chain.say("coded", title, delivery.verified, _code_in_words(delivery), *files)


def _code_in_words(delivery: Delivery) -> str:
    difference = delivery.difference
    if difference is None:
        return f"a full unit; no difference of parameters: {delivery.not_alike}"
    source = next(
        path for path in delivery.paths if path.suffix == ".c" and "test" not in path.name
    )
    back = difference.reversed().apply(source.read_text("utf-8"))
    if checksum_of(back) != difference.checksum_before:
        raise NumericalFailure("the way back does not lead to the tables that run; export again")
    return (
        f"{len(difference.changes)} of {sum(difference.sizes.values())} entries of its tables "
        f"change, checksum {difference.checksum_before} to {difference.checksum}; applied "
        "backwards they give the tables that run"
    )


def _switched(chain: _Chain, new: Synthesis, machine: Machine) -> None:
    """The change, and the way back, on the nonlinear rig with the identified machine."""
    before: Verification = chain.made["before"]
    done: LoopIdentification = chain.made["identification"]
    title = "The change and the way back on the rig"
    point = done.outputs[0].record.point if done.outputs else done.result.point
    held = _holds(machine, before, point)
    if held is not None:
        words = f"not tried: the running controller is unstable on the identified machine {held}"
        chain.say("switched", title, None, words)
        return
    runs = []
    for forward in (True, False):
        first, second = (chain.running, new) if forward else (new, chain.running)
        chain.progress("changing the controller on the virtual rig" if forward else "and back")
        try:
            runs.append(_switch(chain, machine, point, first, second, forward))
        except AmbroseError as error:
            chain.say("switched", title, False, str(error))
            return
    chain.made["switches"] = tuple(runs)
    words = "; ".join(_switch_in_words(run) for run in runs)
    chain.say("switched", title, all(run.passed for run in runs), words)


def _holds(machine: Machine, before: Verification, point: Any) -> str | None:
    """Where the running controller is unstable of the points that are like the record's; None:
    nowhere.
    """
    labels = {
        item.label
        for item in machine.operation.envelope
        if (item.speed, item.seal_pressure) == (point.speed, point.seal_pressure)
    }
    own = [checks for checks in before.points if checks.label.removesuffix(MEASURED) in labels]
    lost: list[Checks] = [checks for checks in own if not checks.stable]
    return f"at {lost[0].label}" if lost else None


def _switch(
    chain: _Chain, machine: Machine, point: Any, first: Synthesis, second: Synthesis, forward: bool
) -> Switch:
    unbalances = _unbalances(machine) if point.speed > 0 else ()
    scenario = Scenario(
        "change of controllers",
        2 * _HALF,
        unbalances=unbalances,
        speed=point.speed,
        sample_time=chain.timing.sample_time,
        switch_at=_HALF,
    )
    trace = simulate_scenario(
        machine,
        first,
        scenario,
        axes=machine.group,
        point=replace(point, label=""),
        rate=chain.timing.rate,
        delay_samples=chain.timing.delay_samples,
        second=second,
    )
    record = trace.record
    rows = [record[name] for name in record.signals if name.startswith("y_")]
    y = np.array(rows)
    middle = round(_HALF * record.sample_rate_hz)
    still = y[:, middle // 2 : middle]
    mean = still.mean(axis=1, keepdims=True)
    after = float(np.abs(y[:, middle:] - mean).max())
    before = float(np.abs(still - mean).max())
    return Switch(forward, trace, after, before, _BUMP * _gap(machine))


def _unbalances(machine: Machine) -> tuple[Unbalance, ...]:
    """What the machine's balance grade leaves, in the planes of the bearings and in phase."""
    residual = residual_unbalance(machine)
    if residual is None:
        return ()
    return tuple(
        Unbalance(bearing.name, residual.moment * share)
        for bearing, share in zip(machine.bearings, residual.share, strict=True)
    )


def _gap(machine: Machine) -> float:
    """The smallest clearance [m] that the machine file states."""
    gaps = [
        gap
        for item in machine.bearings
        for gap in (item.touchdown_gap, item.gap)
        if gap is not None
    ]
    return min(gaps, default=_NARROW)


def _switch_in_words(run: Switch) -> str:
    way = "the change" if run.forward else "the way back"
    return (
        f"{way}: {run.trace.outcome}, {1e6 * run.bump:.3g} um from the mean after it, "
        f"{1e6 * run.before:.3g} um before"
    )


def _accepted(chain: _Chain, records: Records) -> None:
    """The loop after the change, measured, over its limits and the prediction."""
    new = chain.made.get("new")
    law = chain.running if new is None else new
    done: LoopIdentification = chain.made["identification"]
    chain.progress("measuring the loop after the change")
    title = "The loop after the change, as measured"
    try:
        result: Acceptance = accept(
            done.machine, law, records, delay_samples=chain.timing.delay_samples
        )
    except AmbroseError as error:
        chain.say("accepted", title, False, str(error))
        return
    chain.made["acceptance"] = result
    failed = list(joined.from_iterable(loop.checks.failed for loop in result.points))
    peaks = [loop.largest for loop in result.points]
    good = f"every limit is met; largest sensitivity of an axis {max(peaks):.3g}"
    words = "; ".join(_why(check) for check in failed[:_MOST]) if failed else good
    chain.say("accepted", title, result.passed, words)
