"""Attractors followed along a parameter (``docs/maps.md``)."""

import math
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.delay_bounce import DelayBounce

from .test_bifurcations import LEAST, Table


class Fold(hy.Automaton):
    """Two branches between two folds, at ``mu = +- 2 / sqrt(27)``."""

    x = hy.state()
    mu: float = hy.parameter(0.0)

    @hy.mode
    def only(self, t, s):
        return (self.mu + s.x - s.x**3,)


FOLD = 2.0 / math.sqrt(27.0)
MU = np.linspace(-0.5, 0.5, 21)
ASKED = {"start": {"x": 0.5}, "t": (0.0, 60.0), "section": 1.0, "skip": 58, "keep": 2}


@pytest.mark.parametrize("way", [1, -1])
def test_a_branch_is_followed_to_its_fold(way):
    """Up to the fold at its end, where the other one is come to; the way back is another."""
    table = hy.bifurcation(Fold(), {"mu": MU[::way]}, **ASKED, follow=True).table
    assert table.mu.values.tolist() == MU[::way].tolist()
    for mu, x in zip(table.mu.values, table.x_section.values[:, -1], strict=True):
        roots = np.sort_complex(np.roots([-1.0, 0.0, 1.0, mu]))
        real = roots.real[np.abs(roots.imag) < 1e-9]
        near = way * mu < FOLD
        # the slowest way in is that at 0.4, beside the fold: exp(-60 * 0.6)
        assert x == pytest.approx(min(real, key=lambda root: way * root * (1 if near else -1)))
    passed = way * table.mu.values > FOLD
    assert (way * table.x_section.values[:, -1] > 0).tolist() == passed.tolist()


def test_an_orbit_of_impacts_is_followed_to_its_end():
    """A ball that strikes its table once a period does so down to ``pi (1 - e)/(1 + e)``, at the
    phase whose cosine is that over ``G``; then it comes to rest, and it rests on the way up."""
    G, first = np.linspace(0.8, 0.5, 7), math.acos(LEAST / 0.8)
    flown = 2 * math.pi - first
    start = {"x": 0.8 * math.sin(first) + math.pi * flown - flown**2 / 2, "v": math.pi - flown}
    asked = {"start": start, "t": (0.0, 400 * math.pi), "section": 2 * math.pi, "skip": 190}
    down = hy.bifurcation(Table(), {"G": G}, **asked, keep=4, follow=True).table
    once = G > LEAST
    assert once.sum() == 5
    # at 0.6 a turn takes a third of what is left, by far less than 1e-9 in 190
    exact = np.arccos(LEAST / G[once]) - math.pi
    np.testing.assert_allclose(down.v_section.values[once, -1], exact, rtol=0, atol=1e-9)
    assert down["mode"].values.tolist() == ["flight"] * 5 + ["flight.rest(impact)"] * 2
    up = hy.bifurcation(Table(), {"G": G[::-1]}, **asked, keep=4, follow=True).table
    assert set(up["mode"].values.tolist()) == {"flight.rest(impact)"}
    assert up.jumps.values[1:].tolist() == [0] * 6


def test_whoever_flies_them_lanes_follow_in_order(tmp_path):
    """Blocks, an executor and an interrupt have no say."""
    pytest.importorskip("zarr")
    from hybrid.maps.store import status

    asked = {"over": {"mu": MU}, **ASKED, "follow": True}
    whole = hy.sweep(Fold(), **asked)
    assert whole.identical(hy.sweep(Fold(), **asked, block=2))
    with ThreadPoolExecutor(2) as pool:
        assert whole.identical(hy.sweep(Fold(), **asked, block=4, executor=pool))
    path, told = tmp_path / "map.zarr", []

    def stop(done, lanes):
        told.append((done, lanes))
        if done >= 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        hy.sweep(Fold(), **asked, block=4, store=path, progress=stop)
    assert told == [(4, 21), (8, 21)]
    assert status(path)["done"] == 2
    assert whole.identical(hy.sweep(Fold(), **asked, block=4, store=path))
    with pytest.raises(hy.StoreError, match="other options"):
        hy.sweep(Fold(), **{**asked, "follow": False}, block=4, store=path)


class Root(hy.Automaton):
    """Falls by the root of a parameter, which may have none."""

    x = hy.state()
    k: float = hy.parameter(1.0)

    @hy.mode
    def only(self, t, s):
        return (-jnp.sqrt(self.k),)


@pytest.mark.parametrize("block", [1, 5])
def test_after_a_lane_that_fails_the_next_begins_anew(block):
    """At the start, whatever block it is in; what has failed is a row with its reason."""
    k = [1.0, 4.0, -1.0, 9.0, 16.0]
    table = hy.sweep(Root(), {"k": k}, {"x": 10.0}, (0.0, 1.0), follow=True, block=block)
    assert table.status.values[2] == "not_finite"
    assert table.x.values[[0, 1, 3, 4]].tolist() == [9.0, 7.0, 7.0, 3.0]


def test_a_start_may_be_a_function_of_the_model():
    """Of the first model, and of the one after a lane that has failed."""
    asked = {"over": {"k": [1.0, 4.0, -1.0, 9.0, 16.0]}, "t": (0.0, 1.0), "follow": True}
    table = hy.sweep(Root(), start=lambda self: {"x": 10.0 + self.k}, **asked)
    assert table.x.values[[0, 1, 3, 4]].tolist() == [10.0, 8.0, 16.0, 12.0]


@pytest.mark.parametrize(
    ("model", "change", "said"),
    [
        (Fold, {"over": {"mu": MU, "x": [0.0]}}, "over one parameter, not over mu, x"),
        (Fold, {"over": {"x": MU}}, "over one parameter, not over x"),
        (Fold, {"t": (0.0, 60.5)}, "60.5 periods of section=; a whole number is due"),
        (Fold, {"max_jumps": 3}, "leave out max_jumps"),
        (Fold, {"refine": {"mu": 0.1}}, "no refine="),
        (DelayBounce, {"over": {"r": [0.5]}}, "it looks into the past"),
    ],
)
def test_what_cannot_be_followed(model, change, said):
    """Wrong use is one clear error."""
    with pytest.raises(hy.OptionError, match=f"{model.__name__}: follow=True.*{said}"):
        hy.sweep(model(), **{"over": {"mu": MU}, **ASKED, "follow": True, **change})
