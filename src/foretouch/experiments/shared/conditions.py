# SPDX-License-Identifier: Apache-2.0
"""What `coverage` and `ablation` share: the default model on simulated new objects and on splits of the real grasps."""

from dataclasses import dataclass

from foretouch.config import setting
from foretouch.experiments.shared.folds import split_by_fold, split_objects
from foretouch.experiments.shared.scores import labelled
from foretouch.experiments.shared.simulated_data import BothSettings, RealAndSimulated
from foretouch.learning.data import make_folds
from foretouch.learning.evaluation.metrics import BootstrapConfig
from foretouch.learning.training.contact import ContactConfig
from foretouch.types import GraspSample


@dataclass(frozen=True, kw_only=True)
class ConditionSettings(BothSettings):
    """Settings of both."""

    split_seeds: tuple[int, ...] = setting((0, 1, 2), "Seeds of the splits of the simulated objects", minimum=0)
    train_objects: int = setting(65, "Number of simulated training objects; the others are tested", minimum=2)
    draws: int = setting(10, "Number of random draws of the touched grasps", minimum=1, maximum=1000)
    contact: ContactConfig = ContactConfig()
    bootstrap: BootstrapConfig = BootstrapConfig()


def split_condition(
    settings: ConditionSettings, data: RealAndSimulated, split: str, part: str, seed: int = 0
) -> tuple[list[GraspSample], list[GraspSample]]:
    """Training and test samples: of the fold `part` of a named split of the real grasps, or simulated objects.

    Args:
        settings: Settings of the experiment.
        data: The samples.
        split: Name of the split; "" for simulated objects.
        part: Name of the fold, or seed of the split of the simulated objects.
        seed: Seed of the folds.
    """
    if not split:
        return split_objects(labelled(data.simulated), settings.train_objects, int(part))
    real = labelled(data.real)
    return split_by_fold(real, make_folds(real, split, seed), part)
