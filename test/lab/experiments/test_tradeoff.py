# SPDX-License-Identifier: Apache-2.0
"""An area of one's own from skill to picture, timed again and redrawn; and what the areas of the package measure."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from contact_model_builders import FEW_TREES
from every_case import every_case
from experiment_samples import make_collection, make_samples

from foretouch.camera.device import ensure_libusb
from foretouch.cli.main import main
from foretouch.errors import ConfigError, ForetouchError
from foretouch.pipeline import PipelineConfig
from foretouch.types import Cloud
from foretouch_lab.cli.experiment import data_source
from foretouch_lab.experiments import (
    peers,
    tradeoff_chain,
    tradeoff_grasp,
    tradeoff_model,
    tradeoff_scene,
    tradeoff_simulation,
    tradeoff_training,
)
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.manifest import read_results, write_results
from foretouch_lab.experiments.framework.tradeoff import Area, Panel, find_area, frontier, list_areas
from foretouch_lab.experiments.shared.scores import skill_rows
from foretouch_lab.experiments.shared.touched_scenes import HARD, SceneSettings, TouchedScenes, overlap
from foretouch_lab.experiments.tradeoff_grasp import FoundObjects
from foretouch_lab.experiments.tradeoff_model import NETWORKS, ModelSettings, fewer_trees
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig
from foretouch_lab.learning.training.contact import describe_samples, fit_contact
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT

ROOT = Path(__file__).parents[3]
GRASPS = make_collection()
QUICK = BootstrapConfig(draws=100)

SOURCE = """
import math
import time
from hashlib import sha256

from foretouch_lab.experiments.framework.tradeoff import Panel, Variant, make_area

TERMS = {"shipped": 8, "short": 2, "long": 12, "slow and bad": 1}


class Words:
    def __init__(self, path):
        self.sha256 = sha256(path.read_bytes()).hexdigest()


def closeness(terms):
    return 1.0 - abs(4.0 * sum((-1.0) ** k / (2 * k + 1) for k in range(terms)) - math.pi)


def timed(variant, settings, data):
    def answer(count):
        end = time.thread_time() + (2e-3 if variant.name == "slow and bad" else 1e-4 * TERMS[variant.name])
        while time.thread_time() < end:
            pass

    return answer, 1.0


EXPERIMENT = make_area(
    lambda skill, settings, data: {name: {skill: closeness(terms)} for name, terms in TERMS.items()},
    name="pi",
    question="How many digits in a millisecond?",
    module=__name__,
    presets={"small": {"timing_s": 0.3, "requests": [1, 3], "pause_s": 0.001}, "full": {}},
    load=lambda settings, path: Words(path),
    data_folder="data.txt",
    variants=[Variant(name, "shipped" if name == "shipped" else "terms") for name in TERMS],
    timed=timed,
    panels=(Panel("skill", 1, "One number"),),
)
"""


@pytest.fixture(scope="module")
def scenes_of_each_kind() -> tuple[TouchedScenes, TouchedScenes]:
    """Two images whose objects are apart, and two whose objects touch."""
    return TouchedScenes.render(2), TouchedScenes.render(2, HARD)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_this_process: None) -> Path:
    (tmp_path / "pi_lab").mkdir()
    (tmp_path / "pi_lab/__init__.py").touch()
    (tmp_path / "pi_lab/pi.py").write_text(SOURCE)
    (tmp_path / "data.txt").write_text("3")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("pi_lab", "pi_lab.pi"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


def test_an_area_gives_table_and_picture_and_is_timed_again_with_its_skills(lab: Path, capsys) -> None:
    def run(*words: str) -> tuple[int, dict[str, object] | str]:
        head = ["tradeoff", "pi_lab.pi", "-o", str(lab / "out"), "--data", str(lab / "data.txt"), "--workers", "1"]
        status = main([*head, "--json", *words])
        printed = capsys.readouterr()
        return status, json.loads(printed.out.splitlines()[-1]) if printed.out else printed.err

    status, last = run()
    assert (status, last["cells"]) == (0, 1)
    assert last["frontier"] == {"One number": ["short", "shipped", "long"]}
    table, summary = lab / "out/tradeoff.csv", lab / "out/summary.md"
    rows = read_results(table)
    names = ("shipped", "short", "long", "slow and bad")
    assert {(row["variant"], row["request"]) for row in rows} == {(name, n) for name in names for n in (1, 3)}
    for row in rows:
        assert row["ms_p50"] <= row["ms_p95"] <= row["ms_p99"]
        assert row["calls"] >= 5
        assert row["state"] in ("idle", "loaded")
    short, long = (next(row for row in rows if row["variant"] == one) for one in ("short", "long"))
    assert long["cpu_ms"] / short["cpu_ms"] == pytest.approx(6.0, rel=0.3)
    assert "| shipped * | " in summary.read_text()
    assert (lab / "out/tradeoff.png").stat().st_size > 10_000

    first = table.read_text()
    assert "--resume" in run()[1]
    assert run("--resume")[1]["reused"] == 1  # no cell was run
    origin = summary.read_text().splitlines()[2]
    assert origin.startswith(f"`foretouch tradeoff pi --preset small --data {lab / 'data.txt'}`; foretouch ")
    shutil.rmtree(lab / "out/cells")  # as published results are
    (lab / "out/manifest.json").unlink()
    again = table.read_text()
    assert again != first
    assert run("--redraw")[1]["figures"] == ["tradeoff.png"]
    assert summary.read_text().splitlines()[2] == origin
    assert {row["skill"] for row in read_results(table) if row["variant"] == "short"} == {0.52507}
    (lab / "out/tradeoff.csv").unlink()
    assert "skills: 'taste' is not one of skill" in run("skills=[taste]", "--resume")[1]


def test_a_frontier_is_timed_here_and_all_areas_run_one_after_the_other(lab: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("foretouch_lab.cli.tradeoff.list_areas", lambda: [find_area("pi_lab.pi")])
    monkeypatch.setenv("FORETOUCH_DATA", str(lab))
    out, head = lab / "times", ["tradeoff", "all", "--workers", "1", "--json"]

    def run(*words: str) -> str:
        assert main([*head, *words]) == 0
        return capsys.readouterr().out

    run("-o", str(out))
    table = out / "pi/tradeoff.csv"
    rows = read_results(table)
    assert {row["yardstick_ms"] > 0.0 for row in rows} == {True}
    assert all(row["cpu_ms"] <= row["cpu_ms_p95"] for row in rows)
    assert "Yardstick: SciPy's k-d tree" in (out / "pi/summary.md").read_text()
    before = table.read_bytes()
    assert run("-o", str(out), "--resume") == ""  # it is measured
    assert table.read_bytes() == before
    here = json.loads(run("--here", str(out)))
    assert [(row[0], row[1]) for row in here["rows"]] == [
        (name, size) for name in ("shipped", "short", "long") for size in ("1", "3")
    ]  # what is on the frontier, and the shipped one
    assert "The yardstick takes" in here["notes"][0]
    assert main([*head, "-o", str(out), "skills=[skill]"]) == 1
    assert "tradeoff all: takes -o DIR or --here DIR" in capsys.readouterr().err


def test_areas_of_the_package_and_their_committed_tables(capsys: pytest.CaptureFixture[str]) -> None:
    areas = list_areas()
    assert [one.area for one in areas] == ["chain", "grasp", "model", "scene", "simulation", "training"]
    assert (find_area("touch").area, find_area("perception").area) == ("model", "scene")

    def check(area: Area) -> None:
        assert find_area(area.area) is area
        names = [variant.name for variant in area.variants]
        assert len(set(names)) == len(names)
        assert [variant for variant in area.variants if variant.factor == "shipped"]
        folder = ROOT / "docs/results/tradeoff" / area.area
        rows = read_results(folder / "tradeoff.csv")
        summary = (folder / "summary.md").read_text()
        for table in area.tables(rows):
            assert all(" | ".join(line) in summary for line in table.rows)
            assert all(note in summary for note in table.notes)

    every_case({one.area: one for one in areas}, check)
    with pytest.raises(ConfigError, match=r"'nothing' is not one of chain, grasp, model"):
        find_area("nothing")
    assert main(["tradeoff", "list", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[0])["name"] == "chain"


def test_the_frontier_holds_what_nothing_beats_and_of_equals_of_the_best_the_fastest() -> None:
    errors = np.array([[100.0] * 8, [60.0] * 8, [57.0, 62.0] * 4, [20.0] * 8, [19.0, 21.1] * 4])  # of each object
    names = ("mean", "quick", "slow", "best", "fast")
    made = {
        name: [
            {"object": str(k), "count": 1, "squared": [e] * 50, "reference": [100.0] * 50} for k, e in enumerate(own)
        ]
        for name, own in zip(names, errors, strict=True)
    }
    found = skill_rows("skill", made, BootstrapConfig(draws=500))
    equals = {name: row["skill_equals"] for name, row in found.items()}
    assert equals == {"mean": None, "quick": None, "slow": None, "best": "best", "fast": "best"}
    times: dict[str, float | None] = {"mean": 1.0, "quick": 2.0, "slow": 3.0, "best": 5.0, "fast": 4.0}
    rows: list[Row] = [
        {"variant": name, "ms_p50": ms, "cpu_ms": ms, "state": "idle", "request": 1, **found[name]}
        for name, ms in times.items()
    ]
    late = {**rows[0], "ms_p50": 9.0, "state": "loaded"}  # of a table of both states of the machine the idle one counts
    none = {**rows[0], "variant": "unknown", "skill": None}
    panel = Panel("skill", 1, "All")
    assert [row["variant"] for row in frontier([*rows, late, none], panel)] == ["mean", "quick", "slow", "fast"]


@pytest.mark.slow
def test_models_are_measured_on_each_split_and_timed() -> None:
    area = tradeoff_model.EXPERIMENT
    settings = ModelSettings(requests=(1, 2), bootstrap=QUICK)
    rows = area.run(area.cells(settings, GRASPS)[1], settings, GRASPS)
    found = {row["variant"]: row for row in rows}
    assert found.keys() == {variant.name for variant in area.variants} - {"mean of the object"} - {*NETWORKS}
    assert found["mean of labels + readings"]["object"] > 0.1
    assert found["mean of labels"]["object"] == 0.0
    assert found["contact-v3"]["object_rmse_PDC_TH"] > 0.0
    assert found["10 trees"]["object"] != found["contact-v3"]["object"]
    made = {variant.name: area.timed(variant, settings, GRASPS)[0] for variant in area.variants}
    for name, answer in made.items():
        assert answer(2).shape == (2, 50), name
    assert not np.array_equal(made["contact-v3 + readings"](1), made["contact-v3"](1))


def test_networks_have_the_skill_of_the_leaderboard_and_one_of_other_data_is_refused(tmp_path) -> None:
    recipe, table = NETWORKS["P1's PointNet"], tmp_path / "results.csv"
    row = {
        "predictor": recipe,
        "split": "object",
        "modality": "mean",
        "skill": -0.5,
        "skill_low": -0.9,
        "skill_high": -0.1,
    }
    rows = [row | {"data": GRASPS.sha256[:16]}, row | {"data": GRASPS.sha256[:16], "modality": "PDC_MF", "skill": 0.3}]
    write_results(tmp_path, rows)
    found = tradeoff_model._of_leaderboard("object", str(table), GRASPS)
    assert found == {"P1's PointNet": {"object": -0.5, "object_low": -0.9, "object_high": -0.1}}
    assert tradeoff_model._of_leaderboard("time", str(table), GRASPS) == {}
    assert tradeoff_model._of_leaderboard("time", "", GRASPS) == {}
    write_results(tmp_path, [row | {"data": "other"}])
    with pytest.raises(ConfigError, match=r"leaderboard: .*results.csv is of other data than"):
        tradeoff_model._of_leaderboard("object", str(table), GRASPS)
    table.write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(
        ConfigError, match=r"leaderboard: .*results.csv is not a results.csv of `foretouch benchmark touch`"
    ):
        tradeoff_model.EXPERIMENT.prepare(ModelSettings(leaderboard=str(table)), tmp_path, tmp_path)
    published = {row["predictor"] for row in read_results(ROOT / "docs/results/leaderboard/results.csv")}
    assert published >= set(NETWORKS.values())


def test_the_objects_of_a_scene_are_found_and_measured_with_their_masks(monkeypatch, scenes_of_each_kind) -> None:
    truth = np.array([[2, 2, 2, 2, 0, 3, 3, 0]], np.int32)
    labels = np.array([[1, 1, 1, 2, 0, 3, 3, 3]], np.int32)
    assert [overlap(labels, truth == label) for label in (2, 3, 4)] == [3 / 4, 2 / 3, 0.0]
    area, settings, (_, hard) = tradeoff_scene.EXPERIMENT, SceneSettings(bootstrap=QUICK), scenes_of_each_kind
    fewer = tuple(one for one in area.variants if one.name in ("default", "grid rows 60", "angle deg 180"))
    monkeypatch.setattr(tradeoff_scene, "VARIANTS", fewer)
    found = {skill: tradeoff_scene._accuracy(skill, settings, hard) for skill in ("found", "iou")}
    assert found["iou"].keys() == {one.name for one in fewer}
    assert found["iou"]["default"]["iou"] > found["iou"]["angle deg 180"]["iou"] > 0.3
    assert found["found"]["default"]["found_low"] <= found["found"]["default"]["found"] <= 1.0
    answer, _ = area.timed(fewer[0], settings, hard)
    assert answer(1).shape == (480, 640)
    assert {key: value for one in area.variants for key, value in one.values.items() if key == "grasp"} == {}


@pytest.mark.slow
def test_open3d_finds_objects_that_stand_apart(scenes_of_each_kind) -> None:
    ensure_libusb()
    pytest.importorskip("open3d", exc_type=ImportError)
    easy = scenes_of_each_kind[0]
    assert min(easy.overlaps(0, tradeoff_scene.open3d_labels(easy.cloud(0)))) > 0.3


def test_peers_in_cpp_are_named_where_they_can_be_compiled_and_a_wrong_checkout_is_refused(
    monkeypatch, tmp_path
) -> None:
    monkeypatch.setenv("FORETOUCH_GEOGRASP", str(tmp_path))
    monkeypatch.setattr(peers, "_SYSTEM", tmp_path / "none")
    monkeypatch.setattr(peers.shutil, "which", lambda _: "/usr/bin/g++")
    assert not peers.has_lccp()
    (tmp_path / "none" / "pcl-1.13").mkdir(parents=True)
    (tmp_path / "none" / "vtk-9.1").mkdir()
    assert peers.has_lccp()
    assert not peers.has_geograsp()
    with pytest.raises(ConfigError, match=r"FORETOUCH_GEOGRASP: .*: no such file; name a checkout of GeoGrasp"):
        tradeoff_grasp.EXPERIMENT.prepare(SceneSettings(), None, tmp_path)
    (tmp_path / "geograsp/lib/geograsp").mkdir(parents=True)
    (tmp_path / "geograsp/lib/geograsp/GeoGrasp.cpp").write_text("int x = nothing;")
    assert peers.has_geograsp()
    monkeypatch.setenv("FORETOUCH_PEERS", "0")
    assert not peers.has_geograsp()


def test_a_peer_that_cannot_be_compiled_or_loaded_is_named(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(peers, "_SYSTEM", tmp_path)  # without Eigen and PCL
    peers._library.cache_clear()
    if shutil.which("g++"):
        with pytest.raises(ForetouchError, match=r"lccp.cpp: cannot be compiled with .*; FORETOUCH_PEERS=0 leaves"):
            peers.lccp(Cloud(np.ones((1, 1, 3))), np.ones((1, 1), np.int32))
    monkeypatch.setattr(peers.subprocess, "run", _write_nothing)
    with pytest.raises(ForetouchError, match=r"lccp-\w+.so: .*; remove it and repeat; FORETOUCH_PEERS=0"):
        peers.lccp(Cloud(np.ones((1, 1, 3))), np.ones((1, 1), np.int32))
    none = np.full((1, 1, 3), np.nan)
    assert peers.lccp(Cloud(none), np.ones((1, 1), np.int32)).tolist() == [[0]]


def _write_nothing(command, **_):
    Path(command[-1]).touch()
    return SimpleNamespace(returncode=0)


@pytest.mark.slow
def test_the_published_geograsp_gives_the_contacts_of_original(scenes_of_each_kind) -> None:
    if not peers.has_geograsp():
        pytest.skip("the published GeoGrasp: needs g++, libpcl-dev and a checkout in FORETOUCH_GEOGRASP")
    easy = scenes_of_each_kind[0]
    data = FoundObjects(easy.scene, easy.depths, easy.labels, easy.slots)
    pipeline = data.pipeline({"grasp.method": "original"})
    for _, target in data.targets:
        ours, theirs = pipeline.plan(target).grasps[0], peers.geograsp(target.cloud, target.plane, 25.0)
        np.testing.assert_allclose([theirs.g1, theirs.g2], [ours.g1, ours.g2], atol=1e-4)
        np.testing.assert_allclose(np.abs(theirs.rotation), np.abs(ours.rotation), atol=1e-3)
    assert peers.geograsp(Cloud(np.zeros((0, 3))), target.plane, 25.0) is None


def test_a_grasp_that_holds_is_read_and_one_beside_the_object_is_not(monkeypatch, scenes_of_each_kind) -> None:
    area, settings, easy = tradeoff_grasp.EXPERIMENT, SceneSettings(bootstrap=QUICK), scenes_of_each_kind[0]
    data = FoundObjects(easy.scene, easy.depths, easy.labels, easy.slots)
    assert [number for number, _ in data.targets] == [0, 1]
    number, target = data.targets[0]
    grasp = data.pipeline({}).plan(target).grasps[0]
    touch, tare = data.read(number, grasp)
    assert np.abs(touch.values - tare.values).max() > 50.0
    assert data.read(number, replace(grasp, g1=grasp.g1 + 0.2, g2=grasp.g2 + 0.2)) is None
    fewer = tuple(one for one in area.variants if one.name in ("default", "original, 8000 points"))
    monkeypatch.setattr(tradeoff_grasp, "VARIANTS", fewer)
    found = tradeoff_grasp._accuracy("held", settings, data)
    assert found["default"]["held"] == 1.0
    assert area.timed(fewer[0], settings, data)[0](1)


def test_the_chain_multiplies_what_is_found_held_and_explained(monkeypatch, scenes_of_each_kind) -> None:
    sums = np.zeros(104)
    sums[:4], sums[4:54], sums[54:] = (8.0, 6.0, 4.0, 2.0), 3.0, 4.0
    assert tradeoff_chain.steps(sums).tolist() == pytest.approx([0.75, 0.5, 0.25])
    assert tradeoff_chain.steps(np.zeros(104)).tolist() == [0.0, 0.0, 0.0]
    area, settings = tradeoff_chain.EXPERIMENT, SceneSettings(bootstrap=QUICK)
    data = tradeoff_chain.Images(dict(zip(("apart", "touching"), scenes_of_each_kind, strict=True)))
    shown = ("default", "320x240, grid 120, 500 points, contact + readings")
    fewer = tuple(one for one in area.variants if one.name.startswith(shown))
    assert len(fewer) == 6
    monkeypatch.setattr(tradeoff_chain, "VARIANTS", fewer)
    rows = tradeoff_chain._accuracy("chain", settings, data)
    for row in rows.values():
        assert row["chain"] == pytest.approx(row["found"] * row["held"] * row["touch"])
        assert max(row["apart"], row["touching"]) <= 1.0
    assert rows["default: 640x480, grid 120, 8000 points, contact"]["apart"] > 0.0
    assert rows["default: 640x480, grid 120, 8000 points, mean"]["touch"] == 0.0
    smaller = next(one for one in fewer if one.name.startswith("320"))
    text = (
        "an image of 320 columns, segmentation.grid_rows=120, grasp.max_points=500, segmentation.clusters.min_points=40"
    )
    assert tradeoff_chain.settings_text(smaller) == f"{text}, readings of the hand"
    assert "preset=default" in map(tradeoff_chain.settings_text, fewer)
    for one in fewer:
        assert len(area.timed(one, settings, data)[0](1)) == 1  # a prediction
    for one in area.variants:  # they can be copied
        PipelineConfig().updated(one.values["changes"])
    default = next(one for one in area.variants if one.factor == "shipped")
    assert PipelineConfig().updated(default.values["changes"]) == PipelineConfig()


def test_the_chain_shows_meshes_of_a_folder_and_names_one_without_any(monkeypatch, tmp_path) -> None:
    area, settings = tradeoff_chain.EXPERIMENT, SceneSettings(scenes=2)
    assert area.prepare(settings, None, tmp_path) == tmp_path
    with pytest.raises(ConfigError, match=r"--data .*: holds no <object>/collision_vhacd.obj of the YCB set"):
        area.prepare(settings, tmp_path, tmp_path / "out")
    monkeypatch.setenv("FORETOUCH_DATA", str(tmp_path))
    assert data_source(area, SimpleNamespace(data=None)) is None
    (tmp_path / "Block").mkdir()
    trimesh.creation.box((0.06, 0.07, 0.09)).export(tmp_path / "Block" / "collision_vhacd.obj")
    data = area.load(settings, area.prepare(settings, tmp_path, tmp_path / "out"))
    assert {part: len(scenes) for part, scenes in data.parts.items()} == {"apart": 1, "touching": 1, "YCB": 1}
    assert [one.name for one in data.parts["YCB"].scene.objects] == ["Block"]
    assert (data.parts["YCB"].labels == FIRST_OBJECT).sum() > 300


def test_springs_are_nearly_right_on_rigid_objects_and_effects_can_be_left_out(tmp_path: Path, monkeypatch) -> None:
    area, settings = (
        tradeoff_simulation.EXPERIMENT,
        tradeoff_simulation.SimulationSettings(compared=4, train=10, trees=2),
    )
    data = area.load(settings, ROOT / "config/scenes")
    every_case({variant.name: (variant,) for variant in area.variants}, data.changed)
    shown = ("finest", "winkler 12", "everything as shipped", "without noise")
    fewer = tuple(variant for variant in area.variants if any(text in variant.name for text in shown))
    monkeypatch.setattr(tradeoff_simulation, "VARIANTS", fewer)
    found: dict[str, Row] = {}
    for cell in area.cells(settings, data):
        if cell.key in ("digits_rigid", "digits_deformables", "trained_everything"):
            found |= {row["variant"]: row for row in area.run(cell, settings, data)}
    rigid, soft = found["rigid: winkler 12x12"], found["deformables: winkler 12x12"]
    assert rigid["digits_rigid"] > 1.3
    assert soft["digits_deformables"] < 1.0
    assert rigid["digits_rigid_low"] <= rigid["digits_rigid"]
    assert found["without noise"]["trained_everything"] != found["everything as shipped"]["trained_everything"]
    answer, _ = area.timed(area.variants[0], settings, data)
    one, two = answer(1).touch.values, answer(1).touch.values
    assert one.shape == (50,)
    assert not np.array_equal(one, two)
    with pytest.raises(ConfigError, match=r"holds no rigid.yaml; give the folder config/scenes"):
        area.prepare(settings, tmp_path, tmp_path)


def test_more_grasps_are_more_skilful_and_take_the_robot_longer(monkeypatch) -> None:
    area, settings = tradeoff_training.EXPERIMENT, tradeoff_training.TrainingSettings(trees=2, bootstrap=QUICK)
    wanted = ("contact model as shipped", "mean of labels", "5 grasps an object", "2 objects", "network as shipped")
    variants = {variant.name: variant for variant in area.variants if variant.name in wanted}
    monkeypatch.setattr(tradeoff_training, "VARIANTS", tuple(variants.values()))
    cells = area.cells(settings, GRASPS)
    assert [cell.key for cell in cells] == ["known", "new", "one_block"]
    found = {row["variant"]: row for row in area.run(cells[0], settings, GRASPS)}
    assert found.keys() == set(wanted[:3])
    shipped, mean, fewer = (found[name] for name in wanted[:3])
    assert shipped["known"] > fewer["known"] > mean["known"] == 0.0
    assert shipped["robot_h_known"] == pytest.approx(76.8 * 60.0 / 3600.0, abs=0.01)
    assert shipped["known_low"] < shipped["known"] < shipped["known_high"]
    fit, _ = area.timed(variants["contact model as shipped"], settings, GRASPS)
    assert fit(1).shape == (10, 50)
    epoch, epochs = area.timed(variants["network as shipped"], settings, GRASPS)
    assert epochs == 120.0
    assert epoch(1)["loss"] > 0.0


def test_cheaper_contact_models() -> None:
    samples = make_samples()
    rows = describe_samples(samples)
    objects = [sample.object for sample in samples]
    large, small = (fit_contact(rows, labels_of(samples), objects, FEW_TREES.replace(trees=trees)) for trees in (4, 2))
    np.testing.assert_array_equal(fewer_trees(large, 2).predict_rows(rows)[0], small.predict_rows(rows)[0])
    np.testing.assert_array_equal(fewer_trees(large, 9).predict_rows(rows)[0], large.predict_rows(rows)[0])
    changed = rows.copy()
    changed[:, -14:] += 1.0  # the second contact
    plain = replace(large, surroundings=False)
    np.testing.assert_array_equal(plain.predict_rows(rows)[0], plain.predict_rows(changed)[0])
    assert np.abs(large.predict_rows(rows)[0] - plain.predict_rows(rows)[0]).max() > 1e-3
