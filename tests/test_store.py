"""Files and datasets give back what was run."""

import numpy as np
import pytest

import hybrid as hy
from models.ball_on_circle import BallOnCircle
from models.bead_on_table import BeadOnTable


def test_a_saved_trajectory_is_the_same_trajectory(tmp_path):
    """Jumps, arcs, accumulations exactly; the state at any time to the solver's order."""
    run = hy.simulate(BeadOnTable(r=0.6, omega=3.5), [1.5, 0.0], (0, 7), rtol=1e-10)
    run.save(tmp_path / "run.nc")
    again = hy.load(tmp_path / "run.nc")
    np.testing.assert_array_equal(run.jumps.t, again.jumps.t)
    np.testing.assert_array_equal(run.jumps.after.v, again.jumps.after.v)
    assert list(run.jumps.edge) == list(again.jumps.edge)
    assert [arc.mode for arc in run.arcs] == [arc.mode for arc in again.arcs]
    for one, other in zip(run.zeno, again.zeno, strict=True):
        assert (one.t, one.t_error, one.t_release) == (other.t, other.t_error, other.t_release)
        assert one.state == other.state
    times = np.linspace(0, 7, 500)
    np.testing.assert_allclose(run(times).x, again(times).x, atol=1e-10)
    assert again.status is run.status
    assert repr(again) == repr(run)
    assert f"{len(run.jumps)} jumps listed" in repr(run)
    assert again.parameters["omega"] == 3.5


def test_states_with_a_shape(tmp_path):
    """Saved and tabulated with their own dimension."""
    run = hy.simulate(BallOnCircle(), {"q": [0.15, 1.2], "p": [0, 0]}, (0, 4))
    run.save(tmp_path / "run.nc")
    again = hy.load(tmp_path / "run.nc")
    assert again(1.0).q.shape == (2,)
    data = again.to_xarray(np.linspace(0, 4, 9))
    assert data.q.shape == (9, 2)


def test_files_that_cannot_be_read_or_written(tmp_path):
    """One line that says why."""
    with pytest.raises(hy.StoreError, match="no such file"):
        hy.load(tmp_path / "none.nc")
    (tmp_path / "bad.nc").write_text("not a file")
    with pytest.raises(hy.StoreError, match="not a saved trajectory"):
        hy.load(tmp_path / "bad.nc")
    run = hy.simulate(BeadOnTable(), {"x": 1.9, "v": 0.0}, (0, 0.1))
    with pytest.raises(hy.StoreError, match="cannot write"):
        run.save(tmp_path / "no" / "folder.nc")


def test_the_dataset_has_units_and_both_sides_of_a_jump():
    """Each jump's time stands there twice."""
    run = hy.simulate(BeadOnTable(), {"x": 1.9, "v": 0.0}, (0, 2))
    data = run.to_xarray()
    assert data.x.attrs["units"] == "m"
    assert np.sum(np.isclose(data.time.values, run.jumps.t[0], atol=1e-15)) == 2
