# SPDX-License-Identifier: Apache-2.0
"""A package of somebody else, as pip leaves it in a folder: its modules, and the entry points by which it adds parts to foretouch."""

from collections.abc import Mapping
from pathlib import Path


def install(
    site: Path, parts: Mapping[str, Mapping[str, str]], modules: Mapping[str, str] | None = None, name: str = "others"
) -> None:
    """Write a package into a folder that is on `sys.path`, or will be.

    Args:
        site: The folder; it is created.
        parts: Places (`module:attribute`) by name, by group of entry points.
        modules: Code of its modules, by name.
        name: Of the package.
    """
    info = site / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    lines = [
        line
        for group, places in parts.items()
        for line in (f"[{group}]", *(f"{part} = {place}" for part, place in places.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines), encoding="utf-8")
    for module, code in (modules or {}).items():
        (site / f"{module}.py").write_text(code, encoding="utf-8")
