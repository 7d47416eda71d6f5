# SPDX-License-Identifier: Apache-2.0
"""The commands: what each prints in the help, and the module that runs it.

A package adds a command by an entry point of the group `foretouch.commands` that names a `CommandEntry`, and an action of
`foretouch dataset` by one that is called `dataset.NAME`.
"""

import importlib
from types import ModuleType
from typing import Final, NamedTuple

from foretouch.doors import Door, reported
from foretouch.errors import ConfigError


class CommandEntry(NamedTuple):
    """A command, described without importing its module.

    Attributes:
        summary: Its line in the help.
        module: Has `add_arguments(parser)` and `run(arguments) -> int`. Heavy libraries are imported inside of `run`, so that help is fast.
        example: A command line for its help.
        uses_ros: Whether the variables of ROS 2 are checked before it runs.
        has_json: Whether it takes `--json`; a command whose actions take it does not.
    """

    summary: str
    module: str
    example: str
    uses_ros: bool = False
    has_json: bool = True

    def load(self, name: str) -> ModuleType:
        """Import the module; a `ConfigError` if it cannot be, or a `MissingDependencyError` if a library that it needs is not installed."""
        with reported(f"command {name}", str(self.module)):
            module = importlib.import_module(self.module)
        for function in ("add_arguments", "run"):
            if not callable(getattr(module, function, None)):
                raise ConfigError(f"command {name}: {self.module} has no function {function}")
        return module


COMMANDS: Final = Door(
    "foretouch.commands",
    "command",
    {
        "segment": CommandEntry(
            "Segment the table and the objects of each cloud", "foretouch.cli.segment", "foretouch segment scene.npz"
        ),
        "grasp": CommandEntry(
            "Plan two-finger grasps on each object",
            "foretouch.cli.grasp",
            "foretouch grasp object.pcd --plane 0,0,1,-1.27",
        ),
        "predict": CommandEntry(
            "Predict the tactile readings of grasps on each object",
            "foretouch.cli.predict",
            "foretouch predict object.pcd --touched session",
        ),
        "dataset": CommandEntry(
            "Inspect, verify, repair, edit and convert datasets",
            "foretouch.cli.dataset",
            "foretouch dataset info session",
            has_json=False,
        ),
        "run": CommandEntry(
            "Run the whole ROS graph in one terminal",
            "foretouch.cli.run",
            "foretouch run --source config/scenes/clean.yaml --count 30 --picture touch.png",
            uses_ros=True,
        ),
        "record": CommandEntry(
            "Record grasps and tactile readings to a dataset",
            "foretouch.cli.record",
            "foretouch record -o session --object can --samples 20",
            uses_ros=True,
        ),
        "replay": CommandEntry(
            "Replay a recording or a folder of clouds to the ROS graph",
            "foretouch.cli.replay",
            "foretouch replay session --rate 5",
            uses_ros=True,
        ),
        "forget": CommandEntry(
            "Let a running graph forget readings of the object or of the hand",
            "foretouch.cli.forget",
            "foretouch forget touches",
            uses_ros=True,
        ),
        "view": CommandEntry(
            "Show clouds, grasps and predicted touch in Rerun",
            "foretouch.cli.view",
            "foretouch view session --save session.rrd",
            has_json=False,
        ),
        "models": CommandEntry("List and verify touch models", "foretouch.cli.models", "foretouch models contact-v3"),
        "sensor": CommandEntry(
            "List, check and draw descriptions of tactile sensors",
            "foretouch.cli.sensor",
            "foretouch sensor list",
            has_json=False,
        ),
        "hand": CommandEntry(
            "List, check and draw descriptions of hands and grippers",
            "foretouch.cli.hand",
            "foretouch hand list",
            has_json=False,
        ),
        "doctor": CommandEntry(
            "Check dependencies and print the fixes", "foretouch.cli.doctor", "foretouch doctor --self-test"
        ),
    },
    CommandEntry,
)
"""All commands by name: the commands of foretouch, then those that other packages add."""
