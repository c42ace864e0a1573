"""The layout: imports point one way, importing is light, files stay readable."""

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "hybrid"

#: Lowest first: a module imports from its own layer or from those before it.
LAYERS = [
    ["rules"],
    ["errors", "extras", "clock", "segment", "reals", "beside"],
    ["automaton"],
    ["jit"],
    ["lowering"],
    ["events", "solvers"],
    ["zeno"],
    ["accumulation", "arcs", "log", "stats", "trajectory"],
    ["run", "store", "pictures"],
    ["histories", "hindsight"],
    ["variation"],
    ["asked", "again", "abreast", "lanes"],
    ["replay"],
    ["tangent"],
    ["rows"],
    ["simulation", "ensembles", "function", "certificates"],
    ["compare", "gallery", "models", "orbits"],
    ["cli", "__main__", "__init__"],
]


def layer(module):
    return next(i for i, names in enumerate(LAYERS) if module in names)


def runtime_imports(path):
    """Relative imports of a file at import time: not under TYPE_CHECKING or in functions."""
    package = [*path.relative_to(PACKAGE).parts[:-1]]
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - (node.level - 1)]
            full = [*base, *(node.module or "").split(".")]
            names = [full[0]] if full[0] else [alias.name for alias in node.names]
            yield from (name for name in names if name)


def test_imports_point_down():
    """Declaration, scene, solver, trajectory, analysis: never back."""
    for path in PACKAGE.rglob("*.py"):
        own = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for name in runtime_imports(path):
            assert layer(name) <= layer(own), f"{path.name} imports {name}"


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
