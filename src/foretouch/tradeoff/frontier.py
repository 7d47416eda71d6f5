# SPDX-License-Identifier: Apache-2.0
"""The frontier of skill and time, and the sentences that are written from it."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.tradeoff.area import Area, Panel

BUDGETS_MS: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def time_column(rows: Sequence[Row]) -> str:
    """Wall time if the machine was idle, else processor time, which other processes disturb less."""
    return "ms_p50" if all(row["state"] == "idle" for row in rows) else "cpu_ms"


def frontier(rows: Sequence[Row], skill: str) -> list[Row]:
    """Rows that no other beats in both skill and time, by ascending time.

    Args:
        rows: Of one size of request and one state of the machine.
        skill: Column; rows without it are ignored.
    """
    column = time_column(rows)
    result: list[Row] = []
    for row in sorted((row for row in rows if row.get(skill) is not None), key=lambda one: (one[column], -one[skill])):
        if not result or row[skill] > result[-1][skill]:
            result.append(row)
    return result


def best_state(rows: Sequence[Row]) -> list[Row]:
    """Rows of the idle machine, if it was idle once, else of the loaded one."""
    return [row for row in rows if row["state"] == "idle"] or list(rows)


def of_request(rows: Sequence[Row], request: int) -> list[Row]:
    """Rows of one size of request, of the best state of the machine."""
    return [row for row in best_state(rows) if row["request"] == request]


def summary_tables(area: Area[Any, Any], rows: Sequence[Row], skipped: Mapping[str, str]) -> list[Table]:
    """A table of the frontier and plain sentences for each panel, then what is true of all."""
    tables = []
    for panel in area.panels:
        chosen = of_request(rows, panel.request)
        line = frontier(chosen, panel.skill)
        if not line:
            continue
        column = time_column(chosen)
        body = [[row["variant"], f"{row[panel.skill]:.3f}", *_times(row), _ratio(row)] for row in line]
        columns = [
            "frontier",
            "skill",
            "p50 [ms]",
            "p95 [ms]",
            "p99 [ms]",
            "CPU [ms]",
            "times as fast as the reference",
        ]
        tables.append(Table(panel.title, columns, body, list(_sentences(panel, chosen, line, column))))
    return [*tables, Table("All settings", [], [], list(_general(area, rows, skipped)))]


def _times(row: Row) -> list[str]:
    return [f"{row[name]:.3g}" for name in ("ms_p50", "ms_p95", "ms_p99", "cpu_ms")]


def _ratio(row: Row) -> str:
    return "" if row["ratio"] is None else f"{row['ratio']:.1f}"


def _sentences(panel: Panel, rows: Sequence[Row], line: Sequence[Row], column: str) -> Iterator[str]:
    skill = panel.skill
    best, fastest = line[-1], line[0]
    yield f"Most skilful: {best['variant']}, skill {best[skill]:.2f} in {best[column]:.3g} ms."
    yield f"Fastest: {fastest['variant']}, skill {fastest[skill]:.2f} in {fastest[column]:.3g} ms."
    good = next((row for row in line if row[skill] >= panel.share * best[skill]), best)  # the best may be negative
    yield (
        f"At least {panel.share:.0%} of the best skill: {good['variant']}, skill {good[skill]:.2f} in {good[column]:.3g} ms, "
        f"{best[column] / good[column]:.1f} times as fast as the most skilful."
    )
    said = ""
    for budget in BUDGETS_MS:
        within = [row for row in line if row["ms_p95" if column == "ms_p50" else column] <= budget]
        if within and within[-1]["variant"] != said:
            said = within[-1]["variant"]
            yield f"Within {budget:g} ms: {said}, skill {within[-1][skill]:.2f}."
    own = (row for row in rows if row["factor"] == "shipped" and row.get(skill) is not None)
    if (shipped := next(own, None)) is not None:
        beaten = shipped not in line
        ratio = (
            f", {shipped['ratio']:.1f} times as fast as {shipped['reference']} in the same run"
            if shipped["ratio"] and shipped["reference"] != shipped["variant"]
            else ""
        )
        text = "is not on the frontier" if beaten else "is on the frontier"
        yield f"{shipped['variant']} (shipped) {text}: skill {shipped[skill]:.2f} in {shipped[column]:.3g} ms{ratio}."


def _general(area: Area[Any, Any], rows: Sequence[Row], skipped: Mapping[str, str]) -> Iterator[str]:
    yield from area.notes(rows)
    chosen = best_state(rows)
    largest: dict[tuple[str, str], Row] = {}
    for row in chosen:
        if row["difference"] is not None and row["variant"] != row["compared_with"]:
            largest.setdefault((row["variant"], row["compared_with"]), row)
    shipped = {row["variant"] for row in chosen if row["factor"] == "shipped"}
    twins = [row for row in largest.values() if row["compared_with"] not in shipped]
    for row in twins:
        yield f"{row['variant']} answers like {row['compared_with']} within {row['difference']:.2g} {area.unit}."
    untold = sorted({row["variant"] for row in chosen if all(row.get(skill) is None for skill in area.skills)})
    if untold:
        yield f"Time alone, without a skill: {', '.join(untold)}."
    for name, why in skipped.items():
        yield f"Skipped: {name}: {why}."
    first = chosen[0]
    column = "wall time" if first["state"] == "idle" else "processor time"
    yield (
        f"Measured on {first['cpu']}, {first['cores']} cores, one thread, {first['state']}: other processes used "
        f"{first['other_cores']:.2f} cores. Frontiers are of the median {column}."
    )
