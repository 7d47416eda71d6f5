# SPDX-License-Identifier: Apache-2.0
"""Data of experiments on simulated grasps: an existing training store, or a scene that is simulated first.

Stores that a sweep makes lie beside its folder, in `<DIR>.data`; they are made once and needed again only to resume.
"""

from pathlib import Path
from typing import Any

from foretouch.dataset.store import Store, is_store
from foretouch.errors import ConfigError
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.simulation.scene import load_scene
from foretouch_lab.simulation.simulate import Simulation


def prepare_simulated(settings: Any, source: Path | None, out: Path) -> Path:
    """`prepare` of an experiment: `--data` is a store of simulated grasps, or a scene that is simulated now.

    Raises:
        ConfigError: If nothing is given, or neither of these.
    """
    if source is None:
        raise ConfigError(
            "experiment: no data; give --data a scene, such as config/scenes/deformables.yaml, or a store"
        )
    if is_store(source):
        return source
    if source.is_dir():
        raise ConfigError(f"--data: {source}: is neither a scene (.yaml) nor a store of simulated grasps")
    return simulate_store(source, settings.samples, out.absolute().with_name(f"{out.absolute().name}.data"))


def simulate_store(scene_file: Path, count: int, folder: Path) -> Path:
    """Simulate the first `count` samples of a scene (YAML) to a store in a folder, or reuse a complete one.

    Raises:
        ConfigError: If the existing store is of another scene or size.
    """
    scene, path = load_scene(scene_file), folder / scene_file.stem
    if not is_store(path):
        about = {"scene": scene.to_mapping(), "scene_sha256": scene.sha256()}
        with StoreWriter(path, about, scene.fingers.taxel_sensor()) as writer:
            for sample in Simulation(scene).samples(count):
                writer.write(sample)
        return path
    store = Store(path)
    if len(store) != count or store.manifest.get("about", {}).get("scene_sha256") != scene.sha256():
        raise ConfigError(f"{path}: contains {len(store)} samples of another scene or size; remove it")
    return path
