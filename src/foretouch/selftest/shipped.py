# SPDX-License-Identifier: Apache-2.0
"""The models that come with the package: their hashes, and their answers on a made cloud against stored values.

`python -m foretouch.selftest.shipped` stores the values again, after a model was released or its features were changed.
"""

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.checked_files import read_json
from foretouch.errors import ModelError
from foretouch.selftest.case import HardCase
from foretouch.selftest.references import exact_cloud, exact_grasps
from foretouch.types import TOUCH_SIZE

TOLERANCE_COUNTS: Final = 0.5
"""Largest difference between processors: half of what a reading resolves. One bit in each coordinate moves 0.002."""

_EXPECTED: Final = Path(__file__).with_name("expected.json")


def model_cases() -> Iterator[HardCase]:
    """Hash and answers of each model, and the models that there should be."""
    from foretouch.models import available_models

    expected = read_json(_EXPECTED)
    for name in sorted({*expected, *available_models()}):
        yield HardCase(
            f"model: {name}",
            partial(_difference, name, expected.get(name)),
            right=lambda d: bool(d <= TOLERANCE_COUNTS),
        )


def _difference(name: str, expected: Any) -> float:
    """Largest difference from the stored values [counts]."""
    if expected is None:
        raise ModelError(f"{name}: has no stored values to compare with")
    found = _answers(name)
    if found["sha256"] != expected["sha256"]:
        raise ModelError(f"{name}: sha256: {found['sha256']} is not {expected['sha256']} of this version")
    shape = (len(exact_grasps()), 3, TOUCH_SIZE)
    return float(np.abs(np.reshape(found["counts"], shape) - np.reshape(expected["counts"], shape)).max())


def _answers(name: str) -> dict[str, Any]:
    """Hash, and values and bounds for each grasp [counts]."""
    from foretouch.models import load_model

    model = load_model(name)
    rows = []
    for one in model.predict(exact_cloud(), exact_grasps()):
        if one.value is None or one.lower is None or one.upper is None:
            raise ModelError(f"{name}: {one.reason or 'has no bounds'}")
        rows += [part.vector().round(3).tolist() for part in (one.value, one.lower, one.upper)]
    return {"sha256": model.sha256, "counts": rows}


def store() -> None:
    """Store the values of all models of the package."""
    from foretouch.models import available_models

    found = {name: _answers(name) for name in sorted(available_models())}
    lines = [f' "{name}": {json.dumps(one)}' for name, one in found.items()]
    _EXPECTED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    store()
