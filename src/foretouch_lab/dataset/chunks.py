# SPDX-License-Identifier: Apache-2.0
"""Samples that the nodes of a Ray cluster make in chunks, in a folder that all of them share.

    FOLDER/plan.json       what decides the samples
    FOLDER/chunk-00000/    a training store each, with its number: complete, with the hashes of its files, or absent

What is in a chunk depends on the plan and its number alone. A node returns no samples, but writes them; so nothing is lost
with a node but the chunks that it was making, and the same call later makes only those that are missing.
"""

import json
import os
import shutil
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from foretouch.dataset.store import Store
from foretouch.errors import DatasetError, FileError, ForetouchError
from foretouch.files import read_json, system_errors, write_text
from foretouch.tactile.description import Sensor
from foretouch.types import GraspSample
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.ray_cluster import ray_results

CHUNK_SAMPLES: Final = 512
PLAN: Final = "plan.json"

#: Writes the samples of a range with the function that it is given, and returns facts on them for the chunk's manifest.
MakeSamples = Callable[[range, Callable[[GraspSample], None]], Mapping[str, Any]]


def chunks_folder(out: Path) -> Path:
    """Where the chunks of a store are, beside it, until it is complete."""
    return out.with_name(f"{out.name}.chunks")


def remove_chunks(out: Path) -> None:
    """Remove the chunks of a store that is complete; whatever else is in a folder of their name is kept."""
    folder = chunks_folder(out)
    for plan in [*folder.glob(f"*/{PLAN}"), *folder.glob(PLAN)]:
        shutil.rmtree(plan.parent, ignore_errors=True)
    with suppress(OSError):
        folder.rmdir()


def made_in_chunks(
    folder: Path,
    plan: Mapping[str, Any],
    count: int,
    make: MakeSamples,
    address: str,
    workers: int,
    progress: Callable[[int], None] = lambda _: None,
    sensor: Sensor | None = None,
) -> Iterator[Store]:
    """Make the chunks that are missing, then open all of them in order.

    Args:
        folder: Where they are kept; every node must see it at this path. The caller removes it.
        plan: What decides the samples, in plain types; a folder of another plan is refused.
        count: Number of samples.
        make: A function of a module, or `partial` of one, that depends on the plan alone.
        address: Of the cluster; and cores of a local one (see `ray_results`).
        workers: As of `ray_results`.
        progress: Called with the number of samples of each chunk that is there.
        sensor: Of the readings, as of `StoreWriter`.

    Raises:
        FileError: If the folder holds chunks of another plan, a chunk is not there, or the disk fails.
        DatasetError: If a chunk could not be made; the others are kept.
        ConfigError, MissingDependencyError: As `ray_results`.
    """
    _require_plan(folder, plan)
    slots = {
        k: range(k * CHUNK_SAMPLES, min((k + 1) * CHUNK_SAMPLES, count)) for k in range(-(-count // CHUNK_SAMPLES))
    }
    missing = [k for k in slots if not _is_whole(folder, k)]
    for k in slots.keys() - missing:
        progress(len(slots[k]))
    errors = {}
    if missing:
        for (k, _), _, error in ray_results(
            partial(_make_chunk, folder, make, sensor=sensor), [(k, slots[k]) for k in missing], address, workers
        ):
            if error:
                errors[k] = error
            else:
                progress(len(slots[k]))
    if errors:
        raise DatasetError(
            f"{folder}: {len(errors)} of {len(slots)} chunks could not be made; chunk {min(errors)}: {errors[min(errors)]}"
        )
    for k in slots:
        yield Store(_chunk(folder, k))


def _chunk(folder: Path, number: int) -> Path:
    return folder / f"chunk-{number:05d}"


def _require_plan(folder: Path, plan: Mapping[str, Any]) -> None:
    path, wanted = folder / PLAN, json.loads(json.dumps(plan))
    with system_errors(folder, "cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            write_text(path, json.dumps(wanted, indent=1))
    found = read_json(path)
    if found != wanted:
        differs = sorted(key for key in wanted if not isinstance(found, dict) or found.get(key) != wanted[key])
        raise FileError(path, f"is of other samples ({', '.join(differs)}); remove {folder} to make these")


def _is_whole(folder: Path, number: int) -> bool:
    """Whether a chunk is there with the hashes of its manifest.

    One that is damaged, or is that of another number, is removed, and what is not a folder is refused.
    """
    path = _chunk(folder, number)
    if not os.path.lexists(path):
        return False
    if path.is_symlink() or not path.is_dir():
        raise FileError(path, "is a link or no folder, and is in the way of a chunk")
    with suppress(ForetouchError):
        if Store(path).manifest.get("about", {}).get("chunk") == number:
            return True
    with system_errors(path, "is damaged, and cannot be removed"):
        shutil.rmtree(path)
    return False


def _make_chunk(folder: Path, make: MakeSamples, chunk: tuple[int, range], sensor: Sensor | None = None) -> str:
    """Make one chunk on a node; gives its name. If a node that seemed lost made it too, both are equal."""
    number, slots = chunk
    path = _chunk(folder, number)
    if not folder.is_dir():
        raise DatasetError(f"node {socket.gethostname()} does not see {folder}, which all nodes must share")
    own = path.with_name(f"{path.name}-{socket.gethostname()}-{os.getpid()}")
    with StoreWriter(own, sensor=sensor) as writer:
        writer.about.update(make(slots, writer.write), chunk=number)
    with suppress(OSError):  # the other was earlier
        own.rename(path)
    shutil.rmtree(own, ignore_errors=True)
    return path.name
