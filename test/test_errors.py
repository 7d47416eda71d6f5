# SPDX-License-Identifier: Apache-2.0
"""Known failures: messages of one line, whatever names they repeat, and errors that leave the process that raised them."""

import ast
import copy
import importlib
import inspect
import multiprocessing
import pickle
from pathlib import Path
from typing import Any

import pytest
from every_case import every_case

import foretouch
import foretouch_lab
from foretouch.base.files import read_bytes
from foretouch.dataset.labelling.cut import PairingError
from foretouch.errors import CloudError, ConfigError, FileError, ForetouchError, SimulationError

SENT = {"path": Path("a/b.mcap"), "status": 3}  # arguments of errors that are not texts


def test_a_failure_is_one_short_line() -> None:
    def check(err: ForetouchError) -> None:
        assert str(err).isprintable()
        assert 0 < len(str(err)) <= 20_000

    long = {"one name": ConfigError("x" * 100_000), "codes": PairingError("why", "\x1b[2J" * 9999)}
    every_case({"lines": ForetouchError("a\nb\0"), "simulation": SimulationError("a\nb"), **long}, check)
    ordinary = "scene.yaml: camera.range_m: 12.0 exceeds 10.0 … ±"
    assert str(ConfigError(ordinary)) == ordinary


def error_classes() -> list[type[BaseException]]:
    """All classes of exceptions that the modules of both packages define; ROS need not be installed for their names."""
    found: list[type[BaseException]] = []
    for package in (foretouch, foretouch_lab):
        root = Path(str(package.__file__)).parent
        for file in sorted(root.rglob("*.py")):
            classes = [node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.ClassDef)]
            names = [
                node.name
                for node in classes
                if any(
                    ast.unparse(base).endswith(("Error", "Exception", "Warning", "Interrupt")) for base in node.bases
                )
            ]
            if names:
                name = ".".join([package.__name__, *file.relative_to(root).with_suffix("").parts])
                if ".ros." in name:
                    pytest.importorskip("rclpy")
                found += [getattr(importlib.import_module(name), class_name) for class_name in names]
    return found


def test_every_error_is_pickled_and_copied_with_its_attributes() -> None:
    def check(kind: Any) -> None:
        parameters = [name for name in inspect.signature(kind).parameters if name not in {"args", "kwargs"}]
        err = kind(**{name: SENT.get(name, f"the {name}") for name in parameters}) if parameters else kind()
        err.add_note("seen in a test")
        for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
            same_as(pickle.loads(pickle.dumps(err, protocol)), err)
        same_as(copy.copy(err), err)
        same_as(copy.deepcopy(err), err)

    def same_as(other: Any, err: Any) -> None:
        assert type(other) is type(err)
        assert (str(other), other.args, vars(other)) == (str(err), err.args, vars(err))

    kinds = error_classes()
    assert {FileError, PairingError, CloudError} <= {*kinds}
    every_case(kinds, check)


def test_the_error_of_a_file_leaves_the_worker_that_read_it(tmp_path: Path) -> None:
    with multiprocessing.get_context("fork").Pool(1) as pool:
        with pytest.raises(FileError, match=r"absent\.pcd") as caught:
            pool.map_async(read_bytes, [tmp_path / "absent.pcd"]).get(60)
        pool.close()  # so that it ends by itself: it inherits the handlers of signals that ROS leaves behind
        pool.join()
    assert (caught.value.path, caught.value.rule) == (tmp_path / "absent.pcd", "No such file or directory")
