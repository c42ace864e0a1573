"""The pictures of docs/maps.md but one, on finer grids than that page has.

python docs/figures/maps.py [FOLDER]

That of the valve over all its flows: python benchmarks/maps.py valve --to FOLDER
"""

import re
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hybrid as hy

HERE = Path(__file__).parent


def scope_of_the_page():
    """What its blocks of Python define."""
    scope = {"__name__": "page"}
    text = (HERE.parent / "maps.md").read_text()
    with redirect_stdout(StringIO()):
        exec("\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL)), scope)
    return scope


def followed(folder, asked, count=121):
    """The valve where two attractors are, followed up and down; it tells where it stands highest by
    an event, so that machine code flies it."""
    sys.path.insert(0, str(HERE.parent.parent))
    from benchmarks.maps import Valve

    q, axes = np.linspace(5.5, 6.7, count), plt.figure(figsize=(10, 5)).gca()
    asked = {**asked, "section": "turn", "keep": 32, "measure": ()}
    for values, name, size in ((q[::-1], "down", 4.5), (q, "up", 1.5)):
        found = hy.bifurcation(
            Valve(), over={"q": values}, t=(0.0, 450.0), skip=150, follow=True, **asked
        )
        highest = found.table.y1_section.values
        axes.plot(np.repeat(values, 32), highest.ravel(), ".", ms=size, label=f"followed {name}")
    axes.set(xlabel="q", ylabel="y1", title="ReliefValve: y1 on the section")
    axes.legend(markerscale=3, frameon=False)
    axes.figure.savefig(Path(folder) / "maps_followed.png", dpi=120, bbox_inches="tight")


def main(folder=HERE, count=64):
    """Draw all; ``count`` points along an axis."""
    scope = scope_of_the_page()
    starts = {"x": np.linspace(0.0, 8.0, count), "v": np.linspace(-5.0, 5.0, count)}
    found = hy.basins(scope["Table"](), starts, **scope["asked_basins"])
    found.plot(Path(folder) / "maps_basins.png")
    print(found)
    print(found.boundary())
    plane = {"obstacle": np.linspace(1.02, 1.4, count), "x": np.linspace(1.03, 1.9, count)}
    followed(folder, scope["asked_valve"])
    hy.region(over=plane, **scope["asked_region"]).plot(Path(folder) / "maps_region.png")


if __name__ == "__main__":
    main(*sys.argv[1:2])
