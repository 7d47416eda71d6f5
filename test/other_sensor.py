# SPDX-License-Identifier: Apache-2.0
"""Made-up grasps with readings of another sensor than the BioTac SP, and a model that is trained on them."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from experiment_samples import make_samples

from foretouch.tactile.description import Sensor, load_sensor, packaged_sensor, sensor_files
from foretouch.types import Sample, Touch
from foretouch.types.channels import Channels
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.learning.data import load_dataset
from foretouch_lab.learning.training.run import train_run
from foretouch_lab.learning.training.run_config import RunConfig

USKIN = packaged_sensor("xela_uskin_4x4")


def changed_sensor(folder: Path, name: str = "xela_uskin_4x4", **changes: Any) -> Sensor:
    """A sensor of the package with changed settings."""
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(sensor_files()[name].read_text()) | changes))
    return load_sensor(path)


def readings(samples: list[Sample], channels: Channels, seed: int = 0) -> list[Sample]:
    """The samples with touches that follow from the place of the grasp, and tares of fingers that drift with the object."""
    rng, middle = np.random.default_rng(seed), (channels.low + channels.high) / 2.0
    unit = np.minimum(1000.0, (channels.high - channels.low) / 64.0)
    gain, made = rng.uniform(1.0, 8.0, channels.size), []
    drift = {name: rng.normal(0.0, 0.5) for name in sorted({sample.object for sample in samples})}
    for sample in samples:
        rest = middle * channels.tared + unit * channels.tared * drift[sample.object]
        noise = 0.02 * rng.normal(size=channels.size)
        touch = rest + unit * (gain * (0.5 + 10.0 * sample.grasp.g1[1]) + noise)
        made.append(replace(sample, touch=Touch(touch, channels), tare=Touch(rest, channels)))
    return made


def write_readings(
    path: Path, sensor: Sensor = USKIN, objects: int = 4, each: int = 7, zero: tuple[int, ...] = ()
) -> Path:
    """A store of `readings` of a sensor, of which some values are zero in every reading."""
    with StoreWriter(path, sensor=sensor) as writer:
        for sample in readings(make_samples(objects, each), sensor.channels):
            assert sample.touch is not None
            sample.touch.values[list(zero)] = 0.0
            writer.write(sample)
    return path


@cache
def _config() -> RunConfig:
    return RunConfig.from_mapping({"method": "contact", "contact": {"trees": 3}})


def train_on(store: Path, out: Path) -> Path:
    """A contact model of few trees, calibrated; the path of its card."""
    return train_run(_config(), load_dataset(store), out, lambda _: None)
