# SPDX-License-Identifier: Apache-2.0
"""A model folder: its files, and the check that it stays the same run.

RUN/config.yaml        resolved settings
RUN/log.jsonl          one line per epoch
RUN/state.safetensors  state of the last epoch that was finite, from which --resume continues
RUN/PDC_TH/…        log and state of one of several networks
RUN/<name>.safetensors, RUN/<name>.json  the model and its card, at the end
RUN/<name>.trust.safetensors             its calibration

The state is one safetensors file, tensors and JSON with their checksum, that is replaced as a whole or not at all; it also
holds the lines of the log, which is written from it.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from foretouch.base.files import parse_json, read_bytes, replace_files, write_text
from foretouch.config import dump_yaml, flattened, load_yaml
from foretouch.errors import ConfigError, FileError, ModelError, shown
from foretouch_lab.learning.training.trainer import Trainer

CONFIG_FILE: Final = "config.yaml"
LOG_FILE: Final = "log.jsonl"
STATE_FILE: Final = "state.safetensors"

_KEY: Final = "foretouch-training"
_SEAL: Final = "sha256"


def write_state(path: Path, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> None:
    """Replace the state on disk by tensors and plain data, with a checksum over both, and write the log of its epochs.

    Raises:
        FileError: If it cannot be written; the previous state is kept.
    """
    sealed = {**plain, _SEAL: _digest(tensors, plain)}
    log = "".join(json.dumps(record) + "\n" for record in plain["log"])
    replace_files({path: save(dict(tensors), {_KEY: json.dumps(sealed)}), path.with_name(LOG_FILE): log.encode()})


def read_state(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return tensors and plain data of `write_state`.

    Raises:
        FileError: If there is no state, or it is damaged or was changed.
    """
    content = read_bytes(path)
    try:
        tensors = load(content)
        header = parse_json(content[8 : 8 + int.from_bytes(content[:8], "little")])
        plain = parse_json(header["__metadata__"][_KEY])
        seal = plain.pop(_SEAL)
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise FileError(path, f"is not a state of training: {' '.join(str(err).split())}") from err
    if seal != (digest := _digest(tensors, plain)):
        raise FileError(path, f"{digest} is not {shown(seal)}: the file was changed", field=_SEAL)
    return tensors, plain


def _digest(tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain).encode() + save(dict(tensors))).hexdigest()


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
        self._log: list[dict[str, Any]] = []  # a record of each epoch

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
        if any(self.path.glob("*.safetensors")) or any(self.path.glob(f"*/{STATE_FILE}")):
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

    def part(self, name: str) -> "RunFolder":
        """Return the folder of one of several networks of this run, which was opened; its records name the network."""
        folder = RunFolder(self.path / name, lambda record: self.report({"network": name, **record}))
        folder.resumed = (folder.path / STATE_FILE).exists()
        return folder

    def store(self, trainer: Trainer, record: dict[str, Any]) -> None:
        """Replace the state by a trainer's after an epoch, and report the record of the epoch."""
        self._log.append(record)
        tensors, plain = trainer.snapshot()
        write_state(self.path / STATE_FILE, tensors, {**plain, "log": self._log})
        self.report(record)

    def restore(self, trainer: Trainer) -> None:
        """Let a trainer continue from the state.

        Raises:
            FileError: If the state is damaged, or of another architecture.
        """
        file = self.path / STATE_FILE
        tensors, plain = read_state(file)
        try:
            trainer.restore(tensors, plain)
            self._log = list(plain["log"])
            write_state(file, tensors, plain)  # after a kill, the log may lack the last epoch
        except (ModelError, KeyError, TypeError, ValueError, AttributeError, OverflowError) as err:
            raise FileError(file, f"is not the state of this training: {err}") from err
