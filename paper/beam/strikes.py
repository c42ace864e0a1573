"""The beam of section 4 struck blow by blow: what happens, with nothing summed and nothing proved.

A model of its own, without a contact: its impacts are plain jumps of the speed, each of them
computed, down to a speed of 1e-6, at which the beam is held if the force presses it on the
obstacle. So nothing of what this package does about accumulations takes part: no sum, no resting
mode, no certificate.
"""

from __future__ import annotations

from collections.abc import Mapping
from shutil import rmtree
from typing import Any

import attrs
import jax.numpy as jnp
import numpy as np

from hybrid import gallery
from hybrid.automaton import Automaton, edge, mode, parameter, state
from hybrid.errors import StoreError
from hybrid.maps import sweep

#: Where the beam of the figure starts.
START = 1.3

#: Speeds: of the impacts that are kept, of an impact so slow that the beam is held.
LEVELS, HELD = np.array([0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4, 1e-5]), 1e-6

#: What the last flight of a series is of its first, at most.
SHRUNK = 0.5

#: Longer than any flight; more than any speed.
FAR = 1e4

#: How long a lane is flown: so long, and so many periods of the forcing.
LASTS, PERIODS = 80.0, 2

#: Tolerances of a step.
RTOL, ATOL = 1e-9, 1e-12


class Struck(Automaton):
    """The beam at a distance ``y`` from the obstacle, and a record of its impacts."""

    y = state(doc="distance from the obstacle")
    v = state(doc="velocity")
    age = state(doc="time since the last impact")
    flight = state(doc="length of the flight before the last impact")
    row = state(doc="flights so far in a row, each shorter than the one before")
    first = state(doc="length of the flight that this row began with")
    longest = state(doc="longest such row to shrink enough, of those that a longer flight ended")
    count = state(doc="impacts")
    pace = state(doc="speed after the last impact")
    fuse = state(doc="burns down; lit at once by an impact slow enough, then the time of it")
    times = state(shape=(len(LEVELS) + 1,), doc="of the last impacts to fall below each level")
    speeds = state(shape=(len(LEVELS) + 1,), doc="of these, and of the slowest impact")

    r: float = parameter(0.9)
    obstacle: float = parameter(1.1)
    delta: float = parameter(0.05)
    gamma: float = parameter(0.05)
    w: float = parameter(0.1)

    def push(self, t: Any, y: Any) -> Any:
        """The force without damping; negative where it presses on the obstacle."""
        x = self.obstacle + y
        return x - x**3 + self.gamma * jnp.cos(self.w * t)

    def _rates(self, *own: Any, fuse: float = 0.0) -> Any:
        """Rates of ``y``, ``v``, ``age`` and of the fuse; the rest stands still."""
        none = jnp.zeros(len(LEVELS) + 1)
        return (*own, *[0.0] * (9 - len(own)), fuse, none, none)

    @mode(initial=True)  # type: ignore[untyped-decorator]
    def flies(self, t: Any, s: Any) -> Any:
        force = self.push(t, s.y) - self.delta * s.v
        return self._rates(s.v, force, 1.0, fuse=-1.0)

    @mode
    def held(self, t: Any, s: Any) -> Any:
        return self._rates()

    @mode
    def released(self, t: Any, s: Any) -> Any:
        return self._rates()

    @edge(flies, to=flies, guard=lambda self, t, s: s.y)  # type: ignore[untyped-decorator]
    def strike(self, t: Any, s: Any) -> Any:
        v = -self.r * s.v
        shorter, shrunk = s.age < s.flight, s.flight <= SHRUNK * s.first
        falls = jnp.append((v < LEVELS) & (s.pace >= LEVELS), v < s.speeds[-1])
        ends = (v < HELD) & (self.push(t, 0.0) < 0.0)
        return s.replace(
            y=0.0,
            v=v,
            age=0.0,
            flight=s.age,
            row=jnp.where(shorter, s.row + 1.0, 0.0),
            first=jnp.where(shorter, s.first, s.age),
            longest=jnp.maximum(s.longest, jnp.where(~shorter & shrunk, s.row, 0.0)),
            count=s.count + 1.0,
            pace=v,
            fuse=jnp.where(ends, 0.0, FAR),
            times=jnp.where(falls, t, s.times),
            speeds=jnp.where(falls, v, s.speeds),
        )

    @edge(flies, to=held, guard=lambda self, t, s: s.fuse)  # type: ignore[untyped-decorator]
    def hold(self, t: Any, s: Any) -> Any:
        return s.replace(y=0.0, v=0.0, fuse=t)

    @edge(held, to=released, guard=lambda self, t, s: -self.push(t, 0.0))  # type: ignore[untyped-decorator]
    def release(self, t: Any, s: Any) -> Any:
        return s.replace(age=t)


@attrs.frozen(eq=False)
class Lanes:
    """What became of each lane.

    Attributes
    ----------
    delta, gamma, w : array
        Its parameters.
    end : array
        Until when it was flown.
    held, released : array
        When the impacts had become so slow that the beam was held, and when the force then
        pulled it off; NaN where that did not happen.
    longest : array of int
        Flights, less one, in the longest row of shorter and shorter ones that has shrunk to
        ``SHRUNK`` of its first flight and that a longer one has ended.
    count : array of int
        Impacts.
    times, speeds : array, shape (lanes, levels + 1)
        The last impact of the lane that fell below each of ``LEVELS``, then its slowest impact;
        NaN where there was none. Speeds are those after the impact.
    """

    delta: np.ndarray
    gamma: np.ndarray
    w: np.ndarray
    end: np.ndarray
    held: np.ndarray
    released: np.ndarray
    longest: np.ndarray
    count: np.ndarray
    times: np.ndarray
    speeds: np.ndarray

    @property
    def late(self) -> np.ndarray:
        """Lanes that were held too late to be seen through a period of the forcing."""
        left = self.end - self.held < 2.0 * np.pi / self.w
        return ~np.isnan(self.held) & np.isnan(self.released) & left


def fly(over: Mapping[str, Any], gamma: float = 0.0, store: Any = None) -> Lanes:
    """Fly all beams of a grid from rest, each blow by itself.

    ``over`` has values of ``delta``, ``gamma``, ``w``, and of ``y``, the height above the obstacle,
    which is that of the figure if omitted; the last name varies fastest. What is in the store is
    not flown again; one of another map, as of an older state of this file, is made anew.

    Raises
    ------
    ArithmeticError
        If a lane fails.
    """
    own = gallery.find("moon_holmes").cls()
    model = Struck(r=own.r, obstacle=own.obstacle, gamma=gamma)
    none = np.zeros(len(LEVELS) + 1)
    first: dict[str, Any] = {"y": START - own.obstacle, "v": 0.0, "age": 0.0, "flight": 0.0}
    first |= {"row": 0.0, "first": 0.0, "longest": 0.0, "count": 0.0, "pace": FAR, "fuse": FAR}
    first |= {"times": none, "speeds": none + FAR}
    start = {name: value for name, value in first.items() if name not in over}
    asked: dict[str, Any] = {"rtol": RTOL, "atol": ATOL, "zeno": "ignore"}
    try:
        table = sweep(model, over, start, _span, store=store, **asked)
    except StoreError:
        rmtree(store)
        table = sweep(model, over, start, _span, store=store, **asked)
    return _lanes(table, over, gamma)


def _span(model: Any) -> tuple[float, float]:
    """So long, and so many periods of the forcing."""
    return 0.0, LASTS + PERIODS * 2.0 * np.pi / model.w


def _lanes(table: Any, over: Mapping[str, Any], gamma: float) -> Lanes:
    """The map as rows."""
    rows = [a.ravel() for a in np.meshgrid(*over.values(), indexing="ij")]
    given = {"gamma": np.full(rows[0].size, gamma), **dict(zip(over, rows, strict=True))}
    delta, gammas, w = (given[name] for name in ("delta", "gamma", "w"))

    def flat(name: str) -> np.ndarray:
        values: np.ndarray = table[name].values
        return values.reshape(len(delta), *values.shape[len(over) :])

    failed = flat("status") != "reached_end"
    if np.any(failed):
        place = int(np.argmax(failed))
        where = f"delta = {delta[place]}, gamma = {gammas[place]}, w = {w[place]}"
        raise ArithmeticError(f"lane {place} ({where}): {flat('reason')[place]}")
    modes, speeds = flat("mode"), flat("speeds")
    never = speeds >= FAR
    return Lanes(
        delta,
        gammas,
        w,
        LASTS + PERIODS * 2.0 * np.pi / w,
        np.where(modes == "flies", np.nan, flat("fuse")),
        np.where(modes == "released", flat("age"), np.nan),
        flat("longest").astype(int),
        flat("count").astype(int),
        np.where(never, np.nan, flat("times")),
        np.where(never, np.nan, speeds),
    )
