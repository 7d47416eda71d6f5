# SPDX-License-Identifier: Apache-2.0
"""Run the examples of docs/api, and put what they print into the pages: `python docs/_ext/api_pages.py`.

The blocks of a page are one program, which runs in a folder with links to `examples`, `config` and `docs`. A block of text behind a
block of Python is what it printed; pictures are written where the page shows them.
"""

import contextlib
import io
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs" / "api").glob("*.md"))
BLOCK = re.compile(r"```python\n(.*?)```\n(?:\n```text\n(.*?)```\n)?", re.DOTALL)


def code_lines(page: Path) -> int:
    """Return the number of lines of the program of a page, without empty ones, comments and imports."""
    lines = "\n".join(match[1] for match in BLOCK.finditer(page.read_text(encoding="utf-8"))).splitlines()
    return sum(bool(line.strip()) and not line.lstrip().startswith(("#", "import ", "from ")) for line in lines)


def run(page: Path, pictures: Path) -> Iterator[tuple[str, str, str]]:
    """Run a page, and iterate over its blocks, each with what it printed and what the page says that it prints; pictures go to a folder `docs`."""
    names: dict[str, object] = {"__name__": "__main__"}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name, place in (("examples", ROOT / "examples"), ("config", ROOT / "config"), ("docs", pictures)):
            Path(name).symlink_to(place)
        for match in BLOCK.finditer(page.read_text(encoding="utf-8")):
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile(match[1], str(page), "exec"), names)  # noqa: S102  the examples of this repository
            yield match[1], printed.getvalue(), match[2] or ""


def main() -> None:
    """Write what the examples print into the pages."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        printed = iter([out for _, out, _ in run(page, ROOT / "docs")])

        def block(match: re.Match[str], printed: Iterator[str] = printed) -> str:
            out = next(printed)
            return f"```python\n{match[1]}```\n" + (f"\n```text\n{out}```\n" if out else "")

        page.write_text(BLOCK.sub(block, text), encoding="utf-8")


if __name__ == "__main__":
    main()
