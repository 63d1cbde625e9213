"""The seal monitor against simulations of the loop in which the seal is known: exact without noise,
honest with it.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ambrose.annexes.scheduled.seal_monitor import seal_model, students_t
from ambrose.annexes.scheduled.seal_watch import NOTCH, SealMonitor, measuring_filter, monitor
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate, simulate_piecewise
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop, match_controller
from ambrose.machine.description import Tolerance
from ambrose.machine.part import SealTable
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.record.record import Record
from coarse import coarse

DT, LENGTH = 1e-4, 16_000
PATH = "seal.center.pressure"


@cache
def setting():
    machine = coarse("seal-rig")
    return machine, pid_synthesis(free_mode_reduction(assemble(machine), 3)).controller


def excitation(amplitude, axes=4):
    steps = np.random.default_rng(1).integers(0, 2, (axes, LENGTH // 10)) * 2 - 1
    return amplitude * np.repeat(steps, 10, axis=1)


@cache
def loop(share, modes=3, moved=()):
    """The sampled loop of the rig at a share of the nominal pressure, parameters moved relative to
    their values.
    """
    machine, law = setting()
    nominal = machine.operation.nominal
    plant = free_mode_reduction(
        assemble(machine, replace(nominal, seal_pressure=share * nominal.seal_pressure)), modes
    )
    tolerances = [Tolerance(path, relative=abs(value)) for path, value in moved]
    if moved:
        plant = perturbed(plant, {path: float(np.sign(value)) for path, value in moved}, tolerances)
    return closed_loop(plant, c2d(match_controller(law, plant), DT, "tustin", delay=DT))


def recorded(share, e, modes=3, moved=(), noise=0.0, seed=0):
    """A record of the linear loop; the noise of the sensors runs through the controller."""
    machine = setting()[0]
    d = noise * np.random.default_rng(seed).standard_normal(e.shape)
    driven, seen = (
        [f"{kind}_{axis}" for kind in kinds for axis in machine.axes] for kinds in ("ed", "yu")
    )
    y = simulate(select(loop(share, modes, moved), driven, seen), np.vstack([e, d]))
    names = (*seen, *driven[:4])
    units = ("m",) * 4 + ("A",) * 8
    return Record(
        machine.name,
        1 / DT,
        names,
        units,
        np.vstack([y, e]),
        replace(machine.operation.nominal, label=""),
    )


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_without_noise_the_seal_is_found_at_every_pressure(share):
    """Whatever pressure the record claims; what is left is the third power of theta (measured: 2e-4
    at 0.5, 8e-4 at 1).
    """
    machine, law = setting()
    found = monitor(machine, law, recorded(share, excitation(0.02)), doubts={}, rate=0.0)
    values = found.values[found.known_at, 0] / found.reference[0]
    assert len(values) > 50 and np.abs(values - share).max() < 1e-3 * max(share**3, 0.1)
    assert found.reference == [machine.operation.nominal.seal_pressure]


def test_one_bending_mode_in_the_observer_is_enough_and_none_is_not():
    machine, law = setting()
    record = recorded(1.0, excitation(0.02))
    one, none = (
        monitor(machine, law, record, doubts={}, bending_modes=k).values[-1, 0] for k in (1, 0)
    )
    true = machine.operation.nominal.seal_pressure
    assert abs(one / true - 1) < 3e-3 < abs(none / true - 1)


def test_stiffness_and_damping_apart():
    machine, law = setting()
    found = monitor(
        machine,
        law,
        recorded(0.5, excitation(0.02)),
        unknown=("K", "k", "C", "c"),
        doubts={},
        rate=0.0,
    )
    seal = machine.seals[0]
    assert found.values[-1] == pytest.approx(
        0.5 * np.array([seal.K, seal.k, seal.C, seal.c]), rel=3e-3
    )


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("bearing.A.force_per_current.zeta", "force_per_current"),
        pytest.param(
            "bearing.B.negative_stiffness.eta", "negative_stiffness", marks=pytest.mark.study
        ),
        ("amplifier.natural_frequency", "amplifier"),
    ],
)
def test_the_effect_of_what_is_taken_as_known_is_exact(path, kind):
    """Against the same loop with the parameter moved: the estimate shifts by as much as is said (of
    the seal only to first order: the loop is without pressure).
    """
    machine, law = setting()
    e, step = excitation(0.02), 1e-3
    shift = [
        monitor(machine, law, recorded(0.0, e, moved=moved), doubts={}, rate=0.0).values[-1, 0]
        for moved in ((), ((path, step),))
    ]
    record = recorded(0.0, e)
    model = seal_model(machine, law, record.point, [PATH], DT, doubts={kind: step})
    following = SealMonitor(model, rate=0.0)
    y, u = (np.stack([record[f"{k}_{axis}"] for axis in machine.axes]) for k in "yu")
    following.follow(y, u + e, e)
    window = following._long
    kinds = [i for i, name in enumerate(general_paths(machine, kind)) if name == path]
    effect = window.known[0, kinds[0]] / window.sums[1] * model.reference[0]
    assert effect == pytest.approx(shift[1] - shift[0], rel=0.05)


def general_paths(machine, kind):
    if kind == "amplifier":
        return ["amplifier.natural_frequency"]
    return [
        f"bearing.{item.name}.{kind}.{axis}"
        for item in machine.bearings
        for axis in ("zeta", "eta")
    ]


def test_pieces_of_a_record_give_the_same_as_the_whole():
    machine, law = setting()
    e = excitation(0.02)
    record = recorded(1.0, e, noise=1e-7)
    model = seal_model(machine, law, record.point, [PATH], DT)
    y, u = (np.stack([record[f"{k}_{axis}"] for axis in machine.axes]) for k in "yu")
    whole, pieces = SealMonitor(model), SealMonitor(model)
    at_once = whole.follow(y, u + e, e)
    one_by_one = []
    for part in np.array_split(np.arange(LENGTH), 37):
        one_by_one += pieces.follow(y[:, part], (u + e)[:, part], e[:, part])
    assert len(at_once) == len(one_by_one) > 50
    for a, b in zip(at_once[6:], one_by_one[6:], strict=True):
        assert a.theta == pytest.approx(b.theta, rel=1e-9) and a.half_width == pytest.approx(
            b.half_width, rel=1e-7
        )


@pytest.mark.study
def test_noise_widens_the_interval_as_it_scatters_the_estimate():
    """40 records of the loop with white noise: the noise part holds at least 36, and is no more
    than 6 times too wide.
    """
    machine, law = setting()
    e = excitation(0.02)
    runs = [
        monitor(
            machine, law, recorded(0.0, e, noise=1e-7, seed=k), bending_modes=1, doubts={}, rate=0.0
        )
        for k in range(40)
    ]
    errors, noise = (
        np.array([getattr(one, name)[-1, 0] for one in runs]) for name in ("values", "noise")
    )
    assert (np.abs(errors) <= noise).sum() >= 36
    assert np.median(noise) < 6 * 2 * errors.std()


def test_without_excitation_it_says_so():
    machine, law = setting()
    e = excitation(0.02)
    found = monitor(machine, law, recorded(1.0, 0 * e, noise=1e-7))
    assert not found.known_at.any() and "nothing can be said" in found.findings[0]
    assert np.isnan(found.values).all() and "nan" not in found.to_csv()
    ends = e * (np.arange(LENGTH) < 6000)
    found = monitor(machine, law, recorded(1.0, ends, noise=1e-7), window=0.1)
    assert (
        found.known_at.any()
        and not found.known_at[-1]
        and any("the excitation ended" in x for x in found.findings)
    )


def test_a_step_of_the_seal_begins_the_estimate_anew():
    """The loop at two pressures, one after the other, from the states it has: a step of 30 % half
    way.
    """
    machine, law = setting()
    e = excitation(0.05)
    first, second = loop(1.0), loop(0.7)
    names = [[f"{k}_{axis}" for k in kinds for axis in machine.axes] for kinds in ("e", "yu")]
    half = LENGTH // 2
    y = simulate_piecewise(
        [select(first, *names), select(second, *names)], [e[:, :half], e[:, half:]]
    )
    y[:4] += 1e-8 * np.random.default_rng(0).standard_normal(y[:4].shape)
    record = replace(recorded(1.0, e), values=np.vstack([y, e]))
    found = monitor(machine, law, record)
    assert (
        len(found.restarts) == 1
        and 0.8 < found.restarts[0] < 1.35
        and "began anew" in found.findings[0]
    )
    late = found.known_at & (found.time > 1.4)
    assert np.abs(found.values[late, 0] / found.reference[0] - 0.7).max() < 0.02
    assert any("outside the estimate" in text for text in found.findings)


def test_the_notch_takes_out_what_turns_and_leaves_the_rest():
    speed = 2 * np.pi * 50
    filters = measuring_filter(speed, DT)
    assert len(filters.sections) == 4 and len(measuring_filter(0.0, DT).sections) == 1

    def gain(omega):
        z = np.exp(1j * omega * DT) ** -np.arange(3)
        return np.prod([abs(row[:3] @ z / (np.r_[1, row[3:]] @ z)) for row in filters.sections])

    assert all(gain(k * speed) < 1e-9 for k in (1, 2, 3)) and gain(1e-6) < 1e-9
    assert (
        gain(speed + 0.5 * NOTCH) == pytest.approx(np.sqrt(0.5), rel=0.05)
        and gain(2 * np.pi * 75) > 0.98
    )
    assert filters.settling < 0.8


def test_students_t():
    from scipy.stats import t

    for freedom in (3, 5, 8, 20, 200):
        assert students_t(freedom) == pytest.approx(t.ppf(0.975, freedom), rel=0.01)


def test_refusals():
    machine, law = setting()
    record = recorded(1.0, excitation(0.02))
    with pytest.raises(InvalidInput, match="one of center"):
        monitor(machine, law, record, seal="other")
    with pytest.raises(InvalidInput, match=r"no \[\[seal\]\]"):
        monitor(replace(machine, seals=(), tolerances=()), law, record)
    twice = replace(
        machine, seals=(*machine.seals, replace(machine.seals[0], name="second", position=0.4))
    )
    with pytest.raises(InvalidInput, match="name the one to watch"):
        monitor(twice, law, record)
    with pytest.raises(InvalidInput, match="the machine of the record is 'another'"):
        monitor(machine, law, replace(record, machine="another"))
    with pytest.raises(InvalidInput, match="no u_A_zeta"):
        monitor(machine, law, record.select([n for n in record.signals if n != "u_A_zeta"]))
    with pytest.raises(InvalidInput, match="record longer"):
        monitor(machine, law, record.between(0.0, 0.3))
    with pytest.raises(InvalidInput, match="no seal's"):
        seal_model(machine, law, record.point, ["bearing.A.negative_stiffness"], DT)
    with pytest.raises(InvalidInput, match="zero at every operating point"):
        still = replace(machine, seals=(replace(machine.seals[0], C=0.0),))
        monitor(still, law, record, unknown=("C",))
    with pytest.raises(InvalidInput, match="unstable together"):
        monitor(machine, replace(law, D=-law.D, C=-law.C), record)
    with pytest.raises(InvalidInput, match="window"):
        monitor(machine, law, record, window=-1.0)


def test_of_two_seals_one_is_watched_and_the_other_is_at_its_pressure():
    machine, law = setting()
    two = replace(
        machine,
        seals=(
            *machine.seals,
            replace(machine.seals[0], name="second", position=0.35, k=5e5, K=0.0),
        ),
    )
    plant = free_mode_reduction(assemble(two), 3)
    system = closed_loop(plant, c2d(match_controller(law, plant), DT, "tustin", delay=DT))
    assert np.abs(np.linalg.eigvals(system.A)).max() < 1
    e = excitation(0.02)
    names = [[f"{k}_{axis}" for k in kinds for axis in machine.axes] for kinds in ("e", "yu")]
    record = replace(recorded(1.0, e), values=np.vstack([simulate(select(system, *names), e), e]))
    found = monitor(two, law, record, seal="second", unknown=("k",), doubts={}, rate=0.0)
    assert found.values[-1, 0] == pytest.approx(5e5, rel=5e-3)


def test_a_seal_with_states_is_watched_by_its_pressure_and_refused_without():
    machine, law = setting()
    grid = (0.0, 200.0, 400.0, 800.0, 1600.0, 3200.0)
    rows = tuple(
        (name, tuple(getattr(machine.seals[0], name) * (1 + slope * w / 3200) for w in grid))
        for name, slope in (("K", 1.0), ("k", -0.3), ("C", -0.4), ("c", -0.2))
    )
    table = SealTable((("frequency", grid),), rows)
    seal = replace(
        machine.seals[0], K=0.0, k=0.0, C=0.0, c=0.0, table=table, frequency_dependence="states"
    )
    rig, point = replace(machine, seals=(seal,)), machine.operation.nominal
    plant = free_mode_reduction(
        assemble(rig, replace(point, seal_pressure=0.5 * point.seal_pressure)), 3
    )
    system = closed_loop(plant, c2d(match_controller(law, plant), DT, "tustin", delay=DT))
    e = excitation(0.02)
    names = [[f"{k}_{axis}" for k in kinds for axis in machine.axes] for kinds in ("e", "yu")]
    record = replace(recorded(1.0, e), values=np.vstack([simulate(select(system, *names), e), e]))
    found = monitor(rig, law, record, doubts={}, rate=0.0)
    assert found.values[-1, 0] == pytest.approx(0.5 * point.seal_pressure, rel=1e-3)
    with pytest.raises(InvalidInput, match="with states"):
        monitor(rig, law, replace(record, point=replace(point, seal_pressure=0.0, label="")))
