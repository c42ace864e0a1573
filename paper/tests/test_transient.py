"""Section 2: how much of chattering is left out when it is cut off."""

from fractions import Fraction

import numpy as np
import pytest

import hybrid as hy
from models.hard_spring import HardSpring
from paper.transient import transient


def test_the_transient_of_section_2(reference):
    """Impacts, t_inf, gap and height for r from 0.8 down to 1/4; the gap falls ever faster."""
    rows = reference["section_2"]["rows"]
    r = [float(Fraction(row["r"])) for row in rows]
    found = transient(HardSpring(), [2.1, 0.0], (0, 3), values=r, rtol=1e-12, atol=1e-12)
    assert found.impacts.tolist() == [row["[1/r]"] for row in rows]
    exact = [float(row["theta_inf"]) for row in rows]
    np.testing.assert_allclose(found.t_inf, exact, rtol=0, atol=1e-11)  # rtol, grown by impacts
    gaps = [float(row["gap=theta_inf-theta_[1/r]"]) for row in rows]
    np.testing.assert_allclose(found.gap, gaps, rtol=0, atol=1e-11)
    heights = [float(row["max_height_missed(after impact N)"]) for row in rows]
    np.testing.assert_allclose(found.height, heights, rtol=1e-10)  # of dense output
    few = transient(HardSpring(), [2.1, 0.0], (0, 3), values=[1 / 2, 1 / 4, 1 / 6, 1 / 8])
    assert np.all(np.diff(np.log(few.gap), 2) < 0)
    assert len(str(few).splitlines()) == 5


def test_what_is_left_out_keeps_its_digits(reference):
    """Down to 3e-86 the gap is ``2 v / (9 (1 - r))`` and the height ``v^2 / 18``, v = r^N |v_1|."""
    first = reference["example_1"]["r=0.8,x0=2.1"]["first_impacts"][0]["v_pre"]
    r = 1 / np.array([20, 30, 50])
    found = transient(HardSpring(), [2.1, 0.0], (0, 1), values=r, solver="taylor")
    v = r**found.impacts * -float(first)  # next terms are v^2 = 1e-50 smaller
    np.testing.assert_allclose(found.gap, 2 * v / 9 / (1 - r), rtol=1e-13)
    np.testing.assert_allclose(found.height, v**2 / 18, rtol=1e-13)
    assert found.gap[-1] < 1e-85


@pytest.mark.parametrize("r", [0.4, 0.5])
def test_the_gap_after_any_number_of_impacts(r, reference):
    """From 5 impacts on it is the reference's series, to the accuracy that is asked of sums."""
    case = reference["example_1"]
    first = -float(case["r=0.8,x0=2.1"]["first_impacts"][0]["v_pre"])
    series = [float(Fraction(c)) for c in case["flight_time_over_speed_as_series_in_v^2"]]
    for impacts in range(5, 26):
        options = {"zeno": "truncate", "max_jumps": impacts, "solver": "taylor", "rtol": 1e-12}
        run = hy.simulate(HardSpring(r=r), [2.1, 0.0], (0, 2), **options)
        v, powers = first * r**impacts, 2 * np.arange(len(series)) + 1
        exact = np.sum(series * v**powers / (1 - r**powers))
        assert abs(run.zeno[0].truncation.gap / exact - 1) < 1e-11


def test_what_cannot_be_studied():
    """Unknown parameters; another treatment of the accumulation; a run that never chatters."""
    with pytest.raises(hy.OptionError, match="no parameter 'e'; there are: r, wall"):
        transient(HardSpring(), [2.1, 0.0], (0, 3), values=[0.5], parameter="e")
    with pytest.raises(hy.OptionError, match="zeno='truncate'"):
        transient(HardSpring(), [2.1, 0.0], (0, 3), values=[0.5], zeno="rest")
    none = transient(HardSpring(), [2.1, 0.0], (0, 0.1), values=[0.5])
    assert none.impacts.tolist() == [-1]
    assert np.isnan(none.gap[0])
