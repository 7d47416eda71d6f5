# SPDX-License-Identifier: Apache-2.0
"""Predictions for the grasps of messages, in the same way for the topic, the service and the actions. No node."""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from foretouch.cloud.geometry.limits import check_object, check_table
from foretouch.errors import CloudError, ForetouchError, FrameError, GraspError, LimitError, ModelError
from foretouch.grasp import GeoGraspConfig, hand_rotation, object_axis
from foretouch.models import TouchModel, load_model
from foretouch.models.card import OWN
from foretouch.pipeline import Pipeline
from foretouch.ros.messages.answers import TouchAnswer
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.ros.messages.requests import RefusalError, RequestedGrasps, Targets, status_name
from foretouch.ros.runtime.processing_node import warm_up_cloud
from foretouch.ros.steps.online_adapter import OnlineAdapter
from foretouch.ros.steps.touch_settings import TouchSettings
from foretouch.tactile.description import Sensor
from foretouch.types import Float64, Grasps, Predictions
from foretouch.types.channels import NO_CHANNELS, Channels
from foretouch.types.scene import Object
from foretouch_msgs.msg import Status


class Predictor:
    """A model that may be absent: every answer then gives the reason.

    Args:
        model: Name or path of the model.
        fallback: Name or path of the model to use if it cannot be loaded; "" for none.
        predictor: Name of the predictor of a model of the user; "" for none.
    """

    def __init__(self, model: str, fallback: str = "", predictor: str = "") -> None:
        self.model: TouchModel | None = None  # None if neither could be loaded
        self.adapter: OnlineAdapter | None = None  # adapts predictions to tactile readings; None for vision alone
        self.fault = ""  # why `model` could not be loaded
        self.flags: tuple[str, ...] = ()  # of every prediction
        self.regime = ""  # what the latest prediction was adapted to, and whether its grasp resembles the training
        try:
            self.model = load_model(model, predictor or None)
        except ForetouchError as err:
            self.fault = f"model: {err}"
        if self.model is None and fallback:
            try:
                self.model, self.flags = load_model(fallback), ("fallback_model",)
            except ForetouchError as err:
                self.fault = f"{self.fault}; fallback_model: {err}"
        # Predict once, so that the first real cloud does not wait for torch; a predictor of the user has answered on loading.
        if self.model is not None and self.model.card.get("kind") != OWN:
            pipeline = Pipeline()
            for target in pipeline.segment(warm_up_cloud()).targets:
                with suppress(ForetouchError):  # each answer gives the reason
                    self.model.predict(target, pipeline.plan(target).grasps)

    @property
    def sensor(self) -> Sensor | None:
        """Sensor of the model, whose readings are predicted."""
        return None if self.model is None else self.model.sensor

    @property
    def channels(self) -> Channels:
        """Channels of the sensor; without a model none."""
        return NO_CHANNELS if self.model is None else self.model.sensor.channels

    def answer(
        self, targets: Targets, requested: RequestedGrasps, config: TouchSettings, posing: GeoGraspConfig | None = None
    ) -> TouchAnswer:
        """Predict or refuse every grasp, in order.

        Args:
            targets: The objects; features are computed once for each that has grasps.
            requested: The grasps, each on the object that it names, or on the only one.
            config: The limits of objects and the hand's reach.
            posing: Settings to compute missing orientations with, on the target's table; None refuses such grasps.
        """
        grasps, turned = requested.grasps, requested.turned
        refused = {k: ("bad_grasp", reason) for k, reason in enumerate(requested.reasons) if reason}
        by_target: dict[int, list[int]] = {}
        for k in range(len(grasps)):
            if k not in refused:
                try:
                    by_target.setdefault(_target_of(grasps.object_id[k], targets.objects), []).append(k)
                except GraspError as err:
                    refused[k] = "bad_grasp", str(err)
        parts = []
        for number, members in by_target.items():
            target, unturned = targets.objects[number], [k for k in members if not turned[k]]
            if unturned and self.model is not None:
                grasps, unposed = _posed(grasps, unturned, target, config, posing)
                refused |= unposed
            ready = [k for k in members if k not in refused]
            parts.append((ready, self.predict(target, grasps.take(ready), config)))
        left = list(refused)
        statuses, reasons = ([refusal[part] for refusal in refused.values()] for part in (0, 1))
        parts.append((left, Predictions.refused(grasps.take(left), self.channels, statuses, reasons)))
        order = np.argsort([k for members, _ in parts for k in members])
        rows = Predictions.join([part for _, part in parts]).take(order)
        if requested.messages is None:
            computed = None if turned.any() else np.where(rows.ok[:, None, None], rows.grasps.rotation, 0.0)
            return TouchAnswer(targets.header, rows.grasps, rows, sensor=self.sensor, arrays=True, rotations=computed)
        posed_now = rows.ok & ~turned
        messages = [
            grasp_to_msg(rows[k].grasp, message.status, message.reason) if posed_now[k] else message
            for k, message in enumerate(requested.messages)
        ]
        return TouchAnswer(targets.header, messages, rows, sensor=self.sensor)

    def predict(self, target: Object, grasps: Grasps, config: TouchSettings) -> Predictions:
        """Predict for the grasps on one object, adapted to the readings so far, or refuse all of them.

        Args:
            target: The object.
            grasps: With orientations.
            config: The limits of objects and the hand's reach.
        """
        model = self.model
        if model is None:
            return Predictions.refused(grasps, self.channels, "no_model", self.fault)
        if not grasps:
            return Predictions.refused(grasps, self.channels, "refused", "")
        try:
            read = None if self.adapter is None else self.adapter.readings_for(target.cloud)
            predictions = model.predict(target, grasps, history=read, limits=config.limits, reach=config)
        except (CloudError, ModelError) as err:
            return Predictions.refused(grasps, self.channels, *_refusal_of(err))
        new = "unfamiliar" in predictions.flags[0]
        self.regime = f"{predictions.reference[0]} ({'new' if new else 'known'})"
        return predictions


def _posed(
    grasps: Grasps, unturned: list[int], target: Object, config: TouchSettings, posing: GeoGraspConfig | None
) -> tuple[Grasps, dict[int, tuple[str, str]]]:
    """Compute the orientations of some of the grasps; status and reason of those without a possible one, by their number."""
    try:
        axis = _axis(target, config, posing)
    except ForetouchError as err:
        return grasps, dict.fromkeys(unturned, _refusal_of(err))
    rotation, refused = grasps.rotation.copy(), {}
    for k in unturned:
        try:
            rotation[k] = hand_rotation(grasps.g1[k], grasps.g2[k], axis)
        except GraspError as err:
            refused[k] = _refusal_of(err)
    return grasps.replace(rotation=rotation), refused


def _axis(target: Object, config: TouchSettings, posing: GeoGraspConfig | None) -> Float64:
    """Return (3,) the axis of an object, as `Pipeline.grasp_between` finds it."""
    if posing is None:
        raise GraspError("pose: no orientation, and no table to compute it with")
    check_object(target.cloud.xyz, config.limits)
    try:
        check_table(target.plane, config.limits, target.cloud.xyz)
    except LimitError as err:
        raise RefusalError(Status.BAD_PLANE, str(err)) from err
    return object_axis(target.cloud, target.plane, posing)[0]


def _refusal_of(err: ForetouchError) -> tuple[str, str]:
    """Name the status and the reason with which an error refuses a grasp."""
    if isinstance(err, RefusalError):
        return status_name(err.status), err.reason
    statuses = {
        FrameError: "unknown_frame",
        LimitError: "bad_cloud",
        CloudError: "too_few_points",
        GraspError: "bad_grasp",
    }
    return next((name for kind, name in statuses.items() if isinstance(err, kind)), "refused"), str(err)


def _target_of(object_id: str, targets: Sequence[Object]) -> int:
    """Index of a grasp's target; a single target matches if it or the grasp has no object id."""
    ids = [target.id for target in targets]
    if object_id in ids:
        return ids.index(object_id)
    if len(ids) == 1 and (not object_id or not ids[0]):
        return 0
    raise GraspError(f"object_id: {object_id!r} is not one of {', '.join(map(repr, ids)) or 'the objects'}")
