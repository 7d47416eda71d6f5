# SPDX-License-Identifier: Apache-2.0
"""Two real processes give the gradients of one."""

import multiprocessing
from pathlib import Path

import pytest
import torch

from foretouch.learning.losses import Features, SrganLossConfig, discriminator_loss, labeled_loss
from foretouch.learning.ranks import ONE_RANK, Ranks

READINGS = ("as_printed", "contrast", "srgan")


def batch() -> tuple[torch.Tensor, torch.Tensor]:
    """Six samples whose errors grow, so that the ranks' own roots differ much."""
    generator = torch.Generator().manual_seed(5)
    x = torch.randn(6, 4, generator=generator)
    return x, torch.randn(6, 3, generator=generator) * torch.arange(1.0, 7.0).unsqueeze(1)


def gradients(chosen: slice, ranks: Ranks) -> torch.Tensor:
    """Of a linear map that is features and prediction at once, for each reading."""
    x, target = (part[chosen] for part in batch())
    rows = []
    for reading in READINGS:
        weight = torch.linspace(-1.0, 1.0, 12).view(4, 3).requires_grad_()
        labeled = labeled_loss(x @ weight, target, [1, 2], ranks=ranks)
        features = Features(x @ weight, (x * 0.5 + 1.0) @ weight, (x * 2.0 - 1.0) @ weight)
        discriminator_loss(labeled, features, SrganLossConfig(reading=reading), ranks=ranks).total.backward()
        rows.append(weight.grad)
    return torch.stack(rows)


def run_rank(rank: int, folder: str) -> None:
    """One of two processes: half of the batch, and the average of both gradients, as data-parallel training takes it."""
    torch.set_num_threads(1)
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
    own = gradients(slice(3 * rank, 3 * rank + 3), Ranks.of_process_group())
    torch.distributed.all_reduce(own)
    if rank == 0:
        Path(folder, "found").write_bytes((own / 2).numpy().tobytes())
    torch.distributed.destroy_process_group()


@pytest.mark.slow
def test_two_processes_give_the_gradients_of_one(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=run_rank, args=(rank, str(tmp_path))) for rank in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
    assert [worker.exitcode for worker in workers] == [0, 0]
    found = torch.frombuffer(bytearray((tmp_path / "found").read_bytes()), dtype=torch.float32).view(3, 4, 3)
    whole = gradients(slice(0, 6), ONE_RANK)
    assert float((found - whole).norm() / whole.norm()) < 1e-6


def test_the_mean_of_the_ranks_own_roots_would_be_wrong() -> None:
    """What the sum before the root is for."""
    halves = (gradients(slice(0, 3), ONE_RANK) + gradients(slice(3, 6), ONE_RANK)) / 2
    whole = gradients(slice(0, 6), ONE_RANK)
    assert float((halves - whole).norm() / whole.norm()) > 0.001


def test_one_rank_changes_nothing() -> None:
    value = torch.tensor([3.0], requires_grad=True)
    assert Ranks.of_process_group() == ONE_RANK
    assert ONE_RANK.shared_sum(value) is value
    assert not ONE_RANK.sum(value).requires_grad
