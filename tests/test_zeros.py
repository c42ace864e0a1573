"""Zeros of polynomials: none lost, none invented, as exact as the coefficients allow.

The truth is reckoned in rational numbers, from the very floats that the rules are given.
"""

import math
import os
import subprocess
import sys
from itertools import pairwise

import flint
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from hybrid.rules import unit
from hybrid.rules.load import Library
from hybrid.rules.zeros import SPARE_ROWS, UNFIT, VANISHES

EPS = 2.0**-52

FALLING, RISING = -1, 1


@pytest.fixture
def plain(monkeypatch):
    """The rules as plain Python that refuses indices below zero."""
    monkeypatch.setenv("HYBRID_RULES", "checked")
    return Library("hybrid.rules").unit("zeros")


def room(n):
    return np.full((n + SPARE_ROWS, n + 5), np.nan), np.full((2 * n + 4, 2), np.nan)


def crossings(b, order=0, tolerance=0.0):
    """Rows of point and direction, or a status code."""
    b = np.array(b, dtype=float)
    n = len(b) - 1
    work, found = room(n)
    count = unit("zeros").crossings(b, n, order, tolerance, work, found)
    return [tuple(row) for row in found[:count].tolist()] if count >= 0 else count


def first(c, reach=1.0, order=0, direction=0, noise=0.0):
    c = np.array(c, dtype=float)
    work, found = room(len(c) - 1)
    return unit("zeros").first(c, len(c) - 1, reach, order, direction, noise, work, found)


def series(c, reach, tolerance=-1.0):
    c = np.array(c, dtype=float)
    work, found = room(len(c) - 1)
    count = unit("zeros").series(c, len(c) - 1, reach, 0, tolerance, work, found)
    return [tuple(row) for row in found[:count].tolist()] if count >= 0 else count


def turns(b):
    b = np.array(b, dtype=float)
    work, found = room(len(b) - 1)
    count = unit("zeros").turns(b, len(b) - 1, work, found)
    return [tuple(row) for row in found[:count].tolist()]


# ---------------------------------------------------------------------------------------
# the truth


def rational(x):
    return flint.fmpq(*float(x).as_integer_ratio())


def from_bernstein(b):
    """The exact polynomial of Bernstein coefficients."""
    n = len(b) - 1
    x = flint.fmpq_poly([0, 1])
    terms = [rational(v) * math.comb(n, k) * x**k * (1 - x) ** (n - k) for k, v in enumerate(b)]
    return sum(terms, flint.fmpq_poly([]))


def to_float(v):
    return int(v.p) / int(v.q)


def with_roots(roots, n, scale=1):
    """Bernstein coefficients of the polynomial of degree ``n`` with some real roots."""
    p = flint.fmpq_poly([scale])
    for root in roots:
        p *= flint.fmpq_poly([-rational(root), 1])
    return [to_float(v) for v in exact_bernstein(p, n)]


def exact_bernstein(p, n):
    shares = [p[k] / math.comb(n, k) for k in range(n + 1)]
    return [
        sum((math.comb(j, k) * shares[k] for k in range(j + 1)), flint.fmpq(0))
        for j in range(n + 1)
    ]


def real_roots(p):
    """Simple real roots in (0, 1), as floats (of 100 digits' work)."""
    numerator = p.numer()
    square_free = numerator // numerator.gcd(numerator.derivative())
    with flint.ctx.workdps(100) if hasattr(flint.ctx, "workdps") else flint.ctx.extradps(85):
        found = [z for z, _ in square_free.complex_roots()]
        real = [z.real for z in found if z.imag == 0]
    return sorted(float(r) for r in real if 0 < float(r) < 1)


def rounding(b, s):
    """What rounding may make of the value at ``s``: of each term, a few spacings per degree."""
    n = len(b) - 1
    sizes = [abs(v) * math.comb(n, k) * s**k * (1 - s) ** (n - k) for k, v in enumerate(b)]
    return 2 * (n + 1) * EPS * sum(sizes)


def check(b):
    """Hold what is found against the exact polynomial of the floats given."""
    p, found = from_bernstein(b), [row for row in crossings(b) if row[1]]
    points = [s for s, _ in found]
    assert points == sorted(points)
    assert all(0.0 < s <= 1.0 for s in points)
    for s in points:  # each is a zero of a polynomial that differs by rounding
        assert abs(to_float(p(rational(s)))) <= rounding(b, s) + 8 * EPS * s * slope(p, s)
    inner = [d for s, d in found if s < 1.0 or b[-1]]
    assert all(one == -other for one, other in pairwise(inner)), "directions alternate"
    if b[0] and b[-1]:
        assert len(found) % 2 == ((b[0] < 0) != (b[-1] < 0)), "parity"
    roots = real_roots(p)
    for before, root, after in zip([0.0, *roots], roots, [*roots[1:], 1.0], strict=False):
        certain(b, p, root, min(root - before, after - root) / 2, found)


def slope(p, s):
    return abs(to_float(p.derivative()(rational(s))))


def certain(b, p, root, gap, found):
    """What is found between the nearest points at which rounding leaves the sign agrees with it.

    That is one, in its direction; pairs beside it are where rounding does not leave the sign, as
    each of them is held to be.
    """
    width = 4 * EPS * root
    while width < gap:
        left, right = root - width, root + width
        values = [to_float(p(rational(s))) for s in (left, right)]
        if all(abs(v) > rounding(b, s) for v, s in zip(values, (left, right), strict=True)):
            crosses = (values[0] < 0) != (values[1] < 0)
            assert sum(d for s, d in found if left <= s <= right) == (
                math.copysign(1.0, values[1]) if crosses else 0.0
            ), (root, width)
            return
        width *= 2.0


# ---------------------------------------------------------------------------------------
# crossings


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 8, 12, 16, 20, 24])
def test_random_roots_are_found(degree):
    """Real roots inside and outside, complex pairs: each within what rounding allows."""
    rng = np.random.default_rng(degree)
    for _ in range(12):
        inside = rng.integers(0, degree + 1)
        roots = [*rng.uniform(0, 1, inside), *rng.uniform(-1.5, 2.5, degree - inside)]
        check(with_roots(roots, degree))
        check(rng.normal(size=degree + 1).tolist())


@pytest.mark.parametrize("exponent", range(3, 13))
def test_close_pairs_are_found(exponent):
    """Two roots 1e-3 to 1e-12 apart: both, or neither where rounding hides them."""
    rng = np.random.default_rng(exponent)
    for degree in (2, 4, 9):
        a = rng.uniform(0.1, 0.9)
        check(with_roots([a, a + 10.0**-exponent, *rng.uniform(1.2, 3.0, degree - 2)], degree))


def test_two_roots_as_close_as_floats_allow():
    """A pair around one half, 2e-15 to 2e-3 apart, in a polynomial whose coefficients are exact."""
    for k in range(9, 48):
        b = [0.25 - 4.0**-k, -0.25 - 4.0**-k, 0.25 - 4.0**-k]
        if b[0] == 0.25:
            continue
        check(b)


@pytest.mark.parametrize("degree", [5, 10, 13])
def test_wilkinson(degree):
    """Equally spaced roots, within what rounding of the coefficients leaves of them."""
    roots = [flint.fmpq(2 * k + 1, 2 * degree) for k in range(degree)]
    b = with_roots([to_float(r) for r in roots], degree, 10**degree)
    check(b)
    assert len(crossings(b)) == degree


@pytest.mark.parametrize("degree", [24, 32])
def test_as_many_roots_as_the_degree(degree):
    """Chebyshev's polynomials, whose coefficients in Bernstein's form are huge."""
    x = flint.fmpq_poly([-1, 2])
    before, now = flint.fmpq_poly([1]), x
    for _ in range(degree - 1):
        before, now = now, 2 * x * now - before
    b = [to_float(v) for v in exact_bernstein(now, degree)]
    exact = [math.sin(math.pi * (2 * k + 1) / (4 * degree)) ** 2 for k in range(degree)]
    found = [s for s, _ in crossings(b)]
    # rounding against slope: the largest coefficient over twice the degree
    bound = (degree + 1) * EPS * max(map(abs, b)) / degree
    assert found == pytest.approx(exact, abs=bound)


@settings(max_examples=200, deadline=None)
@given(some.lists(some.floats(-1.0, 1.0), min_size=2, max_size=17))
def test_any_coefficients(b):
    """Order, direction, parity and backward error, whatever the coefficients."""
    if any(0 < abs(v) < 1e-30 for v in b):
        b = [round(v, 30) for v in b]
    if any(b):
        check(b)


@pytest.mark.parametrize("exponent", [-1, -5, -17, -100, -300])
def test_roots_next_to_zero_keep_their_digits(exponent):
    """A root as small as 1e-300, beside others of order one."""
    small = 10.0**exponent
    b = with_roots([small, 0.3, 0.7], 5)
    (root, direction), *others = crossings(b)
    assert root == pytest.approx(small, rel=16 * EPS)
    assert direction == RISING
    assert [s for s, _ in others] == pytest.approx([0.3, 0.7] if small < 0.3 else [], rel=64 * EPS)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
@pytest.mark.parametrize("small", [0.2, 1e-3, 1e-12, 1e-80])
def test_what_vanishes_at_the_start_is_divided_out(order, small):
    """Nor does it matter what rounding left of it."""
    rng = np.random.default_rng(order)
    b = with_roots([*[0.0] * order, small, 0.6], order + 4, 7)
    for k in range(order):
        b[k] = 1e-17 * rng.normal()
    found = crossings(b, order)
    assert [d for _, d in found] == [FALLING, RISING]
    assert [s for s, _ in found] == pytest.approx([small, 0.6], rel=64 * EPS)


def test_a_zero_at_the_right_end_counts_as_reached():
    """From the sign before it, also behind other zeros; one at the left end does not count."""
    assert crossings([1.0, 0.5, 0.0]) == [(1.0, FALLING)]
    assert crossings([-1.0, 0.0, 0.0]) == [(1.0, RISING)]
    (inner, end) = crossings(with_roots([0.25, 1.0], 4))
    assert inner == (pytest.approx(0.25, rel=8 * EPS), FALLING)
    assert end == (1.0, RISING)
    assert crossings([0.0, 1.0, 2.0]) == []


@pytest.mark.parametrize("degree", [3, 4, 7])
def test_zeros_where_the_interval_is_halved(degree):
    """Exactly at 1/2, 1/4, 3/4: a crossing once, a double zero not at all."""
    once = crossings(with_roots([0.25, 0.5, 0.75], degree))
    assert [d for _, d in once] == [RISING, FALLING, RISING]
    # coefficients are rounded where a binomial is no power of two
    assert [s for s, _ in once] == pytest.approx([0.25, 0.5, 0.75], rel=8 * EPS)
    assert crossings(with_roots([0.5, 0.5], degree)) in ([], [(0.5, 0.0)])
    assert crossings(with_roots([0.5, 0.5, 0.5], degree)) == [(0.5, RISING)]


@pytest.mark.parametrize("exponent", [-300, -285, -30, 30, 285, 305])
def test_units_do_not_matter(exponent):
    """Coefficients times a power of two: the same zeros to the last digit."""
    b = with_roots([0.2, 0.201, 0.9], 9)
    power = 2.0 ** round(exponent / math.log10(2.0))
    assert crossings([power * v for v in b]) == crossings(b)


def test_what_is_no_polynomial_has_a_code():
    """Not a number, infinity, and zero everywhere; a constant has no zero."""
    assert crossings([1.0, math.nan, -1.0]) == UNFIT
    assert crossings([1.0, math.inf, -1.0]) == UNFIT
    assert crossings([0.0, 0.0, 0.0]) == VANISHES
    assert crossings([1e-17, 0.0, 0.0], order=1) == VANISHES
    assert crossings([0.0]) == VANISHES
    assert crossings([2.0]) == []
    assert crossings([5.0, 2.0], order=1) == []
    for c in ([1.0, math.nan], [math.inf, 1.0]):
        assert math.isnan(first(c))
    assert first([0.0, 0.0]) == math.inf
    assert math.isnan(first([1.0, -2.0], reach=math.nan))


# ---------------------------------------------------------------------------------------
# touching and turning


@pytest.mark.parametrize("depth", [1e-9, 0.0, 1e-15])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_touches_are_listed_within_the_tolerance(depth, side):
    """A minimum above zero, a maximum below it; not one that is further away."""
    b = [side * (0.16 + depth), side * (-0.24 + depth), side * (0.36 + depth)]
    ((point, direction),) = crossings(b, tolerance=2e-9)
    assert direction == 0
    assert point == pytest.approx(0.4, abs=1e-7)
    if depth == 1e-9:
        assert crossings(b, tolerance=5e-10) == []


def test_touches_stand_among_crossings_in_order():
    """A crossing, a touch, a crossing."""
    b = with_roots([0.1, 0.5, 0.5, 0.8], 6)
    found = crossings([v - 1e-14 for v in b], tolerance=1e-12)
    assert [d for _, d in found] == [FALLING, 0, RISING]
    assert found[0][0] == pytest.approx(0.1, abs=1e-12)
    assert found[-1][0] == pytest.approx(0.8, abs=1e-12)


def test_turning_points():
    """Of a cubic, and none of a line; one at an end does not count."""
    assert turns(to_cubic([0.0, 0.3, -0.5 * 1.1, 1.0 / 3.0])) == [
        (pytest.approx(0.5, rel=1e-14), FALLING),
        (pytest.approx(0.6, rel=1e-14), RISING),
    ]
    assert turns([1.0, 2.0, 3.0]) == []
    assert turns([0.0, 0.0, 1.0]) == []
    assert turns([1.0, 0.0, 0.0]) == []


def to_cubic(powers):
    p = flint.fmpq_poly([rational(c) for c in powers])
    return [to_float(v) for v in exact_bernstein(p, 3)]


# ---------------------------------------------------------------------------------------
# the first zero of a series


@pytest.mark.parametrize("reach", [1.0, 30.0, 1e6, math.inf])
def test_the_first_zero_of_a_series(reach):
    """In each direction, however far one may look; infinity if there is none."""
    cubic = [-0.006, 0.11, -0.6, 1.0]  # 0.1, 0.2, 0.3
    assert first(cubic, reach) == pytest.approx(0.1, rel=1e-13)
    assert first(cubic, reach, direction=FALLING) == pytest.approx(0.2, rel=1e-13)
    assert first(cubic, reach, direction=RISING) == pytest.approx(0.1, rel=1e-13)
    assert first([1.0, 0.0, 1.0], reach) == math.inf
    assert first([2.0], reach) == math.inf


@pytest.mark.parametrize("reach", [3.5, 1e4, math.inf])
def test_all_zeros_of_a_series(reach):
    """Crossings and touches, in order, however far one may look."""
    c = np.polynomial.polynomial.polyfromroots([1.0, 2.0, 2.0, 3.0])
    assert [d for _, d in series(c - [1e-12, 0, 0, 0, 0], reach, 1e-9)] == [FALLING, 0, RISING]
    # lowering it by 1e-12 moves zeros where its slope is 2 by half of that
    assert series(c - [1e-12, 0, 0, 0, 0], reach) == [
        (pytest.approx(1.0, abs=1e-12), FALLING),
        (pytest.approx(3.0, abs=1e-12), RISING),
    ]
    assert series([1.0, math.nan], reach) == UNFIT
    assert series([0.0, 0.0], reach) == VANISHES


def test_a_zero_behind_which_there_is_only_rounding():
    """A dip of 1e-16 below zero is passed over; one of 1e-12 is not."""
    dip, deeper = [1.0 - 1e-16, -2.0, 1.0], [1.0 - 1e-12, -2.0, 1.0]
    assert first(dip, 3.0, direction=FALLING) == pytest.approx(1.0, abs=1e-7)
    assert first(dip, 3.0, direction=FALLING, noise=16.0) == math.inf
    assert first(deeper, 3.0, direction=FALLING, noise=16.0) == pytest.approx(1.0 - 1e-6, abs=1e-9)


def test_a_zero_at_the_reach_counts():
    """And one a spacing beyond it does not."""
    assert first([-0.5, 1.0], 0.5) == 0.5
    assert first([-0.5, 1.0], math.nextafter(0.5, 0.0)) == math.inf


@pytest.mark.parametrize("speed", [1e-200, 1e-60, 1e-9, 1.0, 1e9, 1e100])
@pytest.mark.parametrize("reach", [1e200, math.inf])
def test_flights_of_any_length(speed, reach):
    """A ball that leaves the ground: 2 v / g, whatever the units."""
    assert first([0.0, speed, -4.905], reach, 1, FALLING) == pytest.approx(speed / 4.905, rel=EPS)


@pytest.mark.parametrize("exponent", [-12, -150, -300])
@pytest.mark.parametrize("power", [1, 2, 3])
def test_flat_series_next_to_zero(exponent, power):
    """``s^k = a``, whose zero is of another size than every coefficient."""
    small = 10.0**exponent
    assert first([-small, *[0.0] * (power - 1), 1.0]) == pytest.approx(
        small ** (1.0 / power), rel=4 * EPS
    )


def test_random_series():
    """Products of linear factors: the first positive root in each direction."""
    rng = np.random.default_rng(7)
    for degree in (2, 3, 5, 8):
        for _ in range(40):
            roots = np.sort(rng.uniform(-1, 2, degree))
            c = np.polynomial.polynomial.polyfromroots(roots)
            inside = [(k, r) for k, r in enumerate(roots) if 0 < r <= 1.7]
            for direction in (FALLING, RISING):
                chosen = [r for k, r in inside if (-1) ** (degree - 1 - k) == direction]
                apart = min([1.0, *np.diff(roots)])
                if apart < 1e-3:
                    continue
                expected = chosen[0] if chosen else math.inf
                # coefficients are of order 2^degree, slopes at least apart^(degree - 1)
                assert first(c, 1.7, 0, direction) == pytest.approx(
                    expected, rel=1e-15 * (4.0 / apart) ** (degree - 1)
                )


# ---------------------------------------------------------------------------------------
# the ways to run them


def test_plain_python_finds_the_same(plain):
    """Each rule, to the rounding by which a contracted product and sum differs."""
    rng = np.random.default_rng(11)
    rules = unit("zeros")
    for degree in (1, 2, 5, 12, 24):
        for order in (0, 1, 3):
            if order >= degree:
                continue
            roots = (np.arange(degree) + rng.uniform(0.2, 0.8, degree)) / degree * 1.5
            b = np.array(with_roots(roots.tolist(), degree))
            c = np.polynomial.polynomial.polyfromroots(roots[:8])
            size = len(c) - 1
            for name, arguments in {
                "crossings": (b, degree, order, 1e-9 * np.abs(b).max()),
                "turns": (b, degree),
                "first": (c, size, 1.3, min(order, size), -1, 16.0),
                "series": (c, size, 1.3, min(order, size), 1e-9),
            }.items():
                answers = []
                for library in (rules, plain):
                    work, found = room(degree + 8)
                    count = getattr(library, name)(*arguments, work, found)
                    listed = [] if name == "first" else found[:count].tolist()
                    answers.append([count, *np.ravel(listed)])
                # a product of up to 24 factors in (0, 1): some digits are lost between zeros
                assert answers[0] == pytest.approx(answers[1], rel=1e-6)


SIMULATED = """
import math, sys
import numpy as np
from numba import cuda
from hybrid.rules import polynomials, zeros

for module in (polynomials, zeros):
    for name, rule in list(vars(module).items()):
        if getattr(rule, "__module__", "") != module.__name__:
            continue
        device = cuda.jit(device=True)(rule)
        for other in (polynomials, zeros):
            if getattr(other, name, None) is rule:
                setattr(other, name, device)

@cuda.jit
def lanes(b, work, found, counts):
    i = cuda.grid(1)
    if i < counts.shape[0]:
        counts[i] = zeros.crossings(b[i], b.shape[1] - 1, 0, 0.0, work[i], found[i])

b = np.array([[0.12, -0.28, 0.32], [0.1, 0.2, 0.3], [-0.5, 0.0, 0.5], [1.0, np.nan, 1.0]])
work, found, counts = np.zeros((4, 10, 7)), np.zeros((4, 8, 2)), np.zeros(4, np.int64)
lanes[1, 4](b, work, found, counts)
print(counts.tolist(), found[0, :2, 0].round(12).tolist(), found[2, 0, 0])
"""


def test_a_unit_runs_in_the_simulator_of_a_gpu():
    """Four lanes, each with a polynomial of its own."""
    env = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1"}
    done = subprocess.run(
        [sys.executable, "-c", SIMULATED], env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[2, 0, 1, -1] [0.2, 0.6] 0.5"
