# SPDX-License-Identifier: Apache-2.0
"""The data of an experiment that needs both: the real grasps, and those of a scene that is simulated beside the sweep."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from foretouch.config import setting
from foretouch.errors import ConfigError
from foretouch.learning.collection import Collection, load_collection
from foretouch.learning.experiments.simulated_data import SimulatedSettings, beside, load_simulated, simulate_store

__all__ = ["BothSettings", "RealAndSimulated", "load_both", "prepare_both"]

_REAL: Final = "real"


@dataclass(frozen=True, kw_only=True)
class BothSettings(SimulatedSettings):
    """Of experiments on both."""

    scene: str = setting("config/scenes/unseen_objects.yaml", "Scene of the simulated grasps")
    samples: int = setting(2400, "Grasps of it", minimum=10, maximum=1_000_000)


@dataclass(frozen=True, eq=False)
class RealAndSimulated:
    """Both.

    Attributes:
        real: The real grasps.
        simulated: The simulated ones.
    """

    real: Collection
    simulated: Collection

    @property
    def sha256(self) -> str:
        """Of both."""
        return hashlib.sha256(f"{self.real.sha256} {self.simulated.sha256}".encode()).hexdigest()


def prepare_both(settings: BothSettings, source: Path | None, out: Path) -> Path:
    """A folder with the store of the scene and a link to the real grasps.

    Raises:
        ConfigError: If no real grasps are given.
    """
    if source is None:
        raise ConfigError("experiment: no real grasps; give --data PATH or set FORETOUCH_DATA")
    folder = beside(out)
    simulate_store(Path(settings.scene), settings.samples, folder)
    link = folder / _REAL
    if link.is_symlink():
        link.unlink()
    link.symlink_to(source.absolute(), target_is_directory=True)
    return folder


def load_both(settings: BothSettings, path: Path) -> RealAndSimulated:
    """Read the folder of `prepare_both`."""
    simulated = load_simulated(settings, path / Path(settings.scene).stem)
    return RealAndSimulated(load_collection(path / _REAL), simulated.collection)
