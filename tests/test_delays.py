"""Delay equations against closed forms and reference values, and the order of the methods."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.delay.memory import Memory
from hybrid.rules.places import NEXT_TO_NOTHING
from models.pyragas import Pyragas

from . import delayed
from .conftest import SOLVERS
from .contract.ways import later, spread
from .delay_truth import HALVING, TRUTHS, unit_lag, unit_lag_kicked

TIGHT = {"rtol": 1e-10, "atol": 1e-12}

#: Errors grow along a run; this much at TIGHT, against the size of what is known.
GROWTH = {"Neves": 1e-8}


def solved(truth, **options):
    model, start = delayed.scalar(truth), truth.value(truth.span[0])
    history = {"y": lambda t: truth.history(math, t)}
    return hy.simulate(model, {"y": start}, truth.span, history=history, **options)


@pytest.mark.parametrize("name", TRUTHS)
@pytest.mark.parametrize("solver", ["DOP853", "taylor"])
def test_closed_forms(name, solver):
    """Ten to a hundred steps at 1e-10 each."""
    truth = TRUTHS[name]
    run = solved(truth, **TIGHT, **SOLVERS[solver])
    for t in np.linspace(*truth.span, 7).tolist():
        assert float(run(t).y) == pytest.approx(truth.value(t), abs=GROWTH.get(name, 2e-9))


@pytest.mark.parametrize("name", TRUTHS)
def test_breaking_points_of_closed_forms(name):
    """Where a derivative jumps a step ends; up to order 5, as the states say to 1e-10."""
    truth = TRUTHS[name]
    run = solved(truth, **TIGHT)
    ends = np.array([truth.span[0], *(s.end + truth.span[0] for s in run.arcs[0].segments)])
    for t in [t for t, order in truth.breaks.items() if order <= 5]:
        assert np.abs(ends - t).min() <= 1e-8  # those that depend on the state, to its error


def test_a_long_wave():
    """y' = -y(t - pi/2) is the cosine; over 100 periods errors of 1e-8 a step add up."""
    run = hy.simulate(
        delayed.Lagged(tau=math.pi / 2),
        {"y": 1.0},
        (0, 200 * math.pi),
        history={"y": math.cos},
        solver="taylor",
    )
    assert run.final.y == pytest.approx(1.0, abs=1e-8)


def test_exact_polynomials_to_rounding(accurate):
    """Methods of order 8 and more are exact on the first polynomials."""
    run = hy.simulate(delayed.Lagged(), {"y": 1.0}, (0, 10), **accurate)
    for t in (0.5, 1.5, 2.5, 6.25, 10.0):
        assert run(t).y == pytest.approx(float(unit_lag(t)), abs=1e-13)


def test_delay_jump(reference, accurate):
    """Right-continuous values around the jump and its echoes, with 40 digits."""
    run = hy.simulate(delayed.Kicked(), {"y": 1.0}, (0, 10), **accurate)
    for row in reference["delay_jump"]["values"]:
        top, _, bottom = row["t"].partition("/")
        t = int(top) / int(bottom or 1)
        assert run(t).y == pytest.approx(float(row["y(t+)"]), abs=1e-13)
        assert float(unit_lag_kicked(t)) == pytest.approx(float(row["y(t+)"]), abs=1e-15)


@pytest.mark.parametrize("case", ["rests", "rests and is released"])
def test_delay_bounce(reference, accurate, case):
    """Impacts, rests and releases; the first release is the end of a lag, exactly."""
    known = reference["delay_bounce"][case]
    model = delayed.Ball(**{name: float(known[name]) for name in ("g", "k", "tau", "r")})
    history = {"y": float(known["history_const"])}
    start = [float(known["y0"]), 0.0]
    run = hy.simulate(model, start, (0, float(known["t_end"])), history=history, **accurate)
    sticks = [float(t) for what, t in known["events"] if what == "stick"]
    lifts = [float(t) for what, t in known["events"] if what == "lift"]
    assert [point.t for point in run.zeno] == pytest.approx(sticks, abs=1e-11)
    found = [point.t_release for point in run.zeno if point.t_release is not None]
    assert found == pytest.approx(lifts, abs=1e-11)
    first = [[float(v) for v in row] for row in known["first_impacts[t,v-]"][:8]]
    assert run.jumps.t[:8].tolist() == pytest.approx([t for t, _ in first], abs=1e-11)
    assert run.jumps.before.v[:8].tolist() == pytest.approx([v for _, v in first], abs=1e-11)


KEPT = "memory kept through impacts, constant history x0 (the delay equation as written)"
RESTARTED = (
    "memory restarted at each impact with constant history 2 "
    "(what an integrator does that is restarted from the impact state)"
)
LIFTED = "C=+60, r=0.2, x0=2.5, constant history, memory kept"


@pytest.mark.parametrize(
    ("solver", "x0"), spread(["DOP853", "taylor", "Dopri8"], ["2.1", "3", "100"])
)
def test_pyragas_with_its_memory_kept_comes_to_rest(reference, solver, x0):
    """Stick times to 1e-9 at rtol 1e-10."""
    known = reference["pyragas"][KEPT][f"x0={x0}"]
    run = hy.simulate(Pyragas(), [float(x0), 0.0], (0, 10), **TIGHT, **SOLVERS[solver])
    assert [point.t for point in run.zeno] == pytest.approx([float(known["stick"])], abs=1e-9)
    times, speeds = zip(*[map(float, row) for row in known["first_impacts"]], strict=True)
    assert run.jumps.t[:8].tolist() == pytest.approx(list(times), abs=1e-9)
    assert run.jumps.before.x2[:8].tolist() == pytest.approx(list(speeds), rel=1e-8)
    assert run.mode == "flight.rest(impact)"


@pytest.mark.parametrize("x0", [2.5, 10.0, *later(3.0, 5.0, 100.0, 200.0)])
def test_pyragas_restarted_is_periodic(reference, x0):
    """The period of Table 1; its multiplier of 0.58 forgets the start in 40 impacts."""
    known = reference["pyragas"][RESTARTED]
    run = hy.simulate(Pyragas(), [x0, 0.0], (0, 90), memory="restart", save="jumps", **TIGHT)
    assert not run.zeno
    assert np.diff(run.jumps.t)[-1] == pytest.approx(float(known["T"]), abs=1e-9)
    assert run.jumps.before.x2[-1] == pytest.approx(float(known["v_pre"]), abs=1e-8)


@pytest.mark.parametrize("side", [-1, 1])
def test_pyragas_restarted_rests_below_a_border(reference, side):
    """Within 1e-9 of the border: chattering below it, periodic above it."""
    border = float(reference["pyragas"][RESTARTED]["boundary between the two, x0"])
    options = {"memory": "restart", "save": "jumps", "max_jumps": 200}
    run = hy.simulate(
        Pyragas(), [border + side * 1e-9, 0.0], (0, 60), rtol=1e-12, atol=1e-12, **options
    )
    assert bool(run.zeno) == (side < 0)


def test_pyragas_sticks_and_lifts(reference, accurate):
    known = reference["pyragas"][LIFTED]
    run = hy.simulate(Pyragas(C=60.0, r=0.2), [2.5, 0.0], (0, 5.2), **accurate)
    sticks, lifts = [list(map(float, known[name])) for name in ("sticks", "lifts")]
    assert [point.t for point in run.zeno] == pytest.approx(sticks, abs=1e-11)
    assert [point.t_release for point in run.zeno] == pytest.approx(lifts, abs=1e-11)


@pytest.mark.parametrize("name", ["RK45", "Radau", "Tsit5", *later("Kvaerno5", "classic")])
def test_other_methods_stick_and_lift_at_the_same_times(reference, name):
    """At rtol 1e-10 methods of order 5 agree to 1e-7 through two rests."""
    known = reference["pyragas"][LIFTED]
    run = hy.simulate(Pyragas(C=60.0, r=0.2), [2.5, 0.0], (0, 3.9), **TIGHT, **SOLVERS[name])
    lifts = [float(t) for t in known["lifts"][:2]]
    assert [point.t_release for point in run.zeno[:2]] == pytest.approx(lifts, abs=1e-7)


# ---------------------------------------------------------------------------------------
# order


class Wright(hy.Automaton):
    """``y' = -1.2 y(t - 0.7) (1 + y)``: its start is a kink, which is seen at 0.7, 1.4, ..."""

    y = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return (-1.2 * past(0.7).y * (1.0 + s.y),)


def slope(error, tolerances):
    """Order by steps: minus the slope of the error's logarithm over that of their number."""
    rows = [error(tolerance) for tolerance in tolerances]
    steps, errors = np.log([[float(v) for v in row] for row in rows]).T
    return -np.polyfit(steps, errors, 1)[0]


@pytest.mark.parametrize(
    ("name", "order", "tolerances"),
    [
        ("DOP853", 8, np.logspace(-6, -11, 8)),
        ("RK45", 5, np.logspace(-5, -10, 8)),
        ("RK23", 3, np.logspace(-4, -8, 8)),
        ("Dopri8", 8, np.logspace(-6, -11, 8)),
        ("Tsit5", 5, np.logspace(-5, -10, 8)),
        ("Bosh3", 3, np.logspace(-4, -8, 8)),
        ("Kvaerno5", 5, np.logspace(-5, -9, 6)),
    ],
)
def test_the_order_is_kept_across_breaking_points(name, order, tolerances):
    """The largest error over a long run falls with the number of steps as without a delay.

    A kink that a step went over would leave order two.
    """
    options = SOLVERS.get(name, {"solver": "diffrax", "method": name})
    times = np.linspace(0.1, 20.0, 67)
    exact = hy.simulate(Wright(), {"y": 1.0}, (0, 20), rtol=1e-14, atol=1e-14, solver="taylor")

    def error(tolerance):
        run = hy.simulate(Wright(), {"y": 1.0}, (0, 20), rtol=tolerance, atol=tolerance, **options)
        return len(run.arcs[0].segments), np.abs(run(times).y - exact(times).y).max()

    assert slope(error, tolerances) >= order - 0.5


def test_lags_that_grow_keep_the_order():
    """y' = -y(t / 2) has polynomials between octaves: a method of order 8 is exact on them."""
    run = solved(HALVING, rtol=1e-6, atol=1e-6)
    assert run.final.y == pytest.approx(HALVING.value(20), abs=1e-9)


# ---------------------------------------------------------------------------------------
# two solvers agree


class Pushed(hy.Automaton):
    """A ball that is pushed by where it was: many impacts a lag, and chaos in the end."""

    y = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        return s.v, -9.81 + 4.0 * jnp.sin(5.0 * past(3.0).y)

    ground = hy.contact("flight", gap=lambda self, t, s: s.y, restitution=0.98)


def test_many_impacts_a_lag():
    """Impacts within 6 lags, 2 or 3 a lag at first: DOP853 and Taylor series to 1e-8."""
    one = hy.simulate(Pushed(), [1.0, 0.0], (0, 18), rtol=1e-12, atol=1e-12)
    other = hy.simulate(Pushed(), [1.0, 0.0], (0, 18), solver="taylor")
    assert len(one.jumps) == len(other.jumps) > 20
    np.testing.assert_allclose(one.jumps.t, other.jumps.t, atol=1e-8)


class Dragged(hy.Automaton):
    """Chattering with r = 0.95 that sees where it was and how fast a lag ago."""

    y = hy.state()
    v = hy.state()
    tau = hy.parameter(0.3)

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        before = past(self.tau)
        return s.v, -9.81 + 0.5 * before.y - 0.2 * before.v

    ground = hy.contact("flight", gap=lambda self, t, s: s.y, restitution=0.95)


@pytest.mark.parametrize("tau", [0.3, 1e-2, *later(1e-4)])
def test_velocities_seen_a_lag_later_chatter_to_one_limit(tau):
    """The velocity's jumps arrive as kinks, hundreds of them: two solvers to 1e-8."""
    options = {"zeno": "stop", "rtol": 1e-11, "atol": 1e-13}
    one = hy.simulate(Dragged(tau=tau), [0.1, 0.0], (0, 9), **options)
    other = hy.simulate(Dragged(tau=tau), [0.1, 0.0], (0, 9), solver="taylor", **options)
    assert one.zeno[0].t == pytest.approx(other.zeno[0].t, abs=1e-8)


class Paired(hy.Automaton):
    """Two balls; the second is pushed by where the first was."""

    y = hy.state(shape=(2,))
    v = hy.state(shape=(2,))

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        return s.v, jnp.array([-1.0, -1.0 + 0.3 * past(0.5).y[0]])

    first = hy.contact("flight", gap=lambda self, t, s: s.y[0], restitution=0.5)
    second = hy.contact("flight", gap=lambda self, t, s: s.y[1], restitution=0.7)


def test_impacts_while_another_contact_rests():
    """The first ball rests while the second chatters on: two solvers to 1e-9."""
    start = {"y": [0.2, 1.0], "v": [0.0, 0.0]}
    one = hy.simulate(Paired(), start, (0, 12), **TIGHT)
    other = hy.simulate(Paired(), start, (0, 12), solver="taylor")
    assert [point.edges for point in one.zeno] == [("first",), ("second",)]
    found = [point.t for point in one.zeno]
    assert found == pytest.approx([point.t for point in other.zeno], abs=1e-9)


class Tossed(hy.Automaton):
    """A ball that sees its place and speed a lag ago, and its place another lag ago."""

    y = hy.state()
    v = hy.state()
    k = hy.parameter(-2.0)
    c = hy.parameter(0.3)
    r = hy.parameter(0.5)
    first = hy.parameter(0.5)
    second = hy.parameter(1.0)

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        one, two = past(self.first), past(self.second)
        return s.v, -1.0 + self.k * one.y + self.c * one.v + 0.5 * jnp.sin(3.0 * two.y)

    ground = hy.contact("flight", gap=lambda self, t, s: s.y, restitution="r")


@pytest.mark.parametrize("memory", ["keep", "restart"])
@pytest.mark.parametrize("seed", [*range(3), *later(*range(3, 8))])
def test_drawn_lags(seed, memory):
    """Lags from 1e-6 to 2, equal, double or at random: two solvers to 1e-7 through impacts."""
    draw = np.random.default_rng(seed)
    first = float(draw.choice([draw.uniform(0.1, 2.0), 10.0 ** draw.uniform(-6, -1)]))
    second = float(draw.choice([first, 2 * first, draw.uniform(0.01, 1.0)]))
    model = Tossed(first=first, second=second, k=draw.uniform(-5, 0.5), r=draw.uniform(0.1, 0.8))
    start, options = [float(draw.uniform(0.05, 1.5)), 0.0], {"memory": memory, "zeno": "stop"}
    one = hy.simulate(model, start, (100, 103), rtol=1e-11, atol=1e-13, **options)
    other = hy.simulate(model, start, (100, 103), rtol=1e-12, solver="taylor", **options)
    assert one.status is other.status
    assert [p.t for p in one.zeno] == pytest.approx([p.t for p in other.zeno], abs=1e-7)
    assert one.final.y == pytest.approx(float(other.final.y), abs=1e-7)


def test_an_impact_just_after_a_window_begins():
    """Two lags, one of them double: a guess that an impact ends at once is no failure."""
    model = Tossed(first=4.522946536544237e-4, second=9.045893073088474e-4)
    run = hy.simulate(model, [1.1962981157030337, 0.0], (100, 104), solver="taylor", rtol=1e-12)
    assert run.status is hy.Status.REACHED_END


class Slides(hy.Automaton):
    """A lag that grows where the start is seen, and does not where the history is."""

    y = hy.state()
    x = hy.state()

    @hy.mode(initial=True)
    def flow(self, t, s, past):
        return 0.0 * s.y, 1.0 + past(0.5 + s.x).y


@pytest.mark.parametrize("solver", ["taylor", "scipy", *later("diffrax")])
def test_a_lag_that_looks_along_a_jump_of_the_record_has_no_way_on(solver):
    """What it sees is led back to the jump from both sides."""
    with pytest.raises(hy.FlowError, match=r"t = 0\.5000.* looks at a jump of the record"):
        hy.simulate(Slides(), [1.0, 0.0], (0.0, 2.0), history={"y": -1.0}, solver=solver)


class Lifted(hy.Automaton):
    """A body on the floor that a force lifts smoothly, and that sees its place a lag ago."""

    x = hy.state()
    v = hy.state()
    g = hy.parameter(3.5895367670496596)
    f = hy.parameter(7.970509225791227)
    c = hy.parameter(21.48415397955616)
    d = hy.parameter(0.4804184990778926)

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        pull = self.c * (past(self.d).x - s.x)
        return s.v, -self.g + pull + self.f * jnp.sin(3.0 * t)

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.2)


@pytest.mark.parametrize("solver", ["taylor", "scipy", *later("diffrax")])
@pytest.mark.parametrize("memory", ["keep", "restart"])
def test_a_smooth_release_happens_once(solver, memory):
    """Where the load is zero, as no past jumps by it: a lag later or not."""
    options = {"mode": "flight.rest(floor)", "memory": memory, "solver": solver, "rtol": 1e-10}
    run = hy.simulate(Lifted(), [0.0, 0.0], (0.0, 0.4557), **options)
    assert run.jumps.edge.tolist() == ["floor.release"]
    assert run.jumps.t[0] == pytest.approx(math.asin(Lifted().g / Lifted().f) / 3.0, rel=1e-12)


@pytest.mark.parametrize("solver", ["taylor", "scipy", *later("diffrax")])
@pytest.mark.parametrize("lag", [0.25, 1.0])
@pytest.mark.parametrize("feels", [0.0, 0.05])
def test_impacts_do_not_shake_a_table_whose_speed_they_do_not_change(solver, lag, feels):
    """So that a lag after the impacts of the ball have accumulated the table that shows the weight
    still holds it; in a run that goes on, too."""
    model, start = delayed.Lift(lag=lag, feels=feels), {"w": 0.0, "y": 0.5, "v": 0.0}
    options = TIGHT | {"solver": solver}
    run = hy.simulate(model, start, (0.0, 5.0), **options)
    (point,) = run.zeno
    assert point.t_release is None
    assert set(run.jumps.edge) == {"table"}
    assert run.final.y == pytest.approx(run(5.0 - lag).w, abs=1e-10)
    first = hy.simulate(model, start, (0.0, 3.2), **options)
    more = hy.simulate(model, first.final, (3.2, 5.0), mode=first.mode, history=first, **options)
    assert len(more.jumps) == 0
    assert more.final.y == pytest.approx(run.final.y, abs=1e-9)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_windows_that_end_at_no_breaking_point_release_nothing(solver):
    """What is seen is a window as accurate as the tolerances, and so is its rate."""
    names = "lag", "r", "first", "second", "third", "one", "two", "three"
    values = 0.35167803074036974, 0.69939903025171, 101.45986307316312, 104.57096479113986
    values += 104.92772453170636, 0.7057563532677678, 0.5185754170373202, -0.057536697715377505
    model = delayed.Ramps(**dict(zip(names, values, strict=True)))
    start = {"y": 1.4464010889186496, "v": -0.7399276871059537}
    start |= {"w": 0.1, "u": -0.7469199450672697}
    run = hy.simulate(model, start, (100.25, 108.25), rtol=1e-10, solver=solver)
    assert [point.t_release for point in run.zeno] == [None]
    assert run.zeno[0].t == pytest.approx(106.489007072713, abs=2e-11)


class Remembers(hy.Automaton):
    """A ball whose gravity changes at each impact; at rest it integrates what it was a lag ago."""

    x = hy.state()
    v = hy.state()
    z = hy.state()
    r: float = hy.parameter(0.6)
    lag: float = hy.parameter(0.2)

    @hy.mode(initial=True)
    def light(self, t, s):
        return s.v, -2.0, 0.0

    @hy.mode
    def heavy(self, t, s):
        return s.v, -3.0, 0.0

    @hy.mode(limit_of=("to_heavy", "to_light"))
    def rest(self, t, s, past):
        return 0.0, 0.0, past(self.lag).v

    @hy.edge(light, to=heavy, guard=lambda self, t, s: s.x)
    def to_heavy(self, t, s):
        return s.replace(v=-self.r * s.v)

    @hy.edge(heavy, to=light, guard=lambda self, t, s: s.x)
    def to_light(self, t, s):
        return s.replace(v=-self.r * s.v)

    def height(self, back):
        """The height at a time before the limit."""
        flights = [(0.0, 1.0, 0.0, 2.0)]
        t, u = 1.0, 2.0 * self.r
        while u > 1e-20:
            force = 5.0 - flights[-1][3]
            flights.append((t, 0.0, u, force))
            t, u = t + 2.0 * u / force, self.r * u
        begin, x, u, force = [own for own in flights if own[0] <= t - back][-1]
        s = t - back - begin
        return x + u * s - 0.5 * force * s * s


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize(("r", "lag"), [(0.5, 0.1), (0.7, 0.3), (0.9, 0.02), (0.95, 0.5)])
def test_jumps_of_a_cycle_are_remembered_up_to_its_limit(solver, r, lag):
    """The limit is known long before; what was a straight line to it was 4e-6 off in ``z``, the
    height that the integral makes good. The flights that are left out take a millionth of the
    longest, 2, and what their speeds of as much integrate to is less than 4e-12."""
    model = Remembers(r=r, lag=lag)
    run = hy.simulate(model, [1.0, 0.0, 0.0], (0.0, 60.0), solver=solver)
    assert run.mode == "rest"
    assert abs(run.final.z + model.height(lag)) < (4e-12 if solver == "taylor" else 1e-8)


class Carried(hy.Automaton):
    """A body on a floor that goes where another state was a lag ago."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    u = hy.state()
    lag: float = hy.parameter(0.3)

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0, s.u, -4.0 * s.y

    floor = hy.contact(flight, gap=lambda self, t, s, past: s.x - past(self.lag).y, restitution=0.3)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_body_has_the_speed_of_its_floor_wherever_the_run_ends(solver):
    """``y = -0.4 cos 2t``, so at rest the speed is ``0.8 sin 2(t - lag)``. The lag added to a place
    and taken off again may leave a rounding of the time, on which nothing shows a rate: the speed
    was 0 at 1 of 20 ends."""
    draw = np.random.default_rng(3)
    start = {"x": 0.4, "v": 0.0, "y": -0.4, "u": 0.0}
    for t in draw.uniform(0.8, 2.2, 60):
        model = Carried(lag=draw.uniform(0.2, 0.5))
        run = hy.simulate(model, start, (0.0, t), solver=solver, rtol=1e-9)
        assert run.mode == "flight.rest(floor)"
        assert run.final.v == pytest.approx(0.8 * np.sin(2 * (t - model.lag)), abs=1e-7)


class Watched(hy.Automaton):
    """A bead on a table that turns fast, and the integral of its height a lag ago."""

    x = hy.state()
    v = hy.state()
    seen = hy.state()
    amplitude: float = hy.parameter(8e-6)
    omega: float = hy.parameter(190.3831)

    @hy.mode
    def flight(self, t, s, past):
        return s.v, -9.81, past(0.1).x

    table = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.amplitude * jnp.sin(self.omega * t + 4.613145),
        restitution=0.289935,
    )

    def integral(self, run, end):
        """Of the height from the start on: of the parabolas between jumps, then of the table."""
        ends = np.append(run.jumps.t, min(run.zeno[0].t, end))
        whole, t, x, v = 0.0, 0.0, 0.202305, 0.0
        for k, until in enumerate(ends):
            s = min(until, end) - t
            whole += x * s + v * s * s / 2 - 9.81 * s**3 / 6
            if until >= end or k == len(run.jumps):
                break
            t, x, v = until, run.jumps[k].after.x, run.jumps[k].after.v
        turned = self.omega * np.array([min(run.zeno[0].t, end), end]) + 4.613145
        return whole - self.amplitude / self.omega * np.diff(np.cos(turned))[0]


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_flights_of_a_sum_are_remembered_as_they_are_made(solver):
    """A flight that takes several series was remembered as a line to the limit, which left 7e-7 of
    the integral out."""
    model, start = Watched(), {"x": 0.202305, "v": 0.0, "seen": 0.0}
    run = hy.simulate(model, start, (0.0, 0.5), solver=solver)
    expected = 0.1 * 0.202305 + model.integral(run, 0.4)
    assert run.final.seen == pytest.approx(expected, abs=1e-12)
    assert expected == pytest.approx(48.99836405773926e-3, abs=1e-13)
    lanes = hy.ensemble(model, {"x": np.array([0.202305]), "v": 0.0, "seen": 0.0}, (0.0, 0.5))
    assert lanes.seen.values[0] == pytest.approx(expected, abs=1e-12)


class Flips(hy.Automaton):
    """A ball whose impacts set ``q`` in turn to 1 and to another value, and an integral of what
    that was a lag ago."""

    x = hy.state()
    v = hy.state()
    q = hy.state()
    seen = hy.state()
    lag: float = hy.parameter(0.3)
    even: float = hy.parameter(-1.0)

    @hy.mode(initial=True)
    def odd_flight(self, t, s, past):
        return s.v, -2.0, 0.0, past(self.lag).q

    @hy.mode
    def even_flight(self, t, s, past):
        return s.v, -2.0, 0.0, past(self.lag).q

    @hy.mode(limit_of=("odd", "last"))
    def rest(self, t, s, past):
        return 0.0, 0.0, 0.0, past(self.lag).q

    @hy.edge(odd_flight, to=even_flight, guard=lambda self, t, s: s.x)
    def odd(self, t, s):
        return s.replace(v=-0.5 * s.v, q=1.0)

    @hy.edge(even_flight, to=odd_flight, guard=lambda self, t, s: s.x)
    def last(self, t, s):
        return s.replace(v=-0.5 * s.v, q=self.even)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize(("lag", "even"), [(0.3, -1.0), (1e-3, 0.25), (2.5, 0.0)])
def test_what_resets_move_up_to_a_limit_is_remembered(solver, lag, even):
    """From height 1 the ball falls for 1, then come flights of 1, 1/2, 1/4, ...: the odd ones take
    4/3 of the 2 until the limit, the others 2/3. Jumps of the last millionth are not remembered one
    by one, and their mean leaves nothing out: with the last value it was 7e-7 off. Sums of some 40
    windows round to 1e-14."""
    start = {"x": 1.0, "v": 0.0, "q": 0.0, "seen": 0.0}
    run = hy.simulate(Flips(lag=lag, even=even), start, (0.0, 3.5 + lag), solver=solver)
    assert run.mode == "rest"
    assert run.final.seen == pytest.approx(4 / 3 + even * (2 / 3 + 0.5), abs=1e-12)


class Echoes(hy.Automaton):
    """A ball that feels how fast it was a lag ago, on a floor that goes where a slow state was."""

    y = hy.state()
    v = hy.state()
    z = hy.state()
    lag: float = hy.parameter(0.5)
    feels: float = hy.parameter(0.05)

    @hy.mode
    def flight(self, t, s, past):
        return s.v, -4.85 + self.feels * past(self.lag).v, -1.7 * s.z - 0.45 * s.y

    floor = hy.contact(
        flight, gap=lambda self, t, s, past: s.y - 0.2 * past(self.lag).z, restitution=0.4
    )


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_corners_that_a_force_sees_do_not_move_the_floor(solver):
    """Windows end at each of the impacts of a lag ago, as the force jumps there, and are as short
    as their flights. The floor's place and speed do not jump, and its acceleration of at most 1 is
    less than gravity: nothing is released."""
    draw = np.random.default_rng(2)
    for _ in range(6):
        model = Echoes(lag=draw.uniform(0.2, 0.6), feels=draw.uniform(-0.1, 0.1))
        start = {"y": draw.uniform(0.5, 1.0), "v": 0.0, "z": draw.uniform(-0.5, 0.5)}
        run = hy.simulate(model, start, (20.0, 24.0), solver=solver)
        assert len(run.zeno) == 1
        assert run.mode == "flight.rest(floor)"
        assert not any("release" in edge for edge in run.jumps.edge)


class Hears(Remembers):
    """One that integrates all the time, so that ``z`` is the way that it fell a lag ago."""

    @hy.mode(initial=True)
    def light(self, t, s, past):
        return s.v, -2.0, past(self.lag).v

    @hy.mode
    def heavy(self, t, s, past):
        return s.v, -3.0, past(self.lag).v

    def limit(self):
        """The time of the limit, and those of the impacts."""
        impacts, t, u, force = [], 1.0, 2.0 * self.r, 3.0
        while u > 1e-20:
            impacts.append(t)
            t, u, force = t + 2.0 * u / force, self.r * u, 5.0 - force
        return t, impacts


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("before", [1e-5, 6e-5, 3e-4])
def test_a_limit_is_not_told_from_turns_before_a_corner(solver, before):
    """Where an impact is seen a lag later, shortly before the limit, what integrates it follows
    another law from there on: the state at the limit was up to 3e-2 off."""
    model = Hears(r=0.6)
    limit, impacts = model.limit()
    model = Hears(r=0.6, lag=limit - before - impacts[1])
    run = hy.simulate(model, [1.0, 0.0, 0.0], (0.0, limit + 0.05), solver=solver, rtol=1e-10)
    assert run.mode == "rest"
    exact = Remembers(r=0.6).height(limit - (run.t1 - model.lag)) - 1.0
    assert abs(run.final.z - exact) < 1e-9


class Sinks(hy.Automaton):
    """A ball over a floor that sinks at a steady rate, as far as it sees."""

    x = hy.state()
    v = hy.state()
    z = hy.state()
    r: float = hy.parameter(0.5)
    rate: float = hy.parameter(-0.07)

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0, self.rate

    floor = hy.contact(flight, gap=lambda self, t, s, past: s.x - past(1.0).z, restitution="r")


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize("r", [0.3, 0.5, 0.8])
def test_a_floor_that_an_impact_moves_off_is_struck_where_it_is_then(solver, r):
    """An impact that forgets the past shows the floor where ``z`` is now, and there it stays until
    the next one: each flight goes lower than it began, so impacts do not come to rest."""
    model, x, v, floor, t = Sinks(r=r), 1.0, 0.0, 0.0, 0.0
    run = hy.simulate(model, [x, v, 0.0], (0.0, 3.0), solver=solver, memory="restart")
    for jump in run.jumps:
        flight = (v + math.sqrt(v * v + 20.0 * (x - floor))) / 10.0
        x, v, t = floor, r * (10.0 * flight - v), t + flight
        floor = model.rate * t
        assert jump.t == pytest.approx(t, abs=1e-7)
    assert t + (v + math.sqrt(v * v + 20.0 * (x - floor))) / 10.0 > 3.0
    assert not run.zeno


class NoLag(hy.Automaton):
    """A ball that sees its speed through a lag that is 0 up to ``since``, and grows then; what it
    sees cancels while the lag is 0."""

    x = hy.state()
    v = hy.state()
    lag: float = hy.parameter(0.0)
    since: float = hy.parameter(0.0)

    @hy.mode
    def flight(self, t, s, past):
        return s.v, -8.0 + past(self.lag * jnp.maximum(t - self.since, 0.0)).v - s.v

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.7)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("lag", [0.0, 0.5])
@pytest.mark.parametrize("t0", [-50.0, 1.0, 30.0, 100.0, 1e4])
def test_a_lag_of_zero_is_the_present_state_up_to_rest(t0, lag, solver):
    """From 0.25 m a ball falls for 0.25 s and rests after ``(1 + r) / (1 - r)`` times that. At the
    end flights are shorter than any guess at what a lag of 0 sees. The speed that is seen is off by
    up to a tenth of ``rtol`` and ``atol`` of 1e-9, as is the time, beside its own rounding."""
    model, rests = NoLag(lag=lag, since=t0 + 1.45), t0 + 0.25 * 1.7 / 0.3
    run = hy.simulate(model, {"x": 0.25, "v": 0.0}, (t0, t0 + 2.0), solver=solver, rtol=1e-9)
    assert run.status is hy.Status.REACHED_END
    assert run.zeno[0].t == pytest.approx(rests, rel=0, abs=1e-8 + 100 * np.spacing(abs(t0)))
    assert tuple(run.final) == (0.0, 0.0)


def test_a_lag_of_nearly_zero_that_cannot_be_seen_through_says_so(monkeypatch):
    """What cannot be found is told with the mode, the lag and a way out, and ends the run."""
    monkeypatch.setattr(Memory, "_read", lambda self: NEXT_TO_NOTHING)
    with pytest.raises(hy.FlowError, match=r"mode flight, t = 0.0, .*the lag .* is 0\.0, .*s\.x"):
        hy.simulate(NoLag(), {"x": 0.25, "v": 0.0}, (0.0, 2.0))


class OnALate(hy.Automaton):
    """A ball on a ball, which it sees 0.45 s late."""

    y = hy.state()
    w = hy.state()
    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s, past):
        return s.w, -5.7, s.v, -11.0

    floor = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.64)
    top = hy.contact(flight, gap=lambda self, t, s, past: s.x - past(0.45).y, restitution=0.5)


@pytest.mark.parametrize("rtol", [1e-6, 1e-8, 1e-10, 1e-12])
def test_what_is_seen_of_the_last_flights_before_a_limit_is_in_its_bound(rtol):
    """The upper ball follows the lower one's impacts to their end. What the record leaves out of
    them has moved all runs alike that were compared, by a root of the tolerances."""
    start = {"y": 0.84, "w": -0.58, "x": 1.87, "v": -0.87}
    run = hy.simulate(OnALate(), start, (0.0, 4.0), rtol=rtol, atol=0.1 * rtol, solver="taylor")
    fast = math.sqrt(0.58**2 + 2.0 * 5.7 * 0.84)
    limit = (fast - 0.58) / 5.7 + 2.0 * 0.64 * fast / (5.7 * 0.36) + 0.45
    assert [point.edges for point in run.zeno] == [("floor",), ("top",)]
    assert abs(run.zeno[1].t - limit) <= run.zeno[1].t_error < 10.0 * rtol + 1e-11


class Sensor(hy.Automaton):
    """A ball, and how long a sensor has shown it in the air, 0.5 s late."""

    y = hy.state()
    w = hy.state()
    shown = hy.state()

    @hy.mode
    def flight(self, t, s, past):
        return s.w, -5.0, jnp.where(past(0.5).y > 0.0, 1.0, 0.0)

    floor = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.6)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12])
def test_a_formula_sees_all_of_the_last_flights_before_a_limit(rtol, solver):
    """It is in the air for ``sqrt(2 h / g) (1 + r) / (1 - r)``, and before the start; what is left
    out lasts ``rtol`` of that."""
    start, history = {"y": 0.5, "w": 0.0, "shown": 0.0}, {"y": 0.5, "w": 0.0, "shown": 0.0}
    options = {"rtol": rtol, "atol": 0.1 * rtol, "solver": solver}
    run = hy.simulate(Sensor(), start, (0.0, 4.0), history=history, **options)
    assert run.final.shown == pytest.approx(4.0 * math.sqrt(0.2) + 0.5, abs=3.0 * rtol + 1e-11)
