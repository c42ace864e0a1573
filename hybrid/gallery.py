"""Models by name or file, of the gallery or the user's own; and the paper of a checkout."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import attrs

from .automaton import Automaton
from .automaton.markers import is_number
from .errors import DeclarationError, HybridError


class GalleryError(HybridError):
    """A model's file is not found, cannot be run, or holds no model."""


@attrs.frozen
class GalleryEntry:
    """A model and the run that its file suggests.

    Attributes
    ----------
    cls : type
        The automaton.
    start : dict or None
        ``START`` of the file.
    until : (t0, t1) or None
        ``UNTIL`` of the file.
    history : dict, callable or None
        ``HISTORY`` of the file, what was before ``until[0]``; for models with delays.
    module : module
        The file itself; the gallery's files hold an ``oracle(run)``.
    """

    cls: Any
    start: Any
    until: Any
    history: Any
    module: ModuleType


def folder() -> Path:
    """Where the gallery is: inside an installed package, or beside it in a checkout."""
    here = Path(__file__).parent
    inside = here / "models"
    return inside if inside.is_dir() else here.parent / "models"


def names() -> list[str]:
    """Names of the models in the gallery."""
    return sorted(path.stem for path in folder().glob("*.py") if not path.stem.startswith("_"))


def summary(name: str) -> str:
    """The first line of a gallery file, without running it."""
    text = ast.get_docstring(ast.parse((folder() / f"{name}.py").read_text())) or ""
    return text.partition("\n")[0]


def find(given: str) -> GalleryEntry:
    """The model of a file ``path.py`` (``path.py:Class`` where it has several), or by name.

    A file is run anew each time; one of the gallery is imported, as ``hybrid.models.NAME``.

    Raises
    ------
    GalleryError, DeclarationError
    """
    name, _, wanted = given.partition(":")
    path = Path(name)
    if path.suffix == ".py" and not path.is_file():
        raise GalleryError(f"{name}: no such file")
    if path.suffix != ".py" and name not in names():
        raise GalleryError(
            f"no model {name!r} in the gallery: {', '.join(names())}; or give a file"
        )
    own = path.suffix == ".py"
    module = _run(path) if own else importlib.import_module(f".models.{name}", __package__)
    models = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Automaton)
        and value.__module__ == module.__name__
    ]
    start, until, history = (getattr(module, n, None) for n in ("START", "UNTIL", "HISTORY"))
    if start is not None and not isinstance(start, Mapping):
        raise GalleryError(f"{path}: START = {start!r}: a dict, the states by name")
    if until is not None and not _is_pair(until):
        raise GalleryError(f"{path}: UNTIL = {until!r}: a pair, (first, last) time")
    if history is not None and not (isinstance(history, Mapping) or callable(history)):
        raise GalleryError(f"{path}: HISTORY = {history!r}: a dict, the states by name")
    return GalleryEntry(_choose(path, models, wanted), start, until, history, module)


def paper() -> Any:
    """The paper claim by claim: the package ``paper`` of a checkout.

    Raises
    ------
    GalleryError
        Where this package is installed without it.
    """
    folder = Path(__file__).parents[1] / "paper"
    if not (folder / "claims.py").is_file():
        raise GalleryError(
            "the paper's sections are not installed with the package: they are the folder paper/ "
            "of a checkout of its source; there, make paper"
        )
    if str(folder.parent) not in sys.path:
        sys.path.append(str(folder.parent))
    return importlib.import_module("paper")


def _is_pair(until: Any) -> bool:
    try:
        first, last = until
    except (TypeError, ValueError):
        return False
    return is_number(first) and is_number(last)


def _choose(path: Path, models: list[type], wanted: str) -> type:
    listed = ", ".join(model.__name__ for model in models)
    if not models:
        raise GalleryError(f"{path}: no subclass of hybrid.Automaton is defined in this file")
    if wanted:
        for model in models:
            if model.__name__ == wanted:
                return model
        raise GalleryError(f"{path}: no model {wanted!r}; there are {listed}")
    if len(models) > 1:
        raise GalleryError(
            f"{path} holds several models ({listed}); name one: {path}:{models[0].__name__}"
        )
    return models[0]


def _run(path: Path) -> ModuleType:
    """Import a file by its path, under a name of its own."""
    name = f"hybrid_model_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except DeclarationError:
        raise
    except Exception as fault:  # whatever the user's file raises, in one line
        line = _line_in(fault, path)
        raise GalleryError(f"{path}{line}: {type(fault).__name__}: {fault}") from fault
    return module


def _line_in(fault: BaseException, path: Path) -> str:
    if isinstance(fault, SyntaxError):
        return f":{fault.lineno}"
    frames = traceback.extract_tb(fault.__traceback__)
    return next((f":{f.lineno}" for f in reversed(frames) if f.filename == str(path)), "")
