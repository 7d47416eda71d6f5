# SPDX-License-Identifier: Apache-2.0
"""The same id for the same object in all clouds of a stream, where `segment` numbers each cloud by distance.

An object is the one before with which it shares most pixels, if these are more than half of the smaller of both. Clouds
that are no images, or of another size, are compared by centroid. Objects that a hand hides are remembered for a while.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count, groupby
from typing import Final

import numpy as np

from foretouch.kernels import Kernel
from foretouch.types import Float64, Int32, Int64
from foretouch.types.scene import Object, Scene

_count_labels = Kernel("count_labels")
_write_ids = Kernel("write_ids")

_SAME_PLACE_M: Final = 0.03  # between the centroids of an object in two clouds
_REMEMBERED: Final = 90  # clouds without the object: 3 s at 30 Hz
_LAST: Final = 2**31 - 1  # an id is an int32 in the labels


@dataclass(frozen=True, eq=False)
class _Seen:
    """An object when it was seen last."""

    pixels: Int64  # flat indices
    centroid: Float64  # [m]
    shape: tuple[int, ...]  # of the cloud
    at: int  # number of the cloud


class ObjectIdentity:
    """The ids of the objects in a stream of clouds."""

    def __init__(self) -> None:
        self._seen: dict[int, _Seen] = {}
        self._ids = count(1)
        self._clouds = 0

    def ids(self, scene: Scene) -> list[str]:
        """Return the ids of the stream of the objects of the next cloud, and write them into the labels of its scene.

        Its counts get `new_ids`: objects that were not seen before.
        """
        self._clouds += 1
        known = self._known(scene)
        names = np.zeros(len(scene.objects) + 1, np.int32)
        for label in range(1, len(names)):
            names[label] = known.get(label) or next(self._ids) % _LAST
        ids, shape = names[1:].tolist(), scene.labels.shape
        self._seen |= {
            id_: _Seen(object_.pixels, object_.centroid, shape, self._clouds)
            for id_, object_ in zip(ids, scene.objects, strict=True)
        }
        self._seen = {id_: sight for id_, sight in self._seen.items() if self._clouds - sight.at < _REMEMBERED}
        if not np.array_equal(names, np.arange(len(names))):
            _rename(scene.labels, names)
        scene.counts["new_ids"] = len(ids) - len(known)
        return [str(id_) for id_ in ids]

    def _known(self, scene: Scene) -> dict[int, int]:
        """Return the id of the stream by the label in this cloud: most pixels first, objects of the cloud before first."""
        known: dict[int, int] = {}
        by_age = sorted(self._seen.items(), key=lambda item: -item[1].at)
        for _, group in groupby(by_age, key=lambda item: item[1].at):
            pairs = [
                (-share, id_, label)
                for id_, seen in group
                for label, share in enumerate(_shared(seen, scene.labels, scene.objects), 1)
                if share
            ]
            for _, id_, label in sorted(pairs):
                if label not in known and id_ not in known.values():
                    known[label] = id_
            if len(known) == len(scene.objects):
                break
        return known


def _rename(labels: Int32, names: Int32) -> None:
    """Write the new names of labels over them."""
    height, width = np.atleast_2d(labels).shape
    _write_ids(labels, height, width, 0, 0, names, width, labels, np.empty(1, np.int64))


def _shared(seen: _Seen, labels: Int32, objects: Sequence[Object]) -> list[float]:
    """Return how much each object of a cloud has in common with one seen before; 0 if it is another."""
    if labels.ndim == 1 or labels.shape != seen.shape:
        apart = [float(np.linalg.norm(object_.centroid - seen.centroid)) for object_ in objects]
        return [max(0.0, _SAME_PLACE_M - distance) for distance in apart]
    shared = np.empty(len(objects) + 1, np.int64)
    _count_labels(labels, seen.pixels, len(seen.pixels), len(objects), shared)
    sizes = [min(len(seen.pixels), object_.n_points) for object_ in objects]
    return [float(n) if 2 * n > size else 0.0 for n, size in zip(shared[1:].tolist(), sizes, strict=True)]
