# SPDX-License-Identifier: Apache-2.0
"""Depth images of generated scenes with their truth: the object of each pixel, and what a simulated hand reads in any grasp.

Each image shows a can, a box or a ball among others (config/scenes/chain.yaml). The hand takes this first object alone. A
grasp holds if both fingertips meet the true surface, where its slope is within the cone of friction, and carry the weight
there (`foretouch_lab.simulation.effects.grasp`). Whether the fingers meet other objects on their way is not known.
"""

import hashlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from foretouch.config import setting
from foretouch.errors import SimulationError
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.types import AnyArray, Cloud, Float64, Grasp, Int32, Touch
from foretouch.types.scene import Object, Scene
from foretouch_lab import simulation
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.tradeoff import TradeoffSettings
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig, drawn_weights
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT, RenderedFrame
from foretouch_lab.simulation.effects import grasp, reading, view
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.scene_camera import FrameMaker
from foretouch_lab.simulation.world import CAMERA_FRAME, SampleKey

FOUND: Final = 0.6  # IoU from which an object is found: an F of 0.75
TIMED: Final = 8  # images that are timed in turn
HARD: Final = {
    "clutter": {"count": 3, "touching": {}},
    "camera": {"noise": {}, "stereo": {}, "flying_pixels": {}, "holes": {}},
}
"""Changes to the scene: the other objects touch the first one or each other, and the camera has all faults."""

_SCENE: Final = Path(simulation.__file__).parent / "scenes" / "chain.yaml"
_FEWEST_PX: Final = 300  # of an object that counts


@dataclass(frozen=True, kw_only=True)
class SceneSettings(TradeoffSettings):
    """Settings of the areas that measure on generated scenes."""

    scenes: int = setting(200, "Number of generated images", bounds=(2, 10_000))


@dataclass(frozen=True, eq=False)
class TouchedScenes:
    """Images of the first slots of a scene for which clutter finds a place."""

    scene: SceneConfig
    depths: AnyArray  # (N, H, W) uint16 [mm], 0 without depth
    labels: AnyArray  # (N, H, W) int32: 0 none or floor, 1 table, 2 the first object, 3 and on the others
    slots: tuple[int, ...]  # of each image

    @classmethod
    def render(cls, count: int, changes: Mapping[str, Any] | None = None) -> Self:
        """Render images of the scene, with changed settings."""
        scene = load_scene(_SCENE).updated(changes or {})
        maker, images, slot = FrameMaker(scene), dict[int, RenderedFrame](), 0
        while len(images) < count:
            with suppress(SimulationError):  # no place for clutter
                images[slot] = maker.frame(slot)
            slot += 1
        depths, labels = (np.stack([getattr(one, name) for one in images.values()]) for name in ("depth_mm", "labels"))
        return cls(scene, depths, labels, tuple(images))

    def first(self, count: int) -> Self:
        """Return the first images alone."""
        return replace(self, depths=self.depths[:count], labels=self.labels[:count], slots=self.slots[:count])

    def __len__(self) -> int:
        return len(self.slots)

    @cached_property
    def sha256(self) -> str:
        """Hash of the scene and its images."""
        return hashlib.sha256(self.scene.sha256().encode() + self.depths.tobytes()).hexdigest()

    @cached_property
    def _hand(self) -> Engine:
        """What executes a grasp that is given."""
        return Engine(self.scene, (*view.PLACING, *grasp.EFFECTS[1:], *reading.EFFECTS))

    def pipeline(self, changes: Mapping[str, Any]) -> Pipeline:
        """Return the pipeline for the scene's hand, with changed settings."""
        return Pipeline(
            PipelineConfig().updated(
                {"hand.name": self.scene.hand, "hand.thumb_at": "g1", "target.mode": "all", **changes}
            )
        )

    def cloud(self, number: int, stride: int = 1) -> Cloud:
        """Return an image as a camera of every n-th row and column gives it."""
        depth = np.ascontiguousarray(self.depths[number, ::stride, ::stride])
        matrix = self._hand.world.view.matrix / stride
        return Cloud.from_depth(depth, (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]), frame_id=CAMERA_FRAME)

    def overlaps(self, number: int, labels: Int32, stride: int = 1) -> list[float]:
        """Return the intersection over union of each true object with the found one that covers it most.

        Args:
            number: Of the image; objects that show few pixels do not count.
            labels: (H, W) labels of a segmentation, objects from 1 on.
            stride: Of its rows and columns.
        """
        counts, truth = np.bincount(self.labels[number].ravel()), self.labels[number, ::stride, ::stride]
        return [
            overlap(labels, truth == label) for label in range(FIRST_OBJECT, len(counts)) if counts[label] >= _FEWEST_PX
        ]

    def wanted(self, number: int, scene: Scene, stride: int = 1) -> Object | None:
        """Return which object of a segmented scene is the first one of an image; None where it was not found."""
        true = self.labels[number, ::stride, ::stride] == FIRST_OBJECT
        labels = scene.labels.reshape(true.shape)
        if overlap(labels, true) < FOUND:
            return None
        chosen = np.bincount(labels[true], minlength=2)[1:].argmax()
        place = np.flatnonzero(labels == 1 + chosen)
        return next((one for one in scene.objects if np.isin(one.pixels[0], place)), None)

    def read(self, number: int, chosen: Grasp) -> tuple[Touch, Touch] | None:
        """Return what both fingers read in a grasp of the first object of an image, and before it; None if it does not hold."""
        try:
            state = self._hand.run(SampleKey(self.scene.seed, self.slots[number]), grasp=chosen)
        except SimulationError:
            return None
        return None if state.tare is None else (state.touch, state.tare)


def overlap(labels: Int32, true: AnyArray) -> float:
    """Return the intersection over union of a true object (H, W) with the label, from 1 on, that covers it most."""
    if not true.any():
        return 0.0
    covering = labels == 1 + int(np.bincount(labels[true], minlength=2)[1:].argmax())
    return float((true & covering).sum() / (true | covering).sum())


def share(sums: Float64) -> Float64:
    """Return the ratio of the first to the second of sums (..., 2)."""
    return np.asarray(sums[..., 0] / np.maximum(sums[..., 1], 1.0), np.float64)


def drawn_rows(
    skill: str, sums: Mapping[str, Float64], value: Callable[[Float64], Float64], bootstrap: BootstrapConfig
) -> dict[str, Row]:
    """Return columns of a skill by variant, as an area needs them, with intervals of 95 % by drawing scenes.

    Args:
        skill: Name of the column.
        sums: By variant (S, C) float64, sums of each of the same S scenes.
        value: Sums (..., C) of scenes to their skill (...).
        bootstrap: Number of draws; variants are compared in the same draws.
    """
    weights = drawn_weights(len(next(iter(sums.values()))), bootstrap)
    whole = {name: float(value(own.sum(axis=0))) for name, own in sums.items()}
    drawn = {name: value(weights @ own) for name, own in sums.items()}
    best = max(whole, key=lambda name: whole[name])
    result: dict[str, Row] = {}
    for name, own in drawn.items():
        low, high = np.percentile(own, (2.5, 97.5)).tolist()
        equal = name == best or float(np.percentile(drawn[best] - own, 2.5)) <= 0.0
        ends = {f"{skill}_low": low, f"{skill}_high": high, f"{skill}_equals": best if equal else None}
        result[name] = {skill: whole[name], **ends}
    return result
