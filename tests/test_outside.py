"""Steps of other solvers in the rules' own loop, and methods that are the user's own classes."""

import numpy as np
import pytest
from scipy.integrate import RK45, DenseOutput, OdeSolver, Radau

import hybrid as hy
from hybrid.gallery import find
from hybrid.lowering import scene_of
from hybrid.solvers.scipy_backend import RungeKuttaStepper, SampledStepper, SciPySolver
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring
from tests.contract.test_units import Pile
from tests.contract.ways import later, spread
from tests.test_advance import SCENES

#: Example 1's accumulation, from 40 digits.
T_INF = 1.32961738383844857732


def both(monkeypatch, scene, **options):
    """A run with the loop, and one by one."""
    model, start, span = scene
    run = hy.simulate(model, start, span, **options)
    monkeypatch.setattr(SciPySolver, "asked", False)
    return run, hy.simulate(model, start, span, **options)


@pytest.mark.parametrize(
    ("name", "method"),
    spread(
        ["thermostat", "sections", "hard_spring", "bead_on_table"],
        ["DOP853", "RK45", "Radau", "LSODA"],
        of=2,
    ),
)
def test_the_loop_gives_the_run_of_the_rules_one_by_one(name, method, monkeypatch):
    """Edges in order, times to what the tolerances leave open, modes, accumulations."""
    run, slow = both(monkeypatch, SCENES[name], method=method, rtol=1e-9, atol=1e-11)
    assert [arc.mode for arc in run.arcs] == [arc.mode for arc in slow.arcs]
    assert list(run.jumps.edge) == list(slow.jumps.edge)
    np.testing.assert_allclose(run.jumps.t, slow.jumps.t, rtol=0, atol=1e-5)  # LSODA's own errors
    assert [point.edges for point in run.zeno] == [point.edges for point in slow.zeno]


def test_dense_output_is_the_methods_own(monkeypatch):
    """Between the ends of the steps too: the polynomials are those that the method gives."""
    run, slow = both(monkeypatch, SCENES["thermostat"], rtol=1e-9, atol=1e-11)
    at = np.linspace(0.1, 39.9, 400)
    far = np.array([np.abs(slow.jumps.t - t).min() > 1e-6 for t in at])
    x, y = (np.stack([np.ravel(v) for v in r(at[far])]) for r in (run, slow))
    np.testing.assert_allclose(x, y, rtol=0, atol=1e-7)


@pytest.mark.parametrize("options", [{}, {"solver": "taylor"}, {"method": "Radau"}], ids=str)
@pytest.mark.parametrize("name", ["thermostat", "sections"])
def test_the_state_at_a_jump_is_the_jumps(name, options):
    """At its own time, to the last bit: an arc ends when the jump is, however times round."""
    model, start, span = SCENES[name]
    run = hy.simulate(model, start, span, **options)
    for jump in run.jumps:
        assert run(jump.t, jump.j) == jump.before
        assert run(jump.t, jump.j + 1) == jump.after


@pytest.mark.parametrize(
    ("method", "unit"),
    spread(["Radau", "RK23", "BDF"], [1e-9, 1.0, 1e12, 1e-3, 1e3, 1e6, 1e9]),
)
def test_nothing_falls_through_what_a_step_shows_to_rounding(unit, method):
    """A step that ends on a guard may show it on one side, and the next one on the other."""
    start = dict(
        zip([s.name for s in Pile.spec.states], [1.5 * unit, 2.0 * unit, 0, 0], strict=True)
    )
    given = {"method": method, "rtol": 1e-9, "atol": 1e-11 * unit}
    run = hy.simulate(Pile(unit=unit), start, (0.0, 2.75), **given)
    for arc in run.arcs:
        low, high = arc.last[:2] / unit
        table = np.sin(4.0 * (arc.t0 + arc.length))
        assert low > table - 1e-6  # the tolerance, and what it grows to
        assert high > low - 1e-6


STOPPED = [
    (RungeKuttaStepper, "step", "DOP853"),
    (RungeKuttaStepper, "powers", "DOP853"),
    (SampledStepper, "land", "Radau"),
]


@pytest.mark.parametrize(
    ("stepper", "name", "method", "count"),
    [(*where, count) for where in STOPPED for count in (1, 2, 7)]
    + [(*where, 40) for where in STOPPED[:2]]
    + later((*STOPPED[2], 40)),  # impacts, in steps of Radau's
)
def test_the_keyboard_stops_between_steps(stepper, name, method, count, monkeypatch):
    """What was flown until then is kept, to a state of the run."""
    own, made = getattr(stepper, name), []

    def stop(self, *given):
        made.append(given)
        if len(made) == count:
            raise KeyboardInterrupt
        return own(self, *given)

    model, start, _ = SCENES["duffing"]
    monkeypatch.setattr(stepper, name, stop)
    run = hy.simulate(model, start, (0.0, 300.0), method=method)
    assert run.status is hy.Status.INTERRUPTED
    whole = hy.simulate(model, start, (0.0, run.t1 + 1e-9), method=method)
    assert len(whole.jumps) == len(run.jumps)
    np.testing.assert_allclose(list(run.final), list(whole(run.t1, side="left")), atol=1e-12)


@pytest.mark.parametrize("loop", [True, False])
@pytest.mark.parametrize("count", range(1, 9))
def test_the_keyboard_stops_within_a_step(count, loop, monkeypatch):
    """In a step of SciPy's, the first of an arc too: the run ends where the last one ended."""
    own, made = Radau._step_impl, []

    def stop(solver):
        made.append(solver.t)
        if len(made) == count:
            raise KeyboardInterrupt
        return own(solver)

    monkeypatch.setattr(Radau, "_step_impl", stop)
    monkeypatch.setattr(SciPySolver, "asked", loop)
    run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0), method="Radau")
    assert run.status is hy.Status.INTERRUPTED
    since = run.jumps.t[-1] if len(run.jumps) else 0.0
    assert run.t1 == pytest.approx(since + made[-1], abs=1e-12)


class Line(DenseOutput):
    """Hermite's cubic."""

    def __init__(self, t0, t1, ends, rates):
        super().__init__(t0, t1)
        self.ends, self.rates = ends, rates

    def _call_impl(self, t):
        h = self.t - self.t_old
        s = (np.asarray(t) - self.t_old) / h
        terms = [(1 + 2 * s) * (1 - s) ** 2, s * s * (3 - 2 * s), h * s * (1 - s) ** 2]
        terms.append(h * s * s * (s - 1))
        return sum(
            np.multiply.outer(c, f) for c, f in zip((*self.ends, *self.rates), terms, strict=True)
        )


class Classical(OdeSolver):
    """The classical Runge-Kutta method of order 4, with steps of one length."""

    def __init__(self, fun, t0, y0, t_bound, rtol, atol, first_step=None, vectorized=False):
        super().__init__(fun, t0, y0, t_bound, vectorized)
        self.h = 0.3 * rtol**0.25

    def _step_impl(self):
        h, t, y, f = min(self.h, self.t_bound - self.t), self.t, self.y, self.fun
        a = f(t, y)
        b = f(t + h / 2, y + h / 2 * a)
        c = f(t + h / 2, y + h / 2 * b)
        d = f(t + h, y + h * c)
        self.began, self.t, self.y = (y, a), t + h, y + h / 6 * (a + 2 * b + 2 * c + d)
        return True, None

    def _dense_output_impl(self):
        (y, a), end = self.began, self.fun(self.t, self.y)
        return Line(self.t_old, self.t, (y, self.y), (a, end))


class Mine(RK45):
    """A method of SciPy's, as a class."""


@pytest.mark.parametrize("method", [Classical, Mine])
def test_a_method_may_be_a_class(method):
    """It steps; events, jumps and the sum are ours, and the error is measured."""
    run = hy.simulate(HardSpring(), [2.1, 0.0], (0.0, 5.0), method=method, rtol=1e-9, atol=1e-11)
    (point,) = run.zeno
    assert abs(point.t - T_INF) <= point.t_error < 1e-6
    assert run.options["method"] == method.__name__
    assert run.arcs[-1].mode == "flight.rest(impact)"


def test_a_class_that_cannot_be_made_is_refused():
    """The error names the class, and how it is made."""

    class Strange(OdeSolver):
        def __init__(self):
            pass

    with pytest.raises(hy.OptionError, match=r"Strange.*t_bound"):
        hy.simulate(HardSpring(), [2.1, 0.0], (0.0, 1.0), method=Strange)


@pytest.mark.parametrize("name", ["hard_spring", "coupled", "moon_holmes"])
def test_the_jacobian_is_the_flows(name):
    """Against differences of the flow."""
    scene = scene_of(find(name).cls())
    field, n = scene.field(scene.spec.initial), scene.spec.dimension
    x = np.random.default_rng(0).uniform(0.5, 1.5, n)
    slopes = np.array(field.jacobian(0.3, x.tolist())).reshape(n, n)
    step = 1e-6
    for j in range(n):
        e = step * np.eye(n)[j]
        ends = [np.array(field.rhs(0.3, (x + s * e).tolist())) for s in (1, -1)]
        np.testing.assert_allclose(slopes[:, j], (ends[0] - ends[1]) / (2 * step), atol=1e-7)


def test_a_step_costs_its_stages_and_no_more():
    """Steps end on the wall, and none is made again, nor asked for its dense output, which takes
    three evaluations more: there are twelve for each step, and one where each of three arcs begins,
    two flights before the sum and the rest."""
    run = hy.simulate(HardSpring(), [2.1, 0.0], (0.0, 5.0), save="jumps", method="DOP853")
    assert (run.stats.rejected, len(run.zeno)) == (0, 1)
    assert run.stats.evaluations == 12 * run.stats.steps + 3
