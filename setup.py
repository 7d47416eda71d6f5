# SPDX-License-Identifier: Apache-2.0
"""Metadata and requirements stand in setup.cfg; here is what has to be listed by code."""

import sys
from importlib.util import find_spec
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import CCompilerError, ExecError

# What foretouch_lab adds to foretouch, as any package may (src/foretouch/doors.py).
LABORATORY = {
    "foretouch.commands": {
        **{
            name: f"foretouch_lab.cli.commands:{name.upper()}"
            for name in ("simulate", "train", "evaluate", "experiment", "benchmark", "tradeoff")
        },
        "dataset.build": "foretouch_lab.cli.commands:BUILD",
    },
    "foretouch.sources": dict.fromkeys(("scene", ".yaml", ".yml"), "foretouch_lab.simulation.scene_source:SCENE"),
    "foretouch.nodes": {"hand": "foretouch_lab.ros.hand:HandNode"},
    "foretouch.functions": {
        "compare_hand": "foretouch_lab.cli.hand_surface:run",
        "fit": "foretouch_lab.learning.training.fit:fit",
        "calibrate": "foretouch_lab.learning.training.own:calibrate",
        "evaluate": "foretouch_lab.learning.training.scoring:evaluate",
        "folds": "foretouch_lab.learning.data.folds:make_folds",
        "replay": "foretouch_lab.learning.prequential:replay_model",
    },
}
NODES = ("camera", "segmentation", "grasp", "touch_predictor", "replay", "hand", "recorder", "bridge", "perception")


class BuildKernels(build_ext):
    """Compiles the kernels, or ends with one line that names the remedy."""

    def build_extension(self, ext: Extension) -> None:
        try:
            super().build_extension(ext)
        except (CCompilerError, ExecError) as err:
            raise SystemExit(
                f"foretouch: its C kernels could not be compiled (apt install gcc, then repeat): {err}"
            ) from None


# colcon asks for the arguments of setup() with --dry-run, and cannot read the object that this becomes.
ASKED_ONLY = "--dry-run" in sys.argv
REQUIRED_PYTHON = {} if ASKED_ONLY else {"python_requires": ">=3.11"}

KERNELS = {"cffi_modules": ["src/foretouch/kernels/build.py:builder"]} if find_spec("cffi") else {}
if not KERNELS and not ASKED_ONLY:  # setuptools would warn, and leave the kernels out
    raise SystemExit(
        "foretouch: cffi, which compiles its C kernels, is not installed: pip install cffi (or apt install python3-cffi), then repeat"
    )

setup(
    **REQUIRED_PYTHON,
    **KERNELS,
    cmdclass={"build_ext": BuildKernels},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/foretouch"]),
        ("share/foretouch", ["package.xml"]),
        *(
            (f"share/foretouch/{folder}", sorted(map(str, Path(folder).glob("*.*"))))
            for folder in (
                "launch",
                "config",
                "config/hands",
                "config/models",
                "config/presets",
                "config/scenes",
                "config/sensors",
                "config/train",
            )
        ),
    ],
    entry_points={
        "console_scripts": [
            "foretouch = foretouch.__main__:main",
            *(f"foretouch_{node} = foretouch.ros.executables:{node}" for node in NODES),
        ],
        **{group: [f"{name} = {place}" for name, place in parts.items()] for group, parts in LABORATORY.items()},
    },
)
