# SPDX-License-Identifier: Apache-2.0
"""The rows of the self-test: groups of cases, each with what to do if one is not as expected."""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any, Final, Literal

from foretouch.selftest.case import HardCase, fault

State = Literal["ok", "failed", "skipped"]

_REINSTALL: Final = "pip install --force-reinstall foretouch"
_LIBRARIES: Final = "foretouch doctor: compare the versions of numpy, scipy and torch"
_FORMATS: Final = "foretouch doctor: compare the versions of python-neo-lzf, pyarrow and rosbags"


@dataclass(frozen=True)
class RowResult:
    """The outcome of one row."""

    row: str  # its name
    state: State  # "ok", "failed" or "skipped"
    found: str  # what was found, such as "12 of 12 as expected"
    cause: str = ""  # the first case that failed and why, in one line
    fix: str = ""  # what to do about it
    seconds: float = 0.0  # elapsed time

    def to_mapping(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


@dataclass(frozen=True)
class Row:
    """A group of cases."""

    name: str
    cases: Callable[[], Iterator[HardCase]]
    fix: str  # what to do if a case fails


def run_row(row: Row) -> RowResult:
    """Run the cases of a row."""
    began = time.monotonic()
    count, faults = 0, []
    for case in row.cases():
        count += 1
        found = fault(case)
        if found:
            faults.append(f"{case.name}: {found}")
    elapsed = time.monotonic() - began
    counted = f"{count - len(faults)} of {count} as expected"
    if not faults:
        return RowResult(row.name, "ok", counted, seconds=elapsed)
    return RowResult(row.name, "failed", counted, faults[0], row.fix, elapsed)


def timings() -> RowResult:
    """Times of the main steps, for orientation; they fail nothing."""
    from foretouch.cloud.segmentation.segment import segment
    from foretouch.grasp import GeoGraspConfig, plan_grasps
    from foretouch.models import DEFAULT_MODEL, load_model
    from foretouch.selftest.clouds import scene
    from foretouch.selftest.references import exact_cloud, exact_grasps
    from foretouch.types import ASSUMED_TABLE, Cloud

    image, cloud, grasps, model = Cloud(scene(width=848, height=480)), exact_cloud(), exact_grasps(), load_model()
    steps: dict[str, Callable[[], object]] = {
        "segment 848x480": lambda: segment(image),
        "grasp": lambda: plan_grasps(cloud, ASSUMED_TABLE, GeoGraspConfig(method="stable")),
        DEFAULT_MODEL: lambda: model.predict(cloud, grasps),
    }
    began = time.monotonic()
    found = ", ".join(f"{name} {_median_ms(step):.1f} ms" for name, step in steps.items())
    return RowResult("timings", "ok", found, seconds=time.monotonic() - began)


def _median_ms(step: Callable[[], object]) -> float:
    spans = []
    for _ in range(7):
        began = time.perf_counter()
        step()
        spans.append(time.perf_counter() - began)
    return 1e3 * sorted(spans)[len(spans) // 2]


def _clouds() -> Iterator[HardCase]:
    from foretouch.selftest.pipeline import pipeline_cases

    return pipeline_cases()


def _numbers() -> Iterator[HardCase]:
    from foretouch.selftest.numbers import number_cases

    return number_cases()


def _training() -> Iterator[HardCase]:
    from foretouch.selftest.training import label_cases, network_cases

    return chain(label_cases(), network_cases())


def _simulator() -> Iterator[HardCase]:
    from foretouch.selftest.simulator import mesh_cases, scene_cases

    return chain(mesh_cases(), scene_cases())


def _files() -> Iterator[HardCase]:
    from foretouch.selftest.files import file_cases

    return (case for case in file_cases() if case.name.startswith(_SMALL))


_SMALL: Final = tuple(f"files: {name} as " for name in ("0 points", "1 points", "7 points", "any bits", "colours"))


def _damage() -> Iterator[HardCase]:
    from foretouch.selftest.damage import damage_cases

    return damage_cases()


def _references() -> Iterator[HardCase]:
    from foretouch.selftest.references import reference_cases

    return reference_cases()


def _invariances() -> Iterator[HardCase]:
    from foretouch.selftest.references import invariance_cases

    return invariance_cases()


def _models() -> Iterator[HardCase]:
    from foretouch.selftest.shipped import model_cases

    return model_cases()


ROWS: Final = {
    row.name: row
    for row in (
        Row("models", _models, _REINSTALL),
        Row("references", _references, _LIBRARIES),
        Row("invariances", _invariances, _LIBRARIES),
        Row("clouds", _clouds, _REINSTALL),
        Row("numbers", _numbers, _LIBRARIES),
        Row("training", _training, _LIBRARIES),
        Row("simulator", _simulator, _LIBRARIES),
        Row("formats", _files, _FORMATS),
        Row("damaged files", _damage, _FORMATS),
    )
}
"""By name, in the order in which they run."""
