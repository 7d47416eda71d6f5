# SPDX-License-Identifier: Apache-2.0
"""A hard case is an input at the limits of a layer: a right answer or a refusal by name is expected, and no warning.

Cases are tuples for `every_case(cases, check_outcome)`: a name, a function, and what is expected of it, see there.
"""

import re
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from foretouch.errors import ForetouchError

LONGEST = 1000  # characters of a refusal that a terminal can show


def check_outcome(name: str, run: Callable[[], Any], expected: str | Callable[[Any], bool] | None = None) -> None:
    """Call the layer.

    Args:
        name: `layer: case`.
        run: Returns numbers, arrays or tensors, all of which must be finite.
        expected: Pattern of the reason with which the call is refused; whether an answer is right; None for any.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", DeprecationWarning)
            answer = run()
    except ForetouchError as err:
        reason = str(err)
        assert isinstance(expected, str), f"is refused: {reason}"
        assert "\n" not in reason, "is refused in several lines"
        assert len(reason) <= LONGEST, f"is refused with {len(reason)} characters"
        assert re.search(expected, reason), f"is refused for another reason than {expected!r}: {reason}"
        return
    assert not isinstance(expected, str), f"is answered, not refused as {expected!r}"
    assert all(np.isfinite(part).all() for part in numbers(answer)), "the answer is not finite"
    assert expected is None or expected(answer), f"the answer is wrong: {' '.join(str(answer).split())[:200]}"


def nearly(value: float, relative: float = 1e-6) -> Callable[[Any], bool]:
    """A check that all numbers of an answer are near a value."""
    return lambda answer: all(np.allclose(part, value, rtol=relative, atol=0.0) for part in numbers(answer))


def numbers(answer: Any) -> Iterator[Any]:
    """All numbers of an answer, in float64."""
    if isinstance(answer, dict | list | tuple):
        for part in answer.values() if isinstance(answer, dict) else answer:
            yield from numbers(part)
    elif answer is not None and not isinstance(answer, str | bool):
        # A tensor in bfloat16 has no NumPy type.
        yield np.asarray(answer.detach().double() if hasattr(answer, "detach") else answer, np.float64)
