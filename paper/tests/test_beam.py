"""Section 4 of the report: the beam with an obstacle, and the map of its parameters."""

import numpy as np
import pytest

import hybrid as hy
from hybrid.gallery import find
from paper import beam
from paper.beam import chart, perturbed, proof, strikes
from paper.claims import Verdict

BORDER = 1.1**3 - 1.1


def number(claim, what):
    """The one number of a claim that is this."""
    (found,) = [n for n in claim.numbers if n.what == what]
    return found


@pytest.fixture(scope="module")
def small():
    """A map of 60 beams."""
    over = {"gamma": [0.0, 0.1, 0.2, 0.2309, 0.2311, 0.3], "delta": [0.05, 0.3]}
    return chart.compared(strikes.fly(over | {"w": [0.1, 0.5, 1.0, 2.0, 5.0]}))


def test_the_proof_fails_as_printed_and_is_mended():
    """f and the inequality, as their closed forms; the conclusion holds."""
    bounds, inequality, chattering = beam.bounds(), beam.inequality(), beam.chattering()
    assert {c.verdict for c in (bounds, inequality, chattering)} == {Verdict.CORRECTED}
    assert number(bounds, "sup f").ours == pytest.approx(-BORDER, abs=1e-14)
    assert number(bounds, "inf f").ours == pytest.approx(1.5 - 1.5**3, abs=1e-14)
    left = 1.875 * np.sqrt(0.8 / BORDER)
    assert number(inequality, "left side").ours == pytest.approx(left, abs=1e-12)
    assert beam.mended() == 3.5


def test_accumulations_of_the_figure(reference):
    """With and without perturbation: within the bound of the reference, and proved."""
    for pair, claim, what in (
        ((0, 0), beam.chattering(), "t_inf from 1.3"),
        ((0.05, 0.05), beam.figure_6(), "t_inf, delta = 0.05, gamma = 0.05"),
    ):
        exact = reference["moon_holmes delta={},gamma={},w=0.1".format(*pair)]
        found = number(claim, what)
        assert abs(found.ours - float(exact["t_inf"])) <= found.error < 1e-10
    assert beam.figure_6().verdict is Verdict.REPRODUCED


def test_what_takes_the_place_of_continuity():
    """The lemma proves it from an impact on, between bounds that hold the limit."""
    claim = beam.continuity()
    assert claim.verdict is Verdict.CORRECTED
    low, high = (
        number(claim, f"{side} bound of t_inf from there").ours for side in ("lower", "upper")
    )
    assert low < number(claim, "t_inf").ours < high
    assert beam.asymmetric().verdict is Verdict.REPRODUCED


def test_the_proof_from_an_impact_agrees_with_certify():
    """What hy.certify proves at all phases of a weak forcing is proved from single impacts."""
    own = find("moon_holmes").cls(delta=0.05, gamma=0.02, w=0.5)
    period = 2 * np.pi / 0.5
    box = {"gap": (0.0, 2e-5), "speed": (0.0, 0.004), "t": (0.0, 2 * period)}
    certificate = hy.certify(own, box)
    fast = 0.99 * certificate.initial_set["speed"][1]
    assert certificate.verdict == "certified"
    assert fast > 1e-3
    for t in np.linspace(0.0, period, 9):
        low, high = proof.accumulates(0.05, 0.02, 0.5, t, fast)
        assert certificate.remaining[0] * 0.98 <= low - t < high - t <= certificate.remaining[1]
    assert proof.accumulates(0.05, 0.3, 0.5, 0.0, fast) is None


def test_the_border_of_resting_is_proved():
    """gamma = 0.231 from below, not from above; 1.1 is the float next to it."""
    assert proof.pushes_always(BORDER - 1e-15)
    assert not proof.pushes_always(BORDER + 1e-15)


def test_nothing_is_proved_that_is_not_seen(small):
    """Beams that are held fall within the bounds; few are seen and not proved."""
    assert not np.any(small.disagree)
    assert not np.any(small.undecided)
    assert np.sum(small.certified) > 30
    assert np.sum(small.unproved) <= 3
    rests = small.seen == chart.REST
    assert np.all(small.lanes.gamma[rests] < BORDER)
    assert np.all(small.lanes.gamma[small.seen == chart.RELEASED] > BORDER)


def test_a_wrong_proof_would_be_noticed(small, monkeypatch):
    """With another restitution in the lemma, or a border moved, beams disagree."""
    own = find("moon_holmes").cls
    monkeypatch.setattr(proof, "beam", lambda: own(r=0.8))
    assert np.sum(chart.compared(small.lanes).disagree) > 10
    monkeypatch.setattr(proof, "beam", lambda: own(obstacle=1.11))
    assert np.any(chart.compared(small.lanes).disagree)


def test_a_proof_of_a_series_that_ends_would_be_noticed(small, monkeypatch):
    """A beam that is never held, and is said to chatter, is a disagreement."""
    monkeypatch.setattr(chart, "accumulates", lambda *given: (given[3], given[3] + 1.0))
    assert np.any(chart.compared(small.lanes).disagree & ~small.complete)


def test_blow_by_blow_is_the_run_of_the_gallery(small):
    """The run's impacts accumulate a moment after a beam is held; both are released together."""
    lanes = small.lanes
    for place in np.flatnonzero(small.complete & (lanes.w == 1.0))[[0, 3, -1]]:
        own = find("moon_holmes").cls(
            **{name: float(getattr(lanes, name)[place]) for name in ("delta", "gamma", "w")}
        )
        run = hy.simulate(own, {"x": 1.3, "v": 0.0}, (0.0, 60.0), rtol=1e-11, atol=1e-12)
        assert lanes.held[place] < run.zeno[0].t + 1e-6
        assert run.zeno[0].t < lanes.held[place] + small.tail[place] + 1e-6
        if run.zeno[0].t_release is None:
            assert np.isnan(lanes.released[place])
        else:
            assert lanes.released[place] == pytest.approx(run.zeno[0].t_release, abs=1e-6)


def test_the_border_from_runs():
    """Bisected to twelve digits."""
    low, high = perturbed.bisected()
    assert low <= BORDER <= high
    assert high - low < 3e-12


def test_a_fast_forcing_locks_the_beam(small):
    """With w = 5 and gamma = 0.1 a stable orbit has one impact a period, and never chatters."""
    orbit = perturbed.locked()
    assert (orbit.jumps, orbit.stable) == (1, True)
    assert abs(orbit.multipliers[0] * orbit.multipliers[1]) == pytest.approx(
        0.81 * np.exp(-0.1 * orbit.period), rel=1e-9
    )
    assert not perturbed.flown(*perturbed.LOCKED).zeno


def test_a_map_is_kept(tmp_path, monkeypatch):
    """What is stored is not flown again; a store of another map is made anew."""
    pytest.importorskip("zarr")
    over = {"gamma": [0.0, 0.3], "delta": [0.1], "w": [1.0]}
    store = tmp_path / "beam.zarr"
    first = strikes.fly(over, store=store)
    flown = []
    real = strikes.sweep
    monkeypatch.setattr(
        strikes,
        "sweep",
        lambda *given, **asked: real(*given, progress=lambda *n: flown.append(n), **asked),
    )
    assert np.array_equal(strikes.fly(over, store=store).count, first.count)
    assert not flown
    assert len(strikes.fly(over | {"w": [1.0, 2.0]}, store=store).count) == 4
    assert flown == [(4, 4)]


def test_claims_of_the_map(monkeypatch, tmp_path):
    """Verdicts and figure on a coarse grid; the slider has all slices, the cells both kinds."""
    monkeypatch.setattr(chart, "KEPT", tmp_path / "beam.zarr")
    monkeypatch.setattr(chart, "GAMMAS", np.array([0.0, 0.04, 0.23099, 0.23101, 0.3]))
    monkeypatch.setattr(chart, "DELTAS", np.array([0.1, 0.3]))
    monkeypatch.setattr(perturbed, "GAMMAS", chart.GAMMAS)
    monkeypatch.setattr(chart, "whole", chart.whole.__wrapped__)
    found = chart.whole()
    for module in (chart, perturbed):
        monkeypatch.setattr(module, "whole", lambda: found)
    small, border, incomplete = perturbed.claims()
    assert small.verdict is border.verdict is Verdict.REPRODUCED
    assert incomplete.verdict is Verdict.REPRODUCED
    assert number(small, "proved and not seen").ours == 0
    slider = small.figures[0].slider
    assert [label for label, _ in slider.stops] == [f"{w:g}" for w in chart.SLICES]
    (seen,), (proved,) = slider.stops[slider.start][1]
    assert seen.cells.kind.shape == proved.cells.kind.shape == (2, 5)
    assert "proved from the impact" in seen.cells.notes[0, 0]
    wrong = np.zeros(len(found.seen), dtype=bool)
    wrong[0] = True
    monkeypatch.setattr(chart.Map, "disagree", property(lambda self: wrong))
    assert perturbed.small().verdict is Verdict.NOT_REPRODUCED
