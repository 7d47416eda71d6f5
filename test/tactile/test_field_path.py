# SPDX-License-Identifier: Apache-2.0
"""Field paths, in plain objects, lists and arrays."""

from types import SimpleNamespace as Message

import numpy as np
from every_case import every_case, every_refusal

from foretouch.errors import ConfigError, TactileError
from foretouch.tactile.field_path import FieldPath

MESSAGE = Message(
    header=Message(stamp=Message(sec=3)),
    fingers=[Message(name="TH", taxels=[Message(x=k, y=10 * k) for k in range(3)]), Message(name="MF", taxels=[])],
    values=np.arange(10),
)


def test_paths_lead_to_numbers_and_series() -> None:
    cases = (
        ("", MESSAGE),
        ("header.stamp.sec", 3),
        ("fingers[0].name", "TH"),
        ("fingers[-1].name", "MF"),
        ("fingers[name=MF].taxels", []),
        ("fingers[name=TH].taxels[].y", [0, 10, 20]),
        ("fingers[0].taxels[1:].x", [1, 2]),
        ("fingers[].taxels[].x", [[0, 1, 2], []]),
        ("values[4]", 4),
        ("values[]", list(range(10))),
        ("values[1:4]", [1, 2, 3]),
        ("values[0::3]", [0, 3, 6, 9]),
        ("values[:2]", [0, 1]),
    )

    def check(path: str, expected: object) -> None:
        found = FieldPath(path).get(MESSAGE)
        assert (found.tolist() if isinstance(found, np.ndarray) else found) == expected

    every_case(cases, check)


def test_what_is_no_path_is_refused() -> None:
    texts = (".", "a.", "a..b", "a[", "a[x]", "a[=x]", "a[::0]", "a[-2:]", "a.__class__")
    every_refusal(
        ConfigError, [("rule: .* is not a field path", text) for text in texts], lambda text: FieldPath(text, "rule")
    )


def test_what_a_message_lacks_is_named() -> None:
    cases = (
        (r"header.stmp: SimpleNamespace: field 'stmp' is not one of stamp; did you mean stamp\?", "header.stmp"),
        (r"there is no element 2 among 2", "fingers[2]"),
        (r"no element has name=FF; known: TH, MF", "fingers[name=FF].taxels"),
        (r"no element has name=FF; known: none", "fingers[1].taxels[name=FF]"),
        (r"SimpleNamespace: field 'nme' is not one of name, taxels", "fingers[nme=TH]"),
        ("SimpleNamespace is not a list", "header[0]"),
        ("str is not a list", "fingers[0].name[]"),
        ("field 'z' is not one of x, y", "fingers[0].taxels[].z"),
    )
    every_refusal(TactileError, cases, lambda path: FieldPath(path).get(MESSAGE))
