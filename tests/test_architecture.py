"""The layout: imports point one way, importing is light, files stay readable."""

import ast
import runpy
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "hybrid"

#: What measures the package; here its names are held to it.
HOUSE = runpy.run_path(str(ROOT / "benchmarks" / "house.py"))

#: Lowest first: a module imports from its own layer or from those before it.
LAYERS = [
    ["rules"],
    ["errors", "segment"],
    ["automaton"],
    ["lowering"],
    ["bounds"],
    ["events", "solvers"],
    ["zeno"],
    ["trajectory"],
    ["plot"],
    ["delay"],
    ["run"],
    ["variation"],
    ["replay"],
    ["ensembles"],
    ["functions"],
    ["result"],
    ["simulation"],
    ["certificates", "orbits"],
    ["maps"],
    ["benchmark"],
    ["gallery", "models"],
    ["cli", "__main__", "__init__"],
]

#: Imports within functions that go up, or close a circle, and why.
MEANT = {
    # the version
    ("trajectory.stats", "__init__"),
    # Model.draw(), a method of every model
    ("automaton.base", "plot.graph"),
    # what cannot be written out is refused when the class is made, by what writes it out
    ("automaton.base", "lowering.jaxpr"),
}


@cache
def trees():
    """Each file of the package, parsed."""
    return {path: ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")}


@cache
def imported():
    """What each module of the package imports, at its top and in functions; by names below it."""
    return HOUSE["imports"](PACKAGE, trees())


def pairs():
    """Pairs of modules of which the first imports the second."""
    return {(a, b) for a, found in imported().items() for b in found}


def layer(module):
    return next(i for i, names in enumerate(LAYERS) if module.split(".")[0] in names)


def test_imports_point_down():
    """Declaration, lowering, solver, trajectory, analysis: never back, in functions neither."""
    up = {(a, b) for a, b in pairs() if layer(b) > layer(a)}
    assert up <= MEANT


def test_no_module_imports_itself_by_way_of_others():
    """But for what is meant."""
    then = {a: {b for b in found if (a, b) not in MEANT} - {a} for a, found in imported().items()}
    free = set()
    while ready := {name for name in then if name not in free and then[name] <= free}:
        free |= ready
    assert set(then) == free


def test_imports_that_are_meant_are_made():
    """The list has nothing that is gone."""
    assert pairs() >= MEANT


def test_no_two_classes_share_a_name():
    """Whoever reads of one knows which."""
    assert HOUSE["shared_classes"](trees().values()) == set()


def test_no_constant_has_two_values_under_one_name():
    """What differs has names that say how; what is the same is imported."""
    assert HOUSE["ambiguous"](HOUSE["constants"](trees().values())) == set()


def test_few_files_stand_at_the_top():
    """Everything else is in the folder of its subject."""
    assert len(list(PACKAGE.glob("*.py"))) <= 8


def test_importing_is_light():
    """Neither JAX, numba, SciPy, python-flint nor matplotlib is loaded by ``import hybrid``."""
    heavy = ("jax", "numba", "llvmlite", "scipy", "matplotlib", "xarray", "rich", "flint")
    code = f"import sys, hybrid\nprint([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert done.stdout.strip() == "[]"


def test_public_names_have_docstrings():
    """Everything in ``hybrid.__all__`` says what it is."""
    import hybrid

    for name in hybrid.__all__:
        value = getattr(hybrid, name)
        if callable(value):
            assert value.__doc__, name


def test_no_module_hides_a_public_function():
    """``import hybrid.x`` sets ``hybrid.x``: no module may have a public function's name."""
    import hybrid

    modules = {path.stem for path in PACKAGE.glob("*.py")} | {p.name for p in PACKAGE.glob("*/")}
    functions = {name for name in hybrid.__all__ if callable(getattr(hybrid, name))}
    assert not modules & functions


def test_the_package_lists_its_public_names():
    """And only those."""
    import hybrid

    assert sorted(dir(hybrid)) == sorted([*hybrid.__all__, "__version__"])
