# SPDX-License-Identifier: Apache-2.0
"""Draw pictures of the documents: python docs/drawings.py [PICTURE].

`steps` and `frames`, of docs/concepts.md, show one simulated scene, as the pipeline sees it with its default settings.

`touch_recorded` shows grasps of the public recordings (FORETOUCH_DATA) that the model was not fitted to: the recipe of
`contact-v2` is fitted to all but the last fifth of each object's grasps, in order of time. Of that last fifth, the grasps
are drawn whose mean electrode error lies at the lower quartile, the median and the upper quartile.
"""

import os
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d.axes3d import Axes3D
from PIL import Image

from foretouch.pipeline import Pipeline, PipelineResult
from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Prediction

FOLDER = Path(__file__).parent
AXES = ("tab:red", "tab:green", "tab:blue")  # x, y, z as in RViz
POINTS = 1800  # drawn at most


def scene() -> tuple[Cloud, PipelineResult]:
    """A cloud with the table in view, and what the pipeline makes of it."""
    from foretouch_lab.simulation.depth_scene import random_scene

    cloud = random_scene(np.random.default_rng(3), width=424, height=240, n_objects=3).render().cloud()
    return cloud, Pipeline().run(cloud)


def thinned(xyz: np.ndarray) -> np.ndarray:
    """(M, 3) finite points, few enough to draw."""
    finite = xyz.reshape(-1, 3)[np.isfinite(xyz.reshape(-1, 3)).all(axis=1)]
    return np.random.default_rng(0).permutation(finite)[:POINTS]  # a stride would draw stripes


def draw_points(ax: Axes, xyz: np.ndarray, colour: str | np.ndarray, size: float = 2.0) -> None:
    """Points as the camera sees them: x to the right, y down [m]."""
    ax.scatter(xyz[:, 0], xyz[:, 1], c=colour, s=size, linewidths=0)


def draw_steps(cloud: Cloud, result: PipelineResult) -> None:
    """Cloud, objects, grasp, touch."""
    figure, (seen, found, grasped, predicted) = plt.subplots(
        1, 4, figsize=(12, 3.1), layout="constrained", width_ratios=(1.3, 1.3, 0.9, 1.3)
    )
    everything = thinned(cloud.xyz)
    draw_points(seen, everything, everything[:, 2], 6.0)
    seen.set_title("1  cloud (colour: depth)")
    draw_points(found, everything, "lightgray", 6.0)
    assert result.scene is not None  # noqa: S101  a cloud with the table in view
    for one, colour in zip(result.scene.segmentation.objects, ("tab:orange", "tab:purple", "tab:brown"), strict=False):
        draw_points(found, thinned(one.cloud.xyz), colour, 1.5)
    found.set_title("2  table and objects")
    (target,) = result.targets
    prediction = target.predictions[0]
    draw_points(grasped, thinned(target.target.cloud.xyz), "tab:orange", 8.0)
    draw_grasp(grasped, prediction)
    grasped.set_title("3  best grasp")
    draw_touch(predicted, prediction)
    predicted.set_title("4  predicted touch")
    for ax in (seen, found, grasped):
        ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        ax.invert_yaxis()
    for ax in (seen, found):
        ax.set(xlim=(-0.55, 0.55), ylim=(0.4, -0.4))
    figure.savefig(FOLDER / "steps.png", dpi=110)


def draw_grasp(ax: Axes, prediction: Prediction) -> None:
    """Both contacts, with the fingers that take them by default."""
    for point, name, up in ((prediction.grasp.g1, "thumb, g1", -16), (prediction.grasp.g2, "middle finger, g2", 9)):
        ax.plot(point[0], point[1], "o", color="black", markersize=6)
        ax.annotate(name, point[:2], textcoords="offset points", xytext=(0, up), fontsize=8, ha="center")
    ax.margins(x=0.35)


def draw_touch(ax: Axes, prediction: Prediction) -> None:
    """The 24 electrodes of both fingers with their 90 % intervals [counts]."""
    for shift, name, centre, low, high in zip((-0.15, 0.15), ("thumb", "middle finger"), *prediction["E"], strict=True):
        ax.errorbar(
            np.arange(1, 25) + shift, centre, np.array([centre - low, high - centre]), fmt="o", ms=3, lw=1, label=name
        )
    ax.set(xlabel="electrode", ylabel="counts")
    ax.legend(fontsize=8, loc="lower left")


def draw_frames(cloud: Cloud, result: PipelineResult) -> None:
    """The camera's optical frame, and the frame of the hand at a grasp."""
    figure = plt.figure(figsize=(4.6, 4.6), layout="constrained")
    ax = figure.add_subplot(projection="3d")
    assert isinstance(ax, Axes3D)  # noqa: S101
    (target,) = result.targets
    grasp = target.predictions[0].grasp
    # Shown with z down, as a camera above a table looks.
    around = thinned(cloud.xyz)
    around = around[(np.abs(around - grasp.midpoint) < 0.3).all(axis=1)]
    ax.scatter(*around.T, s=3, c="gray", linewidths=0)
    ax.scatter(*thinned(target.target.cloud.xyz).T, s=2, c="tab:orange", linewidths=0)
    triad(ax, np.zeros(3), np.eye(3), 0.2, "camera\noptical\nframe", "xyz")
    triad(ax, grasp.midpoint, grasp.rotation, 0.2, "frame of\nthe hand\n\n", "XYZ")
    for point in (grasp.g1, grasp.g2):
        ax.plot(*point[:, None], "o", color="black", markersize=4)
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", aspect="equal")
    ax.invert_zaxis()
    ax.invert_yaxis()  # with z down, this keeps the axes right-handed
    ax.view_init(elev=20, azim=-60)
    figure.savefig(FOLDER / "frames.png", dpi=110)


def triad(ax: Axes3D, origin: np.ndarray, rotation: np.ndarray, length: float, name: str, letters: str) -> None:
    """The three axes of a frame."""
    for axis, colour, letter in zip(rotation.T, AXES, letters, strict=True):
        ax.quiver(*origin, *(axis * length), color=colour, arrow_length_ratio=0.15)
        ax.text(*(origin + axis * length * 1.15), letter, color=colour)
    ax.text(*(origin - np.array([0.3, 0.0, 0.0])), name, fontsize=9)


def draw_recorded() -> None:
    """Predicted beside read, on recorded grasps that the model was not fitted to."""
    from foretouch.report.touch_figure import DrawnGrasp, save_touch_picture
    from foretouch_lab.learning.data import labels_of, load_dataset, make_folds
    from foretouch_lab.learning.training.contact import ContactPredictor, ContactTrainingConfig

    samples = load_dataset(Path(os.environ["FORETOUCH_DATA"]) / "vision2tactile").samples
    fold = make_folds(samples, "time", 0)[-1]
    train, test = ([samples[k] for k in index] for index in (fold.train, fold.test))
    model = ContactPredictor(train, labels_of(train), ContactTrainingConfig())
    values, half = model.predict_after([], test)
    errors = np.abs(values - labels_of(test))[:, 2:].mean(axis=1)
    ranked = np.argsort(errors, kind="stable")
    drawn = []
    for share, name in ((0.25, "lower quartile"), (0.5, "median"), (0.75, "upper quartile")):
        k = ranked[round(share * (len(ranked) - 1))]
        value, lower, upper = (biotac_touch(values[k] + sign * half[k]) for sign in (0.0, -1.0, 1.0))
        prediction = Prediction.of(test[k].grasp, value, lower, upper)
        title = f"{test[k].object}: {name} of the errors of {len(test)} grasps, predicted from the cloud alone"
        rest = biotac_touch(model.rest)
        drawn.append(DrawnGrasp(prediction=prediction, read=test[k].touch, rest=rest, title=title))
    path = save_touch_picture(FOLDER / "touch_recorded.png", drawn)
    with Image.open(path) as image:
        image.convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)


def main(picture: str = "") -> None:
    """Draw one, or all of docs/concepts.md."""
    if picture == "touch_recorded":
        return draw_recorded()
    cloud, result = scene()
    draw_steps(cloud, result)
    draw_frames(cloud, result)
    return None


if __name__ == "__main__":
    main(*sys.argv[1:])
