# SPDX-License-Identifier: Apache-2.0
"""Does segmentation find all objects, and how exactly, beside a pipeline of Open3D? See README.md."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.common import print_rows
from foretouch.cloud.segmentation.segment import segment
from foretouch.types import Cloud
from foretouch_lab.experiments.tradeoff_perception import overlaps
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT, random_scene

Labels = npt.NDArray[np.int32]
N_OBJECTS = 3
OBJECTS = range(FIRST_OBJECT, FIRST_OBJECT + N_OBJECTS)  # labels in the truth
N_SCENES = 50


def open3d_pipeline(cloud: Cloud) -> Labels:
    """A common pipeline: crop, RANSAC plane, DBSCAN of the points above it, small clusters dropped."""
    from foretouch.camera.device import ensure_libusb

    ensure_libusb()
    import open3d

    flat = cloud.xyz.reshape(-1, 3)
    with np.errstate(invalid="ignore"):
        index = np.flatnonzero((flat[:, 2] > 0.16) & (flat[:, 2] < 2.0))
    points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(flat[index].astype(np.float64)))
    open3d.utility.random.seed(0)
    plane, _ = points.segment_plane(0.01, 3, 100)
    plane = np.array(plane) * np.sign(plane[3])
    above = flat[index] @ plane[:3] + plane[3] > 0.006
    objects = points.select_by_index(np.flatnonzero(above))
    clusters = np.asarray(objects.cluster_dbscan(0.01, 10)) + 1
    keep = np.bincount(clusters) >= 150
    keep[0] = False
    labels = np.zeros(len(flat), np.int32)
    labels[index[above]] = np.where(keep, np.cumsum(keep), 0)[clusters]
    return labels.reshape(cloud.xyz.shape[:-1])


def scenes() -> Iterator[tuple[str, Cloud, Labels]]:
    """In two sizes a generated scene, clean, noisy and with flying pixels, and the shared one if available."""
    for width, height in ((848, 480), (1280, 720)):
        for name, noise_m, flying in (("exact", 0.0, False), ("noise", 0.0015, False), ("flying", 0.0015, True)):
            rng = np.random.default_rng(1)
            image = random_scene(rng, width, height).render(rng, noise_m, flying)
            yield f"{width}x{height} {name}", image.cloud(), image.labels
        shared = Path(os.environ.get("FORETOUCH_DATA", "")) / "scenes" / f"oblique_{width}x{height}.npz"
        if shared.is_file():
            with np.load(shared) as scene:
                yield f"{width}x{height} oblique", Cloud(scene["xyz"]), scene["labels"].astype(np.int32)


def generated(noise_m: float, flying: bool) -> dict[str, object]:
    """Scenes in which another number of objects is found, and the overlaps of all."""
    wrong, found = 0, []
    for seed in range(N_SCENES):
        rng = np.random.default_rng(seed)
        image = random_scene(rng).render(rng, noise_m, flying)
        labels = segment(image.cloud()).labels
        wrong += int(labels.max()) != N_OBJECTS
        found += overlaps(labels, image.labels, OBJECTS)
    return {"wrong number": wrong, "least IoU": f"{min(found):.3f}", "mean IoU": f"{float(np.mean(found)):.3f}"}


def main() -> None:
    """Print both tables."""
    rows = []
    for name, cloud, truth in scenes():
        row: dict[str, object] = {"scene": name}
        for who, labels in (("", segment(cloud).labels), ("Open3D ", open3d_pipeline(cloud))):
            texts = (f"{value:.3f}" for value in overlaps(labels, truth, OBJECTS))
            row |= {f"{who}objects": labels.max(), f"{who}IoU": "/".join(texts)}
        rows.append(row)
    print_rows(rows)
    print(f"\n{N_SCENES} generated scenes of {N_OBJECTS} objects, 848x480")
    effects = {"exact": (0.0, False), "noise 1 mm": (0.001, False), "and flying": (0.001, True)}
    print_rows([{"effects": name} | generated(*given) for name, given in effects.items()])


if __name__ == "__main__":
    main()
