"""Section 3 of the report: the bead on the vibrating table."""

from math import pi, sin

import pytest

from paper import table
from paper.claims import Verdict
from paper.table import bead


@pytest.fixture(scope="module")
def claims():
    return table.section().claims


def claim(claims, text):
    """The one claim that says this."""
    (found,) = [c for c in claims if text in c.says]
    return found


def number(found, what):
    (one,) = [n for n in found.numbers if n.what == what]
    return one


@pytest.mark.parametrize(
    ("text", "due"),
    [
        ("the jump of x' is", Verdict.REPRODUCED),
        ("close to a horizontal", Verdict.CORRECTED),
        ("|f(x, x')| = g = M = m", Verdict.CORRECTED),
        ("sqrt(37.24) < 7", Verdict.REPRODUCED),
        ("this solution is chattering", Verdict.CORRECTED),
        ("(implied)", Verdict.CORRECTED),
        ("0.1 <= x <= 2", Verdict.CORRECTED),
        ("long contact", Verdict.REPRODUCED),
    ],
)
def test_verdicts(claims, text, due):
    """Each claim of the section has the verdict that its numbers give."""
    assert claim(claims, text).verdict is due
    assert len(claims) == 8


def test_the_accumulation_of_example_2(claims, reference):
    """Within the bound reported of the reference, computed with 40 digits."""
    exact = reference["example_2"]
    found = claim(claims, "this solution is chattering")
    t_inf, there = number(found, "t_inf"), number(found, "table there")
    assert abs(t_inf.ours - float(exact["t_inf"])) <= t_inf.error < 1e-10
    assert abs(there.ours - float(exact["X(t_inf)"])) <= there.error < 1e-9
    first = exact["impacts"][0]
    before = number(found, "first impact, relative velocity before").ours
    assert abs(before - float(first["vrel_pre"])) < 1e-12


def test_the_domain_is_left_at_impact_21(claims, reference):
    """The table is above 0.1 at the twentieth impact, and below it at the next."""
    found = claim(claims, "0.1 <= x <= 2")
    assert number(found, "impact at which x < 0.1").ours == 21
    twentieth = float(reference["example_2"]["impacts"][19]["t"])
    assert sin(0.29 * twentieth) > 0.1 > sin(0.29 * number(found, "its time").ours)


def test_the_certificate_covers_every_impact(claims):
    """It is for all phases, and its speed is above that of the first impact."""
    proof = bead.by_lemma()
    first, last = proof.initial_set["t"]
    assert last - first >= 2 * pi / 0.29
    assert bead.covered_from(bead.printed()) == 1
    assert proof.m == pytest.approx(9.8 - 0.29**2, abs=1e-11)
    assert proof.left == pytest.approx(0.9 * ((9.8 + 0.29**2) / (9.8 - 0.29**2)) ** 0.5, abs=1e-11)


def test_a_weaker_certificate_covers_less(monkeypatch):
    """With a lower speed it covers a later impact; over less than a period it covers none."""
    import attrs

    proof = bead.by_lemma()
    slower = attrs.evolve(proof, initial_set={**proof.initial_set, "speed": (0.0, 1.0)})
    monkeypatch.setattr(bead, "by_lemma", lambda: slower)
    after = bead.impacts(bead.printed())[2]
    assert after[bead.covered_from(bead.printed()) - 2] > 1.0
    shorter = attrs.evolve(proof, initial_set={**proof.initial_set, "t": (0.0, 20.0)})
    monkeypatch.setattr(bead, "by_lemma", lambda: shorter)
    assert bead.covered_from(bead.printed()) == 0


def test_the_table_at_both_starts(claims):
    """Fastest at 2 pi / omega, at rest at pi / (2 omega)."""
    found = claim(claims, "(implied)")
    assert number(found, "table's speed at 2 pi / omega").ours == pytest.approx(0.29, abs=1e-15)
    assert bead.table(bead.turned().t0) == pytest.approx((1.0, 0.0), abs=1e-15)
    force = number(claim(claims, "long contact"), "g - X0 omega^2")
    assert force.ours == pytest.approx(9.7159, abs=1e-14)
