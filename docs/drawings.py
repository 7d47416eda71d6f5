# SPDX-License-Identifier: Apache-2.0
"""Draw pictures of the documents: python docs/drawings.py [PICTURE].

`steps` and `frames`, of docs/concepts.md, show one simulated scene, as the pipeline sees it with its default settings.

`touch_recorded` shows grasps of the public recordings (FORETOUCH_DATA) that the model was not fitted to: the recipe of
`contact-v2` is fitted to all but the last fifth of each object's grasps, in order of time. Of that last fifth, the grasps
are drawn whose mean electrode error lies at the lower quartile, the median and the upper quartile.

`demo` is the moving picture of README. The can of `config/scenes/demo.yaml` lies among three other objects, once with each of
twenty seeds, and is grasped once. The grasp is shown whose mean electrode error is the median (of two, the lower).
"""

import io
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from PIL import Image

from foretouch.grasp.hand import FINGER, THUMB, Hand, load_hand
from foretouch.pipeline import Pipeline, PipelineConfig, PipelineResult
from foretouch.report.finger_figure import FingerScale
from foretouch.report.scene_figure import draw_scene
from foretouch.tactile import biotac_touch
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Bool, Cloud, Float64, Grasp, Prediction, Sample, Touch
from foretouch.types.scene import Scene

FOLDER = Path(__file__).parent
AXES = ("tab:red", "tab:green", "tab:blue")  # x, y, z as in RViz
POINTS = 1800  # drawn at most
RUNS = 20  # of which the moving picture shows the median
FACES = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])  # of a box
PARTS = {THUMB: "tab:red", FINGER: "tab:cyan"}  # the palm is grey


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
    for object_, colour in zip(result.scene.objects, ("tab:orange", "tab:purple", "tab:brown"), strict=False):
        draw_points(found, thinned(object_.cloud.xyz), colour, 1.5)
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
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(3))
    ax.invert_zaxis()
    ax.invert_yaxis()  # with z down, this keeps the axes right-handed
    ax.view_init(elev=20, azim=-60)
    figure.savefig(FOLDER / "frames.png", dpi=110, bbox_inches="tight", pad_inches=0.15)


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


@dataclass(frozen=True, eq=False)
class DemoRun:
    """A grasp of the can that is predicted, then executed by the simulated hand."""

    cloud: Cloud  # the whole image
    sample: Sample
    prediction: Prediction
    read: Touch

    @property
    def error(self) -> float:
        """Mean difference of the electrodes [counts]."""
        return float(np.abs(self.read.values - self.prediction.value.values)[2:].mean())

    @property
    def missed(self) -> Bool:
        """(50,) which values were read outside of their intervals."""
        values = self.read.values
        return (values < self.prediction.lower.values) | (values > self.prediction.upper.values)


def demo_run(seed: int) -> DemoRun:
    """The can among three other objects, predicted by the model `simulated` from the cloud and a tare."""
    from foretouch.models import load_model
    from foretouch_lab.learning.prequential import replay_model
    from foretouch_lab.simulation.scene import load_scene
    from foretouch_lab.simulation.scene_camera import FrameMaker
    from foretouch_lab.simulation.simulate import Simulation

    demo = load_scene(FOLDER.parent / "config" / "scenes" / "demo.yaml")
    changes = {"campaign.objects": 1, "campaign.grasps": 1, "clutter.count": 3, "seed": seed}
    scene_of_can = replace(demo.updated(changes), objects=demo.objects[:1])
    samples = list(Simulation(scene_of_can).samples(1))
    played = replay_model(load_model("simulated"), samples).played
    value, half = played.counts[0], played.half[0]
    prediction = Prediction.of(samples[0].grasp, *(biotac_touch(value + sign * half) for sign in (0.0, -1.0, 1.0)))
    made_by = (int(samples[0].extra[name]) for name in ("slot", "attempt"))
    cloud, read = FrameMaker(scene_of_can).frame(*made_by).cloud(), samples[0].touch
    assert read is not None  # noqa: S101  it was executed
    return DemoRun(cloud, samples[0], prediction, read)


def hand_corners(hand: Hand, grasp: Grasp, up: Float64, *, opened: float, away_m: float) -> Float64:
    """(B, 8, 3) corners of a hand that comes from straight above [m]: opened by a share, and still so far away."""
    across = (grasp.g1 - grasp.g2) / np.linalg.norm(grasp.g1 - grasp.g2)
    ahead = -(up - (up @ across) * across)
    ahead /= np.linalg.norm(ahead)
    pose = np.column_stack([across, np.cross(ahead, across), ahead])
    return np.asarray(hand.opened(grasp.width_m, opened) @ pose.T + grasp.midpoint - away_m * ahead, np.float64)


class DemoPicture:
    """The panels of the moving picture: depth image, hand, and the taxels of both fingers, predicted and read."""

    def __init__(self, run: DemoRun) -> None:
        self.run = run
        self.scene: Scene = Pipeline().segment(run.cloud)
        self.hand = load_hand("shadow_thumb_middle")
        self.figure = plt.figure(figsize=(9.6, 4.6), dpi=80)
        self.image = self.figure.add_axes((0.01, 0.14, 0.31, 0.78), xticks=[], yticks=[])
        self.space = self.figure.add_axes((0.325, 0.14, 0.3, 0.78), projection="3d")
        left, bottom, size = (0.635, 0.82), (0.58, 0.14), (0.17, 0.32)
        self.taxels = [[self.figure.add_axes((x, y, *size)) for x in left] for y in bottom]
        for panel in (self.space, *self.taxels[0], *self.taxels[1]):
            panel.set_axis_off()
        self.text = self.figure.text(0.5, 0.035, "", ha="center", fontsize=14)
        self.view = TaxelView(BIOTAC_SP)
        self.scale = FingerScale(
            self.view, [self.levels(finger, read) for finger in (0, 1) for read in (0, 1)], tared=True
        )

    def levels(self, finger: int, read: int) -> Float64:
        """(24,) how far contact moves the electrodes of a finger, predicted or read [counts]."""
        touch = self.run.read if read else self.run.prediction.value
        return self.view.levels(touch.values, self.run.sample.tare, finger)

    def draw_image(self) -> None:
        """Draw the depth image."""
        depth = self.run.cloud.xyz[..., 2]
        self.image.imshow(depth, cmap="cividis_r", vmin=float(np.nanmin(depth)))
        self.image.set_title("depth image", fontsize=12)
        self.image.set(
            xlim=(0.2 * depth.shape[1], 0.8 * depth.shape[1]), ylim=(0.88 * depth.shape[0], 0.12 * depth.shape[0])
        )

    def draw_objects(self) -> None:
        """Outline the objects, the target in the colour of its points."""
        target = self.scene.near(self.run.sample.grasp.g1)
        for item in self.scene.objects:
            inside = (self.scene.labels == int(item.id)).astype(float)
            self.image.contour(inside, levels=[0.5], colors="tab:orange" if item is target else "white", linewidths=2.0)
        self.image.set_title("depth image and objects", fontsize=12)

    def draw_hand(self, *, opened: float, away_m: float) -> None:
        """Draw the object and the hand, seen from the side, what is outside of the panel is cut."""
        self.space.clear()
        self.space.set_axis_off()
        assert self.scene.table is not None  # noqa: S101  the scene has one
        grasp, up = self.run.sample.grasp, self.scene.table.normal
        points = thinned(self.run.sample.cloud.xyz)
        self.space.scatter(*points.T, s=4, c="tab:orange", linewidths=0)
        corners = hand_corners(self.hand, grasp, up, opened=opened, away_m=away_m)
        for part, box in zip(self.hand.parts, corners, strict=True):
            colour = PARTS.get(part, "lightgray")
            self.space.add_collection3d(
                Poly3DCollection(box[FACES], facecolors=colour, edgecolors="black", linewidths=0.4, alpha=0.55)
            )
        middle = grasp.midpoint + 0.03 * up
        self.space.set(**{f"{axis}lim": (at - 0.085, at + 0.085) for axis, at in zip("xyz", middle, strict=True)})
        self.space.invert_zaxis()
        self.space.invert_yaxis()
        across = grasp.g1 - grasp.g2
        self.space.view_init(elev=12, azim=float(np.degrees(np.arctan2(across[1], across[0]))) + 65)
        self.space.set_title("grasp on a Shadow Hand", fontsize=12)

    def draw_touch(self, read: int) -> None:
        """Draw the taxels of both fingers, predicted or read."""
        for finger, name in enumerate(("thumb", "middle finger")):
            panel = self.taxels[finger][read]
            panel.set_axis_on()
            outside = self.run.missed[self.view.columns(finger)] if read else None
            self.scale.draw(panel, finger, self.levels(finger, read), outside=outside)
            panel.set_title(f"{name}: {('predicted', 'read')[read]}", fontsize=11)

    def frames(self) -> Iterator[tuple[Image.Image, int]]:
        """Each image, and how long it is shown [ms]."""
        self.draw_image()
        yield self.frame("A depth camera looks at a table."), 1500
        self.draw_objects()
        yield self.frame("foretouch finds the objects …"), 1500
        for away_m in (0.12, 0.09, 0.06, 0.03, 0.0):
            self.draw_hand(opened=1.0, away_m=away_m)
            yield self.frame("… plans a grasp for the hand …"), 250
        self.draw_touch(0)
        yield self.frame("… and predicts what the fingertips will read, before they touch."), 3000
        for opened in (0.75, 0.5, 0.25, 0.0):
            self.draw_hand(opened=opened, away_m=0.0)
            yield self.frame("The hand closes."), 250
        self.draw_touch(1)
        inside = int((~self.run.missed[2:]).sum())
        yield (self.frame(f"{inside} of 48 electrodes read within their 90 % intervals (others are ringed)."), 4000)

    def frame(self, text: str) -> Image.Image:
        """The picture as it is, above a line of text."""
        self.text.set_text(text)
        held = io.BytesIO()
        self.figure.savefig(held, format="png", facecolor="white")
        return Image.open(held).convert("RGB")


def draw_demo() -> None:
    """Draw the moving picture of README."""
    runs = [demo_run(seed) for seed in range(RUNS)]
    errors = [run.error for run in runs]
    seed = int(np.argsort(errors, kind="stable")[(RUNS - 1) // 2])
    frames, durations = zip(*DemoPicture(runs[seed]).frames(), strict=True)
    colours = frames[-1].quantize(96, Image.Quantize.MAXCOVERAGE)
    shown = [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]
    path = FOLDER / "demo.gif"
    shown[0].save(path, save_all=True, append_images=shown[1:], duration=durations, loop=0, optimize=True)
    print(f"{path}: seed {seed}, mean error {errors[seed]:.1f} counts (all: {min(errors):.1f} to {max(errors):.1f})")  # noqa: T201


def draw_hands() -> None:
    """Draw the first grasp of each hand on the same object, for docs/hands.md."""
    seen = np.load(FOLDER.parent / "examples" / "data" / "table_depth.npz")
    target = Pipeline().segment(Cloud.from_depth(seen["depth"], seen["K"])).objects[0]
    pictures = []
    for name in ("shadow_thumb_middle", "franka_hand", "robotiq_2f85"):
        grasps = Pipeline(PipelineConfig().updated({"hand.name": name})).plan(target).grasps
        figure = draw_scene(target, grasps)
        figure.suptitle(name.replace("_", " "))
        held = io.BytesIO()
        figure.savefig(held, format="png", dpi=110, facecolor="white")
        pictures.append(Image.open(held).convert("RGB"))
    sheet = Image.new("RGB", (pictures[0].width, sum(picture.height for picture in pictures)), "white")
    for row, picture in enumerate(pictures):
        sheet.paste(picture, (0, row * picture.height))
    sheet.quantize(64).save(FOLDER / "hands.png", optimize=True)


def main(picture: str = "") -> None:
    """Draw one, or all of docs/concepts.md."""
    if picture == "touch_recorded":
        return draw_recorded()
    if picture == "demo":
        return draw_demo()
    if picture == "hands":
        return draw_hands()
    cloud, result = scene()
    draw_steps(cloud, result)
    draw_frames(cloud, result)
    return None


if __name__ == "__main__":
    main(*sys.argv[1:])
