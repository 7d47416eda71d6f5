# SPDX-License-Identifier: Apache-2.0
"""Sphinx extension: leads links to files outside of the site to the repository, and describes the fields of dataclasses."""

import dataclasses
import inspect
import re
from pathlib import Path
from typing import Any, get_type_hints

from sphinx.application import Sphinx
from sphinx.util.typing import stringify_annotation

from foretouch.config import Settings

REPOSITORY = "https://github.com/foretouch/foretouch"
LINK = re.compile(
    r"(?<!!)\[(?P<text>(?:[^\[\]]|!?\[[^\]]*\]\([^)]*\))*)\]\((?P<target>[^)\s#:]+)(?P<anchor>#[^)\s]*)?\)"
)


def outward(text: str, page: Path, site: Path) -> str:
    """Return the text of a page with links that leave the site, or name a folder, as addresses of the repository."""
    root = site.parent

    def lead(match: re.Match[str]) -> str:
        target = (page.parent / match["target"]).resolve()
        if target.is_relative_to(site) and target.is_file():
            return match[0]
        kind = "tree" if target.is_dir() else "blob"
        return f"[{match['text']}]({REPOSITORY}/{kind}/main/{target.relative_to(root)}{match['anchor'] or ''})"

    return LINK.sub(lead, text)


def _read(app: Sphinx, docname: str, content: list[str]) -> None:
    page = Path(app.env.doc2path(docname)).resolve()
    if page.suffix == ".md":
        content[0] = outward(content[0], page, Path(app.srcdir).resolve())


def field_comments(cls: type) -> dict[str, str]:
    """Return the description of each field that a dataclass declares itself: of `setting(...)`, or the comment beside it."""
    source = inspect.getsource(cls)
    comments = {}
    for field in dataclasses.fields(cls):
        beside = re.search(rf"^    {field.name}: [^#\n]*#\s*(?!noqa|fmt)(.+)$", source, re.MULTILINE)
        if field.name in cls.__annotations__ and ("description" in field.metadata or beside):
            comments[field.name] = field.metadata.get("description") or (beside[1] if beside else "")
    return comments


def _short(annotation: str) -> str:
    """Return an annotation with arrays as `NDArray[float64]`."""
    array = r"~?numpy\.ndarray\[tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[~?numpy\.(\w+)\]\]"
    return re.sub(array, r"NDArray[\1]", annotation)


def _describe_fields(_: Sphinx, what: str, __: str, documented: Any, ___: Any, lines: list[str]) -> None:
    """Add fields that are described beside them, and the types of all that are described (napoleon ran before)."""
    if what != "class" or not dataclasses.is_dataclass(documented) or not isinstance(documented, type):
        return
    lines += ["", *(f":ivar {name}: {comment}" for name, comment in field_comments(documented).items())]
    described = {line.split()[1].rstrip(":") for line in lines if line.startswith(":ivar ")}
    for name, hint in get_type_hints(documented).items():
        if name in described:
            lines.append(f":vartype {name}: {_short(stringify_annotation(hint, 'smart'))}")
    lines.append("")


def _hide_signature(_: Sphinx, what: str, __: str, documented: Any, ___: Any, ____: str, _____: str) -> Any:
    """Settings have dozens of keyword arguments, which are their fields."""
    return ("(…)", None) if what == "class" and issubclass(documented, Settings) else None


def _shorten_types(app: Sphinx, *_: Any) -> None:
    """Shorten the types that autodoc is about to add to an object."""
    for types in app.env.current_document.autodoc_annotations.values():
        types.update({name: _short(kind) for name, kind in types.items()})


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.connect("source-read", _read)
    app.connect("autodoc-process-docstring", _describe_fields)
    app.connect("autodoc-process-signature", _hide_signature)
    app.connect("object-description-transform", _shorten_types, priority=100)
    return {"parallel_read_safe": True}
