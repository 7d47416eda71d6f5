# SPDX-License-Identifier: Apache-2.0
"""Two real processes give the gradients of one."""

import dataclasses
import multiprocessing
from pathlib import Path

import numpy as np
import pytest
import torch

from foretouch.errors import ConfigError
from foretouch.learning.data.training_set import TrainingSet
from foretouch.learning.training.device import SINGLE_PROCESS, DistributedContext, TrainingDevice
from foretouch.learning.training.losses import Features, SrganLossConfig, discriminator_loss, labeled_loss
from foretouch.learning.training.srgan import SrganConfig, SrganTrainer
from foretouch.learning.training.supervised import SupervisedTrainer, TrainConfig
from foretouch.learning.training.trainer import Trainer
from foretouch.models.network.networks import GeneratorConfig

METHODS = ("supervised", "frozen", "per_source")
VARIANTS = ("as_printed", "contrast", "srgan")


def batch() -> tuple[torch.Tensor, torch.Tensor]:
    """Six samples whose errors grow, so that the processes' own roots differ much."""
    generator = torch.Generator().manual_seed(5)
    x = torch.randn(6, 4, generator=generator)
    return x, torch.randn(6, 3, generator=generator) * torch.arange(1.0, 7.0).unsqueeze(1)


def gradients(chosen: slice) -> torch.Tensor:
    """Of a linear map that is features and prediction at once, for each variant of the loss."""
    x, target = (part[chosen] for part in batch())
    rows = []
    for variant in VARIANTS:
        weight = torch.linspace(-1.0, 1.0, 12).view(4, 3).requires_grad_()
        labeled = labeled_loss(x @ weight, target, [1, 2])
        features = Features(x @ weight, (x * 0.5 + 1.0) @ weight, (x * 2.0 - 1.0) @ weight)
        config = SrganLossConfig(loss_variant=variant)
        discriminator_loss(labeled, features, config)["total"].backward()
        rows.append(weight.grad)
    return torch.stack(rows)


def in_double(trainer: Trainer) -> None:
    """Networks, labels and inputs."""
    for module in trainer.modules.values():
        module.double()
    trainer._labels, trainer._grasp_inputs = trainer._labels.double(), trainer._grasp_inputs.double()
    trainer.training_device = DoubleDevice(**vars(trainer.training_device))


@dataclasses.dataclass(frozen=True)
class DoubleDevice(TrainingDevice):
    """Distributes rows in float64."""

    def shard(self, rows: torch.Tensor) -> torch.Tensor:
        return super().shard(rows).double()


def trained_gradients(data: TrainingSet, method: str) -> torch.Tensor:
    """All gradients of one step, whose batch of 20 the processes share, and the running statistics after it."""
    if method == "supervised":
        config = TrainConfig(epochs=1, batch_size=20, loss="rmse", optimiser="sgd", device="cpu")
        trainer: Trainer = SupervisedTrainer(data, np.arange(20), config)
    else:
        loss = SrganLossConfig(loss_variant="srgan", gradient_penalty=0.0 if method == "per_source" else 10.0)
        generator = GeneratorConfig(noise_length=3, stride=2)
        settings = SrganConfig(epochs=1, batch_size=20, optimiser="sgd", learning_rate=1e-4, points=24, device="cpu")
        settings = settings.replace(batch_norm=method, generator=generator, loss=loss)
        trainer = SrganTrainer(data, np.arange(20), np.arange(20, 40), settings)
    in_double(trainer)  # batch norm of few rows makes much of a rounding: in float32 both ways are 1e-6 to 7e-6 apart
    trainer.run_epoch()
    parameters = [parameter for module in trainer.modules.values() for parameter in module.parameters()]
    buffers = [buffer for module in trainer.modules.values() for buffer in module.buffers()]
    return torch.cat([one.double().flatten() for one in (*(parameter.grad for parameter in parameters), *buffers)])


def train_rank(rank: int, folder: str, data: TrainingSet) -> None:
    """One of two processes: half of a batch with the average of both gradients, as training takes it; and training."""
    torch.set_num_threads(1)
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
    own = gradients(slice(3 * rank, 3 * rank + 3))
    torch.distributed.all_reduce(own)
    Path(folder, f"losses{rank}").write_bytes((own / 2).numpy().tobytes())
    for method in METHODS:
        Path(folder, f"{method}{rank}").write_bytes(trained_gradients(data, method).numpy().tobytes())
    torch.distributed.destroy_process_group()


@pytest.mark.slow
def test_two_processes_train_with_the_gradients_of_one(samples, small, tmp_path: Path) -> None:
    """Batch norm in T-Net, trunk and head: by the samples of both, or frozen; root, means and penalty over all."""
    config = small.replace(tnet=True, tnet_widths=(8, 8, 16, 8, 8), head_norm=True)
    data = TrainingSet.build(samples, config)
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=train_rank, args=(rank, str(tmp_path), data)) for rank in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
    assert [worker.exitcode for worker in workers] == [0, 0]
    losses = gradients(slice(0, 6))
    for rank in range(2):
        found = torch.frombuffer(bytearray((tmp_path / f"losses{rank}").read_bytes()), dtype=torch.float32)
        assert float((found - losses.flatten()).norm() / losses.norm()) < 1e-6
    halves = (gradients(slice(0, 3)) + gradients(slice(3, 6))) / 2
    assert float((halves - losses).norm() / losses.norm()) > 0.001  # the mean of the processes' own roots is wrong
    for method in METHODS:
        whole = trained_gradients(data, method)
        for rank in range(2):
            found = torch.frombuffer(bytearray((tmp_path / f"{method}{rank}").read_bytes()), dtype=torch.float64)
            assert float((found - whole).norm() / whole.norm()) < 1e-10, method


def test_a_batch_that_cannot_be_shared_evenly_is_refused() -> None:
    four = DistributedContext(world_size=4, rank=1)
    assert four.shard(np.arange(8)).tolist() == [2, 3]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DistributedContext, "of_process_group", classmethod(lambda _cls: four))
        with pytest.raises(ConfigError, match=r"batch_size: 6 is no multiple of the 4 processes"):
            TrainingDevice.of(TrainConfig(batch_size=6, device="cpu"), 6)


def test_a_single_process_changes_nothing() -> None:
    value = torch.tensor([3.0], requires_grad=True)
    assert DistributedContext.of_process_group() == SINGLE_PROCESS
    assert SINGLE_PROCESS.shared_sum(value) is value
    assert not SINGLE_PROCESS.sum(value).requires_grad
