"""Trajectories as datasets and files.

A file holds every arc with its dense output (Chebyshev coefficients, so evaluation after
loading gives the same numbers), all jumps, accumulations and grazings. Chattering tails are
written out as the arcs that a double can tell from their limit. The layout is in
``docs/notes/file-format.md``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .accumulation import Accumulation, Truncation
from .arcs import Arc, JumpRow
from .automaton.record import Record
from .automaton.spec import Spec, StateSpec
from .errors import StoreError
from .extras import FILES, TABLES, need
from .log import Log
from .segment import Segment
from .trajectory import Jump, Status, Trajectory

if TYPE_CHECKING:
    import xarray

#: Raised when the layout changes.
FORMAT = 1


def to_xarray(run: Trajectory, t: Any = None) -> xarray.Dataset:
    """The states at times ``t`` as variables over the dimension ``time``.

    Where ``t`` is omitted: the times that the run was asked to save, or both ends of each
    arc and 15 points between (so a jump's time stands there twice: before and after).
    """
    need("run.to_xarray", TABLES)
    import xarray as xr

    if t is not None:
        times = np.atleast_1d(np.asarray(t, dtype=float))
        states = _stack(run.spec, run(times))
    elif run.samples is not None:
        times, states = run.options["times"], run.samples
    else:
        grids = [np.linspace(0.0, 1.0, 17 if arc.segments else 2) * arc.length for arc in run.arcs]
        pairs = list(zip(run.arcs, grids, strict=True))
        times = np.concatenate([arc.t0 + (arc.low + grid) for arc, grid in pairs])
        states = np.concatenate([arc.local(grid) for arc, grid in pairs])
    record = run.spec.record(states)
    variables = {}
    for state in run.spec.states:
        dims = ("time", *(f"{state.name}_{axis}" for axis in range(len(state.shape))))
        attributes = {"units": state.unit, "long_name": state.doc}
        variables[state.name] = (dims, record[state.name], attributes)
    attributes = {"model": run.spec.model, "status": str(run.status), **_numbers(run.parameters)}
    return xr.Dataset(variables, coords={"time": times}, attrs=attributes)


def _stack(spec: Spec, record: Record) -> np.ndarray:
    parts = [np.asarray(v) for v in record]
    lead = parts[0].shape[: parts[0].ndim - len(spec.states[0].shape)]
    return np.concatenate([p.reshape((*lead, -1)) for p in parts], axis=-1)


def _numbers(parameters: dict[str, Any]) -> dict[str, Any]:
    return {name: np.asarray(value, dtype=float).tolist() for name, value in parameters.items()}


def save(run: Trajectory, path: Any) -> None:
    """Write a trajectory to a NetCDF file.

    Raises
    ------
    StoreError
        If the file cannot be written; the message says why.
    """
    need("run.save", FILES)
    import xarray as xr

    arcs, segments = run.arcs, [s for arc in run.arcs for s in arc.segments]
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
    if run.samples is not None:
        data["sample_t"] = ("sample", run.options["times"])
        data["sample_state"] = (("sample", "element"), run.samples)
    attributes = {"format": FORMAT, "meta": json.dumps(_meta(run, modes, edges))}
    try:
        xr.Dataset(data, attrs=attributes).to_netcdf(Path(path), engine="h5netcdf")
    except OSError as fault:
        raise StoreError(f"cannot write {path}: {fault}") from None


def _meta(run: Trajectory, modes: list[str], edges: list[str]) -> dict[str, Any]:
    options = {k: v for k, v in run.options.items() if k != "times"}
    return {
        "model": run.spec.model,
        "states": [[s.name, s.unit, s.doc, list(s.shape), s.offset] for s in run.spec.states],
        "parameters": _numbers(run.parameters),
        "options": {k: np.asarray(v).tolist() for k, v in options.items()},
        "status": run.status.name,
        "pairs": [list(pair) for pair in run.pairs],
        "modes": modes,
        "edges": edges,
        "zeno": [_accumulation(run.spec, point) for point in run.zeno],
        "grazings": [[g.t, g.j, g.edge, _stack(run.spec, g.before).tolist()] for g in run.grazings],
    }


def _accumulation(spec: Spec, point: Accumulation) -> dict[str, Any]:
    cut = point.truncation
    return {
        "t": point.t,
        "t_error": point.t_error,
        "state": _stack(spec, point.state).tolist(),
        "state_error": _stack(spec, point.state_error).tolist(),
        "ratio": point.ratio,
        "edges": list(point.edges),
        "verdict": point.verdict,
        "mode": point.mode,
        "j": point.j,
        "enclosure": point.enclosure,
        "t_release": point.t_release,
        "truncation": None if cut is None else [cut.impacts, cut.t_inf, cut.gap, cut.height],
    }


def load(path: Any) -> Trajectory:
    """Read a trajectory written by ``run.save(path)``.

    Raises
    ------
    StoreError
        If there is no such file, or it was not written by this package.
    """
    need("hy.load", FILES)
    import xarray as xr

    if not Path(path).exists():
        raise StoreError(f"cannot read {path}: no such file")
    try:
        data = xr.load_dataset(Path(path), engine="h5netcdf")
        if int(data.attrs["format"]) != FORMAT:
            raise StoreError(f"{path}: layout {data.attrs['format']}; this version reads {FORMAT}")
        meta = json.loads(data.attrs["meta"])
    except (OSError, KeyError, ValueError) as fault:
        raise StoreError(f"cannot read {path}: not a saved trajectory ({fault})") from None
    states = [
        StateSpec(name, unit, doc, tuple(sh), off) for name, unit, doc, sh, off in meta["states"]
    ]
    spec = Spec(meta["model"], tuple(states), (), (), (), "")
    arcs, modes = _arcs(data, meta["modes"]), meta["edges"]
    jumps = {
        index: JumpRow(
            float(data.jump_t[index]),
            float(data.jump_low[index]),
            modes[int(data.jump_edge[index])],
            before,
            after,
        )
        for index, (before, after) in enumerate(
            zip(data.jump_before.values, data.jump_after.values, strict=True)
        )
    }
    zeno = [_read_accumulation(spec, point) for point in meta["zeno"]]
    grazings = [_read_grazing(spec, *row) for row in meta["grazings"]]
    options, samples = meta["options"], None
    if "sample_t" in data:
        options["times"], samples = data.sample_t.values, data.sample_state.values
    return Trajectory(
        spec,
        meta["parameters"],
        Log(arcs, _by_arc(jumps, arcs, zeno)),
        zeno,
        grazings,
        Status[meta["status"]],
        options,
        samples,
        pairs=[(i, k) for i, k in meta["pairs"]],
    )


def _by_arc(
    jumps: dict[int, JumpRow], arcs: list[Arc], zeno: list[Accumulation]
) -> dict[int, JumpRow]:
    """The arc each jump leads from: the last arc with as many jumps before it as the jump."""
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
        first, last = data.arc_first.values[i], data.arc_last.values[i]
        arcs.append(Arc(mode, j, t0, low, length, first, last, segments))
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
        errors=(point["t_error"], error),
    )


def _read_grazing(spec: Spec, t: float, j: int, edge: str, state: list[float]) -> Jump:
    record = spec.record(np.array(state))
    return Jump(t, j, edge, record, record)


__all__ = ["load", "save", "to_xarray"]
