"""The report's section 2: its verdicts, and its numbers against the reference and closed forms."""

from fractions import Fraction
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from paper import asymptotics
from paper.asymptotics.cut import RATIOS
from paper.claims import Verdict

from .reported import claim_that, number

pytest.importorskip("flint")


@pytest.fixture(scope="module")
def section():
    return asymptotics.section()


@pytest.fixture(scope="module")
def claim(section):
    """A claim by a part of what it says."""
    return partial(claim_that, section)


@pytest.fixture
def rows(reference):
    return reference["section_2"]["rows"]


def near(found, exact):
    """A number of the report within its own error of an exact one, known to nine digits."""
    close = abs(found.ours - float(exact)) <= found.error
    return close and found.error <= 1e-9 * abs(float(exact))


def test_verdicts(section):
    """The cap and the bead that stays are corrected; that it cannot be simulated is not so."""
    verdicts = [claim.verdict for claim in section.claims]
    false, corrected = Verdict.NOT_REPRODUCED, Verdict.CORRECTED
    assert verdicts.count(corrected) == 2
    assert [v for v in verdicts if v is false] == verdicts[:1] == [false]
    assert "i < [1/r]" in section.claims[1].says
    assert "stays" in section.claims[4].says
    assert section.claims[1].verdict is section.claims[4].verdict is corrected


def test_the_full_series(claim, reference):
    """Accumulations for r = 0.5, 0.8 and 0.99 are those of the reference, within their errors."""
    for label in ("0.5", "0.8", "0.99"):
        found = number(claim("infinitely many jumps"), f"r = {label}")
        assert near(found, reference["example_1"][f"r={label},x0=2.1"]["t_inf"])


def test_both_readings_of_the_cap(claim, rows):
    """Impacts and gaps of both readings; none is permitted by the formula where r > 1/2."""
    told = claim("i < [1/r]")
    for row in rows:
        assert number(told, f"r = {row['r']}: `[1/r]`").ours == row["[1/r]"]
        found = number(told, f"r = {row['r']}: gap with `i <=")
        assert near(found, row["gap=theta_inf-theta_[1/r]"])
        strict = number(told, f"r = {row['r']}: gap with `i < ")
        if row["[1/r]"] == 1:
            assert strict.ours == "no impact"
        else:
            assert near(strict, row["gap_if_only_i<[1/r]_impacts"])
    assert "first for 1/93" in told.how


def test_impacts_on_a_fixed_interval(claim, rows):
    """[1/r] of them; the times of the last permitted and of the accumulation."""
    told = claim("increases unboundedly")
    for row in rows[2:]:
        assert near(number(told, f"r = {row['r']}: `theta_[1/r]"), row["theta_[1/r]"])
        assert near(number(told, f"r = {row['r']}: `theta_inf"), row["theta_inf"])
    for label in RATIOS[2:]:
        assert number(told, f"r = {label}: impacts").ours == int(1 / Fraction(label))


def test_the_bead_without_a_contact(claim, rows):
    """Places at the accumulation and half a unit later; held, it is on the wall at all times."""
    told = claim("stays")
    later = [n for n in told.numbers if n.what.startswith("and")]
    for row, late in zip(rows, later, strict=True):
        found = number(told, f"r = {row['r']}: x at `theta_inf`")
        exact = float(row["literal_reading_x(theta_inf)_without_wall"])
        assert abs(found.ours - exact) <= found.error < 1e-10
        assert abs(late.ours - float(row["literal_reading_x(theta_inf+0.5)"])) <= late.error
    assert number(told, "contact held").ours == 0.0


def test_what_is_left_out(claim, rows, reference):
    """Heights of the reference; from r = 1/20 on gap and height are their leading terms."""
    gaps, heights = claim("last interval"), claim("asymptotic approximations")
    for row in rows[2:]:
        found = number(heights, f"r = {row['r']}: largest distance in x")
        assert near(found, row["max_height_missed(after impact N)"])
    first = float(reference["example_1"]["r=0.8,x0=2.1"]["first_impacts"][0]["v_pre"])
    for label in ("0.05", "0.02"):
        r = float(label)
        v = -first * r ** round(1 / r)
        assert near(number(gaps, f"r = {label}: gap"), 2 * v / (9 * (1 - r)))
        assert near(number(heights, f"r = {label}: largest distance in x"), v**2 / 18)
        assert near(number(heights, f"r = {label}: largest distance in x'"), v)


def test_the_rate_of_the_last_interval(claim):
    """-log gap / ((1/r) log(1/r)) falls towards 1; the curve drawn is the closed leading term."""
    told = claim("last interval")
    rates = [n.ours for n in told.numbers if n.what.startswith("`-log")]
    assert all(a > b > 1 for a, b in pairwise(rates[2:]))
    assert rates[-1] < 1.01
    leading, simulated = told.figures[0].columns[0][0].curves
    late = leading.x > 10
    np.testing.assert_allclose(simulated.y[late], leading.y[late], rtol=1e-12)


def test_before_and_after(claim):
    """Runs agree to rounding up to the last permitted impact, and exactly at rest."""
    before, after = claim("coincide").numbers
    # Each run rounds x = 2 once in a flight, to 2.2e-16. At the slowest impact of one that takes
    # two steps (r = 1/8, speed 0.17, acceleration 9) that moves the landing by 1.3e-15 and the
    # speed by 1.2e-14, in either run.
    assert float(before.ours) < 2.4e-14
    assert after.ours == 0.0


def test_the_slider(claim):
    """A stop for each r with the same panels; permitted impacts are the first of all."""
    slider = claim("stays").figures[0].slider
    assert [label for label, _ in slider.stops] == list(RATIOS)
    shapes = {tuple((p.x, p.y, p.log) for c in columns for p in c) for _, columns in slider.stops}
    assert len(shapes) == 1
    for label, columns in slider.stops:
        everything, permitted = columns[1][0].curves
        assert len(permitted.x) == int(1 / Fraction(label))
        np.testing.assert_allclose(everything.y[: len(permitted.y)], permitted.y, rtol=1e-11)
