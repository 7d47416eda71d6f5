# SPDX-License-Identifier: Apache-2.0
"""Files of a release, and what commands print of them: kept in `data/from_<version>`, they prove what later versions read.

    python test/compatibility_files.py test/data/from_0_2_0

Make them once, with the code of the release. Do not renew them: files that newer code wrote prove nothing about older ones.
"""

import contextlib
import hashlib
import io
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
from calibrated_models import save_calibrated_contact, save_calibrated_network
from recording_builders import write_grasps

from foretouch.cli.main import main

EXPECTED = "expected.json"
_CHANGING = {"ms", "seconds", "version", "out", "path", "original"}
"""Keys whose values differ from run to run, or name folders."""
REFUSED = ("recording: ", "edits", "repair")
"""Beginnings of what was printed of recordings, which version 0.3 was the last to convert."""


def make(folder: Path) -> None:
    """Write the files and what is printed of them."""
    recording = folder / "recording"
    write_grasps(recording)
    printed("dataset", "edit", recording, "--relabel", "cup", "--id", "cheezit/0")
    printed("dataset", "edit", recording, "--merge", "campbells", "mug")
    printed("dataset", "edit", recording, "--drop", "--id", "cheezit/3")
    printed("dataset", "edit", recording, "--undo")
    printed("dataset", "build", recording, "-o", folder / "store", "--seed", 3)
    save_calibrated_contact(folder / "model")
    save_calibrated_network(folder / "model")
    expected = json.dumps(read(folder, folder / "scratch"), indent=1, sort_keys=True) + "\n"
    shutil.rmtree(folder / "scratch")
    (folder / EXPECTED).write_text(expected, encoding="utf-8")


def read(files: Path, scratch: Path) -> dict[str, Any]:
    """What commands print of the files, as far as it is the same on every machine."""
    folder = Path(shutil.copytree(files, scratch, ignore=shutil.ignore_patterns(scratch.name)))
    _require_refusal(folder / "recording")
    found: dict[str, Any] = {}
    for kind in ("store",):
        found[f"{kind}: info"] = printed("dataset", "info", folder / kind)
        found[f"{kind}: verify"] = printed("dataset", "verify", folder / kind)
        npz, built = folder / f"{kind}-npz", folder / f"{kind}-built"
        found[f"{kind}: export"] = printed("dataset", "export", folder / kind, "-o", npz, "--format", "npz")
        found[f"{kind}: values"] = {path.name: _values(path) for path in sorted(npz.rglob("*.npz"))}
        found[f"{kind}: build"] = printed("dataset", "build", folder / kind, "-o", built, "--seed", 3)
        found[f"{kind}: splits"] = json.loads((built / "splits.json").read_text(encoding="utf-8"))
    for card in sorted((folder / "model").glob("*.json")):
        found[f"model: {card.stem}"] = printed("models", card)
    plain: dict[str, Any] = json.loads(json.dumps(_plain(found)).replace(f"{folder}/", ""))
    return plain


def _require_refusal(recording: Path) -> None:
    """Check that a recording of foretouch 0.2 is refused by every command, with the version that converts it."""
    for words in (
        ["info", recording],
        ["verify", recording],
        ["repair", recording],
        ["import", recording, "-o", recording / "new"],
    ):
        with contextlib.redirect_stderr(io.StringIO()) as err:
            assert main(["dataset", *map(str, words)]) == 1
        assert "convert it with `foretouch dataset import OLD -o NEW` of version 0.3" in err.getvalue()


def printed(*words: object) -> list[dict[str, Any]]:
    """The JSON lines of a command that has to succeed."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        status = main([*map(str, words), "--json"])
    assert status == 0, f"{words}: exit status {status}"
    return [json.loads(line) for line in out.getvalue().splitlines()]


def _values(path: Path) -> dict[str, str]:
    with np.load(path, allow_pickle=False) as arrays:
        return {
            name: f"{a.dtype}{a.shape} {hashlib.sha256(a.tobytes()).hexdigest()[:16]}" for name, a in arrays.items()
        }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items() if key not in _CHANGING}
    return [_plain(item) for item in value] if isinstance(value, list) else value


if __name__ == "__main__":
    make(Path(sys.argv[1]))
