"""Proofs of complete chattering before a run, by interval arithmetic, never by sampling.

``question.py``: the checked question, and the functions that it needs, read from the trace.
``restitution.py``, ``beside.py``: conditions of both proofs on impacts and on other states.
``setting.py``, ``theorem.py``: Theorem 1 of Akhmet and Çağ, with (C2). ``relative.py``: the lemma
without (C2), in coordinates relative to the contact. ``result.py``: the answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .result import Certificate

__all__ = ["Certificate", "certify"]


def certify(
    model: Any,
    box: Mapping[str, tuple[float, float]],
    mode: str | None = None,
    contact: str | None = None,
) -> Certificate:
    """Prove, from the right-hand side alone, that a contact's impacts accumulate.

    If the box bounds position and velocity, Theorem 1 of Akhmet and Çağ is used: a fixed obstacle,
    and forces that depend on position and velocity. If it bounds ``gap`` and ``speed`` (coordinates
    relative to the contact), the lemma without (C2) is used: it allows moving obstacles, and forces
    that depend on time or are not even in the velocity.

    Parameters
    ----------
    model : Automaton
    box : mapping of str to (low, high)
        Theorem 1: the position from the obstacle to the largest height, and the velocity ``(-c,
        c)``. Lemma: ``"gap": (0, y)``, ``"speed": (0, w)`` (an absolute value), and all else that
        the gap's acceleration depends on: ``"t"``, other states. For both, bounds of states that
        might end the motion. Elements of an array are named ``"q[0]"``.
    mode, contact : str, optional
        Which contact; needed if there are several.

    Returns
    -------
    Certificate
        ``verdict`` is ``"certified"`` (proved), ``"refuted"`` (a condition is proved to fail on
        this box; the motion may chatter nevertheless) or ``"undecided"``.

    Raises
    ------
    OptionError
        If the question cannot be asked; the message gives the reason and the remedy.

    Examples
    --------
    >>> proof = hy.certify(BouncingBall(), {"x": (0.0, 1.0), "v": (-5.0, 5.0)})
    >>> proof.verdict
    'certified'
    """
    from ..automaton.base import require_no_discrete
    from ..bounds.interval import require_flint
    from ..errors import OptionError

    lags = getattr(model, "spec", None) and model.spec.lags
    if lags:
        raise OptionError(
            f"{model.spec.model} looks into the past (lag {lags[0].name}): a proof before a run "
            "knows no past; simulate it, and ask the accumulations of the run for their proofs"
        )
    clocks = getattr(model, "spec", None) and model.spec.clocks
    if clocks:
        raise OptionError(
            f"{model.spec.model}, edge {clocks[0].name}, fires at given times: a proof before a "
            "run has no clock; simulate it, and ask the accumulations of the run for their proofs"
        )
    require_no_discrete(model, "a proof before a run", "ask the accumulations of a run for theirs")
    require_flint()
    from .question import ask
    from .relative import by_lemma
    from .theorem import by_theorem

    question = ask(model, box, mode, contact)
    return by_lemma(question) if question.relative else by_theorem(question)
