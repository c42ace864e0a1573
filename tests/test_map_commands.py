"""``hybrid basins``, ``bifurcation``, ``region``: maps and their pictures, a command each."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

import hybrid as hy
from hybrid.cli import app
from hybrid.maps import diagram

from .swept import Ball
from .wells import Floor, Wells

call = CliRunner().invoke

WELLS = str(Path(__file__).with_name("wells.py")) + ":Wells"
FLOOR = str(Path(__file__).with_name("wells.py")) + ":Floor"


def test_basins(tmp_path):
    """Attractors as lines, or as JSON; the picture and the table are written."""
    asked = ["--over", "x=-1.25:1.25:4", "--start", "v=0", "--from", "0", "--until", "100"]
    asked += ["--section", "1.0", "--keep", "8"]
    files = tmp_path / "basins.png", tmp_path / "basins.nc"
    done = call(app, ["basins", WELLS, *asked, "--plot", str(files[0]), "--save", str(files[1])])
    assert done.exit_code == 0, done.output
    first, *lines, last = done.stdout.splitlines()
    assert first == "Wells: 4 starts"
    assert [line[:20] for line in lines] == ["  0: rest in free, x", "  1: rest in free, x"]
    assert last == f"picture: {files[0]}"
    assert files[0].stat().st_size > 1000
    assert xarray.load_dataset(files[1]).attractor.values.tolist() == [0, 0, 1, 1]
    found = json.loads(call(app, ["basins", WELLS, *asked, "--json"]).stdout)
    assert [each["share"] for each in found["attractors"]] == [0.5, 0.5]
    assert found["attractors"][1]["state"]["x"] == pytest.approx(1.0)
    done = call(app, ["basins", WELLS, *asked[:8]])
    assert done.exit_code == 2
    assert "--section is needed" in done.stderr


def test_bifurcation(tmp_path):
    """Points at the jumps of a contact, and where a state has a value."""
    picture = tmp_path / "diagram.png"
    asked = ["--over", "G=[0.7,0.9]", "--start", "x=1.5", "--start", "v=2.5", "--from", "0"]
    asked += ["--until", "300", "--skip", "20", "--keep", "4", "--plot", str(picture)]
    done = call(app, ["bifurcation", FLOOR, "v", *asked, "--section", "impact"])
    assert done.exit_code == 0, done.output
    assert done.stdout == f"Floor: 2 lanes: 2 reached_end\npicture: {picture}\n"
    assert picture.stat().st_size > 1000
    done = call(
        app, ["bifurcation", FLOOR, "x", *asked, "--section", "v=0", "--crossing", "falling"]
    )
    assert done.exit_code == 0, done.output
    done = call(app, ["bifurcation", FLOOR, "x", *asked, "--section", "v=up"])
    assert "--section v=up: write NAME=NUMBER" in done.stderr
    done = call(app, ["bifurcation", FLOOR, "x", *asked, "--section", "v=0", "--crossing", "down"])
    assert "--crossing down: rising, falling, either" in done.stderr
    done = call(app, ["bifurcation", FLOOR, "w", *asked, "--section", "impact"])
    assert done.exit_code == 2, done.output
    assert "Floor has no state or output 'w'; there are: x, v" in done.stderr


def test_a_followed_attractor(tmp_path):
    """``--follow`` is ``follow=True``."""
    file = tmp_path / "followed.nc"
    asked = ["--over", "G=[0.7,0.9]", "--start", "x=1.5", "--start", "v=2.5", "--from", "0"]
    asked += ["--until", repr(20 * np.pi), "--section", repr(2 * np.pi), "--skip", "0"]
    done = call(app, ["bifurcation", FLOOR, "v", *asked, "--follow", "--save", str(file)])
    assert done.exit_code == 0, done.output
    own = hy.bifurcation(
        Floor(), {"G": [0.7, 0.9]}, {"x": 1.5, "v": 2.5}, (0.0, 20 * np.pi),
        section=2 * np.pi, skip=0, follow=True,
    )  # fmt: skip
    assert xarray.load_dataset(file).v_section.equals(own.table.v_section)


def test_region(tmp_path):
    """A plane by verdict, and what is proved drawn over it."""
    picture = tmp_path / "region.png"
    asked = ["--over", "r=0.3:0.9:4", "--over", "x=0.5:2.5:5", "--plot", str(picture)]
    done = call(app, ["region", "bouncing_ball", *asked, "--box", "x=0:2.2", "--box", "v=-7:7"])
    assert done.exit_code == 0, done.output
    assert done.stdout == f"BouncingBall: 20 lanes: 20 reached_end\npicture: {picture}\n"
    assert picture.stat().st_size > 1000
    done = call(app, ["region", "bouncing_ball", *asked, "--by", "t_inf"])
    assert done.exit_code == 2
    assert "can be told apart" in done.stderr


BOX = {"x": (0.0, 1.75), "v": (-7.0, 7.0)}


def test_what_is_proved_of_a_plane():
    """From rest at heights within the box, whatever the restitution: ``h < 1.75``, as 7 m/s is more
    than a fall from there; from another speed nothing is proved."""
    over = {"r": [0.3, 0.8], "x": [0.5, 1.5, 1.75, 2.0]}
    found = hy.region(Ball(), over, {"v": 0.0}, (0.0, 30.0), box=BOX)
    assert found.table.certified.dims == ("r", "x_start")
    assert found.table.certified.values.tolist() == [[True, True, False, False]] * 2
    assert np.all(found.table.verdict == "estimated")
    moving = hy.region(Ball(), over, {"v": 0.1}, (0.0, 30.0), box=lambda self: BOX)
    assert not moving.table.certified.values.any()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"over": {"r": [0.3, 0.8]}}, "two names"),
        ({"by": "t_inf"}, "can be told apart"),
        ({"by": "colour"}, "one value a lane is due"),
        ({"refine": {"r": 0.1}}, "box= takes a grid"),
        ({"box": {"gap": (0.0, 0.1), "speed": (0.0, 0.1)}}, "bounds of position and velocity"),
    ],
)
def test_what_is_no_region(change, said):
    """Wrong use is one clear error."""
    over = {"r": [0.3, 0.8], "x": np.linspace(0.5, 2.0, 7)}
    asked = {"over": over, "start": {"v": 0.0}, "t": (0.0, 9.0), "box": BOX}
    with pytest.raises(hy.OptionError, match=said):
        hy.region(Ball(), **{**asked, **change})


def test_many_points_are_a_density(monkeypatch, tmp_path):
    """Each cell has as many points as fall into it, none is lost."""
    monkeypatch.setattr(diagram, "MOST_DOTS", 10)
    found = hy.bifurcation(
        Ball(), {"r": np.linspace(0.5, 0.8, 5)}, {"x": 1.0, "v": 0.0}, (0.0, 2.0),
        section="impact", skip=0, keep=3,
    )  # fmt: skip
    panel = diagram._shown(*(np.repeat(np.arange(5.0), 3), np.arange(15.0)))
    assert panel.density.count.sum() == 15
    assert panel.density.count.shape == (400, 5)
    (axes,) = found.plot("v", tmp_path / "density.png").axes
    assert axes.collections
    pytest.importorskip("plotly")
    found.plot("v", tmp_path / "density.html")
    assert (tmp_path / "density.html").stat().st_size > 1000


def test_a_refined_plane_is_dots(tmp_path):
    """One for each lane, in the colour of its kind."""
    found = hy.region(
        Wells(), {"x": np.linspace(-1.0, 1.0, 3), "v": np.linspace(-0.5, 0.5, 3)}, t=(0.0, 20.0),
        by="right_of_zero", measure=[right_of_zero], refine={"x": 0.5, "v": 0.5},
    )  # fmt: skip
    (axes,) = found.plot(tmp_path / "dots.png").axes
    drawn = sum(len(line.get_xdata()) for line in axes.lines if line.get_linestyle() == "None")
    assert drawn == found.table.sizes["lane"] > 9


def right_of_zero(table):
    """In which well a lane is."""
    return table.x > 0


@pytest.mark.parametrize(
    "command", [["sweep"], ["basins"], ["bifurcation", "x"], ["region", "--over", "v=0:1:2"]]
)
def test_all_maps_have_the_options_of_a_run(command):
    """Tolerances, methods, steps and what is done at accumulations: checked as for a run."""
    asked = [command[0], WELLS, *command[1:], "--over", "x=0:1:2", "--until", "1"]
    asked += ["--start", "v=0"] if command[0] != "region" else []
    asked += ["--section", "1.0"]
    for option, value in {"rtol": "-1", "method": "none", "max-step": "0", "zeno": "no"}.items():
        done = call(app, [*asked, "--solver", "scipy", f"--{option}", value])
        assert done.exit_code == 2, done.output
        assert option.replace("-", "_") in done.stderr
