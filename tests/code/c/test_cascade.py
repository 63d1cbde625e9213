"""Filter banks as cascades of second-order sections: the C code against Python, against the modal
form, and its rounding.
"""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

import code_driver as driver
from ambrose import load_machine
from ambrose.code.block.block import build_block
from ambrose.code.block.cascade import (
    _from_signals,
    _gains,
    _running_law,
    _signal_rows,
    block_law,
    build_cascade,
    floating_error,
    in_words,
)
from ambrose.code.block.fixed_point import response_error, sampled_response
from ambrose.code.block.run import LIMITED, run_of
from ambrose.code.c.code import generate
from ambrose.code.c.compiled import CompiledBlock, read_law
from ambrose.code.pipeline import export
from ambrose.code.sampled import deploy
from ambrose.code.targets import C
from ambrose.core.checks import InvalidInput
from ambrose.judge.result import Synthesis
from ambrose.law.pid import pid_controller
from ambrose.machine.part import MODES, Channel, PidSettings, Section
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Pulse, Scenario
from needs import needs

MACHINE = load_machine("seal-rig")
HZ = 2 * np.pi
DT = 1e-4
CURRENT = 4.0
PID = Section("pid", 0.2, 2e-3, 0.1)
NOTCH = Section(
    "notch", zero_frequency=HZ * 210, zero_damping=0.02, pole_frequency=HZ * 230, pole_damping=0.3
)
LAG = Section("lead-lag", zero_frequency=HZ * 900, pole_frequency=HZ * 300)
LOW_PASS = Section("low-pass", frequency=HZ * 1500, damping=0.7)
compiler = needs("gcc or clang")


def settings(coordinates="axes"):
    """Two chains of different length; the second has a section of first order and a constant, and
    no integrator.
    """
    names = MODES if coordinates != "axes" else MACHINE.axes
    twice = Section("sos", numerator=(2.0,), denominator=(1.0,))
    other = (replace(PID, integral_time=None), LAG, twice, LOW_PASS)
    chains = (Channel(names[:2], 20e3, (PID, NOTCH, LOW_PASS)), Channel(names[2:], 15e3, other))
    return PidSettings(channels=chains, coordinates=coordinates)


def both(coordinates="axes", error=0.5e-3, bank=None, **how):
    bank = settings(coordinates) if bank is None else bank
    deployment = deploy(pid_controller(bank, MACHINE), DT, DT, force=True, **how)
    block = build_cascade(deployment, bank, MACHINE, "rig", error, CURRENT, **how)
    return block, build_block(deployment, "rig", error, CURRENT)


@pytest.fixture(scope="module", params=["axes", "tilt-translate"])
def blocks(request):
    return both(request.param)


def test_1_and_3_sections_run_as_the_modal_form(blocks):
    """Limits, anti-windup and transfer included; the bounds hold and are no guess."""
    block, modal = blocks
    e, valid = driver.adversarial(modal, 3000)
    found, expected = run_of(block, e, valid=valid), run_of(modal, e, valid=valid)
    assert np.abs(found.currents - expected.currents).max() <= 1e-9
    assert (found.status == expected.status).all()
    assert 0.1 < ((found.status & LIMITED) > 0).mean() < 0.95
    assert (found.largest <= block.bound).all()
    assert ((found.largest / block.bound).max()) > 0.1
    assert (block.raw_limit <= modal.raw_limit * 1.0001).all()


def test_1_sections_against_scipy():
    """A chain of Tustin's sections in coefficients of 1/z, as scipy filters them, errors small
    enough for no limit.
    """
    block, _ = both(bank=settings())
    rng = np.random.default_rng(1)
    e = rng.uniform(-1e-7, 1e-7, (800, 4))
    w = [NOTCH.zero_frequency, NOTCH.pole_frequency]
    analog = [
        ([DT * 4.4 / 2 * 2 / DT * 1e-3, 2.2e-3 * 0 + 0.2 + 2e-4, 1.0], [0.2 * 2e-4, 0.2, 0.0]),
        ([1 / w[0] ** 2, 0.04 / w[0], 1], [1 / w[1] ** 2, 0.6 / w[1], 1]),
        ([1.0], [1 / LOW_PASS.frequency**2, 1.4 / LOW_PASS.frequency, 1]),
    ]
    t_i, t_f = 0.2, 0.1 * 2e-3  # 1 + 1/(t_i s) + 2e-3 s/(t_f s + 1) over one denominator
    analog[0] = ([t_i * t_f + t_i * 2e-3, t_i + t_f, 1.0], [t_i * t_f, t_i, 0.0])
    y = e[:, 0]
    for b, a in analog:
        y = scipy.signal.lfilter(*scipy.signal.bilinear(b, a, 1 / DT), y)
    assert np.abs(run_of(block, e).currents[:, 0] - 20e3 * y).max() <= 1e-9 * np.abs(20e3 * y).max()


def test_2_prewarping_reaches_the_sections():
    block, modal = both(prewarp=HZ * 210)
    plain, _ = both()
    e = np.zeros((50, 4))
    e[0] = 1e-7
    found = run_of(block, e).currents
    assert np.abs(found - run_of(modal, e).currents).max() < 1e-12
    assert np.abs(found - run_of(plain, e).currents).max() > 1e-8


@compiler
@pytest.mark.parametrize("blocks", ["axes", "tilt-translate"], indirect=True)
@pytest.mark.parametrize(
    "arithmetic",
    [
        "double",
        "float",
        "fixed32",
        "fixed16",
    ],
)
def test_code_agrees_with_python(blocks, arithmetic, tmp_path):
    """Under the sanitizers, to the last digits; words exactly."""
    block = blocks[0].single() if arithmetic == "float" else blocks[0]
    with np.errstate(all="ignore"):
        e, valid = driver.adversarial(block, 2000)
        e = e.astype(np.float32).astype(float) if arithmetic == "float" else e
    program = driver.compiled(
        block, arithmetic, tmp_path / "c", driver.compilers()[0], largest_error=0.1
    )
    if "fixed" in arithmetic:
        fixed = in_words(block, int(arithmetic[5:]), 0.1)
        words = np.nan_to_num(np.clip(e, -1, 1) / block.error_limit) * 2**fixed.signal_bits
        e = np.clip(
            np.round(words), 1 - 2.0 ** (fixed.word - 1), 2.0 ** (fixed.word - 1) - 1
        ).astype(np.int64)
        expected = run_of(fixed, e, valid=valid)
    else:
        expected = run_of(block, e, valid=valid)
    found, status = driver.replay(program, arithmetic, e, valid)
    allowed = {"double": 1e-12 * block.raw_limit, "float": np.full(4, 1e-3 * CURRENT)}.get(
        arithmetic, 0
    )
    assert (np.abs(found - expected.currents).max(axis=0) <= allowed).all()
    assert (status == expected.status).mean() >= (0.999 if arithmetic == "float" else 1)
    assert ((status & LIMITED) > 0).any()


@compiler
@pytest.mark.parametrize("blocks", ["axes", "tilt-translate"], indirect=True)
@pytest.mark.parametrize("arithmetic", ["double", "fixed32"])
def test_self_test_passes_and_finds_a_wrong_section(blocks, arithmetic, tmp_path):
    files = generate(blocks[0], arithmetic)
    assert (
        "A_zeta: notch, zero frequency 210 Hz" in files["rig.c"]
        or "translate_x: notch" in files["rig.c"]
    )
    row = next(line for line in files["rig.c"].splitlines() if "low-pass" in line)
    number = row.strip(" {").split(",")[0]
    wrong = (
        str(int(number) * 1.001 // 1).removesuffix(".0")
        if "fixed" in arithmetic
        else f"{float(number) * 1.001!r}"
    )
    for expected, change in ((0, number), (1, wrong)):
        for name, text in files.items():
            changed = text.replace(row, row.replace(number, change, 1)) if name == "rig.c" else text
            (tmp_path / name).write_text(changed, encoding="utf-8")
        target = tmp_path / f"test{expected}"
        driver.build(
            driver.compilers()[0],
            [str(tmp_path / "rig.c"), str(tmp_path / "rig_test.c"), "-o", str(target)],
        )
        assert (
            subprocess.run([str(target)], capture_output=True, check=False).returncode == expected
        )


@compiler
@pytest.mark.parametrize("blocks", ["axes", "tilt-translate"], indirect=True)
@pytest.mark.parametrize(
    ("arithmetic", "digits"), [("double", 1e-12), ("float", 1e-5), ("fixed32", 1e-6)]
)
def test_law_read_back_and_transfer(blocks, arithmetic, digits):
    """What verification would see is the law; a transfer continues with the current given."""
    block = blocks[0]
    code = CompiledBlock(block, arithmetic, driver.compilers()[0])
    law = read_law(code)
    scale = np.concatenate([block.bound, block.error_limit])
    for found, exact in (
        (law.A - block.system.A, law.A),
        (law.B - block.system.B, law.B),
        (law.D - block.system.D, law.D),
    ):
        rows = block.raw_limit if found is not None and len(found) == 4 else block.bound
        columns = scale[: block.n_states] if found.shape[1] == block.n_states else block.error_limit
        assert np.abs(found * columns / rows[:, None]).max() <= digits * max(
            1, np.abs(exact * columns / rows[:, None]).max()
        )
    if block.transfers:
        code.track(np.full(4, 1e-6), np.array([0.5, -0.25, 0.1, 0.0]))
        assert code.step(np.full(4, 1e-6)) == pytest.approx([0.5, -0.25, 0.1, 0.0], abs=2e-3)


@pytest.mark.parametrize("coordinates", ["axes", "tilt-translate"])
@pytest.mark.parametrize(("word", "error"), [(32, 0.5e-3), (16, 1e-5)])
def test_6_rounding_is_predicted(coordinates, word, error):
    """Noise within 12 % of its prediction, and the bound holds; compared is the law of the rounded
    numbers.
    """
    block, _ = both(coordinates, error)
    fixed = in_words(block, word)
    counts = np.rint(
        np.random.default_rng(2).uniform(-0.01, 0.01, (1200, 4)) * 2**fixed.signal_bits
    ).astype(np.int64)
    run = run_of(fixed, counts)
    assert not run.status.any()
    exact = run_of(quantised(fixed), counts * block.error_limit / 2**fixed.signal_bits)
    off = run.currents * block.current_limit / 2.0**fixed.signal_bits - exact.currents
    assert np.sqrt((off**2).mean(axis=0)) == pytest.approx(fixed.noise, rel=0.12)
    assert (np.abs(off).max(axis=0) <= fixed.error).all()


def quantised(fixed):
    """The block with the rounded coefficients: as exact arithmetic would run the code's numbers."""
    block = fixed.block
    tables = fixed.sections * np.exp2(-fixed.section_bits)[:, :, None]
    at = dict(enumerate(block.signals[: len(block.into)] if block.mixes else block.error_limit))
    i = 0
    stages = []
    into = (
        fixed.into
        * np.exp2(-fixed.into_bits)[:, None]
        * np.array(list(at.values()))[:, None]
        / block.error_limit
    )
    for k, stage in enumerate(block.stages):
        size, (x1, x2) = (
            block.signals[len(block.into) + k],
            np.append(block.bound[i : i + stage.order], 1.0)[:2],
        )
        v, t = at[stage.channel], tables[k]
        # c and k are one in the block: the states' units are chosen so
        c, k12 = t[0, 1] * size / x1, t[1, 2] * x1 / x2 if stage.order > 1 else 1.0
        d = t[0, 0] * size / v
        b1 = t[1, 0] * x1 / v * c
        b2 = t[2, 0] * x2 / v * c * k12
        stages.append(replace(stage, coefficients=(d, b1, b2, -t[1, 1], -t[2, 1] * x2 / x1 * k12)))
        at[stage.channel], i = size, i + stage.order
    out = (
        fixed.output
        * np.exp2(-fixed.output_bits)[:, None]
        * block.current_limit[:, None]
        / np.array(list(at.values()))
    )
    return replace(block, into=into, out=out, stages=tuple(stages))


def test_an_integrator_loses_nothing_in_sixteen_bits():
    """Thousands of samples of one count: the integral is all there, whatever the shifts cut off."""
    slow = PidSettings(channels=(Channel(MACHINE.axes, 2e3, (Section("pid", 0.5),)),))
    block, _ = both(bank=slow, error=1e-4)
    fixed = in_words(block, 16)
    count = 4000
    run = run_of(fixed, np.ones((count, 4), np.int64))
    step = 1e-4 / 2**14 * 2e3  # A
    assert run.currents[-1] * CURRENT / 2**14 == pytest.approx(
        np.full(4, step * (1 + count * DT / 0.5)), rel=0.02, abs=CURRENT / 2**14
    )


def louder(bank):
    return replace(bank, channels=(replace(bank.channels[0], gain=21e3), bank.channels[1]))


@compiler
@pytest.mark.parametrize("arithmetic", ["float", "fixed32", "fixed16"])
def test_gains_between_mixings_have_no_states(arithmetic, tmp_path):
    bank = PidSettings(gain=(2e4,), coordinates="tilt-translate", tilt_gain=1.5)
    block, _ = both(bank=bank, error=2e-4)
    assert block.n_states == 0
    for name, text in generate(block, arithmetic).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    driver.build(
        driver.compilers()[0],
        [str(tmp_path / "rig.c"), str(tmp_path / "rig_test.c"), "-o", str(tmp_path / "test")],
    )
    assert (
        subprocess.run([str(tmp_path / "test")], capture_output=True, check=False).returncode == 0
    )


@pytest.mark.parametrize("gain", [0.0, 1.0])
def test_sections_that_do_nothing_or_cannot_be_seen(gain):
    """Zeros on the poles, and a chain that ends in zero: modal form and cascade run all the
    same.
    """
    idle = replace(NOTCH, zero_frequency=900.0, pole_frequency=900.0, zero_damping=0.3)
    last = Section("sos", numerator=(gain,), denominator=(1.0, 500.0))
    block, modal = both(
        bank=PidSettings(
            channels=(Channel(MACHINE.axes, 2e4, (replace(PID, integral_time=None), idle, last)),)
        )
    )
    e = np.random.default_rng(4).uniform(-1e-5, 1e-5, (200, 4))
    assert np.abs(run_of(block, e).currents - run_of(modal, e).currents).max() < 1e-12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda bank: None,
            "a cascade needs a bank of filters, and this controller is not one; design one",
        ),
        (lambda bank: replace(bank, channels=bank.channels[::-1]), None),
        (louder, "not the one that its filters give on this machine"),
    ],
)
def test_only_the_filters_of_the_controller_itself(change, message, tmp_path):
    bank = settings()
    given = Synthesis(pid_controller(bank, MACHINE), filters=change(bank))
    target = C(form="cascade", force=True, error_limit=1e-3, current_limit=4.0, rate=1e4)
    if message is None:
        assert export(given, tmp_path, to=target).paths
        return
    with pytest.raises(InvalidInput, match=message):
        export(given, tmp_path / "out", to=target)
    assert not (tmp_path / "out").exists()


def test_refusals_say_what_to_do():
    bank = settings("tilt-translate")
    source = pid_controller(bank, MACHINE)
    with pytest.raises(InvalidInput, match=r"machine is not known, .*; name its file"):
        build_cascade(deploy(source, DT, force=True), bank, None, "rig", 1e-3, 4.0)
    with pytest.raises(InvalidInput, match="use --sampling tustin, or the modal form"):
        build_cascade(deploy(source, DT, force=True, method="zoh"), bank, MACHINE, "rig", 1e-3, 4.0)
    block, _ = both()
    with pytest.raises(
        InvalidInput, match=r"rounding noise of u_A_\w+ .* lower error_limit to (\S+) m"
    ) as refused:
        in_words(block, 16)
    narrow = float(str(refused.value).partition("error_limit to ")[2].partition(" m")[0])
    assert in_words(both(error=narrow)[0], 16).noise.max() <= 1e-3 * CURRENT
    with pytest.raises(
        InvalidInput, match="form is given, but must be left out with the target st; it goes with c"
    ):
        export(Synthesis(source, filters=bank), "out", to="st", form="cascade")
    with pytest.raises(InvalidInput, match="form is 'ladder', but must be one of modal, cascade"):
        C(form="ladder")


def test_bound_on_floating_point():
    """Single precision stays within the bound stated, which is of its order."""
    block = both()[0].single()
    e = np.random.default_rng(3).uniform(-2e-6, 2e-6, (1000, 4)).astype(np.float32).astype(float)
    single = replace(
        block,
        stages=tuple(
            replace(s, coefficients=tuple(float(np.float32(c)) for c in s.coefficients))
            for s in block.stages
        ),
        out=block.out.astype(np.float32).astype(float),
    )
    off = np.abs(run_of(single, e).currents - run_of(block, e).currents).max(axis=0)
    share = 2e-6 / block.error_limit.max()
    assert (off <= share * floating_error(block, 24, 1000)).all()
    assert (off > 1e-4 * share * floating_error(block, 24, 1000)).all()


TURNED = replace(
    MACHINE,
    sensors=tuple(
        replace(s, angle=b.angle + turn)
        for s, b, turn in zip(MACHINE.sensors, MACHINE.bearings, (0.4, -1.1), strict=True)
    ),
)


@compiler
@pytest.mark.parametrize("coordinates", ["axes", "tilt-translate"])
def test_turned_sensors_are_turned_back_in_the_code(coordinates):
    """The compiled sections hold the rig as the law does, and as with sensors in the magnets'
    axes.
    """
    bank, runs = replace(MACHINE.controller, coordinates=coordinates, tilt_gain=1.1), []
    push = Scenario("push", 0.02, (Pulse("f_A_zeta", 50.0, 0.004, 0.002),))
    for machine in (MACHINE, TURNED):
        law = pid_controller(bank, machine)
        block = build_cascade(
            deploy(law, DT, DT, force=True), bank, machine, "rig", 0.5e-3, CURRENT
        )
        code = CompiledBlock(block, "double", driver.compilers()[0])
        quiet = replace(machine, sensors=tuple(replace(s, noise=0.0) for s in machine.sensors))
        runs.append(virtual_rig.run(quiet, code, push).record)
        assert runs[-1]["u_A_eta"] == pytest.approx(
            virtual_rig.run(quiet, law, push).record["u_A_eta"], abs=1e-9
        )
    for axis in MACHINE.axes:
        assert runs[1][f"u_{axis}"] == pytest.approx(
            runs[0][f"u_{axis}"], abs=1e-6 * np.abs(runs[0][f"u_{axis}"]).max()
        )
    assert (
        np.abs(runs[1]["y_A_zeta"] - runs[0]["y_A_zeta"]).max()
        > 0.1 * np.abs(runs[0]["y_A_zeta"]).max()
    )


def test_a_cascade_of_turned_sensors_needs_the_machine():
    bank = settings()
    source = pid_controller(bank, TURNED)
    with pytest.raises(
        InvalidInput,
        match=r"would not run; name its file, --machine my.toml, or use the modal form",
    ):
        build_cascade(deploy(source, DT, DT, force=True), bank, None, "rig", 1e-3, CURRENT)


@compiler
def test_four_channels_of_three_bearings_run_as_code():
    """Between the mixings there are fewer channels than axes."""
    train = load_machine("three-bearing-train")
    bank = replace(train.controller, coordinates="tilt-translate", gain=(20e3,))
    law, dt = pid_controller(bank, train), 5e-5
    block = build_cascade(deploy(law, dt, dt, force=True), bank, train, "rig", 0.5e-3, 10.0)
    assert block.into.shape == (4, 6) and block.out.shape == (6, 4)
    code = CompiledBlock(block, "double", driver.compilers()[0])
    push = Scenario("push", 0.008, (Pulse("f_MID_zeta", 50.0, 0.002, 0.002),))
    found, expected = (
        virtual_rig.run(train, item, push).record["u_MID_zeta"] for item in (code, law)
    )
    assert np.abs(expected).max() > 0.1 and found == pytest.approx(expected, abs=1e-9)


def stepped(block, e, x, errors=None):
    """The signals, currents and steps of (1), with errors added to the signals as they are made."""
    errors = np.zeros(len(block.signals)) if errors is None else errors
    v = block.into @ e + errors[: len(block.into)]
    signals, step, i = [*v], np.zeros(block.n_states), 0
    for k, stage in enumerate(block.stages):
        d, b1, b2, a1, a2 = stage.coefficients
        y = d * v[stage.channel] + x[i] + errors[len(block.into) + k]
        step[i] = b1 * v[stage.channel] - a1 * x[i]
        if stage.order == 2:
            step[i] += x[i + 1]
            step[i + 1] = b2 * v[stage.channel] - a2 * x[i]
        v[stage.channel], i = y, i + stage.order
        signals.append(y)
    return np.array(signals), block.out @ v, step


def law_of(respond, states, errors):
    """A - I, B, C and D of a step, column by column."""
    none = np.zeros(errors), np.zeros(states)
    by_e = [respond(unit, none[1]) for unit in np.eye(errors)]
    by_x = [respond(none[0], unit) for unit in np.eye(states)]
    (D, B), (C, A) = (
        map(np.transpose, map(np.array, zip(*by, strict=True))) for by in (by_e, by_x)
    )
    return A, B, C, D


def test_1_and_3_rows_of_signals_and_of_their_errors(blocks):
    """The matrices of bounds and noise, beside single steps; and the law of the block itself."""
    block, rng = blocks[0], np.random.default_rng(0)
    e, x, errors = (rng.normal(size=n) for n in (4, block.n_states, len(block.signals)))
    signals, currents, step = stepped(block, e, x)
    rows = _signal_rows(block, block.into, block.stages)
    assert rows @ np.concatenate([e, x]) == pytest.approx(signals)
    _, off, moved = stepped(block, e, x, errors)
    B, D = _from_signals(block)
    assert D @ errors == pytest.approx(off - currents, abs=1e-9 * np.abs(off).max())
    assert B @ errors == pytest.approx(moved - step, abs=1e-12)
    for found, expected in zip(block_law(block), law_of(block.respond, len(x), 4), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_4_the_law_of_whole_numbers_and_its_distance(blocks):
    fixed = in_words(blocks[0], 16, 0.1)
    law = law_of(quantised(fixed).respond, fixed.block.n_states, 4)
    exact, rounded = sampled_response(*block_law(fixed.block)), sampled_response(*law)
    found = sampled_response(*_running_law(fixed))
    assert response_error(rounded, found) < 1e-9
    assert fixed.gain_error > 1e-6
    assert fixed.gain_error == pytest.approx(response_error(exact, rounded, 0.1), rel=1e-6)


def test_5_energy_of_errors_that_are_made_good_a_sample_later():
    """An error of one unit at a channel's input, taken back at the next sample: the sum of squares
    of what it does to the currents, sample by sample.
    """
    block, _ = both("tilt-translate")
    B, D = _from_signals(block)
    count = len(block.into)
    x, squares = np.zeros((block.n_states, count)), np.zeros(len(block.outputs))
    for k in range(8192):
        u = np.diag(block.signals[:count]) * (1.0, -1.0)[k] if k < 2 else np.zeros((count, count))
        squares += ((block.C @ x + D[:, :count] @ u) ** 2).sum(axis=1)
        x = x + block.increment @ x + B[:, :count] @ u
    nothing = np.zeros(block.n_states)
    signals = np.zeros(len(block.signals))
    energy = _gains(block, signals, nothing, nothing, 8192, block.signals[:count])[2]
    assert energy == pytest.approx(squares, rel=1e-6)
