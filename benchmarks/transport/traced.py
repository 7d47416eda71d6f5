# SPDX-License-Identifier: Apache-2.0
"""Runs nodes as their executable does, and writes when each cloud passed them: `traced OUT NODE... --ros-args ...`."""

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
        self._current = threading.local()

    def install(self) -> None:
        """Measure around the methods that receive, answer and compute."""
        from foretouch.models.touch_model import TouchModel
        from foretouch.pipeline import Pipeline
        from foretouch.ros.runtime.processing_node import ProcessingNode

        self._wrap_node(ProcessingNode)
        for owner, name in ((Pipeline, "segment"), (Pipeline, "plan"), (TouchModel, "predict")):
            self._wrap_function(owner, name)

    def _wrap_node(self, owner: Any) -> None:
        receive, work = owner._receive, owner._work  # noqa: SLF001  what is measured

        def traced_receive(node: Any, topic: str, message: Any) -> None:
            stamp = message.header.stamp
            self._received[node.get_name(), stamp.sec * 10**9 + stamp.nanosec] = time.time_ns()  # the last one counts
            receive(node, topic, message)

        def traced_work(node: Any, job: Any) -> None:
            began, name = time.time_ns(), node.get_name()
            stamp = next(iter(job.messages.values())).header.stamp
            key = name, stamp.sec * 10**9 + stamp.nanosec
            self._current.wall = self._current.cpu = 0
            try:
                work(node, job)
            finally:
                self.rows.append((*key, self._received.pop(key, began), began, self._current.wall, self._current.cpu))
                self._current.__dict__.clear()

        owner._receive, owner._work = traced_receive, traced_work  # noqa: SLF001

    def _wrap_function(self, owner: Any, name: str) -> None:
        function = getattr(owner, name)

        def traced(*arguments: Any, **options: Any) -> Any:
            wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
            try:
                return function(*arguments, **options)
            finally:
                if hasattr(self._current, "wall"):
                    self._current.wall += time.perf_counter_ns() - wall
                    self._current.cpu += time.thread_time_ns() - cpu

        setattr(owner, name, traced)

    def write(self, path: Path) -> None:
        """Write the rows."""
        path.write_text(json.dumps([dict(zip(COLUMNS, row, strict=True)) for row in self.rows]), encoding="utf-8")


def main() -> int:
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()
    from foretouch.ros.executables import run

    end = sys.argv.index("--ros-args")
    trace = Trace()
    trace.install()
    try:
        return run(*sys.argv[2:end], args=[sys.argv[0], *sys.argv[end:]])
    finally:
        trace.write(Path(sys.argv[1]))  # not at exit, where a library that does not end would lose it


if __name__ == "__main__":
    sys.exit(main())
