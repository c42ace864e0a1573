"""The pictures of docs/maps.md but for the valve, from the models of that page on finer grids.

python docs/figures/maps.py [FOLDER]

That of the valve: python benchmarks/maps.py valve --to FOLDER
"""

import re
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

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


def main(folder=HERE, count=64):
    """Draw both; ``count`` points along an axis."""
    scope = scope_of_the_page()
    starts = {"x": np.linspace(0.0, 8.0, count), "v": np.linspace(-5.0, 5.0, count)}
    found = hy.basins(scope["Table"](), starts, **scope["asked_basins"])
    found.plot(Path(folder) / "maps_basins.png")
    print(found)
    print(found.boundary())
    plane = {"obstacle": np.linspace(1.02, 1.4, count), "x": np.linspace(1.03, 1.9, count)}
    hy.region(over=plane, **scope["asked_region"]).plot(Path(folder) / "maps_region.png")


if __name__ == "__main__":
    main(*sys.argv[1:2])
