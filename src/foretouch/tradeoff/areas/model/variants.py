# SPDX-License-Identifier: Apache-2.0
"""The touch models that are compared: one factor at a time around the shipped one."""

from typing import Final

from foretouch.tradeoff.area import Variant

SHIPPED: Final = "contact-v2"
REFERENCE: Final = "papers' four networks"
MEAN: Final = "mean of labels"

TREES: Final = (2, 5, 10, 20)
"""Numbers of trees below the shipped one."""


def list_variants() -> list[Variant]:
    """All variants."""
    shipped = Variant(SHIPPED, "shipped", {"kind": "contact"})
    trees = [Variant(f"{count} trees", "trees", {"kind": "contact", "trees": count}) for count in TREES]
    return [
        shipped,
        Variant(REFERENCE, "reference", {"kind": "papers"}),
        Variant(MEAN, "part", {"kind": "mean"}),
        *trees,
    ]
