# SPDX-License-Identifier: Apache-2.0
"""Runs nodes in this process and writes when each received, began and computed each cloud: `traced.py FILE NODE... --ros-args ...`."""

import json
import sys
import threading
import time
from pathlib import Path
from typing import Any

COLUMNS = ("node", "stamp_ns", "received_ns", "began_ns", "computed_ns", "computed_cpu_ns")


class Trace:
    """A row of `COLUMNS` for each cloud and node; times on the clock of the stamps."""

    def __init__(self) -> None:
        self.rows: list[tuple[Any, ...]] = []
        self._received: dict[tuple[str, int], int] = {}
        self._computed = threading.local()  # by a thread for its current cloud: `wall` and `cpu` [ns]

    def install(self) -> None:
        """Measure around the methods that receive, answer and compute."""
        from foretouch.models.touch_model import TouchModel
        from foretouch.pipeline import Pipeline
        from foretouch.ros.runtime.processing_node import ProcessingNode
        from foretouch.tactile.messages.table import stamp_ns

        receive, work = ProcessingNode._receive, ProcessingNode._work  # noqa: SLF001  what is measured

        def traced_receive(node: Any, topic: str, message: Any) -> None:
            self._received[node.get_name(), stamp_ns(message.header.stamp)] = time.time_ns()  # the last one counts
            receive(node, topic, message)

        def traced_work(node: Any, job: Any) -> None:
            began, key = time.time_ns(), (node.get_name(), stamp_ns(next(iter(job.messages.values())).header.stamp))
            self._computed.wall = self._computed.cpu = 0
            work(node, job)
            self.rows.append((*key, self._received.pop(key, began), began, self._computed.wall, self._computed.cpu))

        ProcessingNode._receive, ProcessingNode._work = traced_receive, traced_work  # noqa: SLF001
        for owner, name in ((Pipeline, "segment"), (Pipeline, "plan"), (TouchModel, "predict")):
            setattr(owner, name, self._timed(getattr(owner, name)))

    def _timed(self, function: Any) -> Any:
        def timed(*arguments: Any, **options: Any) -> Any:
            wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
            result = function(*arguments, **options)
            if hasattr(self._computed, "wall"):  # else it is of no cloud
                self._computed.wall += time.perf_counter_ns() - wall
                self._computed.cpu += time.thread_time_ns() - cpu
            return result

        return timed


def main() -> int:
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()
    from foretouch.ros.executables import run

    end, trace = sys.argv.index("--ros-args"), Trace()
    trace.install()
    try:
        return run(*sys.argv[2:end], args=[sys.argv[0], *sys.argv[end:]])
    finally:  # not at exit, where a library that does not end would lose it
        Path(sys.argv[1]).write_text(json.dumps([dict(zip(COLUMNS, row, strict=True)) for row in trace.rows]))


if __name__ == "__main__":
    sys.exit(main())
