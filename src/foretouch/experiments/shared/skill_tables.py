# SPDX-License-Identifier: Apache-2.0
"""Tables of skills, and sentences on them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.rows import SIGNS, enumerated, grouped, listed, select, short, unique
from foretouch.experiments.shared.scores import ALL_OBJECTS
from foretouch.learning.evaluation.metrics import MEAN
from foretouch.tactile import MODALITIES

MODEL: Final = "contact"
"""The default model, which is shown by object if it was run."""

COLUMNS: Final = ("skill", *MODALITIES, MEAN)

_LEGEND: Final = (
    "skill: 0 is the mean of the training labels, 1 is perfect; [95 % interval by bootstrap over objects]; below it the object "
    "with the lowest skill"
)
_VERDICTS: Final = (
    "▲ significantly better, ▼ significantly worse, = no significant difference (95 % CI) from {references}; "
    "same grasps, paired bootstrap"
)
_ITSELF: Final = "·"


def findings(sentences: Sequence[str]) -> Table:
    """Sentences above the tables."""
    return Table("Findings", (), (), sentences)


def skill_tables(rows: Sequence[Row], notes: Sequence[str] = (), sentences: Sequence[str] = ()) -> list[Table]:
    """Sentences, and a table of skills for each `table` of the results, with a sign for each comparison."""
    references = compared_with(rows[0])
    tables = []
    for name, own in grouped(rows, "table"):
        together = select(own, object=ALL_OBJECTS)
        body = [
            [one, *(_cell(row, references) + _worst(select(own, predictor=one), row["modality"]) for row in shown)]
            for one, shown in grouped(together, "predictor")
        ]
        title = f"{name}: {together[0]['samples']} predictions on {together[0]['objects']} objects"
        tables.append(Table(title, COLUMNS, body))
    for name, own in grouped(select(rows, predictor=MODEL), "table"):
        single = [row for row in own if row["object"] != ALL_OBJECTS and row["skill"] is not None]
        body = [[one, *(short(row["skill"]) for row in shown)] for one, shown in grouped(single, "object")]
        tables += [Table(f"{name}: {MODEL}, by object", COLUMNS, body)] * bool(body)
    legend = [_LEGEND] + [_VERDICTS.format(references=", then from ".join(references))] * bool(references)
    tables[-1] = replace(tables[-1], notes=[*legend, *notes])
    return [findings([*skill_sentences(rows), *sentences]), *tables]


def compared_with(row: Row) -> list[str]:
    """References that a row is compared with."""
    return [name[3:-8] for name in row if name.startswith("vs_") and name.endswith("_verdict")]


def skill_sentences(rows: Sequence[Row], predictor: str = "") -> list[str]:
    """For each table the skills of a predictor, the model or else the last one, beside each reference's."""
    sentences = []
    for name, own in grouped(select(rows, object=ALL_OBJECTS), "table"):
        predictors = unique(own, "predictor")
        shown = predictor or (MODEL if MODEL in predictors else predictors[-1])
        chosen = select(own, predictor=shown)
        text = f"{name}: `{shown}` has skills of {listed(chosen[: len(MODALITIES)], 'skill')} ({', '.join(MODALITIES)})"
        parts = [verdict_text(chosen, f"vs_{other}", other) for other in compared_with(own[0]) if other != shown]
        sentences.append("; ".join([text, *filter(None, parts)]))
    return sentences


def verdict_text(rows: Sequence[Row], column: str, other: str) -> str:
    """Where the skill is significantly better and worse than another one's; empty without comparison."""
    parts = []
    for verdict in ("better", "worse"):
        chosen = [row["modality"] for row in rows if row[f"{column}_verdict"] == verdict]
        names = ["the mean" if name == MEAN else name for name in chosen]
        if names:
            parts.append(f"significantly {verdict} than `{other}` in {enumerated(names)}")
    if not parts and any(row[f"{column}_verdict"] == "tie" for row in rows):
        return f"not significantly different from `{other}`"
    return ", ".join(parts)


def _worst(rows: Sequence[Row], modality: str) -> str:
    """The object with the lowest skill and that skill; empty for the mean, a single object, and where all are equal."""
    single = [row for row in select(rows, modality=modality) if row["object"] != ALL_OBJECTS]
    found = [(row["skill"], row["object"]) for row in single if row["skill"] is not None]
    if modality == MEAN or len({skill for skill, _ in found}) < 2:
        return ""
    skill, name = min(found)
    return f"\n{name} {short(skill)}"


def _cell(row: Row, references: Sequence[str]) -> str:
    signs = "".join(SIGNS.get(row[f"vs_{name}_verdict"] or "", _ITSELF) for name in references)
    text = f"{short(row['skill'])} {signs.strip(_ITSELF) and signs}".rstrip()
    if row["skill_low"] is not None and row["modality"] != MEAN and row["skill_low"] != row["skill_high"]:
        text += f"\n[{short(row['skill_low'])}, {short(row['skill_high'])}]"
    return text
