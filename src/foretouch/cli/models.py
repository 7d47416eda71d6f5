# SPDX-License-Identifier: Apache-2.0
"""`foretouch models`: list touch models with their skill, coverage and limits, and verify their files."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foretouch.base.files import file_sha256
from foretouch.cli.inputs import add_options
from foretouch.cli.output import print_json, print_table, print_text
from foretouch.cli.parser import CommandParser
from foretouch.errors import ModelError
from foretouch.models.card import OWN, read_card
from foretouch.models.registry import available_models, find_cards, load_model

_SPLITS = ("random", "time", "object")


def add_arguments(parser: CommandParser) -> None:
    """Declare names or paths of models; by default all of the package."""
    parser.add_argument(
        "models",
        metavar="MODEL",
        nargs="*",
        help="names, or paths of cards, weights or model folders (default: the models of the package)",
    )
    add_options(parser, "--predictor")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; the exit status is 1 if a model is missing, damaged, or needs --predictor."""
    records = [_record(name, arguments.predictor) for name in arguments.models or available_models()]
    if arguments.json:
        for record in records:
            print_json(record)
    else:
        _show(records, in_full=bool(arguments.models))
    return int(any(record["status"] != "ok" for record in records))


def _record(name: str, predictor: str | None) -> dict[str, Any]:
    """Return the JSON object of one model; loading it compares every file with its hash in the card."""
    status = "missing"
    try:
        paths, status = find_cards(name), "damaged"
        if predictor is None and read_card(paths[0])["kind"] == OWN:
            status = "needs --predictor"
        model = load_model(name, predictor)
    except ModelError as err:
        return {"status": status, "name": name, "reason": str(err)}
    card = model.card
    names = (card["weights"], (card["calibration"] or {}).get("weights"))
    files = [] if model.path is None else [model.path.with_name(Path(name).name) for name in names if name]
    skills = {split: _mean(name, "skill") for split, name in card.get("skill", {}).items()}
    return {
        "status": "ok",
        "name": model.name,
        "kind": card["kind"],
        "sha256": model.sha256,
        "bytes": sum(file.stat().st_size for file in files),
        "files": {file.name: {"sha256": file_sha256(file), "bytes": file.stat().st_size} for file in files},
        "skill": {split: mean for split, mean in skills.items() if mean is not None},
        "calibration": _calibration(card),
        "card": card,
    }


def _mean(scores: Mapping[str, Mapping[str, Any]], name: str) -> float | None:
    """Return the mean of a number over the modalities that have it."""
    values = [score[name] for score in scores.values() if score.get(name) is not None]
    return sum(values) / len(values) if values else None


def _calibration(card: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the calibration of the intervals; None without intervals.

    Returns:
        `level`: nominal coverage. `objects`: how many objects, or shapes, the intervals of unfamiliar objects were
        calibrated on. `left_out`: which of the two. `promise`: the highest coverage that conformal intervals guarantee
        for one more, whatever the distribution [Vovk et al. 2005]. `regimes`: by group, the `coverage` of held-out
        ones, mean over the modalities.
    """
    facts = card.get("calibration")
    if facts is None:
        return None
    groups = {
        name: {key: regime.get(key) for key in ("objects", "samples")}
        | {"coverage": _mean(regime.get("coverage", {}), "mean")}
        for name, regime in facts.get("regimes", {}).items()
    }
    objects = groups.get("new", {}).get("objects") or 0
    stated = {"level": facts.get("level"), "objects": objects, "left_out": facts.get("left_out", "objects")}
    return {**stated, "promise": objects / (objects + 1), "regimes": groups}


def _show(records: list[dict[str, Any]], *, in_full: bool) -> None:
    """Print a table of models, and below it what is wrong with damaged ones, and in full the limits of the others."""
    print_table(
        "Touch models: skill on held-out samples by split (0: the mean of the training readings, 1: perfect), coverage of 90 % intervals",
        ["model", "kind", "files", "kB", *_SPLITS, "coverage"],
        [_row(record) for record in records],
    )
    for record in records:
        if record["status"] != "ok":
            print_text(record["reason"])  # which names the file
        elif in_full:
            for line in _notes(record):
                print_text(f"{record['name']}: {line}" if len(records) > 1 else f"- {line}")
    if not in_full:
        print_text("What each is good for and its limits: foretouch models NAME")


def _row(record: Mapping[str, Any]) -> list[str]:
    """Return name, kind, files, size, skills and coverage of held-out objects; empty for a damaged model."""
    if record["status"] != "ok":
        return [record["name"], record["status"], *[""] * 6]
    skills = [f"{record['skill'][name]:+.2f}" if name in record["skill"] else "–" for name in _SPLITS]
    coverage = "no intervals"
    if record["calibration"] is not None:
        shares = {name: regime["coverage"] for name, regime in record["calibration"]["regimes"].items()}
        known = [f"{name} {share:.2f}" for name, share in shares.items() if share is not None]
        coverage = "\n".join(known) or "not measured"
    return [record["name"], record["kind"], "ok", f"{record['bytes'] / 1000:.0f}", *skills, coverage]


def _notes(record: Mapping[str, Any]) -> list[str]:
    """Return summary, guarantee of the intervals and limits of a model."""
    notes, calibration = [str(record["card"].get("summary", ""))], record["calibration"]
    if calibration is not None:
        count = f"{calibration['objects']} {calibration['left_out']}"
        note = f"{calibration['level']:.0%} intervals, calibrated on {count}: "
        note += f"the guaranteed coverage of one more is at most {calibration['promise']:.0%}"
        recorded = record["card"]["calibration"].get("rest") == "recorded tares"
        notes.append(note if recorded else f"{note}; not calibrated for predictions with a tare")
    if not record["skill"]:
        measure = "`foretouch train` with release=true or split=NAME measures them; or ask `foretouch evaluate`"
        notes.append(f"the card holds no skills: {measure}")
    return [note for note in [*notes, *map(str, record["card"].get("limits", []))] if note]
