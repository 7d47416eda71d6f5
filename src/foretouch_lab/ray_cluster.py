# SPDX-License-Identifier: Apache-2.0
"""Run a function as tasks of a Ray cluster; what a lost node was running runs again on another one."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from typing import Any, Final, TypeVar

from foretouch import __version__
from foretouch.base.processes import ONE_THREAD
from foretouch.errors import ConfigError, ForetouchError, MissingDependencyError, described

LOCAL_CLUSTER: Final = "local"  # address that starts a Ray node on this machine

DIED: Final = "its process died (killed, or out of memory)"

_RETRIES: Final = 3
_AHEAD: Final = 2  # tasks a core that are handed to the cluster
_LOOK_S: Final = 10.0  # without a result until the head is asked for; after a minute without one Ray ends this process

_Item = TypeVar("_Item")


def ray_results(
    function: Callable[[_Item], Any], items: Sequence[_Item], address: str, workers: int
) -> Iterator[tuple[_Item, Any, str]]:
    """Call a function with each item, one task of one core each, and yield results as they arrive.

    Args:
        function: Of a module, or `partial` of one, which every node can import; returns small plain data.
        items: Plain data.
        address: `auto`, `ray://host:port` or `host:port` of a running cluster; `local` starts a node on this machine.
        workers: Cores of that node.

    Yields:
        The item, its result, and the error in one line: "" without an error; with one, no result.

    Raises:
        MissingDependencyError: If ray is not installed.
        ConfigError: If no cluster answers, or it was lost.
    """
    try:
        import ray
    except ImportError as err:
        raise MissingDependencyError("ray is not installed: pip install 'foretouch[sweep]'") from err
    _require_server(address)
    try:
        # Without an address, Ray would use RAY_ADDRESS.
        own: dict[str, Any] = {"num_cpus": workers, "include_dashboard": False} if address == LOCAL_CLUSTER else {}
        ray.init(address=address, log_to_driver=False, **own)
    except (ray.exceptions.RayError, ConnectionError, ImportError, ValueError, RuntimeError) as err:
        raise ConfigError(f"--address: {address}: {' '.join(str(err).split())}") from err
    has_head = True
    try:
        head = "" if address.startswith("ray://") else ray.get_runtime_context().gcs_address  # a client notices itself
        task = ray.remote(num_cpus=1, max_retries=_RETRIES, runtime_env={"env_vars": ONE_THREAD})(outcome)
        waiting = list(reversed(items))
        running: dict[Any, _Item] = {}
        while waiting or running:
            limit = _AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
            while waiting and len(running) < limit:
                item = waiting.pop()
                running[task.remote(function, item, __version__)] = item
            with redirect_stdout(sys.stderr):  # Ray, in its own thread, reports nodes that are lost
                finished, _ = ray.wait(list(running), num_returns=1, timeout=_LOOK_S)
            if not finished:
                has_head = False
                _require_server(head)
                has_head = True
            for done in finished:
                item = running.pop(done)
                try:
                    yield item, *ray.get(done)
                except ray.exceptions.RayError as err:
                    yield item, None, f"{DIED}: {type(err).__name__}, {_RETRIES + 1} times"
    except (ray.exceptions.RayError, ConnectionError) as err:
        raise ConfigError(f"--address: {address}: the cluster was lost: {' '.join(str(err).split())[:200]}") from err
    finally:
        if has_head:  # without one, Ray would wait for it, and end this process before the error is reported
            with redirect_stdout(sys.stderr):
                ray.shutdown()


def outcome(function: Callable[[_Item], Any], item: _Item, version: str = __version__) -> tuple[Any, str]:
    """Return in another process the result and no error, or none and the error in one line.

    `version` is the version of foretouch in the process that asks.
    """
    if version != __version__:
        return None, f"node {socket.gethostname()} has foretouch {__version__}, not {version}"
    try:
        return function(item), ""
    except ForetouchError as err:
        return None, str(err)
    except Exception as err:  # noqa: BLE001 - a defect in one task must not end the others; it is reported
        return None, described(err)


def _require_server(address: str) -> None:
    """Fail at once where Ray would retry for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon:
        return
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=10.0):
            return
    except (OSError, ValueError, OverflowError) as err:
        raise ConfigError(f"--address: {address}: no cluster answers: {err}") from err
