# SPDX-License-Identifier: Apache-2.0
"""Columns as a table of pandas and as a dataset of xarray; both are optional packages."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from foretouch.errors import MissingDependencyError
from foretouch.types.arrays import AnyArray
from foretouch.types.channels import Channels

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


class Variable(NamedTuple):
    """An array with a name for each of its dimensions."""

    dims: tuple[str, ...]  # the first counts the rows
    values: AnyArray
    unit: str = ""


@dataclass(frozen=True, eq=False)
class LabelledTable:
    """Arrays of K rows whose dimensions have names, and labels along them."""

    variables: Mapping[str, Variable]
    labels: Mapping[str, tuple[Any, ...]]  # along the dimensions but the first
    facts: Mapping[str, str] = field(default_factory=dict)  # of all of them, such as the sensor

    def columns(self) -> Iterator[tuple[str, AnyArray]]:
        """Iterate over the names and numbers of the columns of a flat table."""
        for name, (dims, values, _) in self.variables.items():
            for labels in product(*(enumerate(self.labels[dim]) for dim in dims[1:])):
                place: tuple[Any, ...] = (slice(None), *(k for k, _ in labels))
                yield "_".join([name, *(str(label) for _, label in labels)]), values[place]


class Tabular:
    """Base of types with rows that become a table."""

    def _table(self) -> LabelledTable:
        raise NotImplementedError

    def to_pandas(self) -> "DataFrame":
        """Return a `pandas.DataFrame` with a row for each grasp.

        What has several numbers has a column for each, such as `g1_x`, `PDC_TH_value` and `E_TH_24_lower`; `attrs` names the sensor.

        Raises:
            MissingDependencyError: If pandas is not installed.
        """
        shown = self._table()
        table = _optional("pandas").DataFrame(dict(shown.columns()))
        table.attrs.update(shown.facts)
        return table

    def to_xarray(self) -> "Dataset":
        """Return an `xarray.Dataset` with named dimensions, such as (row, finger, taxel), and units in `attrs`.

        Raises:
            MissingDependencyError: If xarray is not installed.
        """
        table = self._table()
        variables = {
            name: (dims, values, {"units": unit} if unit else {})
            for name, (dims, values, unit) in table.variables.items()
        }
        used = {dim for one in table.variables.values() for dim in one.dims[1:]}
        labels = {dim: list(labels) for dim, labels in table.labels.items() if dim in used}
        dataset: Dataset = _optional("xarray").Dataset(variables, labels, dict(table.facts))
        return dataset


def labels_of(channels: Channels) -> dict[str, tuple[Any, ...]]:
    """Return the labels along dimensions of grasps and readings."""
    taxels = max((channel.size for channel in channels.channels), default=0)
    labels = {"axis": ("x", "y", "z"), "hand_axis": tuple("XYZ"), "end": ("value", "lower", "upper")}
    return {**labels, "finger": channels.fingers, "taxel": tuple(range(1, taxels + 1))}


def texts(column: Any) -> AnyArray:
    """Return a column of texts, or of tuples of them, as an array of texts."""
    return np.array([", ".join(one) if isinstance(one, tuple) else str(one) for one in column], np.str_)


def _optional(name: str) -> ModuleType:
    """Import an optional package, or say how to install it."""
    from importlib import import_module

    try:
        return import_module(name)
    except ModuleNotFoundError as err:
        raise MissingDependencyError(
            f"to_{name}: {err.name} is not installed: pip install 'foretouch[tables]'"
        ) from err
