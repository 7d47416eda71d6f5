# SPDX-License-Identifier: Apache-2.0
"""Show a Rerun recording in a window, or draw it to a picture.

Rerun is started with its usage statistics turned off, in its own configuration folder, and listens on 127.0.0.1 alone.
"""

import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from foretouch.errors import ForetouchError, MissingDependencyError
from foretouch.files import open_own, read_bytes, replace_files

_SCREENSHOT_S: Final = 120.0
_POLL_S: Final = 0.1
_NO_GRAPHICS: Final = ("No graphics adapter", "Failed to get render context")  # what Rerun prints without a driver


def save_screenshot(recording: Path, path: Path) -> None:
    """Draw the first step of a Rerun recording to a PNG, without a window.

    A `ForetouchError` if the file cannot be written, Rerun draws nothing, or it or a graphics driver (Vulkan) is absent.
    """
    with _viewer_environment() as environment, tempfile.TemporaryDirectory(prefix="foretouch-view-") as folder:
        printed, drawn = Path(folder) / "printed.txt", Path(folder) / "drawn.png"
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = int(free.getsockname()[1])
        command = [*_viewer(port), "--headless", "--window-size", "1600x1000", recording]
        with os.fdopen(open_own(printed, os.O_WRONLY), "wb") as output:
            viewer = subprocess.Popen(command, env=environment, stdout=output, stderr=output)  # noqa: S603  Rerun's own
        try:
            _draw(viewer, port, drawn)
        finally:
            viewer.kill()
            viewer.wait()
        if not drawn.is_file():
            said = read_bytes(printed).decode("utf-8", "replace")
            if any(text in said for text in _NO_GRAPHICS):
                raise MissingDependencyError(
                    "--screenshot: Rerun finds no graphics driver (Vulkan): apt install libvulkan1 mesa-vulkan-drivers"
                )
            raise ForetouchError(f"--screenshot: Rerun has drawn nothing within {_SCREENSHOT_S:.0f} s")
        replace_files({path: read_bytes(drawn)})


def _draw(viewer: subprocess.Popen[bytes], port: int, path: Path) -> None:
    """Wait until a viewer has loaded its recording, and let it draw; without a file if it ended or took too long."""
    from rerun.experimental import ViewerClient

    end = time.monotonic() + _SCREENSHOT_S
    client: ViewerClient | None = None
    while viewer.poll() is None and time.monotonic() < end:
        with suppress(RuntimeError, ConnectionError, ValueError):  # until it answers
            client = client or ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            state = client.get_state()
            if state.active_recording is not None and state.recordings[0].timelines and not state.loading:
                client.set_time("step", sequence=0, play_state="paused")
                time.sleep(5.0)  # until all is drawn, and the viewer's note at its start is gone
                client.save_screenshot(str(path))
                return
        time.sleep(_POLL_S)


def open_viewer(recording: Path) -> None:
    """Show a Rerun recording in a window, and wait until it is closed.

    A `ForetouchError` if Rerun is not installed, or the viewer ends with an error, as it does without a display.
    """
    with _viewer_environment() as environment:
        done = subprocess.run(  # noqa: S603  Rerun's own viewer
            [*_viewer(), recording], env=environment, stderr=subprocess.PIPE, text=True, errors="replace", check=False
        )
    if done.returncode:
        cause = next(iter(done.stderr.strip().splitlines()), "no message")
        raise ForetouchError(f"Rerun cannot open a window ({cause}): write a file with --save F.rrd instead")


def _viewer(port: int | None = None) -> list[str | Path]:
    """Return the command that starts Rerun's viewer, which else would listen on all addresses."""
    module = find_spec("rerun_cli")
    if module is None or module.origin is None:
        raise MissingDependencyError("Rerun is not installed: pip install 'foretouch[view]'")
    return [Path(module.origin).with_name("rerun"), "--bind", "127.0.0.1", "--port", str(port or "auto")]


@contextmanager
def _viewer_environment() -> Iterator[dict[str, str]]:
    """Set variables with which Rerun sends no usage statistics; the settings of the user stay as they are."""
    with tempfile.TemporaryDirectory(prefix="foretouch-rerun-") as folder:
        environment = {**os.environ, "XDG_CONFIG_HOME": folder, "XDG_DATA_HOME": folder, "RERUN_APP_ONLY": "true"}
        done = subprocess.run(  # noqa: S603  Rerun's own viewer
            [_viewer()[0], "analytics", "disable"], env=environment, capture_output=True, check=False, timeout=30.0
        )
        if done.returncode:
            raise ForetouchError("Rerun cannot turn its usage statistics off, so it is not started")
        yield environment
