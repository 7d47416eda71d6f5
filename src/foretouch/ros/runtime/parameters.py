# SPDX-License-Identifier: Apache-2.0
"""ROS parameters made from `Settings`, which declare type, bounds, description and read-only flag.

A change is checked against all rules of the settings, those across fields included, and is accepted or refused
as a whole, with the reason.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final, Generic, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from foretouch.config import SettingInfo, Settings, setting_infos
from foretouch.errors import ConfigError, nearest, shown
from foretouch.pipeline import PRESET, preset_settings

_S = TypeVar("_S", bound=Settings)
_NOTHING: Final = ("null", "None")
"""What ROS makes of a value that `ros2 param dump` wrote as `null`, in a parameter file and in `ros2 param load`."""
_LIMITS: dict[type, Any] = {int: 2**63 - 1, float: sys.float_info.max}


class NodeSettings(Generic[_S]):
    """The parameters of a node, one for each setting of `cls`, as one frozen `Settings`, `value`.

    Nested settings have dotted names. A preset gives other defaults.

    Args:
        node: Declares the parameters.
        cls: Class of the settings.
        on_change: Called with the new settings after a change.

    Raises:
        ConfigError: If a value given at the start (file or command line) breaks a rule.
    """

    def __init__(self, node: Node, cls: type[_S], on_change: Callable[[_S], None] = lambda _: None) -> None:
        self._cls = cls
        self._on_change = on_change
        infos = setting_infos(cls)
        self._infos = {info.name: info for info in infos}
        self._floats = {info.name for info in infos if info.type is float and not info.is_list}
        given = {PRESET: _declare(node, self._infos[PRESET])} if PRESET in self._infos else {}
        defaults = preset_settings(given[PRESET]) if given else {}
        for info in infos:
            if info.name not in given:
                given[info.name] = _declare(node, replace(info, default=defaults.get(info.name, info.default)))
        self.value: _S = cls.from_mapping(given)
        node.add_pre_set_parameters_callback(self._as_declared)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _as_declared(self, parameters: "list[Parameter[Any]]") -> "list[Parameter[Any]]":
        """Whole numbers as floats where these are declared, such as 10 for 10.0."""
        return [_as_float(parameter) if parameter.name in self._floats else parameter for parameter in parameters]

    def _changed(self, parameters: Sequence["Parameter[Any]"]) -> _S | None:
        changes = {p.name: _plain(self._infos[p.name], p.value) for p in parameters if p.name in self._infos}
        return self._cls.from_mapping({**self.value.to_mapping(), **changes}) if changes else None

    def _check(self, parameters: Sequence["Parameter[Any]"]) -> SetParametersResult:
        try:
            self._changed(parameters)
        except ConfigError as err:
            return SetParametersResult(successful=False, reason=str(err))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: Sequence["Parameter[Any]"]) -> None:
        if (changed := self._changed(parameters)) is not None:
            self.value = changed
            self._on_change(changed)


def set_known(node: Node, callback: Callable[..., Any], request: Any, response: Any) -> Any:
    """Call rclpy's service that sets parameters, but refuse by name what the node or rclpy does not know, for which rclpy has no words.

    Args:
        node: Whose parameters they are.
        callback: Of the service, `SetParameters` or `SetParametersAtomically`.
        request: Names and values of parameters.
        response: To be filled.
    """
    faults = [_unknown(node, parameter) for parameter in request.parameters]
    refused = [SetParametersResult(successful=False, reason=fault) for fault in faults if fault]
    if not refused:
        return callback(request, response)
    if isinstance(request, SetParametersAtomically.Request):
        response.result = refused[0]
        return response
    known = [parameter for parameter, fault in zip(request.parameters, faults, strict=True) if not fault]
    results = iter(callback(SetParameters.Request(parameters=known), SetParameters.Response()).results)
    response.results = [refused.pop(0) if fault else next(results) for fault in faults]
    return response


def _unknown(node: Node, parameter: Any) -> str:
    """Say why a parameter of a request is not known; "" if it is."""
    if parameter.value.type > ParameterType.PARAMETER_STRING_ARRAY:
        return f"{shown(parameter.name)}: type {parameter.value.type} is not one of rcl_interfaces/ParameterType"
    if not node.has_parameter(parameter.name):
        hint = nearest(parameter.name, node.get_parameters_by_prefix("").keys())
        return f"{shown(parameter.name)}: {node.get_fully_qualified_name()} has no such parameter{hint}"
    return ""


def _declare(node: Node, info: SettingInfo) -> Any:
    """Declare one parameter and return its value.

    ROS has no unset value of a type and infers none from an empty list: such settings are declared with dynamic typing
    and checked by `Settings` alone.
    """
    descriptor = ParameterDescriptor(
        name=info.name,
        description=f"{info.description} [{info.unit}]" if info.unit else info.description,
        additional_constraints=f"one of: {', '.join(map(str, info.choices))}" if info.choices else "",
        read_only=info.read_only,
        dynamic_typing=info.optional or info.is_list,
    )
    limit, bounded = _LIMITS.get(info.type), info.minimum is not None or info.maximum is not None
    if limit is not None and bounded and not descriptor.dynamic_typing:
        low = -limit if info.minimum is None else info.type(info.minimum)
        high = limit if info.maximum is None else info.type(info.maximum)
        if info.type is int:
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    default = _plain(info, info.default)
    try:
        if info.type is float and not descriptor.dynamic_typing:  # a whole number is a float, too
            anything = ParameterDescriptor(dynamic_typing=True)
            default = _as_float(node.declare_parameter(info.name, default, anything)).value
            node.undeclare_parameter(info.name)
            return node.declare_parameter(info.name, default, descriptor, ignore_override=True).value
        return _plain(info, node.declare_parameter(info.name, default, descriptor).value)
    except ParameterException as err:
        raise ConfigError(f"{info.name}: {' '.join(str(err).split())}") from err


def _as_float(parameter: "Parameter[Any]") -> "Parameter[Any]":
    value = parameter.value
    return Parameter(parameter.name, value=float(value)) if type(value) is int else parameter


def _plain(info: SettingInfo, value: Any) -> Any:
    """Convert tuples and arrays of rclpy to lists, and what stands for no value to None or an empty list."""
    if (info.optional or info.is_list) and (value is None or (isinstance(value, str) and value in _NOTHING)):
        return None if info.optional else []
    return value if value is None or isinstance(value, (bool, int, float, str)) else list(value)
