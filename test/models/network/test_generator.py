# SPDX-License-Identifier: Apache-2.0
"""P2's generator: its sizes, its range, and that all of it can learn."""

import torch

from foretouch.models.network.config import ModelConfig
from foretouch_lab.learning.network.networks import CloudGenerator, GeneratorConfig, draw_noise

P2 = GeneratorConfig()


def make(config: GeneratorConfig = P2, channels: str = "xyz+rgb", seed: int = 0) -> CloudGenerator:
    torch.manual_seed(seed)
    return CloudGenerator(config, ModelConfig(channels=channels))


def noise(config: GeneratorConfig = P2, count: int = 4, seed: int = 1) -> torch.Tensor:
    return draw_noise(count, config, torch.Generator().manual_seed(seed))


def test_lengths_are_those_of_the_paper_and_the_size_follows_the_configuration() -> None:
    generator, lengths = make(), []
    for layer in generator.layers:
        layer.register_forward_hook(lambda _m, _i, out: lengths.append(out.shape[-1]))
        assert (layer.kernel_size, layer.stride) == ((5,), (5,))
    assert generator(noise()).shape == (4, 750, 6)
    assert lengths == [30, 150, 750]
    assert P2.n_points == 750
    config = GeneratorConfig(noise_length=4, widths=(16,), stride=3)
    generator = make(config)
    assert [tuple(layer.weight.shape[:2]) for layer in generator.layers] == [(6, 16), (16, 6)]
    assert generator(noise(config)).shape == (4, 36, 6)
    assert config.n_points == 36


def test_gradient_reaches_every_parameter_of_channels_in_use() -> None:
    for channels in ("xyz", "xyz+rgb", "xyz+normals"):
        generator = make(channels=channels)
        (generator.clouds(noise(count=16)) * torch.randn(16, 750, 1)).sum().backward()
        for name, parameter in generator.named_parameters():
            assert float(parameter.grad.abs().max()) > 0, name
        last = generator.layers[-1].weight.grad
        assert (float(last[:, 3:].abs().max()) == 0.0) == (channels == "xyz")
