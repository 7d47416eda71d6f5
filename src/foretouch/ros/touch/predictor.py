# SPDX-License-Identifier: Apache-2.0
"""Predictions as messages, in the same way for the topic, the service and the action."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from std_msgs.msg import Header

from foretouch.errors import CloudError, ForetouchError, GraspError, ModelError
from foretouch.grasp import GeoGraspConfig, closing_faults
from foretouch.grasp.messages import has_orientation
from foretouch.models import TouchModel, load_model
from foretouch.models.equal_pressure import flag_equal_pressures
from foretouch.pipeline import Object, Pipeline
from foretouch.ros.messages.answers import TouchAnswer
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.ros.messages.requests import GraspArrays, RefusalError, status_name
from foretouch.ros.runtime.processing_node import warm_up_cloud
from foretouch.ros.touch.config import TouchSettings
from foretouch.ros.touch.online_adapter import OnlineAdapter
from foretouch.ros.touch.posing import posed_grasps, refusal_of
from foretouch.tactile.description import Sensor
from foretouch.types import Grasps, Predictions
from foretouch.types.channels import NO_CHANNELS, Channels
from foretouch_msgs.msg import Grasp as GraspMsg
from foretouch_msgs.msg import Status


class Predictor:
    """A model that may be absent: every answer then gives the reason. `fallback` is used if it cannot be loaded."""

    def __init__(self, model: str, fallback: str = "") -> None:
        self.model: TouchModel | None = None  # None if neither could be loaded
        self.adapter: OnlineAdapter | None = None  # adapts predictions to tactile readings; None for vision alone
        self.fault = ""  # why `model` could not be loaded
        self.flags: tuple[str, ...] = ()  # of every prediction
        try:
            self.model = load_model(model)
        except ForetouchError as err:
            self.fault = f"model: {err}"
        if self.model is None and fallback:
            try:
                self.model, self.flags = load_model(fallback), ("fallback_model",)
            except ForetouchError as err:
                self.fault = f"{self.fault}; fallback_model: {err}"
        if self.model is not None:  # predict once, so that the first real cloud does not wait for torch
            pipeline = Pipeline()
            for target in pipeline.segment(warm_up_cloud()).targets:
                self.model.predict(target, pipeline.plan(target).grasps)

    @property
    def sensor(self) -> Sensor | None:
        """Sensor of the model, whose readings are predicted."""
        return None if self.model is None else self.model.sensor

    @property
    def channels(self) -> Channels:
        """Channels of the sensor; without a model none."""
        return NO_CHANNELS if self.sensor is None else self.sensor.channels

    def answer(
        self,
        targets: Sequence[Object],
        grasps: Sequence[GraspMsg] | GraspArrays,
        header: Header,
        config: TouchSettings,
        posing: GeoGraspConfig | None = None,
    ) -> TouchAnswer:
        """Predict or refuse every grasp, in order.

        Args:
            targets: The objects; features are computed once for each that has grasps.
            grasps: Messages, each on the object that it names, or on the only one; or arrays, which are all on one.
            header: Header of the cloud.
            config: The limits of objects and the hand's reach.
            posing: Settings to compute missing orientations with, on the target's table; None refuses such grasps.

        Raises:
            RefusalError: If none of the targets is the object of arrays.
        """
        channels, sensor = self.channels, self.sensor
        if isinstance(grasps, GraspArrays):
            try:
                target = targets[_target_of(grasps.object_id, targets)]
            except GraspError as err:
                raise RefusalError(Status.BAD_GRASP, str(err)) from err
            posed = posed_grasps(grasps, target, config, posing, channels)
            rotations = None
            if grasps.rotations is None:
                rotations = np.where(posed.ok[:, None, None], posed.grasps.rotation, 0.0)
            rows = self.predict(target, posed, config)
            return TouchAnswer(header, rows.grasps, rows, sensor=sensor, arrays=True, rotations=rotations)
        rows = Predictions.refused(Grasps.unknown(len(grasps)), channels, "bad_grasp", "")
        by_target: dict[int, list[int]] = {}
        for i, grasp in enumerate(grasps):
            try:
                by_target.setdefault(_target_of(grasp.object_id, targets), []).append(i)
            except GraspError as err:
                rows.reason[i] = str(err)
        for k, members in by_target.items():
            posed = posed_grasps([grasps[i] for i in members], targets[k], config, posing, channels)
            rows = rows.put(members, self.predict(targets[k], posed, config))
        if posing is not None:
            grasps = [_as_predicted(grasp, rows, k) for k, grasp in enumerate(grasps)]
        return TouchAnswer(header, grasps, rows, sensor=sensor)

    def predict(self, target: Object, posed: Predictions, config: TouchSettings) -> Predictions:
        """Predict for the grasps on one object, where `posed` is ok and no other reason to refuse is found.

        Readings so far are adapted to.
        """
        model = self.model
        if model is None:
            return Predictions.refused(posed.grasps, posed.channels, "no_model", self.fault)
        usable = posed.ok
        if not usable.any():
            return posed
        options: dict[str, Any] = {"limits": config.limits, "reach": config, "table": target.plane}
        grasps = posed.grasps if usable.all() else posed.grasps.take(usable)
        try:
            if self.adapter is not None:
                predictions = self.adapter.predict(target.cloud, grasps, **options)
            else:
                predictions = model.predict(target.cloud, grasps, **options)
        except (CloudError, ModelError) as err:
            status, reason = refusal_of(err)
            return posed.put(usable, Predictions.refused(grasps, posed.channels, status_name(status), reason))
        predictions = flag_equal_pressures(predictions, model)
        faults = closing_faults(grasps)
        tilted = np.array([bool(fault) for fault in faults], np.bool_) & predictions.ok
        if tilted.any():  # the constructor of a message makes w = 1, which is an orientation
            reasons = [fault for fault, refused in zip(faults, tilted.tolist(), strict=True) if refused]
            refused = Predictions.refused(grasps.take(tilted), posed.channels, "bad_grasp", reasons)
            predictions = predictions.put(tilted, refused)
        return predictions if usable.all() else posed.put(usable, predictions)


def _as_predicted(message: GraspMsg, predictions: Predictions, k: int) -> GraspMsg:
    """The message of a grasp, with the pose that was computed for it."""
    if not predictions[k].ok or has_orientation(message):
        return message
    return grasp_to_msg(predictions[k].grasp, message.status, message.reason)


def _target_of(object_id: str, targets: Sequence[Object]) -> int:
    """Index of a grasp's target; a single target matches if it or the grasp has no object id."""
    ids = [target.id for target in targets]
    if object_id in ids:
        return ids.index(object_id)
    if len(ids) == 1 and (not object_id or not ids[0]):
        return 0
    raise GraspError(f"object_id: {object_id!r} is not one of {', '.join(map(repr, ids)) or 'the objects'}")
