# SPDX-License-Identifier: Apache-2.0
"""What planners ask for: the service `predict_touch`, the actions that sample grasps, and forgetting readings.

Requests are answered in threads (see `ThreadPool`), beside the worker that answers the topic: the model is immutable and serves
all of them.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from foretouch.errors import quoted
from foretouch.models.equal_pressure import predicted_pressures
from foretouch.pipeline import Object
from foretouch.ros.messages.requests import RefusalError, read_arrays, requested_targets, status_name
from foretouch.ros.runtime.lifecycle_node import REQUESTS, ForetouchNode
from foretouch.ros.runtime.processing_node import Step
from foretouch.ros.runtime.workers import ThreadPool
from foretouch.ros.steps.touch import TouchStep
from foretouch.ros.touch.grasp_actions import (
    PLANNER_ACTION,
    PLANNER_TYPE,
    Predicted,
    planner_action_class,
    planner_feedback,
    planner_goal,
    planner_result,
    refused_goal,
    sample_grasps,
)
from foretouch.ros.touch.online_adapter import OnlineAdapter
from foretouch.types import UNKNOWN_FRAME
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, Status, TouchPredictionArray, TouchPredictionBatch
from foretouch_msgs.srv import PredictTouch

_T = TypeVar("_T")


class TouchServices(Step):
    """Services and actions of a node, which predict by its `TouchStep`."""

    def __init__(self, node: ForetouchNode[Any], step: TouchStep) -> None:
        self._node, self._step = node, step
        self._requests: Counter[str] = Counter()  # by name and status
        self._threads = ThreadPool(node, 2, 100)  # more threads would only share the processor
        node.closing.callback(self._threads.close)
        group = ReentrantCallbackGroup()
        node.serve(PredictTouch, "predict_touch", self._predict_touch, group)
        node.serve(Trigger, "forget_touches", partial(self._forget, OnlineAdapter.forget, "touches"), group)
        node.serve(Trigger, "forget_history", partial(self._forget, OnlineAdapter.forget_history, "readings"), group)
        self._offer(SampleGrasps, "sample_grasps", self._sample_grasps, refused_goal)
        self._planner_action, self._planner_fault = planner_action_class()
        if self._planner_action is not None:
            refused = partial(planner_result, self._planner_action)
            self._offer(self._planner_action, PLANNER_ACTION, self._sample_poses, refused)

    def warnings(self) -> tuple[str, ...]:
        """Why the action of MoveIt Task Constructor is not offered although its package is there."""
        return (self._planner_fault,) if self._planner_fault else ()

    def notes(self) -> dict[str, str]:
        """Numbers of requests by name and status."""
        counts = {f"requests.{name}": str(count) for name, count in dict(self._requests).items()}
        return counts | ({PLANNER_ACTION: "/".join(PLANNER_TYPE)} if self._planner_action is not None else {})

    def _offer(self, kind: Any, name: str, work: Callable[[Any], Any], failure: Callable[[RefusalError], Any]) -> None:
        """Make the server of an action, whose goals are worked on in a thread; one with an internal error is aborted."""
        server = ActionServer(
            self._node,
            kind,
            name,
            partial(self._execute, name, work, failure),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
            goal_service_qos_profile=REQUESTS,
            result_service_qos_profile=REQUESTS,
            cancel_service_qos_profile=REQUESTS,
        )
        self._node.closing.callback(server.destroy)

    def _forget(self, forget: Callable[[OnlineAdapter], int], what: str, _request: Any, response: Any) -> Any:
        count = forget(self._step.adapter) if self._step.adapter else 0
        response.success, response.message = True, f"{count} {what} forgotten"
        return response

    async def _do(self, name: str, work: Callable[[], _T]) -> _T:
        """Answer a request in a thread, and count its outcome."""
        outcome = Status.FAILED
        try:
            answer = await self._threads.run(work)
            outcome = Status.OK
        except RefusalError as refusal:
            outcome = refusal.status
            raise
        finally:
            self._requests[f"{name}.{status_name(outcome).lower()}"] += 1
        return answer

    def _frame_flags(self, header: Header) -> tuple[str, ...]:
        """The flag of a request whose cloud is in a frame that is not that of the graph's clouds."""
        latest = self._step.latest
        return () if latest is None or header.frame_id == latest.header.frame_id else (UNKNOWN_FRAME,)

    # The service.

    async def _predict_touch(self, request: Any, response: Any) -> Any:
        try:
            answer = await self._do("predict_touch", partial(self._answer_request, request))
        except RefusalError as refusal:
            status, reason = refusal.status, refusal.reason
        except Exception as err:  # noqa: BLE001  the answer names the request's cloud
            status, reason = Status.FAILED, self._node.internal_errors.report("predict_touch", err)
        else:
            name = "batch" if isinstance(answer, TouchPredictionBatch) else "touch"
            setattr(response, name, answer)
            return response
        refused = {"header": request.cloud.header, "status": status, "reason": reason}
        response.touch, response.batch = TouchPredictionArray(**refused), TouchPredictionBatch(**refused)
        return response

    def _answer_request(self, request: Any) -> Any:
        config, step, latest = self._node.config, self._step, self._step.latest
        grasps = read_arrays(request) if len(request.contacts) or len(request.rotations) else request.grasps
        if len(grasps) > config.max_grasps:
            raise RefusalError(Status.BAD_REQUEST, f"grasps: {len(grasps)} is above max_grasps, {config.max_grasps}")
        ids = sorted(grasp.id for grasp in request.grasps if grasp.id)
        if twice := [first for first, second in pairwise(ids) if first == second]:
            raise RefusalError(Status.BAD_REQUEST, f"grasps: id {quoted(twice[0])} occurs twice")
        header, targets, on_table = requested_targets(request.cloud, request.table, latest, config.limits)
        if not grasps:
            raise RefusalError(Status.NO_GRASP, "grasps: is empty")
        message = step.answer(targets, grasps, header, config.grasp if on_table else None)
        message.flags += self._frame_flags(header)
        cloud = latest.message if latest is not None and header is latest.header else lambda: request.cloud
        step.add_requested(header, cloud, message.answered)  # not before: it may have been executed already
        return message.reply

    # The actions.

    async def _execute(
        self, name: str, work: Callable[[Any], Any], failure: Callable[[RefusalError], Any], goal_handle: Any
    ) -> Any:
        """The result of work on a goal, which then has succeeded, or was aborted or cancelled."""
        try:
            result = await self._do(name, partial(work, goal_handle))
            end = goal_handle.succeed
        except RefusalError as refusal:
            result, end = failure(refusal), goal_handle.abort
        except Exception as err:  # noqa: BLE001  it would end the process
            reason = self._node.internal_errors.report(name, err)
            result, end = failure(RefusalError(Status.FAILED, reason)), goal_handle.abort
        if goal_handle.is_cancel_requested:
            end = goal_handle.canceled
        end()
        return result

    def _sample_grasps(self, goal_handle: Any) -> Any:
        """Answer a goal of `sample_grasps`."""
        return self._sample(goal_handle, goal_handle.request, goal_handle.publish_feedback)

    def _sample_poses(self, goal_handle: Any) -> Any:
        """Answer a goal of MoveIt Task Constructor on the latest object."""
        goal = planner_goal(goal_handle.request, self._node.config.max_grasps)
        sampled = self._sample(goal_handle, goal, lambda _: None)
        goal_handle.publish_feedback(planner_feedback(self._planner_action, sampled))
        return planner_result(self._planner_action)

    def _sample(self, goal_handle: Any, goal: Any, feedback: Callable[[Any], None]) -> Any:
        """Sample grasps for a `SampleGrasps.Goal`."""
        latest, given = self._step.latest, goal.cloud.width * goal.cloud.height
        flags = self._frame_flags(goal.cloud.header) if given else ()
        result = sample_grasps(
            goal,
            latest,
            self._node.config,
            bytes(goal_handle.goal_id.uuid).hex()[:8],
            self._predict_candidates,
            feedback,
            lambda: goal_handle.is_cancel_requested,
        )
        for prediction in result.predictions:
            prediction.flags = [*prediction.flags, *flags]
        if given or latest is None:
            self._step.add_requested(goal.cloud.header, lambda: goal.cloud, result.grasps)
        else:
            self._step.add_requested(latest.header, latest.message, result.grasps)
        return result

    def _predict_candidates(self, target: Object, grasps: Sequence[Grasp], header: Header) -> Sequence[Predicted]:
        answer = self._step.answer([target], grasps, header, None)
        pressed = np.full((3, len(grasps), 1), np.nan)
        if (model := self._step.predictor.model) is not None:
            pressed = predicted_pressures(answer.predictions, model)
        return list(zip(answer.message.predictions, pressed.swapaxes(0, 1), strict=True))
