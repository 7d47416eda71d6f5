# SPDX-License-Identifier: Apache-2.0
"""Samples as a dataset of torch, for networks of one's own."""

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from foretouch.cloud.geometry.sampling import sample_indices
from foretouch.errors import DatasetError
from foretouch.types import Sample


class TouchDataset(Dataset[tuple[Tensor, Tensor, Tensor]]):
    """Labelled samples as tensors of fixed sizes, which are kept in memory.

    Args:
        samples: Such as `foretouch.open(path)` or a part of it; those without a touch are left out.
        points: Of each cloud, the same ones whenever it is asked for; clouds with fewer repeat some.
        seed: Draws them, alike for each cloud.

    Shapes of an item:
        points (N, 3) float32 [m] and grasp (15,) float32, g1, g2 [m] and the rotation row by row, in the frame of the camera;
        touch (D,) float32, in the unit of the sensor.

    Raises:
        DatasetError: If no sample is labelled, or a cloud has no finite point.
    """

    def __init__(self, samples: Iterable[Sample], points: int = 1024, seed: int = 0) -> None:
        self._items: list[tuple[Tensor, Tensor, Tensor]] = []
        for sample in samples:
            if sample.touch is None:
                continue
            xyz = sample.cloud.finite
            if not len(xyz):
                raise DatasetError(f"{sample.id}: cloud: has no finite point")
            grasp = np.concatenate([sample.grasp.g1, sample.grasp.g2, sample.grasp.rotation.ravel()])
            chosen = xyz[sample_indices(len(xyz), points, np.random.default_rng(seed))]
            parts = (torch.from_numpy(np.asarray(part, np.float32)) for part in (chosen, grasp, sample.touch.values))
            self._items.append((next(parts), next(parts), next(parts)))
        if not self._items:
            raise DatasetError("samples: none is labelled")

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor, Tensor]:
        return self._items[index]
