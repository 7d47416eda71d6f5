# SPDX-License-Identifier: Apache-2.0
"""Use of `foretouch_lab`: a robot imports none of it unless a command or a simulated source asks for a part."""

from collections.abc import Iterator
from contextlib import contextmanager
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
