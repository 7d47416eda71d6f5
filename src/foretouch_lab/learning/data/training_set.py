# SPDX-License-Identifier: Apache-2.0
"""Samples prepared once for a network; the points of each cloud are drawn again for every batch.

Prepared clouds are on the disk: clouds of a large dataset exceed memory, and an epoch uses them in any order.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foretouch.base.files import open_regular, system_errors
from foretouch.cloud.geometry.sampling import UnitSphereFrame, sample_indices
from foretouch.errors import CloudError, DatasetError, ModelError
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.preparation import (
    SAMPLER_SEED,
    finite_points,
    grasp_lengths,
    prepare_cloud,
    prepare_grasps,
    sample_channels,
)
from foretouch.tactile import TOUCH_SIZE, touch_faults
from foretouch.tactile.description import require_same
from foretouch.types import Float32, Float64, Integer, Sample
from foretouch.types.channels import Channels
from foretouch_lab.learning.data.folds import Indices


class CloudFile(Sequence[Float32]):
    """Clouds (N_i, C) float32 in a temporary file without a name, which is removed with the last process that reads it.

    They are read, not mapped: the pages of a mapping count as memory of the process. A pickle of it is for processes of
    this machine while this one lives.

    Raises:
        FileError: If the folder of temporary files (`TMPDIR`) has no room.
    """

    def __init__(self) -> None:
        with system_errors(Path("TMPDIR"), "names no folder that can be written"):
            self._folder = Path(tempfile.gettempdir())
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  open as long as this object
        weakref.finalize(self, self._file.close)
        self._ends = [0]  # in values
        self._columns = 0

    def append(self, cloud: Float32) -> None:
        """Write one more cloud, of the same C."""
        with system_errors(self._folder, "cannot hold the prepared clouds; set TMPDIR to a folder with more space"):
            rest = np.ascontiguousarray(cloud).data.cast("B")
            while rest:
                rest = rest[self._file.write(rest) :]
        self._ends.append(self._ends[-1] + cloud.size)
        self._columns = cloud.shape[1]

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __getitem__(self, index: Any) -> Any:
        """Return one cloud, read-only; slices are not supported."""
        k = range(len(self))[index]
        start, end = self._ends[k : k + 2]
        content = os.pread(self._file.fileno(), 4 * (end - start), 4 * start)
        return np.frombuffer(content, np.float32).reshape(-1, self._columns)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_file": f"/proc/{os.getpid()}/fd/{self._file.fileno()}"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update({**state, "_file": open_regular(state["_file"])})
        weakref.finalize(self, self._file.close)


if TYPE_CHECKING:
    from foretouch_lab.learning.network.networks import TouchNet


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Inputs and labels of S samples, prepared for one network configuration."""

    clouds: Sequence[Float32]  # (N_i, C) float32 of each sample in the unit sphere: all points, not yet sampled
    grasps: Float32  # (S, G) float32, as fed to the head
    labels: Float64  # (S, D) float64 [counts]; NaN for an unlabelled sample
    lengths: Float64  # (S, 5) float64 [m], for the range check of the card
    config: ModelConfig  # the network configuration

    @classmethod
    def build(cls, samples: Sequence[Sample], config: ModelConfig, *, unlabelled: bool = False) -> TrainingSet:
        """Prepare samples.

        Args:
            samples: In the order that indices refer to.
            config: The network configuration.
            unlabelled: Whether samples without a label are accepted.

        Raises:
            DatasetError: If there is no sample, a label is missing or is not a reading of a working sensor, or a cloud
                is unusable or lacks a channel of the network; names the sample.
            FileError: If the prepared clouds cannot be kept in the folder of temporary files (see `CloudFile`).
        """
        if not samples:
            raise DatasetError("training set: no sample")
        missing = np.full(TOUCH_SIZE, np.nan)
        labels = [missing if unlabelled and sample.touch is None else _label(sample) for sample in samples]
        clouds = CloudFile()
        grasps = []
        lengths = []
        for sample in samples:
            points, grasp, length = _prepared(sample, config)
            clouds.append(points)
            grasps.append(grasp)
            lengths.append(length)
        return cls(clouds, np.array(grasps), np.array(labels), np.array(lengths), config)

    def __len__(self) -> int:
        return len(self.clouds)

    def points(self, index: Integer, rng: np.random.Generator, n_points: int | None = None) -> Float32:
        """Return (B, n, C) float32: points of the chosen clouds, drawn by `rng`; n is by default the configuration's."""
        count = self.config.n_points if n_points is None else n_points
        chosen = [self.clouds[i] for i in index]
        return np.stack([c[sample_indices(len(c), count, rng)] for c in chosen])


def labels_of(samples: Sequence[Sample]) -> Float64:
    """Return (S, D) float64 labels [counts]; a `DatasetError` names a sample without one, or with a broken sensor's."""
    return np.array([_label(sample) for sample in samples])


def channels_of(samples: Sequence[Sample]) -> Channels:
    """Return the channels of the touches of labelled samples; a `TactileError` names one of another sensor, a `DatasetError` if none is labelled."""
    touches = [(sample.id, sample.touch) for sample in samples if sample.touch is not None]
    if not touches:
        raise DatasetError("no sample is labelled")
    channels = touches[0][1].channels
    for name, touch in touches:
        require_same(touch.channels, channels, f"{name}: touch")
    return channels


def _prepared(sample: Sample, config: ModelConfig) -> tuple[Float32, Float32, Float64]:
    """Return all points, the grasp and the lengths of one sample."""
    try:
        usable = finite_points(sample.cloud, config)
        frame = UnitSphereFrame.fit(usable.xyz)
        points = sample_channels(usable, np.arange(usable.size), frame, config)
        # On the points that prediction will choose: the gap to the nearest point depends on their number.
        lengths = grasp_lengths(prepare_cloud(sample.cloud, config), [sample.grasp])[0]
        return points, prepare_grasps([sample.grasp], frame, config)[0], lengths
    except (CloudError, ModelError) as err:
        raise DatasetError(f"{sample.id}: {err}") from err


def _label(sample: Sample) -> Float64:
    if sample.touch is None:
        raise DatasetError(f"{sample.id}: touch: is not labelled")
    if faults := touch_faults(sample.touch):
        raise DatasetError(f"{sample.id}: touch: {faults[0]}")
    return sample.touch.values


def predict_set(net: TouchNet, data: TrainingSet, index: Indices) -> Float64:
    """Return (T, M) predictions [counts] of some samples, each on the points that prediction chooses.

    Args:
        net: The network.
        data: Samples prepared for it.
        index: (T,) samples to predict.
    """
    import torch

    device = net.target_mean.device
    grasps = torch.from_numpy(data.grasps).to(device) if data.config.use_grasp else None
    rows = []
    for i in index:
        row = np.array([i])
        points = torch.from_numpy(data.points(row, np.random.default_rng(SAMPLER_SEED))).to(device)
        grasp = None if grasps is None else grasps[row]
        with torch.inference_mode():
            rows.append(net.counts(points, grasp))
    return torch.cat(rows).cpu().numpy().astype(np.float64)
