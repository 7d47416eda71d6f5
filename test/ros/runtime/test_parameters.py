# SPDX-License-Identifier: Apache-2.0
from dataclasses import dataclass

import pytest
from every_case import every_case
from rcl_interfaces.msg import ParameterType
from rclpy.node import Node
from rclpy.parameter import Parameter

from foretouch.cloud.segmentation.objects import TargetConfig
from foretouch.config import Settings, setting, setting_infos
from foretouch.errors import ConfigError
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
