"""The referee, held against closed forms: it decides about others, so it comes first."""

import ast
from pathlib import Path

import pytest
from mpmath import asin, atanh, cos, exp, log, mp, mpf, nsum, pi, sin, sqrt

from . import referee
from .referee import Cycle, Edge, Mode

mp.dps = referee.DIGITS

#: All is computed with 40 digits, steps of 1/16 in order 16; tails are summed from gaps of 1e-9
#: on, whose ratio still changes by the square of that.
EXACT = mpf(10) ** -17


def parabola(g):
    """Motion under gravity."""

    def motion(t0, x0, t):
        s = t - t0
        return [x0[0] + s * (x0[1] - g * s / 2), x0[1] - g * s]

    return motion


def bouncing(g, r):
    """A ball on a floor that may come to rest on it."""
    impact = Edge("impact", "flight", lambda t, x: x[0], lambda t, x: [0, -r * x[1]])
    flight = Mode([impact], motion=parabola(g))
    return {"flight": flight, "rest": Mode(motion=lambda t0, x0, t: x0)}, [
        Cycle(("impact",), {"flight": "rest"}, lambda t, x: [mpf(0), mpf(0)])
    ]


def test_it_shares_no_line_with_what_it_judges():
    """Nothing of ``hybrid`` is imported, by any name."""
    tree = ast.parse(Path(referee.__file__).read_text())
    names = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    names += [a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names]
    assert not [name for name in names if "hybrid" in name or name.startswith(".")]


@pytest.mark.parametrize(("g", "r", "h"), [(9.81, 0.7, 1.0), (2.0, 0.1, 3.0), (1.0, 0.9, 0.01)])
def test_a_ball_comes_to_rest(g, r, h):
    """Each impact, and the limit ``sqrt(2 h / g) (1 + r) / (1 - r)``."""
    modes, cycles = bouncing(mpf(g), mpf(r))
    fall = sqrt(2 * mpf(h) / mpf(g))
    end = fall * (1 + mpf(r)) / (1 - mpf(r))
    out = referee.simulate(modes, "flight", [h, 0.0], (0.0, 1.1 * float(end)), 1 / 64, cycles)
    assert abs(out.limits[0][0] - end) < EXACT
    assert (out.mode, out.x, len(out.limits)) == ("rest", [0, 0], 1)
    for k, (t, *_) in enumerate(out.jumps[:6]):
        exact = fall * (1 + 2 * sum(mpf(r) ** n for n in range(1, k + 1)))
        assert abs(t - exact) < EXACT


def test_small_steps_follow_a_flow():
    """x'' = -x from (1, 0) to 5: no closed form is given, and none is needed."""
    modes = {"free": Mode(flow=lambda t, x: [x[1], -x[0]])}
    out = referee.simulate(modes, "free", [1.0, 0.0], (0.0, 5.0), 1 / 16)
    assert abs(out.x[0] - cos(mpf(5))) < EXACT
    assert abs(out.x[1] + sin(mpf(5))) < EXACT


def test_a_thermostat_switches():
    """Exponentials between 18 and 22."""
    modes = {
        "on": Mode([Edge("hot", "off", lambda t, x: 22 - x[0])], flow=lambda t, x: [30 - x[0]]),
        "off": Mode([Edge("cold", "on", lambda t, x: x[0] - 18)], flow=lambda t, x: [10 - x[0]]),
    }
    out = referee.simulate(modes, "on", [20.0], (0.0, 3.0), 1 / 16)
    times = [log(mpf(10) / 8) + k * log(mpf(12) / 8) for k in range(7)]
    assert [edge for _, edge, _, _ in out.jumps] == ["hot", "cold"] * 3 + ["hot"]
    assert max(abs(j[0] - t) for j, t in zip(out.jumps, times, strict=True)) < EXACT
    assert abs(out.x[0] - (10 + 12 * exp(times[6] - 3))) < EXACT


@pytest.mark.parametrize("inflow", [1.2, 1.5, 1.9])
def test_two_tanks_run_dry_together(inflow):
    """Both leak at 1, the hose brings ``inflow``: the excess is used up at 4 / (2 - inflow)."""
    w = mpf(inflow)
    line = lambda a, b: lambda t0, x0, t: [x0[0] + a * (t - t0), x0[1] + b * (t - t0)]  # noqa: E731
    modes = {
        "first": Mode([Edge("to_second", "second", lambda t, x: x[1] - 5)], motion=line(w - 1, -1)),
        "second": Mode([Edge("to_first", "first", lambda t, x: x[0] - 5)], motion=line(-1, w - 1)),
        "dry": Mode(motion=line(0, 0)),
    }
    cycles = [Cycle(("to_second", "to_first"), {"first": "dry"})]
    end = 4 / (2 - w)
    out = referee.simulate(modes, "first", [8.0, 6.0], (0.0, 45.0), 1 / 8, cycles)
    assert abs(out.limits[0][0] - end) < EXACT
    assert out.mode == "dry"


def test_a_rocking_block_comes_to_rest():
    """Between two edges of its base, by x'' = x -+ a; each strike takes the same share of v."""
    a, r = mpf(0.5), mpf(0.9)

    def rock(sign):
        def motion(t0, x0, t):
            e, f = exp(t - t0), exp(t0 - t)
            off = x0[0] - sign * a
            p, q = (off + x0[1]) / 2, (off - x0[1]) / 2
            return [sign * a + p * e + q * f, p * e - q * f]

        return motion

    strike = lambda t, x: [mpf(0), r * x[1]]  # noqa: E731
    modes = {
        "right": Mode([Edge("to_left", "left", lambda t, x: x[0], strike)], motion=rock(1)),
        "left": Mode([Edge("to_right", "right", lambda t, x: -x[0], strike)], motion=rock(-1)),
        "upright": Mode(motion=lambda t0, x0, t: x0),
    }
    cycles = [Cycle(("to_left", "to_right"), {"right": "upright"})]
    out = referee.simulate(modes, "right", [0.0, 0.4], (0.0, 60.0), 1 / 4, cycles)
    exact = nsum(lambda n: 2 * atanh(r**n * mpf(0.4) / a), [0, mp.inf])
    assert abs(out.limits[0][0] - exact) < EXACT


def test_a_body_is_thrown_off_a_table():
    """At rest on ``sin(4 t)`` it leaves where the table's acceleration is -g, and flies."""
    g, w = mpf(9.8), 4
    rest = Mode(
        [Edge("release", "flight", lambda t, x: g - w * w * sin(w * t))],
        motion=lambda t0, x0, t: [sin(w * t), w * cos(w * t)],
    )
    hit = Edge("impact", "flight", lambda t, x: x[0] - sin(w * t))
    modes = {"rest": rest, "flight": Mode([hit], motion=parabola(g))}
    out = referee.simulate(modes, "rest", [0.0, 4.0], (0.0, 0.5), 1 / 64)
    leaves = asin(g / 16) / 4
    assert [edge for _, edge, _, _ in out.jumps] == ["release"]
    assert abs(out.jumps[0][0] - leaves) < EXACT
    assert out.x[0] > sin(2)


def test_a_piece_of_the_flow_is_no_jump():
    """A force of +1, -1, +1 in turn, by guards that are silent: from x = 1, v = 0 at t = 2 on."""
    push = lambda f: parabola(-mpf(f))  # noqa: E731
    switch = lambda to: Edge("", to, lambda t, x: sin(pi * t), either=True, silent=True)  # noqa: E731
    modes = {
        "up": Mode([switch("down")], motion=push(1)),
        "down": Mode([switch("up")], motion=push(-1)),
    }
    out = referee.simulate(modes, "up", [0.0, 0.0], (0.0, 2.5), 1 / 16)
    assert (len(out.jumps), out.mode) == (0, "up")
    assert abs(out.x[0] - mpf(1.125)) < EXACT
    assert abs(out.x[1] - mpf(0.5)) < EXACT


def test_a_guard_that_a_jump_left_below_zero_fires_at_once():
    """A force begins at t = 1 that lifts a body at rest: it is released there."""
    begin = Edge("", "pulled", lambda t, x: 1 - t, silent=True)
    off = Edge("release", "flight", lambda t, x: mpf(-1))
    modes = {
        "rest": Mode([begin], motion=lambda t0, x0, t: x0),
        "pulled": Mode([off], motion=lambda t0, x0, t: x0),
        "flight": Mode(motion=parabola(mpf(-2))),
    }
    out = referee.simulate(modes, "rest", [0.0, 0.0], (0.0, 2.0), 1 / 16)
    assert [(edge, float(t)) for t, edge, _, _ in out.jumps] == [("release", 1.0)]
    assert abs(out.x[0] - 1) < EXACT


def test_a_guard_that_just_misses_zero_is_told():
    """cos t comes within 1e-3 of a wall at -1.001, and within nothing of one at -1.1."""
    for wall, miss in ((1.001, 1e-3), (1.1, 0.1)):
        hit = Edge("impact", "free", lambda t, x, wall=wall: x[0] + mpf(wall))
        modes = {"free": Mode([hit], motion=lambda t0, x0, t: [cos(t)])}
        out = referee.simulate(modes, "free", [1.0], (0.0, 5.0), 1 / 32)
        assert not out.jumps
        assert float(out.nearest) == pytest.approx(miss, rel=1e-2)  # a parabola through samples


def test_edges_at_one_time_fire_in_declared_order():
    """Two guards that are zero together: the first, then the second at once."""
    first = Edge("first", "run", lambda t, x: 1 - x[0], lambda t, x: [x[0] - 5, x[1]])
    second = Edge("second", "run", lambda t, x: 1 - x[1], lambda t, x: [x[0], x[1] - 5])
    line = lambda t0, x0, t: [x0[0] + (t - t0), x0[1] + (t - t0)]  # noqa: E731
    modes = {"run": Mode([first, second], motion=line)}
    out = referee.simulate(modes, "run", [0.0, 0.0], (0.0, 2.0), 1 / 4)
    assert [(edge, float(t)) for t, edge, _, _ in out.jumps] == [("first", 1.0), ("second", 1.0)]
