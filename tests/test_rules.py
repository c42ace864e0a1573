"""Rules: built once, loaded by others, never stale; the same as plain Python."""

import ast
import gc
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hybrid.rules import load

RULES = Path(load.__file__).parent
FILES = sorted(path for path in RULES.glob("*.py") if path.stem not in load.APART)

LOW = """
from __future__ import annotations


def scaled(x: float) -> float:
    return 0.5 * x
"""

HIGH = """
from __future__ import annotations

from .low import scaled

__all__ = ("quotient", "total")


def quotient(x: float, y: float) -> float:
    return scaled(x) / y


def total(c: Floats, shift: int) -> float:
    s = 0.0
    for k in range(3):
        s += c[k + shift]
    return s
"""

ASK = """
import sys
from hybrid.rules.load import Library
unit = Library("toy").unit("high")
print(unit.quotient(3.0, 2.0))
"""


@pytest.fixture
def toy(tmp_path):
    """A small package of rules."""
    write(tmp_path)
    return tmp_path


def write(folder):
    """Write it into a folder."""
    (folder / "toy").mkdir()
    for name, text in {"__init__": "", "low": LOW, "high": HIGH}.items():
        (folder / "toy" / f"{name}.py").write_text(text)


def started(folder, code=ASK, **variables):
    """A process of its own that may import the package in a folder, with a cache there."""
    env = {k: v for k, v in os.environ.items() if k != "HYBRID_RULES"}
    env |= {"PYTHONPATH": f"{RULES.parent.parent}{os.pathsep}{folder}"}
    env |= {"HYBRID_CACHE": str(folder / "cache"), **variables}
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-c", code], stdout=pipe, stderr=pipe, text=True, env=env
    )


def done(process):
    """What a process printed, and what it said besides."""
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out.strip(), err.strip()


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The folder of such a package after a process that compiled it, and what that said."""
    folder = tmp_path_factory.mktemp("compiled")
    write(folder)
    return folder, done(started(folder))


@pytest.fixture
def built(compiled, tmp_path):
    """A copy of that folder, to change it."""
    return Path(shutil.copytree(compiled[0], tmp_path / "built"))


def test_rules_are_built_once(compiled):
    """The first process compiles and says so in one line; the second loads in silence, and not
    even numba."""
    folder, (said, line) = compiled
    assert said == "0.75"
    assert line.startswith("hybrid: compiling the rules 'high'")
    assert "\n" not in line
    assert done(started(folder, ASK + "print('numba' in sys.modules)")) == ("0.75\nFalse", "")


def test_two_processes_at_once_build_once(toy):
    """Both have the answer; one of them compiled."""
    processes = [started(toy), started(toy)]
    answers = [done(process) for process in processes]
    assert [out for out, _ in answers] == ["0.75", "0.75"]
    assert sum("compiling" in err for _, err in answers) == 1


TOP = """
from __future__ import annotations

from .high import quotient

__all__ = ("halved",)


def halved(x: float) -> float:
    return quotient(x, 2.0)
"""

ASK_TOP = """
from hybrid.rules.load import Library
unit = Library("toy").unit("top")
print(unit.halved(6.0))
"""


@pytest.mark.long
def test_what_a_unit_calls_is_compiled_in_a_process_of_its_own(toy):
    """One line is said; the file that is called is a unit of its own afterwards."""
    (toy / "toy" / "top.py").write_text(TOP)
    code = ASK_TOP + "import sys\nprint(not any(n.endswith('.high') for n in sys.modules))"
    said, line = done(started(toy, code))
    assert said.split() == ["1.5", "True"]
    assert line.startswith("hybrid: compiling the rules 'top'")
    assert "\n" not in line
    assert done(started(toy)) == ("0.75", "")


@pytest.mark.long
def test_units_that_are_needed_together_are_compiled_together(toy):
    """The one that was not asked for is loaded without a word."""
    (toy / "toy" / "top.py").write_text(TOP)
    code = "from hybrid.rules.load import Library\nLibrary('toy', [('high', 'top')]).unit('high')"
    assert done(started(toy, code))[1].startswith("hybrid: compiling the rules 'high'")
    assert done(started(toy, ASK_TOP)) == ("1.5", "")


@pytest.mark.long
def test_a_unit_alone_is_compiled_beside_the_process_too(toy):
    """With the settings of the others, whatever those of a process that asks for it."""
    (toy / "toy" / "top.py").write_text(TOP)
    assert done(started(toy))[0] == "0.75"
    said, line = done(started(toy, ASK_TOP + "import sys\nprint('numba' in sys.modules)"))
    assert said.split() == ["1.5", "False"]
    assert line.startswith("hybrid: compiling the rules 'top'")


def test_an_error_in_a_process_beside_is_raised(toy):
    """A rule that cannot be compiled says why, and leaves nothing that looks compiled."""
    (toy / "toy" / "top.py").write_text(TOP)
    (toy / "toy" / "high.py").write_text(HIGH.replace("scaled(x) / y", "scaled(x) / y.nothing"))
    process = started(toy, ASK_TOP)
    assert "nothing" in process.communicate(timeout=120)[1]
    assert process.returncode != 0
    assert {path.stem for path in (toy / "cache").rglob("*.built")} <= {"low"}


@pytest.mark.long
def test_without_processes_one_compiles_all(toy):
    """Where none can be started, and in a temporary folder, all is compiled all the same."""
    (toy / "toy" / "top.py").write_text(TOP)
    hidden = "import sys; sys.executable = '/nowhere/python'\n"
    out, err = done(started(toy, hidden + ASK_TOP))
    assert (out, err.count("compiling")) == ("1.5", 1)
    (toy / "file").write_text("")
    out, err = done(started(toy, ASK_TOP, HYBRID_CACHE=str(toy / "file" / "cache")))
    assert (out, err.count("compiling"), err.count("UserWarning")) == ("1.5", 1, 1)


@pytest.mark.long
def test_everything_is_built_at_once(toy):
    """Each unit is then loaded without a word."""
    (toy / "toy" / "top.py").write_text(TOP)
    code = "from hybrid.rules.load import Library\nprint(Library('toy').build())"
    assert done(started(toy, code)) == ("True", "")
    assert done(started(toy, ASK_TOP)) == ("1.5", "")
    assert done(started(toy)) == ("0.75", "")
    (toy / "toy" / "top.py").write_text(TOP.replace("2.0", "x.nothing"))
    assert done(started(toy, code))[0] == "False"


def test_garbage_is_collected_again():
    """After compiling, and after what cannot be compiled."""
    assert gc.isenabled()
    with load.uncollected():
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(ValueError, match="no"), load.uncollected():
        raise ValueError("no")
    assert gc.isenabled()


ONE = """
from __future__ import annotations

__all__ = ("one",)

EXACT = True

TEXT = True


def one(x: float, y: float) -> float:
    return x * y + y
"""


def test_a_rule_may_be_kept_in_the_language_of_llvm(toy):
    """It is put down once, and where the file says that it is exact nothing may be contracted."""
    (toy / "toy" / "one.py").write_text(ONE)
    code = (
        "from hybrid.rules.load import Library\n"
        "text = Library('toy').text('one')\n"
        "print('define' in text, 'fmul double' in text, 'contract' in text)"
    )
    said, line = done(started(toy, code))
    assert said == "True True False"
    assert "compiling" in line
    assert done(started(toy, code)) == (said, "")


def test_a_lock_of_a_killed_process_does_not_block(toy):
    """A process that dies while it holds the lock gives it back."""
    (toy / "cache").mkdir()
    code = (
        "import sys, time; from pathlib import Path; from hybrid.rules.load import locked\n"
        f"with locked(Path({str(toy / 'cache' / 'lock')!r})):\n"
        "    print('held', flush=True); time.sleep(60)"
    )
    holder = started(toy, code)
    assert holder.stdout.readline().strip() == "held"
    holder.kill()
    holder.communicate()
    begin = time.monotonic()
    with load.locked(toy / "cache" / "lock"):
        assert time.monotonic() - begin < 10.0


def test_a_changed_callee_is_not_stale(built):
    """A rule in another file is changed: its callers are compiled again."""
    (built / "toy" / "low.py").write_text(LOW.replace("0.5", "2.5"))
    out, err = done(started(built))
    assert out == "3.75"
    assert "compiling" in err


def test_a_cache_that_cannot_be_written_is_one_warning(toy):
    """The rules are compiled into a temporary folder, which goes with the process."""
    (toy / "file").write_text("")
    (toy / "tmp").mkdir()
    nowhere = {"HYBRID_CACHE": str(toy / "file" / "cache"), "TMPDIR": str(toy / "tmp")}
    out, err = done(started(toy, **nowhere))
    assert not list((toy / "tmp").glob("hybrid-*"))
    assert out == "0.75"
    assert err.count("UserWarning") == 1
    assert "HYBRID_CACHE" in err


def test_without_numba_rules_are_python(toy):
    """One warning, however many units are asked for; none if plain Python is asked for."""
    hidden = "import sys; sys.modules['numba'] = None\n" + ASK + "Library('toy').unit('high')"
    out, err = done(started(toy, hidden))
    assert out == "0.75"
    assert err.count("UserWarning") == 1
    assert "numba cannot be imported" in err
    assert not (toy / "cache").exists()
    assert done(started(toy, hidden, HYBRID_RULES="python")) == ("0.75", "")


@pytest.mark.parametrize("how", ["machine", "python", "checked"])
def test_a_number_divided_by_zero_is_infinite(built, how):
    """Machine code and plain Python treat numbers alike."""
    code = ASK.replace("2.0", "0.0")
    assert done(started(built, code, HYBRID_RULES=how))[0] == "inf"


def test_arrays_of_another_kind_are_refused(built):
    """Single precision, and every second entry of an array: not silently compiled anew."""
    code = ASK + (
        "import numpy as np\n"
        "for array in (np.ones(3, np.float32), np.ones(6)[::2], np.ones((3, 1))):\n"
        "    try: print(unit.total(array, 0))\n"
        "    except TypeError: print('refused')"
    )
    assert done(started(built, code))[0].split() == ["0.75", "refused", "refused", "refused"]


TUPLES = """
from __future__ import annotations

from typing import Any, NamedTuple

Floats = Matrix = Ints = Table = Any


class Inner(NamedTuple):
    m: Matrix
    k: Ints


class Outer(NamedTuple):
    inner: Inner
    x: Floats
"""

MIXED = """
from __future__ import annotations

from .arrays import Outer

__all__ = ("mixed", "nothing")


def mixed(o: Outer, up: bool, s: float) -> tuple[float, bool, int]:
    o.x[0] = o.inner.m[1, 2] * s
    return o.x[0] + o.inner.m.shape[1], not up, o.inner.k[-1 + len(o.inner.k)]


def nothing(o: Outer) -> None:
    o.x[1] = 5.0
"""

ASK_MIXED = """
from hybrid.rules.load import Library
from hybrid.rules.calls import held
from toy.arrays import Inner, Outer
import numpy as np
unit = Library("toy").unit("mixed")
m, k, x = np.arange(6.0).reshape(2, 3), np.array([7, 8]), np.zeros(2)
o = Outer(Inner(m, k), x)
print(*unit.mixed(o, True, 2.0), unit.nothing(o), *x.tolist(), sep="|")
again = held(unit.mixed, o, False, 3.0)
m[1, 2] = 4.0
print(*again(), *again(), sep="|")
"""

ASK_WRONG = """
for wrong in (o._replace(x=m), o._replace(inner=o), Outer(o.inner._replace(k=x), x)):
    try: print(unit.mixed(wrong, True, 2.0))
    except TypeError: print("refused")
"""


@pytest.mark.parametrize("how", ["machine", "python"])
def test_tuples_of_arrays_and_several_results(toy, how):
    """They go in by reference, and what is in them is read anew at each call. Machine code refuses
    those of another kind, by what they hold, and by their names, however deep."""
    (toy / "toy" / "arrays.py").write_text(TUPLES)
    (toy / "toy" / "mixed.py").write_text(MIXED)
    code, refused = (ASK_MIXED + ASK_WRONG, 3) if how == "machine" else (ASK_MIXED, 0)
    first, second, *wrong = done(started(toy, code, HYBRID_RULES=how))[0].split()
    assert [first, second] == ["13.0|False|8|None|10.0|5.0", "15.0|True|8|15.0|True|8"]
    assert wrong == ["refused"] * refused


def test_a_damaged_file_is_not_run(built):
    """The hash of its content is at its beginning."""
    (kept,) = (built / "cache").rglob("high.built")
    kept.write_bytes(kept.read_bytes()[:-1] + b"!")
    process = started(built)
    assert "damaged: remove it" in process.communicate(timeout=120)[1]
    assert process.returncode != 0


def test_indices_below_zero_are_found(toy):
    """Checked Python refuses what machine code silently counts from the end."""
    code = ASK + "import numpy as np\nprint(unit.total(np.ones(3), -1))"
    assert done(started(toy, code, HYBRID_RULES="python"))[0] == "0.75\n3.0"
    process = started(toy, code, HYBRID_RULES="checked")
    assert "IndexError: a rule asks for index -1" in process.communicate(timeout=120)[1]


def test_old_folders_are_removed(tmp_path):
    """The last few are kept, those of today, and what is not ours."""
    names = [f"{k:024x}" for k in range(10)]
    for k, name in enumerate(names):
        (tmp_path / name).mkdir()
        age = 3600.0 if k == 0 else 86400.0 * (1 + k)
        os.utime(tmp_path / name, (time.time() - age,) * 2)
    (tmp_path / "mine").mkdir()
    os.utime(tmp_path / "mine", (0.0, 0.0))
    load.tidy(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [*names[: load.KEPT], "mine"]


# ---------------------------------------------------------------------------------------
# the subset

#: What allocates, raises, recurses, or is not known to machine code.
FORBIDDEN = (
    *(ast.Raise, ast.Try, ast.With, ast.Assert, ast.ClassDef, ast.Lambda, ast.Yield, ast.YieldFrom),
    *(ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp, ast.GeneratorExp),
    *(ast.JoinedStr, ast.Global, ast.Nonlocal, ast.Delete, ast.AsyncFunctionDef, ast.Starred),
)

BUILTINS = {"abs", "bool", "float", "int", "len", "max", "min", "range"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_rule_files_stay_in_the_subset(path):
    """No allocation, exceptions, recursion or closures; ``math`` and other rule files only."""
    tree = ast.parse(path.read_text())
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 1:
            assert node.module in {file.stem for file in FILES}
        elif isinstance(node, ast.ImportFrom):
            assert node.module in ("__future__", "typing")
        elif isinstance(node, ast.Import):
            assert [alias.name for alias in node.names] == ["math"]
    for function in functions:
        assert not function.decorator_list
        for node in ast.walk(function):
            assert not isinstance(node, FORBIDDEN), f"line {node.lineno}"
            assert node is function or not isinstance(node, ast.FunctionDef), "a closure"
        assert called(function) <= BUILTINS | names(tree) | {"math"}
    assert not loops({function.name: called(function) for function in functions})


def called(function):
    """Names that a function calls, or whose attribute it calls."""
    calls = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
    return {ast.unparse(call).split(".")[0] for call in calls}


def names(tree):
    """Functions of a file, and what it imports."""
    found = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    return found | {alias.asname or alias.name for node in imports for alias in node.names}


def loops(calls):
    """Functions that call themselves, through others or not."""
    found = set()
    for name in calls:
        reached, frontier = set(), [name]
        while frontier:
            new = calls.get(frontier.pop(), set()) - reached
            reached |= new
            frontier += new
        found |= {name} & reached
    return found


def test_threads_that_ask_for_a_unit_at_once_have_the_same_machine_code():
    """It is loaded once: a second engine in its place would let go what the first one runs."""
    code = (
        "import time\n"
        "from concurrent.futures import ThreadPoolExecutor\n"
        "from hybrid.rules import code, library, unit\n"
        "made, engine = [], code.engine\n"
        "slow = lambda own: (made.append(own), time.sleep(0.05), own)[-1]\n"
        "code.engine = lambda codes: slow(engine(codes))\n"
        "with ThreadPoolExecutor(4) as pool:\n"
        "    assert len(set(map(id, pool.map(unit, ['zeros'] * 4)))) == 1\n"
        "assert len(made) == code.placed.cache_info().currsize or library.how() != 'machine'\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)
