"""All solvers agree on every model of the gallery, up to what the tolerance explains."""

import pytest
from typer.testing import CliRunner

from hybrid import gallery
from hybrid.cli import app
from hybrid.compare import CLOSE, able, compare

from . import systems


@pytest.mark.parametrize("name", gallery.names())
def test_solvers_agree_on_a_model(name):
    """Edges, modes and verdicts are the same; times, states and limits within the tolerance."""
    entry = gallery.find(name)
    found = compare(entry.cls(), entry.start, entry.until, history=entry.history)
    assert found.explained, [d for d in found.differences if not d.explained]
    assert list(found.runs) == list(able(entry.cls))
    assert len(found.runs) == 8 + (not entry.cls.spec.lags)


def test_what_the_tolerance_does_not_explain_is_seen():
    """A run at rtol 1e-3 passed off as one at 1e-9 is found out."""
    entry = gallery.find("bouncing_ball")
    exact, loose = {"solver": "taylor"}, {"solver": "scipy", "method": "RK45", "rtol": 1e-3}
    found = compare(
        systems.Drag(), {"x": 1.0, "v": 0.0}, (0, 2), methods={"exact": exact, "loose": loose}
    )
    assert not found.explained
    assert all(d.size > 0 for d in found.differences if d.quantity in CLOSE[:2])
    assert compare(
        entry.cls(), entry.start, entry.until, methods={"a": exact, "b": exact}
    ).explained


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
    for quantity in ("edges", "modes", "verdicts", *CLOSE):
        assert f"\n{quantity} " in result.output
