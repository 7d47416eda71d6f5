# SPDX-License-Identifier: Apache-2.0
"""Does touch depend on where the camera is? See README.md."""

from argparse import ArgumentParser
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.common import print_rows, read_csv, write_csv
from foretouch import load_model
from foretouch.errors import SimulationError
from foretouch.models.contact.estimator import ContactEstimator, NoveltyDetector
from foretouch.models.contact.features import CHECKED, UPPER_FEATURES, HandFrameFeatures
from foretouch.models.novelty import IN_DISTRIBUTION
from foretouch.types import Float64, Grasp, Sample
from foretouch_lab.learning.evaluation.metrics import mean_skill, score
from foretouch_lab.learning.training.contact import ContactTrainingConfig, describe_samples, fit_contact
from foretouch_lab.simulation.effects.view import EFFECTS
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.simulate import Simulation
from foretouch_lab.simulation.world import SampleKey

RESULTS: Final = Path(__file__).parent / "results.csv"
TILTS_DEG: Final = (0, 20, 40, 60)
FIELDS_DEG: Final = {0.4: 90.0, 0.7: 65.0, 1.3: 55.0}  # of view, by the distance of the camera [m]
KNOWN, STRANGE = 8, 24  # objects of a set
TRAINED, TESTED, STRANGE_GRASPS = 40, 8, 2  # grasps on each object
ANGLES: Final = {"pitch_deg": [-5, 5], "roll_deg": [-5, 5]}
UPPER: Final = [CHECKED.index(name) for name in UPPER_FEATURES]
LENGTHS: Final = [CHECKED.index(f"upper_extent_{k}") for k in (2, 3)]


@dataclass(frozen=True)
class View:
    """A grasp as one camera sees it."""

    grasp: str  # name of its sample
    tilt_deg: int
    distance_m: float
    row: Float64  # features
    touch: Float64  # counts


def scene(objects: int, objects_seed: int, seed: int) -> SceneConfig:
    """Return a scene of soft objects of eight shapes, 5 to 12 cm large, seen from straight above."""
    shapes = ["random", "can", "box", "ball", "flat_ball", "sponge", "volleyball", "minion"]
    sizes = {"size_m": [0.05, 0.12], "young_pa": [2e4, 1.5e5], "thickness_m": [0.01, 0.03]}
    family = {"name": "o", "count": objects, "seed": objects_seed, "shapes": shapes, "rests": ["upright", "side"]}
    content = {
        "families": [family | sizes],
        "camera": {"distance_m": 1.25, "z_step_m": 0.001, "noise": {}},
        "grasps": {"slide": True, "max_width_m": 0.14, "error": {}, "insertion_m": 0.0},
        "fingers": {"thumb_posture": ANGLES, "middle_posture": ANGLES, "noise": {}},
        "max_attempts": 200,
        "seed": seed,
    }
    return SceneConfig.from_mapping(content, "views")


def views(from_above: SceneConfig, samples: Sequence[Sample]) -> Iterator[View]:
    """Yield each grasp as cameras at all angles and distances see it. Object, grasp and readings are the same."""
    above = Engine(from_above, EFFECTS).world.view
    for tilt in TILTS_DEG:
        for distance, field in FIELDS_DEG.items():
            camera = from_above.camera.replace(tilt_deg=float(tilt), distance_m=distance, hfov_deg=field)
            engine = Engine(from_above.replace(camera=camera), EFFECTS)
            for sample in samples:
                key = SampleKey(*(int(sample.extra[name]) for name in ("seed", "slot", "attempt")))
                try:
                    cloud = engine.run(key).cloud
                except SimulationError:  # out of the image
                    continue
                view = engine.world.view
                g1, g2 = (view.to_camera(above.to_world(contact)) for contact in (sample.grasp.g1, sample.grasp.g2))
                turned = view.R_world_camera.T @ above.R_world_camera @ sample.grasp.rotation
                row = HandFrameFeatures(cloud.xyz, engine.world.plane).describe([Grasp(g1, g2, turned)])[0]
                yield View(sample.id, tilt, distance, row, sample.touch.values)


def fitted(samples: Sequence[Sample]) -> ContactEstimator:
    """Return a contact model of the grasps that were seen from above."""
    readings = np.array([sample.touch.values for sample in samples])
    return fit_contact(
        describe_samples(samples), readings, [sample.object for sample in samples], ContactTrainingConfig()
    )


def flagged(detector: NoveltyDetector, seen: Sequence[View]) -> float:
    """Return the share of the grasps that are unfamiliar."""
    return float((detector.scores(np.array([view.row for view in seen])) < IN_DISTRIBUTION).mean())


def length_error_mm(seen: Sequence[View], from_above: Mapping[str, View]) -> float:
    """Return the root mean square error of the length and the width of the upper side [mm], beside the same grasps from above."""
    errors = np.array([view.row[LENGTHS] - from_above[view.grasp].row[LENGTHS] for view in seen])
    return 1e3 * float(np.sqrt((errors**2).mean()))


def of_set(seed: int) -> list[dict[str, Any]]:
    """Return rows of one set of objects, one for each tilt."""
    known, strange = scene(KNOWN, 100 + seed, seed), scene(STRANGE, 1000 + seed, seed)
    samples = list(Simulation(known).samples(KNOWN * (TRAINED + TESTED)))
    train, test = samples[: KNOWN * TRAINED], samples[KNOWN * TRAINED :]
    estimator = fitted(train)
    seen = list(views(known, test))
    strangers = list(views(strange, list(Simulation(strange).samples(STRANGE * STRANGE_GRASPS))))
    from_above = {view.grasp: view for view in seen if (view.tilt_deg, view.distance_m) == (0, 0.7)}
    shipped, rows = load_model("contact-v3").predictor.novelty, []
    for tilt in TILTS_DEG:
        own = [view for view in seen if view.tilt_deg == tilt]
        others = [view for view in strangers if view.tilt_deg == tilt]
        counts, _ = estimator.predict_rows(np.array([view.row for view in own]))
        readings = np.array([view.touch for view in own])
        reference = np.tile(estimator.mean, (len(own), 1))
        row = {
            "set": seed, "tilt_deg": tilt, "grasps": len(own), "strange_grasps": len(others),
            "skill": round(mean_skill(score(counts, readings, reference, estimator.ranges)), 4),
            "known_flagged": round(flagged(estimator.novelty, own), 4),
            "strange_flagged": round(flagged(estimator.novelty, others), 4),
            "flagged_by_contact_v3": round(flagged(shipped, others), 4),
            "length_error_mm": round(length_error_mm(own, from_above), 2),
        }  # fmt: skip
        rows.append(row)
    return rows


def main() -> None:
    """Write results.csv."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, nargs="+", default=list(range(1, 9)), help="numbers of the sets of objects")
    parser.add_argument("--print", action="store_true", help="only print results.csv")
    arguments = parser.parse_args()
    if not arguments.print:
        write_csv(RESULTS, [row for seed in arguments.sets for row in of_set(seed)])
    table = read_csv(RESULTS)
    columns = ("skill", "known_flagged", "strange_flagged", "flagged_by_contact_v3", "length_error_mm")
    groups = {"chosen with": ("1", "2", "3", "4"), "new": ("5", "6", "7", "8")}
    rows = []
    for name, sets in groups.items():
        for tilt in TILTS_DEG:
            own = [row for row in table if row["set"] in sets and row["tilt_deg"] == str(tilt)]
            if own:
                means = {column: np.mean([float(row[column]) for row in own]) for column in columns}
                rows.append({"sets": name, "tilt_deg": tilt, **means})
    print_rows(rows)


if __name__ == "__main__":
    main()
