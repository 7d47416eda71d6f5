# SPDX-License-Identifier: Apache-2.0
"""Control of the running statistics of a network's batch norms, for its training."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

import torch
from torch import Tensor, nn

Inputs: TypeAlias = tuple[Tensor, Tensor | None]
"""Points (B, N, C) and grasps (B, G) of one batch."""


def freeze(net: nn.Module) -> None:
    """Training mode for all but batch norm, which keeps its statistics: samples of a batch stay independent."""
    net.train()
    for norm in _norms(net):
        norm.eval()


@torch.no_grad()
def calibrate(net: nn.Module, batches: Iterable[Inputs]) -> None:
    """Set the statistics to their plain mean over some batches of clouds and grasps.

    Args:
        net: Its weights and mode are unchanged.
        batches: Points (B, N, C) and grasps (B, G) or None, with B of at least 2.
    """
    was_training = {module: module.training for module in net.modules()}
    momenta = {norm: norm.momentum for norm in _norms(net)}
    for norm in momenta:
        norm.reset_running_stats()
        norm.momentum = None  # makes the running statistics a plain mean
    net.train()
    for points, grasps in batches:
        net(points, grasps)
    for norm, momentum in momenta.items():
        norm.momentum = momentum
    for module, mode in was_training.items():
        module.training = mode


@contextmanager
def statistics_kept(net: nn.Module) -> Iterator[None]:
    """Context in which batch norm in training mode normalises by the batch but keeps its running statistics."""
    momenta = {norm: norm.momentum for norm in _norms(net)}
    for norm in momenta:
        norm.momentum = 0.0
    try:
        yield
    finally:
        for norm, momentum in momenta.items():
            norm.momentum = momentum


def _norms(net: nn.Module) -> list[nn.BatchNorm1d]:
    return [module for module in net.modules() if isinstance(module, nn.BatchNorm1d)]
