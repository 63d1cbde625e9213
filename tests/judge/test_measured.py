"""A controller judged on measured responses: those of the tests' own rig, whose magnets and modes
are not those of the machine file.
"""

import json
import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.linalg import block_diag, expm
from scipy.signal import cont2discrete, tf2ss

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.judge.checks import Check, Checks
from ambrose.judge.controller_file import write_controller
from ambrose.judge.measured import check_measured, margins
from ambrose.judge.plants import full_plants
from ambrose.judge.verdict import _TOLD, _with_model
from ambrose.law.loop import timing_of
from ambrose.machine.description import OperatingPoint
from ambrose.record.response import Path, Response
from ambrose.record.response_files import write_response
from independent_rig import Rig, numbers_of

MACHINE, RATE = "seal-rig", 1e4
FILE = FilePath(amb.__file__).parent / "machines" / f"{MACHINE}.toml"
# every twentieth of a decade, and by one and two hertz about the bending modes
HERTZ = np.unique(
    np.concatenate(
        [np.geomspace(4, 1600, 130), np.arange(480, 620, 1.0), np.arange(1200, 1460, 2.5)]
    ).round(3)
)
FINE = np.unique(
    np.concatenate(
        [np.geomspace(4, 1600, 2000), np.arange(500, 600, 0.25), np.arange(1280, 1400, 1.0)]
    )
)


@cache
def machine():
    """The machine file's model, on a coarse mesh, which takes a tenth of the time."""
    full = amb.load_machine(MACHINE)
    coarse = tuple(replace(part, elements=min(part.elements, 2)) for part in full.shaft)
    return replace(full, shaft=coarse)


@cache
def running():
    """The package's PID and its matrices as sampled."""
    found = amb.design(machine(), "pid").controller
    law = c2d(found, 1 / RATE, "tustin")
    return found, (law.A, law.B, law.C, law.D)


def rig_of(magnets=(0.0, 0.0), mode=0.0):
    """The rig with k_i and k_s off by a part, and its modes by another."""
    numbers = numbers_of(FILE)
    for bearing in numbers["bearings"]:
        bearing["ki"], bearing["ks"] = (
            bearing[key] * (1 + part) for key, part in zip(("ki", "ks"), magnets, strict=True)
        )
    for section in numbers["shaft"]:
        section["youngs_modulus"] *= (1 + mode) ** 2
    return Rig(numbers, linear=True)


@dataclass(frozen=True, eq=False)
class Truth:
    """The sampled plant of a rig, its G on the lines and on a fine grid of the same range."""

    rig: Rig
    held: tuple

    @staticmethod
    @cache
    def of(magnets=(0.0, 0.0), mode=0.0):
        rig = rig_of(magnets, mode)
        a, n = len(rig.axes), len(rig.A)
        big = np.zeros((n + a, n + a))
        big[:n, :n], big[:n, n:] = rig.A, rig.Bv
        big = expm(big / rig.rate)
        return Truth(rig, (big[:n, :n], big[:n, n:], rig.Cy, np.zeros((a, a))))

    @cache  # noqa: B019
    def plant(self, key):
        return response(self.held, FINE if key == "fine" else HERTZ)

    def stable(self, law, edge=0.0):
        """Of the loop with its delay of one sample: states of plant, law and held current."""
        Ad, Bd, Cy, zero = self.held
        A, B, C, D = law
        loop = np.block(
            [
                [Ad, np.zeros((len(Ad), len(A))), Bd],
                [-B @ Cy, A, np.zeros((len(A), len(zero)))],
                [-D @ Cy, C, zero],
            ]
        )
        return np.abs(np.linalg.eigvals(loop)).max() < 1 + edge

    def largest(self, law):
        """The largest sensitivity of every axis within the sweep."""
        GK = self.plant("fine") @ late(law, FINE)
        S = np.linalg.inv(np.eye(4) + GK)
        return np.abs(np.einsum("wii->wi", S)).max(axis=0)


def response(matrices, hertz):
    A, B, C, D = matrices
    z = np.exp(2j * np.pi * hertz / RATE)
    inner = z[:, None, None] * np.eye(len(A)) - A
    return C @ np.linalg.solve(inner, np.broadcast_to(B, (len(z), *B.shape))) + D


def late(law, hertz):
    """K with its delay of one sample."""
    return np.exp(-2j * np.pi * hertz / RATE)[:, None, None] * response(law, hertz)


def random_law(rng):
    """A PID for every axis, each with its own filter, by Tustin's rule; time in samples."""
    sampled = []
    for _ in range(4):
        gain = 18250 * np.exp(rng.uniform(-0.4, 0.3))
        rate_time = 0.0035 * np.exp(rng.uniform(-0.4, 0.5)) * RATE
        lag, corner = 10 ** rng.uniform(-4.4, -3.7) * RATE, 2 * np.pi * 10 ** rng.uniform(2.9, 3.5)
        corner, integral = corner / RATE, rng.choice([0.1, 0.3, 10.0]) * RATE
        # P (1 + 1/(T_i s) + T_d s/(1 + s T_f)) / (1 + 1.4 s/w + s^2/w^2)
        over = np.polyadd(
            np.polymul([integral, 1], [lag, 1]), np.polymul([integral, 0], [rate_time, 0])
        )
        under = np.polymul(np.polymul([integral, 0], [lag, 1]), [corner**-2, 1.4 / corner, 1])
        sampled.append(cont2discrete(tf2ss(gain * over, under), 1.0, "bilinear")[:4])
    A, B, C, D = (block_diag(*(item[k] for item in sampled)) for k in range(4))
    names = [f"{side}_{axis}" for side in ("err", "u") for axis in machine().axes]
    return amb.StateSpace(A, B, C, D, names[:4], names[4:], dt=1 / RATE), (A, B, C, D)


def sweep(truth, law, kind="T", noise=0.01, seed=1, stated=True):
    """Responses of the running loop with noise."""
    G, K, eye = truth.plant("lines"), late(law, HERTZ), np.eye(4)
    S = np.linalg.inv(eye + G @ K)
    inner = np.linalg.inv(eye + K @ G)
    values = {"S": S, "T": G @ K @ S, "motion": G @ inner, "G": G, "I": K @ G @ inner}
    rng, paths = np.random.default_rng(seed), []
    for quantity in kind.split("+"):
        X = values[quantity]
        floor = 0.05 * np.median(np.abs(X[:, 0, 0]))
        for i, j in np.ndindex(4, 4):
            size = noise * np.hypot(np.abs(X[:, i, j]), floor)
            error = rng.normal(size=(2, len(HERTZ))) * size / np.sqrt(2)
            value = X[:, i, j] + error[0] + 1j * error[1]
            axes = truth.rig.axes[i], truth.rig.axes[j]
            at = "current" if quantity == "I" else "sensor"
            name = "T" if quantity == "I" else quantity
            paths.append(Path(name, *axes, value, size**2 if stated else None, at))
    point = OperatingPoint(0.0, 0.0)
    return Response(MACHINE, 2 * np.pi * HERTZ, tuple(paths), point, sample_rate_hz=RATE)


@cache
def plant():
    return next(item for item in full_plants(machine()) if item.point.seal_pressure == 0)


def judged(response, law, ran=True):
    law = law[0] if isinstance(law, tuple) else law
    timing = timing_of(machine(), law, RATE)
    return check_measured(plant(), response, law, running()[0] if ran else None, timing)


def peaks(checks, which):
    """The largest sensitivity of every axis: "measured", "lower end", "upper end", "model"."""
    return checks.curve(f"sensitivity.output.{which}").y[1:].max(axis=1)


def ends(checks):
    """The lower and the upper end of the largest sensitivity of every axis."""
    return peaks(checks, "lower end"), peaks(checks, "upper end")


def count(truth, number, kind="T", seed=0, **options):
    """Of random controllers: wrong verdicts, undecided ones, stable ones and how many of these have
    the largest sensitivity of all axes within its interval; the intervals' part of it.
    """
    rng = np.random.default_rng(seed)
    wrong, undecided, widths, within = [], [], [], 0
    for k in range(number):
        law = random_law(rng)
        response = sweep(truth, running()[1], kind, seed=k, **options)
        try:
            checks = judged(response, law, ran=kind != "G")
        except InvalidInput as error:
            assert "do not show" in str(error), error
            undecided.append(k)
            continue
        if checks.stable != truth.stable(law[1]):
            wrong.append(k)
        elif checks.stable:
            low, high = ends(checks)
            value = truth.largest(law[1])
            within += bool(((low <= value) & (value <= high)).all())
            widths.append(float(((high - low) / value).max()))
    return wrong, undecided, within, widths


KINDS = [("T", {}), ("T", {"stated": False}), ("S+T", {}), ("motion", {}), ("I", {}), ("G", {})]


@pytest.mark.parametrize(("kind", "options"), KINDS, ids=str)
def test_random_controllers_on_the_measured_plant(kind, options):
    """Each of them on a plant whose magnets are 10 and 8 %, whose modes 3 % off the file's."""
    truth = Truth.of((0.1, -0.08), -0.03)
    wrong, undecided, within, widths = count(truth, 4, kind, **options)
    assert not wrong and len(undecided) <= 1
    assert within == len(widths) > 0
    assert np.median(widths) < 0.4


@pytest.mark.study
def test_two_hundred_controllers():
    """On the whole: no verdict wrong, the largest sensitivity in 95 of 100 within its interval."""
    truth = Truth.of((0.1, -0.08), -0.03)
    wrong, undecided, within, widths = count(truth, 200)
    print(f"{len(undecided)} undecided, {within} of {len(widths)}, median {np.median(widths):.3f}")
    assert not wrong and len(undecided) <= 20
    assert within >= 0.95 * len(widths)


OFF = [((0.05, -0.05), -0.03), ((0.1, -0.1), -0.05), ((-0.1, 0.1), 0.05), ((0.2, -0.2), -0.1)]


@pytest.mark.parametrize(("magnets", "mode"), OFF)
def test_the_measured_answer_beside_the_models(magnets, mode, capsys):
    """The model is off by what its magnets and mode are, the measured plant by its noise."""
    truth = Truth.of(magnets, mode)
    law = running()
    checks = judged(sweep(truth, law[1]), law)
    value = truth.largest(law[1])
    low, high = ends(checks)
    model, measured = peaks(checks, "model"), peaks(checks, "measured")
    print(f"{magnets} {mode}: {value.round(2)} {measured.round(2)} {model.round(2)}")
    assert ((low <= value) & (value <= high)).all()
    assert np.abs(measured / value - 1).max() < 0.04
    assert np.abs(model / value - 1).max() > 2 * np.abs(measured / value - 1).max()
    assert f"{model[0]:.4g}" in checks["sensitivity.output.A_zeta"].detail
    # every margin is below the true one, and not by much
    S = np.linalg.inv(np.eye(4) + truth.plant("fine") @ late(law[1], FINE))
    for i, axis in enumerate(machine().axes):
        gain, phase = margins(S[:, i, i], np.zeros(len(FINE)))
        own = [checks[f"margin.{kind}.output.{axis}"].value for kind in ("gain", "phase")]
        assert 0.7 * gain < own[0] < 1.01 * gain
        assert 0.7 * phase < own[1] < 1.01 * phase


def test_margins_of_a_loop_in_closed_form():
    """L = 4/(1 + s)^3: gain 2, and a wider disc takes from both margins."""
    omega = np.geomspace(0.01, 100, 4000)
    L = 4 / (1 + 1j * omega) ** 3
    gain, phase = margins(1 / (1 + L), np.zeros(len(omega)))
    crossing = np.sqrt(4 ** (2 / 3) - 1)
    assert gain == pytest.approx(2, rel=2e-3)
    assert phase == pytest.approx(np.pi - 3 * np.arctan(crossing), rel=2e-2)
    less = margins(1 / (1 + L), 0.1 * np.ones(len(omega)))
    # the largest real value within 0.1 of any S: there 1 + L = 1/s, and -1/L is the factor
    S = 1 / (1 + L)
    near = np.abs(S.imag) < 0.1
    s = (S.real[near] + np.sqrt(0.01 - S.imag[near] ** 2)).max()
    assert less[0] == pytest.approx(1 / (1 - 1 / s), rel=2e-3)
    assert less[1] < phase


def test_an_unstable_controller_counts_with_its_own_poles():
    """A law that is unstable by itself, at 150 Hz, holds the rotor all the same: of r/(z - z0)
    beside K the loop makes z0 - r Y(z0), which lies inside for one sign of r.
    """
    law, (A, B, C, D) = random_law(np.random.default_rng(3))
    truth, hertz = Truth.of((0.1, -0.08), -0.03), np.array([150.0])
    G = response(truth.held, hertz)
    Y = np.linalg.solve(np.eye(4) + G @ late((A, B, C, D), hertz), G)[0, 0, 0]
    turn = np.exp(2j * np.pi * hertz[0] / RATE)
    z = 1.0005 * turn
    found = []
    for sign in (1.0, -1.0):
        r = sign * 0.002 * z * turn / Y  # one sample late
        grown = block_diag(A, [[z.real, -z.imag], [z.imag, z.real]])
        b, c = np.zeros((2, 4)), np.zeros((4, 2))
        b[0, 0], c[0] = 1.0, [2 * r.real, -2 * r.imag]
        matrices = (grown, np.vstack([B, b]), np.hstack([C, c]), D)
        new = amb.StateSpace(*matrices, law.inputs, law.outputs, dt=1 / RATE)
        checks = judged(sweep(truth, running()[1], noise=0.002), new)
        found.append((checks.stable, truth.stable(matrices)))
    assert found == [(True, True), (False, False)]


def without(response, low, high):
    omega = response.omega / (2 * np.pi)
    kept = (omega < low) | (omega > high)
    paths = [
        replace(p, values=p.values[kept], variance=None if p.variance is None else p.variance[kept])
        for p in response.paths
    ]
    return replace(response, omega=response.omega[kept], paths=tuple(paths))


def test_a_gap_that_hides_a_mode_is_never_green():
    """Thirty hertz on either side of the mode its flanks drown in the noise: neither line shows it,
    and of twenty controllers two were once called stable that are not.
    """
    truth, rng = Truth.of((0.1, -0.08), -0.03), np.random.default_rng(0)
    for k in range(6):
        law = random_law(rng)[0]
        with pytest.raises(InvalidInput, match="do not show"):
            judged(without(sweep(truth, running()[1], seed=k), 520, 580), law)


def diagonal(response):
    return replace(response, paths=tuple(p for p in response.paths if p.read == p.injected))


def with_axis(law, other, axis):
    """A law with one axis of another one; both are diagonal."""
    (A, B, C, D), (A2, B2, C2, D2) = law, other
    keep = np.arange(4) != axis
    matrices = (
        block_diag(A, A2),
        np.vstack([B * keep, B2 * ~keep]),
        np.hstack([C * keep[:, None], C2 * ~keep[:, None]]),
        D * np.outer(keep, keep) + D2 * np.outer(~keep, ~keep),
    )
    names = [f"{side}_{name}" for side in ("err", "u") for name in machine().axes]
    return amb.StateSpace(*matrices, names[:4], names[4:], dt=1 / RATE), matrices


def test_the_diagonal_alone_tells_the_loop_that_ran():
    truth, law = Truth.of((0.1, -0.08), -0.03), running()
    checks = judged(diagonal(sweep(truth, law[1])), law)
    S = np.linalg.inv(np.eye(4) + truth.plant("fine") @ late(law[1], FINE))
    value = np.abs(np.einsum("wii->wi", S)).max(axis=0)
    low, high = (checks.curve(f"sensitivity.output.{end}").y.max(axis=1)
                 for end in ("lower end", "upper end"))  # fmt: skip
    assert ((low <= value) & (value <= high)).all() and checks.stable
    assert checks["sensitivity.told"].passed
    # without the axes between each other the limit of the largest singular value is not met
    assert checks["sensitivity.output.max"].passed is False and not checks.passed
    assert "not measured between" in checks["sensitivity.output.max"].detail


@pytest.mark.parametrize("kind", ["T", "motion", "I"])
def test_the_diagonal_alone_tells_one_axis_that_changes(kind):
    """Stability and the axis's own sensitivity against the whole loop's; the others are not told,
    which is no pass.
    """
    truth, base = Truth.of((0.1, -0.08), -0.03), running()
    rng, found = np.random.default_rng(1), []
    for k in range(6):
        law, matrices = with_axis(base[1], random_law(rng)[1], k % 4)
        checks = judged(diagonal(sweep(truth, base[1], kind, seed=k)), law)
        # the integrator of the axis that was taken out stays, at 1, and acts on nothing
        assert checks.stable == truth.stable(matrices, edge=1e-9)
        assert not checks.passed
        if checks.stable:
            told = checks["sensitivity.told"]
            assert told.value == 1 and not told.passed and "not told" in told.detail
            low, high = (checks.curve(f"sensitivity.output.{end}").y[0].max()
                         for end in ("lower end", "upper end"))  # fmt: skip
            found.append(low <= truth.largest(matrices)[k % 4] <= high)
    assert all(found) and len(found) > 2


def test_the_diagonal_alone_does_not_tell_two_axes_that_change():
    truth, base = Truth.of((0.1, -0.08), -0.03), running()
    law = with_axis(base[1], random_law(np.random.default_rng(1))[1], 0)
    two = with_axis(law[1], random_law(np.random.default_rng(2))[1], 1)
    with pytest.raises(InvalidInput, match=r"12 of 16 .* one axis at a time"):
        judged(diagonal(sweep(truth, base[1])), two)


def test_what_does_not_tell_is_refused_in_one_sentence():
    truth = Truth.of((0.1, -0.08), -0.03)
    law = random_law(np.random.default_rng(0))[0]
    whole = sweep(truth, running()[1])
    other = random_law(np.random.default_rng(5))[1]
    wrong = [replace(whole.paths[0], read="C_zeta"), *whole.paths[1:]]
    both = sweep(truth, running()[1], "motion+T")
    mixed = (*both.kind("motion"), *sweep(truth, other, "T").paths)
    for words, response, ran in (
        ("no axis 'C_zeta'", replace(whole, paths=tuple(wrong)), True),
        ("1 of 16 responses", replace(whole, paths=whole.paths[1:]), True),
        ("number of lines", without(whole, 5, 1500), True),
        ("does not|do not show", without(whole, 525, 575), True),
        ("last line, 286.9", without(whole, 300.5, 1700), True),
        ("give the controller that ran", replace(both, paths=mixed), True),
        ("only with the controller that ran", whole, False),
    ):
        with pytest.raises(InvalidInput, match=words) as error:
            judged(response, law, ran)
        assert "\n" not in str(error.value) and "; " in str(error.value)


@pytest.mark.parametrize(
    ("kind", "factor"),
    [("T", 1.3), ("T", 2.0), ("T", 0.7), ("motion", 2.0), ("G", 2.0), ("S", 1.4)],
)
def test_a_scale_that_is_wrong_is_named(kind, factor):
    """On a plant whose magnets are 20 % off, which no scale is."""
    law = running()
    whole = sweep(Truth.of((0.2, -0.2), -0.1), law[1], kind)
    wrong = [replace(p, values=factor * p.values) for p in whole.paths]
    with pytest.raises(InvalidInput, match=r"A_zeta is about [\d.]+ times what .* its scale"):
        judged(replace(whole, paths=tuple(wrong)), law, ran=kind != "G")


MISREAD = {
    "radians": lambda p: np.abs(p.values) * np.exp(1j * np.radians(np.angle(p.values))),
    "a lag is positive": lambda p: p.values.conj(),
    "sign is": lambda p: -p.values,
    "not in dB": lambda p: 10 ** (np.abs(p.values) / 20) * np.exp(1j * np.angle(p.values)),
    "about 0.7": lambda p: 0.75 * p.values,
}


@pytest.mark.parametrize(
    ("kind", "words"),
    [("T", "radians"), ("G", "a lag is positive"), ("motion", "about 0.7"), ("motion", "sign is"),
     ("T", "not in dB")],
)  # fmt: skip
def test_numbers_of_another_meaning_are_named(kind, words):
    """Phases in radians stated as degrees gave T a sensitivity of 1 and a pass, phases of the other
    sign G half the true one, excitations read 0.75 times too small a tenth less.
    """
    whole = sweep(Truth.of((0.05, -0.05), -0.02), running()[1], kind, noise=0.002)
    judged(whole, running(), ran=kind != "G")  # as it is, it tells
    wrong = [replace(p, values=MISREAD[words](p)) for p in whole.paths]
    with pytest.raises(InvalidInput, match=words) as error:
        judged(replace(whole, paths=tuple(wrong)), running(), ran=kind != "G")
    assert "; " in str(error.value)


def test_what_responses_do_not_tell_is_checked_with_the_model():
    """An unbalance orbit four times its limit passed, where the point had been measured."""
    law, whole = random_law(np.random.default_rng(0))[0], sweep(Truth.of(), running()[1])
    stated = machine().requirements
    options = {"points": ["zero"], "running": running()[0], "tolerances": False}
    for limit, passed in ((1e-4, True), (1e-7, False)):
        file = replace(machine(), requirements=replace(stated, unbalance_orbit=limit))
        (point,) = amb.verify(file, law, measured=[whole], **options).points
        (modelled,) = amb.verify(file, law, points=["zero"], rate=RATE, tolerances=False).points
        own, other = point["unbalance.orbit_0p"], modelled["unbalance.orbit_0p"]
        assert (own.value, own.passed) == (other.value, other.passed) == (own.value, passed)
        assert point.label == "zero pressure, measured"
        assert {c.name for c in modelled.checks} - {c.name for c in point.checks} <= {
            c.name for c in modelled.checks if c.name.startswith(_TOLD)
        }
        assert point.passed <= passed


def test_a_model_that_is_unstable_where_it_was_measured_does_not_pass():
    """Then nothing tells unbalance, currents and settling."""
    whole = judged(sweep(Truth.of(), running()[1]), running())
    point = Checks(
        "zero", False, (Check("stability.abscissa", "S", 3.0, "rad/s", 0.0, "<", False),)
    )
    both = _with_model(replace(whole, checks=whole.checks[:1]), point)
    assert both.stable and not both.passed and both.holds
    assert "identify the machine" in both["model.abscissa"].detail


def test_lines_out_of_phase_are_never_said_to_agree():
    """One line in nine turned over, of which never two lie side by side."""

    def top(response):
        said = judged(response, law).notes[0]
        found = re.search(r"agree within 10 % and 10 degrees up to ([\d.]+)", said)
        return None if found is None else float(found[1])

    law = running()
    whole = sweep(Truth.of((0.02, -0.02)), law[1])
    assert top(whole) > 1000
    turn = np.where(np.arange(len(HERTZ)) % 9 == 1, -1.0, 1.0)
    turned = tuple(replace(p, values=turn * p.values) for p in whole.paths)
    assert top(replace(whole, paths=turned)) is None


def test_from_the_command_line(tmp_path):
    """The three answers: passed or failed on the measured plant, and nothing told."""
    truth = Truth.of((0.05, -0.05), -0.02)
    run = lambda *words: CliRunner().invoke(main, ["verify", *map(str, words)])  # noqa: E731
    write_controller(tmp_path / "K.json", running()[0])
    write_response(sweep(truth, running()[1]), tmp_path / "measured.h5")
    given = (MACHINE, "--controller", tmp_path / "K.json", "--measured", tmp_path / "measured.h5")
    done = run(*given, "--running", tmp_path / "K.json", "--json", "--report", tmp_path / "p.html")
    assert done.exit_code in {0, 1}, done.stderr
    points = json.loads(done.stdout)["points"]
    labels = [item["label"] for item in points]
    assert labels[0] == "zero pressure, measured" and "zero pressure" not in labels
    assert len(points) == 3
    named = {item["name"]: item for item in points[0]["checks"]}
    low, high = truth.largest(running()[1])[0] * np.array([1.0, 1.2])
    assert low < named["sensitivity.output.A_zeta"]["value"] < high
    assert "measured and modelled" in (tmp_path / "p.html").read_text(encoding="utf-8")
    refused = run(*given)
    assert refused.exit_code == 2 and "--running" in refused.stderr
    assert len(refused.stderr.strip().splitlines()) <= 3
    fast = replace(sweep(truth, running()[1]), point=OperatingPoint(300.0, 0.0))
    write_response(fast, tmp_path / "measured.h5")
    refused = run(*given, "--running", tmp_path / "K.json")
    assert refused.exit_code == 2 and "no operating point of the machine" in refused.stderr
