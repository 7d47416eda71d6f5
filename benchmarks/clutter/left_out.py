# SPDX-License-Identifier: Apache-2.0
"""How well segmentation does in images of a source that it did not learn from: `python -m benchmarks.clutter.left_out`.

Each source of real images is left out in turn: trees learn from the simulated images and from all other sources, with the pairs that
`learn.py` kept, and segment its images. `in use` are the trees of the package, which learned from all. Piles and rooms are never
learned from. `chosen` says when a set was last looked at to choose a rule, an input or a threshold.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from multiprocessing import Pool
from pathlib import Path
from typing import Any, Final

from safetensors.numpy import load_file

from benchmarks.clutter import learn, whole
from benchmarks.clutter.metrics import SceneScore
from benchmarks.clutter.scenes import LabelledCloud, load_scenes, real_sources
from benchmarks.common import add_data, markdown, print_rows, replace_marked
from foretouch.base.files import cache_folder
from foretouch.cloud.segmentation import parts
from foretouch.types import Float32

MARKS: Final = ("<!-- left out -->\n", "<!-- end of left out -->\n")  # of the README's table
CHOSEN: Final = "2026-11-29"  # when the sets were last looked at to choose something

Answers = list[tuple[SceneScore, bool, float]]


def without(folder: Path, source: str) -> Float32:
    """Trees that learn from all kept pairs but those of a source."""
    pairs = dict(learn.kept(folder))
    simulated = pairs.pop("")
    return learn.learned(learn.weighted(simulated, {name: one for name, one in pairs.items() if name != source}), learn.LAST)  # fmt: skip


def answers(scenes: Sequence[LabelledCloud], trees: Float32) -> Answers:
    """The scores of scenes by trees."""
    usual, prepared = parts._trees, parts.Trees.of(trees)  # noqa: SLF001  as `learn.Recorder`
    parts._trees = lambda: prepared  # type: ignore[assignment]  # noqa: SLF001
    try:
        return [whole.answer(scene) for scene in scenes]
    finally:
        parts._trees = usual  # noqa: SLF001


def fold(folder: Path, data: Path, source: str) -> dict[str, tuple[Answers, Answers]]:
    """The scores of the whole images of a source, and of those of its database, by trees without it and by those in use."""
    trees, used = without(folder, source), load_file(parts.TREES)["trees"]
    scenes = real_sources(data)[source]
    sets = {source: [one for one in scenes if one.kind == source], f"{source} database": [one for one in scenes if one.kind != source]}  # fmt: skip
    return {name: (answers(some, trees), answers(some, used)) for name, some in sets.items() if some}


def table(folds: dict[str, tuple[Answers, Answers]]) -> list[dict[str, Any]]:
    """A row for each set, and one for all whole images."""
    every = [pair for name, pair in folds.items() if not name.endswith("database")]
    total = [answer for left, _ in every for answer in left], [answer for _, used in every for answer in used]
    rows = []
    for name, (left, used) in [*folds.items(), ("all whole images", total)]:
        row = whole.row(name, left)
        row = {"left out": name, "images": len(left)} | {key: row[key] for key in list(row)[1:-1]}
        rows.append(row | {"found in use": sum(one.n_found for one, *_ in used), "chosen": CHOSEN})
    return rows


def main() -> None:
    """Print the table; write it into the README if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, default=cache_folder("benchmarks") / "learn", help="folder in which learn.py kept the pairs")  # fmt: skip
    parser.add_argument("--also", type=Path, nargs="*", default=[], help="folders of labelled scenes that are never learned from, such as piles and rooms")  # fmt: skip
    parser.add_argument("--jobs", type=int, default=2, help="processes; the result does not depend on them")
    parser.add_argument("--write", action="store_true", help="write the README's table")
    add_data(parser)
    options = parser.parse_args()
    if options.data is None:
        raise SystemExit("FORETOUCH_DATA is not set: real images are needed")
    if not (options.scenes / "pairs-.npz").is_file():
        raise SystemExit(f"{options.scenes}: no pairs are kept there: run python -m benchmarks.clutter.learn first")
    data = Path(options.data)
    with Pool(options.jobs) as workers:
        found = workers.map(partial(fold, options.scenes, data), real_sources(data), chunksize=1)
    rows = table({name: pair for one in found for name, pair in one.items()})
    for folder in options.also:
        same = answers(list(load_scenes(folder)), load_file(parts.TREES)["trees"])
        rows += table({f"{folder.name.split('-')[0]}": (same, same)})[:1]
    print_rows(rows)
    if options.write:
        text = markdown(list(rows[0]), [list(row.values()) for row in rows])
        replace_marked(Path(__file__).with_name("README.md"), text.strip(), *MARKS)


if __name__ == "__main__":
    main()
