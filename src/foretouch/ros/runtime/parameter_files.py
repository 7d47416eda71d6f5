# SPDX-License-Identifier: Apache-2.0
"""Parameters in files and on the command line, checked before any node starts: ROS ignores names that nobody has.

A parameter of a named node must be one of that node's; one for all nodes (`/**`), of one of them. Nodes of other packages
may stand in the same file, outside of the namespace of the graph, if their names are unlike the names of our nodes.
"""

import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import pairwise
from typing import Any, Final

from foretouch.config import EMPTY, flattened, load_yaml, setting_infos
from foretouch.doors import Door
from foretouch.errors import ConfigError, nearest
from foretouch.topics import NAMESPACE

_SHARED: Final = ("use_sim_time", "start_type_description_service", "qos_overrides")
_STEPS: Final = ("segmentation", "grasp", "touch_predictor")
"""Nodes of single steps, for who replaces one of them; `perception` does the work of all."""
_CHANGED: Final = {  # in 0.4
    "hand": "is called hand_name since 0.4",
    "queue_depth": "was removed in 0.4: the newest cloud is answered next",
    "latency_budget_ms": "was removed in 0.4: a prediction takes half a millisecond; see docs/accuracy_vs_time.md",
    "direct": "was removed in 0.4: perception is one node",
}

"""What gives the class of each node, by name."""

_ALIKE: Final = 0.8  # of two names that are taken for one, misspelled


def check_parameters(
    arguments: Sequence[str], nodes: Door, own: Mapping[str, Mapping[str, Any]], namespace: str = NAMESPACE
) -> None:
    """Check the parameters of nodes, of parameter files and of a command line.

    Args:
        arguments: The command line, which may remap the namespace.
        nodes: All nodes that there are.
        own: Parameters of the nodes of this process, by name.
        namespace: Of these nodes.

    Raises:
        ConfigError: If a file is none, or names an unknown node or parameter, with the nearest known one.
    """
    remapped = [word.partition(":=")[2] for word in arguments if re.match(r"(\w+:)?__ns:=", word)]
    namespace = f"/{(remapped or [namespace])[-1].strip('/')}"
    for name, given in own.items():
        _require_known(f"node {name}", [name], given, nodes)
    for option, value in pairwise(arguments):
        if option == "--params-file":
            for name, given in nodes_of_file(value):
                _check(value, name, given, nodes, namespace)
                _refuse_moved(value, name, given, own)
        elif option in {"-p", "--param"} and ":=" in value:
            name, _, parameter = value.partition(":=")[0].rpartition(":")
            _require_known(f"{option} {value}", [name] if name in nodes else [*own], {parameter: None}, nodes)


def nodes_of_file(path: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Read the full names of the nodes in a file, with their parameters by dotted name."""

    def walk(name: str, value: Any) -> Iterator[tuple[str, dict[str, Any]]]:
        groups = value if isinstance(value, Mapping) else {}
        given = groups.get("ros__parameters")
        inner = [(f"{name}/{str(key).strip('/')}", group) for key, group in groups.items() if key != "ros__parameters"]
        if (given is None and not inner) or not isinstance(given, Mapping | None):
            rule = "holds no ros__parameters; a parameter file is NODE: {ros__parameters: {NAME: VALUE}}"
            raise ConfigError(f"{path}: {name.lstrip('/')}: {rule}")
        if given is not None:
            yield name, {str(key): entry for key, entry in flattened(given).items()}
        for key, entry in inner:
            yield from walk(key, entry)

    for name, value in load_yaml(path).items():
        yield from walk(f"/{str(name).strip('/')}", value)


def _check(path: str, name: str, given: Mapping[str, Any], nodes: Door, namespace: str) -> None:
    place, _, short = name.rpartition("/")
    place = place or "/"
    if short in nodes and (place in {namespace, NAMESPACE} or "*" in place or not _taken_for(place, ("/", NAMESPACE))):
        _require_known(f"{path}: {name}", [short], given, nodes)
    elif "*" in short:
        _require_known(f"{path}: {name}", list(nodes), given, nodes)
    elif short in nodes or place == namespace or _taken_for(short, nodes):
        graph = f"{namespace.rstrip('/')}/"
        hint = nearest(short, nodes).replace("mean ", f"mean {graph}")
        raise ConfigError(f"{path}: {name}: there is no such node; in {graph} are {', '.join(nodes)}{hint}")


def _refuse_moved(path: str, name: str, given: Mapping[str, Any], own: Container[str]) -> None:
    """Refuse parameters of single steps where one node does the work of all of them."""
    place, _, short = name.rpartition("/")
    if short in _STEPS and "perception" in own and short not in own and given:
        listed = ", ".join(sorted(given))
        raise ConfigError(
            f"{path}: {name}: {listed}: the node {place}/perception has these parameters since 0.4: move them there"
        )


def _taken_for(name: str, known: Iterable[str]) -> bool:
    return bool(get_close_matches(name, list(known), 1, _ALIKE))


def _require_known(place: str, names: Sequence[str], given: Mapping[str, Any], nodes: Door) -> None:
    """Refuse a parameter that none of some nodes has, or that has no value."""
    classes = [nodes.load(name) for name in names]
    known = [
        info.name for kind in classes if hasattr(kind, "config_class") for info in setting_infos(kind.config_class)
    ]
    for parameter, value in given.items():
        if parameter not in known and parameter.partition(".")[0] not in _SHARED:
            rule = _CHANGED.get(parameter, f"unknown parameter{nearest(parameter, known)}")
            raise ConfigError(f"{place}: {parameter}: {rule}")
        if value is EMPTY:
            raise ConfigError(f"{place}: {parameter}: is empty")
