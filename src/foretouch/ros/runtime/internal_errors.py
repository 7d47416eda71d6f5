# SPDX-License-Identifier: Apache-2.0
"""Keeps an internal error in a callback from ending the process: it is counted, logged and answered.

rclpy passes an error in a callback on to the executor, which ends, and with it all nodes of the process. `ForetouchNode` passes
timers and services through `InternalErrors.guarded`, and inputs report theirs; `spin_on` goes on after all other errors.
"""

import functools
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.executors import Executor, ExternalShutdownException

from foretouch.errors import described, raised_at
from foretouch.ros.runtime.diagnostics import Report


class InternalErrors:
    """Counts and logs the internal errors of one node. Thread-safe.

    Args:
        log: Called with a line for the first error of a callback, and then for the tenth, the hundredth, and so on.
    """

    def __init__(self, log: Callable[[str], object]) -> None:
        self._log = log
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._reported: Counter[str] = Counter()  # those in the reports so far

    def counts(self) -> Counter[str]:
        """Copy the number of errors by callback."""
        with self._lock:
            return Counter(self._counts)

    def report(self, name: str, err: Exception) -> str:
        """Count and log an error of a callback.

        Args:
            name: Of the callback.
            err: The error.

        Returns:
            Its type and text in one line, the reason for an answer with FAILED.
        """
        reason = described(err)[:300]
        with self._lock:
            self._counts[name] += 1
            count = self._counts[name]
        if str(count).rstrip("0") == "1":
            self._log(f"{name}: internal error {count}: {reason}{raised_at(err)}")
        return reason

    def add_to(self, report: Report) -> None:
        """Report all counts, and those since the last report as warnings."""
        counts = self.counts()
        report.warnings += [f"{count} internal errors in {name}" for name, count in (counts - self._reported).items()]
        report.values |= {f"internal_errors.{name}": str(count) for name, count in counts.items()}
        self._reported = counts

    def guarded(
        self,
        name: str,
        callback: Callable[..., Any],
        answer: Callable[[tuple[Any, ...], str], Any] = lambda _arguments, _reason: None,
    ) -> Callable[..., Any]:
        """Make a function that reports its errors instead of raising them.

        Args:
            name: By which errors are counted.
            callback: The function.
            answer: Gives what is returned after an error, from the arguments of the call and the reason.
        """

        @functools.wraps(callback)
        def _run(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as err:  # noqa: BLE001  it would end the process
                return answer(arguments, self.report(name, err))

        return _run


def spin_on(executor: Executor, errors: InternalErrors, until: Callable[[], bool], poll_s: float) -> None:
    """Spin until a condition holds, through errors in the executor itself, such as an answer that cannot be encoded.

    Args:
        executor: Serves the nodes.
        errors: Counts and logs the errors.
        until: The condition.
        poll_s: Time between two looks at it [s].

    Raises:
        ExternalShutdownException: If the context is shut down.
    """
    while not until():
        try:
            executor.spin_once(timeout_sec=poll_s)
        except ExternalShutdownException:
            raise
        except Exception as err:
            if not executor.context.ok():
                raise ExternalShutdownException from err
            errors.report("executor", err)
            time.sleep(0.01)


def failed_response(arguments: tuple[Any, ...], reason: str) -> Any:
    """Make the response of a service after an internal error.

    Args:
        arguments: The request and the response so far.
        reason: Put into the response where it has a field for it.
    """
    request, response = arguments
    refused = SetParametersResult(successful=False, reason=reason)
    if isinstance(request, SetParameters.Request):  # some may have been set before the error
        missing = len(request.parameters) - len(response.results)
        response.results = [*response.results, *[refused] * missing]
        return response
    answer = type(response)()
    if isinstance(request, SetParametersAtomically.Request):
        answer.result = refused
    elif hasattr(answer, "success") and hasattr(answer, "message"):
        answer.success, answer.message = False, reason
    return answer
