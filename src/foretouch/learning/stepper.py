# SPDX-License-Identifier: Apache-2.0
"""One network's optimiser and the course of its rate, whose state is tensors and plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import torch
from torch import Tensor, nn

from foretouch.learning.ranks import ONE_RANK, Ranks

__all__ = ["OPTIMISERS", "SCHEDULES", "StepRule", "Stepper"]

OPTIMISERS: Final = ("adamw", "adam", "sgd")
SCHEDULES: Final = ("cosine", "constant")

_KINDS: Final[dict[str, type[torch.optim.Optimizer]]] = {
    "adamw": torch.optim.AdamW,
    "adam": torch.optim.Adam,
    "sgd": torch.optim.SGD,
}


@dataclass(frozen=True)
class StepRule:
    """How weights move.

    Attributes:
        optimiser: Out of `OPTIMISERS`.
        learning_rate: Largest step.
        weight_decay: Pull of the weights to zero.
        schedule: Out of `SCHEDULES`.
    """

    optimiser: str
    learning_rate: float
    weight_decay: float
    schedule: str


class Stepper:
    """Moves the weights of one network.

    Args:
        module: Whose weights.
        rule: How.
        steps: That will be taken in all; the cosine schedule ends with them.
        ranks: Those that share each batch out.
    """

    def __init__(self, module: nn.Module, rule: StepRule, steps: int, ranks: Ranks = ONE_RANK) -> None:
        # One kernel for all weights: a small network's step takes as long as its number of calls.
        options: dict[str, Any] = {"lr": rule.learning_rate, "weight_decay": rule.weight_decay, "fused": True}
        self._weights = list(module.parameters())
        self._ranks = ranks
        self._optimiser = _KINDS[rule.optimiser](self._weights, **options)
        self._schedule: torch.optim.lr_scheduler.LRScheduler
        if rule.schedule == "cosine":
            self._schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self._optimiser, T_max=steps)
        else:
            self._schedule = torch.optim.lr_scheduler.ConstantLR(self._optimiser, factor=1.0)

    def step(self, loss: Tensor) -> None:
        """Differentiate a scalar and take one step."""
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        self._ranks.average_gradients(self._weights)
        self._optimiser.step()
        self._schedule.step()

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors by name and the rest as plain data; together all that `restore` needs."""
        state = self._optimiser.state_dict()
        tensors = {
            f"{number}.{name}": value for number, values in state["state"].items() for name, value in values.items()
        }
        # SGD keeps None where it has no momentum; what is absent is None again after `restore`.
        tensors = {name: value for name, value in tensors.items() if isinstance(value, Tensor)}
        return tensors, {"groups": state["param_groups"], "schedule": self._schedule.state_dict()}

    def restore(self, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> None:
        """Go on as if nothing had been in between."""
        state: dict[int, dict[str, Tensor]] = {}
        for key, value in tensors.items():
            number, name = key.split(".", 1)
            state.setdefault(int(number), {})[name] = value
        self._optimiser.load_state_dict({"state": state, "param_groups": plain["groups"]})
        self._schedule.load_state_dict(dict(plain["schedule"]))
