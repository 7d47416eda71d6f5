# SPDX-License-Identifier: Apache-2.0
"""Modalities and ranges: the numbers of the papers, and invalid settings."""

import numpy as np
import pytest
from every_case import every_refusal

from foretouch.errors import ConfigError, TactileError
from foretouch.tactile import BIOTAC, MODALITIES, P1_RANGES, P2_RANGES, Ranges, TactileRanges


def test_modalities_fill_the_vector_of_fifty_once() -> None:
    assert sorted(BIOTAC.columns(MODALITIES)) == list(range(50))
    assert [len(BIOTAC.columns([name])) for name in MODALITIES] == [1, 1, 24, 24]
    assert BIOTAC.columns(["E_MF", "PDC_MF"]).tolist() == [*range(26, 50), 1]
    with pytest.raises(TactileError, match=r"'PAC_TH' is not one of PDC_TH, PDC_MF"):
        BIOTAC.columns(["PAC_TH"])


def test_counts_outside_of_their_range() -> None:
    counts = P2_RANGES.ranges.low.copy()
    counts[0], counts[1], counts[2] = 3400.0, 2300.5, np.nan
    assert P2_RANGES.ranges.outside(counts).nonzero()[0].tolist() == [1, 2]


def test_settings_may_be_given_in_part_and_bad_ones_are_named() -> None:
    assert TactileRanges.from_mapping(P1_RANGES.to_mapping()) == P1_RANGES
    ranges = TactileRanges.from_mapping({"pdc_th": [2400, 3300]})
    assert (ranges.ranges.of("PDC_TH"), ranges.ranges.of("E_MF")) == ((2400.0, 3300.0), P2_RANGES.ranges.of("E_MF"))
    cases = (
        (r"hand.yaml: .*pdc_th: \[3400.0, 2500.0\] is not \[low, high\]", {"pdc_th": [3400, 2500]}),
        (r"pdc_th: \[1.0, 2.0, 3.0\] is not", {"pdc_th": [1, 2, 3]}),
        (r"e_mf: \[0.0, 1e-09\]: high - low is not between 1e-06 and 1e\+12 counts", {"e_mf": [0.0, 1e-9]}),
        (r"pac: unknown setting; known: pdc_th", {"pac": [1, 2]}),
        ("is not a list", {"pdc_th": 3}),
    )
    every_refusal(ConfigError, cases, lambda change: TactileRanges.from_mapping(change, "hand.yaml"))
    card = P1_RANGES.ranges.to_mapping()
    odd = ([[500.0], 3400.0], [True, 3400.0], [-(10**400), 0.5], [float("nan"), 1.0], {"0": 1})
    cases = tuple((r"card: pdc_th: .* is not \[low, high\]", {**card, "pdc_th": limits}) for limits in odd)
    every_refusal(ConfigError, cases, lambda change: Ranges.from_mapping(BIOTAC, change, "card"))
