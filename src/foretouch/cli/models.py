# SPDX-License-Identifier: Apache-2.0
"""`foretouch models`: the touch models at hand, each file verified against its card, and what each card promises."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foretouch.cli.output import print_json, print_table
from foretouch.errors import ModelError

__all__ = ["add_arguments", "model_files", "run"]

_SPLITS = ("random", "time", "object")
_MEAN = "mean"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Names or paths; all shipped models by default."""
    parser.add_argument(
        "models", metavar="MODEL", nargs="*", help="names or paths of checkpoints (default: all shipped)"
    )
    parser.add_argument(
        "--json", action="store_true", help="one JSON object a model: files, skill, calibration and its whole card"
    )


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a model is damaged."""
    from foretouch.models import available_models

    records = [_record(name) for name in arguments.models or available_models()]
    if arguments.json:
        for record in records:
            print_json(record)
    else:
        _show(records)
    return int(any(record["status"] != "ok" for record in records))


def model_files(card_path: Path) -> list[Path]:
    """The files of a model besides its card: weights, calibration, and those of an ensemble's members with their cards.

    Raises:
        ModelError: If a card cannot be read.
    """
    from foretouch.models.card import read_card

    card = read_card(card_path)
    files: list[Path] = []
    for member in card.get("members", []):
        path = card_path.with_name(Path(str(member)).name)
        files += [path, *model_files(path)]
    named = [card.get("weights"), (card.get("calibration") or {}).get("weights")]
    return files + [card_path.with_name(Path(str(name)).name) for name in named if name]


def _record(name: str) -> dict[str, Any]:
    """What is told of one model; loading it compares every file with the hash that its card names."""
    from foretouch.models import load_model
    from foretouch.models.files import file_sha256
    from foretouch.models.registry import find_card

    try:
        model = load_model(name)
        files = model_files(find_card(name))
        hashes = {path.name: {"sha256": file_sha256(path), "bytes": path.stat().st_size} for path in files}
    except ModelError as err:
        return {"status": "damaged", "name": name, "reason": str(err)}
    card = model.card
    return {
        "status": "ok",
        "name": model.name,
        "kind": card["kind"],
        "sha256": model.sha256,
        "bytes": sum(one["bytes"] for one in hashes.values()),
        "files": hashes,
        "skill": _skills(card),
        "calibration": _calibration(card),
        "card": card,
    }


def _skills(card: Mapping[str, Any]) -> dict[str, float]:
    """Mean skill over the modalities by split: 0 is the training mean, 1 is perfect."""
    found = {}
    for split, scores in card.get("skill", {}).items():
        values = [score["skill"] for score in scores.values() if "skill" in score]
        if values:
            found[split] = sum(values) / len(values)
    return found


def _calibration(card: Mapping[str, Any]) -> dict[str, Any] | None:
    """What the intervals are calibrated to; None without intervals.

    Returns:
        `level` that was asked for, number of `objects`, `promise`: the most that conformal intervals can promise for one
        more object, whatever their distribution [Vovk et al. 2005], and by regime the `coverage` of objects left out, mean
        over the modalities.
    """
    facts = card.get("calibration")
    if facts is None:
        return None
    regimes = {}
    for name, regime in facts.get("regimes", {}).items():
        coverage = [shares[_MEAN] for shares in regime.get("coverage", {}).values() if _MEAN in shares]
        mean = sum(coverage) / len(coverage) if coverage else None
        regimes[name] = {"objects": regime.get("objects"), "samples": regime.get("samples"), "coverage": mean}
    objects = max((one["objects"] or 0 for one in regimes.values()), default=0)
    return {"level": facts.get("level"), "objects": objects, "promise": objects / (objects + 1), "regimes": regimes}


def _show(records: list[dict[str, Any]]) -> None:
    rows = []
    for record in records:
        if record["status"] != "ok":
            rows.append([record["name"], record["status"], *[""] * 6])
            continue
        skills = [f"{record['skill'][name]:+.2f}" if name in record["skill"] else "–" for name in _SPLITS]
        kilobytes = f"{record['bytes'] / 1000:.0f}"
        rows.append([record["name"], record["kind"], "ok", kilobytes, *skills, _coverages(record["calibration"])])
    columns = ["name", "kind", "files", "kB", *_SPLITS, "coverage"]
    title = "touch models; skill by split: 0 is the training mean, 1 is perfect; coverage of objects left out"
    print_table(title, columns, rows)
    for record in records:
        if record["status"] != "ok":
            print(record["reason"])  # which names the file
            continue
        for line in _lines(record):
            print(f"{record['name']}: {line}")


def _coverages(calibration: Mapping[str, Any] | None) -> str:
    """Of objects left out of the calibration, a line a regime."""
    if calibration is None:
        return "no intervals"
    known = {name: one["coverage"] for name, one in calibration["regimes"].items() if one["coverage"] is not None}
    return "\n".join(f"{name} {share:.2f}" for name, share in known.items()) or "not told"


def _lines(record: Mapping[str, Any]) -> list[str]:
    """What the table has no room for: summary, promise of the intervals and limits of a sound model."""
    lines = [str(record["card"].get("summary", ""))]
    calibration = record["calibration"]
    if calibration is not None:
        told = f"intervals of {calibration['level']:.0%}, calibrated on {calibration['objects']} objects, "
        told += f"which can promise {calibration['promise']:.0%} for one more"
        lines.append(told if "known_tare" in calibration["regimes"] else f"{told}; not calibrated for a tare")
    return [line for line in [*lines, *map(str, record["card"].get("limits", []))] if line]
