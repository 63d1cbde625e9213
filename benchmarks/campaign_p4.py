"""The campaigns of papers P4 and P5 (sec. 3.3) on the nonlinear rig: bearings, coupling, seal
against frequency and pressure.

`python -m benchmarks.campaign_p4` prints the figures of docs/research/reproduction.md with the truth beside
them (two minutes of computing time); `-o DIR` also writes `p4.html` with the pictures; `--short` is
the form that the tests run. The rig is the bundled seal-rig with weight, iron and 0.2 um rms of
sensor noise, at 4 A of bias. Assumed, because the papers do not print it: the seal does nothing
without pressure and k, C, c grow in proportion to it (K = 0); a PRBS of 0.1 A on both bearings
alike; stepped sines of 0.1 A; 5 % of each magnet's control current leaks to its other axis in the
chirp test (P4 sees cross-coupling a tenth of the direct response).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from ambrose.core.frequency import FrequencyResponse, frequency_response
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.identification import frf_spectral as frf
from ambrose.identification.frf import Step, compare, stepped, steps_of
from ambrose.identification.output_error import closed_loop
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.parameters import update_machine
from ambrose.identification.seal import by_frequency as stepped_sine, pipeline as time_domain
from ambrose.identification.seal.by_pressure import COEFFICIENTS, SealFit, averaged, line
from ambrose.law.loop import closed_loop as loop_of
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Chirp, Prbs, Pulse, Scenario, Sine, SteppedSine
from benchmarks import campaign_p4_tables as tables
from benchmarks.campaign_p4_page import page
from benchmarks.campaign_p4_results import BAR, HZ, Columns, Coupled, Impulses, Stepped, Swept, rig

DT = 1e-4
EIGHT = ("bearing.*.force_per_current.*", "bearing.*.negative_stiffness.*")
COUPLING = "coupling.coupling.stiffness.*"
FREQUENCIES = tuple(float(f) for f in range(5, 200, 10))  # [Hz], P4 sec. 3.5.1
PRESSURES = (0.0, 0.7 * BAR, 1.0 * BAR, 1.2 * BAR)
IMPULSE_PRESSURES = tuple(p * BAR for p in (0.45, 0.7, 0.95, 1.2, 1.45, 1.7, 1.9))
TOLERANCES = (0.01, 0.02, 0.03, 0.05, 0.1)  # of magnitude, and of phase [rad]
OTHER = {"zeta": "eta", "eta": "zeta"}


def controller(machine: Machine) -> StateSpace:
    """The printed PID."""
    return pid_controller(machine.controller, machine)


def measure(machine: Machine, scenario: Scenario, pressure: float = 0.0, seed: int = 0) -> Record:
    """The record of a run that must stay in the air."""
    trace = virtual_rig.run(
        machine,
        controller(machine),
        scenario,
        point=OperatingPoint(seal_pressure=pressure),
        seed=seed,
    )
    if trace.outcome != "completed":
        raise RuntimeError(f"{scenario.name} at {pressure:g} Pa: {trace.text}")
    return trace.record


def parallel_prbs(
    machine: Machine, bit_time: float = 1e-3, duration: float = 5.0, seed: int = 3
) -> Record:
    """Two sequences at once, one per direction, the same on both bearings: purely parallel motion
    (P4 sec. 3.4).
    """
    sequences = tuple(
        Prbs(f"e_{b}_{axis}", 0.1, bit_time, seed=i)
        for b in "AB"
        for i, axis in enumerate(("zeta", "eta"))
    )
    return measure(machine, Scenario("parallel PRBS", duration, sequences=sequences), seed=seed)


def bearings(
    machine: Machine, record: Record, **options: object
) -> tuple[Machine, ParameterEstimate]:
    """The machine with K_i and K_s as found."""
    found = closed_loop.identify(machine, record, controller(machine), EIGHT, **options)
    return update_machine(machine, found), found


def loop(machine: Machine, pressure: float, bending_modes: int | None = None) -> StateSpace:
    """The loop as it runs; full model, or ``bending_modes`` per plane (0: the eight rigid states of
    the thesis).
    """
    plant = assemble(machine, OperatingPoint(seal_pressure=pressure))
    plant = plant if bending_modes is None else free_mode_reduction(plant, bending_modes)
    return loop_of(plant, c2d(controller(machine), DT, "tustin", delay=DT))


def middle_response(
    system: StateSpace, omega: np.ndarray, inputs: Sequence[str], outputs: Sequence[str]
) -> FrequencyResponse:
    """From parallel excitation (inputs e_A_<axis>, the same at B) to the motion of the middle
    (outputs y_middle_<axis>).
    """
    e = [name.replace("_A_", f"_{b}_") for name in inputs for b in "AB"]
    y = [name.replace("_middle_", f"_{b}_") for name in outputs for b in "AB"]
    values = frequency_response(select(system, e, y), omega).values
    values = values.reshape(len(omega), len(outputs), 2, len(inputs), 2)
    return FrequencyResponse(values.mean(axis=2).sum(axis=3), omega, tuple(inputs), tuple(outputs))


def with_middle(record: Record) -> Record:
    """The record with y_middle_<axis>, half-way between the sensors: the seal's middle."""
    middles = [
        0.5 * record[f"y_A_{axis}"] + 0.5 * record[f"y_B_{axis}"] for axis in ("zeta", "eta")
    ]
    signals, units = (*record.signals, "y_middle_zeta", "y_middle_eta"), (*record.units, "m", "m")
    return replace(
        record, signals=signals, units=units, values=np.vstack([record.values, *middles])
    )


def chirps(duration: float = 20.0) -> list[Swept]:
    """P4.1: bearings identified by PRBS without coupling, then a linear chirp to 150 Hz, both
    bearings alike.
    """
    true = rig(coupling=False, leak=0.05)
    plain = rig(coupling=False)
    known, _ = bearings(plain, replace_machine(parallel_prbs(true), plain))
    systems = {
        "identified": loop(known, 0.0),
        "identified, 8 rigid states": loop(known, 0.0, 0),
        "file values": loop(plain, 0.0),
    }
    found = []
    for axis in ("zeta", "eta"):
        waves = tuple(Chirp(f"e_{b}_{axis}", 0.1, 0.5 * HZ, 150 * HZ) for b in "AB")
        record = with_middle(measure(true, Scenario("chirp", duration, chirps=waves), seed=5))
        outputs = [f"y_middle_{axis}", f"y_middle_{OTHER[axis]}"]
        measured = frf.h1(record, f"e_A_{axis}", outputs, band=(3 * HZ, 145 * HZ))
        models = {
            name: middle_response(system, measured.omega, measured.inputs, outputs[:1])
            for name, system in systems.items()
        }
        direct = measured.select(outputs=outputs[0])
        validity = {
            name: {
                t: compare(direct, model, magnitude_tolerance=t, phase_tolerance=t)
                for t in TOLERANCES
            }
            for name, model in models.items()
        }
        limits = {
            name: {t: float(v.valid_to[0, 0] / HZ) for t, v in each.items()}
            for name, each in validity.items()
        }
        found.append(
            Swept(
                axis,
                measured,
                models,
                {name: each[0.02] for name, each in validity.items()},
                limits,
            )
        )
    return found


def replace_machine(record: Record, machine: Machine) -> Record:
    """The record as one of the machine that is assumed."""
    return replace(record, machine=machine.name)


def cosines(
    bit_times: Sequence[float] = (0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 40e-3, 80e-3),
) -> Columns:
    """P4.2 and P4.7: K_i and K_s without coupling, per bit time from displacements, from these and
    measured currents, and from currents alone, to which a growing weight on the currents tends.
    """
    machine = rig(coupling=False)
    choices = [
        [f"{kind}_{axis}" for kind in kinds for axis in machine.axes] for kinds in ("y", "yi", "i")
    ]
    found = {}
    for bit_time in bit_times:
        record = parallel_prbs(machine, bit_time)
        found[bit_time] = tuple(
            bearings(machine, record, signals=signals)[1] for signals in choices
        )
    return found


def coupling() -> Coupled:
    """P4.3: K_i and K_s from a record without coupling, then the coupling alone from one with it;
    and two wrong ways.
    """
    bare, whole = rig(coupling=False), rig()
    known, _ = bearings(bare, parallel_prbs(bare))
    guess = (replace(whole.couplings[0], stiffness=(0.3e6, 0.3e6)),)  # begins 25 % off
    record, law = parallel_prbs(whole), controller(whole)

    def found(machine: Machine, unknown: Sequence[str]) -> ParameterEstimate:
        return closed_loop.identify(replace(machine, couplings=guess), record, law, unknown)

    return Coupled(
        found(known, [COUPLING]), found(whole, [COUPLING]), found(known, [*EIGHT, COUPLING])
    )


@cache
def known_but_for_the_seal() -> Machine:
    """Bearings identified with the coupling as known, without pressure."""
    return bearings(rig(), parallel_prbs(rig()))[0]


def stepped_sines(
    frequencies: Sequence[float] = FREQUENCIES, dwell: float = 1.2, settle: float = 0.4
) -> Stepped:
    """P4.4, P4.6: stepped sines along both directions at four pressures."""
    machine, known = rig(), known_but_for_the_seal()
    records: dict[float, list[Record]] = {}
    for i, pressure in enumerate(PRESSURES):
        for j, axis in enumerate(("zeta", "eta")):
            sines = tuple(
                SteppedSine(f"e_{b}_{axis}", 0.1, tuple(f * HZ for f in frequencies), dwell)
                for b in "AB"
            )
            scenario = Scenario("stepped sine", dwell * len(frequencies), stepped_sines=sines)
            records.setdefault(pressure, []).append(
                with_middle(measure(machine, scenario, pressure, 2 * i + j))
            )
    steps = steps_of([f * HZ for f in frequencies], dwell)
    fit = stepped_sine.identify(
        known, [r for group in records.values() for r in group], steps=steps, settle=settle
    )
    constants = averaged(fit, 100 * HZ)
    inputs, outputs = ["e_A_zeta", "e_A_eta"], ["y_middle_zeta", "y_middle_eta"]
    measured = {
        p: stepped(group, inputs, outputs, steps=steps, settle=settle)
        for p, group in records.items()
    }
    model = {}
    for pressure in constants.pressures:
        fixed = with_constants(known, constants.at(pressure).values[0])
        model[float(pressure)] = middle_response(
            loop(fixed, float(pressure)), measured[pressure].omega, inputs, outputs
        )
    return Stepped(fit, constants, measured, model)


def with_constants(machine: Machine, values: np.ndarray) -> Machine:
    """The machine with a seal of these K, k, C, c at every pressure."""
    K, k, C, c = (float(value) for value in values)
    return replace(
        machine,
        seals=(replace(machine.seals[0], K=K, k=k, C=C, c=c, scales_with_pressure=()),),
        tolerances=(),
    )


def correlations(
    frequency: float = 40.0, pressures: Sequence[float] = PRESSURES
) -> dict[float, np.ndarray]:
    """P4.5: column cosines (4, 4) of K, C, k, c in the time domain for a sine along zeta, as in
    table 4 of P4.
    """
    found = {}
    for pressure in pressures:
        record = whirl(frequency, pressure, {"zeta": 0.1})
        paths = [f"seal.center.{name}" for name in ("K", "C", "k", "c")]
        result = closed_loop.identify(known_but_for_the_seal(), record, controller(rig()), paths)
        found[pressure] = result.column_cosine
    return found


def whirl(
    frequency: float,
    pressure: float,
    amplitudes: dict[str, float],
    turn: float = 0.0,
    seed: int = 0,
) -> Record:
    """0.8 s of a steady sine along the directions named, eta ahead by ``turn`` [rad]; 0.4 s before
    it are left out.
    """
    sines = tuple(
        Sine(f"e_{b}_{axis}", size, frequency * HZ, turn if axis == "eta" else 0.0)
        for b in "AB"
        for axis, size in amplitudes.items()
    )
    return measure(rig(), Scenario("sine", 1.2, sines=sines), pressure, seed).between(0.4, 1.2)


def opposed(frequency: float = 40.0, pressure: float = 1.2 * BAR) -> tuple[SealFit, SealFit]:
    """A way out of P4.5: the coefficients from zeta and eta in turn, and from forward whirl and
    stronger backward whirl.
    """
    known = known_but_for_the_seal()
    steps = [Step(frequency * HZ, 0.4, 1.2)]
    plane = [
        whirl(frequency, pressure, {axis: 0.1}, seed=i) for i, axis in enumerate(("zeta", "eta"))
    ]
    both = {"zeta": 0.1, "eta": 0.1}
    forward = whirl(
        frequency, pressure, {axis: 0.3 * size for axis, size in both.items()}, -np.pi / 2, 2
    )
    backward = whirl(frequency, pressure, both, np.pi / 2, 3)
    options = {"steps": steps, "settle": 0.0, "reference": False}
    return stepped_sine.identify(known, plane, **options), stepped_sine.identify(
        known, [forward, backward], **options
    )


def misjudged_amplifier(pressure: float = 1.2 * BAR, damping: float = 0.9) -> dict[str, SealFit]:
    """Why P4 sees damping fall with frequency, pressure or not: the amplifier's damping taken as
    0.9 of its natural frequency, one reading of the misprint (the rig has 1.17). From commanded
    currents through that model, and from measured ones.
    """
    true = rig()
    wrong = replace(
        true,
        amplifier=replace(
            true.amplifier, damping=damping * float(true.amplifier.natural_frequency or 0)
        ),
    )
    known, _ = bearings(wrong, parallel_prbs(true))
    frequencies, dwell = (15.0, 35.0, 55.0, 75.0, 95.0), 0.8
    records = []
    for i, p in enumerate((0.0, pressure)):
        for j, axis in enumerate(("zeta", "eta")):
            sines = tuple(
                SteppedSine(f"e_{b}_{axis}", 0.1, tuple(f * HZ for f in frequencies), dwell)
                for b in "AB"
            )
            scenario = Scenario("stepped sine", dwell * len(frequencies), stepped_sines=sines)
            records.append(measure(true, scenario, p, 40 + 2 * i + j))
    steps = steps_of([f * HZ for f in frequencies], dwell)
    return {
        currents: stepped_sine.identify(known, records, steps=steps, currents=currents)
        for currents in ("commanded", "measured")
    }


def impulses(pressures: Sequence[float] = IMPULSE_PRESSURES, repeats: int = 10) -> Impulses:
    """0.05 A for 10 ms on both bearings along zeta, repeated every 0.4 s, at every pressure."""
    machine = rig()
    known = known_but_for_the_seal()
    every = 0.4
    records = []
    for i, pressure in enumerate(pressures):
        pulses = tuple(Pulse(f"e_{b}_zeta", 0.05, 0.05, 0.01, every=every) for b in "AB")
        records.append(
            measure(machine, Scenario("impulses", repeats * every, pulses=pulses), pressure, 20 + i)
        )
    fit = time_domain.identify(known, records, controller(machine))
    lines = {letter: line(fit, letter) for letter in COEFFICIENTS}
    e, y = ([f"{kind}_{axis}" for axis in machine.axes] for kind in "ey")
    responses = {}
    for record, pressure, values in zip(records, pressures, fit.values, strict=True):
        system = select(loop(with_constants(known, values), pressure, 1), e, y)
        drive = np.stack(
            [record[n] if n in record.signals else np.zeros(len(record.time)) for n in e]
        )
        modelled, one = simulate(system, drive), round(every / DT)
        measured = record.select(y).values
        measured, modelled = (
            x[:, : one * repeats].reshape(4, repeats, one).mean(axis=1)
            for x in (measured, modelled)
        )
        # the currents that carry the weight
        still = measured[:, : round(0.05 / DT)].mean(axis=1, keepdims=True)
        responses[pressure] = (record.time[:one], measured - still, modelled)
    return Impulses(fit, lines, responses)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print everything; with -o, write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, help="folder for p4.html")
    parser.add_argument("--short", action="store_true", help="fewer frequencies and repeats")
    options = parser.parse_args(arguments)
    short = {"frequencies": FREQUENCIES[:10], "dwell": 0.9} if options.short else {}
    swept = chirps()
    found = cosines()
    joined = coupling()
    sines, table = stepped_sines(**short), {40.0: correlations()}
    table |= {f: correlations(f, (0.7 * BAR,)) for f in (5.0, 10.0, 20.0, 80.0, 120.0)}
    pulses = impulses(repeats=5 if options.short else 10)
    for text in (
        tables.chirps(swept),
        tables.cosines(found),
        tables.coupling(joined),
        tables.stepped(sines),
        tables.correlations(table, opposed()),
        tables.impulses(pulses),
        tables.misjudged(misjudged_amplifier()),
    ):
        print(text, end="\n\n")
    if options.output is not None:
        from ambrose.report.page import write

        options.output.mkdir(parents=True, exist_ok=True)
        print(write(page(rig(), swept, sines, pulses), options.output / "p4.html"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
