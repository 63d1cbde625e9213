"""Bad records are found before they become numbers: on synthetic loops with noise, and on records
of the nonlinear rig.
"""

import re
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.identification import pipeline
from ambrose.identification.data_quality.controller import controller_match
from ambrose.identification.data_quality.diagnosis import Wiring, diagnose_records, wirings
from ambrose.identification.data_quality.signals import flat_tops
from ambrose.identification.findings import Code, Finding, refuse
from ambrose.identification.loop import identify_loop, usual_unknowns
from ambrose.identification.output_error.closed_loop import identify
from ambrose.identification.output_error.problem import FitOptions
from ambrose.identification.validation.plausibility import delay_findings, diagnose_result
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop, match_controller
from ambrose.machine.description import Tolerance
from ambrose.machine.part import SealTable
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.record.record import Record
from ambrose.report.identification import identification_page
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Prbs, Pulse, Scenario

run = partial(pipeline.identify, bending_modes=1)  # as the loops have that made the records

DT = 1e-4
K = 8000
LIMIT = 0.5
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
NINE = (
    "bearing.*.force_per_current.*",
    "bearing.*.negative_stiffness.*",
    "amplifier.natural_frequency",
)


def names(kinds):
    return [f"{kind}_{axis}" for kind in kinds for axis in AXES]


@cache
def setting():
    machine = load_machine("seal-rig")
    # fast to assemble
    machine = replace(machine, shaft=tuple(replace(part, elements=1) for part in machine.shaft))
    plant = free_mode_reduction(assemble(machine), 1)
    controller = pid_synthesis(plant).controller
    return machine, plant, controller


@cache
def synthetic(wrong=0.15, dt=DT, count=K):
    """A loop whose k_s and K_i are off the machine file's by up to ``wrong``; its noise goes round
    the loop.
    """
    machine, plant, controller = setting()
    paths = [
        f"bearing.{b}.{q}.{a}"
        for q in ("force_per_current", "negative_stiffness")
        for b in "AB"
        for a in ("zeta", "eta")
    ]
    moved = dict(
        zip(paths, wrong * np.array([1, -0.5, 0.7, -1, 0.6, -0.8, -0.4, 0.9]), strict=True)
    )
    other = perturbed(plant, moved, [Tolerance(path, relative=1.0) for path in paths])
    law = c2d(match_controller(controller, plant), dt, "tustin", delay=dt)
    loop = select(closed_loop(other, law), names("ed"), names("yui"))
    rng = np.random.default_rng(1)
    e = np.stack([0.2 * waveforms.prbs(9, 10, count, shift=127 * i) for i in range(4)])
    values = simulate(loop, np.vstack([e, 3e-8 * rng.standard_normal((4, count))]))
    units = ("m",) * 4 + ("A",) * 12
    return Record(
        machine.name, 1 / dt, tuple(names("yuie")), units, np.vstack([values, e]), plant.point
    )


@cache
def rig():
    """The nonlinear rig under the same controller."""
    machine, _, controller = setting()
    sequences = tuple(Prbs(f"e_{axis}", 0.2, 1e-3, order=9, seed=i) for i, axis in enumerate(AXES))
    return virtual_rig.run(
        machine, controller, Scenario("bad input", K * DT, sequences=sequences, sample_time=DT)
    ).record


RECORDS = {"synthetic": synthetic, "rig": rig}
both = pytest.mark.parametrize("record", RECORDS)


def change(record, **channels):
    """The record with channels showing other ones: y_A_zeta=("y_A_eta", -1)."""
    values = record.values.copy()
    for name, (source, sign) in channels.items():
        values[record.signals.index(name)] = sign * record[source]
    return replace(record, values=values)


def with_values(record, name, function):
    values = record.values.copy()
    values[record.signals.index(name)] = function(record[name])
    return replace(record, values=values)


def findings(record, controller=None, **more):
    machine, _, own = setting()
    return diagnose_records(machine, record, controller or own, **more)


def only(found, severity, words):
    assert len(found) == 1, found
    assert found[0].severity == severity
    assert words in found[0].what, found[0]
    assert found[0].evidence and found[0].remedy
    return found[0]


@both
def test_good_records_have_no_findings(record):
    assert findings(RECORDS[record]()) == ()


MIXED = [
    ({"y_A_zeta": ("y_A_eta", 1), "y_A_eta": ("y_A_zeta", 1)}, "y_A_zeta and y_A_eta are swapped"),
    (
        {"y_A_zeta": ("y_B_zeta", 1), "y_B_zeta": ("y_A_zeta", 1)},
        "y_A_zeta and y_B_zeta are swapped",
    ),
    ({"u_A_eta": ("u_B_eta", 1), "u_B_eta": ("u_A_eta", 1)}, "u_A_eta and u_B_eta are swapped"),
    ({"e_A_zeta": ("e_B_eta", 1), "e_B_eta": ("e_A_zeta", 1)}, "e_A_zeta and e_B_eta are swapped"),
    ({"i_A_zeta": ("i_A_eta", 1), "i_A_eta": ("i_A_zeta", 1)}, "i_A_zeta and i_A_eta are swapped"),
    ({"y_B_eta": ("y_B_eta", -1)}, "y_B_eta has the wrong sign"),
    ({"u_B_zeta": ("u_B_zeta", -1)}, "u_B_zeta has the wrong sign"),
    ({"e_A_eta": ("e_A_eta", -1)}, "e_A_eta has the wrong sign"),
    ({f"y_{axis}": (f"y_{axis}", -1) for axis in AXES}, "all y_ channels have the wrong sign"),
    (
        {"y_A_zeta": ("y_A_eta", -1), "y_A_eta": ("y_A_zeta", 1)},
        "y_A_zeta and y_A_eta are swapped, y_A_zeta with the wrong sign",
    ),
    (
        {"y_A_zeta": ("y_A_eta", 1), "y_A_eta": ("y_B_zeta", 1), "y_B_zeta": ("y_A_zeta", 1)},
        "y_A_zeta shows y_A_eta; y_A_eta shows y_B_zeta; y_B_zeta shows y_A_zeta",
    ),
]


@pytest.mark.parametrize(
    ("channels", "words"),
    [*MIXED[:4], *(pytest.param(*m, marks=pytest.mark.study) for m in MIXED[4:])],
)
def test_mixed_up_channels_are_named(channels, words):
    found = only(findings(change(synthetic(), **channels)), "error", "channels are mixed up")
    assert found.what == f"channels are mixed up: {words}"
    with pytest.raises(InvalidInput, match=r"ambrose convert --columns"):
        refuse([found])


@pytest.mark.parametrize(("channels", "words"), [MIXED[3], MIXED[5]])
def test_mixed_up_channels_of_the_rig_are_named(channels, words):
    assert words in only(findings(change(rig(), **channels)), "error", "channels are mixed up").what


def test_without_controller_outputs_both_explanations_are_named():
    seen = [name for name in synthetic().signals if name[0] in "ye"]
    swapped = change(synthetic(), y_A_zeta=("y_A_eta", 1), y_A_eta=("y_A_zeta", 1)).select(seen)
    assert "y_A_zeta and y_A_eta are swapped" in only(findings(swapped), "error", "mixed up").what
    turned = change(synthetic(), **{f"y_{axis}": (f"y_{axis}", -1) for axis in AXES}).select(seen)
    # y = T e: signs of all y or of all e, nothing tells
    found = only(findings(turned), "error", "mixed up")
    assert (
        "all y_ channels have the wrong sign" in found.what
        and "all e_ channels have the wrong sign" in found.what
    )


def test_every_wiring_is_a_different_signed_permutation():
    four = list(wirings("y", 4))
    assert len(four) == 383 == len({(w.order, w.signs) for w in four})
    six = list(wirings("y", 6))
    assert len(six) == 1 + 6 + 15 * 4
    matrix = Wiring("y", (1, 0, 2), (1, -1, 1)).matrix("y", 3)
    # channel i shows axis order[i]
    np.testing.assert_array_equal(matrix @ [10.0, 20.0, 30.0], [20.0, -10.0, 30.0])


@both
@pytest.mark.parametrize("stated", [5e3, 2e4])
def test_wrong_sample_rate(record, stated):
    found = only(
        findings(replace(RECORDS[record](), sample_rate_hz=stated)), "error", "were not sampled at"
    )
    assert "at about 10000 Hz" in found.what and f"{stated:g} Hz" in found.what


@both
def test_decimated_record_under_the_old_rate(record):
    half = replace(RECORDS[record](), values=RECORDS[record]().values[:, ::2].copy())
    assert "at about 5000 Hz" in only(findings(half), "error", "were not sampled at 10000 Hz").what


def test_decimated_record_under_its_own_rate_does_not_show_the_controller():
    half = replace(rig(), values=rig().values[:, ::2].copy(), sample_rate_hz=5e3)
    assert any(
        "not the one that ran" in item.what and "record every sample" in item.remedy
        for item in findings(half)
    )


@cache
def pulse():
    """One parallel impulse on the rig: the records of P5."""
    machine, _, controller = setting()
    pulses = tuple(
        Pulse(f"e_{axis}", 0.4, start=0.01, duration=0.01) for axis in ("A_zeta", "B_zeta")
    )
    return virtual_rig.run(
        machine, controller, Scenario("pulse", 0.4, pulses=pulses, sample_time=DT)
    ).record


@pytest.mark.parametrize(("channels", "words"), [MIXED[1], MIXED[5]])
def test_one_impulse_tells_mixed_up_channels(channels, words):
    assert all(
        item.severity == "warning" and "start values" in item.what for item in findings(pulse())
    )
    assert (
        words in only(findings(change(pulse(), **channels)), "error", "channels are mixed up").what
    )


def test_a_pressure_that_changes_within_the_record():
    moving = replace(
        synthetic(),
        signals=(*synthetic().signals, "p_seal"),
        units=(*synthetic().units, "Pa"),
        values=np.vstack([synthetic().values, np.linspace(1e5, 2e5, K)]),
    )
    assert (
        "1e+05 to 2e+05 Pa" in only(findings(moving), "error", "operating point changes").evidence
    )


def test_every_operating_point_is_compared_with_its_own_model():
    _, _, controller = setting()
    still = replace(setting()[0].operation.points[1], label="")
    machine, plant, _ = setting()
    plant = free_mode_reduction(assemble(machine, still), 1)
    law = c2d(match_controller(controller, plant), DT, "tustin", delay=DT)
    e = synthetic().values[12:]
    values = np.vstack([simulate(select(closed_loop(plant, law), names("e"), names("yui")), e), e])
    other = replace(synthetic(), values=values, point=still)
    assert diagnose_records(machine, [synthetic(), other], controller) == ()
    bad = change(other, y_B_eta=("y_B_eta", -1))
    assert (
        "y_B_eta has the wrong sign"
        in only(diagnose_records(machine, [synthetic(), bad], controller), "error", "mixed").what
    )
    begin = {"seal.center.k": 1.02 * machine.seals[0].k}
    assert diagnose_records(machine, [synthetic()], controller, start=begin) == ()


def test_held_samples_tell_the_true_rate():
    held = replace(synthetic(), values=np.repeat(synthetic().values, 2, axis=1)[:, :K])
    found = [item for item in findings(held) if "held for 2 samples" in item.evidence]
    assert "as if measured at 5000 Hz" in only(found, "error", "sample rate of 10000 Hz").evidence


@both
@pytest.mark.parametrize("missing", [[7000], [3000, 7345]])
def test_missing_samples_are_found_where_they_are(record, missing):
    found = only(
        findings(
            replace(RECORDS[record](), values=np.delete(RECORDS[record]().values, missing, axis=1))
        ),
        "warning",
        "missing",
    )
    assert all(f"{at - n} (t =" in found.evidence for n, at in enumerate(missing)), found.evidence


def test_many_missing_samples_are_refused():
    found = findings(
        replace(rig(), values=np.delete(rig().values, np.arange(500, 7700, 600), axis=1))
    )
    assert "and 7 more" in only(found, "error", "missing").evidence


def test_repeated_samples():
    values = synthetic().values.copy()
    values[:, 6000:6003] = values[:, 5999:6000]
    found = findings(replace(synthetic(), values=values))
    assert (
        "first at sample 6000"
        in next(item for item in found if "repeated in all channels" in item.what).evidence
    )


def test_a_disturbed_sample_of_one_channel():
    def knock(x):
        x = x.copy()
        x[5000] += 5e-6
        return x

    assert (
        "y_B_zeta or u_B_zeta"
        in only(findings(with_values(synthetic(), "y_B_zeta", knock)), "warning", "disturbed").what
    )


@both
def test_another_computing_delay(record):
    found = only(
        findings(RECORDS[record](), computing_delay=0),
        "warning",
        "follows the controller after 1 sample, not 0",
    )
    assert "give --delay-samples 1" in found.remedy


@both
def test_a_channel_that_is_a_sample_late(record):
    late = with_values(RECORDS[record](), "y_A_eta", lambda x: np.r_[x[:1], x[:-1]])
    assert (
        "A_eta (0 samples)"
        in only(findings(late), "warning", "not recorded at the same time").evidence
    )


@pytest.mark.parametrize(("factor", "severity"), [(1.03, "warning"), (1.4, "error")])
def test_another_gain(factor, severity):
    found = only(
        findings(with_values(synthetic(), "u_B_eta", lambda x: factor * x)),
        severity,
        "another gain",
    )
    assert f"u_B_eta is {factor:.4g} times K(-y)" in found.evidence


def test_another_controller():
    _, _, controller = setting()
    faster = replace(controller, A=3 * controller.A, B=3 * controller.B)
    found = [item for item in findings(rig(), faster) if "not the one that ran" in item.what]
    assert found and float(found[0].evidence.split("by ")[1].split(" %")[0]) > 5


def test_noise_between_controller_and_recorder_is_no_other_controller():
    rng = np.random.default_rng(2)
    noisy = synthetic().values.copy()
    noisy[:4] += 2e-7 * rng.standard_normal(noisy[:4].shape)
    machine, plant, controller = setting()
    record = replace(synthetic(), values=noisy)
    match = controller_match(
        machine, record, c2d(match_controller(controller, plant), DT, "tustin")
    )
    assert match.least.max() > 0.05  # the derivative action makes much of it
    assert findings(record) == ()


@pytest.mark.parametrize("step", [1.5e-8, 2.5e-7])
def test_a_coarse_converter_is_no_other_controller(step):
    values = synthetic().values.copy()
    values[:4] = np.round(values[:4] / step) * step
    values[4:8] = np.round(values[4:8] / 1e-3) * 1e-3
    assert findings(replace(synthetic(), values=values)) == ()


def test_an_unstable_controller_is_compared_through_its_innovation():
    machine, *_ = setting()
    rng = np.random.default_rng(3)
    A = np.diag([1.02, 0.9, 0.95, 0.8])
    law = StateSpace(
        A, np.eye(4) * 50, np.eye(4) * 40, 9000 * np.eye(4), names(["err"]), names("u"), DT
    )
    y = 1e-6 * rng.standard_normal((4, 3000))
    x = np.zeros((4, 3001))
    for t in range(3000):  # errors that keep the unstable state bounded
        y[:, t] += 0.004 * x[:, t]
        x[:, t + 1] = A @ x[:, t] + law.B @ -y[:, t]
    u = law.C @ x[:, :-1] - law.D @ y
    assert np.abs(x).max() < 1
    record = Record(
        machine.name, 1 / DT, tuple(names("yu")), ("m",) * 4 + ("A",) * 4, np.vstack([y, u])
    )
    match = controller_match(machine, record, law)
    assert match.least.max() < 1e-9 and not match.lag.any()
    other = controller_match(machine, record, replace(law, D=1.1 * law.D))
    assert other.least.min() > 0.01


def test_no_excitation_and_one_that_the_machine_does_not_follow():
    record = synthetic()
    assert (
        "y_, u_, i_"
        in only(
            findings(record.select([n for n in record.signals if n[0] != "e"])),
            "error",
            "no excitation",
        ).evidence
    )
    still = replace(record, values=np.vstack([record.values[:12], np.zeros((4, K))]))
    assert "never change" in only(findings(still), "error", "no excitation").evidence
    rng = np.random.default_rng(4)
    other = np.repeat(rng.choice([-0.2, 0.2], (4, K // 10)), 10, axis=1)
    unplugged = replace(record, values=np.vstack([record.values[:12], other]))
    assert (
        "would be chance"
        in only(findings(unplugged), "error", "no trace of the excitation").evidence
    )
    renamed = replace(record, signals=(*record.signals[:12], "e_1", "e_2", "e_3", "e_4"))
    assert "fit no axis" in only(findings(renamed), "error", "no excitation").evidence


@both
def test_clipped_signals(record):
    level = 0.6 * np.abs(RECORDS[record]()["y_A_zeta"]).max()
    found = findings(
        with_values(RECORDS[record](), "y_A_zeta", lambda x: np.clip(x, -level, level))
    )
    assert (
        found[0].severity == "error"
        and "y_A_zeta is clipped" in found[0].what
        and f"{level:.4g} m" in found[0].evidence
    )


def test_flat_tops_are_told_from_coarse_steps():
    t = np.arange(20000) * DT
    rng = np.random.default_rng(5)
    sine = np.sin(2 * np.pi * 17.3 * t)
    assert flat_tops(sine)[0] == 0
    assert flat_tops(np.round(sine * 40) / 40)[0] == 0  # a converter of few steps
    assert flat_tops(np.round((sine + 0.2 * rng.standard_normal(len(t))) * 100) / 100)[0] == 0
    count, level = flat_tops(np.clip(np.round(sine * 40) / 40, -1.1, 0.8))
    assert level == 0.8 and 0.15 < count / len(t) < 0.25
    assert flat_tops(np.clip(sine, -0.999, 2))[1] == -0.999


def test_saturated_currents_of_the_rig_and_touchdown():
    machine, _, controller = setting()
    weak = replace(
        machine, bearings=tuple(replace(item, max_current=LIMIT) for item in machine.bearings)
    )
    weak = replace(weak, gravity_direction=None)
    sequences = tuple(Prbs(f"e_{axis}", 0.15, 1e-3, order=9, seed=i) for i, axis in enumerate(AXES))
    record = virtual_rig.run(
        weak, controller, Scenario("weak", 1.0, sequences=sequences, sample_time=DT)
    ).record
    share = [np.mean(np.abs(record[f"u_{axis}"]) >= 0.999 * LIMIT) for axis in AXES]
    print(share)
    assert 0 < max(share) < 0.1
    found = diagnose_records(weak, record, controller)
    assert any("is saturated" in item.what and f"{LIMIT:g} A" in item.evidence for item in found)
    # samples at the limit do not count against it
    assert not any("controller" in item.what for item in found)
    deep = with_values(synthetic(), "y_B_eta", lambda x: x + 2.6e-4 * (np.arange(K) == 500))
    assert any("y_B_eta reaches the touchdown bearing" in item.what for item in findings(deep))


def test_a_record_given_twice():
    machine, _, controller = setting()
    found = diagnose_records(machine, [synthetic(), replace(synthetic())], controller)
    assert "record 2 is record 1 once more" in only(found, "error", "once more").what


def test_a_dead_channel():
    dead = with_values(synthetic(), "y_B_eta", lambda x: 0 * x + 1e-6)
    assert (
        "all 8000 samples are 1e-06"
        in only(findings(dead), "error", "y_B_eta never changes").evidence
    )


def test_a_response_far_from_the_start_values_is_only_a_warning():
    found = only(findings(synthetic(0.35)), "warning", "responds otherwise")
    assert "power unexplained" in found.evidence
    machine, _, controller = setting()
    result = run(machine, [synthetic(0.35)], controller, unknown=NINE).result
    np.testing.assert_allclose(result.values[0] / result.start[0], 1.35, rtol=0.01)


def heavier(machine, factor):
    return tuple(
        replace(s, material=replace(s.material, density=factor * 7850)) for s in machine.shaft
    )


def test_a_wrong_mass_that_no_record_can_tell():
    machine, _, controller = setting()
    machine = replace(machine, seals=(), couplings=(), tolerances=())
    plant = free_mode_reduction(assemble(machine), 1)
    loop = select(
        closed_loop(plant, c2d(match_controller(controller, plant), DT, "tustin", delay=DT)),
        names("e"),
        names("yu"),
    )
    e = np.stack([0.2 * waveforms.prbs(9, 10, 10000, shift=127 * i) for i in range(4)])
    values = np.vstack([simulate(loop, e), e])
    values[:4] += 1e-8 * np.random.default_rng(0).standard_normal((4, 10000))
    record = Record(
        machine.name, 1 / DT, tuple(names("yue")), ("m",) * 4 + ("A",) * 8, values, plant.point
    )
    checked = run(
        replace(machine, shaft=heavier(machine, 1.2)), [record], controller, unknown=NINE[:2]
    )
    found = next(item for item in checked.findings if "same factor" in item.what)
    assert found.evidence.startswith("1.19") or (
        found.evidence.startswith("1.2") and "weigh the rotor" in found.remedy
    )


def test_wrong_machine_and_wrong_mass():
    machine, _, controller = setting()
    with pytest.raises(InvalidInput, match="machine of record 1 is 'turboexpander'"):
        run(machine, [replace(synthetic(), machine="turboexpander")], controller, unknown=NINE)
    fat = replace(machine, shaft=heavier(machine, 1.2))
    # the seal's known stiffness betrays it
    assert not run(fat, [synthetic(0.0)], controller, unknown=NINE).passed
    short = replace(
        machine,
        # sensors of A and B exchanged
        sensors=tuple(replace(s, position=860e-3 - s.position) for s in machine.sensors),
    )
    with pytest.raises(InvalidInput, match=r"mixed up|no values of these parameters|unstable"):
        run(short, [synthetic(0.0)], controller, unknown=NINE)


def test_impossible_values_are_refused_and_distant_ones_doubted():
    machine, _, controller = setting()
    checked = run(machine, [synthetic()], controller, unknown=NINE)
    assert not checked.findings and checked.passed
    result = checked.result
    turned = replace(result, values=np.r_[-result.values[:1], result.values[1:]])
    found = diagnose_result(machine, turned, checked.outputs)
    assert found[0].severity == "error" and "bearing.A.force_per_current.zeta = -" in found[0].what
    tripled = replace(result, values=np.r_[3 * result.start[:1], result.values[1:]])
    distant, alone = diagnose_result(machine, tripled, checked.outputs)
    assert "3 times its start" in only([distant], "warning", "far from").evidence
    # K_i moved and its K_s did not: no magnet does that
    assert only([alone], "warning", "force_per_current")
    stiff = replace(result, values=np.r_[result.values[:4], -result.values[4:5], result.values[5:]])
    turned, alone = diagnose_result(machine, stiff, checked.outputs)
    assert "not destabilising" in only([turned], "warning", "negative_stiffness").what
    assert only([alone], "warning", "negative_stiffness")


def test_a_knock_during_the_record_is_found_in_the_residual():
    def knocked(x):
        return x + 4e-6 * np.exp(-0.5 * ((np.arange(K) - 7000) / 20) ** 2)

    machine, _, controller = setting()
    # without u nothing shows it before
    seen = [name for name in synthetic().signals if name[0] in "ye"]
    record = with_values(synthetic(), "y_A_zeta", knocked).select(seen)
    checked = run(machine, [record], controller, unknown=NINE)
    assert any(
        "y_A_zeta leaves the model" in item.what and "0.69" in item.evidence
        for item in checked.findings
    )


@pytest.mark.parametrize("given", [0, pytest.param(2, marks=pytest.mark.study)])
def test_a_wrong_delay_without_controller_outputs_is_found_after_the_fit(given):
    """The true one is a sample; it is found as an unknown, with its deviation, and the right one is
    not complained about.
    """
    machine, _, controller = setting()
    record = synthetic().select([name for name in synthetic().signals if name[0] in "ye"])
    checked = run(machine, [record], controller, unknown=NINE, computing_delay=given)
    found = next(item for item in checked.findings if "computing delay of" in item.what)
    count = float(re.search(rf"delay of (\S+) instead of {given} samples", found.what)[1])
    deviation = float(re.search(r"standard deviation (\S+) samples", found.evidence)[1])
    assert abs(count - 1) < 4 * deviation and deviation < 0.01
    assert "lag of amplifier or sensor" in found.remedy and not checked.passed


def test_where_the_delay_cannot_be_an_unknown_whole_ones_are_tried():
    """A fitted controller output has no instant between samples."""
    machine, _, controller = setting()
    result = identify(machine, synthetic(), controller, NINE, signals=names("y"), computing_delay=0)

    def whole(delay):
        if delay == 1:
            return replace(result, fit=tuple((n, name, 99.0) for n, name, _ in result.fit))
        raise InvalidInput("no")

    def refused():
        return identify(
            machine,
            synthetic(),
            controller,
            (*NINE, "delay"),
            signals=names("yu"),
            computing_delay=0,
        )

    found = only(
        delay_findings(result, 0.0, DT, refused, whole),
        "warning",
        "delay of 1 instead of 0 samples",
    )
    assert "% with 1" in found.evidence and "give --delay-samples 1" in found.remedy
    worse = replace(result, fit=tuple((n, name, 0.0) for n, name, _ in result.fit))
    assert delay_findings(result, 0.0, DT, refused, lambda delay: worse) == ()
    assert delay_findings(replace(result, tests=()), 0.0, DT, refused, whole) == ()


def test_an_unknown_delay_is_found_and_not_complained_about():
    machine, _, controller = setting()
    whole = run(machine, [synthetic()], controller, unknown=(*NINE, "delay"), computing_delay=0)
    assert whole.result.values[-1] == pytest.approx(DT, rel=0.01)
    assert not any("follows the controller after" in item.what for item in whole.findings)
    rows = identification_page(whole).sections[0].tables[0].cells
    assert rows[-1][0].text == "controller.delay" and rows[-1][2].text.endswith("ms")
    assert len(whole.outputs[0].residual[0]) == K and np.std(
        whole.outputs[0].residual
    ) < 0.05 * np.std(whole.outputs[0].measured)
    late = run(machine, [synthetic()], controller, unknown=(*NINE, "excitation.delay"))
    assert late.outputs[0].residual.shape == late.outputs[0].record.select(names("y")).values.shape
    assert abs(late.result.values[-1]) < 0.05 * DT


def test_an_unknown_that_is_not_excited_is_doubted_or_refused():
    machine, plant, controller = setting()
    record = synthetic(count=12_000)
    unknown = (
        *NINE,
        "coupling.coupling.damping.zeta",
        "coupling.coupling.damping.eta",
        "seal.center.C",
        "seal.center.c",
    )
    checked = identify_loop(
        machine, [record], controller, unknown, options=FitOptions(bending_modes=1)
    )
    assert not checked.passed and any(
        finding.code == Code.HARDLY_VISIBLE for finding in checked.findings
    )
    # no machine has such values
    with pytest.raises(InvalidInput, match=r"damping \(zeta\) is -.*must be zero or positive"):
        run(machine, [record], controller, unknown=unknown)
    assert plant.axes == AXES


def test_a_start_at_which_the_loop_is_unstable_is_refused():
    machine, _, controller = setting()
    with pytest.raises(InvalidInput, match="the loop at the start values is unstable"):
        run(
            machine,
            [synthetic()],
            controller,
            unknown=NINE,
            start={"bearing.A.negative_stiffness.zeta": 9e6},
        )


def test_usual_unknowns():
    machine, *_ = setting()
    found = usual_unknowns(machine, [synthetic()])
    assert len(found) == 10 and found[-2:] == ("amplifier.natural_frequency", "seal.center.k")
    still = replace(synthetic(), point=replace(synthetic().point, seal_pressure=0.0))
    assert "seal.center.k" not in usual_unknowns(machine, [still])
    marked = replace(machine, tolerances=(Tolerance("bearing.A.force_per_current", relative=0.1),))
    assert len(usual_unknowns(marked)) == 9
    table = SealTable((("pressure", (0.0, 4.08e5)),), (("k", (0.0, 6.4e6)),))
    alone = replace(
        machine.seals[0], K=0.0, k=0.0, C=0.0, c=0.0, table=table, scales_with_pressure=()
    )
    tabulated = replace(machine, seals=(alone,))
    assert "seal.center.k" not in usual_unknowns(tabulated)  # it could not be written back
    # from its geometry
    assert not any(
        path.startswith("seal") for path in usual_unknowns(load_machine("turboexpander"))
    )


def test_a_finding_has_one_of_two_severities():
    with pytest.raises(InvalidInput, match="severity"):
        Finding(Code.CLIPPED, "fatal", "x", "y", "z")
