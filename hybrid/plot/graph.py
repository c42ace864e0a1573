"""A model as a graph of modes and edges: nodes and arrows as data, and their drawing."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.markers import Crossing
from ..automaton.spec import ClockSpec, ContactSpec, EdgeSpec, Spec, Transition
from . import require_writable
from .figure import LIMIT_COLOR, LINE_COLOR, OTHER_COLOR, SURFACE_COLOR

if TYPE_CHECKING:
    from ..automaton.shapes import Matrix, Numbers

#: Symbols for the crossing directions of guards.
WAYS = {Crossing.FALLING: "↓", Crossing.RISING: "↑", Crossing.EITHER: "↕"}
WAYS_IN_WORDS = {"↓": "falls to zero", "↑": "rises to zero", "↕": "either"}

#: Where along an arrow its label may be: the first place that no other label is at.
LABEL_PLACES = (0.5, 0.36, 0.64, 0.24, 0.76)

#: Times of a clock that its label names; of more it says how many.
TIMES_SHOWN = 3

#: Lengths in inches: a letter, a line, the margin around a name, a loop; and the bend of arrows
#: relative to their length.
LETTER, LINE, AROUND, LOOP, BEND = 0.085, 0.16, 0.16, 0.82, 0.16

#: Colour of each kind of node, and whether it is dashed.
NODE_KINDS = {
    "initial": (LINE_COLOR, False),
    "mode": (LINE_COLOR, False),
    "rest": (OTHER_COLOR, True),
    "slide": (LIMIT_COLOR, True),
    "end": (SURFACE_COLOR, False),
}


@attrs.frozen
class ModeNode:
    """A mode, a rest on a contact, or sliding on a surface; for ``kind`` see ``NODE_KINDS``."""

    name: str
    kind: str

    @property
    def half(self) -> Numbers:
        """Half the width and half the height, in inches."""
        return np.array([0.5 * LETTER * len(self.name) + AROUND, 0.5 * LINE + 0.5 * AROUND])


@attrs.frozen
class Arrow:
    """All edges from one node to another; without labels, the two-way link of a contact or
    switching to its derived mode."""

    source: int
    to: int
    labels: tuple[str, ...] = ()


@attrs.frozen
class AutomatonChart:
    """The nodes of a model, related ones adjacent, and its arrows."""

    model: str
    nodes: tuple[ModeNode, ...]
    arrows: tuple[Arrow, ...]


def graph(spec: Spec) -> AutomatonChart:
    """The graph of a model's modes and transitions."""
    known = [mode.name for mode in spec.modes]
    nodes, joined = list[ModeNode](), list[tuple[str, str]]()
    for name in known:
        nodes.append(ModeNode(name, "initial" if name == spec.initial else "mode"))
        for edge in spec.transitions:
            if isinstance(edge, ContactSpec) and edge.source == name and edge.rests:
                nodes.append(ModeNode(f"{name}.rest({edge.name})", "rest"))
                joined.append((name, nodes[-1].name))
        for each in spec.switchings:
            if each.slides and each.positive == name:
                nodes.append(ModeNode(each.mode, "slide"))
                joined += [(each.mode, each.positive), (each.mode, each.negative)]
    places = {node.name: place for place, node in enumerate(nodes)}
    labels: dict[tuple[int, int], list[str]] = {}
    for edge in spec.transitions:
        for name in (edge.source, edge.to):
            if name not in places:
                places[name] = len(nodes)
                nodes.append(ModeNode("end", "end"))
        pair = places[edge.source], places[edge.to]
        labels.setdefault(pair, []).append(label(edge))
    for mode in spec.modes:
        last = [edge.to for edge in spec.transitions if edge.name in mode.limit_of[-1:]]
        for name in last:
            labels.setdefault((places[name], places[mode.name]), []).append("limit ∞")
    arrows = [Arrow(*pair, tuple(lines)) for pair, lines in labels.items()]
    arrows += [Arrow(places[one], places[other]) for one, other in joined]
    return AutomatonChart(spec.model, tuple(nodes), tuple(arrows))


def label(edge: Transition) -> str:
    """What an arrow says of an edge: how its guard reaches zero, or when it rings."""
    asks = ", when" if isinstance(edge, EdgeSpec) and edge.when is not None else ""
    if not isinstance(edge, ClockSpec):
        return f"{edge.name} {WAYS[edge.crossing]}{asks}"
    if edge.times.at is None:
        return f"{edge.name}, every {edge.times.every}{asks}"
    times = [edge.times.at] if np.ndim(edge.times.at) == 0 else list(edge.times.at)
    said = ", ".join(map(str, times)) if len(times) <= TIMES_SHOWN else f"{len(times)} times"
    return f"{edge.name}, at {said}{asks}"


def laid(nodes: Sequence[ModeNode]) -> Matrix:
    """Positions of the nodes in inches: side by side, or around an ellipse."""
    count = len(nodes)
    if count < 3:
        gap = 2.0 + sum(float(node.half[0]) for node in nodes)
        return np.array([[k * gap, 0.0] for k in range(count)])
    widest = max(2.0 * float(node.half[0]) for node in nodes)
    angles = pi - 2.0 * pi * np.arange(count) / count
    across, high = (widest + 1.3) * count / (2.0 * pi) + 0.6, 0.32 * count + 0.4
    return np.array([[across * cos(angle), high * sin(angle)] for angle in angles])


def draw(shown: AutomatonChart, path: Any = None) -> Any:
    """The figure of a graph, written to ``path`` if one is given."""
    require_writable(path)
    from matplotlib.figure import Figure as Drawn

    places = laid(shown.nodes)
    center = places.mean(axis=0)
    drawn = Drawn()
    axes = drawn.add_axes((0.0, 0.0, 1.0, 1.0))
    corners = [places[k] + s * node.half for k, node in enumerate(shown.nodes) for s in (-1, 1)]
    taken = [(place, node.half) for place, node in zip(places, shown.nodes, strict=True)]
    for arrow in shown.arrows:
        corners += _arrow(axes, shown, places, arrow, center, taken)
    for place, node in zip(places, shown.nodes, strict=True):
        _node(axes, node, place)
    low, high = np.min(corners, axis=0) - 0.25, np.max(corners, axis=0) + 0.25
    low[1], high[1] = low[1] - 0.3, high[1] + 0.3
    written = "".join(label for arrow in shown.arrows for label in arrow.labels)
    ways = [f"{way} {words}" for way, words in WAYS_IN_WORDS.items() if way in written]
    said = f"guards: {', '.join(ways)}" if ways else ""
    low[0] = min(low[0], high[0] - 0.75 * LETTER * len(said))
    axes.text(low[0] + 0.1, high[1] - 0.2, shown.model, fontsize=11, va="center", weight="bold")
    axes.text(low[0] + 0.1, low[1] + 0.17, said, fontsize=7.5, va="center", color="#555555")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_axis_off()
    drawn.set_size_inches(*(high - low))
    if path is not None:
        drawn.savefig(path, dpi=150)
    return drawn


def _node(axes: Any, node: ModeNode, place: Numbers) -> None:
    from matplotlib.patches import FancyBboxPatch

    color, dashed = NODE_KINDS[node.kind]
    corner, size = place - node.half + 0.06, 2.0 * node.half - 0.12
    box = FancyBboxPatch(
        (float(corner[0]), float(corner[1])),
        float(size[0]),
        float(size[1]),
        boxstyle="round,pad=0.06",
        facecolor="white",
        edgecolor=color,
        linewidth=2.4 if node.kind == "initial" else 1.3,
        linestyle="--" if dashed else "-",
        zorder=3,
    )
    axes.add_patch(box)
    axes.text(*place, node.name, ha="center", va="center", fontsize=9, zorder=4)


def _arrow(
    axes: Any,
    shown: AutomatonChart,
    places: Matrix,
    arrow: Arrow,
    center: Numbers,
    taken: list[tuple[Numbers, Numbers]],
) -> list[np.ndarray]:
    """Draw an arrow with its labels; corners of what it covers.

    ``taken``: middles and half sizes of the boxes and labels there are, to which its own is added.
    """
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    ends = shown.nodes[arrow.source], shown.nodes[arrow.to]
    a, b = places[arrow.source], places[arrow.to]
    loop = arrow.source == arrow.to
    back = any((o.source, o.to) == (arrow.to, arrow.source) and o.labels for o in shown.arrows)
    bend = BEND if arrow.labels and back else 0.0
    curve = _loop(ends[0], a, center) if loop else _bow(a, b, bend)
    for node, place in zip(ends, (a, b), strict=True):
        curve = curve[np.any(np.abs(curve - place) > node.half + 0.03, axis=1)]
    dashed = not arrow.labels
    axes.add_patch(
        FancyArrowPatch(
            path=Path(curve),
            arrowstyle="<|-|>" if dashed else "-|>",
            mutation_scale=10,
            color=SURFACE_COLOR if dashed else "#1c2733",
            linestyle="--" if dashed else "-",
            linewidth=1.0,
            zorder=1,
        )
    )
    if not arrow.labels:
        return [curve.min(axis=0), curve.max(axis=0)]
    size = np.array([0.85 * LETTER * max(map(len, arrow.labels)), LINE * len(arrow.labels)])
    outwards = curve[len(curve) // 2] - a if loop else np.array([a[1] - b[1], b[0] - a[0]])
    outwards = outwards / max(float(np.linalg.norm(outwards)), 1e-9)
    away = outwards * (0.5 * np.abs(outwards) @ size + 0.05)
    spots = [curve[int(share * (len(curve) - 1))] + away for share in LABEL_PLACES]
    free = (p for p in spots if not any(_overlap(p, 0.5 * size, *other) for other in taken))
    place = next(free, spots[0])
    taken.append((place, 0.5 * size))
    axes.text(
        *place,
        "\n".join(arrow.labels),
        ha="center",
        va="center",
        fontsize=8,
        zorder=2,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85},
    )
    return [curve.min(axis=0), curve.max(axis=0), place - 0.5 * size, place + 0.5 * size]


def _overlap(place: Numbers, half: Numbers, other: Numbers, other_half: Numbers) -> bool:
    """Whether two boxes, each by its middle and half its size, cover a common place."""
    return bool(np.all(np.abs(place - other) < half + other_half))


def _bow(a: Numbers, b: Numbers, bend: float) -> Matrix:
    """Points of a bow from ``a`` to ``b``, bent to the left."""
    way = b - a
    aside = 0.5 * (a + b) + 2.0 * bend * np.array([-way[1], way[0]])
    s = np.linspace(0.0, 1.0, 201)[:, None]
    return (1 - s) ** 2 * a + 2 * s * (1 - s) * aside + s**2 * b  # type: ignore[no-any-return]


def _loop(node: ModeNode, place: Numbers, center: Numbers) -> Matrix:
    """Points of a loop from a node to itself, on the side away from the others."""
    up = 1.0 if place[1] - center[1] > -1e-9 else -1.0
    aside = np.array([min(0.75, float(node.half[0])), 0.0])
    high = np.array([0.0, up * 1.3 * (LOOP + float(node.half[1]))])
    s = np.linspace(0.0, 1.0, 201)[:, None]
    corners = place + np.array([-0.5 * aside, high - aside, high + aside, 0.5 * aside])
    weights = np.hstack([(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s**2 * (1 - s), s**3])
    return weights @ corners  # type: ignore[no-any-return]
