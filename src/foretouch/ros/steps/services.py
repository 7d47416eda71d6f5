# SPDX-License-Identifier: Apache-2.0
"""What planners ask for: the service `predict_touch`, the actions that sample grasps, and forgetting readings.

Requests are answered in threads, which their callbacks await as coroutines, beside the worker that answers the topic: the model is
immutable and serves all of them.
"""

import asyncio
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from typing import Any, Final, TypeVar

from rclpy.action.server import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from std_srvs.srv import Trigger

from foretouch.errors import quoted
from foretouch.ros.messages.requests import RefusalError, RequestedGrasps, requested_targets, status_code, status_name
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.lifecycle_node import REQUESTS, ForetouchNode
from foretouch.ros.runtime.processing_node import Step
from foretouch.ros.steps.online_adapter import OnlineAdapter
from foretouch.ros.steps.sampling import (
    PLANNER_ACTION,
    PLANNER_COUNT,
    PLANNER_TYPE,
    planner_action_class,
    planner_feedback,
    sample_grasps,
)
from foretouch.ros.steps.touch import TouchStep
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Status, TouchPredictionArray, TouchPredictionBatch
from foretouch_msgs.srv import PredictTouch

_T = TypeVar("_T")


_THREADS: Final = 2  # more would only share the processor
_LIMIT: Final = 100  # requests that may wait or be worked on


class TouchServices(Step):
    """Offers services and actions.

    Args:
        node: Offers them; it must be configuring, and its settings are `TouchSettings`.
        step: Predicts.
    """

    def __init__(self, node: ForetouchNode[Any], step: TouchStep) -> None:
        self._node, self._step = node, step
        self._requests: Counter[str] = Counter()  # by name and status
        self._threads, self._waiting = ThreadPoolExecutor(_THREADS, thread_name_prefix=node.get_name()), 0
        node.closing.callback(partial(self._threads.shutdown, cancel_futures=True))
        group = ReentrantCallbackGroup()
        node.serve(PredictTouch, "predict_touch", self._predict_touch, group)
        node.serve(Trigger, "forget_touches", partial(self._forget, OnlineAdapter.forget, "touches"), group)
        node.serve(Trigger, "forget_history", partial(self._forget, OnlineAdapter.forget_history, "readings"), group)
        self._offer(SampleGrasps, "sample_grasps", self._sample_grasps)
        self._planner_action, self._planner_fault = planner_action_class()
        if self._planner_action is not None:
            self._offer(self._planner_action, PLANNER_ACTION, self._sample_poses)

    def diagnose(self, report: Report) -> None:
        """Report requests by name and status, and why the action of MoveIt is not offered although its package is there."""
        report.values |= {f"requests.{name}": str(count) for name, count in dict(self._requests).items()}
        if self._planner_action is not None:
            report.values[PLANNER_ACTION] = "/".join(PLANNER_TYPE)
        if self._planner_fault:
            report.warnings.append(self._planner_fault)

    def _forget(self, forget: Callable[[OnlineAdapter], int], what: str, _request: Any, response: Any) -> Any:
        count = forget(self._step.adapter) if self._step.adapter else 0
        response.success, response.message = True, f"{count} {what} forgotten"
        return response

    async def _do(self, name: str, work: Callable[[], _T]) -> _T | RefusalError:
        """Answer a request in a thread, and count its outcome; an internal error is reported and becomes a refusal.

        Only for callbacks in a reentrant callback group: another group is busy while its callback waits.
        """
        try:
            answer: _T | RefusalError = await self._in_thread(work)
        except RefusalError as refusal:
            answer = refusal
        except Exception as err:  # noqa: BLE001  it would end the process
            answer = RefusalError(Status.FAILED, self._node.internal_errors.report(name, err))
        outcome = answer.status if isinstance(answer, RefusalError) else Status.OK
        self._requests[f"{name}.{status_name(outcome).lower()}"] += 1
        return answer

    async def _in_thread(self, work: Callable[[], _T]) -> _T:
        if self._waiting >= _LIMIT:
            raise RefusalError(status_code("busy"), f"busy: {_LIMIT} requests wait already: ask again later")
        self._waiting += 1
        try:
            future = self._threads.submit(work)
            future.add_done_callback(self._wake)
            while not future.done():  # noqa: ASYNC110  the executor goes on below when it is woken
                await asyncio.sleep(0)
            return future.result()
        finally:
            self._waiting -= 1

    def _wake(self, _: object) -> None:
        if self._node.executor is not None:
            self._node.executor.wake()

    # The service.

    async def _predict_touch(self, request: Any, response: Any) -> Any:
        answer = await self._do("predict_touch", partial(self._answer_request, request))
        if isinstance(answer, RefusalError):
            refused = {"header": request.cloud.header, "status": answer.status, "reason": answer.reason}
            response.touch, response.batch = TouchPredictionArray(**refused), TouchPredictionBatch(**refused)
        elif isinstance(answer, TouchPredictionBatch):
            response.batch = answer
        else:
            response.touch = answer
        return response

    def _answer_request(self, request: Any) -> TouchPredictionArray | TouchPredictionBatch:
        config, step = self._node.config, self._step
        if len(request.contacts) or len(request.rotations):
            requested = RequestedGrasps.of_arrays(request)
        else:
            requested = RequestedGrasps.of_messages(request.grasps)
        count = len(requested.grasps)
        if count > config.max_grasps:
            raise RefusalError(Status.BAD_REQUEST, f"grasps: {count} is above max_grasps, {config.max_grasps}")
        ids = sorted(grasp.id for grasp in request.grasps if grasp.id)
        if twice := [first for first, second in pairwise(ids) if first == second]:
            raise RefusalError(Status.BAD_REQUEST, f"grasps: id {quoted(twice[0])} occurs twice")
        targets = requested_targets(request, step.latest, config.limits, step.frames.placement)
        if not count:
            raise RefusalError(Status.BAD_REQUEST, "grasps: is empty: send grasps, or contacts")
        posing = config.grasp if targets.refusal is None else None
        answer = step.answer(targets, requested.moved(targets.answered_in.back), posing)
        step.add_requested(targets, answer.answered)  # not before: it may have been executed already
        return answer.placed(targets.answered_in).reply

    # The actions.

    def _offer(self, kind: Any, name: str, work: Callable[[Any], Any]) -> None:
        """Make the server of an action, whose goals are worked on in a thread; one that is refused or fails is aborted."""

        async def execute(goal_handle: Any) -> Any:
            answer = await self._do(name, partial(work, goal_handle))
            refused = isinstance(answer, RefusalError)
            if goal_handle.is_cancel_requested:
                goal_handle.canceled()
            elif refused:
                goal_handle.abort()
            else:
                goal_handle.succeed()
            if not refused:
                return answer
            result = kind.Result(grasp_state=f"{status_name(answer.status)}: {answer}")
            if hasattr(result, "status"):  # MoveIt's has none
                result.status = answer.status
            return result

        server = ActionServer(
            self._node,
            kind,
            name,
            execute,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
            goal_service_qos_profile=REQUESTS,
            result_service_qos_profile=REQUESTS,
            cancel_service_qos_profile=REQUESTS,
        )
        self._node.closing.callback(server.destroy)

    def _sample_grasps(self, goal_handle: Any) -> Any:
        """Answer a goal of `sample_grasps`."""
        goal, feedback = goal_handle.request, goal_handle.publish_feedback
        return sample_grasps(self._step, self._node.config, goal, goal_handle, feedback)

    def _sample_poses(self, goal_handle: Any) -> Any:
        """Answer a goal of MoveIt Task Constructor on the latest objects."""
        config = self._node.config
        goal = SampleGrasps.Goal(
            action_name=goal_handle.request.action_name, count=min(PLANNER_COUNT, config.max_grasps)
        )
        sampled = sample_grasps(self._step, config, goal, goal_handle, lambda _: None)
        goal_handle.publish_feedback(planner_feedback(self._planner_action, sampled))
        return self._planner_action.Result(grasp_state="success")
