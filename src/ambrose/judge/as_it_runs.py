"""What a finished controller is as it runs: sampled, late; and without poles that its sample rate
cannot show.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ambrose.core.lft import GeneralizedPlant
from ambrose.core.realisation.modal_form import modal_form
from ambrose.core.statespace import StateSpace, spectral_abscissa
from ambrose.judge.certificate import certify, generalized_certificate
from ambrose.judge.result import Status, Synthesis
from ambrose.law.law import LawLike, law_of
from ambrose.law.timing import Timing
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant

_MARGINAL = 1e-9  # of the largest pole; integrators are meant to be on the boundary


def certify_as_it_runs(plant: Plant, result: Synthesis, timing: Timing | None) -> Synthesis:
    """The synthesis with the margins of its sampled loop on ``plant``; "unstable" where that is.
    None: unchanged.

    A controller that is unstable by itself gets a note: it may hold its loop, but runs away
    whenever the loop is open. So does one with a pole beyond half the rate, which export refuses.
    """
    if timing is None:
        return result
    margins = sampled_margins(plant, result, timing)
    stable = result.certificate.stable and margins["sampled_spectral_abscissa"] < 0
    old = result.certificate
    certificate = replace(
        old, stable=stable, margins={**old.margins, **margins}, plant=f"{old.plant}; {timing}"
    )
    notes, pole = result.notes, spectral_abscissa(result.controller)
    if pole > _MARGINAL * max(old.fastest_pole, 1.0):
        away = (
            f"the controller itself is unstable (a pole at {pole:+.4g} rad/s): it runs away "
            "whenever the loop is open"
        )
        notes += (
            f"{away}, and is not exported unless that is wanted (force); another control weight "
            "may give a stable one",
        )
    if result.controller.dt is None and old.fastest_pole * timing.sample_time > np.pi:
        need = (
            f"sample at {old.fastest_pole / np.pi:.4g} Hz or more, or roll it off below "
            f"{np.pi * timing.rate:.4g} rad/s"
        )
        notes += (
            f"a pole at {old.fastest_pole:.4g} rad/s is beyond half the sample rate, and export "
            f"refuses it; {need}",
        )
    return replace(
        result,
        certificate=certificate,
        notes=notes,
        status=result.status if stable else Status.UNSTABLE,
    )


def sampled_margins(plant: Plant, law: LawLike, timing: Timing | None) -> dict[str, float]:
    """ "sampled_spectral_abscissa" [rad/s] and "sampled_sensitivity_peak" [-] of the loop as it
    runs; empty without a timing.

    Of a schedule the worst over its grid, frozen.
    """
    if timing is None:
        return {}
    law = law_of(law)
    margins = []
    for point in law.points(plant.point):
        place = plant if point == plant.point else assemble(plant.machine, point)
        margins.append(certify(place, timing.in_loop(law.at(point)), margins=False))
    return {
        "sampled_spectral_abscissa": max(item.spectral_abscissa for item in margins),
        "sampled_sensitivity_peak": max(item.closed_loop_norm for item in margins),
    }


def without_fast_poles(result: Synthesis, timing: Timing, problem: GeneralizedPlant) -> Synthesis:
    """The synthesis with its controller's stable poles beyond half the sample rate replaced by
    their static gain.

    Sampled code cannot show them, and export refuses them. problem: the design problem without
    uncertainty, on which what is left is certified anew; the norm that the method reached holds no
    longer (NaN). Without such poles: unchanged.
    """
    limit, form = np.pi / timing.sample_time, modal_form(result.controller)
    K, fast = form.system, np.zeros(form.system.n_states, bool)
    for start, size in zip(form.starts, form.sizes, strict=True):
        block = slice(start, start + size)
        values = np.linalg.eigvals(K.A[block, block])
        fast[block] = bool((np.abs(values) > limit).any() and (values.real < 0).all())
    if not fast.any():
        return result
    D = K.D - K.C[:, fast] @ np.linalg.solve(K.A[np.ix_(fast, fast)], K.B[fast])
    slow = ~fast
    controller = StateSpace(
        K.A[np.ix_(slow, slow)], K.B[slow], K.C[:, slow], D, K.inputs, K.outputs
    )
    certificate = generalized_certificate(problem, controller)
    note = (
        f"{int(fast.sum())} states beyond half the sample rate ({limit:.4g} rad/s) replaced by "
        "their static gain"
    )
    status = Status.VERIFIED if certificate.stable else Status.UNSTABLE
    notes = (*result.notes, note)
    return replace(
        result,
        controller=controller,
        certificate=certificate,
        status=status,
        gamma=np.nan,
        notes=notes,
    )
