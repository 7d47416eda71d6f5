# SPDX-License-Identifier: Apache-2.0
"""The objects on the table: extracted from the clusters, and the selection of those that get grasps."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from foretouch.base.files import read_json
from foretouch.cloud.segmentation.background import ENTERS, REASONS, Background
from foretouch.cloud.segmentation.clusters import ClusterConfig, Clusters, HeightThreshold
from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.kernels import Kernel
from foretouch.types import Cloud, Float64, Int32, Int64, Plane
from foretouch.types.scene import NEAR_M, Object

_collect_members = Kernel("collect_members")
_write = Kernel("write_ids")

AMBIGUOUS_TARGET = "ambiguous_target"  # flag, and start of the reason, where a rule had to choose between equal objects
CUT = "cut_by_image"  # flag of an object that the border of the image cuts

_SAME_PLACE_M = 0.03  # an object that moves less between two clouds is the same
_SAME_ANGLE = float(np.radians(1.0))  # objects whose angles to the optical axis differ less are equally central

TargetMode = Literal["nearest", "largest", "point", "free", "all"]

_FREE = 0.2  # of the score that others may cost the best grasp of a free object: a turn by 45 degrees costs as much
WEIGHTS = Path(__file__).with_name("whole_object.json")
INPUTS = ("log_cells", "refused", "accepted")
_RANGES = ((0.0, 12.0), (-6.0, 1.0), (-2.0, 6.0))  # beyond which a number says no more


def extract_objects(
    cloud: Cloud,
    windows: Sequence[Clusters],
    threshold: HeightThreshold,
    config: ClusterConfig,
    labels: Int32,
    found: Background | None = None,
) -> tuple[tuple[Object, ...], tuple[Object, ...], dict[str, int]]:
    """Extract the clusters of a plausible size as objects, and those that are background.

    Args:
        cloud: The whole cloud, its points contiguous.
        windows: Its labelled windows.
        threshold: The table, and the noise of the depth.
        config: Limits of the size.
        labels: (H, W) or (N,) int32, zeros; the ids of objects are written into it.
        found: Which labels are background, and which the image cuts; all are whole objects if absent.

    Returns:
        Objects in order of the distance of their centroid from the camera, ties by position in the image; background in the
        same order; and the counts `objects`, `rejected` and `flying` of points and `n_rejected` and
        `n_background`, also by reason, of clusters.
    """
    rgb = None if cloud.rgb is None else cloud.rgb.reshape(-1, 3)  # once, not for each window: it may be a copy
    flat = Cloud(cloud.xyz.reshape(-1, 3), rgb, cloud.frame_id, cloud.stamp_ns)
    image = np.atleast_2d(labels)
    shape = image.shape if cloud.organised else None
    standing: list[tuple[Candidate, tuple[str, ...]]] = []  # with the flags of the object
    behind: list[tuple[Candidate, str]] = []  # with the reason
    rejected = []
    first = 0  # label of the window among all labels
    for number, window in enumerate(windows):
        for part in _candidates(flat, number, window, image.shape[1], threshold.plane):
            reason = "" if found is None else REASONS[found.reasons[first + part.label]]
            if reason == ENTERS or (reason and part.cloud.size >= config.min_points):
                behind.append((part, reason))
            elif not reason and _plausible(part, threshold, config):
                cut = found is not None and bool(found.cut[first + part.label])
                standing.append((part, (CUT,) if cut else ()))
            else:
                rejected.append(part.cloud.size)
        first += window.n_labels
    standing.sort(key=lambda entry: entry[0].order)
    behind.sort(key=lambda entry: entry[0].order)
    ids = [np.zeros(window.n_labels + 1, np.int32) for window in windows]
    for k, (part, _) in enumerate(standing, 1):
        ids[part.window][part.label] = k
    labelled = sum(_write_ids(image, *entry) for entry in zip(windows, ids, strict=True))
    objects = []
    for k, (part, flags) in enumerate(standing, 1):
        sure = confidence(windows[part.window], part.label, part.cloud.size)
        objects.append(part.made(str(k), threshold.plane, shape, flags=flags, confidence=sure))
    background = tuple(part.made("0", threshold.plane, shape, background=reason) for part, reason in behind)
    used = sum(object_.n_points for object_ in objects)
    counts = {"objects": used, "rejected": sum(rejected), "n_rejected": len(rejected), "flying": labelled - used}
    counts |= {"n_background": len(background)} | Counter(f"n_{entry.background}" for entry in background)
    return tuple(objects), background, counts


class Candidate(NamedTuple):
    """A cluster of a window, of which an object may be made."""

    cloud: Cloud  # its solid points
    centroid: Float64
    bounds: Float64
    pixels: Int64
    top_m: float  # height above the table [m]
    window: int  # its number
    label: int

    @property
    def order(self) -> tuple[float, int, int]:
        """Distance from the camera [m], then the position in the image."""
        return float(np.linalg.norm(self.centroid)), self.window, self.label

    def made(self, object_id: str, plane: Plane, shape: tuple[int, int] | None, **facts: Any) -> Object:
        """Make the object."""
        return Object(object_id, self.cloud, plane, self.centroid, self.bounds, self.pixels, shape, **facts)


def _candidates(flat: Cloud, number: int, window: Clusters, width: int, plane: Plane) -> Iterator[Candidate]:
    """Iterate over the clusters of a window with solid points."""
    count, size = int(np.count_nonzero(window.solid)), window.n_labels + 1
    ends, pixels, points = np.empty(size, np.int64), np.empty(count, np.int64), np.empty((count, 3), np.float32)
    columns, bounds, tops = np.empty((3, count)), np.empty((size, 2, 3), np.float32), np.empty(size, np.float32)
    image, table = flat.xyz.reshape(-1, width, 3), plane.coefficients.astype(np.float32)
    _collect_members(window.as_struct(image), table, window.n_labels, ends, pixels, points, columns, bounds, tops)
    start = 0
    for cluster, end in enumerate(ends.tolist()):
        if end > start:
            rgb = None if flat.rgb is None else flat.rgb.take(pixels[start:end], axis=0)
            part = Cloud(points[start:end], rgb, flat.frame_id, flat.stamp_ns)
            centroid = np.add.reduce(columns[:, start:end], axis=1) / (end - start)  # in half the time of mean
            box = bounds[cluster].astype(np.float64)
            yield Candidate(part, centroid, box, pixels[start:end], float(tops[cluster]), number, cluster)
        start = end


def _plausible(part: Candidate, threshold: HeightThreshold, config: ClusterConfig) -> bool:
    """Neither speckle nor noise or waves of the table, nor a wall."""
    waves_m = 2.0 * threshold.noise_per_m * part.centroid[2] ** 2
    return bool(
        part.cloud.size >= config.min_points
        and (part.bounds[1] - part.bounds[0]).max() <= config.max_extent_m
        and np.float32(part.top_m) >= np.float32(max(config.min_top_m, waves_m))
    )


def _write_ids(image: Int32, window: Clusters, ids: Int32) -> int:
    """Write the ids of a window's clusters into the labels of the cloud; their number of pixels."""
    count, place = np.empty(1, np.int64), (*window.labels.shape, window.rows, window.columns)
    _write(window.labels, *place, ids, image.shape[1], image, count)
    return int(count[0])


@dataclass(frozen=True, kw_only=True)
class TargetConfig(Settings):
    """Which objects get grasps."""

    mode: TargetMode = setting(
        "nearest",
        "nearest to the camera of the objects that are most surely whole, largest in points, the one at a point, the nearest whose best grasp no other object blocks, or all",
        choices=get_args(TargetMode),
    )
    point: tuple[float, ...] = setting((), "x, y, z for mode point, in the cloud's frame", unit="m")
    tolerance_m: float = setting(
        NEAR_M, "Maximum distance of the object's nearest point from the point", bounds=(0.0, 1.0)
    )
    margin_m: float = setting(0.005, "Two objects whose distances differ less are ambiguous", bounds=(0.0, 1.0))
    confidence_margin: float = setting(
        0.05,
        "Of mode nearest and free: objects whose confidence is lower than the best one's by more come after the others",
        bounds=(0.0, 1.0),
    )
    max_objects: int = setting(16, "Most objects of modes all and free, nearest first", bounds=(1, 10_000))

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.point) not in (0, 3):
            raise ConfigError(f"point: {len(self.point)} numbers are not x, y, z")
        if self.mode == "point" and not self.point:
            raise ConfigError("point: is empty, mode point needs x, y, z")


def select_targets(
    objects: Sequence[Object], config: TargetConfig, previous: Float64 | None = None
) -> tuple[list[Object], str]:
    """Select the objects that get grasps.

    Mode `nearest` selects among the surest ones (see `surest`). Objects within `margin_m` (mode `largest`: within 5 % of the points) of the best are ambiguous, since noise would
    decide. Of them, the object is selected that is still where the previous target was; else the one at the smallest
    angle to the optical axis; of those within 1 degree of it the leftmost in the image, then the highest, then the first.

    Args:
        objects: In order of id.
        config: The rule.
        previous: (3,) float64 [m], centroid of the target of the previous cloud in a stream.

    Returns:
        The selected objects, and why: "" if the rule decides; else none with the reason, or an ambiguous one with a
        reason that starts with `ambiguous_target`, or the nearest of too many.
    """
    if not objects:
        return [], "there is no object"
    if config.mode == "all":
        limit = config.max_objects
        more = f"the {limit} nearest of {len(objects)} objects (target.max_objects)" if len(objects) > limit else ""
        return list(objects[:limit]), more
    if config.mode == "largest":
        objects = _whole(objects)
        largest = max(obj.n_points for obj in objects)
        tied = [obj for obj in objects if obj.n_points > 0.95 * largest or obj.n_points == largest]
        tied.sort(key=lambda obj: -obj.n_points)
        return _one_of(tied, previous, "equally large", [f"{obj.n_points}" for obj in tied], "points")
    where = "the camera"
    if config.mode == "nearest":
        objects = surest(objects, config, previous)
    distances = [obj.distance_m for obj in objects]
    if config.mode == "point":
        point = np.asarray(config.point)
        apart = [obj.cloud.xyz.astype(np.float64) - point for obj in objects]
        distances = [float(np.sqrt((steps * steps).sum(axis=1).min())) for steps in apart]
        at = f"the point ({', '.join(f'{p:g}' for p in config.point)})"
        where, nearest = at, min(distances)
        if nearest > config.tolerance_m:
            return [], f"no object within {config.tolerance_m:g} m of {at}: the nearest is {nearest:.3f} m away"
    nearest = min(distances)
    near = [i for i, d in enumerate(distances) if d - nearest < config.margin_m or d == nearest]
    if config.margin_m == 0.0:
        near = near[:1]
    tied = [objects[i] for i in near]
    return _one_of(tied, previous, f"equally near to {where}", [f"{distances[i]:.3f}" for i in near], "m")


def surest(objects: Sequence[Object], config: TargetConfig, previous: Float64 | None = None) -> list[Object]:
    """Return the objects that are most probably whole, in the same order.

    Those that the image does not cut, if there are any; of these, those whose confidence is at most `confidence_margin` below the
    highest one. For the object that is where the previous target was the margin is twice as wide, so that noise does not change the
    target in a stream. Objects without a confidence, such as from a mask, are all kept.
    """
    whole = _whole(objects)
    known = [obj.confidence for obj in whole if obj.confidence is not None]
    if len(known) < len(whole):
        return list(whole)
    least = max(known) - config.confidence_margin
    before = None if previous is None else _at(whole, previous)
    return [obj for obj in whole if (obj.confidence or 0.0) >= least - config.confidence_margin * (obj is before)]


def select_free(
    objects: Sequence[Object],
    config: TargetConfig,
    loss: Callable[[Object], tuple[float, str]],
    previous: Float64 | None = None,
) -> tuple[list[Object], str]:
    """Select the nearest object whose best grasp is not blocked by another object, for mode `free`: of the surest ones, else of the others.

    If there is none, the one that other objects cost least; of several that have no grasp at all, the nearest.

    Args:
        objects: In order of id, at least one; at most `max_objects` are looked at, and none beyond the first free one.
        config: Its margin decides which free objects are equally near (see `select_targets`).
        loss: The score that other objects cost the best grasp of an object, infinite if it has none, and why.
        previous: (3,) float64 [m], centroid of the target of the previous cloud in a stream.

    Returns:
        The object, and why: which nearer ones are not free, or that none is; "" if the nearest is free.
    """
    free: list[Object] = []
    blocked: list[tuple[float, Object, str]] = []
    sure = {obj.id for obj in surest(objects, config, previous)}
    for obj in sorted(objects, key=lambda entry: (entry.id not in sure, entry.distance_m))[: config.max_objects]:
        if free and (obj.id in sure) != (free[0].id in sure):
            break
        if free and obj.distance_m - free[0].distance_m >= config.margin_m:
            break
        lost, why = loss(obj)
        if lost <= _FREE:
            free.append(obj)
        else:
            blocked.append((lost, obj, f"object {obj.id} {why}"))
    notes = [note for *_, note in blocked]
    if not free:
        least = min(blocked, key=lambda entry: entry[0])[1]
        return [least], f"no object is free: {'; '.join(notes)}; object {least.id} is hindered least"
    chosen, tie = select_targets(free, config.updated({"mode": "nearest"}), previous)
    return chosen, "; ".join([tie, *notes] if tie else notes)


def _whole(objects: Sequence[Object]) -> Sequence[Object]:
    """Return the objects that the image does not cut, or all if it cuts each."""
    return [obj for obj in objects if CUT not in obj.flags] or objects


def _one_of(
    tied: Sequence[Object], previous: Float64 | None, how: str, values: Sequence[str], unit: str
) -> tuple[list[Object], str]:
    """Return the object that is selected of those that tie, and the reason where there are several."""
    if len(tied) == 1:
        return [tied[0]], ""
    chosen, why = _break_tie(tied, previous)
    ids = f"{', '.join(str(obj.id) for obj in tied[:-1])} and {tied[-1].id}"
    numbers = f"{', '.join(values[:-1])} and {values[-1]} {unit}"
    return [chosen], f"{AMBIGUOUS_TARGET}: objects {ids} are {how}, {numbers}; object {chosen.id} {why}"


def _at(objects: Sequence[Object], place: Float64) -> Object | None:
    """Return the object whose centroid is at a place (3,); None if there is none."""
    nearest = min(objects, key=lambda obj: float(np.linalg.norm(obj.centroid - place)))
    return nearest if np.linalg.norm(nearest.centroid - place) < _SAME_PLACE_M else None


def _break_tie(tied: Sequence[Object], previous: Float64 | None) -> tuple[Object, str]:
    if previous is not None and (before := _at(tied, previous)) is not None:
        return before, "was the target before"
    angles = {obj.id: float(np.arctan2(np.hypot(*obj.centroid[:2]), obj.centroid[2])) for obj in tied}
    smallest = min(angles.values())
    central = [obj for obj in tied if angles[obj.id] - smallest < _SAME_ANGLE]
    chosen = min(central, key=lambda obj: (obj.centroid[0], obj.centroid[1]))
    if len(central) > 1:
        return chosen, "is the leftmost of those nearest to the optical axis"
    return chosen, "is nearest to the optical axis"


@cache
def _weights() -> tuple[float, ...]:
    """Return the weights of the inputs, and the constant."""
    weights = read_json(WEIGHTS)["weights"]
    return tuple(float(weights[name]) for name in (*INPUTS, "constant"))


def inputs(window: Clusters, label: int, n_points: int) -> list[float] | None:
    """Return the inputs of the regression (`INPUTS`) for a label of a window; None where splitting is not possible.

    Args:
        window: With the joins of its parts, or the pixels of a cell where nothing called for splitting.
        label: A label of the window.
        n_points: Its solid points.
    """
    if window.joins is not None:
        refused, accepted, cells = window.joins[label].tolist()
    elif window.pixels_per_cell > 0.0:
        refused, accepted, cells = -math.inf, math.inf, n_points / window.pixels_per_cell
    else:
        return None
    values = math.log(max(cells, 1.0)), refused, accepted
    return [min(max(value, low), high) for value, (low, high) in zip(values, _RANGES, strict=True)]


def confidence(window: Clusters, label: int, n_points: int) -> float | None:
    """Return the probability that a label of a window is one whole object; None where splitting is not possible (see `inputs`).

    A logistic regression of three numbers: the logarithm of the cells of the segment, the highest log odds of a join that was refused,
    since what should have been joined is a part, and the lowest of the joins that made it, since what should not have been joined is
    several objects. Its weights (`whole_object.json`) are made by `python -m benchmarks.clutter.confidence`, from labelled images.
    """
    values = inputs(window, label, n_points)
    if values is None:
        return None
    *weights, constant = _weights()
    odds = constant + sum(weight * value for weight, value in zip(weights, values, strict=True))
    return 1.0 / (1.0 + math.exp(-odds))
