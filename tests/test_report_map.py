"""The map of the Moon-Holmes beam: runs, proofs and brute force agree where they must."""

import attrs
import numpy as np
import pytest

import hybrid as hy
from hybrid.report import beam_map, beam_points
from hybrid.report.beam_points import INCOMPLETE, NONE, RELEASED, RESTS, kind_of, points, run_of
from hybrid.report.claims import Verdict


@pytest.fixture(scope="module")
def small():
    """A map of twelve points, of every kind."""
    patch = pytest.MonkeyPatch()
    for module in (beam_map, beam_points):
        patch.setattr(module, "DELTAS", np.array([0.0, 0.2]))
        patch.setattr(module, "GAMMAS", np.array([0.05, 0.25, 0.275]))
        patch.setattr(module, "FREQUENCIES", (0.5, 2.0))
    points.cache_clear()
    yield points()
    points.cache_clear()
    patch.undo()


def test_what_is_certified_is_seen(small):
    """From the proved impact on, by another solver, at the time enclosed."""
    certified = [point for point in small if point.certified]
    assert len(certified) == 10
    assert all(point.confirmed for point in certified)
    assert all(point.chatters == point.certified for point in small)


def test_a_wrong_proof_would_be_found(small):
    """Moved by a hundredth, or of a motion that does not chatter."""
    point = next(point for point in small if point.certified)
    low, high = point.enclosure
    assert not attrs.evolve(point, enclosure=(low + 0.01, high + 0.01)).confirmed
    assert not attrs.evolve(point, followed=np.nan).confirmed


def test_the_kinds_on_both_sides_of_the_border(small):
    """Rest for ever below 0.231, release above, incomplete chattering at w = 2, gamma = 0.275."""
    kinds = {(p.delta, p.gamma, p.w): p.kind for p in small}
    assert {kinds[d, 0.05, w] for d in (0.0, 0.2) for w in (0.5, 2.0)} == {RESTS}
    assert {kinds[d, 0.25, w] for d in (0.0, 0.2) for w in (0.5, 2.0)} == {RELEASED}
    assert kinds[0.2, 0.275, 2.0] == INCOMPLETE


def test_the_claims_say_what_was_counted(small):
    """All points of small forcing chatter; none is certified and not seen."""
    claim = beam_map.map_claims()[0]
    assert claim.verdict is Verdict.REPRODUCED
    assert "certified but not seen: 0" in claim.found
    counts = {number.what: number.ours for number in claim.numbers}
    assert (counts["points"], counts["certified"], counts["confirmed"]) == (12, 10, 10)
    assert len(claim.figures[0].slider.stops) == 2


def test_a_proof_that_is_not_seen_is_counted(small, monkeypatch):
    """The verdict falls with it."""
    broken = (attrs.evolve(small[0], followed=np.nan), *small[1:])
    monkeypatch.setattr(beam_map, "points", lambda: broken)
    claim = beam_map.map_claims()[0]
    assert claim.verdict is Verdict.NOT_REPRODUCED
    assert "certified but not seen: 1" in claim.found


def test_strong_fast_forcing_does_not_chatter():
    """Impacts without a long series of slower and slower ones."""
    assert kind_of(run_of(0.2, 0.6, 4.0)) == NONE


def test_the_border_of_resting_for_ever_is_the_force_at_the_wall():
    """1.1 cubed less 1.1, to ten digits, whatever the damping and the frequency."""
    claim = beam_map.border()
    assert claim.verdict is Verdict.CORRECTED
    for number in claim.numbers:
        assert number.ours == pytest.approx(0.231, abs=1e-11)


def test_brute_force_is_another_simulation():
    """It knows no sums: the library's own run, impact by impact, is the same."""
    slow, t = beam_points._brute(*(np.array([v]) for v in (0.05, 0.05, 0.1)), 0.0, 1.3, 0.0)
    model = beam_points.beam()(delta=0.05, gamma=0.05, w=0.1)
    t_inf = hy.simulate(model, beam_points.START, (0.0, 30.0), rtol=1e-12).zeno[0].t
    assert slow[0]
    assert t[0] == pytest.approx(t_inf, abs=beam_points.NEAR)
    assert t[0] != t_inf
