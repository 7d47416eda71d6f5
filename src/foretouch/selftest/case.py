# SPDX-License-Identifier: Apache-2.0
"""A hard case: an input at the limits of a layer, and its expected outcome."""

import re
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.errors import ForetouchError

_LONGEST = 1000  # characters of a refusal that a terminal can show


@dataclass(frozen=True, eq=False)
class HardCase:
    """One call and its expected outcome.

    Attributes:
        name: `layer: case`.
        run: Calls the layer; returns numbers, arrays or tensors, all of which must be finite.
        refused: Pattern of the reason with which the call is refused; empty if it is answered.
        right: Whether the answer is right; called with what `run` returned.
    """

    name: str
    run: Callable[[], Any]
    refused: str = ""
    right: Callable[[Any], bool] = lambda _: True


def fault(case: HardCase) -> str:
    """Run a case; returns what is not as expected in one line, or an empty text. Warnings count as faults."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", DeprecationWarning)
            answer = case.run()
    except ForetouchError as err:
        return _wrong_refusal(case, str(err))
    except Exception as err:  # noqa: BLE001 - whatever is no ForetouchError is what is searched for
        return f"{type(err).__name__}: {' '.join(str(err).split())} at {_place(err)}"
    if case.refused:
        return f"is answered, not refused as {case.refused!r}"
    if not all(np.isfinite(part).all() for part in _arrays(answer)):
        return "the answer is not finite"
    return "" if case.right(answer) else f"the answer is wrong: {' '.join(str(answer).split())[:200]}"


def nearly(value: float, relative: float = 1e-6, absolute: float = 0.0) -> Callable[[Any], bool]:
    """A check that all numbers of an answer are near a value."""

    def right(answer: Any) -> bool:
        return all(np.allclose(part, value, rtol=relative, atol=absolute) for part in _arrays(answer))

    return right


def _wrong_refusal(case: HardCase, reason: str) -> str:
    if not case.refused:
        return f"is refused: {reason}"
    if "\n" in reason or len(reason) > _LONGEST:
        return f"is refused with {len(reason)} characters or several lines"
    return "" if re.search(case.refused, reason) else f"is refused for another reason than {case.refused!r}: {reason}"


def _arrays(answer: Any) -> Iterable[npt.NDArray[Any]]:
    """All numbers of an answer, in float64."""
    if answer is None or isinstance(answer, str | bool):
        return
    if isinstance(answer, dict):
        answer = list(answer.values())
    if isinstance(answer, list | tuple):
        for part in answer:
            yield from _arrays(part)
        return
    if hasattr(answer, "detach"):  # a tensor; bfloat16 has no NumPy type
        answer = answer.detach().double().numpy()
    yield np.asarray(answer, np.float64)


def _place(err: BaseException) -> str:
    """File and line where an error was raised."""
    trace = err.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "?" if trace is None else f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
