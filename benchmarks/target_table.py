"""The exported code on its processors, in QEMU: every kind of law, number type and target.

    python -m benchmarks.target_table [--laws fixed cascade] [--processors cortex-m7] [--loop]
                                                     five minutes, with --loop one more

Of every row: whether currents, status and faults over random samples that meet every branch are
those of this computer to the last bit; how far a compiler that rounds product and sum at once gets
from them; instructions of the longest step; stack as bounded and as found written; flash and
memory. With --loop: scenarios on the virtual rig with the target's binary as the controller, beside
the same code on this computer. What is not installed is left out, with a word.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import ambrose as amb
from ambrose.annexes.synchronous.block_code import RunUnit
from ambrose.code.block.block import ControlBlock, build_block
from ambrose.code.block.cascade import build_cascade
from ambrose.code.block.scheduled import ScheduledBlock, build_scheduled_block, supervise
from ambrose.code.in_loop import InLoop, simulate_on_target
from ambrose.code.interface import Law
from ambrose.code.pipeline import machine_limits
from ambrose.code.processor_build import PROCESSORS, unit_of
from ambrose.code.processor_trial import Trial, stimulus, try_unit
from ambrose.code.sampled import deploy, deploy_scheduled
from ambrose.code.targets import C
from ambrose.core.checks import InvalidInput
from ambrose.law.supervision import Limits
from ambrose.law.synchronous_block import BlockLaw, SynchronousLaw
from ambrose.rig.scenario import load_scenario

DT = 1e-4
TOP = 4.08e5  # Pa, of the schedule
_SAMPLES = 600
_SCENARIOS = ("levitation", "operating-cycle", "power-loss")
_IN_LOOP = (("cortex-m7", "double"), ("cortex-m7", "float"), ("cortex-r5-big-endian", "float"))


@dataclass(frozen=True)
class Row:
    """A law in a number type on a processor."""

    law: str
    arithmetic: str
    trial: Trial

    def __str__(self) -> str:
        trial = self.trial
        apart = "" if trial.contracted is None else f"{trial.contracted.max():.1e} A"
        size = trial.footprint
        equal = "yes" if trial.equal else f"{trial.apart.max():.1e} A"
        cells = [
            self.law,
            self.arithmetic,
            trial.processor.name,
            equal,
            apart,
            f"{trial.instructions.max()}",
            f"{size.stack} ({trial.written})",
            f"{size.flash}",
            f"{size.memory}",
        ]
        return f"| {' | '.join(cells)} |"


HEAD = (
    "| law | numbers | processor | equal | contracted | instructions | stack (written) | flash | "
    "memory |\n|---|---|---|---|---|---|---|---|---|"
)


class Laws:
    """Laws of the seal rig at 10 kHz, one sample late: four errors, four currents."""

    def __init__(self, smoke: bool) -> None:
        self.machine = amb.load_machine("seal-rig")
        self.limits = machine_limits(self.machine)
        self.smoke = smoke
        self._fixed: ControlBlock | None = None

    def fixed(self) -> ControlBlock:
        """mu of 28 states (smoke: the PID)."""
        if self._fixed is None:
            method = "pid" if self.smoke else "mu"
            made = amb.design(self.machine, method, **({} if self.smoke else {"rate": 1 / DT}))
            self._fixed = build_block(deploy(made, DT, DT, force=True), "rig", *self.limits)
        return self._fixed

    def cascade(self) -> ControlBlock:
        """The machine's bank of filters, section by section."""
        made = amb.design(self.machine, "pid")
        sampled = deploy(made, DT, DT, force=True)
        return build_cascade(sampled, made.filters, self.machine, "rig", *self.limits)

    def scheduled(self) -> ScheduledBlock:
        """Over the seal's pressure."""
        made = amb.design(self.machine, "lpv", pressures=(0.0, TOP), rate=1 / DT)
        return build_scheduled_block(
            deploy_scheduled(made, DT, DT, force=True), "rig", *self.limits
        )

    def supervised(self) -> ScheduledBlock:
        """The same, the fixed one waiting beside it."""
        watch = Limits(0.0, TOP, 2e4, rate=80e5, noise=4e3, stuck=0.01, band=4e4)
        return supervise(self.scheduled(), self.fixed(), watch)

    def synchronous(self) -> RunUnit:
        """Two blocks beside the fixed one, at the first and second multiple of the speed."""
        base = self.fixed()
        n = len(base.inputs)
        speeds = np.array([150.0, 300.0, 600.0])
        drive = np.tile(np.eye(n, 2 * n).astype(complex), (3, 1, 1))
        amplitude = np.full(n, 0.04 * float(np.min(base.error_limit)))
        blocks = tuple(
            BlockLaw(speeds, drive, (160.0, 590.0), 8.0, amplitude, k, 0.0, 4.0, 0.02, 0.01, 0.05)
            for k in (1, 2)
        )
        contact = np.full(n, 0.9 * float(np.min(base.error_limit)))
        return RunUnit(base, SynchronousLaw(blocks, DT, 3000.0), contact)


def rows(laws: Sequence[str], processors: Sequence[str], smoke: bool) -> Iterator[Row]:
    """The table's rows as they come; what a law refuses of numbers, or is not installed, is said."""
    made = Laws(smoke)
    for name in laws:
        build: Callable[[], Law] = getattr(made, name)
        law = build()
        for arithmetic in ("double", "float", "fixed32", "fixed16"):
            try:
                unit = unit_of(law, arithmetic)  # type: ignore[arg-type]
            except InvalidInput as error:
                print(f"{name} in {arithmetic}: {error}", file=sys.stderr)
                continue
            drive = stimulus(unit, 64 if smoke else _SAMPLES)
            for processor in processors:
                try:
                    trial = try_unit(unit, PROCESSORS[processor], samples=drive)
                except InvalidInput as error:
                    print(f"{name} in {arithmetic} on {processor}: {error}", file=sys.stderr)
                    continue
                yield Row(name, arithmetic, trial)
            if smoke:
                return


def loops(smoke: bool) -> Iterator[tuple[str, InLoop]]:
    """Scenarios with the target's binary in the loop."""
    machine = amb.load_machine("seal-rig")
    made: Any = amb.design(machine, "pid" if smoke else "tuned", rate=1 / DT)
    for scenario in _SCENARIOS[: 1 if smoke else None]:
        for processor, arithmetic in _IN_LOOP[: 1 if smoke else None]:
            events = load_scenario(scenario)
            events = replace(events, duration=0.02) if smoke else events
            code = C(try_on=processor, arithmetic=arithmetic, rate=1 / DT)  # type: ignore[arg-type]
            yield scenario, simulate_on_target(machine, made, events, code)


def main(arguments: Sequence[str] | None = None) -> list[Any]:
    """Prints the tables; returns their rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    known = ("fixed", "cascade", "scheduled", "supervised", "synchronous")
    parser.add_argument("--laws", nargs="*", choices=known, default=list(known))
    parser.add_argument("--processors", nargs="+", choices=list(PROCESSORS), default=[*PROCESSORS])
    parser.add_argument("--loop", action="store_true", help="scenarios on the virtual rig, too")
    parser.add_argument("--smoke", action="store_true", help="one law, few samples: does it run?")
    given = parser.parse_args(arguments)
    found: list[Any] = []
    print(HEAD)
    for row in rows(given.laws, given.processors, given.smoke):
        print(row, flush=True)
        found.append(row)
    if given.loop:
        print("\n| scenario | processor | numbers | outcome | record |\n|---|---|---|---|---|")
        for scenario, looped in loops(given.smoke):
            record = "equal to the last bit" if looped.equal else looped.text
            print(
                f"| {scenario} | {looped.processor} | {looped.arithmetic} | "
                f"{looped.trace.outcome} | {record} |",
                flush=True,
            )
            found.append(looped)
    return found


if __name__ == "__main__":
    main()
