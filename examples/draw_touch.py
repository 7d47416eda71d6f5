# SPDX-License-Identifier: Apache-2.0
"""Draw the first two grasps of the demo: an object as the model knows some, and one as it does not, predicted beside read.

Usage: python examples/draw_touch.py [SCENE.yaml [PICTURE.png]]
"""

import sys
from dataclasses import replace
from pathlib import Path

from PIL import Image

from foretouch.pipeline import Pipeline
from foretouch.report.touch_figure import DrawnGrasp, save_touch_picture
from foretouch_lab.simulation.scene import load_scene
from foretouch_lab.simulation.scene_camera import FrameMaker
from foretouch_lab.simulation.simulate import Simulation

ROOT = Path(__file__).parents[1]
OBJECTS = 2
COLOURS = 128


def main(scene_path: str = str(ROOT / "config" / "scenes" / "demo.yaml"), picture: str = "touch.png") -> None:
    """Grasp each object of the scene once."""
    scene, pipeline = load_scene(scene_path), Pipeline()
    frames = FrameMaker(scene)
    drawn = []
    for slot, sample in enumerate(Simulation(scene).samples(OBJECTS, workers=1)):
        cloud = frames.frame(slot).cloud()
        target = replace(pipeline.segment(cloud).targets[0], id=sample.object)
        (prediction,) = pipeline.predict(target, [sample.grasp], tare=sample.tare)
        known = "does not know any such object (unfamiliar)" if prediction.flags else "knows such objects"
        title = (
            f"{sample.object}: {pipeline.model.name} {known}; readings of a simulated hand, on which it was not trained"
        )
        drawn.append(
            DrawnGrasp(
                target=target, prediction=prediction, scene=cloud, rest=sample.tare, read=sample.touch, title=title
            )
        )
    path = save_touch_picture(picture, drawn)
    Image.open(path).convert("RGB").quantize(COLOURS).save(path, optimize=True)  # a third of the size
    print(path)


if __name__ == "__main__":
    main(*sys.argv[1:])
