"""The sum of infinitely many impacts: its algebra, the laws that it reads, and what it gives."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from numpy.polynomial import chebyshev

import hybrid as hy
from hybrid.lowering import scene_of
from hybrid.rules import flights, sums, unit
from hybrid.rules.load import Library
from hybrid.rules.sums import FORCE_SAMPLES, MOST_DEGREE, POINTS_EACH, STRETCH_FLIGHTS
from hybrid.segment import from_values, nodes
from hybrid.zeno import accumulate, close
from hybrid.zeno.flight import fly
from models.hard_spring import HardSpring

EPS = 2.0**-52


@pytest.fixture(params=["machine", "checked"])
def rules(request, monkeypatch):
    """The rules of a file, as machine code or as Python that refuses indices below zero."""
    if request.param == "machine":
        return unit
    monkeypatch.setenv("HYBRID_RULES", "checked")
    return Library("hybrid.rules").unit


# ---------------------------------------------------------------------------------------
# polynomials


@pytest.mark.parametrize("degree", [1, 2, 5, 11, MOST_DEGREE])
def test_values_become_coefficients(rules, degree):
    """A cosine sum is the inverse of the matrix of Chebyshev polynomials at the points."""
    to, w = np.full((MOST_DEGREE + 1, MOST_DEGREE + 1), np.nan), np.full(MOST_DEGREE + 1, np.nan)
    rules("chebyshev").from_values(degree, to)
    rules("chebyshev").nodes(degree, w)
    # from_values of hybrid.segment inverts a matrix, with a condition below 10
    assert to[: degree + 1, : degree + 1] == pytest.approx(from_values(degree), abs=20 * EPS)
    assert np.all(np.abs(w[: degree + 1] - nodes(degree)) <= EPS)


def test_polynomials_side_by_side_have_their_values(rules):
    """At points in and around [0, 1], as numpy has them."""
    c = np.random.default_rng(1).normal(size=(MOST_DEGREE + 1, 3))
    line, found = np.empty(MOST_DEGREE + 1), np.empty(3)
    for w in (0.0, 1e-9, 0.3, 0.77, 1.0):
        rules("chebyshev").evaluate(c, MOST_DEGREE, w, line, found)
        exact = chebyshev.chebval(2 * w - 1, c)
        one = [rules("chebyshev").value(c, MOST_DEGREE, j, w) for j in range(3)]
        # 17 terms of size 1; the recurrence carries an error of a spacing 16 times
        assert found == pytest.approx(exact, abs=300 * EPS)
        assert one == pytest.approx(exact, abs=300 * EPS)


@pytest.mark.parametrize("r", [1 - 1e-11, 1 - 1e-3, 0.5, 0.01])
def test_differences_lose_no_digits_where_the_ratio_is_near_one(rules, r):
    """``T_k(2 r w - 1) - T_k(2 w - 1)`` to relative accuracy, in 40 digits' reckoning."""
    line = np.empty(MOST_DEGREE + 1)
    for w in nodes(MOST_DEGREE)[1:].tolist():
        rules("chebyshev").differences(MOST_DEGREE, r, w, line)
        with mp.workdps(40):
            a, b = 2 * mp.mpf(r) * w - 1, 2 * mp.mpf(w) - 1
            exact = [float(mp.chebyt(k, a) - mp.chebyt(k, b)) for k in range(MOST_DEGREE + 1)]
        # each is at most k^2 times the step, which is the scale of their rounding
        step = 2 * (1 - r) * w
        assert np.abs(line - exact).max() <= 4 * MOST_DEGREE**3 * EPS * step


# ---------------------------------------------------------------------------------------
# equations


def test_equations_are_solved_for_many_right_sides(rules):
    """17 unknowns, 9 right sides, a zero on the diagonal: what is left is rounding."""
    draw = np.random.default_rng(2)
    a, b = draw.normal(size=(17, 17)), draw.normal(size=(17, 9))
    a[0, 0] = 0.0
    x = b.copy()
    assert rules("linear").solve(a.copy(), 17, x, 9)
    assert np.abs(a @ x - b).max() <= 100 * EPS * (np.abs(a) @ np.abs(x)).max()


def test_equations_without_a_solution_are_told(rules):
    """A row twice, or a number that is none."""
    for row in ([1.0, 2.0], [np.nan, 2.0]):
        assert not rules("linear").solve(np.array([row, row]), 2, np.ones((2, 1)), 1)


def test_a_fit_leaves_what_no_polynomial_gives(rules):
    """The rest of a fit as numpy's, and none of a polynomial of the degree, but for rounding."""
    w = np.linspace(0.0, 1.0, FORCE_SAMPLES) ** 2
    basis = chebyshev.chebvander(2 * w - 1, MOST_DEGREE)
    within, beyond = basis @ np.linspace(1.0, 2.0, MOST_DEGREE + 1), np.abs(w - 0.4)
    fitted = basis @ np.linalg.lstsq(basis, beyond, rcond=None)[0]
    for values, exact in ((within, 0.0 * w), (beyond, beyond - fitted)):
        rest = values.copy()
        rules("linear").unfitted(basis.copy(), FORCE_SAMPLES, MOST_DEGREE + 1, rest)
        assert np.abs(rest - exact).max() <= 1e3 * EPS * np.abs(values).max()


def test_a_fit_of_powers_keeps_its_digits(rules):
    """A condition of 1e12: the product of the matrix with itself would leave nothing of it."""
    w = np.linspace(0.0, 1.0, FORCE_SAMPLES)
    powers = np.ascontiguousarray(np.vander(w, MOST_DEGREE + 1, increasing=True))
    assert np.linalg.cond(powers) > 1e11
    rest = powers @ np.ones(MOST_DEGREE + 1)
    size = np.abs(rest).max()
    rules("linear").unfitted(powers, FORCE_SAMPLES, MOST_DEGREE + 1, rest)
    assert np.abs(rest).max() <= 1e3 * EPS * size


# ---------------------------------------------------------------------------------------
# what happens at a contact


class Tilted(hy.Automaton):
    """A body before a moving slope, and a floor on which it may lie."""

    x = hy.state()
    y = hy.state()
    vx = hy.state()
    vy = hy.state()
    a: float = hy.parameter(0.3)

    @hy.mode
    def flight(self, t, s):
        return s.vx, s.vy, -0.1 * s.vx * jnp.abs(s.vy), -1.0 + 0.2 * s.x

    slope = hy.contact(
        flight,
        gap=lambda self, t, s: s.x + self.a * jnp.sin(s.y) + 0.1 * jnp.cos(t),
        restitution=lambda self, t, s, u: 0.5 + 0.1 * jnp.tanh(s.y * u) - 0.01 * t,
        inverse_mass=lambda self, t, s: jnp.array([1.0, 2.0 + s.y**2]),
    )
    floor = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.4)


def test_tapes_of_a_contact_are_its_laws():
    """Landing, impulse, gap speed and acceleration, restitution: also where another is held."""
    scene, t, u = scene_of(Tilted()), 0.7, -0.6
    x, contact = [0.2, 0.5, -0.3, 0.1], scene_of(Tilted()).contact("slope")
    for name in ("flight", "flight.rest(floor)"):
        field = scene.field(name)
        guard = field.guards[field.column("slope")]
        given = [(x, contact.land(t, x)), (x, [*contact.push(t, x), *guard.lie(t, x)[1:]])]
        given.append(([*x, u], [contact.law(t, x, u)]))
        for part, (at, exact) in zip(field.at_contact("slope"), given, strict=True):
            assert read(part, t, at) == pytest.approx(list(exact), rel=1e-13)


def read(part, t, x):
    """The values of a program."""
    tape, out = part.tape, np.empty(len(part.output))
    sides, c = np.zeros(len(tape.kinks), dtype=np.int64), np.empty((tape.rows, 1))
    work = np.empty(tape.room)
    assert unit("jets").values(part.alone, 0, t, np.array(x), sides, c, work, out) == 0
    return out.tolist()


def law(restitution):
    """A falling ball with a restitution of one's own."""

    class Ball(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.v, -1.0 + 0.0 * s.x

        impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=restitution)

    return Ball()


def times(restitution):
    """When the impacts of a ball from height 1 accumulate, impact by impact in 40 digits."""
    with mp.workdps(40):
        t = v = mp.sqrt(2)
        while v > mp.mpf(10) ** -38:
            v = restitution(t, v) * v
            t += 2 * v
        return float(t)


@pytest.mark.parametrize(
    ("given", "exact"),
    [
        (lambda self, t, s, u: 0.5 + 0.05 * t, lambda t, v: mp.mpf(0.5) + mp.mpf(0.05) * t),
        (lambda self, t, s, u: 0.7 / (1 - 0.1 * u), lambda t, v: mp.mpf(0.7) / (1 + v / 10)),
    ],
    ids=["of time", "of speed"],
)
def test_a_restitution_that_changes_is_summed_to_rounding(given, exact):
    """The flight from the first impact counts with the ratio at the limit, not with its own."""
    point = hy.simulate(law(given), [1.0, 0.0], (0.0, 9.0), solver="taylor", rtol=1e-10).zeno[0]
    truth = times(exact)
    # what the run before the sum makes of 1e-10 is far less: gravity is a polynomial
    assert abs(point.t - truth) <= min(point.t_error, 1e-12 * truth)


@pytest.mark.parametrize(
    ("given", "exact"),
    [
        (lambda self, t, s, u: jnp.minimum(0.6, 0.5 * jnp.abs(u) ** -0.25), 0.6),
        (lambda self, t, s, u: jnp.clip(jnp.log(-u) / u, 0.0, 0.6), 0.6),
        (lambda self, t, s, u: 0.6 - 0.1 * jnp.exp(-9.0 / (u * u)), 0.6),
        (lambda self, t, s, u: 0.6 + 0.0 * jax.scipy.special.gammaln(2.0 - u), 0.6),
    ],
    ids=["power", "logarithm", "pulse", "no recurrence"],
)
def test_a_restitution_with_a_pole_at_rest_is_summed(given, exact):
    """What it is at rest is its limit; only its values count, not its series."""
    scene = scene_of(law(given))
    field, x = scene.field("flight"), np.array([0.0, 1e-2])
    tail = close(field, scene.contact("impact"), 0, 1.0, 0.0, x, 1e-2, 1e-9, 1e-12)
    assert tail is not None
    # flights of 2 v: 2 v / (1 - r)
    assert tail.remaining == pytest.approx(2e-2 / (1 - exact), rel=1e-12)


class Shaken(hy.Automaton):
    """A ball above a table that shakes, in air."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0 - 0.1 * s.v

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x - 0.1 * jnp.sin(t), restitution=lambda self, t, s, u: 0.5
    )


def test_checked_rules_sum_the_same(monkeypatch):
    """No index is below zero, and the sum is that of the machine code but for rounding."""
    scene = scene_of(Shaken())
    field, contact, x = scene.field("flight"), scene.contact("impact"), np.array([0.1, 0.1])
    x[0] *= np.sin(1.0)
    given = 0, 1.0, 0.0, x, 0.1 - 0.1 * np.cos(1.0), 1e-9, 1e-12
    tail = close(field, contact, *given)
    monkeypatch.setenv("HYBRID_RULES", "checked")
    monkeypatch.setattr(accumulate, "unit", Library("hybrid.rules").unit)
    same = close(field, contact, *given)
    assert same.curve.shape == tail.curve.shape
    assert same.remaining == pytest.approx(tail.remaining, rel=1e-14)
    assert same.x_inf == pytest.approx(tail.x_inf, rel=1e-14, abs=1e-16)
    # a bound is made of what rounding leaves of a change
    assert same.t_error == pytest.approx(tail.t_error, rel=0.5)


def test_points_shown_of_a_tail_are_on_its_flights(rules, monkeypatch):
    """Those that Taylor series fly from the curve, but for what a cubic leaves; with bounds."""
    scene = scene_of(Shaken())
    field, contact, x = scene.field("flight"), scene.contact("impact"), np.array([0.1, 0.1])
    x[0] *= np.sin(1.0)
    tail = close(field, contact, 0, 1.0, 0.0, x, 0.1 - 0.1 * np.cos(1.0), 1e-9, 1e-12)
    monkeypatch.setattr(accumulate, "unit", rules)
    *points, least, most = tail.shown(1.0, 0.2, 0.0, 1.0)
    assert np.array_equal(least, np.min(points, axis=0))
    assert np.array_equal(most, np.max(points, axis=0))
    for k, w in enumerate(np.linspace(0.2, 1.0, STRETCH_FLIGHTS).tolist()):
        since, x, v = tail.point(w)
        flight = fly(field, 0, 1.0 + since, x.tolist(), v)
        (whole,) = flight.segments()
        for i, share in enumerate(np.linspace(0.0, 1.0, POINTS_EACH).tolist()):
            t, *state, speed, begin, end = points[POINTS_EACH * k + i]
            # the curve is known to 1e-9 of the tail, which is twice the flight at most
            assert t - 1.0 - since == pytest.approx(share * flight.time, abs=1e-9)
            assert [begin - 1.0 - since, end - begin] == pytest.approx([0, flight.time], abs=1e-9)
            assert speed == pytest.approx(flight.u, abs=1e-8)
            # a cubic leaves h^4 / 384 of the fourth derivative, which is 0.01, and h is 0.1
            assert state == pytest.approx(whole(share * flight.time), abs=1e-8)


class Spring(hy.Automaton):
    """A body on a hard spring before a wall, in a unit of time; beside it what moves by itself."""

    x = hy.state()
    v = hy.state()
    fading = hy.state()
    unit: float = hy.parameter(1.0, positive=True)

    @hy.mode
    def flight(self, t, s):
        u, speed = self.unit, s.v * self.unit
        return s.v, (-jnp.cos(speed) - s.x**3) / u**2, -s.fading / u

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - 2.0, restitution=0.8)


class Alone(hy.Automaton):
    """The same with nothing beside it."""

    x = hy.state()
    v = hy.state()
    r: float = hy.parameter(0.8)
    unit: float = hy.parameter(1.0, positive=True)

    @hy.mode
    def flight(self, t, s):
        return s.v, (-jnp.cos(s.v * self.unit) - s.x**3) / self.unit**2

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - 2.0, restitution="r")


def summed(model, speed, rtol, *beside):
    """The sum from an impact before the wall at 2."""
    scene = scene_of(model)
    field, contact = scene.field("flight"), scene.contact("impact")
    return close(field, contact, 0, 0.0, 0.0, np.array([2.0, speed, *beside]), speed, rtol, rtol)


def test_states_that_move_by_themselves_do_not_delay_a_sum():
    """A flight is then not the same from each place on the curve, which the turns must follow."""
    tail, alone = summed(Spring(), 0.1, 1e-9, 1.0), summed(Alone(), 0.1, 1e-9)
    assert tail is not None
    # each is known to a thousandth of the tolerance, and better
    assert tail.remaining == pytest.approx(alone.remaining, rel=1e-12)
    assert tail.x_inf[2] == pytest.approx(np.exp(-tail.remaining), rel=1e-12)


@pytest.mark.parametrize("r", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("speed", [1.2, 0.8, 0.3, 0.01])
def test_bounds_of_a_sum_hold_what_more_points_change(r, speed):
    """Where points are added until the last coefficients are small enough."""
    exact = summed(Alone(r=r), speed, 1e-15)
    for rtol in (1e-5, 1e-7, 1e-9):
        tail = summed(Alone(r=r), speed, rtol)
        assert abs(tail.remaining - exact.remaining) <= tail.t_error + exact.t_error
        assert tail.t_error <= 1e-2 * rtol * tail.remaining
    assert exact.t_error <= 1e-13 * exact.remaining / (1 - r)


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-8, 1e-12])
def test_a_flight_that_nothing_moves_is_made_once(rtol, monkeypatch):
    """One for each point, and one for each probe: what its last terms leave is no odd force."""
    made = []
    monkeypatch.setenv("HYBRID_RULES", "python")
    monkeypatch.setattr(accumulate, "unit", Library("hybrid.rules").unit)
    monkeypatch.setattr(sums, "fly", lambda *a: made.append(flights.fly(*a)) or made[-1])
    tail = summed(Alone(), 0.8, rtol)
    assert len(made) == len(tail.curve) - 1 + len(sums.PROBES)


def test_a_sum_is_the_same_in_a_unit_in_which_high_orders_overflow():
    """A unit of 1e14 times: coefficients of order 24 are up to 1e340."""
    tail, small = summed(Alone(), 0.5, 1e-9), summed(Alone(unit=1e-14), 0.5e14, 1e-9)
    # the flights are of other orders, to the same accuracy
    assert small.remaining == pytest.approx(1e-14 * tail.remaining, rel=1e-12)


@pytest.mark.parametrize(("start", "r"), [(2.3, 0.8), (2.4, 0.8), (2.49, 0.98)])
def test_sums_from_high_flights_are_seen_without_watching_steps(start, r):
    """Nothing hides in Example 1, from its first flights on: each is a step or two, up to the sum.

    Where bounds along a tail are too coarse to tell, all later steps are held against the flow, and
    a flight takes four of them.
    """
    model, options = HardSpring(r=r), {"solver": "taylor", "rtol": 1e-9}
    run = hy.simulate(model, {"x": start, "v": 0.0}, (0.0, 40.0), **options)
    assert run.zeno[0].verdict == "certified"
    assert run.stats.steps <= 12


@pytest.mark.parametrize(("ratio", "fade"), [(0.6, 0.1), (0.3, -0.1), (0.8, 0.3)])
def test_speeds_before_summed_impacts_are_those_after_the_ones_before(ratio, fade):
    """Under a constant force a body comes back as fast as it left, also where the restitution
    depends on that speed."""

    class Fading(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def fly(self, t, s):
            return s.v, -9.8

        impact = hy.contact(
            fly,
            gap=lambda self, t, s: s.x,
            restitution=lambda self, t, s, u: ratio * jnp.exp(fade * u),
        )

    run = hy.simulate(Fading(), {"x": 1.0, "v": 0.0}, (0.0, 8.0), solver="taylor")
    before, after = run.jumps.before.v, run.jumps.after.v
    size = np.abs(after[:-1])
    assert len(run.zeno) == 1
    # each is known to what the sum leaves of its interpolated speeds
    assert np.all(np.abs(before[1:] + after[:-1]) <= 1e-9 * size)
