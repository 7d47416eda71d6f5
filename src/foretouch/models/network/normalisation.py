# SPDX-License-Identifier: Apache-2.0
"""Batch norm whose statistics are chosen, not left to whatever lies in the batch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

import torch
from torch import Tensor, nn

from foretouch.models.network.regressor import TouchNet

__all__ = ["calibrate", "freeze", "statistics_kept"]

Inputs: TypeAlias = tuple[Tensor, Tensor | None]


def freeze(net: nn.Module) -> None:
    """Training mode for all but batch norm, which keeps its statistics: no sample is moved by its batch mates."""
    net.train()
    for norm in _norms(net):
        norm.eval()


@torch.no_grad()
def calibrate(net: TouchNet, batches: Iterable[Inputs]) -> None:
    """Set the statistics to their plain mean over some batches of clouds and grasps.

    Args:
        net: Its weights and mode are left as they are.
        batches: Points (B, N, C) and grasps (B, G) or None, with B of at least 2.
    """
    was_training = {module: module.training for module in net.modules()}
    momenta = {norm: norm.momentum for norm in _norms(net)}
    for norm in momenta:
        norm.reset_running_stats()
        norm.momentum = None  # which makes the running statistics a plain mean
    net.train()
    for points, grasps in batches:
        net(points, grasps)
    for norm, momentum in momenta.items():
        norm.momentum = momentum
    for module, mode in was_training.items():
        module.training = mode


@contextmanager
def statistics_kept(net: nn.Module) -> Iterator[None]:
    """Within, batch norm in training mode normalises by the batch and leaves its running statistics alone."""
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
