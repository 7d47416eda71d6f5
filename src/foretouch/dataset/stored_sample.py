# SPDX-License-Identifier: Apache-2.0
"""Samples of a training store that may be larger than memory: their clouds stay on the disk until they are used."""

from typing import Any, Self

from foretouch.dataset.samples import only_finite
from foretouch.dataset.store import Store
from foretouch.types import GraspSample


class StoredSample(GraspSample):
    """A sample in memory but for its cloud, which is read from the store whenever it is used and is not kept.

    Clouds that are used in the order of the store cost one read of each batch. A copy or a pickle holds the path of the
    store, not the cloud; `dataclasses.replace` makes a sample with its cloud.
    """

    @classmethod
    def of(cls, sample: GraspSample, store: Store, number: int) -> Self:
        """Sample `number` of a store, read before."""
        stored = cls.__new__(cls)
        vars(stored).update({**vars(sample), "_place": (store, number)})
        del vars(stored)["cloud"]
        return stored

    def __getattr__(self, name: str) -> Any:
        """The cloud; raises `FileError` if the store was removed or changed since it was opened."""
        if name != "cloud":
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        store, number = vars(self)["_place"]
        return only_finite(store[number]).cloud
