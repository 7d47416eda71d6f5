# SPDX-License-Identifier: Apache-2.0
"""Draw what two touches teach: one grasp of each object of a scene, predicted before and after them, beside what is read.

Usage: python examples/draw_touch.py [SCENE.yaml [PICTURE.png]]
"""

import sys
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from foretouch import History, Sample, TouchModel, load_model
from foretouch.pipeline import Pipeline
from foretouch.report.touch_figure import DrawnGrasp, save_touch_picture
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.scene_camera import FrameMaker
from foretouch_lab.simulation.simulate import Simulation

ROOT = Path(__file__).parents[1]
TOUCHES = 2  # before the grasp that is drawn
SAMPLES = 10  # of the scene


def grasp_before_and_after(model: TouchModel, samples: list[Sample], frames: FrameMaker) -> DrawnGrasp:
    """Predict the last of some grasps of one object without the touches before it, and with them."""
    *earlier, last = samples
    slot, attempt = (int(last.extra[name]) for name in ("slot", "attempt"))
    scene = frames.frame(slot, attempt).cloud(with_rgb=True)
    target = replace(Pipeline().segment(scene).targets[0], id=last.object)
    predictions = []
    for touched in ([], earlier):
        history = History(model)
        for sample in touched:
            history.tare(sample.tare, stamp_ns=sample.stamp_ns)
            history.touched(sample.cloud, sample.grasp, sample.touch, stamp_ns=sample.stamp_ns, same_object=True)
        history.tare(last.tare, stamp_ns=last.stamp_ns)
        predictions += history.predict(target, [last.grasp], stamp_ns=last.stamp_ns, same_object=bool(touched))
    before, after = predictions
    known = "unfamiliar" if "unfamiliar" in after.flags else "familiar"
    title = f"{last.object} ({known} to the model {model.name}), before and after {len(earlier)} touches"
    return DrawnGrasp(
        prediction=after, earlier=before, target=target, scene=scene, rest=last.tare, read=last.touch, title=title
    )


def grasps_to_draw(scene: SceneConfig, name: str = "simulated") -> list[DrawnGrasp]:
    """Predict a grasp of each object of a scene before and after the touches, by a model: that of the simulated hand."""
    model = load_model(name)
    frames, samples = FrameMaker(scene), list(Simulation(scene).samples(SAMPLES, workers=1))
    visits = [list(visit) for _, visit in groupby(samples, key=lambda sample: sample.object)]
    return [grasp_before_and_after(model, visit[: TOUCHES + 1], frames) for visit in visits if len(visit) > TOUCHES]


def main(scene_path: str = str(ROOT / "config" / "scenes" / "demo.yaml"), picture: str = "touch.png") -> None:
    """Draw the picture."""
    print(save_touch_picture(picture, grasps_to_draw(load_scene(scene_path))))


if __name__ == "__main__":
    main(*sys.argv[1:])
