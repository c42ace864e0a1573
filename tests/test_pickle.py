"""Whatever a call returns is pickled and copied, and says the same afterwards."""

import copy
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hybrid as hy
from hybrid import gallery
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring
from models.pyragas import Pyragas

ROOT = Path(__file__).parent.parent

#: Impacts, rest and release; sliding; a cycle of edges; delays with a history; restarted memory.
RUNS = {
    "ball": lambda: hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0)),
    "table": lambda: hy.simulate(BeadOnTable(), {"x": 1.5, "v": 0.0}, (0.0, 60.0)),
    "by series": lambda: hy.simulate(HardSpring(), [2.1, 0.0], (0, 2), solver="taylor"),
    "relay": lambda: suggested("relay"),
    "tanks": lambda: suggested("two_tanks"),
    "past": lambda: hy.simulate(Pyragas(), [2.5, 0.0], (0, 2), history={"x1": np.cos}),
}


def suggested(name):
    """The run that a file of the gallery suggests."""
    entry = gallery.find(name)
    return hy.simulate(entry.cls(), entry.start, entry.until)


@pytest.fixture(scope="module", params=RUNS)
def run(request):
    return RUNS[request.param]()


def again(value):
    """Through a pickle."""
    return pickle.loads(pickle.dumps(value))


@pytest.mark.parametrize("how", [again, copy.copy, copy.deepcopy])
def test_a_run(run, how):
    """Dense output, tables, words, bounds and verdicts, bit for bit."""
    other = how(run)
    times = np.linspace(run.t0, run.t1, 301)
    for own, theirs in zip(run(times), other(times), strict=True):
        np.testing.assert_array_equal(own, theirs)
    assert other.jumps.t.tolist() == run.jumps.t.tolist()
    assert other.jumps.edge.tolist() == run.jumps.edge.tolist()
    assert other.explain() == run.explain()
    assert [point.t_error for point in other.zeno] == [point.t_error for point in run.zeno]
    assert [point.enclosure for point in other.zeno] == [point.enclosure for point in run.zeno]
    assert set(other.surfaces) == set(run.surfaces)
    assert str(other.settles()) == str(run.settles())


def test_bounds_are_not_looked_for_to_make_a_pickle(monkeypatch):
    """They are found by whoever asks, from what the pickle holds, in another process as well."""
    run = RUNS["ball"]()
    with monkeypatch.context() as without:
        without.setattr("hybrid.run.comparison.Driver", None)
        sent = pickle.dumps(run)
        with pytest.raises(TypeError):
            run.zeno[0].t_error  # noqa: B018
    code = (
        "import pickle, sys\nrun = pickle.loads(sys.stdin.buffer.read())\n"
        "print(run.zeno[0].t_error, run.zeno[0].verdict)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], input=sent, capture_output=True, cwd=ROOT, check=True
    )
    assert done.stdout.decode().split() == [str(run.zeno[0].t_error), "certified"]


def test_its_parts():
    """The table of jumps, a jump, an accumulation, a proof, an arc."""
    run = RUNS["ball"]()
    assert repr(again(run.jumps)) == repr(run.jumps)
    assert repr(again(run.jumps[0])) == repr(run.jumps[0])
    assert repr(again(run.zeno[0])) == repr(run.zeno[0])
    assert again(run.zeno[0].proofs[0]).low == run.zeno[0].proofs[0].low
    assert again(run.arcs[0]).local(0.1).tolist() == run.arcs[0].local(0.1).tolist()


def test_what_a_callback_of_progress_holds_is_left_out():
    """It may be anything."""
    run = hy.simulate(BouncingBall(), [1.0, 0.0], (0.0, 3.0), progress=lambda t: None)
    assert again(run).zeno[0].t_error == run.zeno[0].t_error


def test_what_else_is_returned():
    """Models, return maps and their points, orbits, exponents, certificates, lanes."""
    model = HardSpring(r=0.5)
    assert again(model) == model
    bead = BeadOnTable(r=0.6, omega=3.5)
    section = hy.return_map(bead, "impact")
    start = {"x": 1.5, "v": 0.0}
    assert again(section)(start) == section(start)
    points = section.iterate(start, 2)
    assert again(points).t.tolist() == points.t.tolist()
    proof = hy.certify(HardSpring(), {"x": (2.0, 2.1), "v": (-1.0, 1.0)})
    assert str(again(proof)) == str(proof)
    lanes = hy.ensemble(BouncingBall(), {"x": np.array([1.0, 2.0]), "v": 0.0}, (0.0, 3.0))
    assert again(lanes).equals(lanes)


def test_a_class_that_cannot_be_imported_is_named():
    """Python's own sentence, with the name of the class."""

    class Local(BouncingBall):
        pass

    run = hy.simulate(Local(), [1.0, 0.0], (0.0, 0.1))
    with pytest.raises((pickle.PicklingError, AttributeError), match="Local"):
        pickle.dumps(run)
