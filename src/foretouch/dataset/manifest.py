# SPDX-License-Identifier: Apache-2.0
"""Manifests of datasets: JSON with a format, a schema version, and a checksum over the rest of the text."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foretouch import __version__
from foretouch.checked_files import TEXT_LIMIT, parse_json, read_bytes
from foretouch.errors import FileError, VersionError, shown


def require_version(found: Any, known: int) -> None:
    """Refuse a schema version other than `known` with a `VersionError`."""
    if found != known or isinstance(found, bool):
        newer = isinstance(found, int) and found > known
        advice = "it was written by a newer foretouch" if newer else f"foretouch {__version__} supports no other"
        raise VersionError(f"schema_version: {shown(found)} is not {known}: {advice}")


def sealed(content: Mapping[str, Any], seal: str) -> str:
    """The text of a manifest with its checksum under the name `seal`; equal content gives equal text."""
    body = {name: value for name, value in content.items() if name != seal}
    digest = hashlib.sha256(json.dumps(body, sort_keys=True, allow_nan=False).encode()).hexdigest()
    return json.dumps({**body, seal: digest}, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def read_manifest(file: Path, kind: str, version: int, seal: str) -> dict[str, Any]:
    """The content of a manifest.

    Raises:
        FileError: If it is absent, no JSON, of another format or schema version, or changed.
    """
    text = read_bytes(file, TEXT_LIMIT)
    try:
        content = parse_json(text.decode("utf-8"))
    except ValueError as err:
        raise FileError(file, f"is no JSON: {' '.join(str(err).split())}") from err
    if not isinstance(content, dict) or content.get("format") != kind:
        raise FileError(file, f"is not {kind}", field="format")
    try:
        require_version(content.get("schema_version"), version)
        unchanged = sealed(content, seal).encode() == text
    except VersionError as err:
        raise FileError(file, str(err)) from err
    except ValueError:  # numbers that are not finite
        unchanged = False
    if not unchanged:
        raise FileError(file, "damaged: the text does not match its checksum", field=seal)
    return content
