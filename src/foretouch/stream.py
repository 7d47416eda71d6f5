# SPDX-License-Identifier: Apache-2.0
"""The clouds of one camera in their order: what `Pipeline` answers for each, and what is remembered from one to the next.

Objects keep their ids, the target stays the target among equal ones, an object that a person has selected stays the target, and
the best grasp of an object is kept until another one is clearly better. The nodes answer their clouds through this class.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy.typing as npt

from foretouch.cloud.segmentation.identity import ObjectIdentity
from foretouch.cloud.timing import timed
from foretouch.config import Settings, setting
from foretouch.errors import CloudError, ConfigError, ModelError, require_type
from foretouch.grasp import GraspHold, GraspPlan
from foretouch.models import History
from foretouch.pipeline import Pipeline, PipelineConfig, PipelineResult, TargetResult, require_object
from foretouch.types import Cloud, Float64
from foretouch.types.arrays import objects
from foretouch.types.scene import Object, Scene
from foretouch.types.summary import Summarised, briefly

SELECTED: Final = "selected"
"""Flag of predictions on an object that a person selected, and start of the reason."""

_NO_CONFIG: Final = 'not a StreamConfig, such as StreamConfig().updated({"grasp.count": 3}, "mine")'
_GONE: Final = 30  # clouds in a row without the selected object, after which it is forgotten: 1 s at 30 Hz
_HOLD_TOLERANCE_M: Final = 0.005
"""Change of position or size that makes it another object, whose grasp is not kept."""


@dataclass(frozen=True, kw_only=True)
class HoldConfig(Settings):
    """Settings of the grasps that are kept."""

    grasp_hold: float = setting(
        0.5,
        "The last grasp of an object is kept until another is better by this score on three clouds in a row; "
        "0 disables it, as grasp.method original",
        bounds=(0.0, 1000.0),
    )


@dataclass(frozen=True, kw_only=True, repr=False)
class StreamConfig(PipelineConfig, HoldConfig):
    """Settings of a stream: of all steps, and of the grasps that are kept."""


class Stream(Summarised):
    """Answers the clouds of one camera, each once and in their order. Use it in one thread at a time.

    Args:
        config: Settings; the defaults if None.
        history: Readings of the hand, to which predictions are adapted. `history.touched` and `history.tare` add to it
            between two clouds.

    Attributes:
        config: The current settings; `configure` changes them.
        pipeline: Runs the steps.
        history: Readings of the hand.
        selected: Id of the object that stays the target; "" leaves it to the rule of `target`.
        note: What became of the selection; "" without one.
    """

    def __init__(self, config: StreamConfig | None = None, history: History | None = None) -> None:
        require_type(config, StreamConfig | None, "config", _NO_CONFIG, ConfigError)
        require_type(history, History | None, "history", "not a History", ModelError)
        self.config = StreamConfig() if config is None else config
        self.pipeline = Pipeline(self.config)
        self.history = history
        self.selected = self.note = ""
        self._missing = 0  # clouds in a row without the selected object
        self._identity = ObjectIdentity()
        self._previous: Float64 | None = None  # (3,) centroid of the last single target [m]
        self._held = GraspHold(_HOLD_TOLERANCE_M)

    def _summary(self) -> tuple[str, dict[str, str]]:
        return self.note or "no object is selected", {
            "config": briefly(self.config),
            "history": "" if self.history is None else briefly(self.history),
        }

    def configure(self, config: StreamConfig) -> None:
        """Use other settings, and forget only what followed from those that changed.

        Another `target` ends the selection. Other settings of planner or hand end the grasps that are kept. Ids stay.
        """
        require_type(config, StreamConfig, "config", _NO_CONFIG, ConfigError)
        before, self.config, self.pipeline.config = self.config, config, config
        if config.target != before.target:
            self.select("")
            self._previous = None
        planning = [(one.grasp, one.hand, one.object, one.limits, one.grasp_hold) for one in (before, config)]
        if planning[0] != planning[1] or before.hand.hand is not config.hand.hand:  # its file may have been edited
            self._held = GraspHold(_HOLD_TOLERANCE_M)

    def select(self, object_id: str) -> None:
        """Make an object the target until it is gone; "" leaves the choice to the rule of `target`."""
        require_type(object_id, str, "object_id", "not the id of an object, which is a text", CloudError)
        self.selected, self._missing = object_id, 0
        self.note = f"object {object_id}" if object_id else ""

    def answer(self, cloud: Cloud, *, mask: npt.ArrayLike | None = None) -> PipelineResult:
        """Answer the next cloud, from the objects in it to predicted touch.

        Args:
            cloud: Of the whole scene.
            mask: Labels of the objects, as in `Pipeline.segment`.

        Raises:
            CloudError: As `Pipeline.segment`.
        """
        ms: dict[str, float] = {}
        with timed(ms, "segment"):
            scene = self.with_target(self.find(cloud, mask=mask))
        with timed(ms, "grasp"):
            plans = self.plan(scene.targets)
        results = []
        with timed(ms, "touch"):
            stamp_ns = cloud.stamp_ns or None
            for target, plan in zip(scene.targets, plans, strict=True):
                read = None if self.history is None else self.history.at(stamp_ns, target)
                results.append(TargetResult(target, plan, self.pipeline.predict(target, plan.grasps, history=read)))
        return PipelineResult.of(scene, results, ms)

    def find(self, cloud: Cloud, *, mask: npt.ArrayLike | None = None) -> Scene:
        """Find the objects of the next cloud with their ids; the targets are those of the rule.

        Args:
            cloud: Of the whole scene.
            mask: As in `Pipeline.segment`.

        Raises:
            CloudError: As `Pipeline.segment`.
        """
        return self.pipeline.segment(cloud, self._previous, self._identity, mask=mask)

    def with_target(self, scene: Scene) -> Scene:
        """Make the selected object the only target of the scene of `find`, as long as it is there, and remember the target."""
        require_type(scene, Scene, "scene", "not a Scene, such as `find` returns", CloudError)
        scene = self._selected_in(scene)
        self._previous = scene.targets[0].centroid if len(scene.targets) == 1 else None
        return scene

    def plan(self, targets: Sequence[Object]) -> list[GraspPlan]:
        """Plan grasps on all targets of a cloud, in their order, and keep the best of the cloud before.

        Args:
            targets: Objects of one cloud.

        Returns:
            The plans; each grasp has an id made of the stamp of its cloud, the object and its rank.
        """
        pipeline, hold = self.pipeline, self.config.grasp_hold
        held = self._held if hold > 0.0 and self.config.grasp.method == "completed" else None
        require_type(
            targets, Sequence, "targets", "not the objects of a cloud, such as those in scene.targets", CloudError
        )
        plans = []
        for target in targets:
            require_object(target)
            plan = pipeline.plan(target, held=held.find(target.cloud) if held else None, hold=hold)
            if held is not None and plan.grasps:
                held.remember(target.cloud, (plan.grasps[0], plan.outdone))
            plans.append(named(plan, target))
        if held is not None:
            held.next_cloud()
        return plans

    def _selected_in(self, scene: Scene) -> Scene:
        if not self.selected:
            return scene
        chosen = next((object_ for object_ in scene.objects if object_.id == self.selected), None)
        if chosen is not None:
            self._missing = 0
            flagged = replace(chosen, flags=(SELECTED,))
            return replace(scene, status="ok", reason=f"{SELECTED}: object {chosen.id} was clicked", targets=(flagged,))
        self._missing += 1
        if self._missing > _GONE:
            gone = self.selected
            self.select("")
            self.note = f"object {gone} is gone; the rule of `target` selects again"
            return scene
        if scene.status not in ("ok", "no_target"):  # what is wrong with the cloud comes first
            return scene
        return replace(scene, status="no_target", reason=f"{SELECTED}: object {self.selected} is not seen", targets=())


def named(plan: GraspPlan, target: Object, request: str = "") -> GraspPlan:
    """Return a plan whose grasps have ids: stamp of the cloud, object, rank, and what distinguishes a request.

    Args:
        plan: The plan.
        target: The object that it is for.
        request: Name of the request; "" for the grasps of a stream.
    """
    end = f"/{request}" if request else ""
    names = [f"{target.cloud.stamp_ns}/{target.id}/{rank}{end}" for rank in range(len(plan.grasps))]
    return replace(plan, grasps=plan.grasps.replace(id=objects(names)))
