# SPDX-License-Identifier: Apache-2.0
from dataclasses import dataclass

import pytest
from every_case import every_case
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter

from foretouch.cloud.segmentation.objects import TargetConfig
from foretouch.config import Settings, setting, setting_infos
from foretouch.errors import ConfigError
from foretouch.ros.nodes.perception import PerceptionConfig
from foretouch.ros.runtime.parameters import NodeSettings


@dataclass(frozen=True, kw_only=True)
class Inner(Settings):
    depth: int = setting(3, "How deep", bounds=(1, 9))


@dataclass(frozen=True, kw_only=True)
class Outer(Settings):
    speed: float = setting(1.0, "How fast", unit="m/s", minimum=0.0)
    word: str = setting("a", "Which", choices=("a", "b"))
    fixed: bool = setting(True, "Whether", read_only=True)
    numbers: tuple[float, ...] = setting((), "Any")
    inner: Inner = Inner()
    target: TargetConfig = TargetConfig()


@pytest.fixture
def node(graph):
    return graph.probe


def test_every_setting_becomes_a_parameter_with_its_facts(node):
    NodeSettings(node, Outer)
    for info in setting_infos(Outer):
        assert node.has_parameter(info.name)
    speed = node.describe_parameter("speed")
    assert (speed.type, speed.description) == (ParameterType.PARAMETER_DOUBLE, "How fast [m/s]")
    assert speed.floating_point_range[0].from_value == 0.0
    assert speed.floating_point_range[0].to_value > 1e308  # an open bound is the end of the type
    depth = node.describe_parameter("inner.depth")
    assert (depth.integer_range[0].from_value, depth.integer_range[0].to_value) == (1, 9)
    assert node.describe_parameter("fixed").read_only
    assert "a, b" in node.describe_parameter("word").additional_constraints


def test_what_a_node_does_not_know_is_refused_by_name_and_the_rest_of_a_request_is_set(graph):
    (node,) = graph.add("segmentation")
    doubles = {
        "silence_s": (3, 7.0),
        "click_age": (3, 1.0),
        "mask_wait_s": (77, 1.0),
    }  # rclpy itself would raise for 77
    parameters = [
        ParameterMsg(name=name, value=ParameterValue(type=kind, double_value=value))
        for name, (kind, value) in doubles.items()
    ]
    request = SetParameters.Request(parameters=parameters)
    results = graph.call(SetParameters, "segmentation/set_parameters", request).results
    reasons = [
        "",
        "click_age: /foretouch/segmentation has no such parameter; did you mean click_age_s?",
        "mask_wait_s: type 77 is not one of rcl_interfaces/ParameterType",
    ]
    assert [(one.successful, one.reason) for one in results] == [(not reason, reason) for reason in reasons]
    assert node.config.silence_s == 7.0
    together = SetParametersAtomically.Request(
        parameters=[ParameterMsg(name="silence_s", value=ParameterValue(type=3, double_value=9.0)), *parameters[1:]]
    )
    result = graph.call(SetParametersAtomically, "segmentation/set_parameters_atomically", together).result
    assert (result.successful, result.reason, node.config.silence_s) == (False, reasons[1], 7.0)
    assert not node.internal_errors.counts()  # the error is the sender's


def test_a_valid_change_is_accepted_and_passed_on_as_a_whole(node):
    changes = []
    settings = NodeSettings(node, Outer, changes.append)
    assert node.set_parameters([Parameter("inner.depth", value=5)])[0].successful
    assert settings.value.inner.depth == 5
    assert changes == [settings.value]
    assert node.set_parameters([Parameter("numbers", value=[1.0, 2.0])])[0].successful
    assert settings.value.numbers == (1.0, 2.0)
    both = [Parameter("target.mode", value="point"), Parameter("target.point", value=[0.0, 0.0, 1.0])]
    assert node.set_parameters_atomically(both).successful
    assert settings.value.target.mode == "point"
    assert node.set_parameters([Parameter("speed", value=3)])[0].successful  # a whole number is a float
    assert (settings.value.speed, type(node.get_parameter("speed").value)) == (3.0, float)


def test_an_invalid_change_is_refused_and_changes_nothing_and_an_invalid_value_at_the_start_is_named(node):
    settings = NodeSettings(node, Outer)
    before = settings.value

    def check(name, value, reason):
        (result,) = node.set_parameters([Parameter(name, value=value)])
        assert not result.successful
        assert reason in result.reason
        assert settings.value == before

    cases = [
        ("inner.depth", 10, "10"),
        ("speed", -0.5, "-0.5"),
        ("speed", float("nan"), "nan"),
        ("word", "c", "'c' is not one of a, b"),
        ("fixed", False, "read-only"),
        ("speed", "fast", "type"),
        ("target.mode", "point", "target.point: is empty"),
        ("numbers", ["x"], "is not a number"),
    ]
    every_case(cases, check)
    both = [Parameter("speed", value=2.0), Parameter("word", value="c")]
    assert not node.set_parameters_atomically(both).successful
    assert (settings.value.speed, node.get_parameter("speed").value) == (1.0, 1.0)
    for name, value in (("speed", -1.0), ("word", "c"), ("speed", "fast")):
        node = Node("starter", parameter_overrides=[Parameter(name, value=value)])
        with pytest.raises(ConfigError, match=name) as caught:
            NodeSettings(node, Outer)
        node.destroy_node()
        assert "\n" not in str(caught.value)


def test_a_preset_gives_other_defaults_and_what_is_set_besides_counts():
    overrides = [Parameter("preset", value="fast"), Parameter("grasp.max_points", value=77)]
    node = Node("starter", parameter_overrides=overrides)
    config = NodeSettings(node, PerceptionConfig).value
    assert (config.preset, config.grasp.max_points, config.segmentation.grid_rows) == ("fast", 77, 60)
    assert node.describe_parameter("preset").read_only
    node.destroy_node()
    node = Node("starter", parameter_overrides=[Parameter("preset", value="slow")])
    with pytest.raises(ConfigError, match="preset: slow: is neither a file nor one of"):
        NodeSettings(node, PerceptionConfig)
    node.destroy_node()
    node = Node("starter", parameter_overrides=[Parameter("preset", value="default")])
    assert NodeSettings(node, PerceptionConfig).value == PerceptionConfig()
    node.destroy_node()
