# SPDX-License-Identifier: Apache-2.0
"""The training device: as configured, and a search of low precision that still learns."""

import numpy as np
import pytest
import torch

from foretouch.errors import ConfigError
from foretouch_lab.learning.data.training_set import TrainingSet
from foretouch_lab.learning.network.networks import GeneratorConfig
from foretouch_lab.learning.training.srgan import SrganConfig, SrganTrainer
from foretouch_lab.learning.training.supervised import TrainConfig


def test_a_gpu_that_is_not_there_is_refused_and_auto_does_without() -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    assert TrainConfig().resolved_device == "cpu"
    with pytest.raises(ConfigError, match=r"device: cuda: torch finds no GPU; choose auto or cpu"):
        TrainConfig(device="cuda").resolved_device  # noqa: B018


def test_a_search_in_bfloat16_learns_as_much_and_leaves_float32_weights(samples, small) -> None:
    data = TrainingSet.build(samples, small)
    generator = GeneratorConfig(noise_length=3, stride=2)
    config = SrganConfig(epochs=20, batch_size=10, learning_rate=1e-3, points=24, generator=generator, device="cpu")
    losses, first = {}, {}
    for precision in ("float32", "bfloat16"):
        trainer = SrganTrainer(data, np.arange(20), np.arange(20, 60), config.replace(precision=precision))
        found = [trainer.run_epoch()["labeled"] for _ in range(20)]
        first[precision], losses[precision] = found[0], found[-1]
        assert all(value.dtype != torch.bfloat16 for value in trainer.net.state_dict().values())
    assert first["bfloat16"] != first["float32"]  # it was used
    assert losses["bfloat16"] == pytest.approx(losses["float32"], rel=0.1)
