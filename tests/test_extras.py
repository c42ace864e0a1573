"""What needs a package beyond the base says so before it begins, with the remedy."""

import sys

import numpy as np
import pytest
from typer.testing import CliRunner

import hybrid as hy
from hybrid.cli import app
from models.bouncing_ball import BouncingBall
from paper import report

START, SPAN = {"x": 1.0, "v": 0.0}, (0.0, 0.5)


@pytest.fixture(scope="module")
def run():
    return hy.simulate(BouncingBall(), START, SPAN)


CALLS = [
    (lambda run, path: run.plot(), "matplotlib", "run.plot"),
    (lambda run, path: run.plot(path / "run.png"), "matplotlib", "run.plot"),
    (lambda run, path: run.plot(path / "run.html"), "plotly", "run.plot to .html"),
    (lambda run, path: run.plot(path / "RUN.HTML"), "plotly", "run.plot to .html"),
    (lambda run, path: run.to_xarray(), "xarray", "run.to_xarray"),
    (lambda run, path: run.save(path / "run.nc"), "h5py", "run.save"),
    (lambda run, path: hy.load(path / "run.nc"), "h5netcdf", "hy.load"),
    (
        lambda run, path: hy.ensemble(BouncingBall(), {"x": np.ones(2), "v": 0.0}, SPAN),
        "xarray",
        "hy.ensemble",
    ),
    (
        lambda run, path: hy.sweep(
            BouncingBall(), {"r": [0.5]}, START, SPAN, store=path / "map.zarr"
        ),
        "zarr",
        "store=",
    ),
    (lambda run, path: report(path / "paper"), "plotly", "report"),
]


@pytest.mark.parametrize(("call", "package", "what"), CALLS)
def test_a_missing_package_is_named_with_its_remedy(
    call, package, what, run, tmp_path, monkeypatch
):
    """An error of this package, and nothing is written."""
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(hy.OptionError, match=f"^{what} needs {package}: pip install {package}$"):
        call(run, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "package"),
    [
        (["run", "bouncing_ball", "--plot", "run.html"], "plotly"),
        (["run", "bouncing_ball", "--plot", "run.png"], "matplotlib"),
        (["run", "bouncing_ball", "--save", "run.nc"], "xarray"),
        (["report", "--out", "paper"], "plotly"),
    ],
)
def test_the_command_line_says_it_before_the_run(arguments, package, tmp_path, monkeypatch):
    """One line, exit code 2, and no folder is made."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert f"needs {package}: pip install {package}" in result.stderr
    assert not result.stdout
    assert not list(tmp_path.iterdir())
