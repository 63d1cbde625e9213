"""Closed-loop identification on linear and nonlinear records of known machines."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import scipy.linalg as sla
from benchmarks import waveforms

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.output_error import closed_loop as fit
from ambrose.identification.output_error.loop_model import loop_model
from ambrose.identification.parameters import expand, nominal_values, update_machine
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop, match_controller
from ambrose.machine.description import Tolerance
from ambrose.model.assemble import assemble
from ambrose.model.effects import magnet
from ambrose.model.static_load import operating_magnets
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.record.record import Record
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Prbs, Scenario
from whole_records import simulate_derivative

DT = 1e-4
identify = partial(fit.identify, bending_modes=1)  # as the loops have that made the records
NINE = (
    "bearing.*.force_per_current.*",
    "bearing.*.negative_stiffness.*",
    "amplifier.natural_frequency",
)
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
Y = tuple(f"y_{a}" for a in AXES)
E = tuple(f"e_{a}" for a in AXES)


@cache
def rig():
    machine = load_machine("seal-rig")
    plant = free_mode_reduction(assemble(machine), 1)
    controller = pid_synthesis(plant).controller
    return machine, plant, controller, c2d(controller, DT, "tustin", delay=DT)


@cache
def truth():
    machine, plant, *_ = rig()
    paths = expand(machine, NINE)
    return paths, nominal_values(plant, paths)


def measured(loop, e, point, noise=0.0, seed=0, machine="seal-rig", skip=0):
    """A record of the loop, an independent assembly (law/loop.py), for excitations e (4, k)."""
    y = simulate(select(loop, E, Y), e)
    y = (y + noise * np.random.default_rng(seed).standard_normal(y.shape))[:, skip:]
    return Record(
        machine, 1 / DT, (*Y, *E), ("m",) * 4 + ("A",) * 4, np.vstack([y, e[:, skip:]]), point
    )


def sequences(k, clock=10, order=9):
    return np.stack([0.1 * waveforms.prbs(order, clock, k, shift=127 * i) for i in range(4)])


@cache
def clean(k=4000, skip=0):
    _, plant, _, law = rig()
    return measured(closed_loop(plant, law), sequences(k), plant.point, skip=skip)


def test_the_model_is_the_loop_and_its_change_is_that_of_the_plant():
    _, plant, _, law = rig()
    paths, nominal = truth()
    paths, nominal = (
        (*paths, "seal.center.k"),
        np.append(nominal, nominal_values(plant, ["seal.center.k"])),
    )
    signals = (*Y, "u_A_eta", "i_B_zeta")
    model = loop_model(plant, match_controller(law, plant), paths, nominal, E, signals)
    e = sequences(300)
    for change in (np.zeros(len(paths)), 0.1 * nominal):
        moved = dict(zip(paths, np.sign(change), strict=True))
        tolerances = [
            Tolerance(path, absolute=0.1 * abs(value))
            for path, value in zip(paths, nominal, strict=True)
        ]
        other = perturbed(plant, moved, tolerances) if change.any() else plant
        expected = simulate(select(closed_loop(other, law), E, signals), e)
        np.testing.assert_allclose(
            simulate(model.loop(nominal + change)[0], e),
            expected,
            rtol=0,
            atol=1e-10 * abs(expected).max(),
        )


def test_jacobian_against_complex_step():
    _, plant, _, law = rig()
    paths, nominal = truth()
    law = match_controller(law, plant)
    model = loop_model(plant, law, paths, nominal, E, Y)
    e = sequences(400)
    loop, directions = model.loop(nominal)
    y, J = simulate_derivative(loop, directions, e)

    def outputs(theta):  # an independent recursion in complex numbers
        step = theta - model.theta0
        A, B = (
            model.A + np.tensordot(step, model.A_theta, 1),
            model.B + np.tensordot(step, model.B_theta, 1),
        )
        n, m = B.shape
        held = sla.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * DT)
        Ad, Bd = held[:n, :n], held[:n, n:]
        x = np.zeros(n, complex)
        z = np.zeros(law.n_states, complex)
        shown = []
        for now in e.T:
            out = model.C[:4] @ x
            shown.append(out)
            u = law.C @ z - law.D @ out
            x, z = Ad @ x + Bd @ np.concatenate([u, now]), law.A @ z - law.B @ out
        return np.array(shown).T

    np.testing.assert_allclose(outputs(nominal + 0j).real, y, rtol=0, atol=1e-11 * abs(y).max())
    for j, value in enumerate(nominal):
        h = 1e-30 * value
        direction = np.zeros(len(nominal), complex)
        direction[j] = 1j * h
        exact = outputs(nominal + direction).imag / h
        np.testing.assert_allclose(J[j], exact, rtol=0, atol=1e-9 * abs(exact).max())


def test_nine_parameters_are_recovered_without_noise():
    machine, _, controller, _ = rig()
    paths, nominal = truth()
    start = dict(
        zip(paths, nominal * (1 + 0.1 * np.array([1, -1, 1, -1, -1, 1, -1, 1, 1])), strict=True)
    )
    result = identify(machine, clean(), controller, NINE, start=start)
    np.testing.assert_allclose(result.values, nominal, rtol=1e-6)
    assert result.converged and not result.warnings
    assert all(percent > 99.9999 for _, _, percent in result.fit)
    cosine, correlation = result.column_cosine, result.correlation
    i, j = (
        paths.index("bearing.A.force_per_current.zeta"),
        paths.index("bearing.A.negative_stiffness.zeta"),
    )
    # the other sign: P4's figure is the cosine
    assert cosine[i, j] < -0.7 and correlation[i, j] > 0.7


def test_initial_state_and_offset_are_estimated():
    machine, _, controller, _ = rig()
    _, nominal = truth()
    record = clean(5000, 1003)  # the loop is already moving
    values = record.values.copy()
    values[:4] += np.array([[3e-6], [-1e-6], [2e-6], [5e-6]])
    result = identify(machine, replace(record, values=values), controller, NINE)
    np.testing.assert_allclose(result.values, nominal, rtol=1e-6)
    wrong = identify(
        machine, replace(record, values=values), controller, NINE, initial_state=False, offset=False
    )
    assert np.abs(wrong.values / nominal - 1).max() > 1e-3


def test_starts_thirty_percent_away_converge():
    machine, _, controller, _ = rig()
    paths, nominal = truth()
    record = clean(2000)
    rng = np.random.default_rng(3)
    done = 0
    while done < 12:
        start = nominal * (1 + 0.3 * rng.uniform(-1, 1, len(nominal)))
        try:
            result = identify(
                machine, record, controller, NINE, start=dict(zip(paths, start, strict=True))
            )
        except InvalidInput as error:
            assert "the loop at the start values is unstable" in str(error)
            continue
        np.testing.assert_allclose(result.values, nominal, rtol=1e-6)
        done += 1


def test_several_records_other_signals_and_a_seal():
    machine, plant, controller, law = rig()
    unknown = (
        "seal.center.K",
        "seal.center.k",
        "seal.center.C",
        "seal.center.c",
        "coupling.*.stiffness.zeta",
    )
    paths = expand(machine, unknown)
    loop = closed_loop(plant, law)
    e = np.stack([0.1 * waveforms.prbs(9, 10, 3000, shift=100 * i) for i in range(4)])
    tilt = e * np.array([[1.0], [0.0], [-1.0], [0.0]])
    nominal = nominal_values(plant, paths)
    begin = np.where(nominal == 0, 1e4, 0.9 * nominal)
    records = [measured(loop, e, plant.point), measured(loop, tilt[:, :2000], plant.point)]
    result = identify(
        machine, records, controller, unknown, start=dict(zip(paths, begin, strict=True))
    )
    scale = np.where(nominal == 0, 1e5, np.abs(nominal))
    np.testing.assert_allclose(result.values / scale, nominal / scale, atol=1e-6)


@pytest.mark.study
def test_predicted_deviation_against_monte_carlo():
    machine, _, controller, _ = rig()
    y = clean(1500)
    values, predicted = [], []
    b, a = [1.0], [1.0, -0.9]  # coloured noise
    from scipy.signal import lfilter

    for seed in range(50):
        noise = 5e-8 * lfilter(b, a, np.random.default_rng(seed).standard_normal((4, 1500)), axis=1)
        record = replace(y, values=np.vstack([y.values[:4] + noise, y.values[4:]]))
        result = identify(machine, record, controller, NINE)
        values.append(result.values)
        predicted.append(result.standard_deviations)
    scatter = np.std(values, axis=0, ddof=1)
    ratio = np.sqrt(np.mean(np.square(predicted), axis=0)) / scatter
    assert ((ratio > 0.8) & (ratio < 1.2)).all(), ratio


def test_wrong_delay_is_seen_by_the_residuals_and_not_by_the_fit():
    machine, plant, controller, law = rig()
    record = measured(closed_loop(plant, law), sequences(6000), plant.point, noise=1e-7)
    right = identify(machine, record, controller, NINE)
    assert all(test.passed for test in right.tests) and "no trace" in right.verdict
    wrong = identify(machine, record, controller, NINE, computing_delay=0)
    assert "look for a delay" in wrong.verdict and wrong.warnings[-1].what == wrong.verdict
    assert min(percent for *_, percent in wrong.fit) > 95  # against 97.4: no one would look twice
    assert abs(wrong.values[-1] / right.values[-1] - 1) > 0.04


def test_on_the_nonlinear_rig():
    machine, _, controller, _ = rig()
    scenario = Scenario(
        "p2",
        1.0,
        sequences=tuple(Prbs(e, 0.1, 1e-3, order=9, seed=i) for i, e in enumerate(E)),
        sample_time=DT,
    )
    record = virtual_rig.run(machine, controller, scenario).record
    result = identify(machine, record, controller, NINE)
    _, nominal = truth()
    expected = np.append(np.concatenate(at_work(machine, record)), nominal[-1])
    assert min(percent for *_, percent in result.fit) > 98
    np.testing.assert_allclose(result.values[:4], expected[:4], rtol=0.005)
    np.testing.assert_allclose(result.values[4:8], expected[4:8], rtol=0.01)
    np.testing.assert_allclose(result.values[8], expected[8], rtol=0.005)


def at_work(machine, record):
    """K_i and K_s of the four axes where the weight has moved the working point: differences of the
    rig's magnet force.
    """
    k_i, k_s = [], []
    for bearing, working in zip(machine.bearings, operating_magnets(machine), strict=True):
        names = [f"{bearing.name}_{axis}" for axis in ("zeta", "eta")]
        at = np.array([record[f"{kind}_{name}"].mean() for kind in ("i", "q") for name in names])
        p = working.parameters
        for axis in range(2):
            for found, place, h in ((k_i, axis, 1e-4), (k_s, axis + 2, 1e-9)):
                step = h * np.eye(4)[place]
                found.append(
                    (magnet.force(*(at + step), p)[axis] - magnet.force(*(at - step), p)[axis])
                    / (2 * h)
                )
    return k_i, k_s


def test_the_machine_takes_the_values():
    machine, plant, controller, _ = rig()
    result = identify(machine, clean(), controller, (*NINE, "seal.center.k"))
    found = update_machine(machine, replace(result, values=1.1 * result.values))
    again = free_mode_reduction(assemble(found, plant.point), 1)
    np.testing.assert_allclose(nominal_values(again, result.paths), 1.1 * result.values, rtol=1e-12)
    # the pressure's range stays
    assert [t.parameter for t in found.tolerances] == ["seal.center.pressure", *result.paths]
    assert all(0 < t.relative < 1e-3 for t in found.tolerances[1:])


def test_what_the_records_do_not_show_is_refused():
    machine, _, controller, law = rig()
    machine = replace(machine, seals=(), tolerances=())  # without the seal the two planes are apart
    plant = free_mode_reduction(assemble(machine), 1)
    e = sequences(2000) * np.array([[1.0], [0.0], [1.0], [0.0]])
    record = measured(closed_loop(plant, law), e, plant.point, noise=1e-7)
    for estimated in (False, True):  # then there is only what the noise makes of the initial state
        with pytest.raises(
            InvalidInput,
            match=r"do not determine bearing\.A\.force_per_current\.eta; excite its axis",
        ):
            identify(machine, record, controller, NINE, initial_state=estimated)
    zeta = ("bearing.*.force_per_current.zeta", "bearing.*.negative_stiffness.zeta")
    result = identify(machine, record, controller, zeta)
    assert (
        np.abs(result.values - result.start) < 4 * result.standard_deviations
    ).all() and not result.warnings


def quiet(record):
    return replace(record, values=np.vstack([record.values[:4], 0 * record.values[4:]]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"records": quiet}, "record 1 has no excitation.*add a PRBS"),
        ({"unknown": ["bearing.C.force_per_current.zeta"]}, 'unknown bearing "C"'),
        (
            {"unknown": ["bearing.A.force_per_current"]},
            r'on the two axes.*write "bearing.A.force_per_current.\*"',
        ),
        ({"unknown": [NINE[0], "bearing.A.force_per_current.eta"]}, "the same number"),
        ({"unknown": []}, "no unknown parameter was named"),
        ({"unknown": ["seal.center.M"]}, "cannot be uncertain"),
        (
            {"records": lambda r: replace(r, machine="turboexpander")},
            "machine of record 1 is 'turboexpander'",
        ),
        (
            {"records": lambda r: [r, replace(r, sample_rate_hz=5e3)]},
            "sample rate of record 2 is 5000 Hz",
        ),
        (
            {"records": lambda r: replace(r, sample_rate_hz=5e3), "sampled": True},
            "but must be the controller's 10000 Hz",
        ),
        ({"records": lambda r: r.select(E)}, "record 1 has no signal y_A_zeta"),
        (
            {"start": {"bearing.A.negative_stiffness.zeta": 9e6}},
            "the loop at the start values is unstable",
        ),
        ({"start": {"bearing.A.negative_stiffness": 9e6}}, "start value's path"),
        ({"signals": ["y_C"]}, "a fitted signal"),
        ({"computing_delay": -1}, "computing_delay"),
    ],
)
def test_bad_input(change, words):
    machine, _, controller, law = rig()
    change = dict(change)
    record = change.pop("records", lambda r: r)(clean())
    unknown = change.pop("unknown", NINE)
    law = law if change.pop("sampled", False) else controller
    with pytest.raises(InvalidInput, match=words):
        identify(machine, record, law, unknown, **change)


def test_parameters_that_are_excited_late_are_found():
    """eta is excited after the samples on which a start is sought, which say nothing about it."""
    machine, _, controller, law = rig()
    machine = replace(machine, seals=(), tolerances=())
    plant = free_mode_reduction(assemble(machine), 1)
    e = np.zeros((4, 16000))
    e[[0, 2], :8000] = sequences(8000)[[0, 2]]
    e[[1, 3], 8000:] = sequences(8000)[[1, 3]]
    record = measured(closed_loop(plant, law), e, plant.point, noise=1e-8)
    start = {"bearing.B.force_per_current.eta": 1.1 * machine.bearings[1].force_per_current[1]}
    result = identify(machine, record, controller, NINE, start=start)
    assert result.converged and not result.warnings
    truth_here = nominal_values(plant, result.paths)
    assert (np.abs(result.values - truth_here) < 4 * result.standard_deviations).all()


@pytest.mark.parametrize("period", [None, "auto"])
def test_what_has_not_converged_says_so_first(period):
    machine, _, controller, _ = rig()
    start = {"bearing.A.negative_stiffness.zeta": 1.2 * machine.bearings[0].negative_stiffness[0]}
    record = measured(closed_loop(rig()[1], rig()[3]), sequences(12000, 4), rig()[1].point)
    result = identify(
        machine, record, controller, NINE, start=start, max_iterations=1, period=period
    )
    assert not result.converged
    assert result.verdict.startswith("NOT CONVERGED") and any(
        "not converged after" in text.what for text in result.warnings
    )
    whole = identify(machine, record, controller, NINE, start=start, period=period)
    assert whole.converged and "CONVERGED" not in whole.verdict
