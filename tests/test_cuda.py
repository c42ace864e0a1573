"""The rules stay within what CUDA takes: they are lowered for it, on a machine without a GPU."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

from hybrid.rules import library

TESTS = Path(__file__).parent

#: A rule that opens a list.
LIST = """
__all__ = ("f",)

def f(x: float) -> int:
    return len([x, x])
"""


def lowered(package, unit, *folders):
    """What is said of a unit that is lowered for CUDA, and why it is not."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (TESTS.parent, *folders)))}
    command = [sys.executable, str(TESTS / "for_cuda.py"), package, unit]
    done = subprocess.run(command, capture_output=True, text=True, env=env, check=False)
    return done.stdout.strip(), done.stderr


def test_the_loop_of_lanes_is_lowered_for_cuda():
    """Whole lanes, and so every rule that a run by Taylor series needs: once for each text of the
    rules and of what lowers them, as their machine code."""
    script = hashlib.sha256((TESTS / "for_cuda.py").read_bytes()).hexdigest()
    done = library.folder / f"lowered_{script[:16]}"
    if not done.exists():
        said, fault = lowered("hybrid.rules", "lanes")
        assert said == "lanes int64", fault
        done.touch()


def test_what_cuda_does_not_take_is_refused(tmp_path):
    """The test above can fail."""
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy" / "__init__.py").touch()
    (tmp_path / "toy" / "opens.py").write_text(LIST)
    said, fault = lowered("toy", "opens", tmp_path)
    assert not said
    assert "Error" in fault
