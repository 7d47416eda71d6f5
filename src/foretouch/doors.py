# SPDX-License-Identifier: Apache-2.0
"""Doors: parts that are found by name, and that any installed package can add.

A package adds a part by an entry point (the section `[project.entry-points]` of its `pyproject.toml`) in one of these groups:

- `foretouch.commands`: a `foretouch.cli.commands.CommandEntry`; the name `dataset.NAME` adds an action to `foretouch dataset`.
- `foretouch.sources`: a `foretouch.camera.source.ImageSource`, for `run --source` and the camera node.
- `foretouch.nodes`: the class of a node.
- `foretouch.formats`: a `foretouch.dataset.formats.FormatEntry`.
- `foretouch.models`: a predictor (`foretouch.models.predictor`), or what makes one.
- `foretouch.recipes`: settings of `foretouch train`, as a dictionary.
- `foretouch.functions`: functions behind others: `fit`, `calibrate` and `evaluate` of `import foretouch`, `SampleSet.split`, `predict --prequential` and `hand check --mesh`.

What `foretouch_lab` brings stands in `setup.py`, in the same way. A robot needs none of it.
"""

import functools
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any, Final, NamedTuple

from foretouch.errors import ConfigError, ForetouchError, MissingDependencyError, described, nearest, raised_at, shown

_OPTIONAL: Final = {
    "embreex": "embreex",
    "sklearn": "scikit-learn",
    "threadpoolctl": "threadpoolctl",
    "torch": "torch",
    "trimesh": "trimesh",
}
"""Distributions of the extra `lab`, by the name under which they are imported."""
_OF_ROS: Final = ("rclpy", "_msgs", "_srvs", "_interfaces")  # ends of names of modules


class EntryPoint(NamedTuple):
    """A part that a package adds."""

    name: str
    place: str  # `module:attribute`
    package: str  # that brings it


class Door:
    """Parts of one kind by name.

    Args:
        group: Of the entry points, such as `foretouch.nodes`.
        noun: What a part is called in errors.
        own: Parts of foretouch by name, which no other package replaces. A text is the place of one, `module:attribute`, which
            is imported when it is asked for.
        kind: What each part must be an instance of.
        reserved: Further names that mean something in foretouch, so that no package may add them.
    """

    def __init__(
        self,
        group: str,
        noun: str,
        own: Mapping[str, Any] | None = None,
        kind: type = object,
        reserved: Iterable[str] = (),
    ) -> None:
        self.group, self.noun, self.kind = group, noun, kind
        self._own = dict(own or {})
        self.reserved = frozenset({*self._own, *reserved})
        self._reported = set[str]()  # parts whose faults are in the log

    def __iter__(self) -> Iterator[str]:
        """Return the names of all parts: those of foretouch first, in their order."""
        yield from self._own
        yield from sorted(self.added().keys() - self._own.keys())

    def load(self, name: str, user: str = "") -> Any:
        """Return a part, which is imported if it was not.

        Args:
            name: Of the part.
            user: What needs it, for errors; by default the part.

        Raises:
            ConfigError: If there is no such part, or it cannot be imported.
            MissingDependencyError: If a library that it needs is not installed.
        """
        user = user or f"{self.noun} {shown(name)}"
        if name in self._own:
            own = self._own[name]
            if not isinstance(own, str):
                return own
            with reported(user, own):
                return import_place(own)
        entry = self._added(name, user)
        with reported(user, entry.place, entry.package):
            part = import_place(entry.place)
        if not isinstance(part, self.kind):
            raise ConfigError(f"{user}: {entry.place} is a {type(part).__name__} and no {self.kind.__name__}")
        return part

    def loaded(self) -> Iterator[tuple[str, Any]]:
        """Iterate over all parts by name. One that cannot be imported is a line in the log, once, and the others go on without it."""
        for name in self:
            try:
                yield name, self.load(name)
            except ForetouchError as err:
                if name not in self._reported:
                    _warn(str(err))
                self._reported.add(name)

    def call(self, name: str, user: str, /, *args: Any, **options: Any) -> Any:
        """Call a part that is a function.

        Args:
            name: Of the part.
            user: What needs it, for errors.
            args: Its arguments.
            options: Its named arguments.

        Raises:
            ForetouchError: If `load` raises it, if a library that the function imports is missing, or if the function raises it.
        """
        with needs_extras(user):
            return self.load(name, user)(*args, **options)

    def _added(self, name: str, user: str) -> EntryPoint:
        if name in (added := self.added()):
            return added[name]
        known = list(self)
        listed = (
            f"of which {', '.join(known)} are known{nearest(name, known)}" if known else "of which none is installed"
        )
        raise ConfigError(f"{user}: is no entry point of the group {self.group}, {listed}")

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in self.added()

    def added(self) -> Mapping[str, EntryPoint]:
        """Return the parts of the laboratory and of other packages by name. One whose name is taken is a line in the log, once."""
        return _chosen(self.group, self.noun, self.reserved, tuple(sys.path))


@functools.cache
def _chosen(group: str, noun: str, taken: frozenset[str], folders: tuple[str, ...]) -> Mapping[str, EntryPoint]:
    """Choose one part for each name: the laboratory's, or else the part of the package that comes first in the alphabet."""
    chosen: dict[str, EntryPoint] = {}
    for entry in _entry_points(folders).get(group, ()):
        if entry.name in taken or entry.name in chosen:
            holder = "foretouch" if entry.name in taken else chosen[entry.name].package
            _warn(f"{noun} {shown(entry.name)} of {entry.package} is left out: {holder} has this name")
        else:
            chosen[entry.name] = entry
    return chosen


def _warn(text: str) -> None:
    import logging

    logging.getLogger(__name__).warning("foretouch: %s", text)


@functools.cache
def _entry_points(folders: tuple[str, ...]) -> Mapping[str, Sequence[EntryPoint]]:
    """Read what installed packages add, by group, from the folders where Python looks for modules: foretouch first, then by package.

    `importlib.metadata` gives the same, but nothing else imports it for `foretouch --help`, which takes 193 ms of a processor with it and
    136 ms without (least of 15 runs, 275 packages); `run --help` takes 945 and 904 ms, and `import foretouch` 87 and 88 ms.
    """
    groups: defaultdict[str, list[EntryPoint]] = defaultdict(list)
    seen = set[str]()
    for folder in folders:
        for info in chain.from_iterable(Path(folder).glob(f"*.{kind}-info") for kind in ("dist", "egg")):
            package = info.stem.partition("-")[0]
            if package not in seen:
                seen.add(package)
                for group, part, place in _parts(info / "entry_points.txt"):
                    groups[group].append(EntryPoint(part, place, package))
    for entries in groups.values():
        entries.sort(key=lambda entry: (entry.package != "foretouch", entry.package))
    return groups


def _parts(file: Path) -> Iterator[tuple[str, str, str]]:
    """Read group, name and place of the parts of foretouch in a file of entry points; nothing if there is no such file."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return
    group = ""
    for line in text.splitlines() if "[foretouch." in text else ():
        name, equals, place = line.partition("=")
        if line.startswith("["):
            group = line.strip("[] ")
        elif equals and group.startswith("foretouch."):
            yield group, name.strip(), place.partition("[")[0].strip()


FUNCTIONS: Final = Door("foretouch.functions", "function")
"""What is asked of the laboratory by functions of foretouch: to train, calibrate and score models, and to measure a hand."""


def import_place(place: str) -> Any:
    """Import what `module:attribute` names. Python's own errors are raised."""
    module, _, attribute = place.partition(":")
    if not all(map(str.isidentifier, module.split("."))):
        raise ValueError("is not module:attribute")
    return functools.reduce(getattr, filter(None, attribute.split(".")), import_module(module))


@contextmanager
def reported(user: str, place: str, package: str = "") -> Iterator[None]:
    """Report what another package's code raises when it is imported in one line.

    Args:
        user: What needs it.
        place: What is imported, `module` or `module:attribute`.
        package: That brings it, if it is known.

    Raises:
        MissingDependencyError: If a library is not installed, or the package itself.
        ConfigError: If it cannot be imported for another reason.
    """
    try:
        with needs_extras(user):
            yield
    except ForetouchError:
        raise
    except (Exception, SystemExit) as err:
        module = place.partition(":")[0].strip()
        if package and isinstance(err, ModuleNotFoundError) and err.name and f"{module}.".startswith(f"{err.name}."):
            cure = f"{package} names it; install {package} again, from where it came from"
            cure = "pip install --force-reinstall foretouch" if package == "foretouch" else cure
            raise MissingDependencyError(f"{user}: there is no module {shown(err.name)}: {cure}") from err
        raise ConfigError(f"{user}: {shown(place)} cannot be imported: {described(err)}") from err


@contextmanager
def at_work(user: str) -> Iterator[None]:
    """Report what another package's code raises at its work as a `ConfigError` of one line; foretouch's own errors pass.

    Args:
        user: The part that works, for the error.
    """
    try:
        yield
    except (ForetouchError, ModuleNotFoundError):
        raise
    except Exception as err:
        raise ConfigError(f"{user}: {described(err)}{raised_at(err)}") from err


@contextmanager
def needs_extras(user: str) -> Iterator[None]:
    """Report a library of an extra, or of ROS, that is not installed as a `MissingDependencyError` that names the cure."""
    try:
        yield
    except ModuleNotFoundError as err:
        cure = _cure((err.name or "").partition(".")[0])
        if not cure:
            raise
        raise MissingDependencyError(f"{user}: {cure}") from err


def _cure(module: str) -> str:
    """Say what is not installed, and how to install it; "" for a module that no extra needs."""
    if module in _OPTIONAL:
        return f"{_OPTIONAL[module]} is not installed: pip install 'foretouch[lab]'"
    if module == "yourdfpy":
        return "yourdfpy is not installed: pip install 'foretouch[urdf]'"
    if module.endswith(_OF_ROS) and find_spec("rclpy") is None:
        return "ROS 2 is not installed: pip install 'foretouch[ros]', or source your installation (foretouch doctor)"
    if module == "foretouch_msgs":
        return "foretouch_msgs is not installed: pip install ./foretouch_msgs in a clone of foretouch"
    return ""
