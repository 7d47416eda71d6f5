# SPDX-License-Identifier: Apache-2.0
"""Render the moving picture of README, and the last image of it: python docs/moving_picture.py.

The can of `config/scenes/demo.yaml` lies among three other objects, once with each of twenty seeds, and is grasped once. The grasp is
shown whose mean electrode error is the median, or the lower of the two in the middle. The simulated hand gives the readings; its contact is solved
by `foretouch_lab.simulation`; MuJoCo renders the same objects at the same places.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image
from rendering import Photograph, Stage, Thing, frame_in_world, looking

from foretouch.models import load_model
from foretouch.pipeline import Pipeline
from foretouch.report.camera_figure import draw_camera
from foretouch.report.finger_figure import FingerScale, finger_levels, title_finger
from foretouch.report.panels import INK, PAGE_INCH, TEXT_PT, new_figure
from foretouch.tactile import biotac_touch
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.taxel_view import TaxelView
from foretouch.types import Bool, Prediction, Sample, Touch
from foretouch.types.scene import Scene
from foretouch_lab.learning.prequential import replay_model
from foretouch_lab.simulation.depth_scene import CameraView
from foretouch_lab.simulation.effects import view
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.simulate import Simulation
from foretouch_lab.simulation.solids import Body
from foretouch_lab.simulation.world import SampleKey

FOLDER: Final = Path(__file__).parent
RUNS: Final = 20
COLOURS: Final = ((0.78, 0.22, 0.18), (0.2, 0.45, 0.7), (0.88, 0.66, 0.2), (0.36, 0.6, 0.36))  # the can first
APART_M: Final = (0.25, 0.3)  # of the other objects, so that no finger reaches them
SEEN: Final = (500, 375)  # how much of the camera's image is shown [px]
DPI: Final = 144
QUALITY: Final = 80  # of the images


@dataclass(frozen=True, eq=False)
class Run:
    """A grasp of the can that is predicted, then executed by the simulated hand."""

    scene: SceneConfig
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


def demo_run(seed: int) -> Run:
    """Return the grasp of a seed, predicted by the model `simulated` from the cloud and a tare."""
    demo = load_scene(FOLDER.parent / "config" / "scenes" / "demo.yaml")
    changes = {
        "campaign.objects": 1,
        "campaign.grasps": 1,
        "clutter.count": 3,
        "clutter.distance_m": APART_M,
        "seed": seed,
    }
    of_can = replace(demo.updated(changes), objects=demo.objects[:1])
    samples = list(Simulation(of_can).samples(1))
    played = replay_model(load_model("simulated"), samples).played
    value, half = played.counts[0], played.half[0]
    prediction = Prediction.of(samples[0].grasp, *(biotac_touch(value + sign * half) for sign in (0.0, -1.0, 1.0)))
    read = samples[0].touch
    assert read is not None  # noqa: S101  it was executed
    return Run(of_can, samples[0], prediction, read)


def median_run() -> Run:
    """Return the run with the median error, or the lower of the two in the middle."""
    runs = sorted(map(demo_run, range(RUNS)), key=lambda run: run.error)
    errors = [round(run.error, 1) for run in runs]
    print(f"mean errors of the electrodes: {errors} counts")  # noqa: T201
    return runs[(RUNS - 1) // 2]


def thing_of(body: Body, colour: tuple[float, float, float]) -> Thing:
    """Return a body of the simulator for MuJoCo."""
    mesh = body.mesh
    return Thing(colour, body.position + (mesh.vertices * body.size) @ body.rotation.T, mesh.faces)


class MovingPicture:
    """Camera image, 3D view and the fingers of both hands' fingertips, image by image."""

    def __init__(self, run: Run) -> None:
        self.run = run
        engine = Engine(run.scene, (*view.PLACING, *view.FRAME_EFFECTS))
        slot, attempt = (int(run.sample.extra[name]) for name in ("slot", "attempt"))
        state = engine.run(SampleKey(run.scene.seed, slot, attempt))
        camera = engine.world.view
        self.stage = Stage([thing_of(*pair) for pair in zip(state.bodies, COLOURS, strict=False)], hand=True)
        self.photograph: Photograph = self.stage.photograph(camera)
        self.cloud = self.photograph.cloud()
        self.scene: Scene = Pipeline().segment(self.cloud)
        self.frame_of_grasp = frame_in_world(run.sample.grasp, camera)
        self.eye = self._eye()
        self._lay_out()

    def _eye(self) -> CameraView:
        """Return the camera of the 3D view: below the wrist, so that both fingertips are seen."""
        middle, across = self.frame_of_grasp[:3, 3], self.frame_of_grasp[:3, 0] * (1.0, 1.0, 0.0)
        across /= np.linalg.norm(across)
        arm = -(self.frame_of_grasp @ self.stage.hand.at(self.run.sample.grasp.width_m).tool)[:3, 2] * (1.0, 1.0, 0.0)
        ahead = np.cross([0.0, 0.0, 1.0], across)
        ahead *= -np.sign(ahead @ arm) or 1.0
        place = middle - 0.4 * ahead - 0.08 * across + (0.0, 0.0, 0.22)
        return looking(place, middle + np.array([0.0, 0.0, 0.03]), 754, 486, 50.0)

    def _lay_out(self) -> None:
        self.figure = new_figure(PAGE_INCH, 6.2)
        self.figure.set_layout_engine("none")
        self.image = self.figure.add_axes((0.008, 0.48, 0.45, 0.42))
        self.space = self.figure.add_axes((0.468, 0.48, 0.524, 0.42), xticks=[], yticks=[])
        self.text = self.figure.text(0.5, 0.965, "", ha="center", va="center", fontsize=12, color=INK)
        self.fingers = [self.figure.add_axes((0.01 + 0.25 * k, 0.16, 0.23, 0.235)) for k in range(4)]
        self.scale_at = self.figure.add_axes((0.3, 0.128, 0.4, 0.015))
        for axes in (*self.fingers, self.scale_at):
            axes.set_axis_off()
        sight = TaxelView(BIOTAC_SP)
        rest = self.run.sample.tare
        predicted = [finger_levels(sight, self.run.prediction, rest, k) for k in (0, 1)]
        read = [(sight.levels(self.run.read.values, rest, k), None) for k in (0, 1)]
        levels = [level for level, _ in (*predicted, *read)]
        self.scale = FingerScale(sight, levels, [half for _, half in predicted if half is not None], tared=True)
        self.drawn = predicted, read
        for k, axes in enumerate(self.fingers):
            self.scale.draw(axes, k // 2, np.full(sight.sensor.size, np.nan))  # no values yet
            title_finger(axes, self.scale, k // 2, "", ("predicted", "read")[k % 2])

    def draw_image(self, *, objects: bool, grasp: bool = False) -> None:
        """Draw what the camera sees, with the outlines of the objects, the target's in the first colour, and the contacts."""
        self.image.clear()
        target = self.scene.near(self.run.sample.grasp.g1)
        ordered = [target, *(item for item in self.scene.objects if item is not target)]
        areas = {item.id: self.scene.labels == int(item.id) for item in ordered} if objects else {}
        contacts = replace(self.run.sample.grasp, way=None, object_id=target.id) if grasp else None
        draw_camera(self.image, self.cloud, areas, grasp=contacts, fingers=self.scale.view.fingers)
        height, width = self.scene.labels.shape
        left, top = (width - SEEN[0]) / 2.0, (height - SEEN[1]) / 2.0
        self.image.set(xlim=(left, left + SEEN[0]), ylim=(top + SEEN[1], top))
        self.image.set_title("camera image" + (" with the objects found in it" if objects else ""), fontsize=TEXT_PT)

    def draw_space(self, *, opened: float = 1.0, away_m: float = 0.16) -> None:
        """Draw the hand at the table."""
        self.stage.place_hand(self.frame_of_grasp, self.run.sample.grasp.width_m, opened=opened, away_m=away_m)
        self.space.clear()
        self.space.imshow(self.stage.look(self.eye))
        self.space.set(xticks=[], yticks=[])
        self.space.set_title("the simulated hand", fontsize=TEXT_PT)

    def draw_fingers(self, read: int) -> None:
        """Draw both fingertips, predicted or read: of each finger beside each other."""
        for finger in (0, 1):
            axes = self.fingers[2 * finger + read]
            levels, half = self.drawn[read][finger]
            outside = self.run.missed[self.scale.view.columns(finger)] if read else None
            self.scale.draw(axes, finger, levels, half=half, outside=outside)
        if not read:
            self.scale_at.set_axis_on()
            self.scale.add_bar(self.figure, None, cax=self.scale_at)

    def frames(self) -> Iterator[tuple[Image.Image, int]]:
        """Iterate over images and how long each is shown [ms]."""
        self.draw_image(objects=False)
        self.draw_space()
        yield self.shot("A camera looks at a table."), 1400
        self.draw_image(objects=True)
        yield self.shot("foretouch finds the objects, …"), 1400
        self.draw_image(objects=True, grasp=True)
        yield self.shot("… plans a grasp, …"), 1400
        self.draw_fingers(0)
        yield self.shot("… and predicts what 24 electrodes of each fingertip will read."), 3000
        for step in range(10):
            self.draw_space(away_m=0.16 * (1.0 - (step + 1) / 10.0) ** 1.3)
            yield self.shot("Then the hand comes …"), 90
        for step in range(6):
            self.draw_space(opened=1.0 - (step + 1) / 6.0, away_m=0.0)
            yield self.shot("… and closes."), 110
        self.draw_fingers(1)
        inside = int((~self.run.missed[2:]).sum())
        yield self.shot(f"{inside} of 48 electrodes were read within their predicted 90 % intervals."), 5000

    def shot(self, text: str) -> Image.Image:
        """Return the picture as it is, below a line of text."""
        self.text.set_text(text)
        held = io.BytesIO()
        self.figure.savefig(held, format="png", dpi=DPI, facecolor="white")
        return Image.open(held).convert("RGB")


def main() -> None:
    """Write the moving picture."""
    images, durations = zip(*MovingPicture(median_run()).frames(), strict=True)
    path = FOLDER / "demo.webp"
    images[0].save(path, save_all=True, append_images=images[1:], duration=list(durations), loop=0, quality=QUALITY, method=6)  # fmt: skip
    print(f"{path}: {len(images)} images, {path.stat().st_size / 1e6:.2f} MB")  # noqa: T201


if __name__ == "__main__":
    main()
