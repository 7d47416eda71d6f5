# SPDX-License-Identifier: Apache-2.0
"""Simulated grasps as the data of an experiment: a store that stands, or a scene that is simulated first.

They lie in a folder beside that of the sweep, `<DIR>.data`, which is made once and needed again only to resume.

The data of an experiment that needs both: the real grasps, and those of a scene that is simulated beside the sweep.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from foretouch.config import Settings, setting
from foretouch.dataset.store import Store, is_store
from foretouch.dataset.store_writer import StoreWriter
from foretouch.errors import ConfigError, DatasetError
from foretouch.learning.data.collection import Collection, load_collection
from foretouch.simulation.scene import SceneConfig, load_scene
from foretouch.simulation.simulate import Simulation

__all__ = [
    "BothSettings",
    "RealAndSimulated",
    "SimulatedGrasps",
    "SimulatedSettings",
    "beside",
    "load_both",
    "load_simulated",
    "prepare_both",
    "prepare_simulated",
    "simulate_store",
]


@dataclass(frozen=True, kw_only=True)
class SimulatedSettings(Settings):
    """Of experiments on simulated grasps."""

    samples: int = setting(4000, "Grasps to simulate where --data is a scene", minimum=10, maximum=1_000_000)


@dataclass(frozen=True, eq=False)
class SimulatedGrasps:
    """A store of simulated grasps and the scene that they come from.

    Attributes:
        collection: The samples.
        scene: The scene; with the `slot` and `attempt` of a sample it makes that sample again.
    """

    collection: Collection
    scene: SceneConfig

    @property
    def sha256(self) -> str:
        """Of the samples."""
        return self.collection.sha256


def prepare_simulated(settings: SimulatedSettings, source: Path | None, out: Path) -> Path:
    """`prepare` of an experiment: `--data` is a scene, which is simulated, or a store that was simulated before.

    Raises:
        ConfigError: If nothing is given, or what is given is no scene.
    """
    if source is None:
        raise ConfigError(
            "experiment: no data; give --data a scene, such as config/scenes/deformables.yaml, or a store"
        )
    if is_store(source):
        return source
    if source.is_dir():
        raise ConfigError(f"--data: {source}: is neither a scene (.yaml) nor a store of simulated grasps")
    return simulate_store(source, settings.samples, beside(out))


def beside(out: Path) -> Path:
    """Where the data of a sweep lie that it makes itself."""
    return out.absolute().with_name(f"{out.absolute().name}.data")


def simulate_store(scene_file: Path, count: int, folder: Path) -> Path:
    """The store of a scene's first samples; one that stands there already, whole, is taken as it is.

    Args:
        scene_file: YAML.
        count: Of the samples.
        folder: Where the store lies, under the name of the scene.

    Raises:
        ConfigError: If the store that stands there is of another scene or size.
    """
    scene = load_scene(scene_file)
    path = folder / scene_file.stem
    if not is_store(path):
        with StoreWriter(path, {"scene": scene.to_mapping(), "scene_sha256": scene.sha256()}) as writer:
            for made in Simulation(scene).samples(count):
                writer.write(made.sample)
        return path
    store = Store(path)
    if len(store) != count or _scene_of(store.manifest, path).sha256() != scene.sha256():
        raise ConfigError(f"{path}: holds {len(store)} samples of another scene or size; remove it")
    return path


def load_simulated(settings: SimulatedSettings, path: Path) -> SimulatedGrasps:
    """Read a store and its scene.

    Raises:
        DatasetError: If the store does not tell its scene.
    """
    del settings
    return SimulatedGrasps(load_collection(path), _scene_of(Store(path).manifest, path))


def _scene_of(manifest: Any, path: Path) -> SceneConfig:
    scene = manifest.get("about", {}).get("scene")
    if not isinstance(scene, dict):
        raise DatasetError(f"{path}: about.scene: is missing; only simulated samples can be made again")
    return SceneConfig.from_mapping(scene, str(path))


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
