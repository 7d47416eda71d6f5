# SPDX-License-Identifier: Apache-2.0
"""Areas of `foretouch tradeoff`: experiments that measure skills of many variants of one component, and time them.

Cells measure skills, each in its own process. Once they have run, all variants are timed in one process and in one
random order, and the answers of each are compared with those of the shipped one. The table, `tradeoff.csv`, has a row
for each variant, size of request and state of the machine, idle or loaded; a variant that cannot run here has one row
with the reason. To add an area, add a module `tradeoff_<area>` to `foretouch_lab.experiments` that holds an `EXPERIMENT`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, ForetouchError, none_of
from foretouch.models.timing import MachineLoad, cpu_name, time_calls
from foretouch.types import Float64, Floating
from foretouch_lab.experiments.framework import frontier
from foretouch_lab.experiments.framework.experiment import (
    Cell,
    D,
    Experiment,
    Row,
    S,
    Table,
    find_experiment,
    list_experiments,
)
from foretouch_lab.experiments.framework.manifest import read_results, require_experiment, write_results

_PREFIX: Final = "tradeoff_"
_COMPARED: Final = 10  # size of the requests whose answers are compared, or the next smaller one
_TIMES: Final = ("ms_p50", "ms_p95", "ms_p99", "cpu_ms")
_HOT: Final = "hot_cpu_ms"  # median processor time in a loop without pauses, where there are pauses
_HOT_SHARE: Final = 0.2  # of the time of all timings, for calls without a pause

Answer = Floating


@dataclass(frozen=True, kw_only=True)
class TradeoffSettings(Settings):
    """Settings of every area."""

    timing_s: float = setting(60.0, "Time of all timings together", bounds=(0.1, 3600.0))
    pause_s: float = setting(
        0.0, "Time asleep before each call, as in a graph that waits for clouds", bounds=(0.0, 10.0)
    )
    requests: tuple[int, ...] = setting((1,), "Sizes of the requests that are timed", minimum=1)
    detail: str = setting("all", "few: the main variants; all: all variants and pairs", choices=("few", "all"))


@dataclass(frozen=True)
class Variant:
    """One setting of the component that is measured: the shipped one, or one that differs from it."""

    name: str  # unique, and short: it is written beside its point in the picture
    factor: str  # what differs: `shipped` (one for each panel's skill), `reference`, the name of one setting, or two joined by ` x `
    values: Mapping[str, Any] = field(default_factory=dict)  # plain JSON data from which the area makes it
    compared_with: str = ""  # variant whose answers its own shall equal; "" for the shipped one
    reference: str = ""  # variant to whose time its ratio is taken; "" for that of the area


class Timed(NamedTuple):
    """A variant that is ready to be timed."""

    answer: Callable[[int], Answer]  # from the size of a request to an answer that is comparable with other variants'
    size_mb: float | None = None  # on disk [MB]; None if that has no meaning
    whole: float = 1.0  # number of such calls that make the whole, as steps make a training; times are multiplied by it


@dataclass(frozen=True, kw_only=True)
class Area(Experiment[S, D]):
    """Declaration of one area. Its settings are `TradeoffSettings`, and its presets are `small` and `full`.

    `tabulate` returns one row for each variant with the columns `variant` and, for each of `skills`, `<skill>`,
    `<skill>_low` and `<skill>_high` (its spread), those of `equal_columns` where variants are compared in pairs, and
    errors as the area likes. A variant without a row has times alone.

    Attributes:
        variants: All variants of a preset's settings.
        timed: Makes a variant ready to be timed; called once for each. Raises a `ForetouchError` if it cannot run here,
            such as for a library that is not installed.
        shipped: Name of the variant that users have without asking.
        reference: Name of the variant that ratios of times are taken to.
        skills: Columns of skills, each with its meaning.
        panels: Diagrams of the picture.
    """

    variants: Callable[[S], Iterable[Variant]]
    timed: Callable[[Variant, S, D], Timed]
    shipped: str
    reference: str
    skills: Mapping[str, str]
    panels: Sequence[frontier.Panel]
    summarise: Callable[[Sequence[Row]], Sequence[Table]] = lambda _: ()
    results: str = "tradeoff.csv"
    order: int = 900

    @property
    def area(self) -> str:
        """Name on the command line of `foretouch tradeoff`."""
        return self.name.removeprefix(_PREFIX)

    @property
    def command(self) -> str:
        """Words that run it."""
        return f"foretouch tradeoff {self.area}"

    def resolve(self, preset: str, overrides: Mapping[str, Any]) -> S:
        """As `Experiment.resolve`; a `ConfigError` too if two variants have the same name, or a named one is absent."""
        settings = super().resolve(preset, overrides)
        variants = list(self.variants(settings))
        names = [one.name for one in variants]
        if len(set(names)) < len(names):
            raise ConfigError(f"{self.name}: variants: {max(names, key=names.count)!r} occurs twice")
        wanted = {self.shipped, self.reference, *(n for one in variants for n in (one.compared_with, one.reference))}
        if absent := wanted - {"", *names}:
            raise ConfigError(f"{self.name}: variants: {min(absent)!r} is absent")
        return settings

    def finish(
        self, settings: S, data: D, rows: list[Row], out: Path, progress: Callable[[int, int], None], /
    ) -> list[Row]:
        """Add the times. Rows of an earlier run in the other state of the machine are kept."""
        found = {row["variant"]: row for row in rows}
        names = [name for name in next(iter(rows), {}) if name != "variant"]
        timed = [
            {"variant": variant.name, "factor": variant.factor}
            | {name: found.get(variant.name, {}).get(name) for name in names}
            | row
            for variant, row in _time_variants(self, settings, data, progress)
        ]
        states = {row["state"] for row in timed}
        before = read_results(out / self.results) if (out / self.results).exists() else []
        return timed + [{name: row.get(name) for name in timed[0]} for row in before if row["state"] not in states]

    def facts(self, rows: Sequence[Row], /) -> dict[str, Any]:
        """Variants that could not run, with the reasons, and those on the frontier of each panel."""
        lines = {one.title: frontier.frontier(frontier.of_request(rows, one.request), one.skill) for one in self.panels}
        return {
            "area": self.area,
            "skipped": {row["variant"]: row["skipped"] for row in rows if row["skipped"]},
            "frontier": {title: [row["variant"] for row in line] for title, line in lines.items()},
        }

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """What the area summarises, frontiers, and the machine: the idle one if it was idle once."""
        rows = frontier.best_state(rows)
        machine = Table("Machine", [], [], frontier.machine_notes(rows))
        return [*self.summarise(rows), *frontier.tables(self.panels, rows), machine]

    def draw(self, rows: Sequence[Row], folder: Path) -> list[Path]:
        """Draw `tradeoff.png`, and the figure of the area's own."""
        return [*frontier.draw(self.panels, self.skills, rows, folder), *super().draw(rows, folder)]


def list_areas() -> list[Area[Any, Any]]:
    """The areas of this package, sorted by name."""
    return sorted((one for one in list_experiments() if isinstance(one, Area)), key=lambda one: one.name)


def find_area(name: str) -> Area[Any, Any]:
    """Find an area by name, or by the dotted name of a user's module that holds an `EXPERIMENT`.

    Raises:
        ConfigError: If there is none.
    """
    if "." in name and isinstance(found := find_experiment(name), Area):
        return found
    areas = list_areas()
    if named := [one for one in areas if one.area == name]:
        return named[0]
    raise ConfigError(f"tradeoff: {none_of(name, [one.area for one in areas])}")


def variant_cells(variants: Callable[[S], Iterable[Variant]]) -> Callable[[S, Any], list[Cell]]:
    """`cells` of an area with a cell for each variant."""
    return lambda settings, _: [
        Cell(f"{k:03}", {"variant": one.name, **one.values}) for k, one in enumerate(variants(settings))
    ]


def measure_times(
    area: Area[Any, Any], settings: Any, out: Path, source: Path | None, progress: Callable[[int, int], None]
) -> list[Row]:
    """Time all variants again, with the skills of a table, and write it.

    Raises:
        FileError: If there is no table.
        ConfigError: If it is of another area.
    """
    require_experiment(out, area.name)
    before = read_results(out / area.results)
    names = [name for name in next(iter(before), {}) if name != "factor"]
    skilled = [{name: row[name] for name in names[: names.index("request")]} for row in before]
    data = area.load(settings, area.prepare(settings, source, out))
    return write_results(out, area.finish(settings, data, skilled, out, progress), area.results)


def _time_variants(
    area: Area[S, D], settings: Any, data: D, progress: Callable[[int, int], None]
) -> Iterator[tuple[Variant, Row]]:
    """Make each variant ready, compare its answers, then time all together: a row for each variant and size."""
    from threadpoolctl import threadpool_limits

    requests = sorted(settings.requests)
    compared = max((one for one in requests if one <= _COMPARED), default=requests[0])
    variants = list(area.variants(settings))
    ready: dict[str, Timed] = {}
    answers: dict[str, Answer] = {}
    skipped: dict[str, str] = {}
    with threadpool_limits(1):
        for variant in variants:
            try:
                made = area.timed(variant, settings, data)
                answers[variant.name] = np.array(made.answer(compared))
                ready[variant.name] = made
            except ForetouchError as err:
                skipped[variant.name] = str(err)
        load = MachineLoad()
        calls = {name: one.answer for name, one in ready.items()}
        hot = time_calls(calls, requests, _HOT_SHARE * settings.timing_s, progress) if settings.pause_s else {}
        share = 1.0 - _HOT_SHARE if hot else 1.0
        times = time_calls(calls, requests, share * settings.timing_s, progress, settings.pause_s)
    state = load.row()
    machine = {"state": state["state"], "other_cores": state["other_cores"], "cpu": cpu_name()}
    found = {key: _quantiles(calls, ready[key[0]].whole) for key, calls in times.items()}
    for key, row in found.items():
        row[_HOT] = 1e3 * float(np.median(hot[key][:, 1])) if key in hot else None
    for variant in variants:
        other, reference = variant.compared_with or area.shipped, variant.reference or area.reference
        facts = {
            "reference": reference,
            "size_mb": ready[variant.name].size_mb if variant.name in ready else None,
            "compared_with": other,
            "difference": _largest_difference(answers.get(variant.name), answers.get(other)),
            **machine,
            "skipped": skipped.get(variant.name),
        }
        for request in requests if variant.name in ready else ():
            if (own := found.get((variant.name, request))) is not None:
                against = found.get((reference, request))
                ratio = None if against is None else against["cpu_ms"] / own["cpu_ms"]
                yield (
                    variant,
                    {"request": request, "calls": len(times[variant.name, request]), **own, "ratio": ratio, **facts},
                )
        if variant.name in skipped:
            yield variant, {**dict.fromkeys(("request", "calls", *_TIMES, _HOT, "ratio")), **facts}


def _quantiles(times: Float64, whole: float) -> Row:
    values = [*np.percentile(times[:, 0], (50, 95, 99)), np.median(times[:, 1])]
    return {name: 1e3 * whole * float(value) for name, value in zip(_TIMES, values, strict=True)}


def _largest_difference(answer: Answer | None, other: Answer | None) -> float | None:
    """Of two answers; None if they cannot be compared."""
    if answer is None or other is None or answer.shape != other.shape:
        return None
    return float(np.abs(answer.astype(np.float64) - other.astype(np.float64)).max(initial=0.0))
