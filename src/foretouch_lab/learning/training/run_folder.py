# SPDX-License-Identifier: Apache-2.0
"""A model folder: its files, and the check that it stays the same run.

RUN/config.yaml        resolved settings
RUN/log.jsonl          one line per epoch
RUN/state.safetensors  state of the last epoch that was finite, from which --resume continues
RUN/<name>.safetensors, RUN/<name>.json  the model and its card, at the end
RUN/<name>.trust.safetensors             its calibration

The state is one safetensors file, tensors and JSON with their checksum, that is replaced as a whole or not at all.
"""

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from foretouch.config import dump_yaml, flattened, load_yaml
from foretouch.errors import ConfigError, FileError, ModelError, shown
from foretouch.files import TEXT_LIMIT, open_own, parse_json, read_bytes, replace_files, system_errors, write_text
from foretouch_lab.learning.training.trainer import Trainer

CONFIG_FILE: Final = "config.yaml"
LOG_FILE: Final = "log.jsonl"
STATE_FILE: Final = "state.safetensors"

_KEY: Final = "foretouch-training"
_SEAL: Final = "sha256"


def write_state(path: Path, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> None:
    """Replace the state on disk by tensors and plain data, with a checksum over both.

    Raises:
        FileError: If it cannot be written; the previous state is kept.
    """
    sealed = {**plain, _SEAL: _digest(tensors, plain)}
    replace_files({path: save(dict(tensors), {_KEY: json.dumps(sealed)})})


def read_state(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors and plain data of `write_state`.

    Raises:
        FileError: If there is no state, or it is damaged or was changed.
    """
    try:
        content = read_bytes(path)
        tensors = load(content)
        header = parse_json(content[8 : 8 + int.from_bytes(content[:8], "little")])
        plain = parse_json(header["__metadata__"][_KEY])
        seal = plain.pop(_SEAL)
    except FileError as err:
        if isinstance(err.__cause__, FileNotFoundError):
            raise FileError(path, "does not exist: there is nothing to resume") from err
        raise
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise FileError(path, f"is not a state of training: {' '.join(str(err).split())}") from err
    if seal != (found := _digest(tensors, plain)):
        raise FileError(path, f"{found} is not {shown(seal)}: the file was changed", field=_SEAL)
    return tensors, plain


def _digest(tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> str:
    """SHA-256 over the plain data and over name, type, shape and bytes of each tensor, hexadecimal."""
    digest = hashlib.sha256(json.dumps(plain).encode())
    for name, value in sorted(tensors.items()):
        digest.update(json.dumps([name, str(value.dtype), list(value.shape)]).encode())
        digest.update(value.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


class RunFolder:
    """The files of one model folder.

    Attributes:
        path: The folder; made by `open`.
        report: Called with a record of each epoch.
        resumed: Whether there is a state to resume from; set once the folder is open.
    """

    def __init__(self, path: Path, report: Callable[[Mapping[str, Any]], None] = lambda _: None) -> None:
        self.path = path
        self.report = report
        self.resumed = False

    def open(self, resolved: Mapping[str, Any], *, resume: bool) -> None:
        """Begin a run, or check that the folder holds this very run.

        In a folder without any weights nothing can be lost, and a run begins in it; so a run that was refused
        or stopped before its first epoch can be corrected and started again.

        Args:
            resolved: The settings, and the hash of the data.
            resume: Whether the folder may hold a run.

        Raises:
            FileError: If there are weights and `resume` is off, or the folder cannot be written.
            ConfigError: If the run in the folder has other settings or other data; names the first field that differs.
        """
        file = self.path / CONFIG_FILE
        if any(self.path.glob("*.safetensors")):
            if not resume:
                raise FileError(self.path, "holds a run already; --resume continues it")
            before = flattened(load_yaml(file))
            for key, value in flattened(resolved).items():
                if before.get(key) != value:
                    text = f"{key}: {before.get(key)!r} is not {value!r}; a run resumes as it began"
                    raise ConfigError(f"{file}: {text}")
            self.resumed = (self.path / STATE_FILE).exists()
            return
        write_text(file, dump_yaml(resolved))

    def remove_unfinished(self) -> None:
        """Remove the settings of a run that was refused before its first epoch, and the folder if nothing else is in it."""
        if not any(self.path.glob("*.safetensors")):
            (self.path / CONFIG_FILE).unlink(missing_ok=True)
            with suppress(OSError):
                self.path.rmdir()

    def keep_log(self, epochs: int) -> None:
        """Remove the lines after so many epochs: those whose state was not written before a kill."""
        file = self.path / LOG_FILE
        if file.exists():
            lines = read_bytes(file, TEXT_LIMIT).decode(errors="replace").splitlines()
            write_text(file, "".join(f"{line}\n" for line in lines[:epochs]))

    def log(self, record: Mapping[str, Any]) -> None:
        """Append an epoch's line; raises `FileError` if it cannot be written, such as on a full disk."""
        file = self.path / LOG_FILE
        with (
            system_errors(file, "cannot be written"),
            os.fdopen(open_own(file, os.O_WRONLY | os.O_APPEND), "ab") as log,
        ):
            log.write(json.dumps(record).encode() + b"\n")

    def store(self, trainer: Trainer) -> None:
        """Replace the state by that of a trainer."""
        write_state(self.path / STATE_FILE, *trainer.snapshot())

    def restore(self, trainer: Trainer) -> None:
        """Let a trainer continue from the state.

        Raises:
            FileError: If the state is damaged, or of another architecture.
        """
        file = self.path / STATE_FILE
        tensors, plain = read_state(file)
        try:
            trainer.restore(tensors, plain)
        except (ModelError, KeyError, TypeError, ValueError, AttributeError, OverflowError) as err:
            raise FileError(file, f"is not the state of this training: {err}") from err
