"""Section 2: chattering cut off after ``[1/r]`` impacts, for smaller and smaller ``r``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import attrs
import numpy as np

from hybrid.errors import OptionError
from hybrid.simulation import simulate


@attrs.frozen(eq=False)
class Transient:
    """How much of chattering is left out when it is cut off, by parameter value.

    Attributes
    ----------
    parameter : str
    values : array
    impacts : array of int
        Impacts permitted, ``[1/r]``; -1 where no series was cut off.
    t_inf : array
        Where the full series ends.
    gap : array
        ``t_inf`` less the time of the last impact permitted.
    height : array
        Largest gap of the contact in what is left out.
    """

    parameter: str
    values: np.ndarray
    impacts: np.ndarray
    t_inf: np.ndarray
    gap: np.ndarray
    height: np.ndarray

    def __str__(self) -> str:
        lines = [f"{self.parameter:>10} {'impacts':>8} {'t_inf':>20} {'gap':>10} {'height':>10}"]
        columns = zip(self.values, self.impacts, self.t_inf, self.gap, self.height, strict=True)
        for value, impacts, t_inf, gap, height in columns:
            lines.append(f"{value:10.6g} {impacts:8} {t_inf:20.15g} {gap:10.3e} {height:10.3e}")
        return "\n".join(lines)


def transient(
    model: Any,
    start: Any,
    t: tuple[float, float],
    *,
    values: Iterable[float],
    parameter: str = "r",
    **options: Any,
) -> Transient:
    """Cut chattering off after ``[1/r]`` impacts, for smaller and smaller ``r``.

    Section 2 of Akhmet & Çağ, *Analysis of Impact Chattering*: as ``r`` tends to 0, fewer than
    all impacts tell less and less. (There the body falls on under its flow alone; here the
    contact is held, by its force, as it is in truth.)

    Parameters
    ----------
    model : Automaton
    start, t, options
        As for :func:`hybrid.simulate`.
    values : iterable of float
        Values of the parameter.
    parameter : str
        The coefficient of restitution's name.

    Returns
    -------
    Transient
        Of the first series of each run; ``print`` shows a table.

    Raises
    ------
    OptionError
        If the model has no such parameter, or ``zeno`` is given.
    """
    if parameter not in {p.name for p in model.spec.parameters}:
        known = ", ".join(p.name for p in model.spec.parameters) or "none"
        raise OptionError(f"{model.spec.model} has no parameter {parameter!r}; there are: {known}")
    if "zeno" in options:
        raise OptionError(f"zeno={options['zeno']!r}: a transient is run with zeno='truncate'")
    chosen, rows = [float(value) for value in values], []
    for value in chosen:
        made = attrs.evolve(model, **{parameter: value})
        rows.append(_left_out(simulate(made, start, t, zeno="truncate", **options)))
    impacts, *others = np.array(rows).reshape(-1, 4).T
    return Transient(parameter, np.array(chosen), impacts.astype(int), *others)


def _left_out(run: Any) -> tuple[float, float, float, float]:
    cut = next((point.truncation for point in run.zeno if point.truncation), None)
    if cut is None:
        return -1.0, np.nan, np.nan, np.nan
    return cut.impacts, cut.t_inf, cut.gap, cut.height
