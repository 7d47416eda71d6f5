# SPDX-License-Identifier: Apache-2.0
"""Sphinx extension: inserts what `reference` makes, and leads links to files outside of the site to the repository.

A page asks for generated text with a fenced block, whose content is what a reader of the file itself sees::

    ```{generated} messages
    Made from foretouch_msgs when the site is built.
    ```
"""

import dataclasses
import inspect
import re
from pathlib import Path
from typing import Any

from reference import GENERATORS
from sphinx.application import Sphinx

REPOSITORY = "https://github.com/foretouch/foretouch"
GENERATED = re.compile(r"^```\{generated\} (\w+)\n.*?^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(
    r"(?<!!)\[(?P<text>(?:[^\[\]]|!?\[[^\]]*\]\([^)]*\))*)\]\((?P<target>[^)\s#:]+)(?P<anchor>#[^)\s]*)?\)"
)


def outward(text: str, page: Path, site: Path) -> str:
    """The text of a page with links that leave the site, or name a folder, as addresses of the repository."""
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
        text = outward(content[0], page, Path(app.srcdir).resolve())
        content[0] = GENERATED.sub(lambda match: GENERATORS[match[1]](), text)


def _outdated(app: Sphinx, *_: Any) -> list[str]:
    """Pages with generated text are read again at each build."""
    pages = (Path(app.env.doc2path(name)) for name in app.env.found_docs)
    return [app.env.path2doc(page) or "" for page in pages if GENERATED.search(page.read_text(encoding="utf-8"))]


def field_comments(cls: type) -> dict[str, str]:
    """The description of each field that a dataclass declares itself: of `setting(...)`, or the comment beside it."""
    source = inspect.getsource(cls)
    found = {}
    for field in dataclasses.fields(cls):
        beside = re.search(rf"^    {field.name}: [^#\n]*#\s*(?!noqa|fmt)(.+)$", source, re.MULTILINE)
        if field.name in cls.__annotations__ and ("description" in field.metadata or beside):
            found[field.name] = field.metadata.get("description") or (beside[1] if beside else "")
    return found


def _describe_fields(_: Sphinx, what: str, __: str, documented: Any, ___: Any, lines: list[str]) -> None:
    if what == "class" and dataclasses.is_dataclass(documented) and isinstance(documented, type):
        comments = field_comments(documented)
        lines += ["", *(f":ivar {name}: {comment}" for name, comment in comments.items()), ""]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.connect("source-read", _read)
    app.connect("env-get-outdated", _outdated)
    app.connect("autodoc-process-docstring", _describe_fields)
    return {"parallel_read_safe": True}
