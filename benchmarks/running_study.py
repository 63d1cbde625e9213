"""Identification of a machine that runs: intervals and scatter beside standstill, and deliberate
mistakes, flagged or not.

python -m benchmarks.running_study coverage    seal rig, linear (0.4 s, 100 nm of noise) and rig (2 s): half an hour
python -m benchmarks.running_study halves --runs 50      both halves of a record against each other: minutes
python -m benchmarks.running_study mistakes              virtual rig, 2 s: minutes; --without: as if nothing turned
"""

import argparse
from dataclasses import replace
from functools import cache

import numpy as np

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.identification.output_error import closed_loop
from ambrose.identification.parameters import COVERAGE, expand, nominal_values
from ambrose.identification.validation.places import machine_at_load
from ambrose.judge.result import pid_synthesis
from ambrose.law import loop as control
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Unbalance, load_scenario
from benchmarks import waveforms
from benchmarks.scatter_study import deviation_factors

# the machine file balances for 500 Hz
DT = 1e-4
SPEED = 2 * np.pi * 50
BALANCED = 2 * np.pi * 500
UNKNOWN = (
    "bearing.*.force_per_current.*",
    "bearing.*.negative_stiffness.*",
    "amplifier.natural_frequency",
)


@cache
def setting():
    machine = amb.load_machine("seal-rig")
    plant = free_mode_reduction(assemble(machine), 3)
    return (
        machine,
        pid_synthesis(plant).controller,
        mass_properties(finite_element_rotor(machine)).mass,
    )


@cache
def clean(grade, speed, modes, k):
    """y of the linear loop under four PRBS and an unbalance of an ISO grade [m/s] at the middle;
    the excitations.
    """
    machine, law, mass = setting()
    plant = free_mode_reduction(
        assemble(machine, replace(assemble(machine).point, speed=speed)), modes
    )
    e = np.stack([0.1 * waveforms.prbs(9, 10, k, shift=127 * i) for i in range(4)])
    angle = speed * np.arange(k) * DT
    force = grade * mass * speed**2 / BALANCED * np.stack([np.cos(angle), np.sin(angle)])
    names = [f"{kind}_{axis}" for kind in "ey" for axis in plant.axes]
    driven = [*names[:4], "f_center_x", "f_center_y"]
    loop = control.closed_loop(
        plant, c2d(control.match_controller(law, plant), DT, "tustin", delay=DT)
    )
    return simulate(select(loop, driven, names[4:]), np.vstack([e, force])), e, plant, names


def linear(grade, speed, told, modes, seed, k=4000):
    """A record of the linear loop, and the true values."""
    machine = setting()[0]
    y, e, plant, names = clean(grade, speed, modes, k)
    point = replace(plant.point, speed=told * speed)
    y = y + 1e-7 * np.random.default_rng(seed).standard_normal(y.shape)
    data = Record(
        machine.name, 1 / DT, tuple(names), ("A",) * 4 + ("m",) * 4, np.vstack([e, y]), point
    )
    return data, nominal_values(plant, expand(machine, UNKNOWN))


def nonlinear(grade, speed, modes, seed, duration=2.0):
    """A record of the rig, with other noise and another unbalance's angle for every seed; the
    values at its static load.
    """
    machine, law, _ = setting()
    unbalance = Unbalance("center", grade=grade, grade_speed=BALANCED, phase=float(seed))
    scenario = replace(
        load_scenario("prbs"),
        speed=speed,
        duration=duration,
        unbalances=(unbalance,) if speed else (),
    )
    data = virtual_rig.run(machine, law, scenario, bending_modes=modes, seed=seed).record
    machine = machine_at_load(machine, [data])
    data, rng = seen(data), np.random.default_rng(seed)
    noise = [
        1e-7 * (name[0] == "y") * rng.standard_normal(data.values.shape[1]) for name in data.signals
    ]
    return replace(data, values=data.values + noise), nominal_values(
        assemble(machine, data.point), expand(machine, UNKNOWN)
    )


CASES = {
    "standstill, 1 mode": lambda seed: linear(0.0, 0.0, 1.0, 1, seed),
    "standstill, 2 modes": lambda seed: linear(0.0, 0.0, 1.0, 2, seed),
    "standstill, 3 modes": lambda seed: linear(0.0, 0.0, 1.0, 3, seed),
    "standstill, 4 modes": lambda seed: linear(0.0, 0.0, 1.0, 4, seed),
    "standstill, 8 modes": lambda seed: linear(0.0, 0.0, 1.0, 8, seed),
    "50 Hz, G2.5": lambda seed: linear(2.5e-3, SPEED, 1.0, 3, seed),
    "50 Hz, G6.3, 1 mode": lambda seed: linear(6.3e-3, SPEED, 1.0, 1, seed),
    "50 Hz, G6.3, 2 modes": lambda seed: linear(6.3e-3, SPEED, 1.0, 2, seed),
    "50 Hz, G6.3, 4 modes": lambda seed: linear(6.3e-3, SPEED, 1.0, 4, seed),
    "50 Hz, G6.3, speed told 0.5 % off": lambda seed: linear(6.3e-3, SPEED, 1.005, 3, seed),
    "50 Hz, G2.5, nothing taken out": lambda seed: linear(2.5e-3, SPEED, 1.0, 3, seed),
    "rig, standstill, 1 mode": lambda seed: nonlinear(0.0, 0.0, 1, seed),
    "rig, standstill, 2 modes": lambda seed: nonlinear(0.0, 0.0, 2, seed),
    "standstill, 4 modes, model 1": lambda seed: linear(0.0, 0.0, 1.0, 4, seed),
    "standstill, 4 modes, model 2": lambda seed: linear(0.0, 0.0, 1.0, 4, seed),
    "rig, standstill, 4 modes, model 1": lambda seed: nonlinear(0.0, 0.0, 4, seed),
    "rig, standstill, 4 modes, model 2": lambda seed: nonlinear(0.0, 0.0, 4, seed),
    "rig, 50 Hz, G6.3, 4 modes, model 1": lambda seed: nonlinear(6.3e-3, SPEED, 4, seed),
    "rig, 50 Hz, G6.3, 4 modes, model 2": lambda seed: nonlinear(6.3e-3, SPEED, 4, seed),
    "rig, standstill, 4 modes": lambda seed: nonlinear(0.0, 0.0, 4, seed),
    "rig, 50 Hz, G6.3, 1 mode": lambda seed: nonlinear(6.3e-3, SPEED, 1, seed),
    "rig, 50 Hz, G6.3, 2 modes": lambda seed: nonlinear(6.3e-3, SPEED, 2, seed),
    "rig, 50 Hz, G6.3, 4 modes": lambda seed: nonlinear(6.3e-3, SPEED, 4, seed),
}


def coverage(runs, chosen):
    """Stated and observed deviations, intervals that hold the truth, and how many correct records
    end with status 0.
    """
    machine, law, _ = setting()
    for title in [title for title in CASES if chosen in title]:
        found = []
        truths = []
        good = 0
        for seed in range(runs):
            data, truth = CASES[title](seed)
            options = {"harmonics": 0} if title.endswith("nothing taken out") else {}
            if ", model " in title:
                options["bending_modes"] = int(title[-1])
            done = amb.identify(machine, data, law, unknown=UNKNOWN, **options)
            found = [*found, done.result]
            truths = [*truths, truth]
            good = good + done.passed
        truth = np.array(truths)
        values, stated = (
            np.array([getattr(one, name) for one in found])
            for name in ("values", "standard_deviations")
        )
        errors, deviations = (
            100 * (values / truth - 1),
            100 * np.mean(stated / np.abs(values), axis=0),
        )
        ratio = deviations / errors.std(axis=0, ddof=1)
        held = np.abs(values - truth) <= COVERAGE * stated
        print(
            f"| {title} | {deviations.min():.3f} to {deviations.max():.3f} | {ratio.min():.2f} to "
            f"{ratio.max():.2f} | "
            f"{np.abs(errors.mean(axis=0)).max():.3f} | {100 * held.mean():.0f} % | "
            f"{100 * good / runs:.0f} % |",
            flush=True,
        )


HALVED = (
    "standstill, 4 modes",
    "50 Hz, G2.5",
    "rig, standstill, 4 modes",
    "rig, 50 Hz, G6.3, 4 modes",
)


def halves(runs):
    """Every record whole and in two halves: how far its halves lie apart over what both state, how
    often the interval of one holds the other's value, and how often the whole one's holds the truth
    as fitted, and as reported, which is wider by the last factor. Records of the rig of 1 s.
    """
    machine, law, _ = setting()
    for title in HALVED:
        apart, fitted, reported, wider = [], [], [], []
        for seed in range(1000, 1000 + runs):
            data, truth = CASES[title](seed)
            data = data.between(0, min(1.0, data.values.shape[1] * data.dt))
            span = data.values.shape[1] * data.dt
            done = amb.identify(machine, data, law, unknown=UNKNOWN)
            start = dict(zip(done.result.paths, done.result.values.tolist(), strict=True))
            one, two, whole = (
                closed_loop.identify(machine, part, law, UNKNOWN, start=start)
                for part in (data.between(0, span / 2), data.between(span / 2, span), data)
            )
            own = np.hypot(one.standard_deviations, two.standard_deviations)
            off = (one.values - two.values) / own
            apart.append(off)
            fitted.append(np.abs(whole.values - truth) <= COVERAGE * whole.standard_deviations)
            stated = done.result.standard_deviations
            reported.append(np.abs(done.result.values - truth) <= COVERAGE * stated)
            wider.append(stated / whole.standard_deviations)
        off = np.array(apart)
        low, high = deviation_factors(runs)
        each = off.std(axis=0)
        print(
            f"| {title} | {np.sqrt((off**2).mean()):.2f} | {each.min():.2f} to {each.max():.2f} "
            f"({1 / high:.2f} to {1 / low:.2f}) | {100 * (np.abs(off) <= COVERAGE).mean():.1f} % | "
            f"{100 * np.mean(fitted):.1f} % | {100 * np.mean(reported):.1f} % | "
            f"{np.median(wider):.2f} |",
            flush=True,
        )


def louder(law, gain):
    return StateSpace(law.A, law.B, gain * law.C, gain * law.D, law.inputs, law.outputs, law.dt)


def filtered(law, corner):
    """The law behind a lag of this corner [rad/s] in every channel."""
    n, a = law.n_states, law.B.shape[1]
    A = np.block([[law.A, corner * law.B], [np.zeros((a, n)), -corner * np.eye(a)]])
    B = np.vstack([np.zeros((n, a)), np.eye(a)])
    return StateSpace(
        A, B, np.hstack([law.C, corner * law.D]), np.zeros((len(law.C), a)), law.inputs, law.outputs
    )


def seen(trace):
    """What a recorder without the controller's outputs has."""
    return trace.select([name for name in trace.signals if name[:2] in {"y_", "e_"}])


def mistakes(without):
    machine, law, _ = setting()
    heavy = replace(
        machine,
        shaft=tuple(
            replace(s, material=replace(s.material, density=1.1 * 7850)) for s in machine.shaft
        ),
    )

    def late(data):
        values = data.values.copy()
        rows = [i for i, name in enumerate(data.signals) if name[:2] == "e_"]
        values[rows, 1:] = values[rows, :-1]
        return replace(data, values=values)

    def scaled(data):
        values = data.values.copy()
        values[[i for i, name in enumerate(data.signals) if name[:2] == "y_"]] *= 1.05
        return replace(data, values=values)

    def told_less(data):
        return replace(
            data, point=replace(data.point, seal_pressure=data.point.seal_pressure / 2.5)
        )

    # the rig's machine and law, what else it has, what becomes of the record, the machine that is
    # told
    cases = {
        "none": (machine, law, {}, None, machine),
        "two samples of delay not told": (machine, law, {"computing_delay": 3}, None, machine),
        "excitation recorded a sample late": (machine, law, {}, late, machine),
        "all sensors 5 % too large": (machine, law, {}, scaled, machine),
        "coupling missing in the model": (machine, law, {}, None, replace(machine, couplings=())),
        "filter of 1.5 kHz not told": (machine, filtered(law, 2 * np.pi * 1500), {}, None, machine),
        "controller 5 % louder": (machine, louder(law, 1.05), {}, None, machine),
        "shaft 10 % heavier": (heavy, law, {}, None, machine),
        "pressure 2.5 times the one told": (machine, law, {}, told_less, machine),
    }
    reference = {}
    for title, (real, ran, options, spoilt, told) in cases.items():
        texts = []
        for speed in (0.0, SPEED):
            scenario = replace(
                load_scenario("prbs"),
                speed=speed,
                duration=2.0,
                unbalances=(Unbalance("center", grade=6.3e-3, grade_speed=BALANCED),)
                if speed
                else (),
            )
            data = seen(virtual_rig.run(real, ran, scenario, bending_modes=3, **options).record)
            data = data if spoilt is None else spoilt(data)
            try:
                done = amb.identify(told, data, law, **({"harmonics": 0} if without else {}))
            except InvalidInput as refusal:
                texts.append(f"refused: {str(refusal)[:60]}")
                continue
            values = dict(zip(done.result.paths, done.result.values, strict=True))
            reference.setdefault(speed, values)
            off = {path: abs(value / reference[speed][path] - 1) for path, value in values.items()}
            path = max(off, key=off.__getitem__)
            codes = (
                ", ".join(sorted({str(finding.code) for finding in done.findings}))
                or "**not flagged**"
            )
            shares = [
                abs(test.correlation) / test.limit * test.visible
                for test in done.result.tests
                if not test.passed
            ]
            share = f"; {100 * max(shares):.2g} % of a response" if shares else ""
            texts.append(f"{codes}{share}; {100 * off[path]:.2g} % ({path})")
        print(f"| {title} | {' | '.join(texts)} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("coverage", "halves", "mistakes"))
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--case", default="", help="those whose title holds this")
    parser.add_argument("--without", action="store_true")
    given = parser.parse_args()
    if given.what == "coverage":
        coverage(given.runs, given.case)
    elif given.what == "halves":
        halves(given.runs)
    else:
        mistakes(given.without)
