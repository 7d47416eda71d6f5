# SPDX-License-Identifier: Apache-2.0
"""The trainings that are compared: more grasps or objects, more trees or epochs, points and precision."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from foretouch.tradeoff.area import Variant

CONTACT: Final = "contact model as shipped"
NETWORK: Final = "network as shipped"
MEAN: Final = "mean of labels"

GRASPS: Final = (5, 10, 20)
"""Training grasps of each object; the shipped model uses all, 40 of 50 in each fold of blocks of time."""

OBJECTS: Final = (2, 4)
"""Training objects; the shipped model uses all, 7 of 8 where one is left out."""

_TREES: Final = (5, 15, 120)
_EPOCHS: Final = 120  # of the network as shipped
_NETWORKS: Final[tuple[tuple[str, Mapping[str, Any]], ...]] = (
    ("epochs", {"train.epochs": 10}),
    ("epochs", {"train.epochs": 30}),
    ("epochs", {"train.epochs": 60}),
    ("epochs", {"train.epochs": 240}),
    ("cloud size", {"train.points": 64}),
    ("cloud size", {"train.points": 128}),
    ("cloud size", {"train.points": 512}),
    ("precision", {"train.precision": "bfloat16"}),
    ("epochs x cloud size", {"train.epochs": 240, "train.points": 64}),
    ("epochs x cloud size", {"train.epochs": 240, "train.points": 128}),
    ("epochs x cloud size", {"train.epochs": 60, "train.points": 64}),
)


def list_variants(detail: str) -> list[Variant]:
    """All variants of `few`, without networks, or `all`."""
    return [
        Variant(CONTACT, "shipped", {"kind": "contact"}),
        Variant(MEAN, "part", {"kind": "mean"}, reference=CONTACT),
        *_contact(detail),
        *(_networks() if detail == "all" else ()),
    ]


def _contact(detail: str) -> Iterator[Variant]:
    for count in GRASPS if detail == "all" else GRASPS[::2]:
        yield Variant(f"{count} grasps an object", "labels", {"kind": "contact", "grasps": count}, reference=CONTACT)
    for count in OBJECTS if detail == "all" else ():
        yield Variant(f"{count} objects", "objects", {"kind": "contact", "objects": count}, reference=CONTACT)
    for count in _TREES if detail == "all" else _TREES[1:2]:
        changes = {"trees": count}
        yield Variant(f"{count} trees", "trees", {"kind": "contact", "changes": changes}, reference=CONTACT)
    values = {"kind": "contact", "changes": {"thinned": 1.0}}
    yield Variant("no thinned copies", "copies", values, reference=CONTACT)


def _networks() -> Iterator[Variant]:
    yield _network("shipped", {}, NETWORK)
    for factor, changes in _NETWORKS:
        yield _network(factor, changes, "network, " + ", ".join(_text(*pair) for pair in changes.items()))


def _network(factor: str, changes: Mapping[str, Any], name: str) -> Variant:
    values = {"kind": "network", "changes": dict(changes), "epochs": changes.get("train.epochs", _EPOCHS)}
    return Variant(name, factor, values, compared_with=CONTACT, reference=NETWORK)


def _text(key: str, value: Any) -> str:
    return str(value) if key == "train.precision" else f"{value} {key.rpartition('.')[2]}"
