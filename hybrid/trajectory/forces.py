"""Contact forces of a run: the force on a contact at rest, the impulse of an impact.

Both are multipliers of ``W grad_q(gap)`` (:mod:`hybrid.lowering.contact`). The force keeps the
gap's acceleration at zero; the impulse changes the gap speed according to the restitution.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ..automaton.spec import ContactSpec, Spec
from ..errors import OptionError
from ..lowering import Scene, scene_of
from .arcs import Table

if TYPE_CHECKING:
    from ..automaton.shapes import Integers, Numbers
    from ..lowering.mode import ModeGraph
    from ..lowering.python import Program
    from .trajectory import Solution


def force(run: Solution, contact: str, t: Any) -> np.ndarray:
    """The force on a contact: see :meth:`hybrid.Trajectory.force`."""
    known = [each.name for each in run.spec.transitions if isinstance(each, ContactSpec)]
    scene = scene_known(run.spec, run.parameters, run.hindsight and run.hindsight.scene)
    if contact not in known:
        there = ", ".join(known) or "none"
        raise OptionError(f"{run.spec.model} has no contact {contact!r}; there are: {there}")
    times = np.asarray(t, dtype=float)
    states, flat = run.states(times).reshape(-1, run.spec.dimension), times.reshape(-1)
    found, rows = np.zeros(flat.shape), zip(flat.tolist(), states.tolist(), strict=True)
    for place, (when, x) in enumerate(rows):
        number = run.place(when)
        mode, held = run.parts[number].flown_in
        if contact in held:
            here = run.hindsight.at(number, when) if run.spec.lags else scene.at(when)
            graph = here.code.mode(mode)
            bears = graph.program(("force", contact), partial(_forces, graph, contact))
            found[place] = here.bind(bears, here.numbers(mode, held))(when, x)[0]
    found[np.isin(flat, _struck(run, contact))] = np.nan
    return found.reshape(times.shape)


def _forces(graph: ModeGraph, contact: str) -> list[int]:
    return [graph.forces[contact]]


def _impulse(graph: ModeGraph, contact: str) -> list[int]:
    return [graph.impulse(contact)]


def _struck(run: Solution, contact: str) -> Numbers:
    """Times of the impacts of a contact, except those at accumulation points."""
    times = run.jumps.t[run.jumps.edge == contact]
    return times[~np.isin(times, [point.t for point in run.zeno])]


def impulses(
    spec: Spec, parameters: Mapping[str, Any], scene: Scene | None, table: Table
) -> Numbers:
    """The impulses of jumps: see :attr:`Jumps.impulse`."""
    found = np.full(len(table.t), np.nan)
    if not len(found):
        return found
    scene = scene_known(spec, parameters, scene)
    for contact in sorted(scene.contacts & set(table.edge)):
        mode, rows = scene.code.contact_spec(contact).source, np.flatnonzero(table.edge == contact)
        graph = scene.code.mode(mode)
        program = graph.program(("impulse", contact), partial(_impulse, graph, contact))
        if spec.lags and scene.code.looks_back(graph.graph, graph.impulse(contact)):
            raise OptionError(
                f"{spec.model}: the impulse of {contact} depends on the past, and cannot be "
                "computed from the table of jumps; run(t) has the states on both sides"
            )
        if scene.samples:
            turn = graph.program(("turned", contact), partial(_turned, graph, contact))
            found[rows] = _on_pieces(scene, mode, (program, turn), table, rows)
            continue
        gives = scene.bind(program, scene.numbers(mode, ()))
        columns = table.t[rows].tolist(), table.before[rows].tolist()
        found[rows] = [gives(*row)[0] for row in zip(*columns, strict=True)]
    return found


def _turned(graph: ModeGraph, contact: str) -> list[int]:
    return [*graph.push(contact), graph.contact(contact).weight]


def _on_pieces(
    scene: Scene, mode: str, programs: tuple[Program, Program], table: Table, rows: Integers
) -> list[float]:
    """The impulses of impacts of a model with signals, in the order of ``rows``.

    At a knot of a signal, the impact was computed with the piece before or after it. The impulse
    that agrees with the change of state is chosen.
    """
    found, times = [], table.t[rows].tolist()
    for k, t, behind in zip(rows.tolist(), times, scene.through_time(times), strict=True):
        before, pieces, own = table.before[k].tolist(), [behind], []
        if scene.span(t)[0] == t:
            pieces.append(scene.at(float(np.nextafter(t, -np.inf))))
        for here in pieces:
            numbers = here.numbers(mode, ())
            (gives,), (*push, weight) = (here.bind(p, numbers)(t, before) for p in programs)
            seen = (table.after[k] - table.before[k]) @ push / np.dot(push, push) / weight
            own.append((abs(gives - seen), gives))
        found.append(min(own)[1])
    return found


def scene_known(spec: Spec, parameters: Mapping[str, Any], scene: Scene | None) -> Scene:
    """The model of a run with its parameters: ``scene``, unless it is None.

    Raises
    ------
    OptionError
        If the run was loaded without its model, or depends on a past that the file does not
        contain.
    """
    if scene is not None:
        return scene
    if spec.cls is None or spec.lags:
        why = "looks at the past, which" if spec.lags else "is needed, which"
        raise OptionError(
            f"{spec.model}: the model {why} this file does not contain: ask before the run is saved"
            + ("" if spec.lags else f", or load it with its model, hy.load(path, {spec.model})")
        )
    return scene_of(spec.cls(**parameters))
