# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from every_case import every_case
from numpy.testing import assert_allclose, assert_array_equal
from sim_builders import CAN, SPONGE, run, scene

from foretouch.config import load_yaml
from foretouch.errors import ConfigError
from foretouch.tactile.description import load_sensor, packaged_sensor, sensor_of
from foretouch.types import Float64
from foretouch_lab.simulation import fingertip
from foretouch_lab.simulation.contact.pad import PadConfig
from foretouch_lab.simulation.engine import SampleState
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.taxels import TaxelArray, TaxelConfig
from foretouch_lab.simulation.world import World

USKIN: Any = {"sensor": "xela_uskin_4x4", "pad": {"layer_m": 0.003, "modulus_pa": 3e5}}
FIELD = USKIN | {"sensor": "tacsl_20x25"}
BALL = {"name": "ball", "shape": "ball", "size_m": [0.07, 0.07, 0.07]}
STIFF = {"spread_m": 1e-5, "alignment": 0.0}
WRITTEN: Any = {"grasps": {"insertion_m": 0.0, "thumb": {"force_n": [1.5, 1.5]}}}


def forces(config: SceneConfig, state: SampleState) -> dict[str, Float64]:
    """Sum over the taxels of each modality, in newtons, before noise and rounding."""
    array = World.of(config).array
    assert array is not None
    newton = (state.readings[1] - array.rest) / array.gain
    size, fingers = array.sensor.size, array.sensor.channels.fingers
    names = [channel.name for channel in array.sensor.channels.channels]
    return {
        f"{name}_{finger}": newton[k, c * size : (c + 1) * size]
        for k, finger in enumerate(fingers)
        for c, name in enumerate(names)
    }


def test_the_normal_forces_of_an_array_are_those_of_the_solver_and_shear_is_within_friction() -> None:
    """The field of 1 mm taxels has no gaps: only what is spread over its rim is lost."""
    for item in (CAN, BALL, SPONGE):
        config = scene(item, fingers=FIELD | {"taxels": {"spread_m": 1e-5}}, **WRITTEN)
        state = run(config)
        found = forces(config, state)
        for finger, contact in zip(("left", "right"), state.contacts, strict=True):
            assert found[f"normal_{finger}"].sum() == pytest.approx(contact.force_n, rel=0.02), item
            shear = np.hypot(found[f"shear_x_{finger}"].sum(), found[f"shear_y_{finger}"].sum())
            assert shear <= config.objects[0].friction * contact.force_n * 1.001
            assert (found[f"normal_{finger}"] >= -1e-9).all()


def test_an_inclined_pad_is_sheared_by_what_pushes_along_it_and_by_the_weight_of_the_object() -> None:
    """The place that looks ten degrees towards the tip leads: the object pushes the skin back, away from the tip."""
    posture = {"pitch_deg": [10.0, 10.0]}
    config = scene(BALL, fingers=FIELD | {"thumb_posture": posture, "taxels": STIFF}, **WRITTEN)
    state = run(config)
    found, force_n = forces(config, state), state.contacts[0].force_n
    assert float(state.fingers[0].normal @ state.touches[0].normal) == pytest.approx(np.cos(np.radians(10.0)))
    assert found["shear_x_left"].sum() == pytest.approx(-force_n * np.tan(np.radians(10.0)), rel=0.05)
    assert found["shear_y_left"].sum() == pytest.approx(0.0, abs=0.02 * force_n)
    # x is along the finger, which points down: both skins carry the object's weight.
    config = scene(CAN | {"mass_kg": 0.06}, fingers=FIELD | {"taxels": STIFF}, gravity={}, **WRITTEN)
    found = forces(config, run(config))
    assert found["shear_x_left"].sum() + found["shear_x_right"].sum() == pytest.approx(0.06 * 9.81, rel=0.1)


def test_a_pad_turns_about_the_point_of_first_touch_until_it_lies_on_the_surface() -> None:
    normal = np.array([0.1, -0.05, -1.0]) / np.linalg.norm([0.1, -0.05, -1.0])
    point = np.array([0.01, 0.02, 0.03])
    start = array_of().middle
    for share in (0.0, 0.5, 1.0):
        turned = array_of(alignment=share).aligned(start, point, normal)
        angles = [np.degrees(np.arccos(np.clip(-normal @ one.normal, -1.0, 1.0))) for one in (start, turned)]
        assert angles[1] == pytest.approx((1.0 - share) * angles[0], abs=1e-2)
        assert np.linalg.norm(turned.origin - point) == pytest.approx(np.linalg.norm(start.origin - point))
        assert_allclose(turned.rotation.T @ turned.rotation, np.eye(3), atol=1e-12)
    box = {"name": "box", "shape": "box", "size_m": [0.06, 0.08, 0.12]}
    fingers = [FIELD | {"taxels": {"spread_m": 1e-5, "alignment": share}} for share in (0.0, 1.0)]
    touched = []
    for each in fingers:
        config = scene(box, fingers=each, grasps={"insertion_m": 0.03, "thumb": {"force_n": [1.5, 1.5]}})
        touched.append((forces(config, run(config))["normal_left"] > 1e-3).sum())
    assert touched[1] > 2 * touched[0]  # the face in place of the rim


def array_of(name: str = "xela_uskin_4x4", changes: Any = None, **settings: Any) -> TaxelArray:
    sensor = packaged_sensor(name)
    if changes:
        sensor = sensor_of(sensor.to_mapping() | changes, "test")
    return TaxelArray.of(sensor, TaxelConfig(**settings), PadConfig(layer_m=0.003), np.random.default_rng(0))


def bump(array: TaxelArray, x_m: float = 0.0, y_m: float = 0.0) -> Float64:
    """Tractions of a smooth pressure about a place of the pad, which pushes outwards as a ball does; 1 N in all."""
    x, y = array.window.x - x_m, array.window.y - y_m
    pressure = np.exp(-0.5 * (x**2 + y**2) / 0.002**2) * np.isfinite(array.window.depth)
    pressure /= pressure.sum() * array.pad.step_m**2
    return np.stack([pressure * x / 0.035, pressure * y / 0.035, -pressure], axis=-1)


def newtons(array: TaxelArray, tractions: Float64) -> Float64:
    """(3, N) X, Y, Z of the first finger."""
    return ((array.read(0, tractions) - array.rest[0]) / array.gain[0]).reshape(3, -1)


def test_a_symmetric_press_reads_symmetric_and_one_turned_reads_turned() -> None:
    array = array_of()
    x, y, z = newtons(array, bump(array)).reshape(3, 4, 4)  # rows along x, columns along y
    assert_allclose(z, z[::-1], atol=1e-12)
    assert_allclose(z, z.T, atol=1e-12)
    assert_allclose(x, -x[::-1], atol=1e-12)
    assert_allclose(x, y.T, atol=1e-12)
    assert z.sum() == pytest.approx(1.0, abs=1e-3)
    assert x[2:].min() > 0.0 > x[:2].max()  # outwards, as the skin is pushed aside
    moved = newtons(array, bump(array, x_m=0.0047)).reshape(3, 4, 4)[2]
    assert_allclose(moved[1:], z[:3], atol=5e-3)  # by one row
    at_rim = newtons(array, bump(array, x_m=0.0094))[2].sum()
    assert at_rim == pytest.approx(1.0 - np.arctan2(0.0015, 0.002) / np.pi, abs=0.01)  # the rest is spread over the rim


def curved(radius_m: float, across: int = 5) -> dict[str, Any]:
    """The taxels of a pad that is bent along x, as `Sensor.to_mapping` states them."""
    angle, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.5, 0.5, across), np.linspace(-0.006, 0.006, across)))
    normals = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    points = radius_m * normals + np.stack([np.zeros_like(y), y, np.zeros_like(y)], axis=1)
    return {"array": None, "taxels": [points.tolist(), normals.tolist(), None]}


def test_the_shape_of_a_curved_pad_is_that_of_its_taxels() -> None:
    array = array_of(changes=curved(0.012))
    assert_allclose(array.curvature, [[1.0 / 0.012, 0.0], [0.0, 0.0]], rtol=0.15, atol=1e-6)
    assert_allclose(array.middle.origin, [0.0, 0.0, 0.012], atol=3e-4)
    aimed = array.aimed(0.2, 0.0)
    assert_allclose(aimed.normal, [np.sin(0.2), 0.0, np.cos(0.2)], atol=1e-12)
    assert aimed.origin[0] == pytest.approx(0.012 * np.sin(0.2), rel=0.1)
    assert_allclose(aimed.rotation.T @ aimed.rotation, np.eye(3), atol=1e-12)
    z = newtons(array, bump(array))[2]
    assert z.sum() == pytest.approx(1.0, abs=0.06)  # taxels beside the middle face away
    assert z.argmax() == 12  # the middle of 5 x 5
    assert not array_of().curvature.any()


def test_values_are_those_of_the_channel() -> None:
    """Counts start in the middle of their range and are whole; forces are neither."""
    config = scene(CAN, fingers=USKIN, **WRITTEN)
    state, array = run(config), World.of(config).array
    assert array is not None
    assert state.touch.channels.sha256 == packaged_sensor("xela_uskin_4x4").sha256
    assert_array_equal(state.touch.values, np.rint(state.touch.values))
    assert np.abs(array.rest - 32767.5).max() < 5.0 * 0.02 * 65535
    assert np.log(array.gain / (32767.5 / 1.8)).std() == pytest.approx(0.1, rel=0.3)
    assert_array_equal(array_of("tacsl_20x25").gain, 1.0)
    pressed = array.quantise(np.full((1, 2, 48), 1e6))
    assert (pressed == 65535).all()
    other = scene(CAN, fingers=USKIN | {"hand": 1}, **WRITTEN)
    assert not np.array_equal(run(other).tare.values, state.tare.values)  # type: ignore[union-attr]


def test_dead_taxels_have_the_mean_of_their_nearest_neighbours() -> None:
    fingers = packaged_sensor("xela_uskin_4x4").to_mapping()["fingers"]
    fingers[0]["dead"], fingers[1]["dead"] = [5, 6], [0]
    whole, broken = array_of(), array_of(changes={"fingers": fingers})
    values = np.arange(96.0).reshape(1, 2, 48) ** 2
    first, repaired = whole.quantise(values)[0], broken.quantise(values)[0]
    assert repaired[0, 5] == pytest.approx(first[0, [1, 4, 9]].mean())  # 6 is dead too
    assert repaired[1, 16] == pytest.approx(first[1, [17, 20]].mean())
    alive = np.delete(np.arange(48), [5, 6, 21, 22, 37, 38])
    assert_array_equal(repaired[0, alive], first[0, alive])


def test_crosstalk_goes_to_the_neighbours_and_to_the_other_axes() -> None:
    array = array_of()
    force = np.zeros((1, 2, 48))
    force[0, 0, 32 + 5] = 1.0  # Z of taxel 5
    read = array.with_crosstalk(array.rest + array.gain * force)
    found = ((read - array.rest) / array.gain)[0]
    expected = np.zeros(48)
    expected[[32 + 1, 32 + 4, 32 + 6, 32 + 9]] = expected[[5, 16 + 5]] = 0.03
    expected[32 + 5] = 1.0
    assert_allclose(found[0], expected, atol=1e-9)
    assert_allclose(found[1], 0.0, atol=1e-9)


def test_each_effect_changes_what_it_is_for(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = run(scene(CAN, fingers=USKIN, **WRITTEN)).series
    gain = 32767.5 / 1.8

    def moved(**groups: Any) -> Float64:
        return (run(scene(CAN, fingers=USKIN | groups, **WRITTEN)).series - plain) / gain

    assert np.std(moved(noise={})) == pytest.approx(0.001, rel=0.2)
    session = moved(sessions={})
    assert_allclose(session[0], session[1], atol=1e-9)
    assert np.std(session[0]) == pytest.approx(0.02, rel=0.3)
    monkeypatch.setattr(fingertip, "SESSION_S", (0.0, 0.0))
    monkeypatch.setattr(fingertip, "TARE_AGE_S", (1e6, 1e6))
    drift = moved(drift={})  # warm by 3 K since the tare
    assert np.abs(drift[0]).max() == 0.0
    assert np.std(drift[1]) == pytest.approx(3.0 * 0.005, rel=0.3)
    untouched = run(scene(CAN, fingers=USKIN, grasps={"thumb": {"force_n": [0.0, 0.0]}}))
    assert_array_equal(untouched.touch.values, untouched.tare.values)  # type: ignore[union-attr]
    state = run(scene(CAN, fingers=USKIN | {"timeline": {"hold_s": 1.0}, "slip": {}, "creep": {}}, **WRITTEN))
    assert state.series.shape == (len(state.load), 2, 48)


def test_groups_of_another_sensor_are_refused_by_name(tmp_path: Path) -> None:
    described = packaged_sensor("xela_uskin_4x4").to_mapping()
    channels = {
        "volume": {"name": "V", "field": "v", "dtype": "uint8"},
        "open": {"name": "X", "field": "x", "dtype": "float32", "unit": "T"},
    }
    for name, channel in channels.items():
        values = [channel, {"name": "Z", "field": "z", "dtype": "uint8"}]
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(described | {"values": values}))
    fingers = [described["fingers"][0] | {"dead": list(range(8))}, described["fingers"][1]]
    (tmp_path / "dead.yaml").write_text(yaml.safe_dump(described | {"fingers": fingers}))
    array = "is of the BioTac SP, but the sensor of these fingers is xela_uskin_4x4"
    cases: list[tuple[dict[str, Any], str]] = [
        ({"fingers": USKIN | {"dead": {"thumb": [3]}}}, f"dead: {array}"),
        ({"fingers": USKIN | {"thumb": {"pdc_rest": 2000}}}, f"thumb: {array}"),
        ({"fingers": USKIN | {"pad": {"window_m": 0.02}}}, f"pad.window_m: {array}"),
        ({"fingers": {"crosstalk": {}}}, "crosstalk: is of arrays of taxels, but the sensor .* is the BioTac SP"),
        ({"fingers": {"sensor": "xela"}}, "sensor: .*xela: is neither a file nor one of"),
        ({"fingers": {"sensor": str(tmp_path / "volume.yaml")}}, "V: is not a force that can be simulated"),
        ({"fingers": {"sensor": str(tmp_path / "open.yaml")}}, "X: has neither the unit N or Pa nor a range"),
        ({"fingers": {"sensor": str(tmp_path / "dead.yaml")}}, "dead: half of the taxels of a finger or more"),
        ({"fingers": USKIN, "campaign": {}}, "campaign: its drift is for the BioTac SP"),
    ]

    def check(groups: dict[str, Any], message: str) -> None:
        with pytest.raises(ConfigError, match=message):
            scene(CAN, **groups)

    every_case({message: (groups, message) for groups, message in cases}, check)
    named, absent = scene(CAN, fingers={"sensor": "biotac_sp"}), scene(CAN)
    assert_array_equal(run(named).touch.values, run(absent).touch.values)
    assert named.sha256() == absent.sha256()


def test_the_hash_of_a_scene_is_that_of_the_content_of_its_sensor(tmp_path: Path) -> None:
    described = packaged_sensor("xela_uskin_4x4").to_mapping()

    def hashed(name: str, **changes: Any) -> str:
        (tmp_path / name).write_text(yaml.safe_dump(described | changes))
        return scene(CAN, fingers={"sensor": str(tmp_path / name)}).sha256()

    same = scene(CAN, fingers={"sensor": "xela_uskin_4x4"}).sha256()
    dead = [{**described["fingers"][0], "dead": [3]}, described["fingers"][1]]
    assert hashed("copy.yaml") == hashed("named.yaml", summary="another") == same
    others = {hashed("dead.yaml", fingers=dead), scene(CAN, fingers=USKIN).sha256(), scene(CAN).sha256()}
    others.add(scene(CAN, fingers={"sensor": "xela_uskin_4x4", "taxels": {"spread_m": 0.002}}).sha256())
    assert len({same, *others}) == 5
    (tmp_path / "scene.yaml").write_text(
        "fingers: {sensor: copy.yaml}\nobjects: [{name: can, size_m: [0.07, 0.07, 0.1]}]"
    )
    found = SceneConfig.from_mapping(load_yaml(tmp_path / "scene.yaml"), str(tmp_path / "scene.yaml"))
    assert load_sensor(found.fingers.sensor).config.name == "xela_uskin_4x4"  # beside the scene
