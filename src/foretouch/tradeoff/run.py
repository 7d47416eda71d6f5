# SPDX-License-Identifier: Apache-2.0
"""Measure an area: skills by a sweep, then all times in one process, then the table, the picture and the sentences.

DIR holds what `foretouch.experiments.framework.manifest` describes, of the skills, and:

DIR/tradeoff.csv   a row for each variant, size of request and state of the machine: skill, difference and times
DIR/tradeoff.png   skill against time with the frontier
DIR/summary.md     frontiers and sentences
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.checked_files import read_json
from foretouch.errors import FileError, ForetouchError
from foretouch.experiments.framework import manifest as manifests
from foretouch.experiments.framework.experiment import ReadData, Row
from foretouch.experiments.framework.sweep import Progress, SweepResult, run_sweep
from foretouch.timing import MachineLoad
from foretouch.tradeoff.area import Answer, Area, Timed, TradeoffSettings, Variant
from foretouch.tradeoff.frontier import summary_tables
from foretouch.tradeoff.picture import draw_tradeoff
from foretouch.tradeoff.timing import largest_difference, peak_memory_mb, time_variants

TABLE_FILE: Final = "tradeoff.csv"

_START_S: Final = 20.0  # of the processes, and to read the data
_COMPARED: Final = 10  # size of the requests whose answers are compared, or the next smaller one


@dataclass(kw_only=True)
class TradeoffResult:
    """Result of one area."""

    rows: list[Row] = field(default_factory=list)  # of `tradeoff.csv`
    skipped: dict[str, str] = field(default_factory=dict)  # reasons by variant
    failures: dict[str, str] = field(default_factory=dict)  # reasons by cell
    figures: list[str] = field(default_factory=list)  # file names
    cells: int = 0  # of skills
    reused: int = 0  # cells that were finished before


def estimate_seconds(area: Area[Any, Any], settings: Any, out: Path, data: Any, workers: int) -> float:
    """Time that the unfinished cells and the timings will take [s], of data that were read."""
    cells = area.cells(settings, data)
    area.check_trainings(cells)
    done = manifests.read_cells(out, cells)
    left = [cell for cell in cells if cell.key not in done]
    skills = area.seconds(settings, data, left) if area.seconds else 0.0
    return skills / workers + float(settings.timing_s) + _START_S


def run_tradeoff(
    area: Area[Any, Any],
    settings: Any,
    out: Path,
    *,
    preset: str = "",
    source: Path | None = None,
    resume: bool = False,
    times_only: bool = False,
    workers: int = 1,
    progress: Progress | None = None,
    timing_progress: Callable[[int, int], None] = lambda *_: None,
    read: ReadData | None = None,
) -> TradeoffResult:
    """Measure an area and write its folder; arguments and errors as those of `run_sweep`.

    Finished cells of skills are kept by `resume`; times are measured again. Times of an idle and of a loaded machine
    are kept beside each other, and replaced by those of the same state. With `times_only`, no skill is measured: those
    of `out`, which may be published results without their cells, are kept.
    """
    variants = area.checked_variants(settings)
    read = read or area.read(settings, source, out)
    data = read.values
    sweep = SweepResult()
    if times_only:
        manifests.require_experiment(out, area.name)
    else:
        area.check_trainings(area.cells(settings, data))
        sweep = run_sweep(
            area, settings, out, preset=preset, resume=resume, workers=workers, progress=progress, read=read
        )
    skills = {row["variant"]: row for row in manifests.read_results(out / manifests.RESULTS_FILE)}
    result = TradeoffResult(cells=sweep.cells, reused=sweep.reused, failures=sweep.failures)
    times = _times(area, settings, data, variants, result.skipped, timing_progress)
    names = [name for name in next(iter(skills.values()), {}) if name != "variant"]
    result.rows = [
        {"variant": row["variant"], "factor": row["factor"]}
        | {name: skills.get(row["variant"], {}).get(name) for name in names}
        | {name: value for name, value in row.items() if name not in ("variant", "factor")}
        for row in times
    ]
    result.rows += _of_other_state(out / TABLE_FILE, result.rows)
    manifests.write_results(out, result.rows, TABLE_FILE)
    manifest = read_json(out / manifests.MANIFEST_FILE)
    manifests.write_manifest(out, {**manifest, "skipped": result.skipped})
    result.figures = report(area, out)
    return result


def report(area: Area[Any, Any], out: Path) -> list[str]:
    """Write summary and picture of the rows of `tradeoff.csv`; returns the names of the pictures.

    Raises:
        FileError: If there is no such table.
        ConfigError: If it is of another area.
    """
    manifests.require_experiment(out, area.name)
    rows = manifests.read_results(out / TABLE_FILE)
    if not rows:
        raise FileError(out / TABLE_FILE, "contains no row")
    manifest = out / manifests.MANIFEST_FILE
    skipped = read_json(manifest).get("skipped", {}) if manifest.exists() else {}
    manifests.write_summary(out, area, summary_tables(area, rows, skipped))
    return [path.name for path in (*draw_tradeoff(area, rows, out), *area.draw(rows, out))]


def _times(
    area: Area[Any, Any],
    settings: TradeoffSettings,
    data: Any,
    variants: Sequence[Variant],
    skipped: dict[str, str],
    progress: Callable[[int, int], None],
) -> list[Row]:
    """Make each variant ready, compare its answers, then time all together."""
    from threadpoolctl import threadpool_limits

    requests = sorted(settings.requests)
    compared = max((one for one in requests if one <= _COMPARED), default=requests[0])
    ready: dict[str, Timed] = {}
    facts: dict[str, Row] = {}
    answers: dict[str, Answer] = {}
    with threadpool_limits(1):
        for variant in variants:
            try:
                if variant.missing:
                    raise ForetouchError(variant.missing)
                made = area.timed(variant, settings, data)
                facts[variant.name] = {"size_mb": None if made.size_mb is None else round(made.size_mb, 3)}
                answers[variant.name] = np.array(made.answer(compared))
                memory = peak_memory_mb(partial(made.answer, compared))
                facts[variant.name]["memory_mb"] = None if memory is None else round(memory, 2)
                ready[variant.name] = made
            except ForetouchError as err:
                skipped[variant.name] = str(err)
        for variant in variants:
            if variant.name in ready:
                facts[variant.name] |= _difference(variant, answers, area.shipped)
        load = MachineLoad()
        times = time_variants(ready, requests, settings.timing_s, settings.seed, progress)
    machine = manifests.environment(1, None)
    machine_row = load.row() | {"cpu": machine["cpu"], "cores": machine["cores"]}
    cpu_ms = {(row["variant"], row["request"]): row["cpu_ms"] for row in times}
    factors = {variant.name: variant.factor for variant in variants}
    references = {variant.name: variant.reference or area.reference for variant in variants}
    return [
        {"factor": factors[row["variant"]], **row}
        | {"reference": references[row["variant"]]}
        | {
            "ratio": _rounded(cpu_ms.get((references[row["variant"]], row["request"])), row["cpu_ms"]),
            **facts[row["variant"]],
            **machine_row,
        }
        for row in times
    ]


def _difference(variant: Variant, answers: dict[str, Answer], shipped: str) -> Row:
    other = variant.compared_with or shipped
    difference = largest_difference(answers[variant.name], answers[other]) if other in answers else None
    return {"compared_with": other, "difference": None if difference is None else float(f"{difference:.3g}")}


def _rounded(reference: float | None, own: float) -> float | None:
    """How many times as fast as the reference, by processor time of the same run."""
    return None if reference is None else float(f"{reference / own:.4g}")


def _of_other_state(path: Path, rows: Sequence[Row]) -> list[Row]:
    """Rows of an earlier run in the other state of the machine."""
    if not path.exists() or not rows:
        return []
    earlier = [row for row in manifests.read_results(path) if row["state"] != rows[0]["state"]]
    return [{name: row.get(name) for name in rows[0]} for row in earlier]
