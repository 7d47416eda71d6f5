# SPDX-License-Identifier: Apache-2.0
"""The state of a training on disk: one safetensors file, tensors and JSON, replaced as a whole or not at all.

The folder of a run: what stands in it, and that it stays the run that it began as.

RUN/config.yaml        as resolved
RUN/log.jsonl          one line an epoch
RUN/state.safetensors  of the last epoch that was finite, from which --resume goes on
RUN/<name>.safetensors, RUN/<name>.json  the model and its card, at the end
RUN/tensorboard        the same figures as the log's, only where `tensorboard` asks for them
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import yaml
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from foretouch.config import load_yaml
from foretouch.errors import ConfigError, FileError, ModelError
from foretouch.learning.training.trainer import Trainer
from foretouch.models.card import write_text
from foretouch.models.files import replace_files

__all__ = ["BOARD_FOLDER", "LOG_FILE", "STATE_FILE", "RunFolder", "read_state", "write_state"]


_KEY = "foretouch-training"


def write_state(path: Path, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> None:
    """Replace the state on disk; the one before survives any failure.

    Args:
        path: Of the file.
        tensors: By name.
        plain: What JSON holds.

    Raises:
        FileError: If it cannot be written, such as on a full disk.
    """
    replace_files({path: save(dict(tensors), {_KEY: json.dumps(plain)})})


def read_state(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and plain data of `write_state`.

    Raises:
        FileError: If there is none, or it is damaged.
    """
    try:
        with safe_open(path, framework="pt") as file:
            plain = json.loads(file.metadata()[_KEY])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError as err:
        raise FileError(path, "does not exist: there is nothing to resume") from err
    except (SafetensorError, OSError, ValueError, KeyError, TypeError) as err:
        raise FileError(path, f"is no state of training: {' '.join(str(err).split())}") from err
    return tensors, plain


CONFIG_FILE: Final = "config.yaml"
LOG_FILE: Final = "log.jsonl"
BOARD_FOLDER: Final = "tensorboard"
STATE_FILE: Final = "state.safetensors"

_BEST: Final = "best/"


class RunFolder:
    """Where one run is kept.

    Args:
        path: The folder; made by `open`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def open(self, resolved: Mapping[str, Any], *, resume: bool) -> bool:
        """Begin a run, or check that the one that stands here is this very one.

        A folder without weights of any kind holds nothing that could be lost, and a run begins in it; so what was refused
        or stopped before its first epoch can be mended and started again.

        Args:
            resolved: The configuration, and the hash of the data.
            resume: Whether a run may stand here.

        Returns:
            Whether there is a state to go on from.

        Raises:
            FileError: If there are weights and `resume` is off, or the folder cannot be written.
            ConfigError: If the run here has another configuration or other data; names the first field that differs.
        """
        file = self.path / CONFIG_FILE
        if any(self.path.glob("*.safetensors")):
            if not resume:
                raise FileError(self.path, "holds a run already; --resume goes on with it")
            _require_same(load_yaml(file), resolved, file)
            return (self.path / STATE_FILE).exists()
        write_text(file, yaml.safe_dump(dict(resolved), sort_keys=False))
        return False

    def keep_log(self, epochs: int) -> None:
        """Forget the lines after so many epochs: those whose state was not written before a kill.

        Raises:
            FileError: If the log cannot be read or written.
        """
        file = self.path / LOG_FILE
        if not file.exists():
            return
        try:
            lines = file.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as err:
            raise FileError(file, f"cannot be read: {err}") from err
        write_text(file, "".join(f"{line}\n" for line in lines[:epochs]))

    def log(self, record: Mapping[str, Any]) -> None:
        """Append an epoch's line.

        Raises:
            FileError: If it cannot be written, such as on a full disk.
        """
        file = self.path / LOG_FILE
        try:
            with file.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(record) + "\n")
        except OSError as err:
            raise FileError(file, f"cannot be written: {err.strerror or err}") from err

    def store(self, trainer: Trainer, best: Mapping[str, Tensor], facts: Mapping[str, Any]) -> None:
        """Replace the state.

        Args:
            trainer: What is trained.
            best: Weights of the best epoch so far, by name; empty without validation.
            facts: What is told of that epoch, as JSON holds it.

        Raises:
            FileError: If it cannot be written; the one before is kept.
        """
        tensors, plain = trainer.snapshot()
        tensors |= {_BEST + name: value for name, value in best.items()}
        write_state(self.path / STATE_FILE, tensors, {**plain, "best": dict(facts)})

    def restore(self, trainer: Trainer) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Let a trainer go on from the state; weights and facts of the best epoch, as they were stored.

        Raises:
            FileError: If the state is damaged, or of another architecture.
        """
        file = self.path / STATE_FILE
        tensors, plain = read_state(file)
        best = {name.removeprefix(_BEST): tensors.pop(name) for name in list(tensors) if name.startswith(_BEST)}
        try:
            trainer.restore(tensors, plain)
            return best, dict(plain["best"])
        except (ModelError, KeyError) as err:
            raise FileError(file, f"is not the state of this training: {err}") from err


def _require_same(old: Mapping[str, Any], new: Mapping[str, Any], file: Path) -> None:
    before, now = _leaves(old), _leaves(new)
    for key in now:
        if before.get(key) != now[key]:
            raise ConfigError(f"{file}: {key}: {before.get(key)!r} is not {now[key]!r}; a run resumes as it began")


def _leaves(mapping: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings by their dotted names."""
    leaves: dict[str, Any] = {}
    for key, value in mapping.items():
        leaves |= _leaves(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return leaves
