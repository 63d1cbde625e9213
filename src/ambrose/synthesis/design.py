"""A controller by a method: designed on the reduced plant, then certified on the full one."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from typing import Any

from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import NumericalFailure, invalid
from ambrose.core.presentation import to_plain
from ambrose.judge.as_it_runs import certify_as_it_runs
from ambrose.judge.certificate import certify_envelope
from ambrose.judge.envelope import envelope_of
from ambrose.judge.result import Provenance, Status, Synthesis
from ambrose.machine.file.toml import machine_hash
from ambrose.machine.machine import require_magnets
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.options import choose, settings
from ambrose.registry import registered
from ambrose.synthesis.explanation import explained, why_none
from ambrose.synthesis.methods.choice import methods
from ambrose.synthesis.methods.method import Lowered, Method
from ambrose.synthesis.order_selection import reduce_order

Progress = Callable[[str], None]


def methods_for(plant: Plant) -> tuple[str, ...]:
    """What the machine file allows: "tuned" always, "pid" with [controller], "hinf" with [weights],
    mu with [[tolerance]], too.

    The methods of the annexes, such as "lpv", are asked for by name: that is one controller for all
    speeds or pressures instead of one for the plant's.
    """
    named = registered("method")
    return tuple(
        name for name, kind in methods().items() if name not in named and kind.suits(plant)
    )


@names_wrong_types
def design(
    plant: Plant,
    method: Method | str = "tuned",
    *,
    progress: Progress = lambda text: None,
    **options: Any,
) -> Synthesis:
    """One controller for a full plant.

    method: one of the methods with its options, or the name of one, its options then by name:
    ``Tuned`` (to the requirements themselves, at all operating points of the plant's machine and
    with the worst members of the tolerances around each; the others know the plant's point alone),
    ``Pid`` (the machine's reference controller), ``Hinf`` (H-infinity for the nominal plant),
    ``Mu`` (D-K iteration over the machine's tolerances), ``Polish`` (the mu controller at half its
    order, refined for the worst case), ``Lpv`` (scheduled over speed, pressure or both).

    Where a rate is known (the method's, else the machine file's) the delay of the sampled loop is
    in the design model (not in that of "pid"). The certificate's margins gain
    "full_spectral_abscissa" and "full_sensitivity_peak", recomputed on ``plant``, with a rate also
    "sampled_spectral_abscissa" and "sampled_sensitivity_peak" of the loop as it runs; a controller
    that does not hold one of the two has the status "unstable". The certificate's ``envelope``
    tells the stability at every operating point of the machine, and ``Synthesis.verdict`` where
    "verified" holds. Raises InvalidInput for an unknown method, an option that it does not have, or
    a machine file that lacks what it needs.
    """
    chosen = choose(methods(), "method", method, options)
    if not isinstance(plant, Plant):
        raise invalid(
            "plant", type(plant).__name__, "a Plant", "assemble(machine, point) gives one"
        )
    require_magnets(plant.machine)
    timing = chosen.timing(plant.machine)
    chosen = chosen.on(plant.machine)
    try:
        result = chosen.design(plant, progress)
    except NumericalFailure as error:
        if why := why_none(plant, timing):
            raise NumericalFailure(f"{error}; {why}") from error
        raise
    modes = getattr(chosen, "bending_modes", None) or 0
    modes = int(result.certificate.margins.get("bending_modes", modes))
    if isinstance(chosen, Lowered) and chosen.loss is not None and timing is not None:
        progress("lowering the order")
        result = reduce_order(plant, result, chosen.loss, timing, modes, progress)
    result = certify_as_it_runs(plant, result, timing)
    result = certify_envelope(envelope_of(plant), result, timing)
    envelope = getattr(chosen, "envelope", None)
    result = explained(plant, result, timing, modes, envelope=envelope)
    return replace(result, provenance=provenance(plant, chosen))


def another_point(plant: Plant, method: Method) -> str:
    """Which operating point's design holds all points of the machine, or that none does.

    For a method of one point, whose controller leaves a light mode where that point has it.
    """
    machine = plant.machine
    for point in machine.operation.envelope:
        if point == plant.point:
            continue
        with suppress(NumericalFailure):
            made = design(assemble(machine, point), method)
            if made.status is Status.VERIFIED and not made.lost:
                return f'designed for "{point.label}" it holds all points: --point "{point.label}"'
    return (
        "no point's design by this method holds all: their light modes are not at one frequency; "
        "method tuned designs for all points"
    )


def provenance(plant: Plant, method: Method) -> Provenance:
    """Machine and settings of a design: its key decides which controller comes out.

    The settings name every option of every method, those that this one does not have at their
    defaults, so that files of before compare with it.
    """
    machine = plant.machine
    content = {
        "method": method.name,
        **settings(methods(), method.on(machine)),
        "point": asdict(plant.point),
        "plant_states": plant.system.n_states,
    }
    return Provenance(
        machine=machine.name, machine_hash=machine_hash(machine), settings=to_plain(content)
    )
