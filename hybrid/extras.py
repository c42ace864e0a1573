"""Packages that only some features need: refused with a remedy where they are missing."""

from __future__ import annotations

from importlib.util import find_spec

from .errors import OptionError

#: Modules that a feature needs beyond the package itself.
PLOT = ("matplotlib",)
HTML = ("plotly",)
PROOFS = ("flint",)
TABLES = ("xarray",)
FILES = ("xarray", "h5netcdf", "h5py")

#: Packages whose modules have other names.
PACKAGES = {"flint": "python-flint"}


def need(what: str, modules: tuple[str, ...]) -> None:
    """Refuse what needs a package that is missing.

    Raises
    ------
    OptionError
        With the command that installs what is missing.
    """
    missing = [PACKAGES.get(name, name) for name in modules if find_spec(name) is None]
    if missing:
        raise OptionError(f"{what} needs {', '.join(missing)}: pip install {' '.join(missing)}")
