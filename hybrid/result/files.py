"""Trajectories as datasets and files.

A file holds every arc with its dense output (Chebyshev coefficients, so evaluation after loading
gives the same numbers), all jumps, accumulations and grazings. Chattering tails are written as the
arcs that a double can tell from their limit. The layout is in ``docs/notes/file-format.md``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkstemp
from typing import TYPE_CHECKING, Any, TypeVar
from zlib import crc32

import attrs
import numpy as np

from ..automaton.signals import Samples, SignalSpec
from ..automaton.spec import OutputSpec, Spec, StateSpec
from ..errors import FILES, TABLES, OptionError, StoreError, need
from ..segment import Segment, resolved
from ..trajectory.accumulation import Accumulation, Truncation
from ..trajectory.arcs import Arc, JumpRow
from ..trajectory.log import Log
from ..trajectory.stats import Stats
from ..trajectory.trajectory import Jump, Solution, Status

if TYPE_CHECKING:
    import xarray

Kind = TypeVar("Kind", bound=Solution)

#: Version of the layout; incremented when it changes.
FORMAT = 1


def to_xarray(run: Solution, t: Any = None) -> xarray.Dataset:
    """The states at times ``t`` as variables over the dimension ``time``.

    By default, the times that the run was asked to save, or both ends of each arc and 15 points
    between (a jump's time then appears twice: before and after).
    """
    need("run.to_xarray", TABLES)
    names = (*run.spec.names, *(output.name for output in run.spec.outputs))
    if "time" in names:
        raise OptionError(
            f"{run.spec.model}: 'time' is a state or an output of it, and the axis of the dataset; "
            "give it another name in the model"
        )
    import xarray as xr

    if t is not None:
        states = np.atleast_2d(run.states(t))
        times = np.atleast_1d(np.asarray(t, dtype=float))
    elif run.samples is not None:
        times, states = run.options["times"], run.samples
    else:
        grids = [np.linspace(0.0, 1.0, 17 if arc.segments else 2) * arc.length for arc in run.arcs]
        pairs = list(zip(run.arcs, grids, strict=True))
        times = np.concatenate([arc.t0 + (arc.low + grid) for arc, grid in pairs])
        states = np.concatenate([arc.local(grid) for arc, grid in pairs])
    record, variables = run.observed(times, states), {}
    for state in run.spec.states:
        dims = ("time", *(f"{state.name}_{axis}" for axis in range(len(state.shape))))
        attributes = {"units": state.unit, "long_name": state.doc}
        variables[state.name] = (dims, record[state.name], attributes)
    for output in run.spec.outputs if run.spec.cls is not None else ():
        values, attributes = record[output.name], {"units": output.unit, "long_name": output.doc}
        dims = ("time", *(f"{output.name}_{axis}" for axis in range(values.ndim - 1)))
        variables[output.name] = (dims, values, attributes)
    attributes = {"model": run.spec.model, "status": str(run.status), **_numbers(run)}
    return xr.Dataset(variables, coords={"time": times}, attrs=attributes)


def _numbers(run: Solution) -> dict[str, Any]:
    """Parameter values, without the data of signals."""
    data = [signal.name for signal in run.spec.signals]
    own = ((name, value) for name, value in run.parameters.items() if name not in data)
    return {name: np.asarray(value, dtype=float).tolist() for name, value in own}


#: Ends of names that are those of other formats.
OTHER_FORMATS = (".csv", ".txt", ".json", ".mat", ".npz", ".npy", ".pkl", ".zarr", ".py", ".png")


def require_netcdf(what: str, path: Any) -> None:
    """Refuse a name of a file that says that it is something else."""
    if Path(path).suffix.lower() in OTHER_FORMATS:
        raise OptionError(
            f"{what}: a run is written as NetCDF: end the name in .nc. Its jumps as a table: "
            "run.jumps.to_pandas().to_csv(path), hybrid run --csv"
        )


def save(run: Solution, path: Any) -> None:
    """Write a trajectory to a NetCDF file.

    The write is atomic: an existing file is replaced only when the new one is complete.

    Raises
    ------
    OptionError
        If the name is that of a file of another format.
    StoreError
        If the file cannot be written; the message says why.
    """
    need("run.save", FILES)
    require_netcdf(f"run.save({str(path)!r})", path)
    if not Path(path).resolve().parent.is_dir():
        raise StoreError(f"cannot write {path}: no such folder")
    import xarray as xr

    arcs = [_alone(arc) for arc in run.arcs]
    segments = [segment for arc in arcs for segment in arc.segments]
    width = max((s.degree + 1 for s in segments), default=1)
    n = run.spec.dimension
    padded = np.zeros((len(segments), width, n))
    for row, segment in zip(padded, segments, strict=True):
        row[: segment.degree + 1] = segment.coefficients
    jumps = run.jumps.table
    modes = sorted({arc.mode for arc in arcs})
    edges = sorted(set(jumps.edge))
    data = {
        "arc_mode": ("arc", [modes.index(arc.mode) for arc in arcs]),
        "arc_j": ("arc", [arc.j for arc in arcs]),
        "arc_t0": ("arc", [arc.t0 for arc in arcs]),
        "arc_low": ("arc", [arc.low for arc in arcs]),
        "arc_length": ("arc", [arc.length for arc in arcs]),
        "arc_t1": ("arc", [arc.t1 for arc in arcs]),
        "arc_first": (("arc", "element"), [arc.first for arc in arcs]),
        "arc_last": (("arc", "element"), [arc.last for arc in arcs]),
        "arc_segments": ("arc", [len(arc.segments) for arc in arcs]),
        "segment_start": ("segment", np.array([s.start for s in segments], dtype=float)),
        "segment_length": ("segment", np.array([s.length for s in segments], dtype=float)),
        "segment_degree": ("segment", np.array([s.degree for s in segments], dtype=np.int64)),
        "segment_coefficients": (("segment", "coefficient", "element"), padded),
        "jump_t": ("jump", jumps.t),
        "jump_low": ("jump", jumps.low),
        "jump_edge": ("jump", np.array([edges.index(edge) for edge in jumps.edge], dtype=np.int64)),
        "jump_before": (("jump", "element"), jumps.before),
        "jump_after": (("jump", "element"), jumps.after),
    }
    data |= _signals(run)
    if run.samples is not None:
        data["sample_t"] = ("sample", run.options["times"])
        data["sample_state"] = (("sample", "element"), run.samples)
    attributes = {"format": FORMAT, "meta": json.dumps(_meta(run, modes, edges))}
    written = xr.Dataset(data, attrs=attributes)
    written.attrs["checksum"] = _checksum(written)
    try:
        with _replacing(Path(path).resolve()) as part:
            written.to_netcdf(part, engine="h5netcdf")
    except (OSError, RuntimeError) as fault:  # HDF5 reports a full disk as a RuntimeError
        raise StoreError(f"cannot write {path}: {fault}") from None


def _alone(arc: Arc) -> Arc:
    """An arc whose dense output needs no model to stay on its surface."""
    if arc.project is None:
        return arc
    segments = [resolved(segment, arc.t0, arc.project) for segment in arc.segments]
    return attrs.evolve(arc, segments=segments, project=None)


def _checksum(data: Any) -> int:
    """The CRC-32 of the names and numbers of a file's tables."""
    total = 0
    for name in sorted(data.variables):
        numbers = np.ascontiguousarray(data.variables[name].values)
        total = crc32(numbers.tobytes(), crc32(name.encode(), total))
    return total


def _signals(run: Solution) -> dict[str, Any]:
    """The data of the signals, in declared order."""
    data: dict[str, Any] = {}
    for place, signal in enumerate(run.spec.signals):
        samples, knot = run.parameters[signal.name], f"knot_{place}"
        rows = samples.values.reshape(len(samples.times), -1)
        data[f"signal_{place}_t"] = (knot, samples.times)
        data[f"signal_{place}_values"] = ((knot, f"value_{place}"), rows)
    return data


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside ``path``, which replaces it once complete."""
    handle, name = mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    os.close(handle)
    part = Path(name)
    try:
        yield part
        with part.open("rb+") as written:
            os.fsync(written.fileno())
        part.chmod(_permissions(path))
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _permissions(path: Path) -> int:
    """Permissions of the file that is replaced, or those of a new file."""
    if path.exists():
        return path.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def _meta(run: Solution, modes: list[str], edges: list[str]) -> dict[str, Any]:
    options = {k: v for k, v in run.options.items() if k != "times"}
    return {
        "model": run.spec.model,
        "states": [
            [s.name, s.unit, s.doc, list(s.shape), s.offset, s.kind] for s in run.spec.states
        ],
        "signals": [list(attrs.astuple(signal)) for signal in run.spec.signals],
        "outputs": [[output.name, output.unit, output.doc] for output in run.spec.outputs],
        "parameters": _numbers(run),
        "options": {k: np.asarray(v).tolist() for k, v in options.items()},
        "stats": None if run.stats is None else attrs.asdict(run.stats),
        "versions": run.versions,
        "status": run.status.name,
        "pairs": [list(pair) for pair in run.pairs],
        "modes": modes,
        "edges": edges,
        "zeno": [_accumulation(run.spec, point) for point in run.zeno],
        "grazings": [[g.t, g.j, g.edge, run.spec.vector(g.before).tolist()] for g in run.grazings],
    }


def _accumulation(spec: Spec, point: Accumulation) -> dict[str, Any]:
    cut = point.truncation
    return {
        "t": point.t,
        "t_error": point.t_error,
        "state": spec.vector(point.state).tolist(),
        "state_error": spec.vector(point.state_error).tolist(),
        "ratio": point.ratio,
        "edges": list(point.edges),
        "verdict": point.verdict,
        "mode": point.mode,
        "j": point.j,
        "enclosure": point.enclosure,
        "t_release": point.t_release,
        "truncation": None if cut is None else [cut.impacts, cut.t_inf, cut.gap, cut.height],
        "limits": [[edge, spec.vector(x).tolist()] for edge, x in point.limits],
    }


def read(path: Any, cls: type[Kind], model: Any = None) -> Kind:
    """The content of a saved file, as an instance of ``cls``: see :func:`hybrid.load`."""
    need("hy.load", FILES)
    import xarray as xr

    if not Path(path).exists():
        raise StoreError(f"cannot read {path}: no such file")
    try:
        _require_own_numbers(Path(path))
        run = _trajectory(xr.load_dataset(Path(path), engine="h5netcdf"), cls)
        run.spec = run.spec if model is None else _own(run, model)
        return run
    except StoreError as fault:
        raise StoreError(f"cannot read {path}: {fault}") from None
    except Exception as fault:  # a damaged file may fail anywhere in HDF5 or its readers
        reason = f"{type(fault).__name__}: {fault}"
        raise StoreError(f"cannot read {path}: not a saved trajectory ({reason})") from None


def _require_own_numbers(path: Path) -> None:
    """Refuse a file whose data are stored elsewhere, or are larger than the file."""
    import h5py

    declared = 0
    with h5py.File(path) as file:
        for name in file:
            link, item = file.get(name, getlink=True), file.get(name)
            if not isinstance(link, h5py.HardLink) or not isinstance(item, h5py.Dataset):
                raise StoreError(f"{name} is no table of its own")
            if item.external or item.is_virtual:
                raise StoreError(f"the numbers of {name} are in another file")
            is_dimension = item.is_scale and item.id.get_offset() is None
            declared += 0 if is_dimension else item.nbytes
    if declared > path.stat().st_size:
        raise StoreError("it declares more numbers than it holds: it is cut short or damaged")


def _trajectory(data: Any, cls: type[Kind]) -> Kind:
    """A trajectory from the dataset that :func:`save` writes."""
    if int(data.attrs["format"]) != FORMAT:
        raise StoreError(f"layout {data.attrs['format']}; this version reads {FORMAT}")
    if data.attrs.get("checksum", known := _checksum(data)) != known:
        raise StoreError(
            "its numbers are not those that were written: it is damaged, or was edited; run it "
            "again, or take its attribute 'checksum' away to read it as it is"
        )
    meta = json.loads(data.attrs["meta"])
    states = [
        StateSpec(name, unit, doc, tuple(sh), off, *kind)
        for name, unit, doc, sh, off, *kind in meta["states"]
    ]
    outputs = tuple(OutputSpec(*row) for row in meta.get("outputs", ()))
    rows = meta.get("signals", ())
    signals = tuple(SignalSpec(n, u, d, k, out, tuple(shape)) for n, u, d, k, out, shape in rows)
    spec = Spec(meta["model"], tuple(states), (), (), (), "", outputs=outputs, signals=signals)
    arcs = _arcs(data, meta["modes"])
    zeno = [_read_accumulation(spec, point) for point in meta["zeno"]]
    options, samples = meta["options"], None
    if "sample_t" in data:
        options["times"], samples = data.sample_t.values, data.sample_state.values
    return cls(
        spec,
        meta["parameters"] | _samples(data, signals),
        Log(arcs, _by_arc(_jumps(data, meta["edges"]), arcs)),
        zeno,
        [_read_grazing(spec, *row) for row in meta["grazings"]],
        Status[meta["status"]],
        options,
        samples,
        pairs=[(i, k) for i, k in meta["pairs"]],
        stats=_stats(meta.get("stats")),
        versions={str(k): str(v) for k, v in meta.get("versions", {}).items()},
    )


def _samples(data: Any, signals: Sequence[SignalSpec]) -> dict[str, Samples]:
    """The data of signals by name."""
    found = {}
    for place, signal in enumerate(signals):
        times, rows = (data[f"signal_{place}_{what}"].values for what in ("t", "values"))
        found[signal.name] = Samples(signal, times, rows.reshape(len(times), *signal.shape))
    return found


def _own(run: Solution, model: Any) -> Spec:
    """The spec of the model that made a run.

    Raises
    ------
    StoreError
        If it does not match the run.
    """
    spec: Spec | None = getattr(model, "spec", None)
    if spec is None:
        raise StoreError(f"model={model!r}: give a subclass of hy.Automaton, or one's instance")
    parameters = spec.given
    known, own = (
        (*s.names, *(state.shape for state in s.states), *s.signals) for s in (run.spec, spec)
    )
    if (run.spec.model, known, sorted(run.parameters)) != (spec.model, own, sorted(parameters)):
        raise StoreError(
            f"a run of {run.spec.model} with states {', '.join(run.spec.names)} and parameters "
            f"{', '.join(run.parameters) or 'none'}; the model given is {spec.model} with states "
            f"{', '.join(spec.names)} and parameters {', '.join(parameters) or 'none'}"
        )
    return spec


def _stats(saved: dict[str, Any] | None) -> Stats | None:
    """The cost of the run; None if the file predates it."""
    if saved is None:
        return None
    rejected, evaluations = (
        None if saved[name] is None else int(saved[name]) for name in ("rejected", "evaluations")
    )
    return Stats(int(saved["steps"]), rejected, evaluations, float(saved["seconds"]))


def _jumps(data: Any, edges: list[str]) -> dict[int, JumpRow]:
    """The jumps by their number."""
    t, low = data.jump_t.values.tolist(), data.jump_low.values.tolist()
    names = [edges[int(index)] for index in data.jump_edge.values]
    columns = zip(t, low, names, data.jump_before.values, data.jump_after.values, strict=True)
    return {index: JumpRow(*row) for index, row in enumerate(columns)}


def _by_arc(jumps: dict[int, JumpRow], arcs: list[Arc]) -> dict[int, JumpRow]:
    """The jumps by the arc that each ends: the last arc with as many jumps before it."""
    last = {arc.j: index for index, arc in enumerate(arcs)}
    return {last[j]: row for j, row in jumps.items()}


def _arcs(data: Any, modes: list[str]) -> list[Arc]:
    counts = data.arc_segments.values
    stops = np.cumsum(counts)
    starts, lengths = data.segment_start.values, data.segment_length.values
    degrees, rows = data.segment_degree.values, data.segment_coefficients.values
    arcs = []
    for i, stop in enumerate(stops):
        segments = tuple(
            Segment(float(starts[k]), float(lengths[k]), rows[k, : degrees[k] + 1])
            for k in range(stop - counts[i], stop)
        )
        mode, j = modes[int(data.arc_mode.values[i])], int(data.arc_j.values[i])
        t0, low, length = (float(data[f"arc_{name}"].values[i]) for name in ("t0", "low", "length"))
        t1 = float(data.arc_t1.values[i]) if "arc_t1" in data else t0 + (low + length)
        first, last = data.arc_first.values[i], data.arc_last.values[i]
        arcs.append(Arc(mode, j, t0, low, length, t1, first, last, segments))
    return arcs


def _read_accumulation(spec: Spec, point: dict[str, Any]) -> Accumulation:
    cut, enclosure = point["truncation"], point["enclosure"]
    error = spec.record(np.array(point["state_error"], dtype=float))
    return Accumulation(
        point["t"],
        spec.record(np.array(point["state"])),
        point["ratio"],
        tuple(point["edges"]),
        point["verdict"],
        point["mode"],
        point["j"],
        tuple(enclosure) if enclosure else None,
        point["t_release"],
        Truncation(*cut) if cut else None,
        tuple((edge, spec.record(np.array(x))) for edge, x in point.get("limits", ())),
        errors=(point["t_error"], error),
    )


def _read_grazing(spec: Spec, t: float, j: int, edge: str, state: list[float]) -> Jump:
    record = spec.record(np.array(state))
    return Jump(t, j, edge, record, record)
