# SPDX-License-Identifier: Apache-2.0
"""A loop over the cases of one test that reports each failing case, and not only the first."""

from collections.abc import Callable, Iterable, Mapping
from traceback import extract_tb
from typing import Any

import pytest


def every_case(cases: Mapping[str, Any] | Iterable[Any], check: Callable[..., object]) -> None:
    """Run `check(case)` for each case, `check(*case)` where it is a tuple; fail once, with all failing cases listed.

    Args:
        cases: By name, or a series whose items name themselves: by the first text in a tuple, `__name__`, or `str`.
        check: Fails by an exception. A skip counts as a failure: leave such cases out before.

    Raises:
        AssertionError: With a line for each failing case, from the first one's exception; or if there is no case.
    """
    named = list(cases.items()) if isinstance(cases, Mapping) else [(_name(case), case) for case in cases]
    assert named, "no cases: nothing would be tested"
    failures = {}
    for number, (name, case) in enumerate(named):
        try:
            check(*case) if isinstance(case, tuple) else check(case)
        except (Exception, pytest.fail.Exception, pytest.skip.Exception) as err:  # noqa: BLE001
            failures[f"{number} {name}"] = err
    if failures:
        lines = [f"  {name}: {_line(err)}" for name, err in failures.items()]
        message = "\n".join([f"{len(failures)} of {len(named)} cases failed:", *lines])
        raise AssertionError(message) from next(iter(failures.values()))


def every_refusal(error: type[Exception], cases: Iterable[tuple[Any, ...]], call: Callable[..., object]) -> None:
    """Run `call(*arguments)` for each case (pattern, *arguments); each must raise the error, its message matching."""

    def check(pattern: str, *arguments: Any) -> None:
        with pytest.raises(error, match=pattern):
            call(*arguments)

    every_case(cases, check)


def _name(case: Any) -> str:
    if isinstance(case, tuple):
        case = next((item for item in case if isinstance(item, str)), case)
    return " ".join(str(getattr(case, "__name__", case)).split())[:80]


def _line(err: BaseException) -> str:
    place = extract_tb(err.__traceback__)[1:2]  # the line of the check
    text = (str(err).strip() or "no message").splitlines()[0]
    return f"{type(err).__name__}: {text}" + (f" (line {place[0].lineno})" if place else "")
