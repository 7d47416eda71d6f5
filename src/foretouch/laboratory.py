# SPDX-License-Identifier: Apache-2.0
"""Parts of `foretouch_lab` by name: a robot imports none of them unless a command or a simulated source asks for one."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Final

from foretouch.errors import MissingDependencyError

_NEEDED: Final = {
    "foretouch_lab": "foretouch_lab",
    "embreex": "embreex",
    "sklearn": "scikit-learn",
    "threadpoolctl": "threadpoolctl",
    "trimesh": "trimesh",
}
"""Distributions that only the laboratory needs, by the name under which they are imported."""


def laboratory(module: str, user: str) -> ModuleType:
    """Import a module of the laboratory.

    Args:
        module: Its name below `foretouch_lab`, such as `simulation.scene_camera`.
        user: Command or setting that needs it, for the error message.

    Raises:
        MissingDependencyError: If it, or a library that it needs, is not installed.
    """
    with needs_laboratory(user):
        return importlib.import_module(f"foretouch_lab.{module}")


@contextmanager
def needs_laboratory(user: str) -> Iterator[None]:
    """Report a missing library of the laboratory as a `MissingDependencyError` that names the extra to install."""
    try:
        yield
    except ModuleNotFoundError as err:
        top = (err.name or "").partition(".")[0]
        if top not in _NEEDED:
            raise
        raise MissingDependencyError(f"{user}: {_NEEDED[top]} is not installed: pip install 'foretouch[lab]'") from err
