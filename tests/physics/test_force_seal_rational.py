"""Rational models of frequency-dependent seals: exact where the table is rational, close to it otherwise, causal always."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import Seal, SealTable
from ambrose.physics import seal as constant
from ambrose.physics.seal_rational import RationalSeal, force, lag, linearised, parameters, rational

FREQUENCY = tuple(np.linspace(0, 2000, 21))


def table_of(model, frequency=FREQUENCY):
    """A seal whose table holds a model's coefficients."""
    rows = [linearised(model, w) for w in frequency]
    values = tuple((name, tuple(getattr(row, name) for row in rows)) for name in ("K", "k", "C", "c"))
    return Seal("s", 0.1, table=SealTable((("frequency", frequency),), values))


def model_with_poles(poles):
    direct, cross = np.linspace(2e6, 4e6, len(poles)), np.linspace(-1e6, 3e6, len(poles))
    return RationalSeal(constant.SealCoefficients(1e6, 2e6, 800.0, -300.0), np.asarray(poles), direct, cross, 0.0)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_rational_table_is_found_exactly(n):
    poles = rational(table_of(model_with_poles([300.0])), n_poles=n).poles
    truth = model_with_poles(poles)
    found = rational(table_of(truth), n_poles=n)
    assert found.error < 1e-10
    assert found.direct == pytest.approx(truth.direct, rel=1e-6)
    assert found.cross == pytest.approx(truth.cross, rel=1e-6)
    assert found.static.K == pytest.approx(1e6, rel=1e-6)
    assert found.static.c == pytest.approx(-300.0, rel=1e-5)


def seal_with(direct, cross, frequency=FREQUENCY):
    """A seal whose table holds the dynamic stiffnesses H_d, H_c (w,), C and c constant at standstill."""
    w = np.array(frequency)
    slope = np.where(w > 0, np.divide(1, w, where=w > 0, out=np.zeros_like(w)), 0.0)
    names = {"K": direct.real, "C": direct.imag * slope, "k": cross.real, "c": cross.imag * slope}
    return Seal("s", 0.1, table=SealTable((("frequency", frequency),), tuple((n, tuple(v)) for n, v in names.items())))


def test_other_causal_tables_are_met_better_with_more_poles():
    """1 - (1 + s T)^(-1/2), relaxation without a pole: stiffness rises with frequency to a plateau, damping falls."""
    relaxed = 1 - (1 + 1j * np.array(FREQUENCY) / 300) ** -0.5
    item = seal_with(4e6 + 8e6 * relaxed, 3e6 - 1e6 * relaxed)
    errors = [rational(item, n_poles=n).error for n in (1, 2, 4)]
    assert errors[0] > errors[1] > errors[2]
    assert errors[1] < 0.02
    assert errors[2] < 0.01


def test_a_table_that_no_causal_seal_has_shows_in_the_error():
    """Stiffness that rises without the damping that goes with it (Kramers and Kronig): no model can follow."""
    w = np.array(FREQUENCY)
    item = seal_with(4e6 + 8e6 * np.tanh(w / 900) ** 2 + 1e3j * w, 0j * w)
    assert rational(item, n_poles=4).error > 0.2


def test_time_domain_matches_the_linear_view():
    """Steady whirl at a frequency, the lags integrated from zero: force against K, k, C, c there."""
    model = rational(table_of(model_with_poles([150.0, 700.0])), n_poles=2)
    w, r, rows = 400.0, 1e-5, parameters(model)

    def place(t):
        return r * np.cos(w * t), 0.3 * r * np.sin(w * t + 0.4)

    def motion(t, s):
        x, y = place(t)
        return [lag(v, s[2 * i + j], rows[i]) for i in range(len(rows)) for j, v in enumerate((x, y))]

    end = 40 / rows[:, 0].min()
    states = solve_ivp(motion, (0, end), np.zeros(2 * len(rows)), rtol=1e-10, atol=1e-16, max_step=1e-3).y[:, -1]
    x, y = place(end)
    vx, vy = -r * w * np.sin(w * end), 0.3 * r * w * np.cos(w * end + 0.4)
    now = constant.parameters(linearised(model, w))
    expected = constant.force(x, y, vx, vy, 0.0, 0.0, now)
    found = np.array(constant.force(x, y, vx, vy, 0.0, 0.0, constant.parameters(model.static)))
    for i, row in enumerate(rows):
        found += force(x, y, states[2 * i], states[2 * i + 1], row)
    assert found == pytest.approx(expected, rel=1e-6)


def test_a_table_of_zeros_is_met():
    model = rational(seal_with(1e6 + 0j * np.array(FREQUENCY), 0j * np.array(FREQUENCY)))
    assert model.error < 1e-12
    assert model.static.K == pytest.approx(1e6)
    assert not model.cross.any()


def test_constants_need_no_poles():
    item = Seal("s", 0.1, K=1e6, k=2e6, C=300.0, M=0.2)
    model = rational(item)
    assert len(model.poles) == 0
    assert model.error == 0
    assert linearised(model, 123.0) == constant.coefficients(item)


def test_coefficients_at_standstill_are_finite():
    model = model_with_poles([100.0, 900.0])
    found = linearised(model, 0.0)
    assert found.K == model.static.K
    assert found.C == pytest.approx(800.0 + model.direct[0] / 100 + model.direct[1] / 900)


def test_bad_input():
    one = Seal("s", 0.1, table=SealTable((("frequency", (100.0,)),), (("K", (1e6,)),)))
    with pytest.raises(InvalidInput, match="one frequency"):
        rational(one)
    with pytest.raises(InvalidInput, match="n_poles"):
        rational(table_of(model_with_poles([100.0])), n_poles=0)


def test_compiles_as_it_stands():
    numba = pytest.importorskip("numba")
    row = parameters(model_with_poles([100.0]))[0]
    assert numba.njit(lag)(1e-5, 0.0, row) == lag(1e-5, 0.0, row)
    assert numba.njit(force)(1e-5, 2e-5, 0.0, 0.0, row) == pytest.approx(force(1e-5, 2e-5, 0.0, 0.0, row))
