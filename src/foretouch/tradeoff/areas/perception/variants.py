# SPDX-License-Identifier: Apache-2.0
"""The settings of segmentation and GeoGrasp that are compared: one factor at a time, then pairs of what is fast."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Final

from foretouch.tradeoff.area import Variant

SEGMENTATION: Final = "segmentation"
GRASP: Final = "GeoGrasp"
EVERY_PIXEL: Final = "every pixel"
ALL_POINTS: Final = "all points"

_EVERY_PIXEL_ROWS: Final = 10_000

_Values = tuple[Any, ...]
_SEGMENTATION: Final[tuple[tuple[str, str, _Values, _Values], ...]] = (
    ("grid", "grid_rows", (60, 80, 160, 240), (60, 80, 240)),
    ("crop", "crop.max_range_m", (1.5, 4.0), ()),
    ("plane threshold", "plane.threshold_m", (0.005, 0.02), ()),
    ("plane samples", "plane.max_trials", (64, 4096), ()),
    ("height", "clusters.min_height_m", (0.002, 0.006, 0.008), (0.006,)),
    ("noise", "clusters.noise_factor", (0.0, 1.5, 4.0), ()),
    ("gap", "clusters.gap_m", (0.004, 0.016), (0.016,)),
    ("slope", "clusters.max_slope", (10.0, 40.0), ()),
    ("flying", "clusters.flying_slope", (2.0, 8.0), ()),
)
"""Name of the factor, setting, values in `all`, and those in `few`."""

_GRASP: Final[tuple[tuple[str, str, _Values, _Values], ...]] = (
    ("points", "max_points", (500, 1000, 1500, 2000, 3000, 5000), (1000, 3000)),
    ("neighbours", "neighbours", (10, 20, 30, 80), (20,)),
    ("normal radius", "normal_radius_m", (0.008, 0.01, 0.015, 0.02, 0.04), (0.015,)),
    ("outliers", "outlier_deviations", (0.5, 2.0, 3.0), ()),
    ("slab", "slab_half_width_m", (0.004, 0.01, 0.014), ()),
)

_PAIRS: Final[tuple[tuple[str, str, Mapping[str, Any]], ...]] = (
    (SEGMENTATION, "grid x height", {"grid_rows": 80, "clusters.min_height_m": 0.002}),
    (SEGMENTATION, "grid x gap", {"grid_rows": 80, "clusters.gap_m": 0.004}),
    (SEGMENTATION, "grid x gap", {"grid_rows": 60, "clusters.gap_m": 0.004}),
    (SEGMENTATION, "grid x flying", {"grid_rows": 80, "clusters.flying_slope": 2.0}),
    (SEGMENTATION, "grid x samples", {"grid_rows": 80, "plane.max_trials": 64}),
    (GRASP, "points x neighbours", {"max_points": 3000, "neighbours": 20}),
    (GRASP, "points x neighbours", {"max_points": 1500, "neighbours": 20}),
    (GRASP, "points x neighbours", {"max_points": 1000, "neighbours": 10}),
    (GRASP, "points x radius", {"max_points": 3000, "normal_radius_m": 0.015}),
    (GRASP, "points x radius", {"max_points": 3000, "normal_radius_m": 0.02}),
    (GRASP, "points x radius", {"max_points": 1500, "normal_radius_m": 0.02}),
    (GRASP, "neighbours x radius", {"neighbours": 20, "normal_radius_m": 0.015}),
    (GRASP, "neighbours x radius", {"neighbours": 20, "normal_radius_m": 0.02}),
    (GRASP, "method x points", {"method": "stable", "max_points": 0}),
    (GRASP, "method x points", {"method": "stable", "max_points": 3000}),
    (GRASP, "method x points", {"method": "stable", "max_points": 1500}),
    (GRASP, "method x points", {"method": "stable", "max_points": 1000}),
    (GRASP, "method x points", {"method": "stable", "max_points": 500}),
    (GRASP, "method x neighbours", {"method": "stable", "neighbours": 20}),
    (GRASP, "method x radius", {"method": "stable", "normal_radius_m": 0.015}),
)


def list_variants(detail: str) -> list[Variant]:
    """All variants of `few` or `all`; each changes settings of one step alone, or no setting but the points by noise."""
    shipped = [_variant(SEGMENTATION, "shipped", {}), _variant(GRASP, "shipped", {})]
    references = [
        _variant(SEGMENTATION, "reference", {"grid_rows": _EVERY_PIXEL_ROWS}, EVERY_PIXEL),
        _variant(GRASP, "reference", {"max_points": 0}, ALL_POINTS),
    ]
    noise = [
        replace(
            _variant(GRASP, "noise", {}, f"points moved by {mm:g} mm"), values={**shipped[1].values, "jitter_mm": mm}
        )
        for mm in ((0.1,) if detail == "few" else (0.01, 0.1, 0.5))
    ]
    single = [_variant(GRASP, "method", {"method": "stable"}), *_single(detail)]
    pairs = [_variant(step, factor, changes) for step, factor, changes in _PAIRS] if detail == "all" else []
    return [*shipped, *references, *noise, *single, *pairs]


def _single(detail: str) -> Iterator[Variant]:
    for step, table in ((SEGMENTATION, _SEGMENTATION), (GRASP, _GRASP)):
        for factor, setting, every, few in table:
            for value in every if detail == "all" else few:
                yield _variant(step, factor, {setting: value})


def _variant(step: str, factor: str, changes: Mapping[str, Any], name: str = "") -> Variant:
    parts = [_text(key, value) for key, value in changes.items()]
    return Variant(
        name or ", ".join(parts) or f"{step} as shipped",
        factor,
        {"step": step, "changes": dict(changes)},
        compared_with=f"{step} as shipped",
        reference=EVERY_PIXEL if step == SEGMENTATION else ALL_POINTS,
    )


def _text(key: str, value: Any) -> str:
    name = key.rpartition(".")[2]
    if name == "method":
        return str(value)
    if name.endswith("_m"):
        return f"{name.removesuffix('_m').replace('_', ' ')} {1e3 * value:g} mm"
    return f"{name.replace('_', ' ')} {value:g}"
