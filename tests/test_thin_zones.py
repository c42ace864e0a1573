"""The bound on an accumulation's time holds where a force acts in a narrow zone of the state.

A ball falls through a thin layer; its speed beyond follows from the work done there, its time by
quadrature with 40 digits.
"""

import math

import jax.numpy as jnp
import mpmath as mp
import pytest

import hybrid as hy

from .contract.ways import spread

G = 9.81

#: Widths, the work done over twice the mass, and where the layer and the floor are.
WIDTHS = [10.0**-k for k in range(3, 10)]
SHARES = [0.7, 1.9, -3.0]
NEAR, FAR = [(0.5, 0.0), (0.3, 0.0)], (1000.5, 1000.0)


class Layer(hy.Automaton):
    """A force within ``w`` of a place that moves steadily."""

    x = hy.state()
    v = hy.state()
    w: float = hy.parameter(0.01)
    force: float = hy.parameter(100.0)
    c: float = hy.parameter(0.5)
    floor: float = hy.parameter(0.0)
    rate: float = hy.parameter(0.0)
    r: float = hy.parameter(0.3)

    @hy.mode
    def fall(self, t, s):
        inside = jnp.abs(s.x - self.c - self.rate * t) < self.w
        return s.v, -G + jnp.where(inside, self.force, 0.0)

    impact = hy.contact(fall, gap=lambda self, t, s: s.x - self.floor, restitution="r")


class Bell(Layer):
    """The same work done by a smooth pulse."""

    @hy.mode
    def fall(self, t, s):
        z = (s.x - self.c) / self.w
        return s.v, -G + 2.0 / jnp.sqrt(jnp.pi) * self.force * jnp.exp(-z * z)

    impact = hy.contact(fall, gap=lambda self, t, s: s.x - self.floor, restitution="r")


class Tailed(Layer):
    """A pulse that is felt from afar."""

    @hy.mode
    def fall(self, t, s):
        z = (s.x - self.c) / self.w
        return s.v, -G + self.force / (1.0 + z * z)

    impact = hy.contact(fall, gap=lambda self, t, s: s.x - self.floor, restitution="r")


@pytest.fixture(autouse=True)
def digits():
    """Truth is known to 40 of them."""
    with mp.workdps(40):
        yield


def bounces(speed, r):
    """How long a ball that strikes the floor bounces below the layer."""
    return 2 * r * speed / (mp.mpf(G) * (1 - mp.mpf(r)))


def through(speed, height, a):
    """Time of a flight up through a height under a force, and the speed left; or until it turns."""
    if speed**2 <= 2 * a * height:
        return speed / a, mp.mpf(0)
    new = mp.sqrt(speed**2 - 2 * a * height)
    return (speed - new) / a, new


def fallen(speed, height, a):
    """Time and speed after a fall through a height under a force."""
    new = mp.sqrt(speed**2 + 2 * a * height)
    return (new - speed) / a, new


def layer_ends(model):
    """Parabolas above, in and below the layer; seen from a layer that moves, the floor does."""
    t, u, g, rate = mp.mpf(0), mp.mpf(0), mp.mpf(G), mp.mpf(model.rate)
    c, w, floor = mp.mpf(model.c), mp.mpf(model.w), mp.mpf(model.floor)
    start = floor + 1
    s, fast = fallen(rate, start - c - w, g)
    t, u = t + s, fast
    s, u = fallen(u, 2 * w, g - mp.mpf(model.force))
    t = t + s
    s, u = fallen(u - rate, c + rate * t - w - floor, g)
    t, r = t + s, mp.mpf(model.r)
    while (r * u) ** 2 > 2 * g * (c - w - floor):
        assert not model.rate
        u, left = r * u, r * u
        for height, a in ((c - w - floor, g), (2 * w, g - mp.mpf(model.force)), (floor + 9, g)):
            s, left = through(left, height, a)
            t += 2 * s
    return t + bounces(u, model.r)


def bell_ends(model):
    """Parabolas above and below, as the pulse is 1e-63 at 12 widths; between them by quadrature."""
    c, w, floor = mp.mpf(model.c), mp.mpf(model.w), mp.mpf(model.floor)
    g, work = mp.mpf(G), mp.mpf(model.force) * w
    t, u = fallen(mp.mpf(0), floor + 1 - c - 12 * w, g)

    def speed(z):
        return mp.sqrt(u * u + 2 * g * w * (12 - z) - 2 * work * (1 - mp.erf(z)))

    t += w * mp.quad(lambda z: 1 / speed(z), mp.linspace(-12, 12, 9))
    s, u = fallen(speed(-12), c - 12 * w - floor, g)
    return t + s + bounces(u, model.r)


def tailed_ends(model):
    """All by quadrature: the speeds at the floor fall by ``r``, as the force has a potential."""
    c, w, floor = mp.mpf(model.c), mp.mpf(model.w), mp.mpf(model.floor)

    def energy(x):
        return mp.mpf(G) * x - mp.mpf(model.force) * w * mp.atan((x + floor - c) / w)

    def time(top):
        middle = [mp.sqrt(top - (c - floor) + k * w) for k in (-30, -3, 0, 3, 30)]
        return mp.quad(
            lambda s: slowness(top, s),
            [0, *(m for m in middle if top > c - floor + 30 * w), mp.sqrt(top)],
        )

    def slowness(top, s):
        with mp.workdps(150):  # near the top heights differ by the square of a small number
            return 2 * s / mp.sqrt(2 * (energy(top) - energy(top - s * s)))

    total, u = time(mp.mpf(1)), mp.sqrt(2 * (energy(mp.mpf(1)) - energy(mp.mpf(0))))
    while u > 1e-9:
        u *= mp.mpf(model.r)
        top = mp.findroot(lambda h, u=u: energy(h) - energy(mp.mpf(0)) - u * u / 2, u * u / 2 / G)
        total += 2 * time(top)
    return total + bounces(u, model.r)


def holds(model, exact, solver="taylor", **options):
    """The bound covers the error."""
    span = (0.0, float(exact) + 0.1)
    run = hy.simulate(model, [model.floor + 1.0, 0.0], span, solver=solver, **options)
    (point,) = run.zeno
    assert abs(mp.mpf(point.t) - exact) <= point.t_error


@pytest.mark.parametrize(("w", "share", "place"), spread(WIDTHS, SHARES, NEAR))
def test_the_bound_covers_the_rounding_of_the_edges(place, share, w):
    """Each edge is a place of its own on the floats, the same in all runs."""
    c, floor = place
    model = Layer(w=w, force=share / w, c=c, floor=floor)
    holds(model, layer_ends(model))


@pytest.mark.parametrize("w", WIDTHS[:5])
@pytest.mark.parametrize("share", SHARES)
def test_the_bound_covers_the_rounding_of_edges_far_off(share, w):
    """A thousand times coarser; zones of less than 1e-7 are some thousand floats wide."""
    model = Layer(w=w, force=share / w, c=FAR[0], floor=FAR[1])
    holds(model, layer_ends(model))


@pytest.mark.parametrize("w", WIDTHS[::3])
@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("rate", [0.3, -0.2])
def test_the_bound_covers_the_rounding_of_edges_that_move(rate, share, w):
    """That of the time as well."""
    model = Layer(w=w, force=share / w, rate=rate)
    holds(model, layer_ends(model))


@pytest.mark.parametrize(("w", "share", "place"), spread(WIDTHS[1::2], SHARES[::2], [*NEAR, FAR]))
def test_the_bound_covers_the_rounding_of_a_smooth_pulse(place, share, w):
    """It does not end at any place, but is as narrow."""
    c, floor = place
    model = Bell(w=w, force=share / w, c=c, floor=floor)
    holds(model, bell_ends(model))


@pytest.mark.parametrize(("share", "w"), spread([0.7, -3.0], WIDTHS[::3], of=2))
def test_the_bound_covers_a_pulse_with_tails(share, w):
    """Felt in all flights."""
    model = Tailed(w=w, force=share / w, r=0.1)
    holds(model, tailed_ends(model))


@pytest.mark.parametrize(("share", "w"), spread([0.3, -0.4], WIDTHS[::3], of=2))
def test_the_bound_covers_a_layer_that_is_crossed_again_and_again(share, w):
    """Upwards and downwards: what rounding does one way it need not undo the other."""
    model = Layer(w=w, force=share / w, r=0.9)
    holds(model, layer_ends(model))


@pytest.mark.parametrize("w", WIDTHS[::2])
@pytest.mark.parametrize("rtol", [1e-6, 1e-12])
def test_the_bound_covers_a_layer_that_a_method_steps_over(rtol, w):
    """DOP853 does not look at what is between its points."""
    model = Layer(w=w, force=0.7 / w)
    holds(model, layer_ends(model), "scipy", method="DOP853", rtol=rtol)


class Pulsed(hy.Automaton):
    """A bouncing ball that is lifted by a short pulse."""

    x = hy.state()
    v = hy.state()
    c: float = hy.parameter(1.0)
    w: float = hy.parameter(0.01)
    r: float = hy.parameter(0.5)

    @hy.mode
    def fall(self, t, s):
        z = (t - self.c) / self.w
        return s.v, -1.0 + 0.3 * jnp.exp(-z * z)

    impact = hy.contact(fall, gap=lambda self, t, s: s.x, restitution="r")


def pulsed(r, c, w, impacts):
    """Times of the impacts of a ball thrown up with speed 1, and of their limit."""

    def height(t0, v, s):
        z, begin = (t0 + s - c) / w, (t0 - c) / w
        twice = [u * mp.erf(u) + mp.exp(-u * u) / mp.sqrt(mp.pi) for u in (z, begin)]
        once = w * (twice[0] - twice[1]) - s * mp.erf(begin)
        return v * s - s * s / 2 + 0.3 * mp.sqrt(mp.pi) / 2 * w * once

    t, v, times = mp.mpf(0), mp.mpf(1), []
    for _ in range(impacts):
        length = mp.findroot(
            lambda s, t=t, v=v: height(t, v, s), (1.6 * v, 4 * v), solver="anderson"
        )
        after = -r * mp.diff(lambda s, t=t, v=v: height(t, v, s), length)
        t, v = t + length, after
        times.append(t)
    return times, t + 2 * v / (1 - r)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.995])
@pytest.mark.parametrize(("r", "n"), [(0.2, 3), (0.5, 3), (0.5, 8), (0.8, 4)])
def test_no_sum_of_impacts_passes_over_a_pulse(r, n, share):
    """A pulse at a share of the flight after an impact, where a look at some points may meet it."""
    with mp.workdps(40):
        length, width = 2 * mp.mpf(r) ** n, mp.mpf(r) ** n / 500
        c = 2 * (1 - mp.mpf(r) ** n) / (1 - mp.mpf(r)) + share * length
        times, limit = pulsed(mp.mpf(r), c, width, n + 60)
    model = Pulsed(c=float(c), w=float(width), r=r)
    run = hy.simulate(model, {"x": 0.0, "v": 1.0}, (0.0, 3.0 / (1.0 - r)), solver="taylor")
    # without the pulse the next impact is off by a thousandth of its flight; Taylor series leave
    # some thousand roundings of the time
    assert run.jumps.t[: n + 2] == pytest.approx([float(t) for t in times[: n + 2]], abs=1e-12)
    assert run.zeno[0].t == pytest.approx(float(limit), abs=1e-12)


class Brushed(hy.Automaton):
    """A bouncing ball that is lifted by a faint and short pulse, with tails of the fourth order."""

    x = hy.state()
    v = hy.state()
    c: float = hy.parameter(1.0)
    w: float = hy.parameter(0.01)
    lift: float = hy.parameter(0.02)
    r: float = hy.parameter(0.5)

    @hy.mode
    def fall(self, t, s):
        z = (t - self.c) / self.w
        return s.v, -1.0 + self.lift / (1.0 + z * z) ** 2

    impact = hy.contact(fall, gap=lambda self, t, s: s.x, restitution="r")


def brushed(r, c, w, lift, impacts):
    """Times of the impacts of a ball thrown up with speed 1."""

    def once(z):
        return (z / (1 + z * z) + mp.atan(z)) / 2

    def height(t0, v, s):
        z, begin = (t0 + s - c) / w, (t0 - c) / w
        moved = w * (z * mp.atan(z) - begin * mp.atan(begin)) / 2 - s * once(begin)
        return v * s - s * s / 2 + lift * w * moved

    def speed(t0, v, s):
        return v - s + lift * w * (once((t0 + s - c) / w) - once((t0 - c) / w))

    t, v, times = mp.mpf(0), mp.mpf(1), []
    for _ in range(impacts):
        ends = 1.6 * v, 2.4 * v
        length = mp.findroot(lambda s, t=t, v=v: height(t, v, s), ends, solver="anderson")
        t, v = t + length, -r * speed(t, v, length)
        times.append(t)
    return times, t + 2 * v / (1 - r)


PARTS = [(500, "taylor"), (30, "taylor"), (500, "scipy")]


@pytest.mark.parametrize(
    ("pulse", "lift", "share"), spread(PARTS, [0.3, 0.019, 0.001, 1e-4], [0.0, 0.3, 0.5])
)
def test_no_sum_of_impacts_passes_over_a_faint_pulse(pulse, lift, share):
    """At the impact and the top of a flight points of it meet the pulse; fainter than what bounds
    may overestimate it shows in the rates of the force alone."""
    part, by = pulse
    r, n = 0.5, 8
    with mp.workdps(40):
        length, width = 2 * mp.mpf(r) ** n, mp.mpf(r) ** n / part
        c = 2 * (1 - mp.mpf(r) ** n) / (1 - mp.mpf(r)) + share * length
        times, limit = brushed(mp.mpf(r), c, width, mp.mpf(lift), n + 60)
    model = Brushed(c=float(c), w=float(width), lift=lift)
    run = hy.simulate(model, {"x": 0.0, "v": 1.0}, (0.0, 6.0), solver=by, rtol=1e-10, atol=1e-13)
    # the pulse moves the limit by 1e-9 at least; steps of other methods leave their tolerance
    allowed = 1e-12 if by == "taylor" else 1e-10
    assert run.jumps.t[: n + 2] == pytest.approx([float(t) for t in times[: n + 2]], abs=allowed)
    assert run.zeno[0].t == pytest.approx(float(limit), abs=allowed)


class Window(hy.Automaton):
    """A ball whose restitution is a little larger at some speeds."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.77)
    more = hy.parameter(3.7e-5)
    below = hy.parameter(7.7e-10)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -2.0

    def law(self, t, s, u):
        return self.r + jnp.where((-u < self.below) & (-u > 0.3 * self.below), self.more, 0.0)

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=law)


@pytest.mark.parametrize(
    ("r", "more", "below"),
    [(0.77, 3.7e-5, 7.7e-10), (0.1273, 1.6e-6, 8.3e-8), (0.77, 3.7e-7, 7.7e-10), (0.5, 1e-9, 1e-4)],
)
@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_faint_window_of_speeds_is_within_the_bound(solver, r, more, below):
    """It is too faint to be told from what a sum may be off: then that is more."""
    model = Window(r=r, more=more, below=below)
    (point,) = hy.simulate(model, {"x": 0.0, "v": 1.0}, (0.0, 12.0), solver=solver).zeno
    flights, v = [], 1.0
    while v > 1e-30:
        flights.append(v)  # each takes as long as its speed, as the acceleration is 2
        v *= r + (more if 0.3 * below < v < below else 0.0)
    assert abs(point.t - math.fsum(flights)) <= point.t_error
    low, high = point.enclosure
    assert low <= math.fsum(flights) <= high
