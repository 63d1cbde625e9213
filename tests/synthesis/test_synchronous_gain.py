"""eps of a band over speed: what acts is eps |T|, kept by a sensitivity of closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from ambrose.annexes.synchronous import block_gain
from ambrose.annexes.synchronous.block_loop import BlockTable

BAND, GAIN = (100.0, 400.0), 12.0


def largest(speed):
    """The largest eps that keeps the limit of this file's sensitivity: small at the low end."""
    return 0.5 + 20.0 * ((speed - 100.0) / 300.0) ** 2


@pytest.fixture
def sensitive(monkeypatch):
    def peak(loop, mode, speed, condition, T, eps, leak=0.0):
        size = 0.0 if T is None else np.linalg.norm(T, 2)
        return 1.0 + 2.0 * eps * size / largest(speed), speed

    monkeypatch.setattr(block_gain, "sensitivity_peak", peak)
    monkeypatch.setattr(block_gain, "demand", lambda *args: SimpleNamespace(limit=3.0))
    return SimpleNamespace(machine=SimpleNamespace(requirements=None))


def test_eps_is_that_of_each_speed_and_not_of_the_worst(sensitive):
    rng = np.random.default_rng(0)
    T = rng.standard_normal((4, 2, 2)) + 1j * rng.standard_normal((4, 2, 2))
    T /= np.linalg.norm(T, 2, axis=(1, 2))[:, None, None]
    table = BlockTable(np.array([100.0, 220.0, 330.0, 400.0]), T)
    eps, smaller, words = block_gain.sensitive_table(
        sensitive, "current-free", BAND, table, (None,), GAIN
    )
    assert eps == GAIN  # at the high end nothing holds it back
    assert "100 to 400 rad/s" in words
    for speed in np.linspace(*BAND, 7):
        acting = eps * np.linalg.norm(smaller.at(speed), 2)
        allowed = min(GAIN * np.linalg.norm(table.at(speed), 2), largest(speed))
        # the search ends within a factor of the square root of two, on the safe side
        assert 0.7 * allowed <= acting <= allowed * (1 + 1e-9)
        # the direction is that of T
        other = (
            table.at(speed) * np.linalg.norm(smaller.at(speed)) / np.linalg.norm(table.at(speed))
        )
        assert smaller.at(speed) == pytest.approx(other, abs=1e-12)


def test_what_keeps_the_sensitivity_everywhere_is_left_as_it_is(sensitive):
    table = BlockTable(np.array([100.0]), np.eye(2, dtype=complex)[None])
    found = block_gain.sensitive_table(sensitive, "damping", BAND, table, (None,), 0.4)
    assert found == (0.4, table, "")
