# SPDX-License-Identifier: Apache-2.0
"""Draw the pictures of the documents: python docs/drawings.py [PICTURE ...].

`bottles` shows the objects in the recorded image of examples/data/bottles, and a grasp on one (inputs.png). `sensor` is the picture of a command. All others but `touch_recorded` show scenes of our
own, which MuJoCo renders with colour and depth (docs/rendering.py); what is drawn over them is what foretouch answers. `touch_recorded` shows grasps of the public recordings (FORETOUCH_DATA) that the model was not fitted
to: the recipe of `contact-v2` is fitted to all but the last fifth of each object's grasps, in order of time. Of that last fifth, the
grasps are drawn whose mean electrode error lies at the lower quartile, the median and the upper quartile.
"""

import csv
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from runpy import run_path
from typing import Any, Final

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from PIL import Image
from rendering import BOTTLE, BOWL, CAN, HAND, Photograph, Stage, Thing, box, frame_in_world, looking, rod, turned

from foretouch import fit
from foretouch.cli.main import main as command
from foretouch.grasp import GraspPlan
from foretouch.models import load_model
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.report.camera_figure import area_of, draw_camera, without_slits
from foretouch.report.finger_figure import FingerScale, finger_levels, title_finger
from foretouch.report.hand_figure import COLOURS, finger_names, hand_boxes
from foretouch.report.panels import (
    FAINT,
    FINGER_COLOURS,
    INK,
    OBJECT_COLOURS,
    PAGE_INCH,
    SMALL_PT,
    TEXT_PT,
    Axes,
    new_figure,
    save,
)
from foretouch.report.touch_figure import DrawnGrasp, save_touch_picture
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Cloud, Float64, Grasp
from foretouch.types.scene import Object, Scene
from foretouch_lab.simulation.depth_scene import CameraView
from foretouch_lab.simulation.scene import load_scene

FOLDER: Final = Path(__file__).parent
NOISE_M: Final = 0.0008  # of the depth at 1 m
RED, BLUE, YELLOW, GREEN = (0.78, 0.22, 0.18), (0.2, 0.45, 0.7), (0.88, 0.66, 0.2), (0.36, 0.6, 0.36)
WHITE, GREY, PURPLE, BROWN = (0.86, 0.86, 0.84), (0.55, 0.57, 0.6), (0.5, 0.35, 0.6), (0.45, 0.33, 0.25)
REASONS: Final = {"enters_view": "#d1495b", "beyond_table": "#3b6fb6", "floating": "#8f4fd1", "wall": "#b8860b"}
REASON_TEXTS: Final = {"enters_view": "refused: enters the view", "beyond_table": "refused: beyond the table", "floating": "refused: floats", "wall": "refused: wall"}  # fmt: skip
WAY, DEPTH, BARE, REFUSED = "#c8501e", "#6a4c93", "#5a5a5a", "#b00020"
HANDS: Final = {HAND: "Shadow Hand", "franka_hand": "Franka Hand", "robotiq_2f85": "Robotiq 2F-85"}
AXES: Final = ("#d62728", "#2ca02c", "#1f77b4")  # x, y, z as in RViz


def photograph(things: Sequence[Thing], distance_m: float, tilt_deg: float) -> Photograph:
    """Return what a tilted camera sees of things on a table."""
    return Stage(things).photograph(CameraView.towards_table(640, 480, distance_m, np.radians(tilt_deg)))


def shrink(path: Path) -> None:
    """Write a PNG again with a palette of 256 colours, between which photographs are dithered."""
    with Image.open(path) as image:
        full = image.convert("RGB")
    palette = full.quantize(256, Image.Quantize.MAXCOVERAGE)
    full.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(path, optimize=True)


def save_photo(figure: Figure, path: Path) -> None:
    """Write a figure with photographs."""
    shrink(save(figure, path))


def room() -> list[Thing]:
    """Return four objects, and a wall, a cupboard, an arm and a lamp, which are none."""
    arm = [
        rod(GREY, (-0.75, 0.15, 0.35), (-0.32, 0.08, 0.3), 0.045),
        rod(GREY, (-0.32, 0.08, 0.3), (-0.22, 0.05, 0.13), 0.035),
    ]
    around = [box(WHITE, (2.4, 0.05, 1.6), (0.0, 0.9, -0.75)), box(BROWN, (0.4, 0.4, 1.0), (0.75, 0.72, -0.75))]
    lamp = turned(PURPLE, ((1e-4, 0.0), (0.07, 0.0), (0.045, 0.05), (1e-4, 0.05)), (0.22, 0.2, 0.3))
    objects = [
        turned(RED, CAN, (-0.12, -0.05, 0.0)),
        turned(GREEN, BOTTLE, (0.05, 0.06, 0.0)),
        box(YELLOW, (0.1, 0.06, 0.08), (-0.02, -0.16, 0.0), 0.4),
        turned(BLUE, BOWL, (0.2, -0.1, 0.0)),
    ]
    return [*objects, *arm, *around, lamp]


def full_bin() -> list[Thing]:
    """Return a bin with three objects."""
    side = (0.3, 0.5, 0.62)
    sides = [box(side, (0.42, 0.012, 0.14), (0.0, y, 0.0)) for y in (-0.15, 0.15)]
    sides += [box(side, (0.012, 0.3, 0.14), (x, 0.0, 0.0)) for x in (-0.21, 0.21)]
    objects = [
        turned(RED, CAN, (-0.1, -0.03, 0.0)),
        box(YELLOW, (0.1, 0.06, 0.05), (0.02, 0.06, 0.0), 0.4),
        turned(GREEN, BOTTLE, (0.09, -0.06, 0.0), lying=0.5),
    ]
    return [*sides, *objects]


def pile() -> list[Thing]:
    """Return six objects that touch or hide each other."""
    return [
        box(YELLOW, (0.14, 0.1, 0.06), (0.0, 0.0, 0.0), 0.3),
        box(BLUE, (0.09, 0.07, 0.05), (0.0, 0.0, 0.06), 0.9),
        turned(RED, CAN, (-0.105, 0.02, 0.0)),
        turned(GREEN, BOTTLE, (0.06, -0.1, 0.0)),
        box(PURPLE, (0.08, 0.12, 0.1), (0.13, 0.05, 0.0), -0.2),
        turned(WHITE, BOWL, (-0.12, -0.12, 0.0)),
    ]


def draw_found(axes: Axes, scene: Scene) -> None:
    """Draw a scene with the outlines of its objects, and its background in the colour of its reason."""
    areas = {object_.id: scene.labels == int(object_.id) for object_ in scene.objects}
    draw_camera(axes, scene.cloud, areas)
    height, width = scene.labels.shape
    for part in scene.background:
        inside = np.zeros((height, width), bool)
        inside.flat[part.pixels] = True
        inside = without_slits(inside)
        colour = REASONS[part.background]
        shade = np.zeros((height, width, 4))
        shade[inside] = (*to_rgb(colour), 0.55)
        axes.imshow(shade)
        axes.contour(inside.astype(float), levels=[0.5], colors=colour, linewidths=1.2)
        alike = (one for one in scene.background if one.background == part.background)
        if part is max(alike, key=attrgetter("n_points")):
            rows, columns = np.nonzero(inside)
            k = int(np.argmin(np.hypot(rows - np.median(rows), columns - np.median(columns))))
            text, place = REASON_TEXTS[part.background], np.array([columns[k], rows[k]])
            at = np.clip(place, 6.6 * len(text), width - 6.6 * len(text)) * [1, 0] + [
                0,
                rows[k] + (75 if inside.mean() < 0.06 else 0),
            ]
            label(axes, text, at, colour, place if inside.mean() < 0.06 else None)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))


def label(axes: Axes, text: str, place: Any, colour: str, at: Any = None) -> None:
    """Write a word on a picture, with a line to what it names if `at` is given."""
    around = [withStroke(linewidth=3.2, foreground="white")]
    leads = {"arrowstyle": "-", "color": colour, "lw": 1.5, "shrinkA": 0, "shrinkB": 0, "path_effects": around}
    drawn = axes.annotate(text, place if at is None else at, place, color="white", fontsize=TEXT_PT, fontweight="bold", ha="center", va="center",
                  zorder=9, bbox={"boxstyle": "round,pad=0.25", "facecolor": colour, "edgecolor": "white", "linewidth": 0.6},
                  arrowprops=None if at is None else leads)  # fmt: skip
    drawn.set_in_layout(False)


def draw_background() -> None:
    """Draw what is no object, and why."""
    figure = new_figure(PAGE_INCH, 3.0)
    left, right = figure.subplots(1, 2)
    for axes, things, view in ((left, room(), (1.0, 48.0)), (right, full_bin(), (0.7, 10.0))):
        draw_found(axes, Pipeline().segment(photograph(things, *view).cloud(NOISE_M)))
    left.set_title("objects 1 to 4; an arm, a lamp, a wall and a cupboard", fontsize=TEXT_PT)
    right.set_title("a bin and the objects in it", fontsize=TEXT_PT)
    save_photo(figure, FOLDER / "segmentation_background.png")


def draw_joins() -> None:
    """Draw a pile, its connected points, and its objects."""
    cloud = photograph(pile(), 0.62, 35.0).cloud(NOISE_M)
    figure = new_figure(PAGE_INCH, 2.4)
    panels = figure.subplots(1, 3)
    whole, divided = (
        Pipeline(PipelineConfig().updated({"segmentation.split.angle_deg": angle})).segment(cloud)
        for angle in (180.0, 22.0)
    )
    counts = divided.counts
    titles = (
        "a pile", f"connected points: {len(whole.objects)} objects",
        f"divided where they touch: {len(divided.objects)} objects",
    )  # fmt: skip
    first, second = ([scene.labels == int(one.id) for one in scene.objects] for scene in (whole, divided))
    for k, inside in enumerate(first):  # an object keeps its colour and number
        alike = max(range(k, len(second)), key=lambda j: int((second[j] & inside).sum()))
        second[k], second[alike] = second[alike], second[k]
    for axes, found, title in zip(panels, ([], first, second), titles, strict=True):
        draw_camera(axes, cloud, {str(k): inside for k, inside in enumerate(found, 1)})
        axes.set(xlim=(100, 540), ylim=(430, 60))
        axes.set_title(title, fontsize=TEXT_PT)
    print({name: counts[name] for name in counts if name.startswith(("clusters", "parts", "joined"))})  # noqa: T201
    save_photo(figure, FOLDER / "segmentation_joins.png")


def on_picture(view: CameraView, points: Float64) -> Float64:
    """Return (N, 2) columns and rows at which a camera sees places of the world."""
    local = view.to_camera(np.asarray(points, np.float64))
    return (local @ view.matrix.T)[:, :2] / local[:, 2:]


def plan_on(things: Sequence[Thing], camera: CameraView, hand: str = HAND) -> tuple[Scene, Object, GraspPlan]:
    """Return the scene, its object nearest to the middle of the table, and the plan for it."""
    pipeline = Pipeline(PipelineConfig().updated({"hand.name": hand}))
    scene = pipeline.segment(Stage(things).photograph(camera).cloud(NOISE_M))
    middle = camera.to_camera(np.zeros((1, 3)))[0]
    target = min(scene.objects, key=lambda one: float(np.linalg.norm((one.centroid - middle)[:2])))
    return scene, target, pipeline.plan(target)


def draw_taken(axes: Axes, things: Sequence[Thing], camera: CameraView, grasp: Grasp, *, around_deg: float) -> None:
    """Draw the hand at a grasp from the side, with the closing line, the depth and the way in.

    Args:
        axes: Where to draw.
        things: What is on the table.
        camera: Which saw it.
        grasp: In its frame.
        around_deg: How far the view is turned about the vertical, from where the hand goes to, towards the thumb.
    """
    frame = frame_in_world(grasp, camera)
    assert grasp.way is not None  # noqa: S101
    stage = Stage(things, hand=True)
    middle, across, into = frame[:3, 3], frame[:3, 0], frame[:3, 2]
    aside, turn = np.cross([0.0, 0.0, 1.0], across), np.radians(around_deg)
    aside *= np.sign(aside @ into) or 1.0  # the hand comes towards the view
    level = middle * (1.0, 1.0, 0.0)
    from_here = level + 0.42 * (np.cos(turn) * aside + np.sin(turn) * across)
    eye = looking((*from_here[:2], 0.27), (*level[:2], 0.12), 640, 640, 48.0)
    depth = stage.photograph(eye).depth
    stage.place_hand(frame, grasp.width_m)
    axes.imshow(stage.look(eye))
    ends = middle + np.outer([0.5, -0.5], across * grasp.width_m)
    thumb, finger = on_picture(eye, ends)
    middle_of, shallow = on_picture(eye, np.stack([middle, middle - grasp.way.depth_m * into]))
    for line, colour in (((thumb, finger), INK), ((middle_of, shallow), DEPTH)):
        for width, tint in ((4.0, "white"), (2.0, colour)):
            axes.plot(*np.stack(line).T, color=tint, linewidth=width, solid_capstyle="butt")
    for end, place, name, colour in zip(
        ends, (thumb, finger), ("thumb", "middle finger"), FINGER_COLOURS, strict=False
    ):
        draw_contact(axes, eye, depth, end, name, (145, 440) if place[0] < middle_of[0] else (525, 440), colour)
    start, ahead = np.array([530.0, 75.0]), middle_of - shallow
    end = start + 110.0 * ahead / np.linalg.norm(ahead)
    arrow = {"arrowstyle": "-|>,head_width=0.4,head_length=0.8", "color": WAY, "lw": 3.0}
    axes.annotate("", end, start, arrowprops=arrow)
    label(axes, "approach", (530.0, 30.0), WAY)
    label(axes, f"{1e3 * grasp.way.depth_m:.0f} mm deep", (510, 265), DEPTH, (middle_of + shallow) / 2.0)
    label(axes, "object", (470, 590), BARE, on_picture(eye, np.add(level, (0.0, 0.0, 0.03))[None])[0])
    axes.set(xticks=[], yticks=[], xlim=(0, 640), ylim=(640, 0))


def draw_contact(axes: Axes, eye: CameraView, depth: Float64, end: Float64, name: str, at: Any, colour: str) -> None:
    """Draw a contact in the world as a camera sees it: hollow where the things, of which it sees the depth, hide it."""
    (place,) = on_picture(eye, end[None])
    hidden = eye.to_camera(end[None])[0, 2] > depth[round(place[1]), round(place[0])] + 0.006
    label(axes, name, at, colour, place)
    axes.plot(
        *place,
        "o",
        color=colour,
        markerfacecolor="none" if hidden else colour,
        markersize=7.5,
        zorder=8,
        markeredgewidth=1.8,
    )


def draw_refused(axes: Axes, camera: CameraView) -> None:
    """Draw a box that is wider than the hand opens, as the camera sees it, and how far the hand opens."""
    size, turn = np.array([0.16, 0.15, 0.09]), 0.3
    scene, target, plan = plan_on([box(BLUE, size, (0.0, 0.0, 0.0), turn)], camera)
    assert not len(plan.grasps)  # noqa: S101
    draw_camera(axes, scene.cloud, {"": scene.labels == int(target.id)}, around=0.5)
    axes.texts[0].set_visible(False)
    along = np.array([-np.sin(turn), np.cos(turn), 0.0])
    for half, up, aside, colour, text in (
        (size[1] / 2.0, size[2], 0.0, BARE, f"object: {1e3 * size[1]:.0f} mm"),
        (0.05, 0.0, 0.13, REFUSED, "the hand opens 100 mm"),
    ):
        middle = np.array([np.cos(turn), np.sin(turn), 0.0]) * aside + [0.0, 0.0, up]
        ends = on_picture(camera, middle + np.outer([-half, half], along))
        axes.annotate("", *ends, arrowprops={"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "color": "white", "lw": 4.0})
        axes.annotate("", *ends, arrowprops={"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "color": colour, "lw": 2.0})
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        place = (0.28, 0.09) if up else (0.6, 0.92)
        label(axes, text, (left + place[0] * (right - left), high + place[1] * (low - high)), colour, ends.mean(axis=0))
    axes.set_title("refused: too wide for the hand", fontsize=TEXT_PT)


def draw_grasps() -> None:
    """Draw a grasp from straight above, one that comes tilted, and an object that is refused."""
    camera = CameraView.towards_table(640, 480, 0.8, np.radians(25.0))
    figure = new_figure(PAGE_INCH, 2.75)
    upright, tilted, refused = figure.subplots(1, 3)
    carton = [box(YELLOW, (0.06, 0.12, 0.2), (0.0, 0.0, 0.0), 0.3)]
    draw_taken(upright, carton, camera, plan_on(carton, camera)[2].grasps[0], around_deg=-25.0)
    upright.set_title("taken from straight above", fontsize=TEXT_PT)
    bottle = [turned(GREEN, BOTTLE, (0.0, 0.0, 0.0))]
    grasp = plan_on(bottle, camera)[2].grasps[0]
    assert grasp.way is not None  # noqa: S101
    tilt = np.degrees(np.arccos(-(camera.R_world_camera @ grasp.way.approach)[2]))
    draw_taken(tilted, bottle, camera, grasp, around_deg=-25.0)
    tilted.set_title(f"taken with the hand tilted by {tilt:.0f}°", fontsize=TEXT_PT)
    draw_refused(refused, camera)
    save_photo(figure, FOLDER / "grasps.png")


def touched_figure(model: str) -> DrawnGrasp:
    """Return the grasp of the demo's figure that `examples/draw_touch.py` draws: predicted before and after two touches, and read."""
    example = run_path(str(FOLDER.parent / "examples" / "draw_touch.py"))
    demo = load_scene(FOLDER.parent / "config" / "scenes" / "demo.yaml")
    drawn: list[DrawnGrasp] = example["grasps_to_draw"](demo, model)
    return drawn[-1]


def draw_figure_seen(axes: Axes, drawn: DrawnGrasp) -> None:
    """Draw the figure as the camera sees it, with the contacts of the grasp."""
    assert drawn.target is not None  # noqa: S101
    assert drawn.scene is not None  # noqa: S101
    grasp = replace(drawn.prediction.grasp, way=None)
    areas = {"object": area_of(drawn.target, drawn.scene)}
    draw_camera(axes, drawn.scene, areas, grasp=grasp, around=0.5, fingers=("thumb", "middle finger"))


def draw_skills(axes: Axes) -> None:
    """Draw the skill of the thumb's electrodes on real objects left out, after touches of them (docs/results/unseen_object)."""
    with (FOLDER / "results" / "unseen_object" / "results.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["object"] == "all" and row["modality"] == "E_TH"]
    drawn = (("contact", "the model", (6.6, 0.1), 2, OBJECT_COLOURS[4], "o-"), ("training_mean", "the mean of the training,\nmoved by the touches", (6.2, 0.85), 2, INK, "s--"))  # fmt: skip
    for name, text, place, which, colour, style in drawn:
        own = sorted((row for row in rows if row["predictor"] == name), key=lambda row: int(row["touches"]))
        touches, skill, low, high = (
            np.array([float(row[key]) for row in own]) for key in ("touches", "skill", "skill_low", "skill_high")
        )
        axes.plot(touches, skill, style, color=colour, markersize=5)
        label(axes, text, place, colour, (touches[which], skill[which]))
        axes.fill_between(touches, low, high, color=colour, alpha=0.15, linewidth=0.0)
    axes.axhline(0.0, color=FAINT, linewidth=1.0)
    axes.set(xticks=(0, 1, 3, 5, 10), ylim=(-0.1, 1.0))
    axes.set_xlabel("touches of the object before the prediction", fontsize=SMALL_PT)
    axes.set_ylabel("skill (1: perfect, 0: the mean, not moved)", fontsize=SMALL_PT)
    axes.set_title("eight real objects, new to the model\n(bands: 95 % intervals)", fontsize=TEXT_PT)
    axes.tick_params(labelsize=SMALL_PT)


def draw_adaptation() -> None:
    """Draw how the skill rises with touches of objects that the model never saw, and one grasp by a hand that it never saw, before and after two."""
    grasp = touched_figure("contact-v3")
    assert grasp.read is not None  # noqa: S101
    assert grasp.earlier is not None  # noqa: S101
    view = TaxelView(BIOTAC_SP)
    drawn = [[finger_levels(view, one, grasp.rest, k) for k in (0, 1)] for one in (grasp.earlier, grasp.prediction)]
    drawn.append([(view.levels(grasp.read.values, grasp.rest, k), None) for k in (0, 1)])
    halves = [half for one in drawn for _, half in one if half is not None]
    scale = FingerScale(view, [levels for one in drawn for levels, _ in one], halves, tared=True)
    figure = new_figure(PAGE_INCH, 5.2)
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.35))
    seen, skills = left.subplots(2, 1, height_ratios=(1.0, 1.25))
    draw_figure_seen(seen, grasp)
    seen.set_title("a grasp of a new object by a hand that is\nnew to the model (simulated)", fontsize=TEXT_PT)
    draw_skills(skills)
    grid = right.subplots(2, 3)
    right.suptitle("the same grasp: 48 electrodes of two fingertips", fontsize=TEXT_PT)
    columns = ("predicted before\nthe first touch", "predicted after\ntwo touches", "read\nby the hand")
    for column, one, what in zip(grid.T, drawn, columns, strict=True):
        for k, panel in enumerate(column):
            scale.draw(panel, k, one[k][0], half=one[k][1])
            title_finger(panel, scale, k, "", what if k == 0 else "")
    scale.add_bar(right, list(grid.flat), shrink=0.9, aspect=35)
    for panel, prediction in zip(grid[1], (grasp.earlier, grasp.prediction), strict=False):
        error = np.abs(prediction.value.values - grasp.read.values)[2:].mean()
        panel.text(
            0.5, -0.02, f"error: {error:.0f} counts", transform=panel.transAxes, ha="center", va="top", fontsize=TEXT_PT
        )
    save_photo(figure, FOLDER / "adaptation.png")


def draw_intervals() -> None:
    """Draw the predicted electrodes of one finger as rings and as bars, and where they were read."""
    grasp, finger = touched_figure("simulated"), 1
    assert grasp.read is not None  # noqa: S101
    view = TaxelView(BIOTAC_SP)
    levels, half = finger_levels(view, grasp.prediction, grasp.rest, finger)
    assert half is not None  # noqa: S101
    read = view.levels(grasp.read.values, grasp.rest, finger)
    outside = np.abs(read - levels) > half
    scale = FingerScale(view, [levels, read], [half], tared=True)
    figure = new_figure(PAGE_INCH, 3.6)
    seen, left, right, middle = figure.subplots(1, 4, width_ratios=(1.4, 1.0, 1.0, 2.0))
    draw_figure_seen(seen, grasp)
    seen.set_title("the grasp (simulated)", fontsize=TEXT_PT)
    most = int(np.argmax(levels))
    for axes, what, shown, rings, crossed in (
        (left, "predicted", levels, half, None),
        (right, "read", read, None, outside),
    ):
        scale.draw(axes, finger, shown, half=rings, outside=crossed)
        title_finger(axes, scale, finger, "", what)
        x, y = 1e3 * view.sensor.layout.unrolled[most]
        axes.text(x, y, str(most + 1), color="white", fontsize=SMALL_PT, fontweight="bold", ha="center", va="center")
    draw_bars(middle, levels, half, read, finger)
    middle.set_ylabel("fall of E below rest [counts]", fontsize=SMALL_PT)
    middle.set_title("the same 24 electrodes as bars", fontsize=TEXT_PT)
    scale.add_bar(figure, [seen, left, middle, right], shrink=0.6, aspect=45)
    print(f"{(~outside).sum()} of {len(levels)} inside")  # noqa: T201
    save_photo(figure, FOLDER / "intervals.png")


def draw_bars(axes: Axes, levels: Float64, half: Float64, read: Float64, finger: int) -> None:
    """Draw the electrodes of a finger: (N,) predicted levels, half widths of their intervals, and (N,) levels that were read."""
    number, outside = np.arange(1, len(levels) + 1), np.abs(read - levels) > half
    colour, most = FINGER_COLOURS[finger], int(np.argmax(levels))
    axes.use_sticky_edges = False
    axes.bar(number, 2.0 * half, 0.55, levels - half, color=FAINT)
    axes.plot(number, levels, "_", color=colour, markersize=9, markeredgewidth=2.5)
    axes.plot(number[~outside], read[~outside], "o", color=INK, markersize=4.5)
    axes.plot(number[outside], read[outside], "o", color=INK, markersize=4.5)
    axes.plot(number[outside], read[outside], "s", color=INK, fillstyle="none", markersize=10.0, markeredgewidth=1.5)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    low, high = axes.get_ylim()
    for text, tint, height, value in (
        ("90 % interval", BARE, 0.93, levels[most] + 0.85 * half[most]),
        ("read", INK, 0.8, read[most]),
        ("predicted", colour, 0.67, levels[most]),
    ):
        label(axes, text, (5.0, low + height * (high - low)), tint, (most + 0.8, value))
    axes.set_xlabel("electrode of the middle finger", fontsize=SMALL_PT)
    axes.set_xticks([1, 6, 12, 18, 24])
    axes.tick_params(labelsize=SMALL_PT)


def table_of_four() -> tuple[list[Thing], CameraView]:
    """Return four objects apart from each other, and a camera above them."""
    things = [
        box(YELLOW, (0.07, 0.12, 0.09), (-0.02, 0.0, 0.0), 0.5),
        turned(RED, CAN, (-0.19, 0.05, 0.0)),
        turned(GREEN, BOTTLE, (0.16, 0.06, 0.0)),
        turned(BLUE, BOWL, (0.17, -0.13, 0.0)),
    ]
    return things, CameraView.towards_table(640, 480, 0.8, np.radians(30.0))


def draw_steps() -> None:
    """Draw the way from a cloud to a touch."""
    things, camera = table_of_four()
    pipeline = Pipeline(PipelineConfig().updated({"hand.name": HAND}))
    cloud = Stage(things).photograph(camera).cloud(NOISE_M)
    scene = pipeline.segment(cloud)
    target = scene.targets[0]
    grasp = pipeline.plan(target).grasps[0]
    model = load_model()
    prediction = model.predict(target, [grasp])[0]
    figure = new_figure(PAGE_INCH, 6.1)
    (seen, found), (taken, touch) = np.asarray(figure.subfigures(2, 2))
    depth, photo_of, best = seen.subplots(), found.subplots(), taken.subplots()
    draw_camera(depth, replace(cloud, rgb=None) if type(cloud) is Cloud else Cloud(cloud.xyz), {})
    areas = {one.id: scene.labels == int(one.id) for one in scene.objects}
    draw_camera(photo_of, cloud, areas, table=scene.outline)
    draw_camera(best, cloud, {target.id: areas[target.id]}, grasp=grasp)
    for axes in (depth, photo_of, best):
        axes.set(xlim=(90, 550), ylim=(430, 80))
    for axes, title in (
        (depth, "1  the camera measures depth"),
        (photo_of, "2  objects are found on the table"),
        (best, "3  a grasp of object 1 is planned (pale: the hand)"),
    ):
        axes.set_title(title, fontsize=TEXT_PT)
    view, rest = TaxelView(BIOTAC_SP), model.rest
    drawn = [finger_levels(view, prediction, rest, k) for k in (0, 1)]
    scale = FingerScale(
        view, [levels for levels, _ in drawn], [half for _, half in drawn if half is not None], tared=True
    )
    fingers = list(touch.subplots(1, 2))
    for k, (axes, (levels, half)) in enumerate(zip(fingers, drawn, strict=True)):
        scale.draw(axes, k, levels, half=half)
        title_finger(axes, scale, k, view.scalars(k, prediction.value, prediction))
    scale.add_bar(touch, fingers, shrink=0.8, aspect=30)
    touch.suptitle("4  what both fingertips would read is predicted", fontsize=TEXT_PT)
    save_photo(figure, FOLDER / "steps.png")


def draw_frames() -> None:
    """Draw the camera's optical frame, and the frame of the hand at a grasp."""
    things, camera = table_of_four()
    things = things[:3]
    pipeline = Pipeline(PipelineConfig().updated({"hand.name": HAND}))
    grasp = pipeline.plan(pipeline.segment(Stage(things).photograph(camera).cloud(NOISE_M)).targets[0]).grasps[0]
    body = box((0.2, 0.2, 0.22), (0.12, 0.03, 0.03), camera.eye - [0.0, 0.0, 0.015])
    frame, stage = frame_in_world(grasp, camera), Stage([body, *things], hand=True)
    middle, across, into = frame[:3, 3], frame[:3, 0], frame[:3, 2]
    far = looking((1.0, -1.15, 0.75), (-0.22, -0.06, 0.42), 640, 640, 46.0)
    aside = np.cross([0.0, 0.0, 1.0], across)
    aside *= np.sign(aside @ into) or 1.0
    near = looking(middle + 0.45 * aside - 0.1 * across + [0.0, 0.0, 0.22], middle, 640, 640, 40.0)
    figure = new_figure(PAGE_INCH, 4.2)
    left, right = figure.subplots(1, 2)
    depth = stage.photograph(near).depth
    stage.place_hand(frame, grasp.width_m)
    for axes, eye, title in (
        (left, far, "the camera's optical frame"),
        (right, near, "the frame of the hand at a grasp"),
    ):
        axes.imshow(stage.look(eye))
        axes.set_title(title, fontsize=TEXT_PT)
        axes.set(xticks=[], yticks=[], xlim=(0, 640), ylim=(640, 0))
    meanings = ("x: right in the image", "y: down in the image", "z: depth")
    triad(left, far, camera.eye, camera.R_world_camera, meanings, 0.22)
    rotation = camera.R_world_camera @ grasp.rotation
    triad(right, near, middle, rotation, ("X", "Y", "Z: g2 to g1"), 0.1)
    ends = camera.to_world(np.stack([grasp.g1, grasp.g2]))
    right.plot(*on_picture(near, ends).T, "--", color=INK, linewidth=1.5)
    for number, end, name, colour, at in zip(
        ("g1", "g2"), ends, finger_names(grasp), FINGER_COLOURS, (150, 490), strict=False
    ):
        draw_contact(right, near, depth, end, f"{number}: {name}", (at, 560), colour)
    save_photo(figure, FOLDER / "frames.png")


def triad(
    axes: Axes, eye: CameraView, origin: Float64, rotation: Float64, names: Sequence[str], length_m: float
) -> None:
    """Draw the three axes of a frame of the world as a camera sees them."""
    start = on_picture(eye, origin[None])[0]
    for direction, colour, name in zip(rotation.T, AXES, names, strict=True):
        (end,) = on_picture(eye, origin + length_m * direction[None])
        beyond = end + [90.0, 40.0] * (end - start) / np.linalg.norm(end - start)
        beyond[0] = np.clip(beyond[0], 9.0 * len(name), 640.0 - 9.0 * len(name))
        axes.annotate(
            "", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2.4, "shrinkA": 0, "shrinkB": 0}
        )
        label(axes, name, beyond, colour)


def draw_recorded() -> None:
    """Predicted beside read, on recorded grasps that the model was not fitted to."""
    from foretouch_lab.learning.data import labels_of, load_dataset, make_folds

    samples = load_dataset(Path(os.environ["FORETOUCH_DATA"]) / "vision2tactile").samples
    train, test = make_folds(samples, "time", 0)[-1].sides(samples)
    model = fit(train, "contact-v3")
    predicted = [model.predict(one.cloud, [one.grasp], table=one.table)[0] for one in test]
    values = np.array([one.value.values for one in predicted])
    errors = np.abs(values - labels_of(test))[:, 2:].mean(axis=1)
    ranked = np.argsort(errors, kind="stable")
    drawn = []
    for share, name in ((0.25, "lower quartile"), (0.5, "median"), (0.75, "upper quartile")):
        k = ranked[round(share * (len(ranked) - 1))]
        title = f"{test[k].object}: {name} of the errors of {len(test)} grasps, predicted from the cloud alone"
        drawn.append(DrawnGrasp(prediction=predicted[k], read=test[k].touch, rest=model.rest, title=title))
    save_touch_picture(FOLDER / "touch_recorded.png", drawn)
    shrink(FOLDER / "touch_recorded.png")


def draw_hands() -> None:
    """Draw the boxes of each hand at its first grasp of the same can, for docs/hands.md."""
    profile = ((1e-4, 0.0), (0.033, 0.0), (0.033, 0.12), (1e-4, 0.12))
    can = turned(YELLOW, profile, (0.0, 0.0, 0.0), lying=0.6)
    camera = CameraView.towards_table(640, 480, 0.75, np.radians(20.0))
    figure = new_figure(PAGE_INCH, 3.0)
    figure.suptitle("one can, taken by three hands (the boxes that describe them)", fontsize=TEXT_PT)
    for axes, (name, title) in zip(figure.subplots(1, 3), HANDS.items(), strict=True):
        grasp = plan_on([can], camera, name)[2].grasps[0]
        draw_hand_boxes(axes, grasp, can, camera)
        axes.set_title(title, fontsize=TEXT_PT)
    save_photo(figure, FOLDER / "hands.png")


def draw_hand_boxes(axes: Axes, grasp: Grasp, thing: Thing, camera: CameraView) -> None:
    """Draw the boxes of a hand at its grasp of a thing, from the side, and name its parts."""
    parts = {part: camera.to_world(boxes) for part, boxes in hand_boxes(grasp).items()}
    shapes = [Thing(to_rgb(COLOURS[part]), corners) for part, boxes in parts.items() for corners in boxes]
    middle, across, _ = frame_in_world(grasp, camera)[:3, [3, 0, 2]].T
    aside = np.cross(across, [0.0, 0.0, 1.0])
    eye = looking(middle + 0.55 * aside + 0.18 * across + [0.0, 0.0, 0.18], (*middle[:2], 0.075), 640, 640, 36.0)
    axes.imshow(Stage([thing, *shapes]).look(eye))
    depth = Stage([thing]).photograph(eye).depth
    ends = middle + np.outer([0.5, -0.5], across * grasp.width_m)
    named = ("thumb", "middle finger") if grasp.way and grasp.way.joints else ("finger at g1", "finger at g2")
    for end, text, colour in zip(ends, named, FINGER_COLOURS, strict=False):
        left = on_picture(eye, end[None])[0, 0] < 320
        draw_contact(axes, eye, depth, end, text, (125 if left else 515, 530), colour)
    label(axes, "object", (320, 605), BARE, on_picture(eye, middle[None])[0])
    nearest = min(parts["palm"], key=lambda box: float(np.linalg.norm(box.mean(axis=0) - middle)))
    label(axes, "palm", (110, 45), BARE, on_picture(eye, nearest.mean(axis=0)[None])[0])
    axes.set(xticks=[], yticks=[], xlim=(0, 640), ylim=(640, 0))


def draw_by_command(name: str, *words: str) -> None:
    """Draw the picture of a command of foretouch."""
    command([*words, "--picture", str(FOLDER / f"{name}.png")])
    shrink(FOLDER / f"{name}.png")


def draw_bottles() -> None:
    """Draw what `foretouch segment` and `grasp` find in the recorded image of the examples."""
    folder = str(FOLDER.parent / "examples" / "data" / "bottles")
    draw_by_command("bottles", "segment", folder)
    draw_by_command("inputs", "grasp", folder, "--target", "nearest", "--hand", "franka_hand", "--panels", "image,side")


PICTURES: Final[dict[str, Callable[[], object]]] = {
    "steps": draw_steps,
    "frames": draw_frames,
    "segmentation_background": draw_background,
    "segmentation_joins": draw_joins,
    "grasps": draw_grasps,
    "adaptation": draw_adaptation,
    "intervals": draw_intervals,
    "hands": draw_hands,
    "bottles": draw_bottles,
    "sensor": lambda: command(["sensor", "show", "xela_uskin_4x4", "-o", str(FOLDER / "sensor.png")]),
    "touch_recorded": draw_recorded,
}


def main(*names: str) -> None:
    """Draw some pictures, or all that need no recordings."""
    for name in names or [name for name in PICTURES if name != "touch_recorded"]:
        PICTURES[name]()


if __name__ == "__main__":
    main(*sys.argv[1:])
