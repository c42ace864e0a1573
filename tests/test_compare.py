"""All solvers agree on every model of the gallery, up to what the tolerance explains."""

import attrs
import pytest
from typer.testing import CliRunner

import hybrid as hy
from hybrid import gallery
from hybrid.benchmark.agreement import CLOSE_QUANTITIES, COMPARED_METHODS, SAME_QUANTITIES, compare
from hybrid.cli import app
from hybrid.run import cycles
from models.two_tanks import TwoTanks

from . import systems

#: Those whose errors are far above rounding, beside one that ``tests/test_models.py`` holds, as
#: DOP853 and Dopri8, to the oracle of each model.
SOME = ("taylor", "scipy Radau", "scipy LSODA")


@pytest.mark.parametrize(
    "methods",
    [
        {name: COMPARED_METHODS[name] for name in SOME},
        pytest.param(None, marks=pytest.mark.every_way),
    ],
    ids=["some", "all"],
)
@pytest.mark.parametrize("name", gallery.names())
def test_solvers_agree_on_a_model(name, methods):
    """Edges, modes and verdicts are the same; times, states and limits within the tolerance."""
    entry = gallery.find(name)
    options = {"methods": methods, "history": entry.history}
    found = compare(entry.cls(), entry.start, entry.until, **options)
    assert found.explained, [d for d in found.differences if not d.explained]
    assert list(found.runs) == list(methods or COMPARED_METHODS)


def test_all_methods_are_compared_unless_some_are_chosen():
    """Of each mechanism, and of several orders."""
    entry = gallery.find("bouncing_ball")
    found = compare(entry.cls(), entry.start, entry.until)
    assert found.explained
    assert list(found.runs) == list(COMPARED_METHODS)
    assert len(found.runs) == 8


def test_what_the_tolerance_does_not_explain_is_seen():
    """A run at rtol 1e-3 passed off as one at 1e-9 is found out."""
    entry = gallery.find("bouncing_ball")
    exact, loose = {"solver": "taylor"}, {"solver": "scipy", "method": "RK45", "rtol": 1e-3}
    found = compare(
        systems.Drag(), {"x": 1.0, "v": 0.0}, (0, 2), methods={"exact": exact, "loose": loose}
    )
    assert not found.explained
    assert all(d.size > 0 for d in found.differences if d.quantity in CLOSE_QUANTITIES[:2])
    assert compare(
        entry.cls(), entry.start, entry.until, methods={"a": exact, "b": exact}
    ).explained


class Ticks(TwoTanks):
    """Two tanks; once a level is at a mark there is a jump that changes nothing."""

    mark: float = hy.parameter(4.5)

    @hy.edge("shares", to="shares", guard=lambda self, t, s: s.x1 - self.mark)
    def tick(self, t, s):
        return s


def passed_off(monkeypatch, change):
    """Two runs of the tanks side by side, the second of them changed and passed off as the same."""

    def run(model, start, t, changed=False, **options):
        return (
            change(model, start, t, options) if changed else hy.simulate(model, start, t, **options)
        )

    monkeypatch.setattr("hybrid.benchmark.agreement.simulate", run)
    methods = {"one": {"solver": "taylor"}, "other": {"solver": "scipy", "changed": True}}
    found = compare(Ticks(), {"x1": 8.0, "x2": 6.0}, (0, 30), methods=methods)
    return {d.quantity: d.size for d in found.differences}


def test_turns_of_a_cycle_are_compared_as_far_as_both_went_through_them(monkeypatch):
    """One run lists more turns before it goes over to the limit: that is no difference."""
    runs = []

    def same(model, start, t, options):
        with monkeypatch.context() as patch:
            patch.setattr(cycles, "LEAST_WINDOW", 20)  # the limit is looked for later
            runs.append(hy.simulate(model, start, t, **options))
        return runs[-1]

    sizes = passed_off(monkeypatch, same)
    series = hy.simulate(Ticks(), {"x1": 8.0, "x2": 6.0}, (0, 30), solver="taylor")
    assert len(runs[0].jumps) > len(series.jumps)
    assert [sizes[name] for name in SAME_QUANTITIES] == [0.0] * 3
    assert sizes["times"] < 1e-10


def test_a_jump_that_only_one_run_has_is_seen(monkeypatch):
    """The last of a run, which moves no state and no time."""
    model = Ticks(mark=3.0)
    sizes = passed_off(monkeypatch, lambda _, *a: hy.simulate(model, *a[:2], **a[2]))
    assert [sizes[name] for name in SAME_QUANTITIES] == [1.0, 0.0, 0.0]


def test_the_order_of_modes_before_a_limit_is_compared(monkeypatch):
    """Two arcs of a cycle change places, of the same modes in all."""

    def changed(model, start, t, options):
        run = hy.simulate(model, start, t, **options)
        run.log.kept, run.log.own = run.log.apart()
        third, fourth = run.log.kept[2:4]
        run.log.kept[2:4] = (
            attrs.evolve(third, mode=fourth.mode, segments=third.segments),
            attrs.evolve(fourth, mode=third.mode, segments=fourth.segments),
        )
        return run

    assert passed_off(monkeypatch, changed)["modes"] == 2.0


def test_a_method_that_fails_is_named():
    """A stop at a million steps, a method that is not there: in the table, not in its place."""
    entry = gallery.find("bouncing_ball")
    methods = {"exact": {"solver": "taylor"}, "none": {"solver": "scipy", "method": "Euler"}}
    found = compare(entry.cls(), entry.start, entry.until, methods=methods)
    assert not found.explained
    assert "Euler" in str(found.runs["none"])


def test_the_command_prints_a_line_for_each_quantity():
    result = CliRunner().invoke(app, ["compare", "two_walls"])
    assert result.exit_code == 0, result.output
    for quantity in ("edges", "modes", "verdicts", *CLOSE_QUANTITIES):
        assert f"\n{quantity} " in result.output
