"""Sampling against numerical integration, frequency-domain identities and scipy."""

import itertools

import numpy as np
import pytest
import scipy.integrate
import scipy.signal

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d, pade
from ambrose.core.statespace import (
    StateSpace,
    append,
    is_stable,
    poles,
    rename,
    static_gain,
    transfer_function,
)

DT = 0.05


def random_system(seed, n=3, m=2, p=2):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) - 2 * np.eye(n)
    B, C, D = (rng.standard_normal(shape) for shape in ((n, m), (p, n), (p, m)))
    return StateSpace(A, B, C, D, ["a", "b"], ["x", "y"])


def recursion(system, u):
    x, y = np.zeros(system.n_states), []
    for sample in u:
        y.append(system.C @ x + system.D @ sample)
        x = system.A @ x + system.B @ sample
    return np.array(y)


def integrated(system, u, dt, delay):
    """The same by an ODE solver, restarted at each jump of the delayed, held input."""

    def held(t):
        k = int(np.floor((t - delay) / dt + 1e-9))
        return u[k] if k >= 0 else np.zeros(u.shape[1])

    samples = np.arange(len(u)) * dt
    jumps = np.unique(np.round(np.concatenate([samples, samples + delay % dt]), 12))
    jumps = jumps[jumps <= samples[-1]]
    states = {0.0: np.zeros(system.n_states)}
    for start, end in itertools.pairwise(jumps):
        force = system.B @ held((start + end) / 2)
        solution = scipy.integrate.solve_ivp(
            lambda _, x, f=force: system.A @ x + f,
            (start, end),
            states[float(start)],
            rtol=1e-11,
            atol=1e-13,
        )
        states[float(end)] = solution.y[:, -1]
    return np.array(
        [system.C @ states[float(np.round(t, 12))] + system.D @ held(t) for t in samples]
    )


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.85, 1.0, 2.0, 2.4])
def test_zoh_with_any_delay_against_integration(delay):
    system = random_system(1)
    u = np.random.default_rng(2).standard_normal((12, 2))
    sampled = c2d(system, DT, delay=delay * DT)
    assert (sampled.inputs, sampled.outputs, sampled.dt) == (("a", "b"), ("x", "y"), DT)
    np.testing.assert_allclose(
        recursion(sampled, u), integrated(system, u, DT, delay * DT), atol=1e-9
    )


@pytest.mark.parametrize("fraction", [1e-12, 1 - 1e-12])
def test_almost_whole_delays_add_no_states(fraction):
    assert c2d(random_system(1), DT, delay=(1 + fraction) * DT).n_states == 3 + 2 * (
        1 + round(fraction)
    )


@pytest.mark.parametrize("method", ["zoh", "tustin", "backward-euler"])
def test_scipy_agrees(method):
    system = random_system(3, n=5)
    ours = c2d(system, DT, method)
    theirs = scipy.signal.cont2discrete(
        (system.A, system.B, system.C, system.D),
        DT,
        {"zoh": "zoh", "tustin": "bilinear"}.get(method, "backward_diff"),
    )
    theirs = StateSpace(*theirs[:4], dt=DT)
    omega = np.linspace(0, np.pi / DT, 20)
    np.testing.assert_allclose(
        frequency_response(ours, omega).values, frequency_response(theirs, omega).values, rtol=1e-10
    )


def test_tustin_is_the_bilinear_map_of_the_frequency_axis():
    system = random_system(4)
    omega = np.linspace(0.1, 0.9 * np.pi / DT, 15)
    values = frequency_response(c2d(system, DT, "tustin"), omega).values
    warped = 2 / DT * np.tan(omega * DT / 2)
    np.testing.assert_allclose(values, frequency_response(system, warped).values, rtol=1e-11)


@pytest.mark.parametrize("frequency", [0.5, 10.0, 55.0])
def test_prewarp_is_exact_at_its_frequency(frequency):
    system = random_system(5)
    values = frequency_response(c2d(system, DT, "tustin", prewarp=frequency), [frequency]).values
    np.testing.assert_allclose(values, frequency_response(system, [frequency]).values, rtol=1e-11)


def test_tustin_with_whole_delays_turns_the_phase():
    system = random_system(6)
    omega = np.linspace(0.1, 60.0, 15)
    late = frequency_response(c2d(system, DT, "tustin", delay=2 * DT), omega).values
    prompt = frequency_response(c2d(system, DT, "tustin"), omega).values
    np.testing.assert_allclose(late, prompt * np.exp(-2j * omega * DT)[:, None, None], rtol=1e-11)


@pytest.mark.parametrize("method", ["zoh", "tustin", "backward-euler"])
def test_states_keep_their_meaning_and_scaling_costs_nothing(method):
    """The same system in states scaled by 1e-9 .. 1e9: the sampled matrices must be the scaled
    ones.
    """
    system = random_system(7, n=6)
    t = 10.0 ** np.array([-9, 9, 0, 4, -4, 7])
    bad = StateSpace(system.A * t / t[:, None], system.B / t[:, None], system.C * t, system.D)
    plain, scaled = c2d(system, DT, method), c2d(bad, DT, method)
    np.testing.assert_allclose(scaled.A * t[:, None] / t, plain.A, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(scaled.B * t[:, None], plain.B, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("method", ["zoh", "tustin"])
def test_stiff_oscillators_in_physical_units(method):
    """Modes from 50 to 1e7 rad/s with stiffnesses up to 1e14 (a fine rotor mesh): the slow one
    keeps its closed form.
    """
    dt, omega_0 = 1e-4, np.array([50.0, 3e3, 1e7])
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.diag(omega_0**2), np.zeros((3, 3))]])
    system = StateSpace(
        A, np.vstack([np.zeros((3, 1)), np.ones((3, 1))]), np.eye(3, 6), np.zeros((3, 1))
    )
    sampled = c2d(system, dt, method)
    z = (
        np.exp(1j * omega_0 * dt)
        if method == "zoh"
        else (1 + 0.5j * omega_0 * dt) / (1 - 0.5j * omega_0 * dt)
    )
    found = np.linalg.eigvals(sampled.A)
    for k in (0, 1):
        assert np.abs(found - z[k]).min() < 1e-12
    if method == "zoh":
        np.testing.assert_allclose(
            sampled.B[:2, 0], (1 - np.cos(omega_0[:2] * dt)) / omega_0[:2] ** 2, rtol=1e-9
        )


def test_static_gains_and_integrators():
    gain = static_gain([[1.0, 2.0]])
    assert c2d(gain, DT).D.tolist() == [[1.0, 2.0]]
    assert c2d(gain, DT, delay=DT / 2).D.tolist() == [[0.0, 0.0]]
    assert c2d(gain, DT, "tustin", delay=2 * DT).n_states == 4
    double = c2d(StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]]), DT)
    np.testing.assert_allclose(double.A, [[1, DT], [0, 1]], rtol=1e-14)
    np.testing.assert_allclose(double.B[:, 0], [DT**2 / 2, DT], rtol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"dt": 0.0}, "dt is 0"),
        ({"dt": DT, "delay": -1.0}, "delay is -1"),
        ({"dt": DT, "method": "foh"}, "method is 'foh'"),
        ({"dt": DT, "method": "tustin", "delay": DT / 2}, "whole number of samples"),
        ({"dt": DT, "prewarp": 1.0}, "prewarp is 1.0"),
        ({"dt": DT, "method": "backward-euler", "prewarp": 1.0}, "prewarp is 1.0"),
        ({"dt": DT, "method": "matched"}, "channels mix; use 'tustin'"),
        ({"dt": DT, "method": "tustin", "prewarp": 70.0}, "below Nyquist 62.83"),
        ({"dt": DT, "method": "tustin", "prewarp": 0.0}, "prewarp is 0"),
    ],
)
def test_refuses(arguments, message):
    with pytest.raises(InvalidInput, match=message):
        c2d(random_system(1), **arguments)


def test_refuses_what_has_no_equivalent():
    with pytest.raises(InvalidInput, match="sampled already"):
        c2d(c2d(random_system(1), DT), DT)
    with pytest.raises(
        InvalidInput, match=r"a pole at 40 rad/s has no sampled equivalent by this map"
    ):
        c2d(StateSpace(2 / DT, 1, 1, 0), DT, "tustin")


ZPK = {
    "pid": ([-50.0, -700.0], [0.0, -4000.0], 3.0),
    "oscillating": ([-200.0], [0.0, -300 + 4000j, -300 - 4000j], -2e7),
    "two equal": ([], [-100.0, -100.0, -5000.0], 1e9),
    "zeros right": ([30 + 400j, 30 - 400j], [-2000 + 2000j, -2000 - 2000j], 5.0),
    "differentiator": ([0.0], [-3000.0], 1.0),
}


@pytest.mark.parametrize("name", ZPK)
@pytest.mark.parametrize("prewarp", [None, 2000.0])
def test_matched_maps_poles_and_zeros(name, prewarp):
    """z = exp(s dt), those at infinity to -1; sign and gain at rest, or at the frequency, as
    before.
    """
    zeros, below, gain = ZPK[name]
    dt, omega = 1e-4, np.geomspace(0.1, 3e4, 40)
    system = transfer_function(*scipy.signal.zpk2tf(zeros, below, gain))
    sampled = c2d(system, dt, "matched", prewarp=prewarp)
    z = np.exp(1j * omega * dt)[:, None]
    shape = np.prod(z - np.exp(np.array(zeros) * dt), axis=1) * (z[:, 0] + 1) ** (
        len(below) - len(zeros)
    )
    shape /= np.prod(z - np.exp(np.array(below) * dt), axis=1)
    found, before = (frequency_response(one, omega).values[:, 0, 0] for one in (sampled, system))
    np.testing.assert_allclose(found / shape, np.full(40, (found / shape)[0].real), rtol=1e-8)
    place = 0 if prewarp is None else [prewarp]
    if prewarp is None:
        # at 0.1 rad/s; half a sample of phase each
        assert found[0] / before[0] == pytest.approx(1, abs=1e-4)
    else:
        at = [abs(frequency_response(one, place).values[0, 0, 0]) for one in (sampled, system)]
        assert at[0] == pytest.approx(at[1], rel=1e-9) and (found[0] / before[0]).real > 0
    np.testing.assert_allclose(
        np.sort_complex(np.log(poles(sampled) + 0j) / dt),
        np.sort_complex(np.array(below) + 0j),
        atol=0.2,
    )


def test_matched_agrees_with_python_control():
    control = pytest.importorskip("control")
    zeros = ZPK["pid"][0]
    below = [-20.0, -4000.0]
    gain = 3.0
    system = transfer_function(*scipy.signal.zpk2tf(zeros, below, gain))
    theirs = control.sample_system(control.zpk(zeros, below, gain), 1e-4, method="matched")
    omega = np.geomspace(1, 3e4, 20)
    found = frequency_response(c2d(system, 1e-4, "matched"), omega).values[:, 0, 0]
    np.testing.assert_allclose(found, theirs(np.exp(1j * omega * 1e-4)), rtol=1e-8)


def test_matched_takes_channels_apart_though_their_states_are_mixed():
    one = transfer_function([1.0, 50.0], [1.0, 800.0, 3e5])
    two = transfer_function([2.0, 0.0], [1.0, 800.0, 3e5])
    T = np.random.default_rng(0).standard_normal((4, 4))
    whole = append(rename(one, ["a"], ["c"]), rename(two, ["b"], ["d"]))
    mixed = StateSpace(
        T @ whole.A @ np.linalg.inv(T), T @ whole.B, whole.C @ np.linalg.inv(T), whole.D
    )
    omega = np.geomspace(1, 3e4, 20)
    apart = [
        frequency_response(c2d(item, 1e-4, "matched"), omega).values[:, 0, 0] for item in (one, two)
    ]
    found = frequency_response(c2d(mixed, 1e-4, "matched"), omega).values
    np.testing.assert_allclose(np.diagonal(found, axis1=1, axis2=2).T, apart, rtol=1e-7)


class TestPade:
    @pytest.mark.parametrize("order", [1, 2, 3, 5, 8, 12])
    @pytest.mark.parametrize("delay", [1e-5, 1e-4, 2.0])
    def test_all_pass_and_stable(self, order, delay):
        system = pade(delay, order, "in", "out")
        assert (system.n_states, system.inputs, system.outputs) == (order, ("in",), ("out",))
        assert is_stable(system)
        values = frequency_response(system, np.array([0.0, 0.1, 1.0, 10.0]) / delay).values[:, 0, 0]
        np.testing.assert_allclose(np.abs(values), 1.0, rtol=1e-11)

    @pytest.mark.parametrize("order", [1, 2, 3, 4])
    def test_order_of_the_phase_error(self, order):
        """The first wrong power of omega tau is 2 order + 1."""
        omega = np.array([0.4, 0.8])
        error = np.abs(
            frequency_response(pade(1.0, order), omega).values[:, 0, 0] - np.exp(-1j * omega)
        )
        assert np.log2(error[1] / error[0]) == pytest.approx(2 * order + 1, abs=0.1)

    def test_first_order_by_hand(self):
        assert poles(pade(0.1, 1)) == pytest.approx([-20.0])

    @pytest.mark.parametrize(
        ("delay", "order"), [(0.0, 2), (1.0, 0), (1.0, 1.5), (1.0, 13), (np.nan, 1)]
    )
    def test_refuses(self, delay, order):
        with pytest.raises(InvalidInput):
            pade(delay, order)


def test_sampling_a_filter_keeps_its_dc_gain():
    lowpass = transfer_function([1.0], [1 / 300.0**2, 1.4 / 300.0, 1.0])
    for method in ("zoh", "tustin"):
        value = frequency_response(c2d(lowpass, 1e-3, method, delay=1e-3), [0.0]).values
        assert value[0, 0, 0] == pytest.approx(1.0, rel=1e-12)
