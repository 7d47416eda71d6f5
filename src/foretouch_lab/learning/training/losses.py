# SPDX-License-Identifier: Apache-2.0
"""Losses of the supervised networks and of the SR-GAN: P2's equations 1 to 5 in four variants.

P2 prints for the discriminator (x_L labelled, x_U unlabelled, x_F fake, f features before the grasp joins)::

    L_D = w_L L_labeled + w_U L_unlabeled + w_F L_fake                       eq. 1
    L_labeled   = sqrt(sum_i (ŷ_i - y_i)² / n)                               eq. 2
    L_unlabeled = sum_i |f(x_L,i) - f(x_U,i)|² / n                           eq. 3
    L_fake      = the same as eq. 3                                          eq. 4
    L_G         = sum_i |f(x_F,i) - f(x_U,i)|² / n                           eq. 5

Its text contradicts eq. 4 (L_fake "tries to make the features of the unlabeled data and the fake data as dissimilar
as possible") and eqs. 3 and 4 at once ("we use the ones proposed in the original SR-GAN work"). Hence `loss_variant`:

    as_printed  eqs. 3, 4, 5 to the letter: fake clouds enter no loss of the discriminator
    contrast    eqs. 3 and 5; L_fake pushes f(x_U) and f(x_F) apart by -mean sqrt(|Δ| + 1) of their differences Δ. The
                negative of eq. 3's square is unbounded below, and diverged to 65 million within 60 steps
    batch_means as `contrast`, but eqs. 3 and 5 compare the means of the batches, as the original SR-GAN does: the squared
                difference of the mean features, averaged over the features
    srgan       Olmschenk et al. 2019, with Δ the difference of the batches' mean features: matching and generator
                loss mean|Δ|, the same contrast. Its labelled loss is replaced by eq. 2, as in P2

Eq. 3 to the letter compares unrelated pairs of clouds. Its expectation is 2 tr Cov(f), so with w_U = 10 over 1024 features it
penalises the variance of the features themselves, and all clouds become one (`docs/papers.md`).

Shapes: B samples, F features, M outputs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from foretouch.config import Settings, setting

_LEAST_ROOT: Final = 1e-6
_OF_MEANS: Final = ("batch_means", "srgan")  # variants that compare the mean features of two batches


@dataclass(frozen=True, kw_only=True)
class SrganLossConfig(Settings):
    """Variant of the losses, and P2's weights beside w_L, which is 1."""

    loss_variant: str = setting(
        "contrast",
        "Variant of P2's equations 3 to 5; see the module",
        choices=("as_printed", "contrast", "batch_means", "srgan"),
    )
    weight_unlabeled: float = setting(10.0, "w_U", bounds=(0.0, 1e6))
    weight_fake: float = setting(0.1, "w_F", bounds=(0.0, 1e6))


def _safe_root(mean_square: Tensor) -> Tensor:
    """Return the square root, with a finite slope at zero.

    Departure from eq. 2, whose slope at zero is infinite and turns a perfect batch into NaN weights: below 1e-6 the
    root is replaced by its chord, m / 1e-6. Zero stays zero; from 1e-6 on, far below any real error, it is exact.
    """
    least = _LEAST_ROOT**2
    # Without the clamp, the branch that `where` discards would give 0 · inf.
    return torch.where(mean_square > least, mean_square.clamp(min=least).sqrt(), mean_square / _LEAST_ROOT)


def labeled_loss(
    scaled: Tensor, target: Tensor, sizes: Sequence[int], kind: str = "rmse", epsilon: float = 0.0
) -> Tensor:
    """Return the root mean square error, eq. 2, averaged over the modalities, so that 24 electrodes do not outweigh one pressure.

    Args:
        scaled: (B, M) predictions.
        target: (B, M) labels on the same scale.
        sizes: Number of values of each modality; they add up to M. P2 has one modality per network.
        kind: `rmse`, or `mse` without the root.
        epsilon: Added to the mean square under the root, as in P1's public code; 0 for `_safe_root`.
    """
    parts = torch.split(scaled - target, list(sizes), dim=1)
    stacked = torch.stack([part.square().sum() / part.numel() for part in parts])
    if kind == "mse":
        return stacked.mean()
    return (torch.sqrt(stacked + epsilon) if epsilon > 0.0 else _safe_root(stacked)).mean()


def discriminator_loss(labeled: Tensor, features: Sequence[Tensor], config: SrganLossConfig) -> dict[str, Tensor]:
    """Return the parts of eq. 1 by name, before their weights, and their `total`.

    Args:
        labeled: Result of `labeled_loss`.
        features: (B, F) features f(x) of the labelled, the unlabelled and, but for the variant `as_printed`, the fake clouds;
            the last detached from the generator.
        config: Variant and weights.
    """
    unlabeled = matching_loss(features[0], features[1], config)
    fake = unlabeled  # eq. 4 is eq. 3
    if config.loss_variant != "as_printed":  # a contrast, whose slope in each feature is at most one
        fake = -(_difference(features[1], features[2], config).abs() + 1.0).sqrt().mean()
    parts = {"labeled": labeled, "unlabeled": unlabeled, "fake": fake}
    total = labeled + config.weight_unlabeled * unlabeled + config.weight_fake * fake
    return {**parts, "total": total}


def matching_loss(a: Tensor, b: Tensor, config: SrganLossConfig) -> Tensor:
    """Return squared distance of the (B, F) features of two batches, eqs. 3 and 5, or the SR-GAN's mean|Δ|.

    Eq. 3 is of labelled and unlabelled clouds; eq. 5, the generator's loss, of fake and unlabelled ones.
    """
    delta = _difference(a, b, config)
    if config.loss_variant == "srgan":
        return delta.abs().mean()
    if config.loss_variant == "batch_means":
        return delta.square().mean()
    return delta.square().sum(dim=1).mean()


def _difference(a: Tensor, b: Tensor, config: SrganLossConfig) -> Tensor:
    """Return (B, F) in pairs, or (1, F) of the batches' means."""
    if config.loss_variant not in _OF_MEANS:
        return a - b
    return (a.sum(dim=0, keepdim=True) / len(a)) - (b.sum(dim=0, keepdim=True) / len(b))
