# SPDX-License-Identifier: Apache-2.0
"""The touch models that are compared: one factor at a time around the shipped one, then pairs."""

import importlib.util
from collections.abc import Sequence
from itertools import product
from typing import Any, Final

from foretouch.tradeoff.area import Variant

SHIPPED: Final = "contact-v2"
NETWORK: Final = "touchnet-v1"
REFERENCE: Final = "papers' four networks"
MEAN: Final = "mean of labels"

RECIPES: Final[dict[str, dict[str, Any]]] = {
    "touchnet": {},
    "narrow": {"trunk_widths": [16, 32, 64], "head_widths": [64]},
    "wide": {"trunk_widths": [64, 128, 256], "head_widths": [256]},
    "T-Net": {"tnet": True, "tnet_widths": [32, 64, 128, 64, 32]},
}
"""Networks that are trained: what differs from the recipe of touchnet-v1."""

_BACKENDS: Final = {"ONNX Runtime": ("onnx", "onnxruntime"), "OpenVINO": ("onnx", "openvino")}
_POINTS: Final = (64, 128, 256, 512, 1024, 2048)
_SAMPLERS: Final = ("random", "voxel", "farthest")


def list_variants(*, full: bool) -> list[Variant]:
    """All variants of the preset; `full` adds networks that are trained and contact models that take longer to fit."""
    return [
        Variant(SHIPPED, "shipped", {"kind": "contact"}),
        Variant(REFERENCE, "reference", {"kind": "papers"}),
        Variant(MEAN, "part", {"kind": "mean"}),
        *_contact(full=full),
        *_networks(full=full),
    ]


def _contact(*, full: bool) -> list[Variant]:
    refitted = {"depth": (4, 8), "share": (0.1, 1.0), "leaf": ()}
    if full:
        refitted = {"depth": (2, 4, 6, 8, 12), "share": (0.1, 0.25, 1.0), "leaf": (1, 10), "trees": (120, 240)}
    names = {"depth": "depth {}", "share": "share {:g} of features", "leaf": "leaf {}", "trees": "{} trees"}
    own = [
        *(_contact_variant(f"{count} trees", "trees", trees=count) for count in (2, 5, 10, 20, 30)),
        _contact_variant("no surroundings", "part", part="no surroundings"),
        _contact_variant("forests alone", "part", part="forests"),
        _contact_variant("kernel alone", "part", part="kernel"),
        *(_contact_variant(f"cloud of {count}", "cloud", points=count) for count in (200, 500, 1000)),
    ]
    own += [
        _contact_variant(names[key].format(value), key, refit={_FIELDS[key]: value})
        for key, values in refitted.items()
        for value in values
    ]
    pairs: list[tuple[int, dict[str, Any], str]] = [
        (10, {"part": "no surroundings"}, "no surroundings"),
        (10, {"points": 500}, "cloud of 500"),
    ]
    pairs += [(10, {"part": "forests"}, "forests alone"), (5, {"part": "no surroundings"}, "no surroundings")]
    return own + [_contact_variant(f"{n} trees, {text}", "trees x part", trees=n, **more) for n, more, text in pairs]


_FIELDS: Final = {"depth": "depth", "share": "feature_share", "leaf": "leaf", "trees": "trees"}


def _contact_variant(name: str, factor: str, **values: Any) -> Variant:
    return Variant(name, factor, {"kind": "contact", **values})


def _networks(*, full: bool) -> list[Variant]:
    shipped = Variant(NETWORK, "model", {"kind": "network"})
    points = [
        Variant(f"{sampler} {count}", f"net: {sampler}", {"kind": "network", "points": count, "sampler": sampler})
        for sampler, count in product(_SAMPLERS if full else _SAMPLERS[:1], _POINTS)
    ]
    if not full:
        points += [
            Variant(f"{one} 256", f"net: {one}", {"kind": "network", "points": 256, "sampler": one})
            for one in _SAMPLERS[1:]
        ]
    precisions = [_twin(f"net {one}", "net: precision", {"precision": one}) for one in ("bf16", "int8")]
    backends = [
        _twin(f"net {name}", "net: backend", {"backend": name}, _missing(libraries))
        for name, libraries in _BACKENDS.items()
    ]
    backends.append(
        _twin("net ONNX Runtime int8", "net: backend x precision", {"backend": "ONNX Runtime", "precision": "int8"},
              _missing(_BACKENDS["ONNX Runtime"]))
    )  # fmt: skip
    widths = [_untrained(f"net {name}", "net: width", {"recipe": name}) for name in RECIPES if name != "touchnet"]
    several = [
        Variant("2 nets", "net: ensemble", {"kind": "network", "members": 2}),
        Variant("5 nets", "net: ensemble", {"kind": "network", "members": 5}),
        _untrained("4 separate nets", "net: shared or separate", {"separate": True}),
        Variant("net 64, bf16", "net: points x precision", {"kind": "network", "points": 64, "precision": "bf16"}),
    ]
    papers = [
        _untrained("papers' width, shared", "net: papers' width", {"recipe": "papers"}),
        Variant("papers' width, shared, bf16", "net: papers' width",
                {"kind": "network", "recipe": "papers", "precision": "bf16"}, "papers' width, shared"),
    ]  # fmt: skip
    return [shipped, *points, *precisions, *backends, *widths, *several, *papers]


def _twin(name: str, factor: str, values: dict[str, Any], missing: str = "") -> Variant:
    """The shipped network otherwise executed, whose answers should be the same."""
    return Variant(name, factor, {"kind": "network", **values}, NETWORK, missing=missing)


def _untrained(name: str, factor: str, values: dict[str, Any]) -> Variant:
    """A network that is timed with random weights, so that its answers are compared with no others."""
    return Variant(name, factor, {"kind": "network", **values}, name)


def _missing(libraries: Sequence[str]) -> str:
    absent = [name for name in libraries if importlib.util.find_spec(name) is None]
    return f"{' and '.join(absent)} not installed" if absent else ""
