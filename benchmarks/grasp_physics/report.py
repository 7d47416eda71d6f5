# SPDX-License-Identifier: Apache-2.0
"""Tables of the benchmark: by method and view, by object, and by reason; intervals are over objects."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from benchmarks.common import markdown
from benchmarks.grasp_physics.measure import Conditions, Row
from benchmarks.grasp_physics.methods import DEFAULT, NO_GRASP, NO_OBJECT
from benchmarks.grasp_physics.surface import ANY, FIRST
from foretouch.types import Float64

REFERENCE: Final = "original"  # whose time the others are compared with
_DRAWS = 10_000


def chosen(rows: Sequence[Row], method: str, one: Conditions | None = None, view: str | None = None) -> list[Row]:
    """Rows of one method, where given under these conditions and in this view."""
    return [
        row
        for row in rows
        if row.method == method
        and (one is None or (row.tip_mm, row.friction) == (one.tip_mm, one.friction))
        and view in {None, row.view}
    ]


def by_object(rows: Sequence[Row], value: Callable[[Row], bool]) -> dict[str, float]:
    """Mean over the rows of each object."""
    found: dict[str, list[bool]] = {}
    for row in rows:
        found.setdefault(row.object, []).append(value(row))
    return {name: float(np.mean(values)) for name, values in found.items()}


def share(rows: Sequence[Row], value: Callable[[Row], bool]) -> str:
    """Mean over objects with its interval of 95 %, by drawing as many objects again, with replacement."""
    means = np.array(list(by_object(rows, value).values()))
    again = means[np.random.default_rng(0).integers(len(means), size=(_DRAWS, len(means)))].mean(axis=1)
    low, high = np.quantile(again, [0.025, 0.975])
    return f"{means.mean():.2f} [{low:.2f}, {high:.2f}]"


def named(method: str) -> str:
    """A method, marked where it is the default."""
    return f"{method} (default)" if method == DEFAULT else method


def methods_of(rows: Sequence[Row]) -> list[str]:
    """The methods of the rows, in their order."""
    return list(dict.fromkeys(row.method for row in rows))


def by_method(rows: Sequence[Row], one: Conditions) -> list[dict[str, str]]:
    """Held and strict by view, of the best on the true surface, and time beside that of the reference."""
    views = list(dict.fromkeys(row.view for row in rows))
    times = {name: np.array([row.ms for row in chosen(rows, name, one)]) for name in methods_of(rows)}
    found = []
    for method in methods_of(rows):
        line = {"first grasp": named(method)}
        for view in views:
            mine, best = chosen(rows, method, one, view), chosen(rows, FIRST, one, view)
            line[f"{view}: held"] = share(mine, lambda row: row.held)
            line[f"{view}: strict"] = share(mine, lambda row: row.strict)
            if best:
                line[f"{view}: of the best"] = (
                    f"{np.mean([r.held for r in mine]) / np.mean([r.held for r in best]):.2f}"
                )
        if REFERENCE in times:
            line["time, median (p95)"] = _ratio(times[method], times[REFERENCE])
        found.append(line)
    return found


def _ratio(times: Float64, reference: Float64) -> str:
    if np.isnan(times).all():
        return ""
    median, p95 = (np.nanquantile(times, q) / np.nanquantile(reference, q) for q in (0.5, 0.95))
    return f"{median:.2f} ({p95:.2f})"


def by_name(rows: Sequence[Row], one: Conditions) -> list[dict[str, str]]:
    """Held of each object, all views."""
    methods = methods_of(rows)
    means = {method: by_object(chosen(rows, method, one), lambda row: row.held) for method in methods}
    return [{"object": name, **{named(m): f"{means[m][name]:.2f}" for m in methods}} for name in means[methods[0]]]


def by_reason(rows: Sequence[Row], one: Conditions) -> list[dict[str, str]]:
    """How many grasps ended how, the most frequent first."""
    methods = methods_of(rows)
    reasons = {method: [row.reason for row in chosen(rows, method, one)] for method in methods}
    every = [reason for found in reasons.values() for reason in found]
    order = sorted(set(every), key=lambda reason: (not reason.startswith("held"), -every.count(reason)))
    return [{"what became of it": r, **{named(m): str(reasons[m].count(r)) for m in methods}} for r in order]


def by_conditions(rows: Sequence[Row], all_conditions: Sequence[Conditions]) -> list[dict[str, str]]:
    """Held and strict of both views together, under all conditions."""
    return [
        {"first grasp": named(method)}
        | {
            f"tip {one.tip_mm:g} mm, friction {one.friction:g}": " / ".join(
                f"{np.mean([getattr(row, what) for row in chosen(rows, method, one)]):.2f}"
                for what in ("held", "strict")
            )
            for one in all_conditions
        }
        for method in methods_of(rows)
    ]


def agreement(rows: Sequence[Row]) -> str:
    """How often simulation and friction cones agree, on grasps of all conditions."""
    closed = [row for row in rows if row.reason not in {NO_GRASP, NO_OBJECT} and row.method != ANY]
    same = np.mean([row.held == row.analytic for row in closed])
    only = [sum(row.held and not row.analytic for row in closed), sum(row.analytic and not row.held for row in closed)]
    return (
        f"The friction cones agree with the simulation in {same:.3f} of {len(closed)} grasps; {only[0]} hold in the simulation alone, "
        f"{only[1]} by the cones alone."
    )


def table(rows: Sequence[dict[str, str]]) -> str:
    """A table in Markdown."""
    return markdown(list(rows[0]), [list(row.values()) for row in rows])


def committed(rows: Sequence[Row], all_conditions: Sequence[Conditions]) -> list[dict[str, object]]:
    """One row for each method, conditions, view and object: how many grasps ended how. Without times."""
    found: list[dict[str, object]] = []
    for one in all_conditions:
        for method in methods_of(rows):
            for view in dict.fromkeys(row.view for row in rows):
                mine = chosen(rows, method, one, view)
                found += [
                    {
                        "tip_mm": f"{one.tip_mm:g}",
                        "friction": f"{one.friction:g}",
                        "method": method,
                        "view": view,
                        "object": name,
                    }
                    | _counted([row for row in mine if row.object == name])
                    for name in dict.fromkeys(row.object for row in mine)
                ]
    return found


def _counted(rows: Sequence[Row]) -> dict[str, object]:
    reasons = [row.reason for row in rows]
    ended = "; ".join(f"{reason} {reasons.count(reason)}" for reason in dict.fromkeys(reasons))
    counts = {what: sum(getattr(row, what) for row in rows) for what in ("held", "strict", "analytic")}
    return {"grasps": len(rows), **counts, "reasons": ended}
