"""Section 5 of the report: the oscillator that a chattering ball drives."""

import attrs
import numpy as np
import pytest

from paper import continuous
from paper.claims import Verdict
from paper.continuous import oscillator


@pytest.fixture(scope="module")
def claims():
    return continuous.section().claims


def numbers(claims, text):
    """The numbers of the one claim that says this, by what they are."""
    (found,) = [c for c in claims if text in c.says]
    return {n.what: n for n in found.numbers}


@pytest.mark.parametrize(
    ("text", "due"),
    [
        ("unilateral", Verdict.REPRODUCED),
        ("asymptotically stable", Verdict.REPRODUCED),
        ("infinitely many oscillations", Verdict.CORRECTED),
        ("periodicity theorem", Verdict.CORRECTED),
    ],
)
def test_verdicts(claims, text, due):
    """Each claim of the section has the verdict that its numbers give."""
    (found,) = [c for c in claims if text in c.says]
    assert found.verdict is due
    assert len(claims) == 4


def test_numbers(claims, reference):
    """Within the bounds reported, or to 11 digits, of the reference with 40 digits."""
    exact = reference["coupled"]
    t_inf = numbers(claims, "unilateral")["t_inf"]
    assert abs(t_inf.ours - float(exact["t_inf"])) <= t_inf.error < 1e-11
    found = numbers(claims, "asymptotically stable")
    for name in ("x3", "x4"):
        limit = found[f"{name} at t_inf"]
        assert abs(limit.ours - float(exact["at_t_inf"][name])) <= limit.error < 1e-9
        for t in (1, 10):
            value = found[f"{name} at t = {t}"].ours
            assert value == pytest.approx(float(exact[f"t={t}"][name]), rel=1e-12)


def test_extrema_are_counted(claims, reference):
    """As many as the reference counts with 40 digits; x4' tends to a number that is not 0."""
    exact, found = reference["coupled"], numbers(claims, "infinitely many oscillations")
    assert found["extrema of x3"].ours == exact["x3_extrema_total"]
    assert found["extrema of x4"].ours == exact["x4_extrema_total"]
    limit = found["limit of x4'"]
    assert abs(limit.ours - float(exact["at_t_inf"]["x4dot_limit=-2x3-3x4"])) <= limit.error
    assert found["last extremum of x4 at t"].ours < float(exact["t_inf"]) - 0.9


def test_no_extremum_follows_the_accumulation():
    """x4 and x4' keep their signs in the free motion; from other states one of them does not."""
    after = oscillator.limit_state(oscillator.flown())
    assert oscillator.stays_after(after)
    s = np.linspace(0.0, 20.0, 2001)
    slow, fast = 2.0 * after[2] + after[3], -after[2] - after[3]
    assert np.all(slow * np.exp(-s) + 2.0 * fast * np.exp(-2.0 * s) > 0.0)
    assert np.all(slow * np.exp(-s) + 4.0 * fast * np.exp(-2.0 * s) > 0.0)
    assert not oscillator.stays_after(np.array([1.0, 0.0, 1.0, 1.0]))
    assert not oscillator.stays_after(np.array([1.0, 0.0, 3.0, -1.5]))


def test_the_derivative_of_the_pull():
    """``6 x3 + 7 x4 - 60 x2^2`` is the derivative of ``-2 x3 - 3 x4`` along a flight."""
    arc = oscillator.chattering(oscillator.flown())[5]
    s, h = 0.4 * arc.length, 1e-5
    slope = (oscillator.pull(arc.local(s + h)) - oscillator.pull(arc.local(s - h))) / (2 * h)
    assert slope == pytest.approx(oscillator.jerk(arc.local(s)), rel=1e-7)


def test_the_acceleration_oscillates_for_ever(claims):
    """What is left of the start is positive, by more than its error: 7.59593e-6 with 40 digits."""
    rate = numbers(claims, "periodicity theorem")["6 x3 + 7 x4 at t_inf"]
    exact = 6 * 3.1319870106304709135 - 7 * 2.6845592096926250622
    assert abs(rate.ours - exact) <= rate.error < 0.01 * exact


def test_with_another_start_it_does_not():
    """Thrown hard enough the other way, what is left is negative: no oscillation is claimed."""
    import hybrid as hy
    from hybrid.gallery import find

    start = {**find("coupled").start, "x4": 1000.0}
    run = hy.simulate(find("coupled").cls(), start, (0.0, 25.0), solver="taylor", rtol=1e-14)
    assert not oscillator.oscillates(run)


def test_a_change_of_sign_is_found_within_a_flight_and_at_an_impact():
    """The ball's velocity: at each top, and at each impact."""
    run = oscillator.flown()
    found = oscillator.turns(run, lambda s: s[..., 1])
    times = run.jumps.t
    kinds = np.array([turn.jumps for turn in found[:41]])
    assert np.all(kinds[::2]) != np.all(kinds[1::2])
    assert attrs.astuple(found[1])[0] == pytest.approx(0.5 * (times[0] + times[1]), abs=1e-12)
