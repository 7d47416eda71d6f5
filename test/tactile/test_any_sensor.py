# SPDX-License-Identifier: Apache-2.0
"""Only the places that are about the BioTac SP know its numbers, its channels and its fingers; all else asks the description."""

import ast
import re
from pathlib import Path

import foretouch

SOURCE = Path(foretouch.__file__).parents[1]

# Messages, public JSON keys, importers of public data, presets of the papers, and the simulated BioTac SP.
OWN = (
    "tactile/channels.py",
    "tactile/readings.py",
    "tactile/messages/biotac.py",
    "tactile/messages/table.py",
    "cli/dataset.py",
    "dataset/importing.py",
    "dataset/formats/vision2tactile.py",
    "dataset/recordings/sample_codec.py",
    "ros/messages/answers.py",
    "ros/messages/conversions.py",
    "ros/messages/tactile.py",
    "ros/hand.py",
    "ros/hand_messages.py",
    "models/network/",
    "learning/data/training_set.py",
    "learning/training/supervised.py",
    "learning/training/srgan.py",
    "learning/training/trainer.py",
    "experiments/",
    "simulation/",
)
NAMES = {"ELECTRODES", "TOUCH_SIZE", "MODALITIES", "FULL_SCALE", "FINGER_ORDER", "OTHERS"}
WORDS = re.compile(r"(?<![A-Za-z])(PDC|TH|MF|FF|RF|LF)(?![A-Za-z])")
PROSE = 5  # words; what people read may name examples


def test_no_other_code_knows_the_biotac() -> None:
    found = []
    for path in sorted(SOURCE.rglob("*.py")):
        if path.relative_to(SOURCE).as_posix().partition("/")[2].startswith(OWN):
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # docstrings
        for node in ast.walk(tree):
            text = node.value if isinstance(node, ast.Constant) and id(node) not in alone else None
            named = isinstance(text, str) and len(text.split()) < PROSE and WORDS.search(text)
            if named or (isinstance(node, ast.Name) and node.id in NAMES):
                found.append(f"{path}:{node.lineno}")
    assert not found, "\n".join(found)
