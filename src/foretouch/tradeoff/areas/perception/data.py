# SPDX-License-Identifier: Apache-2.0
"""Clouds with known objects: generated scenes, and where recordings are given, shared scenes and real objects."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from foretouch.cloud.io.files import read_cloud
from foretouch.config import setting
from foretouch.errors import ConfigError
from foretouch.simulation.depth_scene import FIRST_OBJECT, random_scene
from foretouch.simulation.solids import Primitive
from foretouch.simulation.view import CameraView
from foretouch.tradeoff.area import TradeoffSettings
from foretouch.types import Cloud

_NOISE_M = 0.001  # standard deviation of the depth at 1 m
_SHARED = ("oblique_848x480.npz", "oblique_1280x720.npz")
_REAL = "vision2tactile/*/*/cloud-object.pcd"


@dataclass(frozen=True, kw_only=True)
class PerceptionSettings(TradeoffSettings):
    """Settings of the area `perception`."""

    scenes: int = setting(40, "Number of generated scenes of three objects", minimum=2, maximum=1000)
    real: int = setting(60, "Number of real objects, if recordings are given", minimum=0, maximum=1000)
    detail: str = setting("all", "few: the main settings; all: all settings and pairs", choices=("few", "all"))
    moved_mm: float = setting(5.0, "A best grasp has moved if a contact is farther from before", unit="mm", minimum=0.1)


@dataclass(frozen=True, eq=False)
class LabelledScene:
    """A cloud and the truth about it."""

    cloud: Cloud  # (H, W, 3)
    labels: npt.NDArray[np.int32]  # (H, W), 2 and on are the objects
    solids: tuple[Primitive, ...] = ()  # the objects in the world, in order of their labels; none if unknown
    view: CameraView | None = None  # the camera in the world

    @property
    def object_labels(self) -> range:
        """Labels of the objects."""
        return range(FIRST_OBJECT, int(self.labels.max()) + 1)


@dataclass(frozen=True, eq=False)
class PerceptionData:
    """What settings are measured on."""

    scenes: tuple[LabelledScene, ...]
    real: tuple[Cloud, ...]  # an object each
    sha256: str


def prepare(settings: PerceptionSettings, source: Path | None, out: Path) -> Path:
    """The folder of recordings if there is one; scenes are generated.

    Raises:
        ConfigError: If the given path is no folder.
    """
    del settings, out
    if source is not None and not source.is_dir():
        raise ConfigError(f"--data: {source}: is no folder of recordings")
    return Path() / "no recordings" if source is None else source


def load(settings: PerceptionSettings, path: Path) -> PerceptionData:
    """Render the scenes, and read what the folder holds."""
    scenes = [generate(seed) for seed in range(settings.scenes)]
    for name in _SHARED:
        if (path / "scenes" / name).is_file():
            with np.load(path / "scenes" / name) as shared:
                scenes.append(LabelledScene(Cloud(shared["xyz"]), shared["labels"].astype(np.int32)))
    found = sorted(path.glob(_REAL))
    chosen = np.linspace(0, len(found) - 1, min(settings.real, len(found))).astype(int)
    real = tuple(Cloud(read_cloud(found[k]).xyz.reshape(-1, 3)) for k in chosen)
    content = hashlib.sha256()
    for cloud in (*(scene.cloud for scene in scenes), *real):
        content.update(np.ascontiguousarray(cloud.xyz).tobytes())
    return PerceptionData(tuple(scenes), real, content.hexdigest())


def generate(seed: int) -> LabelledScene:
    """Three boxes, cans or balls, 848x480, with depth noise and flying pixels."""
    rng = np.random.default_rng(seed)
    scene = random_scene(rng)
    image = scene.render(rng, _NOISE_M, True)
    return LabelledScene(image.cloud(), image.labels, scene.objects, scene.view)
