# SPDX-License-Identifier: Apache-2.0
"""`foretouch simulate`: a data set of simulated grasps, only with the effects that the scene calls for."""

import argparse
import os
import time
from pathlib import Path

from foretouch import __version__
from foretouch.cli.inputs import positive_number, seed_number
from foretouch.cli.output import print_json, print_table, progress_bar
from foretouch.cli.parser import CommandParser
from foretouch.config import parse_overrides
from foretouch.errors import ConfigError, FileError
from foretouch.types import Sample
from foretouch_lab.dataset.store_writer import StoreWriter
from foretouch_lab.simulation.scene import SceneConfig, load_scene
from foretouch_lab.simulation.simulate import Simulation, explain_scene

SHEET = "contact_sheet.png"
_SHEET_SAMPLES = 12


def add_arguments(parser: CommandParser) -> None:
    """Declare the scene, how many samples, and where to."""
    parser.add_argument("scene", metavar="SCENE", help="scene file (YAML), such as config/scenes/rigid.yaml")
    parser.add_argument(
        "-n", "--count", type=positive_number, metavar="N", help="number of samples; required except with --explain"
    )
    parser.add_argument(
        "-o", "--out", type=Path, metavar="DIR", help="training store to create, which must not exist; required as -n"
    )
    parser.add_argument("--seed", type=seed_number, help="random seed (default: the scene's)")
    parser.add_argument(
        "--workers",
        type=positive_number,
        help="number of processes (default: one a core); the samples do not depend on it",
    )
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="change one setting of the scene; camera.noise={} switches an effect on, camera.noise=null off",
    )
    parser.add_argument(
        "--explain",
        action="store_true",
        help="list the effects that would run and the field that enables each; run nothing",
    )
    parser.add_argument("--no-sheet", action="store_true", help=f"do not draw {SHEET}")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 0, and a slot that is given up is an error."""
    scene = _scene(arguments)
    if arguments.explain:
        return _explain(scene, arguments.json)
    if arguments.count is None or arguments.out is None:
        raise ConfigError("simulate: -n and -o are needed, or --explain")
    if arguments.out.exists():
        raise FileError(arguments.out, "exists already")
    return _simulate(scene, arguments)


def _scene(arguments: argparse.Namespace) -> SceneConfig:
    scene = load_scene(arguments.scene)
    changes = parse_overrides(arguments.set)
    if arguments.seed is not None:
        changes["seed"] = arguments.seed
    return scene.updated(changes, "--set") if changes else scene


def _explain(scene: SceneConfig, as_json: bool) -> int:
    plans, everyone = explain_scene(scene), len(scene.objects)
    if as_json:
        effects = [
            {"name": p.name, "ran": p.runs, "ms_per_sample": None, "reason": p.reason, "objects": p.objects}
            for p in plans
        ]
        print_json({"effects": effects, "samples": 0, "scene_sha256": scene.sha256()})
    else:
        rows = [
            [p.name, "runs" if p.runs else "-", p.reason, "all" if len(p.objects) == everyone else ", ".join(p.objects)]
            for p in plans
        ]
        print_table("effects", ["effect", "", "for", "objects"], rows)
    return 0


def _simulate(scene: SceneConfig, arguments: argparse.Namespace) -> int:
    simulation = Simulation(scene)
    about = {
        "made_by": f"foretouch {__version__} simulate",
        "scene": scene.to_mapping(),
        "scene_sha256": scene.sha256(),
        "scene_file": str(arguments.scene),
    }
    shown: list[Sample] = []
    start = time.perf_counter()
    with (
        StoreWriter(arguments.out, about, scene.fingers.taxel_sensor()) as writer,
        progress_bar("simulating", arguments.count, hidden=arguments.json) as advance,
    ):
        for sample in simulation.samples(arguments.count, arguments.workers or len(os.sched_getaffinity(0))):
            advance()
            writer.write(sample)
            if len(shown) < _SHEET_SAMPLES:
                shown.append(sample)
        writer.about["failures"] = [
            {"slot": f.key.slot, "attempt": f.key.attempt, "reason": f.reason, "message": f.message}
            for f in simulation.failures
        ]
    seconds = time.perf_counter() - start
    if not arguments.no_sheet:
        from foretouch.report.touch_figure import save_contact_sheet

        save_contact_sheet(arguments.out / SHEET, shown, writer.sensor)
    _report(simulation, writer.sha256, arguments, seconds)
    return 0


def _report(simulation: Simulation, sha256: str, arguments: argparse.Namespace, seconds: float) -> None:
    count = arguments.count
    plans = explain_scene(simulation.scene)
    calls = simulation.calls
    seconds_of = simulation.seconds
    if arguments.json:
        effects = [
            {
                "name": plan.name,
                "ran": calls[plan.name] > 0,
                "ms_per_sample": 1e3 * seconds_of[plan.name] / count,
                "reason": plan.reason,
                "calls": calls[plan.name],
            }
            for plan in plans
        ]
        print_json({
            "effects": effects,
            "samples": count,
            "samples_per_s": count / seconds,
            "sha256": sha256,
            "scene_sha256": simulation.scene.sha256(),
            "failures": simulation.failures_by_reason,
            "path": str(arguments.out),
        })  # fmt: skip
        return
    failures = ", ".join(f"{n} {reason}" for reason, n in simulation.failures_by_reason.items()) or "none"
    print(f"{count} samples in {arguments.out}, {count / seconds:.1f} a second; failed tries: {failures}")
    print(f"sha256 {sha256}")
