# SPDX-License-Identifier: Apache-2.0
"""What every test shares: where the recordings of others are, and a seed."""

import errno
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest


def pytest_configure() -> None:
    """Let signals reach the programs that tests start: in the background they are ignored, which programs inherit."""
    for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What a test expects of the recordings of others stands in the repository."""
    for item in items:
        if item.get_closest_marker("real_data"):
            item.add_marker("committed_numbers")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of FORETOUCH_DATA, or a skip with a reason."""
    folder = os.environ.get("FORETOUCH_DATA")
    if not folder:
        pytest.skip("FORETOUCH_DATA is not set: the recordings of others are not part of this repository")
    path = Path(folder)
    if not (path / "vision2tactile").is_dir():
        pytest.fail(f"FORETOUCH_DATA={path}: holds no vision2tactile folder")
    return path


@pytest.fixture(scope="session")
def reference(real_data: Path) -> Path:
    """Outputs of the original GeoGrasp on the real clouds."""
    path = real_data.parent / "reference"
    if not path.is_dir():
        pytest.skip(f"{path}: absent")
    return path


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], AbstractContextManager[None]]:
    """Within `with full_disk(NAME):`, files of this name and their temporary ones do not fit on the disk."""

    @contextmanager
    def full(name: str) -> Iterator[None]:
        def fsync(fd: int) -> None:
            written = Path(f"/proc/self/fd/{fd}").readlink().name
            if written == name or (written.startswith(f"{name}.") and written.endswith(".part")):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patched:
            patched.setattr(os, "fsync", fsync)
            yield

    return full


@pytest.fixture
def rng() -> np.random.Generator:
    """Seeded by FORETOUCH_TEST_SEED, 0 by default."""
    return np.random.default_rng(int(os.environ.get("FORETOUCH_TEST_SEED", "0")))


@pytest.fixture
def numbers(tmp_path: Path) -> Path:
    """Data of the experiment `own_experiments.counting`."""
    path = tmp_path / "numbers.txt"
    path.write_text("1 2.5\n")
    return path


@pytest.fixture
def ray_cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A cluster whose head has one core; only what the test kills dies, however busy the machine is."""
    pytest.importorskip("ray", reason="ray is not installed: pip install 'foretouch[sweep]'")
    from ray.cluster_utils import Cluster

    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", path)  # where nodes find modules of the tests
    monkeypatch.setenv("RAY_memory_monitor_refresh_ms", "0")
    head = {"num_cpus": 1, "include_dashboard": False, "_system_config": {"health_check_failure_threshold": 100}}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    yield cluster
    cluster.shutdown()


@pytest.fixture(scope="session")
def uskin(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A store of readings of the XELA uSkin, and the card of a model trained on it."""
    from other_sensor import train_on, write_readings

    folder = tmp_path_factory.mktemp("uskin")
    store = write_readings(folder / "store")
    return store, train_on(store, folder / "uskin")
