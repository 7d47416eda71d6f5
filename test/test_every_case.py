# SPDX-License-Identifier: Apache-2.0
import pytest
from every_case import every_case, every_refusal


def _is_small(number: int, limit: int = 3) -> None:
    assert number < limit, f"{number} is not below {limit}\nmore lines"


def test_cases_are_passed_by_name_or_as_arguments() -> None:
    seen: list[object] = []
    every_case({"one": 1, "pair": (2, 3)}, lambda *case: seen.append(case))
    every_case(iter([4, (5, 6)]), lambda *case: seen.append(case))
    assert seen == [(1,), (2, 3), (4,), (5, 6)]


def test_every_failing_case_is_listed_in_one_line() -> None:
    with pytest.raises(AssertionError) as caught:
        every_case({"low": 1, "high": 7, "pair": (5, 4), "not a number": "x"}, _is_small)
    first, *lines = str(caught.value).splitlines()
    assert first == "3 of 4 cases failed:"
    assert [line.split(" (line")[0] for line in lines] == [
        "  1 high: AssertionError: 7 is not below 3",
        "  2 pair: AssertionError: 5 is not below 4",
        "  3 not a number: TypeError: '<' not supported between instances of 'str' and 'int'",
    ]
    assert "7 is not below 3" in str(caught.value.__cause__)


def test_no_case_a_skipped_case_and_a_refusal_that_does_not_come_or_reads_otherwise_fail() -> None:
    with pytest.raises(AssertionError, match="no cases"):
        every_case([], _is_small)
    with pytest.raises(AssertionError, match="1 of 2 cases failed:\n  1 x: Skipped: not here"):
        every_case([1, ("x",)], lambda case: pytest.skip("not here") if case == "x" else None)
    with pytest.raises(AssertionError, match=r"2 of 3 cases failed:\n  1 none: .*DID NOT RAISE"):
        every_refusal(ValueError, [("invalid", "x"), ("none", "1"), ("other", "x")], int)
