"""Measured frequency responses against exact ones, against scipy's estimator, and their variance
against Monte Carlo.
"""

import tracemalloc
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.signal
from benchmarks import waveforms

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse, frequency_response
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.identification import frf_spectral as frf
from ambrose.identification.frf import AGREES, DISAGREES, UNDECIDED, compare
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record
from coarse import coarse

HZ = 2 * np.pi
DT = 1e-3
UNITS = {"y": "m", "u": "A", "e": "A", "v": "A"}
B_Z, A_Z = [0.0, 0.4, 0.1], [1.0, -1.2, 0.7]


def record(dt=DT, **signals):
    units = tuple(UNITS[name[0]] for name in signals)
    return Record("bench", 1 / dt, tuple(signals), units, np.stack(list(signals.values())))


def filtered(u):
    return scipy.signal.lfilter(B_Z, A_Z, u)


def truth(omega):
    return scipy.signal.freqz(B_Z, A_Z, omega * DT)[1]


def test_single_input_is_what_scipy_computes():
    rng = np.random.default_rng(1)
    u = rng.standard_normal(8000)
    y = filtered(u) + 0.5 * rng.standard_normal(8000)
    found = frf.h1(record(u_A=u, y_A=y), "u_A", "y_A", segment=0.5, overlap=0.75)
    settings = {"fs": 1 / DT, "window": "hann", "nperseg": 500, "noverlap": 375, "detrend": False}
    f, cross = scipy.signal.csd(u - u.mean(), y - y.mean(), **settings)
    _, power = scipy.signal.welch(u - u.mean(), **settings)
    _, coherence = scipy.signal.coherence(u - u.mean(), y - y.mean(), **settings)
    kept = np.isin(np.round(f * HZ, 6), np.round(found.omega, 6))
    assert kept.sum() == len(found.omega) > 200
    np.testing.assert_allclose(found.values[:, 0, 0], (cross / power)[kept], rtol=1e-10)
    np.testing.assert_allclose(found.coherence[:, 0], coherence[kept], rtol=1e-10)
    assert np.all(found.input_coherence == 1)


@pytest.mark.parametrize("method", [frf.h1, frf.closed_loop])
def test_periodic_excitation_in_a_whole_number_of_periods_is_exact(method):
    lines = HZ * np.array([4.0, 10.0, 30.0, 120.0])
    wave = sum(
        np.cos(line * DT * np.arange(6000) + phase)
        for line, phase in zip(lines, (0.0, 0.8, 2.5, 4.4), strict=True)
    )
    y = filtered(wave)[2000:]
    signals = {"u_A": wave[2000:], "e_A": wave[2000:], "y_A": y}
    found = method(record(**signals), "u_A", "y_A", segment=1.0, overlap=0.0, window="boxcar")
    np.testing.assert_allclose(found.omega, lines, rtol=1e-12)
    np.testing.assert_allclose(found.values[:, 0, 0], truth(lines), rtol=1e-9)
    np.testing.assert_allclose(found.coherence, 1, atol=1e-12)


def noisy_loop(seed, k=20000, noise=0.3):
    """y = G (u + e) + n with u = -0.3 y; one sample of delay in G, so the loop can be stepped."""
    rng = np.random.default_rng(seed)
    e, n = rng.standard_normal(k), noise * rng.standard_normal(k)
    y = np.zeros(k)
    u = np.zeros(k)
    g = np.zeros(k)
    for t in range(2, k):
        g[t] = (
            0.4 * (u[t - 1] + e[t - 1])
            + 0.1 * (u[t - 2] + e[t - 2])
            + 1.2 * g[t - 1]
            - 0.7 * g[t - 2]
        )
        y[t] = g[t] + n[t]
        u[t] = -0.3 * y[t]
    return record(e_A=e, u_A=u, y_A=y)


def test_feedback_biases_h1_and_not_the_closed_loop_estimate():
    records = [noisy_loop(seed, 20000, 2.0) for seed in range(8)]
    joint = frf.closed_loop(records, "v_A", "y_A")
    direct = frf.h1(records, "v_A", "y_A")
    exact = truth(joint.omega)
    middle = (joint.omega > 50) & (joint.omega < 1200)
    bias = np.mean(((direct.values[:, 0, 0] - exact) / exact)[middle])
    rest = np.mean(((joint.values[:, 0, 0] - exact) / exact)[middle])
    assert abs(bias) > 0.25
    assert abs(rest) < 0.02
    assert (
        np.mean(np.abs(joint.values[:, 0, 0] - exact)[middle] < joint.radius()[:, 0, 0][middle])
        > 0.9
    )


@pytest.mark.parametrize("loop", [False, True])
def test_predicted_variance_and_circles_against_monte_carlo(loop):
    """Sixty records: mean predicted variance over the true one within 15 %, circles of 95 % hold
    the truth 92 to 98 %.
    """
    errors = []
    predicted = []
    inside = []
    for seed in range(60):
        if loop:
            found = frf.closed_loop(
                noisy_loop(seed, 3000), "v_A", "y_A", segment=0.2, band=(60, 2500)
            )
        else:
            rng = np.random.default_rng(seed)
            u = rng.standard_normal(6000)
            y = filtered(u) + 0.5 * rng.standard_normal(6000)
            found = frf.h1(record(u_A=u, y_A=y), "u_A", "y_A", segment=0.2, band=(60, 2500))
        error = np.abs(found.values[:, 0, 0] - truth(found.omega))
        errors.append(error**2)
        predicted.append(found.variance[:, 0, 0])
        inside.append(error < found.radius(0.95)[:, 0, 0])
    assert np.mean(predicted) / np.mean(errors) == pytest.approx(1, abs=0.15)
    assert 0.92 < np.mean(inside) < 0.98


def test_variance_under_a_chirp_allows_for_overlapping_segments():
    """A chirp passes each line within a few overlapping segments: their noise is correlated. 150
    records, within 6 %.
    """
    u = waveforms.chirp(2 * HZ, 200 * HZ, 6000, DT)
    errors, predicted = [], []
    for seed in range(150):
        noise = np.random.default_rng(seed).standard_normal(6000)
        found = frf.h1(
            record(u_A=u, y_A=noise), "u_A", "y_A", segment=0.4, band=(20 * HZ, 180 * HZ)
        )
        errors.append(np.abs(found.values[:, 0, 0]) ** 2)
        predicted.append(found.variance[:, 0, 0])
    assert np.mean(predicted) / np.mean(errors) == pytest.approx(1, abs=0.06)


def test_few_segments_cost_degrees_of_freedom():
    """Four segments without overlap, one of them spent on the response: circles as wide as F(2, 6)
    says hold 95 %.
    """
    rng, inside = np.random.default_rng(3), []
    for _ in range(60):
        u, noise = rng.standard_normal((2, 2000))
        found = frf.h1(
            record(u_A=u, y_A=noise),
            "u_A",
            "y_A",
            segment=0.5,
            overlap=0.0,
            window="boxcar",
            band=(20, 3000),
        )
        error = np.abs(found.values[:, 0, 0])
        inside.append(error < found.radius()[:, 0, 0])
    assert found.freedom == pytest.approx(3)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize("method", [frf.h1, frf.closed_loop])
def test_blocks_of_segments_change_nothing_and_bound_the_memory(method, monkeypatch):
    """Segments that overlap across two blocks count once, those of two records never; three records
    take no more than one.
    """
    rng = np.random.default_rng(0)
    records = []
    for _ in range(3):
        u = rng.normal(size=20_000)
        records.append(record(u_a=u, y_a=filtered(u) + 0.1 * rng.normal(size=20_000), e_a=u))
    whole = method(records, "u_a", "y_a", segment=0.1)
    monkeypatch.setattr(frf, "_BLOCK", 5000)
    cut = method(records, "u_a", "y_a", segment=0.1)
    for name in ("values", "variance", "coherence", "input_coherence"):
        np.testing.assert_allclose(getattr(cut, name), getattr(whole, name), rtol=1e-9, atol=1e-14)
    peaks = []
    for given in (records[:1], records):
        tracemalloc.start()
        method(given, "u_a", "y_a", segment=0.1)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_two_inputs_from_two_records_or_from_two_sequences_in_one():
    rng = np.random.default_rng(5)
    a, b = rng.standard_normal((2, 12000))
    zero = np.zeros(12000)

    def made(u, v):
        return record(u_A=u, u_B=v, y_A=filtered(u) + 2 * v, y_B=-filtered(v))

    want = np.zeros((2, 2, 1), complex) + np.array([[1, 0], [0, -1]])[:, :, None]
    for records in ([made(a, zero), made(zero, b)], [made(a, b)], [made(a, a), made(a, -a)]):
        found = frf.h1(records, ["u_A", "u_B"], ["y_A", "y_B"], band=(50, 2500))
        want = np.moveaxis(
            np.array(
                [[truth(found.omega), 2 + 0j * found.omega], [0 * found.omega, -truth(found.omega)]]
            ),
            2,
            0,
        )
        assert np.abs(found.values - want).max() < 0.08
        assert found.variance.shape == (len(found.omega), 2, 2)
        one = found.select("u_B", "y_A").between(100, 200)
        assert one.values.shape[1:] == (1, 1)
        assert one.omega.min() >= 100 - 1e-6


@cache
def rig_loop():
    machine = coarse("seal-rig")
    plant = free_mode_reduction(assemble(machine, OperatingPoint(seal_pressure=1e5)), 1)
    law = c2d(pid_synthesis(plant).controller, 1e-4, "tustin", delay=1e-4)
    return plant, closed_loop(plant, law)


@cache
def chirps():
    """20 s, 0.1 A, 2 to 150 Hz on each axis in turn."""
    plant, loop = rig_loop()
    e, y, u = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "eyu")
    wave = 0.1 * waveforms.chirp(2 * HZ, 150 * HZ, 200_000, 1e-4)
    made = []
    for i in range(4):
        drive = np.zeros((4, len(wave)))
        drive[i] = wave
        values = np.vstack([simulate(select(loop, e, [*y, *u]), drive), drive])
        made.append(
            Record("seal-rig", 1e4, (*y, *u, *e), ("m",) * 4 + ("A",) * 8, values, plant.point)
        )
    return made


def test_plant_from_four_chirps_in_closed_loop():
    """Hann, 75 % overlap, 0.5 s segments of a 20 s chirp: 0.26 % and 0.3 degrees against the
    ZOH-sampled plant.
    """
    plant, _ = rig_loop()
    commands, shown = [f"v_{a}" for a in plant.axes], [f"y_{a}" for a in plant.axes]
    found = frf.closed_loop(chirps(), commands, shown, band=(10 * HZ, 140 * HZ))
    validity = compare(found, plant.system, magnitude_tolerance=0.01, phase_tolerance=np.radians(1))
    own = np.einsum("wii->wi", validity.ratio)
    assert np.abs(np.abs(own) - 1).max() < 0.0026
    assert np.degrees(np.abs(np.angle(own))).max() < 0.3
    assert np.all(np.diag(validity.valid_to) > 139 * HZ)
    continuous = frequency_response(
        select(plant.system, [f"u_{a}" for a in plant.axes], shown), found.omega
    )
    named = FrequencyResponse(continuous.values, continuous.omega, found.inputs, found.outputs)
    late = compare(found, named, magnitude_tolerance=0.01, phase_tolerance=np.radians(1))
    # half a sample of hold is 1 degree at 56 Hz, 1.4 at 80
    assert np.all(np.diag(late.valid_to) < 80 * HZ)


def test_validity_names_the_last_line_before_the_model_leaves():
    plant, loop = rig_loop()
    shown = [f"y_{a}" for a in plant.axes]
    found = frf.h1(
        chirps(), [f"e_{a}" for a in plant.axes], shown, band=(20 * HZ, 140 * HZ)
    ).select("e_A_zeta", "y_A_zeta")
    exact = frequency_response(select(loop, "e_A_zeta", "y_A_zeta"), found.omega)
    delay = np.exp(-1j * found.omega * 1e-3)[:, None, None]
    late = replace(exact, values=exact.values * delay)
    validity = compare(found, late, phase_tolerance=np.radians(18.0))
    assert validity.valid_to[0, 0] / HZ == pytest.approx(50, abs=3)  # 1 ms is 18 degrees at 50 Hz
    assert validity.verdict[0, 0, 0] == AGREES
    assert validity.verdict[-1, 0, 0] == DISAGREES
    assert np.degrees(validity.worst[1][0, 0]) == pytest.approx(18, abs=1.5)
    assert compare(found, replace(exact, values=1.3 * exact.values)).valid_to[0, 0] == 0
    vague = replace(found, variance=np.abs(found.values) ** 2)
    undecided = compare(vague, exact)
    assert np.all(undecided.verdict == UNDECIDED)
    assert undecided.valid_to[0, 0] == 0
    assert undecided.decided[0, 0] == 0


def test_a_continuous_model_is_sampled_with_a_hold_and_a_sampled_one_taken_as_it_is():
    system = StateSpace([[-200.0]], [[200.0]], [[1.0]], [[0.0]], ["u_A"], ["y_A"])
    u = np.random.default_rng(2).standard_normal(40000)
    sampled = c2d(system, DT)
    found = frf.h1(record(u_A=u, y_A=simulate(sampled, u[None])[0]), "u_A", "y_A", band=(20, 2800))
    for model in (system, sampled):
        validity = compare(found, model, magnitude_tolerance=0.02, phase_tolerance=0.02)
        assert validity.valid_to[0, 0] > 2700
    assert (
        compare(found, replace_dt(system), magnitude_tolerance=0.02, phase_tolerance=0.02).valid_to[
            0, 0
        ]
        < 200
    )


def replace_dt(system):
    """The continuous response, not held."""
    omega = frf.h1(
        record(u_A=np.random.default_rng(2).standard_normal(40000), y_A=np.ones(40000)),
        "u_A",
        "y_A",
        band=(20, 2800),
    )
    return frequency_response(system, omega.omega)


def test_what_cannot_be_estimated_is_refused():
    a = np.random.default_rng(0).standard_normal(4000)
    same = record(u_A=a, u_B=a, e_A=a, y_A=filtered(a), y_B=np.zeros(4000))
    with pytest.raises(InvalidInput, match=r"are the same at .*parallel and tilt"):
        frf.h1(same, ["u_A", "u_B"], ["y_A"])
    with pytest.raises(InvalidInput, match="never changes"):
        frf.h1(same, "y_B", "y_A")
    with pytest.raises(InvalidInput, match="shorten it, or record longer"):
        frf.h1(same, "u_A", "y_A", segment=5.0)
    with pytest.raises(InvalidInput, match="no power between"):
        frf.h1(same, "u_A", "y_A", band=(1e5, 1e6))
    with pytest.raises(InvalidInput, match="overlap"):
        frf.h1(same, "u_A", "y_A", overlap=1.0)
    with pytest.raises(InvalidInput, match="window"):
        frf.h1(same, "u_A", "y_A", window="kaiser")
    with pytest.raises(InvalidInput, match="sample rate of record 2"):
        frf.h1([same, record(dt=2e-3, u_A=a, y_A=a)], "u_A", "y_A")
    with pytest.raises(InvalidInput, match="no record"):
        frf.h1([], "u_A", "y_A")
    found = frf.h1(same, "u_A", ["y_A", "y_B"])
    assert np.all(found.coherence[:, 1] == 0)
    with pytest.raises(InvalidInput, match="dead channel"):
        compare(found, FrequencyResponse(found.values, found.omega, found.inputs, found.outputs))
    with pytest.raises(InvalidInput, match="evaluate it at measured"):
        compare(
            found, FrequencyResponse(found.values[1:], found.omega[1:], found.inputs, found.outputs)
        )
    with pytest.raises(InvalidInput, match="within"):
        found.between(1e5, 1e6)
    with pytest.raises(InvalidInput, match="confidence"):
        found.radius(1.0)
