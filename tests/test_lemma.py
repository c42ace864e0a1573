"""The lemma's numbers: outward, sharp where forces are constant, silent where it is not."""

import math

import pytest
from flint import arb

from hybrid.bounds.balls import high, low
from hybrid.zeno.lemma import chattering, largest_speed


def test_constant_gravity_is_exact():
    """M = m: the enclosures shrink to the closed form, 2 v / (m (1 - r))."""
    found = chattering(3.0, 9.81, 9.81, 0.5)
    exact = 2 * 3.0 / (9.81 * 0.5)
    assert found.contracts
    assert low(found.remaining[0]) <= exact <= high(found.remaining[1])
    assert float(found.remaining[1] - found.remaining[0]) < 1e-15
    assert float(found.height) == pytest.approx(9.0 / (2 * 9.81), rel=1e-15)


def test_the_bounds_are_those_of_the_lemma():
    """Written out in floats; the difference is rounding."""
    v, m, M, r = 0.7, 2.0, 3.0, (0.4, 0.6)
    found = chattering(v, m, M, r)
    rho = 0.6 * math.sqrt(M / m)
    slow = 1 - 0.4 * math.sqrt(m / M)
    values = [*found.flight, *found.remaining, found.rho, found.speed, found.height]
    expected = [
        *(2 * v / M, 2 * v / m),
        *(2 * v / (M * slow), 2 * v / (m * (1 - rho))),
        *(rho, v * math.sqrt(M / m), v * v / (2 * m)),
    ]
    assert [float(value) for value in values] == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("v", "m", "M", "r"),
    [
        (1.0, 1.0, 4.0, 0.5),  # r sqrt(M / m) = 1 to the last bit
        (1.0, 1.0, 2.0, 0.9),
        (1.0, -1.0, 2.0, 0.1),
        (1.0, 0.0, 2.0, 0.1),
        ((0.0, 1.0), 1.0, 2.0, 0.1),
        (1.0, 1.0, 2.0, (-0.1, 0.1)),
    ],
)
def test_it_is_silent_without_contraction(v, m, M, r):
    """No bound of the sum, and no speed."""
    found = chattering(v, m, M, r)
    assert not found.contracts
    assert found.remaining is None
    assert largest_speed(m, M, r, 1.0, 1.0, 1.0) == 0.0 or isinstance(v, tuple)


def test_balls_widen_the_bounds():
    """A speed known within a ball: the enclosure holds for both ends."""
    wide = chattering((0.9, 1.1), 2.0, 2.1, 0.5).remaining
    for v in (0.9, 1.0, arb("1.1")):
        narrow = chattering(v, 2.0, 2.1, 0.5).remaining
        assert wide[0] <= narrow[0] <= narrow[1]
        assert low(narrow[1]) <= high(wide[1])


@pytest.mark.parametrize(("height", "speed", "time"), [(1e-3, 9, 9), (9, 0.1, 9), (9, 9, 0.2)])
def test_the_largest_speed_fills_the_box(height, speed, time):
    """One of the three bounds is met within rounding, none is passed."""
    v = largest_speed(2.0, 2.1, 0.5, height, speed, time)
    found = chattering(v, 2.0, 2.1, 0.5)
    used = [found.height / height, found.speed / speed, found.remaining[1] / time]
    assert max(float(share) for share in used) == pytest.approx(1.0, rel=1e-12)
    assert all(share <= 1 + arb("1e-15") for share in used)
