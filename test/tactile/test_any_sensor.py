# SPDX-License-Identifier: Apache-2.0
"""Only the places that are about the BioTac SP know its numbers, its channels and its fingers; all else asks the description."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import foretouch

SOURCE = Path(foretouch.__file__).parents[1]

# Messages, public JSON keys, importers of public data, presets of the papers, and the simulated BioTac SP.
OWN = (
    "tactile/channels.py",
    "tactile/readings.py",
    "tactile/messages/biotac_",
    "tactile/messages/tactile_state.py",
    "cli/dataset.py",
    "dataset/importing.py",
    "dataset/vision2tactile.py",
    "dataset/recording/sample_codec.py",
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
SHAPES = {"arange", "empty", "full", "ones", "range", "reshape", "tile", "zeros"}


def texts_of(tree: ast.AST) -> set[int]:
    """Docstrings, and texts that stand alone, by id."""
    alone = (node.value for node in ast.walk(tree) if isinstance(node, ast.Expr))
    return {id(value) for value in alone if isinstance(value, ast.Constant)}


def sizes_in(tree: ast.AST) -> Iterator[ast.Constant]:
    """Numbers that are part of a shape, a slice or a comparison."""
    for node in ast.walk(tree):
        call = isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in SHAPES
        if call or isinstance(node, ast.Slice | ast.Compare):
            yield from (one for one in ast.walk(node) if isinstance(one, ast.Constant) and type(one.value) is int)


def findings(path: Path) -> Iterator[str]:
    """What a file knows of the BioTac SP."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    texts = texts_of(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id in NAMES:
            yield f"{node.lineno}: {node.id}"
        text = node.value if isinstance(node, ast.Constant) and id(node) not in texts else None
        if isinstance(text, str) and len(text.split()) < PROSE and WORDS.search(text):
            yield f"{node.lineno}: {text!r}"
    yield from (f"{one.lineno}: {one.value}" for one in sizes_in(tree) if one.value in (24, 25, 50))


def test_no_other_code_knows_the_biotac() -> None:
    found = [
        f"{name}:{finding}"
        for path in sorted(SOURCE.rglob("*.py"))
        if not (name := path.relative_to(SOURCE).as_posix()).partition("/")[2].startswith(OWN)
        for finding in findings(path)
    ]
    assert not found, "\n".join(found)


def test_a_constant_of_the_biotac_would_be_found(tmp_path: Path) -> None:
    path = tmp_path / "code.py"
    path.write_text(
        '"""Of PDC and TH."""\nimport numpy as np\nx = np.zeros((3, 24))\ny = x[:50]\nz = "E_TH"\nw = MODALITIES\n'
    )
    assert list(findings(path)) == ["5: 'E_TH'", "6: MODALITIES", "3: 24", "4: 50"]
