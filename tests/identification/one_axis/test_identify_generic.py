"""One axis from its record alone: loops of the tests' own with a known truth, what is refused, and
the records of a real apparatus.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import cont2discrete, lfilter, tf2ss

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.identification.findings import Code
from ambrose.identification.one_axis.axis_record import read_axis
from ambrose.identification.one_axis.estimate import (
    estimate,
    fit_plainest,
    input_polynomials,
    own_polynomial,
    solve,
)
from ambrose.identification.one_axis.identify import look
from one_axis_loop import Truth, hang, levitate

RECORDS = Path(__file__).parents[2] / "records" / "levitation"


def table(path, time, y, u, r=None, names=("t [s]", "y [um]", "u [A]", "r [A]")):
    columns = [time, 1e6 * y, u] if r is None else [time, 1e6 * y, u, r]
    np.savetxt(
        path,
        np.column_stack(columns),
        fmt="%.9g",
        delimiter="\t",
        header="\t".join(names[: len(columns)]),
    )
    return path


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    folder = tmp_path_factory.mktemp("axis")
    time, y, u, r = levitate(seed=3)
    return table(folder / "axis.txt", time, y[:, 0], u[:, 0], r[:, 0])


@pytest.mark.parametrize(
    ("scale", "words"),
    [(1e290, "the displacement at sample .* at most 1e.15 in its SI unit"), (1e-40, "the span of")],
)
def test_a_displacement_that_nothing_measures_is_refused(driven, scale, words, tmp_path):
    """Of 1e285 m the first look overflowed, with a warning and a line of the source."""
    time, y, u, r = np.loadtxt(driven, skiprows=1).T
    with pytest.raises(InvalidInput, match=words):
        read_axis(table(tmp_path / "axis.txt", time, scale * y, u, r))


@pytest.mark.parametrize("lag", [0.0, 1.7])
def test_the_step_between_samples_is_exact(lag):
    """Against scipy's zero-order hold, the delay as so many small steps."""
    a, b, fine = 0.01, 0.3, 20
    numerator, actuator = input_polynomials(np.array([a, b, 1.35, lag] if lag else [a, b, 1.35]))
    held = np.repeat(np.random.default_rng(0).standard_normal(40), fine)
    plant = tf2ss([b], np.convolve([1, 0, -a], [lag, 1]) if lag else [1, 0, -a])
    A, B, C, _, _ = cont2discrete(plant, 1 / fine)
    late = np.concatenate([np.zeros(27), held])[: len(held)]  # 1.35 of 20 small steps
    x, expected = np.zeros(len(A)), []
    for k, value in enumerate(late):
        if k % fine == 0:
            expected.append(float((C @ x).item()))
        x = A @ x + B[:, 0] * value
    denominator = np.convolve(own_polynomial(a), actuator)
    np.testing.assert_allclose(lfilter(numerator, denominator, held[::fine]), expected, atol=1e-9)


def test_what_is_true_is_found(driven):
    done = amb.identify_generic(driven)
    assert done.passed and done.verdict == "identified"
    for name, truth in {"pole": 80.0, "gain": 100.0, "delay": 7e-4}.items():
        item = done.value(name)
        assert abs(item.value - truth) < 1.5 * item.half_width
        assert item.half_width == max(item.formal, item.halves) < 0.15 * truth
    assert done.coherence_in_band > 0.5
    assert "not fitted" in amb.plot(done).layout.title.text
    assert done.estimate.prediction.error < 0.7 * done.estimate.prediction.still


def test_an_actuator_that_shows_is_found():
    _, y, u, r = levitate(Truth(lag=2e-3), seed=1, force=0.005, n=6000)
    done = estimate(y[:, 0], u[:, 0], 2000.0, r[:, 0])
    assert done.structure.lag
    assert abs(done.plant[3] - 2e-3) < 2.5 * done.deviations[3]
    assert abs(done.plant[0] - 6400) < 2.5 * done.deviations[0]


def test_instruments_need_no_noise_model():
    """A coloured force that the Kalman filter's noise cannot be: the direct way is far off in its
    own deviations, the instruments are not.
    """
    _, y, u, r = levitate(runs=4, n=6000, seed=2, colour=0.3)
    direct, second = [], []
    for j in range(4):
        scaled = [(row - row.mean()) / row.std() for row in (y[:, j], u[:, j], r[:, j])]
        fit = fit_plainest(*scaled[:2])
        other = solve(fit, *scaled)
        true = 6400 / 2000**2
        spread = np.sqrt(fit.loss * np.linalg.inv(fit.jacobian.T @ fit.jacobian)[0, 0])
        direct.append((fit.unknowns[0] - true) / spread)
        second.append((other.plant[0] - true) / np.sqrt(other.covariance[0, 0]))
    assert np.mean(direct) > 3.0
    assert abs(np.mean(second)) < 1.5


@pytest.mark.parametrize(
    "change", [{}, {"drive_noise": 1e-4}, {"seed": 9}], ids=["exact", "noisy u", "other"]
)
def test_a_loop_that_nothing_drives_is_refused(change, tmp_path):
    time, y, u, _ = levitate(kind="none", **change)
    path = table(tmp_path / "quiet.txt", time, y[:, 0], u[:, 0])
    with pytest.raises(
        InvalidInput, match=r"(drives the loop|no excitation).*-1/K.*record them too"
    ):
        amb.identify_generic(path)


@pytest.mark.parametrize("kind", ["binary", "none"])
@pytest.mark.parametrize("what", ["control error", "u"])
def test_a_reference_that_answers_is_none(kind, what):
    """The column "e" of many a laboratory is the control error: it must not pass for excitation."""
    _, y, u, r = levitate(kind=kind, n=5000, seed=5)
    said = r[:, 0] / 300 - y[:, 0] if what == "control error" else u[:, 0]
    rows = np.array([y[:, 0], u[:, 0], 1e3 * said])
    record = amb.Record("rig", 2000.0, ("y_x", "u_x", "e_x"), ("m", "A", "A"), rows)
    with pytest.raises(InvalidInput, match=r"reference answers the displacement.*reference: none"):
        amb.identify_generic(record)


def test_another_plant_is_not_this_model(tmp_path):
    """The record of u delayed by a slow filter that the model lacks: two more poles."""
    time, y, u, r = levitate(seed=4, force=0.002, n=6000)
    slow = lfilter([0.02], [1, -1.6, 0.62], u[:, 0])
    with_file = table(tmp_path / "other.txt", time, y[:, 0], slow, r[:, 0])
    done = amb.identify_generic(with_file)
    assert done.verdict == "not this model" and not done.passed
    assert Code.NOT_THIS_MODEL in {finding.code for finding in done.findings}


def test_a_hanging_body_follows_the_force_law(tmp_path):
    time, y, i, aim = hang(amplitude=1e-5, seed=1)
    names = ("t [s]", "y [um]", "i [A]", "r [m]")
    path = table(tmp_path / "hang.txt", time, y, i, aim, names)
    done = amb.identify_generic(path, hanging=True, travel=0.02, mass=0.02)
    assert [row.fits for row in done.law] == [True, True, True]
    assert done.pole == pytest.approx(np.sqrt(2 * 9.81 / 5e-3), rel=0.05)
    assert done.value("k_s").value == pytest.approx(0.02 * done.value("stiffness").value)
    other = amb.identify_generic(path, gap=8e-3, current=float(i.mean()))
    assert [finding.code for finding in other.findings] == [Code.FORCE_LAW]


def test_a_large_motion_shows_the_curvature_and_the_interval_holds_the_tangent():
    """c/m (i/y)^2 with c/m = 0.005: the tangent at the mean of both, by hand."""
    _, y, i, aim = hang(amplitude=3e-4)
    done = amb.identify_generic(
        amb.Record("rig", 2000.0, ("y_x", "u_x", "r_x"), ("m", "A", "m"), np.array([y, i, aim]))
    )
    assert Code.CURVED in {finding.code for finding in done.findings}
    gain = 2 * 0.005 * i.mean() / y.mean() ** 2
    for name, truth in {"gain": -gain, "stiffness": gain * i.mean() / y.mean()}.items():
        assert abs(done.value(name).value - truth) < done.value(name).half_width


@pytest.mark.parametrize("samples", [3.0, 6.1])
def test_few_samples_per_time_constant_of_a_controller_at_that_rate_serve(samples):
    """u is held between them, so that the model's steps are exact at any rate."""
    rate = 80.0 * samples
    _, y, u, r = levitate(Truth(rate=rate, delay=0.5 / rate), n=4000, seed=30)
    rows = np.array([y[:, 0], u[:, 0], r[:, 0]])
    record = amb.Record("rig", rate, ("y_x", "u_x", "e_x"), ("m", "A", "A"), rows)
    done = amb.identify_generic(record)
    assert done.passed and done.verdict == "identified"
    assert abs(done.pole - 80.0) < 1.5 * done.value("pole").half_width < 8.0


def test_a_rate_that_is_too_low_is_seen_by_the_fit(tmp_path):
    """Of a controller at 2 kHz every sixth sample: what u does between them is not recorded."""
    time, y, u, r = (row[::6] for row in levitate(n=12_000, seed=3))
    with pytest.raises(InvalidInput, match=r"rate is too low.*record at \d\.?\d*e\+02 Hz"):
        amb.identify_generic(table(tmp_path / "slow.txt", time, y[:, 0], u[:, 0], r[:, 0]))


def test_a_force_law_is_one_of_currents(driven, tmp_path):
    """By hand: a/b = 6400/100 A/m, so that 64 A/m fit, whatever the current's unit; in V nothing."""
    time, y, u, r = np.loadtxt(driven).T
    stated = {"gap": 1e-3, "current": 0.064}
    for unit, scale in (("A", 1.0), ("mA", 1e3)):
        names = ("t [s]", "y [um]", f"u [{unit}]", "r")
        path = table(tmp_path / f"{unit}.txt", time, 1e-6 * y, scale * u, r, names)
        (row,) = amb.identify_generic(path, **stated).law
        assert row.fits and row.unit == "A/m"
        assert row.found == pytest.approx(64.0, rel=0.1)
    for header in ("u [V]", "u"):
        path = table(tmp_path / "v.txt", time, 1e-6 * y, u, r, ("t [s]", "y [um]", header, "r"))
        for how in (stated, {"hanging": True}):
            with pytest.raises(
                InvalidInput, match="force law is one of currents, and the drive is"
            ):
                amb.identify_generic(path, **how)


def test_columns_in_another_order_and_without_names(driven, tmp_path):
    time, y, u, r = np.loadtxt(driven).T
    path = tmp_path / "renamed.dat"
    np.savetxt(path, np.column_stack([r, u, y / 1e3, time]), fmt="%.9g")
    with pytest.raises(InvalidInput, match="no displacement and no drive is found"):
        amb.identify_generic(path)
    columns = {
        "time": "column 4",
        "displacement": "column 3 [mm]",
        "drive": "column 2 [A]",
        "reference": "column 1",
    }
    first, second = amb.identify_generic(driven), amb.identify_generic(path, columns=columns)
    assert second.pole == pytest.approx(first.pole, rel=1e-6)


def test_records_of_this_package_are_read_by_their_signals(driven, tmp_path):
    _, y, u, r = np.loadtxt(driven).T
    names, si = ("y_x", "u_x", "e_x"), ("m", "A", "A")
    record = amb.Record("rig", 2000.0, names, si, np.array([1e-6 * y, u, r]))
    path = amb.write_record(record, tmp_path / "axis.h5")
    done = amb.identify_generic(path)
    assert dict(done.record.columns) == {"displacement": "y_x", "drive": "u_x", "reference": "e_x"}
    assert done.pole == pytest.approx(amb.identify_generic(driven).pole, rel=1e-6)


def test_the_axis_of_a_displacement_names_the_others():
    rows = np.random.default_rng(0).standard_normal((6, 600))
    names = ("y_A", "y_B", "u_A", "u_B", "e_B", "i_B")
    record = amb.Record("rig", 1e3, names, ("m", "m", "A", "A", "A", "A"), rows)
    with pytest.raises(InvalidInput, match="2 signals that may be the displacement"):
        read_axis(record)
    axis = read_axis(record, columns={"displacement": "y_B", "current": "none"})
    assert dict(axis.columns) == {"displacement": "y_B", "drive": "u_B", "reference": "e_B"}
    assert read_axis(record, columns={"displacement": "y_A"}).reference is None


COLUMNS = {
    name: {
        "time": "column 1",
        "displacement": place,
        "drive": f"column {drive} [A]",
        "voltage": f"column {drive + 1}",
        "reference": reference,
    }
    for name, place, drive, reference in (
        ("levitador_dataset_chirp_20251217_210058.txt", "column 2", 5, "column 7"),
        ("levitador_dataset_multiescalon_20251217_210203.txt", "column 2", 5, "column 7"),
        ("levitador_datos_levitador.txt", "column 3", 5, "column 2"),
    )
}


@pytest.mark.parametrize("name", COLUMNS)
def test_records_of_a_real_apparatus_are_refused_in_words(name):
    with pytest.raises(
        InvalidInput, match=r"(?s)rate is too low.*current does not belong"
    ) as caught:
        amb.identify_generic(RECORDS / name, columns=COLUMNS[name], travel=0.02)
    assert ("did not levitate" in str(caught.value)) == ("multiescalon" not in name)


def test_command(driven, tmp_path):
    page = tmp_path / "axis.html"
    run = CliRunner().invoke(main, ["identify", str(driven), "--generic", "-o", str(page)])
    assert run.exit_code == 0 and "Verdict: identified" in run.output
    assert "What was not fitted" in page.read_text("utf-8")
    words = ["identify", "--generic", str(driven), "--json", "--gap", "1 mm", "--bias", "1 A"]
    run = CliRunner().invoke(main, words)
    said = json.loads(run.stdout)
    assert run.exit_code == 1 and said["findings"][0]["code"] == "force-law"
    name, columns = next(iter(COLUMNS.items()))
    words = [word for what, place in columns.items() for word in (f"--{what}", place)]
    run = CliRunner().invoke(
        main, ["identify", "--generic", str(RECORDS / name), *words, "--travel", "20 mm"]
    )
    assert run.exit_code == 2


@pytest.mark.parametrize(("row", "words"), [(0, "displacement is at an end"), (1, "drive is at")])
def test_flat_tops_are_refused_and_plateaus_are_not(driven, row, words):
    signals = 1e-6 * np.loadtxt(driven).T[1:]
    signals[1:] *= 1e6
    limit = 1.3 * signals[row].std()
    signals[row] = np.clip(signals[row], -limit, limit)
    record = amb.Record("rig", 2000.0, ("y_x", "u_x", "e_x"), ("m", "A", "A"), signals)
    with pytest.raises(InvalidInput, match=words):
        amb.identify_generic(record)
    plateaus = np.round(np.sin(np.arange(8000) / 600) ** 3 * 40)
    assert not look(replace(read_axis(record), position=plateaus, drive=plateaus))


@pytest.mark.study
def test_intervals_hold_the_truth_in_95_of_100():
    """Of 40 records, with a margin of chance (three deviations of a share of 0.95)."""
    _, y, u, r = levitate(runs=40, n=6000, seed=1)
    truth = {"pole": 80.0, "gain": 100.0, "delay": 7e-4}
    held = dict.fromkeys(truth, 0)
    for j in range(40):
        signals = np.array([y[:, j], u[:, j], r[:, j]])
        done = amb.identify_generic(
            amb.Record("rig", 2000.0, ("y_x", "u_x", "e_x"), ("m", "A", "A"), signals)
        )
        for name, value in truth.items():
            held[name] += abs(done.value(name).value - value) <= done.value(name).half_width
    assert min(held.values()) >= 34


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"actuator": "none?"}, "actuator is"),
        ({"between": (0.0, 0.1)}, "at least 500"),
        ({"gap": 1e-3}, "lacks the current"),
        ({"columns": {"displacement": "z"}}, "no column 'z'"),
        ({"columns": {"speed": "z"}}, "a column is"),
        ({"travel": -1.0}, "travel is"),
        ({"mass": 0.0}, "mass is"),
    ],
)
def test_bad_input(driven, options, words):
    with pytest.raises(InvalidInput, match=words):
        amb.identify_generic(driven, **options)
