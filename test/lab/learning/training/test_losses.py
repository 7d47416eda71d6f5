# SPDX-License-Identifier: Apache-2.0
"""Losses against numbers worked by hand, finite differences, and the hazards they were seen to have."""

import math

import pytest
import torch

from foretouch_lab.learning.training.losses import (
    SrganLossConfig,
    _safe_root,
    discriminator_loss,
    labeled_loss,
    matching_loss,
)

F64 = torch.float64

# Two samples, two features.
L = torch.tensor([[1.0, 2.0], [3.0, 0.0]])
U = torch.tensor([[0.0, 2.0], [1.0, 1.0]])  # L - U: (1, 0), (2, -1); means (1.5, -0.5)
FAKE = torch.tensor([[3.0, 2.0], [1.0, 9.0]])  # U - F: (-3, 0), (0, -8); means (-1.5, -4)
ALL = (L, U, FAKE)


def parts(config: SrganLossConfig, features: tuple[torch.Tensor, ...] = ALL) -> dict:
    """The parts of the discriminator's loss as numbers; that of the labels is 0.5."""
    found = discriminator_loss(torch.tensor(0.5), features, config)
    return {name: float(value) for name, value in found.items()}


def test_root_mean_square_by_hand_exact_and_zero_at_zero() -> None:
    scaled, target = torch.tensor([[1.0], [5.0]]), torch.tensor([[4.0], [1.0]])
    assert float(labeled_loss(scaled, target, [1])) == pytest.approx(math.sqrt((9 + 16) / 2))
    assert float(labeled_loss(scaled, target, [1], "mse")) == pytest.approx(12.5)
    apart = torch.zeros(1, 3), torch.tensor([[2.0, 3.0, 4.0]]), [1, 2]  # each modality counts alike
    assert float(labeled_loss(*apart)) == pytest.approx((2 + math.sqrt(12.5)) / 2)
    assert float(labeled_loss(*apart, "mse")) == pytest.approx((4 + 12.5) / 2)
    assert float(labeled_loss(*apart, epsilon=5.0)) == pytest.approx((3 + math.sqrt(17.5)) / 2)
    squares = torch.tensor([0.0, 1.0001e-12, 1e-8, 0.3, 7e6], dtype=F64)
    assert torch.equal(_safe_root(squares), squares.sqrt())


def test_as_printed_contrast_and_the_original_srgan_by_hand_and_equation_4_is_equation_3() -> None:
    config = SrganLossConfig(loss_variant="as_printed")
    found = parts(config)
    assert found["unlabeled"] == found["fake"] == pytest.approx((1 + 5) / 2)
    assert found["total"] == pytest.approx(0.5 + 10 * 3 + 0.1 * 3)
    assert parts(config, (L, U, 100 * FAKE)) == found
    assert float(matching_loss(FAKE, U, config)) == pytest.approx((9 + 64) / 2)
    found = parts(SrganLossConfig(loss_variant="contrast"))
    roots = [2.0, 1.0, 1.0, 3.0]  # sqrt(|Δ| + 1) for |Δ| = 3, 0, 0, 8
    assert found["unlabeled"] == pytest.approx(3.0)
    assert found["fake"] == pytest.approx(-sum(roots) / 4)
    assert found["total"] == pytest.approx(0.5 + 30 - 0.1 * 7 / 4)
    parted = [parts(SrganLossConfig(), (U, U, U + gap))["total"] for gap in (0.0, 0.5, 2.0, 50.0)]
    assert parted == sorted(set(parted), reverse=True)
    means = parts(SrganLossConfig(loss_variant="batch_means"))
    assert means["unlabeled"] == pytest.approx((1.5**2 + 0.5**2) / 2)
    assert float(matching_loss(L, U[:1], SrganLossConfig(loss_variant="batch_means"))) == pytest.approx(
        (2**2 + 1**2) / 2
    )
    config = SrganLossConfig(loss_variant="srgan")
    found = parts(config)
    assert found["unlabeled"] == pytest.approx((1.5 + 0.5) / 2)
    assert found["fake"] == pytest.approx(-(math.sqrt(2.5) + math.sqrt(5)) / 2)
    assert float(matching_loss(FAKE, U, config)) == pytest.approx(2.75)
    matching_loss(FAKE, U[:1], config)  # by means


def test_equation_3_as_printed_is_the_variance_of_the_features() -> None:
    """Over all pairs of clouds it is 2 tr Cov(f); between the means of two batches of B it is 2 tr Cov(f) / (B F)."""
    features = torch.randn(12, 5, dtype=F64, generator=torch.Generator().manual_seed(3)) * torch.arange(1.0, 6.0)
    trace = float(features.var(dim=0, correction=0).sum())
    printed, means = (SrganLossConfig(loss_variant=variant) for variant in ("as_printed", "batch_means"))
    found = [float(matching_loss(features, features.roll(k, dims=0), printed)) for k in range(12)]
    assert sum(found) / 12 == pytest.approx(2.0 * trace)
    pairs = [matching_loss(a[None], b[None], means) for a in features for b in features]  # batches of one
    assert float(torch.stack(pairs).mean()) == pytest.approx(2.0 * trace / 5)
