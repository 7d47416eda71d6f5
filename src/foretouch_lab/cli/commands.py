# SPDX-License-Identifier: Apache-2.0
"""The commands of the laboratory, which `setup.py` adds to those of foretouch."""

from typing import Final

from foretouch.cli.commands import CommandEntry

SIMULATE: Final = CommandEntry(
    "Simulate grasps in a scene and write them to a dataset",
    "foretouch_lab.cli.simulate",
    "foretouch simulate config/scenes/rigid.yaml -n 100 -o simulated",
)
TRAIN: Final = CommandEntry(
    "Train a touch model from a configuration",
    "foretouch_lab.cli.train",
    "foretouch train contact-v3 data=store -o can_model",
)
EVALUATE: Final = CommandEntry(
    "Evaluate a touch model and the baselines on a dataset",
    "foretouch_lab.cli.evaluate",
    "foretouch evaluate contact-v3 store --split object",
)
EXPERIMENT: Final = CommandEntry(
    "Run an experiment and write its tables, figures and manifest",
    "foretouch_lab.cli.experiment",
    "foretouch experiment prequential -o out --preset quick",
)
BENCHMARK: Final = CommandEntry(
    "Score touch models and baselines on the same held-out grasps: the leaderboard",
    "foretouch_lab.cli.benchmark",
    "foretouch benchmark touch --model my_lab.mine:Mine -o out",
)
TRADEOFF: Final = CommandEntry(
    "Measure what accuracy costs in time, and draw the frontier",
    "foretouch_lab.cli.tradeoff",
    "foretouch tradeoff model -o out",
)
BUILD: Final = CommandEntry(
    "Build a training store with splits",
    "foretouch_lab.cli.build",
    "foretouch dataset build session simulated -o store",
)
