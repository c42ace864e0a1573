"""Basins and attractors by recurrences, and the dimension of what parts them (``docs/maps.md``)."""

import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import hybrid as hy
from hybrid.maps.boundary import dimension
from hybrid.maps.recurrence import Nearness, Tails, grouped

from .wells import Belt, Floor, Rooms, Wells

TURN = 2 * math.pi

#: The least amplitude at which a ball that keeps 0.7 of its speed strikes once in each period.
LEAST = math.pi * 0.3 / 1.7

#: Points symmetric about zero, none of them on the border through it.
X, V = np.linspace(-1.25, 1.25, 10), np.linspace(-2.0, 2.0, 8)

WELLS = {"over": {"x": X, "v": V}, "t": (0.0, 120.0), "section": 1.0, "keep": 20}


@pytest.fixture(scope="module")
def wells():
    return hy.basins(Wells(), **WELLS)


def test_basins_that_are_each_other_turned_round(wells):
    """``(x, v)`` and ``(-x, -v)`` lead to wells at ``x`` and ``-x``, half of all to each."""
    labels = wells.labels
    assert set(labels.ravel().tolist()) == {0, 1}
    assert np.all(labels[::-1, ::-1] == 1 - labels)
    assert wells.fractions.tolist() == [0.5, 0.5]
    assert [attractor.kind for attractor in wells.attractors] == ["rest", "rest"]
    # exp(-0.15 t) of what was of size 1 is left at twice the time
    ends = [attractor.state.x for attractor in wells.attractors]
    np.testing.assert_allclose(np.abs(ends), 1.0, atol=1e-12)
    assert np.all(np.sign(wells.table.x.values) == np.sign(ends)[labels])
    assert wells.table.attractor.dims == ("x_start", "v_start")


def test_basins_are_a_sweep(wells, tmp_path):
    """Who flies the blocks, how large they are, and a store have no say."""
    pytest.importorskip("zarr")
    with ThreadPoolExecutor(2) as pool:
        again = hy.basins(Wells(), **WELLS, executor=pool, block=30, store=tmp_path / "map.zarr")
    assert again.table.identical(wells.table)
    told = []
    kept = hy.basins(
        Wells(), **WELLS, block=30, store=tmp_path / "map.zarr", progress=lambda *n: told.append(n)
    )
    assert kept.table.identical(wells.table)
    assert not told


@pytest.mark.long
def test_orbits_side_by_side():
    """At ``G = 1.14`` a ball that keeps 0.7 of its speed may strike once in one period, or once in
    two: at speeds of ``pi`` and ``2 pi``, as :func:`hybrid.periodic_orbit` finds them."""
    model = Floor(G=1.14)
    numbers = 1, 2
    for n in numbers:
        phase = math.acos(n * LEAST / 1.14)
        guess = {"x": 1.14 * math.sin(phase) + 1e-6, "v": n * math.pi}
        orbit = hy.periodic_orbit(model, guess, period=n * TURN, t=phase, settle=8)
        assert (orbit.stable, orbit.jumps) == (True, 1)
        assert orbit.run.jumps.after.v == pytest.approx(n * math.pi, rel=1e-9)
    found = hy.basins(
        model, {"v": [0.5, 3.1, 3.2, 6.28, 6.285]},
        {"x": guess["x"]}, (phase, phase + 300.0), section="impact", keep=16,
    )  # fmt: skip
    speeds = found.table.v_section.values
    periods = {}
    for attractor in found.attractors:
        periods[attractor.number] = attractor.period, attractor.jumps
        own = speeds[found.labels == attractor.number]
        for n in numbers:
            strikes = np.allclose(own, n * math.pi, rtol=0.01)  # as near as points of one place are
            assert strikes == (periods[attractor.number] == (pytest.approx(n * TURN), 1))
    assert (pytest.approx(TURN), 1) in periods.values()
    assert (pytest.approx(2 * TURN), 1) in periods.values()
    assert (pytest.approx(TURN), math.inf) in periods.values()  # it chatters and is thrown off
    assert found.none == 0.0


def test_a_rest_is_an_attractor():
    """On a table that is too slow to throw it a ball rests for good, or strikes once a period; the
    mode in which it is much later says which."""
    over = {"x": np.linspace(0.5, 3.5, 4), "v": np.linspace(-3.0, 3.5, 6)}
    found = hy.basins(Floor(), over, t=(0.0, 300.0), section=TURN, keep=20)
    late = hy.sweep(Floor(), over, t=(0.0, 1200.0))
    rests = np.char.endswith(late["mode"].values.astype(str), "rest(impact)")
    (always,) = [a.number for a in found.attractors if a.mode == "flight.rest(impact)"]
    assert 0 < rests.sum() < rests.size
    assert np.all((found.labels == always) == rests)
    assert found.attractors[always].stick == pytest.approx(1.0)
    assert found.attractors[1 - always].jumps == 1
    assert found.attractors[1 - always].period == pytest.approx(TURN)
    # at the jumps of the contact those that rest are known by where they end
    jumps = hy.basins(Floor(), over, t=(0.0, 300.0), section="impact", keep=20)
    (own,) = [a.number for a in jumps.attractors if a.mode == "flight.rest(impact)"]
    assert np.all((jumps.labels == own) == rests)


def turns(self, t, s):
    return s.v


def test_a_cycle_that_slides():
    """Beside the equilibrium of a block on a belt there is the cycle in which it sticks."""
    found = hy.basins(
        Belt(), {"x": [0.4, 0.62, 0.64, 1.0]}, {"v": 0.0}, (0.0, 400.0),
        section=turns, crossing=hy.FALLING, keep=20,
    )  # fmt: skip
    assert found.labels.tolist() in ([0, 1, 1, 0], [1, 0, 0, 1])
    by = {attractor.kind: attractor for attractor in found.attractors}
    assert set(by) == {"rest", "periodic"}
    assert by["rest"].state.x == pytest.approx(0.625, abs=1e-6)
    assert by["periodic"].jumps == 2
    assert 0 < by["periodic"].stick < 0.1


def test_modes_part_what_states_do_not():
    """A state at rest in one mode is another place than the same state in another."""
    found = hy.basins(Rooms(), {"x": [-2.0, -1.0, 1.0, 2.0]}, t=(0.0, 50.0), section=1.0, keep=8)
    assert found.labels.tolist() == [0, 0, 1, 1]
    assert [attractor.mode for attractor in found.attractors] == ["here", "there"]
    np.testing.assert_allclose([a.state.x for a in found.attractors], 0.0, atol=1e-12)


def test_lanes_that_lead_nowhere():
    """One that fails, one that drifts: no attractor, and a reason."""
    found = hy.basins(
        Floor(G=0.0, g=-1.0), {"x": [-1.0, 1.0]}, {"v": 0.0}, (0.0, 50.0), section=1.0, keep=8
    )
    assert found.labels.tolist() == [-1, -1]
    assert found.table.status.values.tolist() == ["outside", "reached_end"]
    assert found.attractors == []
    assert found.none == 1.0
    assert "none found, or failed: 1 of the starts" in str(found)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"over": {"r": [0.5]}}, "over 'r': starts of x, v"),
        ({"over": {"q": [0.5]}}, "over 'q': starts of x, v"),
        ({"near": 0.0}, "a share, between 0 and 1"),
        ({"keep": 0}, "a whole number, 1 or more"),
        ({"section": "blow"}, "there are the jumps left, right"),
    ],
)
def test_what_has_no_basins(change, said):
    """Wrong use is one clear error."""
    with pytest.raises(hy.OptionError, match=said):
        hy.basins(Wells(), **{**WELLS, **change})


def test_the_picture(wells, tmp_path):
    """Each basin has a name in the legend; a page of HTML too."""
    figure = wells.plot(tmp_path / "basins.png")
    assert Path(tmp_path / "basins.png").stat().st_size > 1000
    (axes,) = figure.axes
    assert axes.get_xlabel() == "x at the start [m]"
    (legend,) = figure.legends
    assert [text.get_text()[:18] for text in legend.get_texts()] == [
        "0: rest in free, x",
        "1: rest in free, x",
    ]
    pytest.importorskip("plotly")
    wells.plot(tmp_path / "basins.html")
    assert "1: rest in free" in (tmp_path / "basins.html").read_text()


# ---------------------------------------------------------------------------------------
# recurrences


def tails_of(points):
    """Lanes with these points, in one mode, none of them at rest."""
    points = np.asarray(points, dtype=float)
    lanes, keep, _ = points.shape
    there = np.ones(lanes, dtype=bool)
    sizes = np.abs(points).max(axis=1), np.ptp(points, axis=1)
    modes = np.zeros((lanes, keep))
    return Tails(points, modes, points[:, -1], modes[:, 0], ~there, there, *sizes)


def test_a_chaotic_attractor_is_one():
    """Lanes on the attractor of the Hénon map, none of which has a point of another."""
    rng = np.random.default_rng(0)

    def iterates(x, n):
        rows = [x]
        for _ in range(n):
            a, b = rows[-1]
            rows.append(np.array([1.0 - 1.4 * a * a + b, 0.3 * a]))
        return np.array(rows[100:])

    starts = rng.uniform(-0.1, 0.1, (12, 2))
    tails = tails_of([iterates(x, 499) for x in starts])
    labels, firsts = grouped(
        tails,
        Nearness(0.01, 1e-6),
        lambda i: (iterates(starts[i], 4099)[400:], np.zeros(3600)),
    )
    assert labels.tolist() == [0] * 12
    assert firsts == [0]


def test_a_drift_is_no_recurrence():
    """Points that go on and on, or spiral in too slowly, have not come back."""
    k = np.arange(100.0)
    line = np.stack([k, 0.0 * k], axis=1)
    spiral = 0.995 ** k[:, None] * np.stack([np.cos(k), np.sin(k)], axis=1)
    tails = tails_of([line, spiral])
    labels, _ = grouped(tails, Nearness(0.01, 1e-6), pytest.fail)
    assert labels.tolist() == [-1, -1]


def test_noise_of_rounding_is_no_place():
    """A coordinate that is zero on the section, but for rounding, parts no lanes."""
    rng = np.random.default_rng(1)
    points = np.zeros((10, 20, 2))
    points[:5, :, 0], points[5:, :, 0] = 1.0, -1.0
    points[..., 1] = 1e-16 * rng.standard_normal((10, 20))
    tails = tails_of(points)
    tails.size[:] = 1.0
    labels, _ = grouped(tails, Nearness(0.01, 1e-6), lambda i: (points[i], np.zeros(20)))
    assert labels.tolist() == [0] * 5 + [1] * 5


# ---------------------------------------------------------------------------------------
# the boundary


def grid(n):
    return np.meshgrid(*[(np.arange(n) + 0.5) / n] * 2, indexing="ij")


def test_a_line_has_dimension_one():
    """And a circle, within its error."""
    x, y = grid(128)
    line = dimension((x + 0.37 * y > 0.6).astype(int), "map")
    assert line.value == pytest.approx(1.0, abs=1e-12)  # counts in proportion to the distance
    circle = dimension(((x - 0.5) ** 2 + (y - 0.5) ** 2 < 0.1).astype(int), "map")
    assert abs(circle.value - 1.0) < 2 * circle.error < 0.2


def gaps_of_cantor(x):
    """The parity of the level of the gap of the Cantor set in which a point lies."""
    found = np.full(x.shape, -1)
    for level in range(30):
        middle = (x > 1 / 3) & (x < 2 / 3) & (found < 0)
        found[middle] = level % 2
        x = np.where(x < 0.5, 3 * x, 3 * x - 2)
    return np.maximum(found, 0)


@pytest.mark.parametrize("n", [243, 512])
def test_the_dimension_of_cantors_dust(n):
    """``log 2 / log 3`` on a line, one more in a plane of such lines."""
    labels = gaps_of_cantor((np.arange(n) + 0.5) / n)
    exact = math.log(2) / math.log(3)
    found = dimension(labels, "map")
    assert abs(found.value - exact) < 2 * found.error < 0.3
    plane = dimension(np.repeat(labels[:, None], n, axis=1), "map")
    assert abs(plane.value - 1.0 - exact) < 2 * plane.error < 0.3
    assert plane.uncertainty == pytest.approx(2.0 - plane.value)


def test_no_boundary():
    """Where there is one region, or too small a grid, that is said."""
    with pytest.raises(hy.OptionError, match="neighbours do not differ"):
        dimension(np.zeros((64, 64), dtype=int), "map")
    with pytest.raises(hy.OptionError, match="too few: 32 along each axis"):
        dimension(np.zeros((64, 8), dtype=int), "map")


def test_points_of_no_region_say_nothing():
    """Where it is not known where starts lead, no boundary is counted."""
    x, y = grid(128)
    labels = (x > 0.5).astype(int)
    labels[y > 0.8] = -1
    assert dimension(labels, "map").value == pytest.approx(1.0, abs=1e-12)
