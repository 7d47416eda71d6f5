# SPDX-License-Identifier: Apache-2.0
"""Reads meshes with Open3D in a process of its own, which a damaged file may end; `read` asks it.

Each question is a line `SUFFIX SIZE` and the content of a file, each answer a line with a size and an .npz of `vertices`
(V, 3) float64 and `faces` (F, 3) int64. The process stays, since Open3D takes a second or more to be imported.
"""

import io
import os
import resource
import subprocess
import sys
import threading
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from foretouch.camera.libusb import ensure_libusb
from foretouch.errors import SimulationError
from foretouch.types import Float64, Int64

_MEMORY: Final = 2_000_000_000  # bytes beyond what the imports take
_PATIENCE_S: Final = 120.0  # for one mesh

_lock = threading.Lock()
_processes: list[subprocess.Popen[bytes]] = []  # the one that answers


def read(suffix: str, content: bytes) -> tuple[Float64, Int64]:
    """Vertices and faces of a mesh, none where it has none, from a file's content and the suffix of its name.

    Raises:
        SimulationError: If the process ended by it, or took too long.
    """
    with _lock:
        if not _processes or _processes[0].poll() is not None:
            command = [sys.executable, "-c", f"from {__name__} import serve; serve()"]
            pipe = subprocess.PIPE  # in a session of its own, which Ctrl-C does not reach
            _processes[:] = [subprocess.Popen(command, stdin=pipe, stdout=pipe, start_new_session=True)]  # noqa: S603
        process = _processes[0]
        timer = threading.Timer(_PATIENCE_S, process.kill)
        timer.start()
        try:
            assert process.stdin is not None  # noqa: S101
            assert process.stdout is not None  # noqa: S101
            process.stdin.write(f"{suffix} {len(content)}\n".encode() + content)
            process.stdin.flush()
            answer = process.stdout.read(int(process.stdout.readline()))
        except (OSError, ValueError) as err:
            process.kill()
            raise SimulationError(f"is damaged: it ended Open3D (exit status {process.wait()})", "mesh") from err
        finally:
            timer.cancel()
    with np.load(io.BytesIO(answer)) as arrays:
        return arrays["vertices"], arrays["faces"]


def serve() -> None:
    """Answer until the end of standard input."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # for what the libraries print
    ensure_libusb()
    import open3d

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _MEMORY, used + _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    while question := sys.stdin.buffer.readline().decode().split():
        with TemporaryDirectory(prefix="foretouch-mesh-") as folder:  # nothing that the file names is in it
            path = Path(folder, f"mesh{question[0]}")
            path.write_bytes(sys.stdin.buffer.read(int(question[1])))
            found = open3d.io.read_triangle_mesh(path)
        faces = np.asarray(found.triangles, np.int64)
        if len(faces) and 0 <= faces.min() <= faces.max() < len(found.vertices):  # or the next calls read elsewhere
            found.remove_duplicated_vertices()
            found.remove_degenerate_triangles()
            found.remove_duplicated_triangles()
            found.remove_unreferenced_vertices()
            faces = np.asarray(found.triangles, np.int64)
        answer = io.BytesIO()
        np.savez(answer, vertices=np.asarray(found.vertices, np.float64), faces=faces)
        output.write(f"{answer.tell()}\n".encode() + answer.getvalue())
        output.flush()
