"""Each model of the gallery is held to its oracle, on both solvers that reach rounding."""

import pytest

import hybrid as hy
from hybrid import gallery


@pytest.mark.parametrize("name", gallery.names())
def test_model_agrees_with_its_oracle(name, accurate):
    """Every value of ``oracle(run)`` within the tolerance given there (relative above 1)."""
    entry = gallery.find(name)
    asked = entry.cls(), entry.start, entry.until
    run = hy.simulate(*asked, history=entry.history, **accurate)
    checked = 0
    for what, value, exact, tolerance in entry.module.oracle(run):
        assert abs(value - exact) <= tolerance * max(1.0, abs(exact)), what
        checked += 1
    assert checked >= 2


def test_moon_holmes_without_forcing(accurate):
    """The paper's unperturbed beam."""
    entry = gallery.find("moon_holmes")
    model = entry.cls(delta=0.0, gamma=0.0)
    run = hy.simulate(model, entry.start, entry.until, **accurate)
    for what, value, exact, tolerance in entry.module.oracle(run):
        assert abs(value - exact) <= tolerance * max(1.0, abs(exact)), what


def test_every_file_is_in_the_table():
    """models/README.md lists each model."""
    table = (gallery.folder() / "README.md").read_text()
    for name in gallery.names():
        assert f"`{name}`" in table
