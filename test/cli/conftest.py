# SPDX-License-Identifier: Apache-2.0
"""A scene and one of its objects, as files, and a way to call commands."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_answer import Answer
from process_domain import process_environment

from benchmarks.random_scenes import random_scene
from foretouch.cli.main import main
from foretouch.cloud.io.files import write_cloud


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    def run(*words: object) -> Answer:
        status = main([str(word) for word in words])
        captured = capsys.readouterr()
        return Answer(status, captured.out, captured.err)

    return run


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`scene.npz`, organised, with two objects; `object.pcd`, the first of them alone; `empty.npz`."""
    folder = tmp_path_factory.mktemp("files")
    image = random_scene(np.random.default_rng(3), width=424, height=240, n_objects=2).render()
    cloud = image.cloud()
    write_cloud(folder / "scene.npz", cloud)
    write_cloud(folder / "object.pcd", cloud.take(image.labels == 2))
    np.savez(folder / "empty.npz", xyz=np.full((4, 5, 3), np.nan, np.float32))
    return folder


@pytest.fixture
def environment() -> dict[str, str]:
    """Of a process in a DDS domain of its own."""
    return process_environment()
