"""Diagrams of bifurcations, and maps that are finer where lanes differ (``docs/maps.md``)."""

import math
import warnings
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.relief_valve import ReliefValve

from .contract.ways import spread

E = 0.7


class Table(hy.Automaton):
    """A ball on a table that moves as ``G sin t``."""

    x = hy.state(unit="m")
    v = hy.state(unit="m/s")
    G: float = hy.parameter(0.6, unit="m")
    e: float = hy.parameter(E, between=(0, 1))

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.G * jnp.sin(t), restitution="e")


def highest(self, t, s):
    """Where the valve turns."""
    return s.y2


#: The equilibrium loses its stability at this flow, where a pair of eigenvalues turns imaginary.
HOPF = 8.49117


def lift(q):
    """The lift at the equilibrium: ``y1 sqrt(y1 + 10) = q``, by bisection."""
    low, high = 0.0, q
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if middle * math.sqrt(middle + 10.0) < q else (low, middle)
    return low


def routh(q):
    """Positive where the equilibrium is stable: ``a b - c`` of ``s^3 + a s^2 + b s + c``."""
    y = lift(q)
    root = math.sqrt(y + 10.0)
    d = 10.0 * y / root
    return (1.25 + d) * (1.0 + 1.25 * d) - (d + 20.0 * root)


def test_the_flow_at_which_the_valve_begins_to_swing():
    """The number above is the zero of Routh's criterion."""
    assert routh(HOPF - 1e-4) < 0 < routh(HOPF + 1e-4)


def test_a_relief_valve(tmp_path):
    """It rests where the flow is large, swings where it is less, and strikes its seat below."""
    q = np.array([3.0, 8.0, 9.8])
    found = hy.bifurcation(
        ReliefValve(), {"q": q}, {"y1": 2.0, "y2": 0.0, "y3": 12.0}, (0.0, 400.0),
        section=highest, crossing=hy.FALLING, skip=150, keep=6, solver="taylor",
    )  # fmt: skip
    table = found.table
    assert table.y1_section.dims == ("q", "hit")
    # at 9.8 it spirals in by exp(-0.09 t), by 1e-11 in 150 turns of some 2
    np.testing.assert_allclose(table.y1_section[2], lift(9.8), rtol=1e-6)
    assert table.period.values.tolist()[::2] == [1.0, 1.0]
    assert table.y1_section.values[1].min() > lift(8.0) + 1.0
    assert table.jumps.values.tolist()[1:] == [0, 0]
    assert table.jumps.values[0] > 10
    np.testing.assert_allclose(table.y2_section, 0.0, atol=1e-7)
    figure = found.plot("y1", tmp_path / "valve.png")
    assert Path(tmp_path / "valve.png").stat().st_size > 1000
    (axes,) = figure.axes
    assert axes.get_xlabel() == "q"
    with pytest.raises(hy.OptionError, match="there are points of y1, y2, y3"):
        found.plot("z")
    with pytest.raises(hy.OptionError, match="one parameter"):
        hy.bifurcation(ReliefValve(), {"q": q, "r": [0.5, 0.8]}, section=highest)


LEAST = math.pi * (1 - E) / (1 + E)
MOST = math.sqrt(LEAST**2 + (2 * (1 + E**2) / (1 + E) ** 2) ** 2)


def phase(model):
    """When the orbit that strikes once a period does so, or nearly."""
    return math.acos(min(1.0, LEAST / model.G))


def near(model):
    """A start a little beside it."""
    return {"x": model.G * math.sin(phase(model)), "v": math.pi * 1.0001}


def length(model):
    """Three hundred periods and a half."""
    return phase(model), phase(model) + 601.0 * math.pi


def test_cells_are_halved_where_orbits_differ():
    """Once a period a ball strikes a table from ``pi (1 - e)/(1 + e)`` on, and stably up to where
    ``G^2`` exceeds the square of that by that of ``2 (1 + e^2)/(1 + e)^2``."""
    width = 0.02
    table = hy.sweep(
        Table(), {"G": np.linspace(0.4, 1.4, 6)}, near, length,
        section="impact", skip=280, keep=6, measure=["period"],
        refine={"G": width}, by="period",
    )  # fmt: skip
    once = table.G.values[table.period.values == 1.0]
    assert np.all(np.diff(table.G.values) > 0)
    # a cell of the width asked for lies about each end; near its own an orbit is slow to settle
    assert LEAST <= once.min() <= LEAST + width
    assert MOST - width <= once.max() <= MOST
    assert len(table.G) < 6 + 2 * 2 * 4
    for end in (once.min(), once.max()):
        beside = np.abs(table.G.values - end)
        assert 0 < np.sort(beside)[1] <= width


def bounds_of(e):
    """From where on a ball may strike once in each period, and up to where stably."""
    least = math.pi * (1 - e) / (1 + e)
    return least, math.hypot(least, 2 * (1 + e * e) / (1 + e) ** 2)


def exists(table):
    """Of each lane whether there is an orbit that strikes once a period."""
    return np.array([orbit is not None for orbit in map(orbit_of, table.G.values, table.e.values)])


def stable(table):
    """Of each lane whether that orbit is stable."""
    found = map(orbit_of, table.G.values, table.e.values)
    return np.array([o is not None and np.abs(o.multipliers).max() < 1.0 for o in found])


def orbit_of(G, e):
    """The orbit that strikes once a period, if there is one."""
    least = bounds_of(e)[0]
    begins = math.acos(min(1.0, least / G))
    guess = {"x": G * math.sin(begins) + 1e-9, "v": math.pi}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            orbit = hy.periodic_orbit(Table(G=G, e=e), guess, period=2 * math.pi, t=begins)
    except hy.OrbitError:
        return None
    return orbit if orbit.jumps == 1 else None  # not the one at rest on the table


def border_of(e, which, width):
    """The amplitudes between which the border lies, and how many lanes were flown to find it."""
    exact = bounds_of(e)[which == "stable"]
    table = hy.sweep(
        Table(e=e), {"G": exact + np.array([-0.1, 0.07]), "e": [e]}, {"x": 3.0, "v": 0.0},
        (0.0, 0.01), measure=[{"exists": exists, "stable": stable}[which]], refine={"G": width},
        by=which,
    )  # fmt: skip
    order = np.argsort(table.G.values)
    G, kinds = table.G.values[order], table[which].values[order]
    (place,) = np.flatnonzero(np.diff(kinds))
    return float(G[place]), float(G[place + 1]), len(G)


@pytest.mark.parametrize(("e", "which"), spread([0.5, 0.8], ["exists", "stable"], of=2))
def test_borders_of_an_orbit_to_a_millionth(e, which):
    """Refinement by what :func:`hybrid.periodic_orbit` finds ends beside the closed forms."""
    low, high, lanes = border_of(e, which, 1e-6)
    assert high - low <= 1e-6
    # beside the fold Newton's method has lost half of its digits, of 1e-12
    assert low - 1e-9 <= bounds_of(e)[which == "stable"] <= high + 1e-9
    assert lanes < 60


def once_a_period(table):
    """Which half-plane a lane is in, for a boundary that is known."""
    return table.x_start + table.v_start > 0.6


def test_refining_a_plane():
    """Cells of the width asked for cover a boundary, and few lanes are flown for it."""
    axes = {"x": np.linspace(0.0, 1.0, 3), "v": np.linspace(0.0, 1.0, 3)}
    asked = {"over": axes, "t": (0.0, 0.01), "measure": [once_a_period], "by": "once_a_period"}
    table = hy.sweep(Free(), **asked, refine={"x": 1 / 32, "v": 1 / 32})
    assert table.once_a_period.dims == ("lane",)
    kinds = table.once_a_period.values
    places = np.stack([table.x_start.values, table.v_start.values], axis=1)
    for inside in places[kinds]:
        if 0.6 < inside.sum() < 0.61 and inside.min() > 0:
            assert np.abs(places[~kinds] - inside).max(axis=1).min() <= 1 / 32
    assert len(places) < 33 * 33 / 3
    assert len({tuple(place) for place in places.tolist()}) == len(places)


class Free(hy.Automaton):
    """Nothing happens."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def rest(self, t, s):
        return 0.0 * s.v, 0.0 * s.x


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"refine": {"e": 0.1}}, "widths by name, of G"),
        ({"refine": {"G": 0.0}}, "a width greater than 0"),
        ({"refine": {"G": 1e-40}}, "less than rounding"),
        ({"refine": {"G": 0.1}, "by": "colour"}, "one value a lane is due"),
    ],
)
def test_what_cannot_be_refined(asked, said):
    """Wrong use is one clear error."""
    with pytest.raises(hy.OptionError, match=said):
        hy.sweep(Table(), {"G": [0.4, 1.4]}, {"x": 2.0, "v": 0.0}, (0.0, 1.0), **asked)


def test_a_refined_map_is_stored(tmp_path):
    """Each round in a group of its own, and gone on with."""
    pytest.importorskip("zarr")
    from hybrid.maps.store import status

    axes = {"x": np.linspace(0.0, 1.0, 3), "v": np.linspace(0.0, 1.0, 3)}
    asked = {"over": axes, "t": (0.0, 0.01), "measure": [once_a_period], "by": "once_a_period"}
    asked |= {"refine": {"x": 0.2}, "store": tmp_path / "map.zarr"}
    table = hy.sweep(Free(), **asked)
    assert table.identical(hy.sweep(Free(), **asked, progress=pytest.fail))
    assert status(tmp_path / "map.zarr")["lanes"] == table.sizes["lane"]
