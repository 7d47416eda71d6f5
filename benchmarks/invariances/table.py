# SPDX-License-Identifier: Apache-2.0
"""The table of the README and the picture, from results.csv alone."""

import csv
from pathlib import Path

import numpy as np

BEGIN, END = "<!-- table: written by bench.py -->", "<!-- end of the table -->"
VERDICTS = {"exact": 0, "bounded": 1, "refused": 2, "jumps": 3}
COLOURS = ("#2b7a4b", "#b7dd9c", "#c9c9d6", "#e08b5a")


def verdict(row: dict[str, str]) -> str:
    """One of `VERDICTS` for a row of the CSV."""
    if int(row["over"]):
        return "jumps"
    if int(row["refused"]) == int(row["n"]):
        return "refused"
    return "exact" if float(row["largest"]) == 0.0 else "bounded"


def text(row: dict[str, str]) -> str:
    """The cell of the table."""
    answered = int(row["n"]) - int(row["refused"])
    refused = f"; {row['refused']} of {row['n']} refused" if int(row["refused"]) else ""
    return {
        "exact": f"exact{refused}",
        "bounded": f"≤ {row['largest']}{refused}",
        "refused": "refused",
        "jumps": f"**{100 * int(row['over']) / max(answered, 1):.0f} %** > {row['limit']}, ≤ {row['largest']}{refused}",
    }[verdict(row)]


def write_table(folder: Path, steps: list[str], changes: list[str]) -> None:
    """Replace the table in README.md, and draw invariances.png."""
    with (folder / "results.csv").open(encoding="utf-8") as file:
        found = {(row["step"], row["change"]): row for row in csv.DictReader(file)}
    units = {step: row["unit"] for (step, _), row in found.items()}
    lines = ["| change | " + " | ".join(f"{step} [{units[step]}]" for step in steps) + " |"]
    lines.append("|---" * (len(steps) + 1) + "|")
    for change in changes:
        cells = [text(found[step, change]) if (step, change) in found else "–" for step in steps]
        lines.append(f"| {change} | " + " | ".join(cells) + " |")
    readme = folder / "README.md"
    head, rest = readme.read_text(encoding="utf-8").split(BEGIN)
    readme.write_text(head + BEGIN + "\n" + "\n".join(lines) + "\n" + END + rest.split(END)[1], encoding="utf-8")
    _draw(folder / "invariances.png", found, steps, changes)


def _draw(path: Path, found: dict[tuple[str, str], dict[str, str]], steps: list[str], changes: list[str]) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    grid = np.full((len(steps), len(changes)), np.nan)
    figure, axes = plt.subplots(figsize=(11, 5.6), layout="constrained")
    for i, step in enumerate(steps):
        for j, change in enumerate(changes):
            row = found.get((step, change))
            if row is None:
                continue
            grid[i, j] = VERDICTS[verdict(row)]
            answered = max(int(row["n"]) - int(row["refused"]), 1)
            jumps = f"{100 * int(row['over']) / answered:.0f} %"
            axes.text(j, i, jumps if int(row["over"]) else row["largest"], ha="center", va="center", fontsize=7)
    axes.imshow(grid, cmap=ListedColormap(COLOURS), vmin=-0.5, vmax=3.5, aspect="auto")
    axes.set_xticks(range(len(changes)), changes, rotation=40, ha="right")
    axes.set_yticks(range(len(steps)), [f"{step} [{found_unit(found, step)}]" for step in steps], fontsize=8)
    names = ("exact", "bounded: largest difference", "refused by name", "jumps: share beyond the limit")
    handles = [Patch(color=colour, label=name) for colour, name in zip(COLOURS, names, strict=True)]
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False)
    figure.savefig(path, dpi=90)


def found_unit(found: dict[tuple[str, str], dict[str, str]], step: str) -> str:
    """The unit of a step."""
    return next(row["unit"] for (name, _), row in found.items() if name == step)
