"""What sections share: Example 1 run twice, with its certificate, without its wall; a figure."""

from __future__ import annotations

from math import sqrt
from typing import Any

import attrs
import numpy as np

from hybrid import gallery
from hybrid.certificates import certify
from hybrid.lowering import scene_of
from hybrid.plot.figure import Figure, Panel
from hybrid.plot.of_run import gaps_panel, states_panel, zooms
from hybrid.result import Trajectory
from hybrid.simulation import simulate

from .claims import Number

#: Runs are made in Taylor series, which are accurate to rounding where no tolerance is given.
FINE: dict[str, Any] = {"solver": "taylor"}

#: Runs with another method, whose distance to those tells how accurate both are.
OTHER: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-12, "solver": "scipy", "method": "DOP853"}

#: What is zero, relative, but for rounding.
ZERO = 1e-10

#: Points a curve, at most.
POINTS = 4000

#: The start of Example 1, and its domain.
START = {"x": 2.1, "v": 0.0}
DOMAIN = {"x": (2.0, 2.5), "v": (-7.0, 7.0)}

#: A wall so deep that nothing meets it.
NONE = -100.0


@attrs.frozen
class Spring:
    """Example 1: the model, its certificate, the run of Figure 1 by two methods."""

    model: Any
    certificate: Any
    run: Any
    again: Any

    @classmethod
    def made(cls) -> Spring:
        """The runs of Figure 1, and the theorem on the paper's domain."""
        model = gallery.find("hard_spring").cls()
        runs = [simulate(model, START, (0.0, 1.5), **options) for options in (FINE, OTHER)]
        return cls(model, certify(model, DOMAIN), *runs)


@attrs.frozen
class Attained:
    """Forces that are attained, and how far off bounds that are proved leave the extreme ones.

    Attributes
    ----------
    most, least, left : (float, float)
        The largest and the least ``f``, and ``M sqrt(2 (h - phi) / m)``, each with its error.
    """

    most: tuple[float, float]
    least: tuple[float, float]
    left: tuple[float, float]

    @classmethod
    def of(cls, model: Any, proved: Any) -> Attained:
        """Of a certificate by Theorem 1."""
        most, least = force(model, proved.m_at), force(model, proved.M_at)
        (low, high), size = proved.box["x"], 4 * float(np.spacing(-least))
        left = -least * sqrt(2 * (high - low) / -most)
        return cls(
            (most, abs(most + proved.m) + size),
            (least, abs(least + proved.M) + size),
            (left, abs(proved.left - left) + size),
        )


def force(model: Any, at: dict[str, float]) -> float:
    """``f`` at a point."""
    rhs = scene_of(model).field("flight").rhs
    return float(rhs(0.0, [at["x"], at.get("v", 0.0)])[1])


def without_contact(model: Any, x: float, v: float, until: float, **options: Any) -> Any:
    """A run under ``x'' = f(x, x')`` alone, from time 0."""
    free, start = attrs.evolve(model, wall=NONE), {"x": x, "v": v}
    return simulate(free, start, (0.0, until), **options)


def apart(one: Any, other: Any) -> float:
    """A bound on an error: three times the distance of two computations, and rounding."""
    one, other = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    return float(np.max(3 * np.abs(one - other) + 4 * np.spacing(np.abs(one))))


def twice(what: str, one: Any, other: Any, paper: str = "") -> Number:
    """A number as computed by two methods."""
    return Number(what=what, ours=float(one), error=apart(one, other), paper=paper)


def flight_figure(run: Trajectory, name: str, title: str, aside: Panel) -> Figure:
    """Position and velocity of a body over time; another panel and the gaps beside them."""
    states = tuple(states_panel(run, state, points=POINTS // 2) for state in ("x", "v"))
    columns = (states, (aside, gaps_panel(run)))
    return Figure(name=name, title=title, columns=columns, zooms=zooms(run))
