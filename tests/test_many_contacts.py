"""An array of gaps is as many contacts, as if each had been declared by itself."""

from decimal import Decimal, localcontext

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.lowering import scene_of
from hybrid.lowering.arithmetic import solve

START, UNTIL = {"x": np.array([0.3, 1.7, 2.9]), "v": np.array([-1.0, -2.0, 0.5])}, (0.0, 2.0)


class Beads(hy.Automaton):
    """Three beads of size one in a column: those above fall on those below."""

    x = hy.state(shape=(3,))
    v = hy.state(shape=(3,))
    r = hy.parameter(0.4)

    @hy.mode
    def flight(self, t, s):
        return s.v, -jnp.ones(3)

    floor = hy.contact(flight, gap=lambda self, t, s: s.x[0], restitution="r")
    impact = hy.contact(flight, gap=lambda self, t, s: s.x[1:] - s.x[:-1] - 1, restitution="r")


class OneByOne(hy.Automaton):
    """The same, contact by contact."""

    x = hy.state(shape=(3,))
    v = hy.state(shape=(3,))
    r = hy.parameter(0.4)

    @hy.mode
    def flight(self, t, s):
        return s.v, -jnp.ones(3)

    floor = hy.contact(flight, gap=lambda self, t, s: s.x[0], restitution="r")
    low = hy.contact(flight, gap=lambda self, t, s: s.x[1] - s.x[0] - 1, restitution="r")
    high = hy.contact(flight, gap=lambda self, t, s: s.x[2] - s.x[1] - 1, restitution="r")


class Weighed(hy.Automaton):
    """Beads on a line, each of its own mass; each pair has its own restitution."""

    x = hy.state(shape=(3,))
    v = hy.state(shape=(3,))
    m = hy.parameter(np.array([1.0, 2.0, 4.0]))
    r = hy.parameter(np.array([1.0, 0.5]))

    @hy.mode
    def line(self, t, s):
        return s.v, jnp.zeros(3)

    hit = hy.contact(
        line,
        gap=lambda self, t, s: s.x[1:] - s.x[:-1],
        restitution="r",
        inverse_mass=lambda self, t, s: 1.0 / self.m,
    )


def names(text):
    """What the contacts of ``OneByOne`` are called here."""
    return str(text).replace("low", "impact[0]").replace("high", "impact[1]")


def test_the_run_is_that_of_contacts_declared_one_by_one(solver):
    """To the last bit, through impacts, accumulations and rest, with names for names."""
    many, single = (hy.simulate(cls(), START, UNTIL, **solver) for cls in (Beads, OneByOne))
    assert {"floor", "impact[0]", "impact[1]"} <= set(many.jumps.edge)
    assert list(many.jumps.edge) == [names(edge) for edge in single.jumps.edge]
    assert [arc.mode for arc in many.arcs] == [names(arc.mode) for arc in single.arcs]
    for one, other in ((many.jumps.t, single.jumps.t), (many.jumps.impulse, single.jumps.impulse)):
        np.testing.assert_array_equal(one, other)
    assert many.jumps.after == single.jumps.after
    assert len(many.zeno) > 0
    for one, other in zip(many.zeno, single.zeno, strict=True):
        assert one.edges == tuple(map(names, other.edges))
        assert (one.t, one.ratio, one.state) == (other.t, other.ratio, other.state)
    times = np.linspace(*UNTIL, 9)
    assert many(times) == single(times)
    pairs = (("impact[0]", "low"), ("impact[1]", "high"))
    for one, other in pairs:
        np.testing.assert_array_equal(many.force(one, times), single.force(other, times))


def test_a_column_rests_on_its_floor(solver):
    """Twenty beads at rest, each pressed by all above it; the floor's force is their weight."""

    class Column(hy.Automaton):
        x = hy.state(shape=(20,))
        v = hy.state(shape=(20,))

        @hy.mode
        def flight(self, t, s):
            return s.v, -jnp.ones(20)

        floor = hy.contact(flight, gap=lambda self, t, s: s.x[0], restitution=0.5)
        on = hy.contact(flight, gap=lambda self, t, s: jnp.diff(s.x) - 1, restitution=0.5)

    held = ", ".join(["floor", *(f"on[{i}]" for i in range(19))])
    start, mode = {"x": np.arange(20.0), "v": np.zeros(20)}, f"flight.rest({held})"
    run = hy.simulate(Column(), start, (0.0, 1.0), mode=mode, **solver)
    assert run.mode == mode
    np.testing.assert_array_equal(run.final.x, np.arange(20.0))
    assert run.force("floor", 0.5) == pytest.approx(20.0, rel=1e-14)  # twenty equations' rounding
    assert run.force("on[18]", 0.5) == pytest.approx(1.0, rel=1e-14)
    with pytest.raises(
        hy.OptionError, match=r"no contact 'on'; there are: floor, on\[0\], on\[1\]"
    ):
        run.force("on", 0.5)


def test_masses_and_restitutions_are_those_of_each_contact(solver):
    """A bead of mass 1 strikes one of 2 elastically, and that one of 4 with restitution 1/2."""
    start = {"x": np.array([0.0, 1.0, 2.0]), "v": np.array([3.0, 0.0, 0.0])}
    run = hy.simulate(Weighed(), start, (0.0, 1.2), **solver)
    assert list(run.jumps.edge) == ["hit[0]", "hit[1]"]
    after = run.jumps.after.v
    np.testing.assert_allclose(after[0], [-1.0, 2.0, 0.0], atol=1e-15)  # 3 (1 - 2) / 3, 3 2 1 / 3
    # momentum 2 * 2 and the speeds apart 2 / 2: v2 = v1 + 1, 2 v1 + 4 v2 = 4
    np.testing.assert_allclose(after[1], [-1.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(run.jumps.impulse, [4.0, 4.0], rtol=4e-16)  # 2 * 2 and 4 * 1


def test_lanes_and_functions_have_them():
    """A lane, and a function, of many contacts is its run."""
    run = hy.simulate(Beads(), START, UNTIL, solver="taylor")
    lanes = hy.ensemble(Beads(), START, UNTIL, {"r": np.array([0.4, 0.5])})
    np.testing.assert_array_equal(lanes.x[0], run.final.x)
    assert lanes.t_inf[0] == run.zeno[0].t
    with jax.enable_x64(True):
        given = hy.as_function(Beads(), t=UNTIL, max_jumps=200)(Beads(), START)
        np.testing.assert_array_equal(given.final["x"], run.final.x)


def test_accumulations_are_certified_by_their_names():
    """Each of two balls has its own limit and proof; ``hy.certify`` takes a contact by its name."""

    class Balls(hy.Automaton):
        x = hy.state(shape=(2,))
        v = hy.state(shape=(2,))

        @hy.mode
        def flight(self, t, s):
            return s.v, -jnp.ones(2)

        impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    run = hy.simulate(Balls(), [[1.0, 2.0], [0.0, 0.0]], (0.0, 20.0), solver="taylor")
    found = {point.edges: point.t for point in run.zeno}
    for i, height in enumerate((1.0, 2.0)):  # falls, then flights of u, u/2, ...: three falls long
        exact = 3.0 * np.sqrt(2.0 * height)
        assert found[f"impact[{i}]",] == pytest.approx(exact, rel=1e-14)
    assert [point.verdict for point in run.zeno] == ["certified", "certified"]
    assert run.mode == "flight.rest(impact[0], impact[1])"
    with pytest.raises(hy.OptionError, match=r"no such contact; there are impact\[0\]"):
        hy.certify(Balls(), {"x[0]": (0, 2), "v[0]": (-3, 3)}, contact="impact")
    proof = hy.certify(Balls(), {"x[1]": (0, 2), "v[1]": (-3, 3)}, contact="impact[1]")
    assert proof.reason == "the motion may leave by impact[0], whose guard may be zero on the box"


def test_a_gap_may_look_back(solver):
    """An array of gaps that depends on the past: walls that follow the bead half a unit behind."""

    class Late(hy.Automaton):
        x = hy.state()
        v = hy.state()
        z = hy.state()

        @hy.mode
        def flight(self, t, s, past):
            return s.v, -past(0.5).z, 1.0

        wall = hy.contact(
            flight,
            gap=lambda self, t, s: (s.x, 1.0 - s.x),
            restitution=lambda self, t, s, u: jnp.array([0.5, 1.0]),
        )

    start = {"x": 0.5, "v": 1.0, "z": 0.0}
    run = hy.simulate(Late(), start, (0.0, 1.0), **solver)
    assert run.jumps.edge[0] == "wall[1]"
    t = run.jumps.t[0]
    assert t == pytest.approx(0.5, abs=1e-6)  # z(t - 0.5) = 0 until then; tolerances of 1e-8
    assert run.jumps.after.v[0] == -run.jumps.before.v[0]


def _matrix():
    class Bad(Beads):
        impact = hy.contact("flight", gap=lambda self, t, s: jnp.eye(2), restitution="r")


def _empty():
    class Bad(Beads):
        impact = hy.contact("flight", gap=lambda self, t, s: s.x[3:], restitution="r")


def _unequal():
    class Bad(Beads):
        r = hy.parameter(np.ones(3))


def _unknown():
    class Bad(Beads):
        @hy.mode(limit_of=("impact[2]",))
        def after(self, t, s):
            return s.v, jnp.zeros(3)

        @hy.mode(initial=True)
        def flight(self, t, s):
            return s.v, jnp.zeros(3)


FAULTS = {
    _matrix: r"contact impact, gap: a value of shape \(2, 2\) where one number is due",
    _empty: "contact impact: a gap of no element; give one or more",
    _unequal: r"impact\[0\], restitution: a restitution of shape \(3,\) where \(2,\) is due",
    _unknown: r"mode after: limit_of=\('impact\[2\]',\): 'impact\[2\]' is no edge; there are: "
    r"floor, impact\[0\], impact\[1\]",
}


@pytest.mark.parametrize("declare", FAULTS, ids=lambda each: each.__name__.strip("_"))
def test_wrong_arrays_are_faults_of_the_class(declare):
    """One sentence when the class is made."""
    with pytest.raises(hy.DeclarationError, match=FAULTS[declare]):
        declare()


def test_masses_are_those_of_all_positions():
    """A diagonal of another length is refused with the length that is due."""

    class Bad(Beads):
        impact = hy.contact(
            "flight", gap=lambda self, t, s: jnp.diff(s.x), restitution="r", inverse_mass=[1.0, 2.0]
        )

    said = r"contact impact\[0\]: inverse_mass of shape \(2,\) where \(3,\) is due, for the"
    with pytest.raises(hy.DeclarationError, match=said):
        hy.simulate(Bad(), START, UNTIL)


class Counted(float):
    """A number that counts the products it is part of."""

    products = 0

    def __mul__(self, other):
        Counted.products += 1
        return Counted(float(self) * other)

    __rmul__ = __mul__

    def __truediv__(self, other):
        return Counted(float(self) / other)


def test_contacts_that_touch_two_others_cost_no_cubes():
    """Forces of a column: twice the beads, four times the products (a full matrix takes eight)."""

    def products(n):
        rows = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
        Counted.products = 0
        found = solve([[*map(Counted, row)] for row in rows], [1.0] * n, exchange=True)
        np.testing.assert_allclose(rows @ found, 1.0, rtol=1e-12)  # the matrix's condition: n^2
        return Counted.products

    assert products(40) < 5 * products(20)


def test_rests_of_bodies_apart_are_made_one_by_one():
    """The load of one that no other touches is made once, whoever else rests; Diffrax's program is
    one for all sets of those at rest."""

    class Rain(hy.Automaton):
        x = hy.state(shape=(4,))
        v = hy.state(shape=(4,))

        @hy.mode(initial=True)
        def flight(self, t, s):
            return s.v, -jnp.ones(4)

        impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    start = {"x": [1.0, 1.1, 1.2, 1.3], "v": np.zeros(4)}
    runs = [hy.simulate(Rain(), start, (0.0, 6.0), solver=name) for name in ("taylor", "diffrax")]
    for run in runs:
        falls = np.sqrt(2.0 * np.array(start["x"]))
        np.testing.assert_allclose([point.t for point in run.zeno], 3.0 * falls, rtol=1e-8)
        np.testing.assert_array_equal(run.final.x, 0.0)
    keys = [key for key in scene_of(Rain()).code._programs if isinstance(key, tuple)]
    assert {len(names) for what, names, *_ in keys if what == "load closed"} == {1}
    assert sum(key[0] == "diffrax" for key in keys) == 2


def test_impacts_at_one_instant_end_where_floats_do(solver):
    """Two beads as one strike a floor, with less and less speed and no time between, while a force
    lifts them: no sum is asked for again and again of the slowest speed that a double can be."""

    class Lifted(hy.Automaton):
        x = hy.state(shape=(2,))
        v = hy.state(shape=(2,))

        @hy.mode
        def free(self, t, s):
            return s.v, jnp.ones(2)

        floor = hy.contact(
            free, gap=lambda self, t, s: s.x[0], restitution=lambda self, t, s, u: 0.25 / (1 - u)
        )
        pair = hy.contact(free, gap=lambda self, t, s: s.x[1] - s.x[0], restitution=0.0)

    run = hy.simulate(Lifted(), {"x": np.zeros(2), "v": [0.0, -1.0]}, (0.0, 1.0), **solver)
    assert (run.mode, set(run.jumps.t)) == ("free.rest(pair)", {0.0})
    assert len(run.jumps) < 100  # each halves the speed, or more: 2^-46 is rounding of the first
    np.testing.assert_allclose(run.final.x, 0.5, rtol=1e-8)  # t^2 / 2, to the solver's tolerance


def test_a_body_wedged_in_a_corner_stops_and_leaves_it(solver):
    """Thrown into a corner it strikes both sides with no time between, ever more slowly; once its
    speed is rounding of the first it is at rest on the floor, and the wind blows it out again."""

    class Corner(hy.Automaton):
        x, y, vx, vy = hy.state(), hy.state(), hy.state(), hy.state()

        @hy.mode
        def free(self, t, s):
            return s.vx, s.vy, 1.0, -1.0

        floor = hy.contact(
            free, gap=lambda self, t, s: s.y, restitution=lambda self, t, s, u: 0.3 / (1 - u)
        )
        roof = hy.contact(
            free,
            gap=lambda self, t, s: 0.3 * s.x - s.y,
            restitution=lambda self, t, s, u: 0.4 / (1 - u),
        )

    start = {"x": 0.0, "y": 0.0, "vx": -1.0, "vy": 0.0}
    run = hy.simulate(Corner(), start, (0.0, 1.0), **solver)
    assert (run.mode, set(run.jumps.t)) == ("free.rest(floor)", {0.0})
    assert len(run.jumps) < 400  # a turn of two keeps 0.82: 2^-46 after 160, a double's least 3,700
    np.testing.assert_allclose(run.final, [0.5, 0.0, 1.0, 0.0], atol=1e-8)  # the tolerance


@pytest.mark.parametrize("height", [0.07, 0.13, 0.26])
def test_a_contact_struck_at_an_instant_stays_closed_there(height, solver):
    """The floor, declared first, is struck again before the wall, though the impact of the discs
    has moved the first of them off it by the rounding of their distance."""

    class Discs(hy.Automaton):
        q = hy.state(shape=(4,))
        v = hy.state(shape=(4,))

        @hy.mode
        def free(self, t, s):
            return s.v, jnp.array([0.0, -1.0, 0.0, -1.0])

        floor = hy.contact(free, gap=lambda self, t, s: s.q[1], restitution=0.5)
        pair = hy.contact(
            free,
            gap=lambda self, t, s: jnp.hypot(s.q[0] - s.q[2], s.q[1] - s.q[3]) - 0.5,
            restitution=0.5,
        )
        wall = hy.contact(free, gap=lambda self, t, s: 2.0 - s.q[2], restitution=0.5)

    q = [2.0 - np.sqrt(0.25 - height * height), 0.0, 2.0, height]
    start = {"q": q, "v": [1.0, -0.1, 0.0, 0.0]}
    run = hy.simulate(Discs(), start, (0.0, 0.1), **solver)
    assert list(run.jumps.edge[:4]) == ["floor", "pair", "floor", "wall"]
    assert not run.jumps.t[:4].any()


class Tower(hy.Automaton):
    """Three beads above each other fall onto a floor."""

    x = hy.state(shape=(3,))
    v = hy.state(shape=(3,))

    @hy.mode(initial=True)
    def fall(self, t, s):
        return s.v, -9.81 * jnp.ones(3)

    floor = hy.contact(fall, gap=lambda self, t, s: s.x[0], restitution=0.5)
    beads = hy.contact(
        fall,
        gap=lambda self, t, s: s.x[1:] - s.x[:-1],
        restitution=0.5,
        inverse_mass=[1.0, 0.5, 0.25],
    )


def impacts_of_a_tower(count):
    """The first impacts of ``Tower`` from 1, 1.1 and 1.2, with 60 digits: times and contacts. All
    fall alike: between impacts the beads move towards each other steadily."""
    half, last, found = Decimal("0.5"), -1, []
    g, *x = [Decimal(number) for number in (9.81, 1.0, 1.1, 1.2)]  # as doubles have them
    t, v = Decimal(0), [Decimal(0)] * 3
    with localcontext(prec=60):
        while len(found) < count:
            root = abs(v[0]) if last == 0 else (v[0] * v[0] + 2 * g * x[0]).sqrt()
            ways = {0: (v[0] + root) / g}
            for i in (1, 2):
                if i != last and v[i] < v[i - 1]:
                    ways[i] = (x[i] - x[i - 1]) / (v[i - 1] - v[i])
            last = min(ways, key=ways.get)
            h = ways[last]
            t += h
            x = [a + b * h - half * g * h * h for a, b in zip(x, v, strict=True)]
            v = [b - g * h for b in v]
            if last == 0:
                x[0], v[0] = Decimal(0), -half * v[0]
            else:  # the upper bead has twice the mass: two thirds of the impulse move the lower
                x[last], closing = x[last - 1], v[last - 1] - v[last]
                v[last - 1] -= closing
                v[last] += half * closing
            found.append((float(t), ("floor", "beads[0]", "beads[1]")[last]))
    return found


def test_beads_strike_in_their_order_however_low_they_fly(solver):
    """Two beads meet at a height at which one that had come from 1 would be on the floor but for
    rounding; from the floor it has not, and strikes it later."""
    exact = impacts_of_a_tower(116)
    start = {"x": [1.0, 1.1, 1.2], "v": [0.0, 0.0, 0.0]}
    run = hy.simulate(Tower(), start, (0.0, 1.0), **solver)
    assert list(run.jumps.edge[:116]) == [name for _, name in exact]
    # the default tolerance; methods that are exact for a parabola are off by rounding alone
    np.testing.assert_allclose(run.jumps.t[:116], [t for t, _ in exact], rtol=1e-8)
