# SPDX-License-Identifier: Apache-2.0
"""Are objects that touch separated, beside PCL's local convexity and clusters alone? See README.md."""

import argparse
import hashlib
import operator
import tempfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.clutter import frontier, models, physics, piles, rooms, whole
from benchmarks.clutter.metrics import SceneScore, score, summary
from benchmarks.clutter.scenes import LabelledCloud, load_scenes, recorded_objects, segment_anew
from benchmarks.common import add_data, cpu_ms, markdown, print_rows, read_csv, replace_marked, write_csv
from foretouch.base.files import cache_folder
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.types import Int32
from foretouch_lab.experiments.peers import has_lccp, lccp

HERE: Final = Path(__file__).parent
OURS, CLUSTERS, LCCP, PERFECT = "foretouch", "clusters alone", "LCCP of PCL", "perfect splitting of the clusters"
_METHODS: Final = (OURS, CLUSTERS, PERFECT, LCCP)
_REPEATS: Final = 5
_PEER_RUNS: Final = 3
_COLUMNS: Final = ("precision", "recall", "f", "found", "merged", "cut", "none")


def table(name: str, scenes: Sequence[LabelledCloud]) -> list[dict[str, Any]]:
    """A row for each method over all scenes, and for each kind of scene."""
    nan, plain = float("nan"), SegmentationConfig().updated({"split.angle_deg": 180.0})  # which does not split
    found: dict[str, list[tuple[SceneScore, float, float]]] = {method: [] for method in (OURS, CLUSTERS, PERFECT)}
    every: list[Int32] = []  # clusters of each scene
    for scene in scenes:
        ours, clusters, true = (
            _measured(scene, labels)
            for labels in (segment(scene.cloud).labels, segment(scene.cloud, plain).labels, scene.labels)
        )
        jobs = [partial(segment_anew, scene.cloud, config) for config in (None, plain)]  # in turn
        whole_ms, alone_ms = np.min([[cpu_ms(job, 1) for job in jobs] for _ in range(_REPEATS)], axis=0).tolist()
        found[OURS].append((score(ours, true), whole_ms, whole_ms - alone_ms))
        found[CLUSTERS].append((score(clusters, true), alone_ms, nan))
        found[PERFECT].append((score(np.where(clusters > 0, true, 0), true), nan, nan))
        every.append(clusters)
    if not has_lccp():
        print(f"{LCCP} is not measured (apt-get install libpcl-dev g++); the written rows keep the day they were taken")
    else:
        found[LCCP] = []
        for scene, clusters, (_, alone_ms, _) in zip(scenes, every, found[CLUSTERS], strict=True):
            split = partial(lccp, scene.cloud, clusters)
            ms = cpu_ms(split, _PEER_RUNS, least=True)
            found[LCCP].append((score(split(), _measured(scene, scene.labels)), alone_ms + ms, ms))
    kinds, rows = ["all", *dict.fromkeys(scene.kind for scene in scenes)], []
    for kind in kinds if len(kinds) > 2 else kinds[:1]:
        for method, answers in found.items():
            some = [answer for scene, answer in zip(scenes, answers, strict=True) if kind in {"all", scene.kind}]
            means = summary(one for one, *_ in some)
            row = {"scenes": name, "kind": kind, "count": len(some), "method": method}
            row |= {column: round(means[column], 3) for column in _COLUMNS}
            row |= {"whole_ms": _median([ms for _, ms, _ in some]), "splitting_ms": _median([ms for *_, ms in some])}
            row["taken"] = datetime.now(tz=UTC).date().isoformat()
            rows.append(row)
    return rows


def _measured(scene: LabelledCloud, labels: Int32) -> Int32:
    """The labels of pixels with depth, 0 elsewhere."""
    return np.where(np.isfinite(scene.cloud.xyz[..., 2]), labels, 0).astype(np.int32)


def _median(values: Sequence[float]) -> float | None:
    return None if np.isnan(values).any() else round(float(np.median(values)), 2)


def pieces(name: str, scenes: Sequence[LabelledCloud]) -> dict[str, Any]:
    """Of scenes of one object: how often it is one object, none, or several."""
    counts = np.array([segment(scene.cloud).labels.max() for scene in scenes])
    worst = sorted({scene.name.rstrip("0123456789") for scene, n in zip(scenes, counts, strict=True) if n > 1})
    return {
        "objects alone": name,
        "count": len(counts),
        "in one piece": round(float(np.mean(counts == 1)), 3),
        "none": int((counts == 0).sum()),
        "several": int((counts > 1).sum()),
        "of them": " ".join(worst),
    }


def kept(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The measured rows, and those of the written table that could not be measured now, with the day they were taken: PCL's without PCL."""
    key = operator.itemgetter("scenes", "kind", "method")
    kinds = list(dict.fromkeys((row["scenes"], row["kind"]) for row in rows))
    old = [
        row for row in read_csv(HERE / "results.csv") if key(row)[:2] in kinds and key(row) not in set(map(key, rows))
    ]
    both = [*rows, *({name: row.get(name, "") for name in rows[0]} for row in old)]
    return sorted(both, key=lambda row: (kinds.index(key(row)[:2]), _METHODS.index(row["method"])))


def made(kind: str, write: Callable[[Path], object], *identity: object) -> Path:
    """A folder of scenes that are made once for each version of what makes them."""
    sources = [
        Path(module.__file__ or "").read_bytes()
        for module in (piles, models, physics, *([rooms] if kind == "rooms" else []))
    ]
    name = hashlib.sha256(b"".join([*sources, repr(identity).encode()])).hexdigest()[:16]
    folder = cache_folder("benchmarks") / f"{kind}-{name}"
    if not folder.is_dir():
        with tempfile.TemporaryDirectory(dir=cache_folder("benchmarks")) as temporary:
            write(Path(temporary) / kind)
            (Path(temporary) / kind).rename(folder)
    return folder


def main() -> None:
    """Print the tables; write them beside this file if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=Path, nargs="*", default=[], help="more folders of labelled scenes")
    parser.add_argument("--count", type=int, default=200, help="number of piles")
    parser.add_argument("--rooms", type=int, default=84, help="number of rooms")
    parser.add_argument("--seed", type=int, default=0, help="of the piles")
    parser.add_argument("--frontier", action="store_true", help="F against time over settings of the splitting instead")
    parser.add_argument("--every", type=int, default=1, help="use every N-th scene of each set")
    parser.add_argument("--write", action="store_true", help="write results.csv and the README's tables")
    add_data(parser)
    options = parser.parse_args()
    data = None if options.data is None else Path(options.data)
    sets = {"OSD": data / "osd"} if data is not None and (data / "osd").is_dir() else {}
    sets |= {folder.name: folder for folder in options.scenes}
    identity = options.seed, str(data)
    if find_spec("mujoco") is None:
        raise SystemExit("piles need MuJoCo: pip install 'foretouch[physics]'")
    sets["piles"] = made("piles", lambda out: piles.write_piles(out, options.count, options.seed, data), options.count, *identity)  # fmt: skip
    if options.frontier and data is not None and (data / "real_scenes").is_dir():
        sets["images"] = data / "real_scenes"
    if options.frontier:
        frontier.run({name: list(islice(load_scenes(folder), 0, None, options.every)) for name, folder in sets.items()}, write=options.write)  # fmt: skip
        return
    single = made("single", lambda out: piles.write_singles(out, options.seed, data), *identity)
    rows = []
    for name, folder in sets.items():
        scenes = list(islice(load_scenes(folder), 0, None, options.every))
        rows += table(name, scenes)
    print_rows(rows)
    rendered = list(load_scenes(single))  # views in turn
    alone = [pieces("rendered, obliquely", rendered[::2]), pieces("rendered, from above", rendered[1::2])]
    if data is not None and (data / "vision2tactile").is_dir():
        alone.append(pieces("recorded", list(recorded_objects(data / "vision2tactile"))))
    images = data / "real_scenes" if data is not None else None
    views = whole.rows(list(load_scenes(images))) if images is not None and images.is_dir() else []
    of_rooms = made(
        "rooms", lambda out: rooms.write_rooms(out, options.rooms, options.seed, data), options.rooms, *identity
    )
    in_rooms = whole.kinds(islice(load_scenes(of_rooms), 0, None, options.every))
    for more in (alone, views, in_rooms):
        print()
        print_rows(more)
    if options.write:
        rows = kept(rows)
        write_csv(HERE / "results.csv", rows)
        tables = (markdown(list(some[0]), [["" if cell is None else cell for cell in row.values()] for row in some]) for some in (rows, alone, views, in_rooms) if some)  # fmt: skip
        replace_marked(HERE / "README.md", "\n".join(tables).strip())


if __name__ == "__main__":
    main()
