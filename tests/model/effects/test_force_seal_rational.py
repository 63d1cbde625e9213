"""Rational models of frequency-dependent seals: exact where the table is rational, close to it
otherwise, causal always.
"""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.machine.part import Seal, SealTable
from ambrose.model.effects import seal as constant
from ambrose.model.effects.seal_rational import (
    force,
    lag,
    linearised,
    poles_of,
    rational,
    rows,
    system,
)

FREQUENCY = tuple(np.linspace(0, 2000, 21))
PISTON = replace(load_machine("turboexpander").seals[0], frequency_dependence="states")
DROP = 38.5e5


def seal_with(direct, cross, poles, frequency=FREQUENCY):
    """A seal whose table holds the dynamic stiffnesses H_d, H_c (w,), C and c constant at
    standstill.
    """
    w = np.array(frequency)
    slope = np.where(w > 0, np.divide(1, w, where=w > 0, out=np.zeros_like(w)), 0.0)
    names = {"K": direct.real, "C": direct.imag * slope, "k": cross.real, "c": cross.imag * slope}
    table = SealTable((("frequency", frequency),), tuple((n, tuple(v)) for n, v in names.items()))
    return Seal("s", 0.1, table=table, frequency_dependence="states", poles=poles)


def rational_table(poles, poles_asked=None):
    """K_0 + C_0 s + sum r s/(s + p), the same for the cross terms, and what it is at the table's
    frequencies.
    """
    s = 1j * np.array(FREQUENCY)
    lags = np.array([s / (s + p) for p in poles])
    direct, cross = np.linspace(2e6, 4e6, len(poles)), np.linspace(-1e6, 3e6, len(poles))
    return seal_with(
        1e6 + 800 * s + direct @ lags, 2e6 - 300 * s + cross @ lags, poles_asked or len(poles)
    )


@pytest.mark.parametrize("poles", [(300.0,), (150.0, 700.0), (100.0, 400.0, 1500.0)])
def test_a_rational_table_is_found_exactly(poles):
    model = rational(rational_table(poles))
    assert model.error < 1e-9
    assert np.sort(-np.linalg.eigvals(model.A)) == pytest.approx(poles, rel=1e-6)
    assert model.static.C == pytest.approx(800.0, rel=1e-5)
    assert linearised(model, 0.0).K == pytest.approx(1e6, rel=1e-6)
    assert linearised(model, 0.0).k == pytest.approx(2e6, rel=1e-6)


def test_other_causal_tables_are_met_better_with_more_poles():
    """1 - (1 + s T)^(-1/2), relaxation without a pole: stiffness rises with frequency to a plateau,
    damping falls.
    """
    relaxed = 1 - (1 + 1j * np.array(FREQUENCY) / 300) ** -0.5
    errors = [
        rational(seal_with(4e6 + 8e6 * relaxed, 3e6 - 1e6 * relaxed, n)).error for n in (1, 2, 3)
    ]
    assert errors[0] > errors[1] > errors[2]
    assert errors[1] < 0.01
    assert errors[2] < 0.001


def test_a_table_that_no_causal_seal_has_shows_in_the_error():
    """Stiffness that rises without the damping that goes with it (Kramers and Kronig): no model can
    follow.
    """
    w = np.array(FREQUENCY)
    assert rational(seal_with(4e6 + 8e6 * np.tanh(w / 900) ** 2 + 1e3j * w, 0j * w, 4)).error > 0.1


def test_poles_are_common_to_all_pressures_and_speeds_of_a_table():
    """Two pressures with the same pole, the second twice the first, and nothing at zero: the pole
    is found from all of them.
    """
    w = np.array(FREQUENCY)
    s = 1j * w
    direct = 1e6 + 3e6 * s / (s + 250)
    slope = np.where(w > 0, direct.imag / np.maximum(w, 1), 3e6 / 250)
    table = SealTable(
        (("pressure", (0.0, 1e5, 2e5)), ("frequency", FREQUENCY)),
        (
            ("K", tuple(tuple(factor * direct.real) for factor in (0, 1, 2))),
            ("C", tuple(tuple(factor * slope) for factor in (0, 1, 2))),
        ),
    )
    item = Seal("s", 0.1, table=table, frequency_dependence="states", poles=1)
    assert poles_of(item).real == pytest.approx([-250.0], rel=1e-6)
    one, two = rational(item, 1e5), rational(item, 2e5)
    assert two.direct == pytest.approx(2 * one.direct)
    assert two.direct @ two.b == pytest.approx(-2 * 3e6 * 250, rel=1e-6)
    assert not rational(item, 0.0).direct.any()


def test_the_gas_seal_is_met_up_to_its_highest_frequency():
    """Against the bulk flow at frequencies between the fitted ones: 11 % with two poles, 0.5 % with
    three, 0.2 % with five.
    """
    w = 2 * np.pi * np.array([3.3, 27.0, 77.0, 140.0, 213.0, 340.0, 610.0, 900.0, 1200.0, 1490.0])
    exact = [constant.coefficients(PISTON, DROP, frequency=x) for x in w]
    truth = np.array(
        [[c.K + 1j * x * c.C, c.k + 1j * x * c.c] for c, x in zip(exact, w, strict=True)]
    ).T
    errors = []
    for poles in (2, 3, 5):
        model = rational(replace(PISTON, poles=poles), DROP)
        assert (np.linalg.eigvals(model.A).real < 0).all()
        assert (model.static.C, model.static.c) == (0.0, 0.0)  # finite at high frequency
        found = [linearised(model, x) for x in w]
        fitted = np.array(
            [[c.K + 1j * x * c.C, c.k + 1j * x * c.c] for c, x in zip(found, w, strict=True)]
        ).T
        errors.append((np.abs(fitted - truth).max(axis=1) / np.abs(truth).max(axis=1)).max())
    assert errors[0] < 0.12
    assert errors[1] < 0.01
    assert errors[2] < 0.003


def test_without_a_pressure_drop_the_states_exert_no_force():
    model = rational(PISTON, 0.0)
    assert len(model.b) == PISTON.poles
    assert not model.direct.any() and not model.cross.any()
    assert model.static == constant.SealCoefficients()


def test_state_space_is_the_force_law():
    """-[[H_d, H_c], [-H_c, H_d]] without the constants."""
    model = rational(PISTON, DROP)
    w = 900.0
    at, rest = linearised(model, w), model.static
    direct = (at.K - rest.K) + 1j * w * (at.C - rest.C)
    cross = (at.k - rest.k) + 1j * w * (at.c - rest.c)
    response = frequency_response(system(model, "s"), [w]).values[0][:2]
    assert response == pytest.approx(-np.array([[direct, cross], [-cross, direct]]), rel=1e-9)


def test_time_domain_matches_the_linear_view():
    """Steady whirl at a frequency, the states integrated from zero: force against K, k, C, c
    there.
    """
    model = rational(PISTON, DROP)
    w, r, lines, n = 400.0, 1e-5, rows(model), len(model.b)

    def place(t):
        return r * np.cos(w * t), 0.3 * r * np.sin(w * t + 0.4)

    def motion(t, s):
        return np.array(
            [[lag(v, s[j::2], line) for j, v in enumerate(place(t))] for line in lines]
        ).ravel()

    end = 40 / np.abs(np.linalg.eigvals(model.A).real).min()
    states = solve_ivp(motion, (0, end), np.zeros(2 * n), rtol=1e-10, atol=1e-16, max_step=1e-3).y[
        :, -1
    ]
    x, y = place(end)
    vx, vy = -r * w * np.sin(w * end), 0.3 * r * w * np.cos(w * end + 0.4)
    expected = constant.force(x, y, vx, vy, 0.0, 0.0, constant.parameters(linearised(model, w)))
    found = np.array(constant.force(x, y, vx, vy, 0.0, 0.0, constant.parameters(model.static)))
    for i in range(n):
        found += force(states[2 * i], states[2 * i + 1], model.direct[i], model.cross[i])
    assert found == pytest.approx(expected, rel=1e-6)


def test_bad_input():
    one = SealTable((("frequency", (100.0,)),), (("K", (1e6,)),))
    with pytest.raises(InvalidInput, match="at least two frequencies"):
        rational(Seal("s", 0.1, table=one))
    with pytest.raises(InvalidInput, match="reference_pressure of seal piston is missing"):
        rational(replace(PISTON, reference_pressure=None), DROP)


def test_compiles_as_it_stands():
    numba = pytest.importorskip("numba")
    model = rational(PISTON, DROP)
    row, states = rows(model)[0], np.linspace(1e-6, 2e-6, len(model.b))
    assert numba.njit(inspect.unwrap(lag))(1e-5, states, row) == pytest.approx(
        lag(1e-5, states, row), rel=1e-14
    )
    assert numba.njit(inspect.unwrap(force))(1e-5, 2e-5, 3.0, 4.0) == pytest.approx(
        force(1e-5, 2e-5, 3.0, 4.0)
    )
