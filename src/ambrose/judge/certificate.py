"""The certificate: what is recomputed for a finished controller on the plant it was made for,
before it is returned.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.checks import InvalidInput, UnstableSystem, invalid, named_failure
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.norms import hinf_norm
from ambrose.core.sampling import c2d
from ambrose.core.statespace import (
    ControllerLike,
    StateSpace,
    as_statespace,
    feedback,
    match_signals,
    poles,
    select,
    series,
    spectral_abscissa,
    static_gain,
)
from ambrose.judge.result import Certificate, Status, Synthesis
from ambrose.judge.stability import judge_stability, loop_abscissa
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import match_controller
from ambrose.law.timing import Timing
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant

_SAME = 1e-5  # relative; margins recomputed elsewhere differ by rounding


@named_failure("the certificate")
def certify(plant: Plant | StateSpace, controller: LawLike, margins: bool = True) -> Certificate:
    """Stability, output sensitivity and margins of the loop of core/lft.py, recomputed from plant
    and controller.

    plant: a Plant, or a StateSpace from currents u [A] to displacements y [m] (its signals matched
    to the controller's by place). A sampled controller closes the loop around the plant sampled
    with a zero-order hold; everything then holds at the samples. ``closed_loop_norm`` is the
    H-infinity norm of S_o. The margins:

    - ``sensitivity_peak``, ``complementary_peak`` [-]: H-infinity norms of S_o and T_o;
    - ``disk_gain_margin``, ``disk_gain_reduction`` [-], ``disk_phase_margin_rad``: what every axis
      at once may change, each by its own factor, the better of the bounds M_S/(M_S-1), M_S/(M_S+1),
      2 asin(1/2M_S) and 1+1/M_T, 1-1/M_T, 2 asin(1/2M_T) (Lehtomaki, Sandell & Athans 1981).
      Margins of single axes: judge/margins.py. Without ``margins`` they are left out, and
      the norm of T_o, which takes as long as that of S_o, is not computed.

    An unstable loop is a verdict: stable False, closed_loop_norm inf, no margins. Raises
    InvalidInput when sizes do not fit.
    """
    loop, law = _open_loop(plant, controller)
    identity = np.eye(len(loop.outputs))
    abscissa = loop_abscissa(loop)
    fastest = fastest_pole(law)
    label = _label(plant)
    if not abscissa < 0:
        return Certificate(False, abscissa, float("inf"), fastest, {}, label)
    loop = continuous_equivalent(loop)  # margins and norms do not change under the bilinear map
    peak = float(hinf_norm(feedback(static_gain(identity), loop)).value)
    figures = {"sensitivity_peak": peak}
    if margins:
        complementary = float(hinf_norm(feedback(loop, static_gain(identity))).value)
        figures |= {"complementary_peak": complementary, **disk_margins(peak, complementary)}
    return Certificate(True, abscissa, peak, fastest, figures, label)


def certify_envelope(
    plants: Sequence[Plant], result: Synthesis, timing: Timing | None
) -> Synthesis:
    """The synthesis whose certificate tells the spectral abscissa at every one of the full
    ``plants``, as the loop runs.

    Plants that a schedule is not meant for are left out.
    """
    envelope = {
        plant.point.label: judge_stability(plant, result, timing).abscissa
        for plant in plants
        if result.covers(plant)
    }
    certificate = replace(result.certificate, envelope=envelope)
    return replace(result, certificate=certificate)


@named_failure("the certificate")
def generalized_certificate(plant: GeneralizedPlant, controller: ControllerLike) -> Certificate:
    """Stability and norm of z = F_l(P, K) w, recomputed from a generalized plant and its controller
    u = K y.

    controller: its signals matched to y and u by place. ``closed_loop_norm`` is the H-infinity norm
    from all w to all z; an unstable or marginal loop is a verdict: stable False, closed_loop_norm
    inf. Raises InvalidInput when sizes do not fit, NumericalFailure for an algebraic loop.
    """
    system = as_statespace(controller)
    loop = lft(plant, system)
    abscissa = spectral_abscissa(loop)
    norm = float("inf")
    if abscissa < 0:
        with contextlib.suppress(UnstableSystem):
            norm = hinf_norm(loop).value
    label = f"generalized plant with {plant.system.n_states} states"
    return Certificate(norm < np.inf, abscissa, norm, fastest_pole(system), {}, label)


def full_plant_margins(plant: Plant, law: LawLike) -> tuple[bool, dict[str, float], str]:
    """Whether a law holds a full plant, a schedule at every point of its grid; the margins that say
    so; on what.

    "full_spectral_abscissa" [rad/s] and "full_sensitivity_peak" [-], the worst over the grid, and
    "worst_speed" [rad/s] and "worst_pressure" [Pa], of what it is scheduled over, where that is.
    """
    law = law_of(law)
    along = law.scheduled_over
    if along is None or law.schedule is None:
        certificate = certify(plant, law, margins=False)
        margins = {
            "full_spectral_abscissa": certificate.spectral_abscissa,
            "full_sensitivity_peak": certificate.closed_loop_norm,
        }
        return certificate.stable, margins, certificate.plant
    machine, points = plant.machine, law.points(plant.point)
    results = [certify(assemble(machine, point), law.at(point), False) for point in points]
    worst = int(np.argmax([item.closed_loop_norm for item in results]))
    margins = {
        "full_spectral_abscissa": max(item.spectral_abscissa for item in results),
        "full_sensitivity_peak": results[worst].closed_loop_norm,
        **{
            f"worst_{one.name}": float(at)
            for one, at in zip(along.each, np.atleast_1d(along.of(points[worst])), strict=True)
        },
    }
    label = f"{machine.name}, full plant at {len(points)} of these {along.plural}"
    return all(item.stable for item in results), margins, label


def certify_on_full_plant(
    plant: Plant, result: Synthesis, margins: Mapping[str, float] | None = None
) -> Synthesis:
    """The synthesis with ``margins`` and those of ``full_plant_margins`` added; "unstable" where it
    does not hold ``plant``.
    """
    before = result.certificate
    holds, full, label = full_plant_margins(plant, result)
    stable = before.stable and holds
    margins = {**before.margins, **(margins or {}), **full}
    certificate = replace(before, stable=stable, margins=margins, plant=f"{before.plant}; {label}")
    return replace(
        result, certificate=certificate, status=result.status if stable else Status.UNSTABLE
    )


def contradiction(plant: Plant, result: Synthesis, sampled: Mapping[str, float]) -> str:
    """Which margin, recomputed on the full plant, is not what the certificate says; "" where all
    are.

    sampled: those of the loop as it runs, recomputed as well (``as_it_runs.sampled_margins``).
    """
    certificate = result.certificate
    margins = {
        "full_spectral_abscissa": certificate.spectral_abscissa,
        "full_sensitivity_peak": certificate.closed_loop_norm,
        **certificate.margins,
    }
    for name, value in {**full_plant_margins(plant, result)[1], **sampled}.items():
        said_of_it = margins.get(name, np.nan)
        if not (value == said_of_it or abs(value - said_of_it) <= _SAME * abs(value)):
            return f"{name} is {value:.6g}, but its certificate says {said_of_it:.6g}"
    return ""


def _open_loop(plant: Plant | StateSpace, controller: LawLike) -> tuple[StateSpace, StateSpace]:
    """Controller, then plant, as one system; and the controller."""
    open_plant, law = _loop_parts(plant, controller)
    return series(law, open_plant), law


def _loop_parts(plant: Plant | StateSpace, controller: LawLike) -> tuple[StateSpace, StateSpace]:
    """The plant from u to y (sampled like the controller), and the controller."""
    if isinstance(plant, Plant):
        system = select(plant.system, plant.named("u"), plant.named("y"))
        law = match_controller(controller, plant)
    else:
        system, fixed = as_statespace(plant), law_of(controller).fixed
        if fixed is None:
            raise InvalidInput(
                "a plant that is a system alone has no operating point; give the Plant, or the "
                "law at one point"
            )
        law = fixed
        if law.D.shape != system.D.shape[::-1] or system.D.shape[0] != system.D.shape[1]:
            raise invalid(
                "the controller's size (outputs, inputs)",
                law.D.shape,
                f"{system.D.shape[::-1]} and square",
                "select() the plant's currents and displacements",
            )
        errors, currents = (
            [f"{to}_{name.removeprefix(prefix)}" for name in names]
            for to, prefix, names in (
                ("err", "y_", system.outputs),
                ("u", "u_", system.inputs),
            )
        )
        law = match_signals(law, errors, currents)
    if law.dt is not None and system.dt is None:
        system = c2d(system, law.dt)
    if law.dt != system.dt and law.n_states:
        raise invalid(
            "the controller's sample time",
            law.dt,
            f"the plant's {system.dt}",
            "resample one of them",
        )
    return system, law


def _label(plant: Plant | StateSpace) -> str:
    if not isinstance(plant, Plant):
        return f"{plant.n_states} states"
    point = plant.point.label or f"{plant.point.speed:g} rad/s, {plant.point.seal_pressure:g} Pa"
    return f"{plant.machine.name}, {point}, {plant.system.n_states} states"


def disk_margins(sensitivity_peak: float, complementary_peak: float) -> dict[str, float]:
    """Gain and phase changes that all axes tolerate at once, from the peaks M_S, M_T >= 0 [-] of
    S_o and T_o.
    """
    s, t = sensitivity_peak, complementary_peak
    increase = [s / (s - 1) if s > 1 else np.inf, 1 + 1 / t if t > 0 else np.inf]
    reduction = [s / (s + 1), 1 - 1 / t if t > 1 else 0.0]
    phase = [2 * np.arcsin(min(1.0, 1 / (2 * m))) if m > 0 else np.pi for m in (s, t)]
    return {
        "disk_gain_margin": float(max(increase)),
        "disk_gain_reduction": float(min(reduction)),
        "disk_phase_margin_rad": float(max(phase)),
    }


def fastest_pole(controller: ControllerLike) -> float:
    """Largest modulus among the controller's poles [rad/s]; of a sampled one |ln z|/dt, pure delays
    (z = 0) left out.
    """
    system = as_statespace(controller)
    values = poles(system)
    if system.dt is not None:
        values = np.log(values[np.abs(values) > 1e-9].astype(complex)) / system.dt
    return float(np.abs(values).max(initial=0.0))


def continuous_equivalent(system: StateSpace) -> StateSpace:
    """A sampled system carried to continuous time by z = (1 + s)/(1 - s); a continuous one
    unchanged.

    Stability, norms, real gains and phases at which a loop closes on -1 are kept; frequencies are
    not. Raises InvalidInput for a pole at z = -1.
    """
    if system.dt is None:
        return system
    n = system.n_states
    E = system.A + np.eye(n)
    if n and np.linalg.cond(E) > 1 / np.finfo(float).eps:
        raise InvalidInput(
            "the sampled loop has a pole at z = -1 (an alternating signal); change the sample time"
        )
    A, B = np.linalg.solve(E, system.A - np.eye(n)), np.linalg.solve(E, system.B)
    C = np.linalg.solve(E.T, system.C.T).T
    return StateSpace(
        A, np.sqrt(2) * B, np.sqrt(2) * C, system.D - C @ system.B, system.inputs, system.outputs
    )
