# SPDX-License-Identifier: Apache-2.0
"""`foretouch models`: the touch models at hand, each verified against its card."""

from __future__ import annotations

import argparse

from foretouch.cli.output import print_json, print_table
from foretouch.errors import ModelError

__all__ = ["add_arguments", "run"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Names or paths; all shipped models by default."""
    parser.add_argument(
        "models", metavar="MODEL", nargs="*", help="names or paths of checkpoints (default: all shipped)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object a model: its card")


def run(arguments: argparse.Namespace) -> int:
    """Exit status 1 if a model is damaged."""
    from foretouch.models import available_models, load_model

    failed = False
    rows = []
    for name in arguments.models or available_models():
        try:
            model = load_model(name)
        except ModelError as err:
            failed = True
            record = {"name": name, "status": "damaged", "reason": str(err)}
            rows.append([name, "damaged", "", str(err)])
        else:
            record = {"status": "ok", "name": model.name, "sha256": model.sha256, "card": model.card}
            rows.append([model.name, "ok", model.sha256[:12], _summary(model.card)])
        if arguments.json:
            print_json(record)
    if not arguments.json:
        print_table("touch models", ["name", "state", "sha256", "card"], rows)
    return int(failed)


def _summary(card: dict[str, object]) -> str:
    return str(card.get("summary", ""))
