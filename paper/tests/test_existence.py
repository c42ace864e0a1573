"""The report's section 1: its verdicts, and its numbers against the reference and closed forms."""

import math
from functools import partial

import pytest

from models import bouncing_ball
from paper import existence
from paper.claims import Verdict
from paper.existence.intervals import Ratios, flights, shrinks
from paper.runs import Spring

from .reported import claim_that, number

pytest.importorskip("flint")


@pytest.fixture(scope="module")
def section():
    return existence.section()


@pytest.fixture(scope="module")
def claim(section):
    """A claim by a part of what it says."""
    return partial(claim_that, section)


def test_what_is_corrected(section):
    """Autonomy, the strict (C1), the inequality for intervals, the end; all else is reproduced."""
    corrected = [claim.says for claim in section.claims if claim.verdict is Verdict.CORRECTED]
    for says, part in zip(corrected, ("autonomous", "(C1)", "M_i / m_i", "+oo"), strict=True):
        assert part in says
    assert all(claim.verdict is not Verdict.NOT_REPRODUCED for claim in section.claims)
    assert len(section.claims) == 14


def test_places_and_figures_are_told_apart(section):
    """No two claims say the same, no two figures have one name; each claim says how."""
    assert len({claim.says for claim in section.claims}) == len(section.claims)
    names = [figure.name for claim in section.claims for figure in claim.figures]
    assert sorted(names) == ["all-starts", "ball", "example-1", "intervals"]
    assert all(claim.how and claim.found for claim in section.claims)


def test_the_ball(claim):
    """The accumulation is the closed form, within its error."""
    t_inf = number(claim("finite number of collisions"), "`t_inf`")
    height, r = bouncing_ball.START["x"], 0.7
    exact = math.sqrt(2 * height / 9.81) * (1 + r) / (1 - r)
    assert abs(t_inf.ours - exact) <= t_inf.error < 1e-12


def test_systems_that_depend_on_time(claim):
    """The table and the forced beam do; the controlled system remembers."""
    kinds = [number.ours for number in claim("autonomous").numbers]
    assert kinds == ["neither", "the time", "the time", "neither", "its past"]


def test_theorem_1_for_example_1(claim):
    """Bounds of f, the range of m and the left side: closed forms, within errors."""
    left = 16.625 * math.sqrt(1 / 7)
    for found, exact in (
        (number(claim("-16.625"), "largest f"), -7.0),
        (number(claim("-16.625"), "least f"), -16.625),
        (number(claim("(C1)"), "m must be less"), 7.0),
        (number(claim("(C1)"), "m must be more"), 16.625**2 / 49),
        (number(claim("6.28"), "`M sqrt"), left),
        (number(claim("6.28"), "margin"), 7.0 - left),
    ):
        assert abs(found.ours - exact) <= found.error < 1e-10
    assert number(claim("(C1)"), "`f(2, pi)`").ours == -7.0


def test_theorem_1_from_all_starts(claim):
    """Certified for each r, and each run once more by its own impacts."""
    found = [number.ours for number in claim("All solutions").numbers]
    assert found == ["4 of 4", "164 of 164"]
    (figure,) = claim("All solutions").figures
    for curve in figure.columns[0][0].curves:
        assert all(a < b for a, b in zip(curve.y, curve.y[1:], strict=False))


def test_the_solution_of_example_1(claim, reference):
    """The accumulation, impacts and speeds, and counts of impacts."""
    case, told = reference["example_1"]["r=0.8,x0=2.1"], claim("the solution is chattering")
    t_inf = number(told, "`t_inf`")
    assert abs(t_inf.ours - float(case["t_inf"])) <= t_inf.error < 1e-12
    low, high = (number(told, what).ours for what in ("`t_inf`: lower", "`t_inf`: upper"))
    assert low <= float(case["t_inf"]) <= high
    for impact in case["first_impacts"][:3]:
        t, v = (number(told, f"impact {impact['n']}: {what}") for what in ("time", "speed"))
        assert abs(t.ours - float(impact["t"])) <= t.error < 1e-12
        assert abs(v.ours + float(impact["v_pre"])) <= v.error < 1e-12
    counts = [n.ours for n in told.numbers if n.what.startswith("impacts until")]
    due = [c["first_n_with_post_speed_below"] for c in case["impact_counts"].values()]
    assert counts == due
    assert len(told.figures[0].zooms) > 5


def test_the_inequality_for_intervals(claim):
    """From rest at 1.07, and leaving with 0.4: more than r M_1 / m_1 = 0.8, as in closed form."""
    told = claim("r M_i / m_i")
    w = 0.8 * math.sqrt(0.14 / 0.86)
    for what, exact in (
        ("first ratio", 0.8 * (1 + w**2) / (1 + (0.8 * w) ** 2)),
        ("`r M_1 / m_1`", 0.8),
        ("`r M_1 / m_2`", 0.8 * (1 + w**2) / (1 + (0.8 * w) ** 2)),
        ("ratio after leaving", 0.8 * 1.16 / 1.1024),
        ("`M sqrt", 0.4 / 0.42),
    ):
        found = number(told, what)
        assert abs(found.ours - exact) <= found.error < 1e-12
    assert shrinks(0.8, 0.4) == pytest.approx(0.84179970972, abs=1e-11)


def test_ratios_of_example_1(reference):
    """Intervals of the reference's impacts; both bounds lie above, the corrected one nearer."""
    spring = Spring.made()
    ratios = Ratios.of(flights(spring.model, spring.run, 20), 0.8)
    t = [float(i["t"]) for i in reference["example_1"]["r=0.8,x0=2.1"]["first_impacts"]]
    for i in range(19):
        assert ratios.found[i] == pytest.approx(
            (t[i + 2] - t[i + 1]) / (t[i + 1] - t[i]), abs=1e-10
        )
        assert 0.8 < ratios.found[i] < ratios.mended[i] < ratios.printed[i]


def test_the_proof_step_by_step(claim):
    """First fall, heights, halves, integrals, limits: numbers obey what is said of them."""
    fall = claim("theta_1 <")
    times = number(fall, "longest"), number(fall, "`sqrt")
    assert times[0].ours < times[1].ours == pytest.approx(math.sqrt(1 / 7), abs=1e-12)
    tops = [n.ours for n in claim("x_1(xi_1)").numbers if n.what.startswith("`x_1(")]
    assert 2.1 > tops[0] > tops[1] > tops[2] > 2.0
    assert all(float(n.ours) < 1e-14 for n in claim("(theta_i + theta_{i+1}) / 2").numbers)
    assert float(number(claim("int f ds"), "largest").ours) < 1e-14
    settled = claim("M_i / m_i -> 1")
    assert number(settled, "flight 40: `M_i").ours < 1e-8
    assert number(settled, "greatest `r M_i").ours < 1.0


def test_what_follows_the_accumulation(claim):
    """Under the equation alone the body goes through the wall; held, it stays."""
    told = claim("+oo")
    # x'' = -cos x' - x^3 from (2, 0), 0.5 later: the limit of the reference's rows as r falls
    assert number(told, "x at `t_inf`").ours == pytest.approx(1.1726761979, abs=1e-9)
    assert number(told, "x at the end").ours == 2.0
