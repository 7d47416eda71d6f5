# SPDX-License-Identifier: Apache-2.0
"""What the pages state about results, held against the committed tables.

Each row of `CLAIMS` is a file, a quoted phrase and what its gaps hold by the tables, or a condition on them. A phrase must
be in the file with its gaps filled, so a change of the text or of a table without the other fails. Every sentence of the
main pages with a skill or a comparison must be quoted here.
"""

import csv
import json
import re
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foretouch.experiments import find_experiment
from foretouch.tactile import MODALITIES

ROOT = Path(__file__).parents[1]
RESULTS = "docs/results/README.md"
MEAN = "mean"
STATED = re.compile(
    r"\b(better|worse|tie|significant\w*)\b|(?<![\w.])[−-]?0?\.\d\d?\b(?! (s|ms|MB|h|mm|m|GB)\b)",
    re.ASCII | re.IGNORECASE,
)


@cache
def table(folder: str) -> list[dict[str, str]]:
    with (ROOT / "docs" / "results" / folder / "results.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def rows(folder: str, **wanted: Any) -> list[dict[str, str]]:
    """Rows of a table, of all objects together unless an object is asked for."""
    wanted = {"object": "all", **wanted} if "object" in table(folder)[0] else wanted
    wanted = {name: value for name, value in wanted.items() if value is not ...}
    found = [row for row in table(folder) if all(row[name] == str(value) for name, value in wanted.items())]
    assert found, (folder, wanted)
    return found


def numbers(folder: str, column: str = "skill", **wanted: Any) -> list[float]:
    """Of the four modalities, or of the one that is asked for; those of several rows one after the other."""
    kept = MODALITIES if "modality" not in wanted else (wanted["modality"],)
    return [float(row[column]) for row in rows(folder, **wanted) if row["modality"] in kept and row[column]]


def short(value: float, decimals: int = 2) -> str:
    """As the pages write numbers: .05, -.23, 1.03, 0."""
    if value == 0.0:
        return "0"
    text = f"{value:.{decimals}f}" if abs(value) < 0.9995 or decimals != 2 or value > 0 else f"{value:.1f}"
    return text.replace("0.", ".", 1) if text.startswith(("0.", "-0.")) else text


def four(folder: str, column: str = "skill", joint: str = " ", **wanted: Any) -> str:
    return joint.join(short(value) for value in numbers(folder, column, **wanted))


def worst(folder: str, **wanted: Any) -> str:
    """Of each modality the lowest skill of an object."""
    per_object = [row for row in table(folder) if row["object"] != "all"]
    chosen = [row for row in per_object if all(row[name] == str(value) for name, value in wanted.items())]
    values = [min(float(row["skill"]) for row in chosen if row["modality"] == name) for name in MODALITIES]
    return " ".join(short(value, 1) if value < -1.0 else short(value) for value in values)


def verdicts(folder: str, versus: str, **wanted: Any) -> dict[str, str]:
    """By modality, and of their mean where it is compared: better, worse or tie."""
    return {row["modality"]: row[f"vs_{versus}_verdict"] for row in rows(folder, **wanted)}


def only(found: dict[str, str], verdict: str, *names: str) -> bool:
    """Whether exactly these have a verdict, and all others are a tie."""
    return all(value == (verdict if name in names else "tie") for name, value in found.items())


def skill_of_mean(folder: str, **wanted: Any) -> float:
    return float(np.mean(numbers(folder, **wanted)))


def ends(values: Iterable[float], decimals: int = 2) -> str:
    values = list(values)
    return f"{short(min(values), decimals)} to {short(max(values), decimals)}"


def prequential(label: str, method: str, folder: str = "prequential", sight: str = "contact") -> str:
    return four(folder, sight=sight, method=method, bin=label)


def bins(method: str) -> str:
    return " | ".join(prequential(label, method) for label in ("none", "first 3", "3-9", "10+"))


def means(folder: str, column: str = "skill", **wanted: Any) -> float:
    return round(float(np.mean(numbers(folder, column, **wanted))), 10)


def card(name: str) -> dict[str, Any]:
    return json.loads((ROOT / "src/foretouch/models/weights" / f"{name}.json").read_text())


_TABLES = ("no touch", "after 1 touch", "after 3 touches", "after 5 touches", "told which")
_GROUNDS = ("simulated new objects, no", "random folds", "blocks of time", "real, new objects, no")
_LEANED = "simulated new objects: what is leaned on"

CLAIMS: Sequence[tuple[str, str, Callable[[], Sequence[str] | bool]]] = [
    # The front page.
    *(
        ("README.md", f"`{name}`{{}} | {{}} | {{}} | {{}} | {{}} ms | {{}} ms |", lambda name=name: _front_row(name))
        for name in ("contact-v2", "contact-v1", "touchnet-v1")
    ),
    (
        "README.md",
        "in which the four separate networks of the papers took {} ms for one grasp",
        lambda: ["{:.0f}".format(float(_timed("papers' four networks", 1)["cpu_ms"]))],
    ),
    (
        "README.md",
        "On held-out objects, without a touch, no model differs significantly from the mean of the labels",
        lambda: all(
            only(verdicts(folder, "training_mean", touches=0, predictor=name), "better")
            for folder, name in (
                ("unseen_object_v2", "contact"),
                ("unseen_object", "contact_v1"),
                ("unseen_object", "touchnet_v1"),
            )
        ),
    ),
    (
        "README.md",
        "the electrodes of the first three grasps on an object have skills of {} and {}, and {} and {} before its first touch",
        lambda: [part for label in ("first 3", "none") for part in prequential(label, "tracker").split()[2:]],
    ),
    ("README.md", "a clock alone has {} there", lambda: [four("unseen_object_v2", touches=0, predictor="clock")]),
    # What a robot at work sees.
    (RESULTS, "| `contact-v2` with the tracker of the sensors' state | {} |", lambda: [bins("tracker")]),
    (RESULTS, "| the same with the memory of one object alone | {} |", lambda: [bins("memory")]),
    (RESULTS, "| a clock (mean of the last day's readings) | {} |", lambda: [bins("clock")]),
    (RESULTS, "| mean of the object so far | {} |", lambda: [bins("object mean")]),
    (
        RESULTS,
        "With eight objects almost no difference between the methods is significant",
        lambda: (
            np.mean(
                [
                    row["vs_memory_verdict"] == "tie"
                    for row in rows("prequential", sight="contact", method="tracker", bin="first 3")
                ]
            )
            == 1
        ),
    ),
    (
        RESULTS,
        "The 90 % intervals cover {}, of each object from its fourth grasp at least {}, and after a jump of all values by 100 counts {} on average ({} for the worst object)",
        lambda: [
            four("prequential", "coverage", sight="contact", method="tracker", bin="all"),
            short(min(_by_object("contact", "4th on"))),
            short(float(np.mean(_by_object("contact", "after jump")))),
            short(min(_by_object("contact", "after jump"))),
        ],
    ),
    (
        RESULTS,
        "They are {} times as wide as those of the memory at equal coverage",
        lambda: [four("prequential", "width_at_equal_coverage", sight="contact", method="tracker", bin="all")],
    ),
    (
        RESULTS,
        "With a strictly past mean as sight, the first three grasps have {}",
        lambda: [prequential("first 3", "tracker", sight="past_mean")],
    ),
    *(
        (RESULTS, f"| {words} | {method} | {{}} |", lambda folder=folder, name=name: [_campaign(folder, name)])
        for folder, first in (
            ("prequential_campaign", "[no tare](prequential_campaign/summary.md)"),
            ("prequential_campaign_tare", "[a tare before each grasp](prequential_campaign_tare/summary.md)"),
        )
        for words, method, name in ((first, "tracker", "tracker"), ("", "memory of one object", "memory"))
    ),
    (
        RESULTS,
        "In the first three grasps the tracker is significantly better than the memory in PDC_TH, E_TH and E_MF without a tare, and in E_TH and E_MF with one;",
        lambda: (
            only(_versus_memory("prequential_campaign"), "better", "PDC_TH", "E_TH", "E_MF")
            and only(_versus_memory("prequential_campaign_tare"), "better", "E_TH", "E_MF")
        ),
    ),
    # contact-v2 beside contact-v1.
    (
        RESULTS,
        "| [unseen_object_both](unseen_object_both/summary.md), no touch | {}, worst object {} | {}, worst object {} | not significant |",
        lambda: (
            [
                text
                for name in ("contact", "contact_v1")
                for text in (four("unseen_object_both", predictor=name), worst("unseen_object_both", predictor=name))
            ]
            if only(verdicts("unseen_object_both", "contact_v1", predictor="contact"), "better")
            else []
        ),
    ),
    *(
        (
            RESULTS,
            f"{words} | {{}} | {{}} | not compared in pairs |",
            lambda touches=touches: [
                four("unseen_object_v2", touches=touches, predictor="contact"),
                four("unseen_object", touches=touches, predictor="contact_v1"),
            ],
        )
        for words, touches in (
            ("| [unseen_object_v2](unseen_object_v2/summary.md), 1 touch", 1),
            ("| the same, 3 touches", 3),
        )
    ),
    (
        RESULTS,
        "| [time_blocked_v2](time_blocked_v2/summary.md) | {} | {} | significantly lower in E_MF |",
        lambda: (
            [four("time_blocked_v2", predictor=name) for name in ("contact", "contact_v1")]
            if only(verdicts("time_blocked_v2", "contact_v1", predictor="contact"), "worse", "E_MF")
            else []
        ),
    ),
    (
        RESULTS,
        "| [cross_validation_v2](cross_validation_v2/summary.md) | {} | {} | significantly lower in E_TH, E_MF and the mean |",
        lambda: (
            [four("cross_validation_v2", predictor=name) for name in ("contact", "contact_v1")]
            if only(verdicts("cross_validation_v2", "contact_v1", predictor="contact"), "worse", "E_TH", "E_MF", MEAN)
            else []
        ),
    ),
    (
        RESULTS,
        "A clock alone has a skill of {} in E_TH on new objects, more than any model.",
        lambda: (
            [four("unseen_object_both", predictor="clock", modality="E_TH")]
            if numbers("unseen_object_both", predictor="clock", modality="E_TH")
            > max(numbers("unseen_object_both", predictor=name, modality="E_TH") for name in ("contact", "contact_v1"))
            else []
        ),
    ),
    # Real grasps.
    (
        RESULTS,
        "the default model, reaches skills of {}. Most of that comes from knowing the object: the mean of the object reaches {}.",
        lambda: [ends(numbers("cross_validation", predictor=name)) for name in ("contact_v1", "object_mean")],
    ),
    (
        RESULTS,
        "The skill of `contact` is above that of the trees on geometry in all four modalities; the difference is significant for the mean of the modalities, but not for any single one",
        lambda: (
            only(verdicts("cross_validation", "geometry_trees", predictor="contact_v1"), "better", MEAN)
            and min(numbers("cross_validation", "vs_geometry_trees", predictor="contact_v1")) > 0
        ),
    ),
    (
        RESULTS,
        "P1's network, trained by its public recipe, has five to ten times the error of the mean",
        lambda: (
            min(_over_mean("cross_validation", "p1_pointnet")) > 4.5
            and max(_over_mean("cross_validation", "p1_pointnet")) < 10.5
        ),
    ),
    (
        RESULTS,
        "P2's network reaches {}, which is below the trees in all four modalities",
        lambda: (
            [four("cross_validation", predictor="p2_pointnet").replace("-", "−")]
            if max(numbers("cross_validation", "vs_geometry_trees", predictor="p2_pointnet")) < 0
            else []
        ),
    ),
    (
        RESULTS,
        "`contact` reaches {} and does not differ significantly from the trees in any modality (three of its skills are higher)",
        lambda: (
            [ends(numbers("time_blocked", predictor="contact_v1"))]
            if only(verdicts("time_blocked", "geometry_trees", predictor="contact_v1"), "better")
            and sum(value > 0 for value in numbers("time_blocked", "vs_geometry_trees", predictor="contact_v1")) == 3
            else []
        ),
    ),
    (
        RESULTS,
        "No predictor is shown to be better than the mean of the object",
        lambda: all(
            float(row["skill_low"]) <= numbers("time_blocked", predictor="object_mean", modality=row["modality"])[0]
            for row in rows("time_blocked")
            if row["modality"] in MODALITIES
        ),
    ),
    (
        RESULTS,
        "P1's published errors are {} times those of predicting the mean of the training labels, in every table and modality",
        lambda: [ends(_published_over_mean(), 1)],
    ),
    (
        RESULTS,
        "From cylinders to boxes and back, no predictor is better than that mean",
        lambda: all(
            float(row["skill"]) <= 0 or float(row["skill_low"] or 0) <= 0
            for row in rows("cross_type", table="across types")
            if row["skill"]
        ),
    ),
    (
        RESULTS,
        "`contact` does not differ significantly (95 % CI) from the mean in any modality; its mean skill is {}. A clock has {} on the same folds ([unseen_object_v2](unseen_object_v2/summary.md)) and {} after three touches. After three touches `contact` reaches {}",
        lambda: (
            [
                short(skill_of_mean("unseen_object", touches=0, predictor="contact_v1")),
                *(four("unseen_object_v2", touches=touches, predictor="clock") for touches in (0, 3)),
                ends(numbers("unseen_object", touches=3, predictor="contact_v1")),
            ]
            if only(verdicts("unseen_object", "training_mean", touches=0, predictor="contact_v1"), "better")
            else []
        ),
    ),
    (
        RESULTS,
        "significantly better than the trees with offset correction in two modalities (PDC_MF, E_TH) and not significantly different in the others",
        lambda: (
            {
                name
                for name, verdict in verdicts(
                    "unseen_object", "geometry_trees", touches=3, predictor="contact_v1"
                ).items()
                if verdict == "better" and name in MODALITIES
            }
            == {"PDC_MF", "E_TH"}
        ),
    ),
    (
        RESULTS,
        "Compared with the mean with offset correction, it is significantly better for the mean of the modalities, but not for any single one",
        lambda: only(verdicts("unseen_object", "training_mean", touches=3, predictor="contact_v1"), "better", MEAN),
    ),
    (
        RESULTS,
        "On 71 simulated objects that were never touched, coverage is {}, with or without a tare, after zero to five touches",
        lambda: [ends(numbers("coverage", "coverage", ground="simulated"))],
    ),
    (
        RESULTS,
        "On the eight real objects, each left out in turn, it is {} on average, but {} for one of them in PDC_TH",
        lambda: [
            ends(numbers("coverage", "coverage", ground="left out")),
            short(min(numbers("coverage", "coverage", ground="left out", object=..., modality="PDC_TH"))),
        ],
    ),
    (
        RESULTS,
        "In later blocks of time it is {}, so the intervals are wider than needed",
        lambda: [short(float(np.mean(numbers("coverage", "coverage", ground="time blocks"))))],
    ),
    (
        RESULTS,
        "Known objects, with 5, 10, 20 and 40 training grasps of each: mean skill {}. New objects, with 2, 4 and 7 training objects: {}. Simulated new objects, with 5 to 80 training objects: {};",
        lambda: [_curve("known objects"), _curve("new objects"), _curve("simulated new objects")],
    ),
    (
        RESULTS,
        "On simulated new objects a tare raises the mean skill from {} to {}, three touches raise it to {}, and both to {}",
        lambda: [
            short(skill_of_mean("ablation", table=_LEANED, predictor=name))
            for name in ("nothing", "tare", "3 touches", "tare + 3 touches")
        ],
    ),
    (
        RESULTS,
        "The forests matter for known objects (the kernel alone loses {}) and the kernel for new ones (the forests alone lose {} in simulation; {} on the real objects, which is not significant)",
        lambda: (
            [
                ends(-_lost("kernel alone", ground)[0] for ground in ("random folds", "blocks of time")),
                short(-_lost("forests alone", "simulated")[0]),
                short(-_lost("forests alone", "real, new objects")[0]),
            ]
            if _lost("forests alone", "real, new objects")[1] == "tie"
            else []
        ),
    ),
    (
        RESULTS,
        "Plain geometric features instead of those at the contacts lose {}, which is not significant on new real objects only",
        lambda: (
            [ends(-_lost("geometry_features only", ground)[0] for ground in _GROUNDS)]
            if [_lost("geometry_features only", ground)[1] for ground in _GROUNDS] == ["worse", "worse", "worse", "tie"]
            else []
        ),
    ),
    (
        RESULTS,
        "using predicted differences without shrinking them (`no worth`) loses {} on the real objects",
        lambda: [short(-_lost("no worth", "real, new objects, 3 touches")[0])],
    ),
    (
        RESULTS,
        "The correlation of errors between values (`B`) adds {}, which is not significant",
        lambda: (
            [short(-_lost("diagonal B", "tare and 3 touches")[0])]
            if {_lost("diagonal B", ground)[1] for ground in ("tare and 3 touches", "real, new objects, 3")} == {"tie"}
            else []
        ),
    ),
    (
        RESULTS,
        "it is significantly better in 16 cells and not significantly different in 4, with an error that is 3 to 4 % lower at T90",
        lambda: (
            sorted(row["verdict"] for row in rows("label_ratio")) == ["tie"] * 4 + ["win"] * 16
            and all(-4.0 < float(row["change"]) < -2.5 for row in rows("label_ratio", ratio=90))
        ),
    ),
    (
        RESULTS,
        "Trees without any unlabelled sample have lower errors than both networks",
        lambda: all(
            float(row["trees_rmse"]) < min(float(row["srgan_rmse"]), float(row["pointnet_rmse"]))
            for row in rows("label_ratio")
        ),
    ),
    (
        RESULTS,
        "`contact` reaches {} of that in every modality",
        lambda: [short(min(numbers("noise_ceiling", "share", name="contact")))],
    ),
    (
        RESULTS,
        "`contact` is significantly better than the mean with offset correction in all four modalities",
        lambda: all(
            verdict == "better"
            for touches in (1, 3, 5)
            for verdict in verdicts(
                "lookalikes", "training_mean", kind="all", touches=touches, predictor="contact"
            ).values()
        ),
    ),
    (
        RESULTS,
        "no predictor that was trained on simulated grasps is significantly better on the real ones",
        lambda: (
            not any(
                row["vs_training_mean_verdict"] == "better"
                for folder in ("sim_to_real", "sim_to_real_unseen_objects")
                for row in rows(folder)
                if row["predictor"].startswith("simulated")
            )
        ),
    ),
    (
        RESULTS,
        "Its errors in `cross_validation` are 2.2 to 4.4 times those that P1 published, over the same divisors ({},",
        lambda: [
            " / ".join(
                short(numbers("cross_validation", "nrmse_p1", predictor="p1_pointnet", modality=name)[0], 3)
                for name in MODALITIES
            )
        ],
    ),
    (
        RESULTS,
        "has 1.2 times the error of the mean in E_MF",
        lambda: round(_over_mean("cross_validation", "p2_pointnet")[3], 1) == 1.2,
    ),
    # The other pages.
    *(
        (
            "docs/results/sim_to_real/README.md",
            f"| {words} | {{}} | {{}} |",
            lambda folder=folder, name=name: [
                four(folder, joint=" / ", touches=touches, predictor=name) for touches in (0, 3)
            ],
        )
        for words, folder, name in (
            ("training mean, with offset correction after touches", "sim_to_real", "training_mean"),
            (
                "clock (readings of other objects, earlier and later), with offset correction: [unseen_object_v2](../unseen_object_v2/summary.md)",
                "unseen_object_v2",
                "clock",
            ),
            ("real trees", "sim_to_real", "geometry_trees"),
            ("simulated, offset", "sim_to_real", "simulated_offset"),
            ("simulated, scaled", "sim_to_real", "simulated_scaled"),
            ("simulated and real", "sim_to_real", "simulated_and_real"),
            ("`contact`, real grasps alone", "sim_to_real", "contact"),
        )
    ),
    *(
        (
            "docs/results/lookalikes/README.md",
            f"| {words} | {{}} |",
            lambda name=name: [
                " | ".join(
                    four("lookalikes", joint=" / ", kind="all", table=table, predictor=name) for table in _TABLES
                )
            ],
        )
        for words, name in (
            ("mean of both, with offset correction after touches", "training_mean"),
            ("trees on geometry, with offset correction", "geometry_trees"),
            ("**`contact`**", "contact"),
        )
    ),
    *(
        (
            f"docs/results/{folder}/README.md",
            f"| {words} | {{}} |",
            lambda folder=folder, name=name, column=column: [_with_ends(folder, column, name)],
        )
        for folder, words, name, column in (
            ("noise_ceiling", "**ceiling**", "ceiling", "skill"),
            ("noise_ceiling", "ceiling of the change from the tare", "ceiling, change from the tare", "skill"),
            ("noise_ceiling", "object mean, share of the ceiling", "object_mean", "share"),
            ("noise_ceiling", "trees on geometry, share of the ceiling", "geometry_trees", "share"),
            ("noise_ceiling", "**`contact`, share of the ceiling**", "contact", "share"),
            ("noise_ceiling_unseen_objects", "ceiling, the object known", "ceiling", "skill"),
            (
                "noise_ceiling_unseen_objects",
                "**ceiling, the object never touched**",
                "ceiling, object never touched",
                "skill",
            ),
            (
                "noise_ceiling_unseen_objects",
                "the same of the change from the tare",
                "ceiling, object never touched, change from the tare",
                "skill",
            ),
            ("noise_ceiling_unseen_objects", "trees on geometry", "geometry_trees", "skill"),
            ("noise_ceiling_unseen_objects", "`contact`", "contact", "skill"),
        )
    ),
    (
        "docs/results/label_ratio/README.md",
        "At T90 the error of the SR-GAN is {} % lower than that of the PointNet in all four modalities, and each 95 % interval excludes 0",
        lambda: (
            [ends((-float(row["change"]) for row in rows("label_ratio", ratio=90)), 1)]
            if all(float(row["change_high"]) < 0 for row in rows("label_ratio", ratio=90))
            else []
        ),
    ),
    (
        "docs/results/label_ratio/README.md",
        "have lower errors than both networks in all 20 cells",
        lambda: (
            len(rows("label_ratio")) == 20
            and all(
                float(row["trees_rmse"]) < min(float(row["srgan_rmse"]), float(row["pointnet_rmse"]))
                for row in rows("label_ratio")
            )
        ),
    ),
    (
        "docs/results/lookalikes/README.md",
        "without a touch no predictor differs significantly from the mean of both, in any modality",
        lambda: all(
            row["vs_training_mean_verdict"] in ("tie", "") for row in rows("lookalikes", kind="all", touches=0)
        ),
    ),
    (
        "docs/results/label_ratio/README.md",
        "In 16 of the 20 cells it is significantly better, in 4 there is no significant difference, and in none is it significantly worse",
        lambda: sorted(row["verdict"] for row in rows("label_ratio")) == ["tie"] * 4 + ["win"] * 16,
    ),
    (
        RESULTS,
        "At T90, three runs, no difference between the models is significant, and the SR-GAN's mean error is above that of the mean of the labels in every modality. Of T50 one modality was run once, with the same outcome",
        lambda: (
            [row["verdict"] for row in rows("label_ratio_p2", ratio=90)] == ["tie"] * 4
            and {row["runs"] for row in rows("label_ratio_p2", ratio=90)} == {"3"}
            and [row["runs"] for row in rows("label_ratio_p2", ratio=50)] == ["1"]
            and all(float(row["srgan_rmse"]) > float(row["mean_rmse"]) for row in rows("label_ratio_p2"))
        ),
    ),
    (
        "docs/results/label_ratio_p2/README.md",
        "Trees on geometry with the same 320 labels have errors that are {} % below those of the mean of the labels",
        lambda: [
            ends(
                (
                    100.0 * (1.0 - float(row["trees_rmse"]) / float(row["mean_rmse"]))
                    for row in rows("label_ratio_p2", ratio=90)
                ),
                0,
            )
        ],
    ),
    (
        "docs/results/label_ratio_p2/README.md",
        "P2 has -31.5 % for E_MF at T90; here it is {} % [{}, {}]",
        lambda: [
            f"{float(rows('label_ratio_p2', ratio=90, modality='E_MF')[0][column]):+.1f}"
            for column in ("change", "change_low", "change_high")
        ],
    ),
    *(
        (
            file,
            "within boxes and across types they are {} % lower",
            lambda: [
                ends(
                    (
                        100.0 * (1.0 - ratio)
                        for (table, *_), ratio in _p1_ratios(("E_TH", "E_MF"), P1_WAYS[:1]).items()
                        if table != "within p1_cylinders"
                    ),
                    0,
                )
            ],
        )
        for file in ("docs/papers.md", "docs/results/p1_as_published/README.md")
    ),
    *(
        (file, phrase, lambda: [ends(_p1_ratios(("E_TH", "E_MF"), P1_WAYS[1:]).values(), 1)])
        for file, phrase in (
            ("docs/papers.md", "with `eval()` they are {} times the published ones"),
            ("docs/results/p1_as_published/README.md", "With `eval()` they are {} times the published ones"),
        )
    ),
    (
        "docs/papers.md",
        "those of pressures, which are {} times the published ones either way",
        lambda: [ends(_p1_ratios(("PDC_TH", "PDC_MF"), P1_WAYS).values(), 1)],
    ),
    (
        "docs/results/p1_as_published/README.md",
        "which are {} times the published ones without `eval()`, and {} times with it",
        lambda: [ends(_p1_ratios(("PDC_TH", "PDC_MF"), (way,)).values(), 1) for way in P1_WAYS],
    ),
    (
        RESULTS,
        "this gives P1's errors of electrodes, within 5 % in four of six cases",
        lambda: sum(abs(one - 1.0) < 0.0505 for one in _p1_ratios(("E_TH", "E_MF"), P1_WAYS[:1]).values()) == 4,
    ),
    *(
        (file, phrase, lambda: all(worse > 1.0 for worse in _p1_ratios(MODALITIES, P1_ALL, P1_MEAN).values()))
        for file, phrase in (
            ("docs/papers.md", "In every table and modality the network is worse than the mean of the training labels"),
            (
                "docs/results/p1_as_published/README.md",
                "In every table and modality, both ways of testing have a larger error than the mean of the training labels",
            ),
        )
    ),
    (
        "docs/results/noise_ceiling_unseen_objects/README.md",
        "`contact` reaches {} of the ceiling",
        lambda: [ends(numbers("noise_ceiling_unseen_objects", "share", name="contact"))],
    ),
]

DEFINED = [
    "as the correlations are, was made after touches on these eight objects had been scored without it",
    "The simulated objects, on which it makes no significant difference, were not used for this choice",
    "a predictor below 0 is worse than that",
    "**Better, worse, no significant difference**",
    "**Eight objects** are few",
    "With SGD at a constant 0.01",
    "With 72 objects and 1440 grasps (parameters fitted to the other half of the objects, not committed)",
    "A tracker whose tares observe the fast state as well",
    "The other differences are not significant",
    "Other rates of adaptation than .2 were tried with the mean as sight and not adopted",
]
"""Sentences of the main pages that define a word, or report what no committed table holds."""


P1_WAYS = ("network, no eval(), as in the public code", "network, eval()")
P1_PUBLISHED, P1_MEAN = "P1, published", "mean of the training labels"
P1_ALL = (*P1_WAYS, P1_PUBLISHED)


def _p1_ratios(
    modalities: Sequence[str], ways: Sequence[str], to: str = P1_PUBLISHED
) -> dict[tuple[str, str, str], float]:
    """P1's score of a predictor over that of another one, by table, modality and predictor."""
    score = {
        (row["table"], row["modality"], row["predictor"]): float(row["as_published_counts"])
        for row in rows("p1_as_published")
    }
    return {
        key: value / score[(*key[:2], to)] for key, value in score.items() if key[1] in modalities and key[2] in ways
    }


def _front_row(name: str) -> list[str]:
    (line,) = (line for line in (ROOT / "README.md").read_text().splitlines() if line.startswith(f"| `{name}`"))
    words = line.removeprefix(f"| `{name}`").split(" | ")[0]
    skills = [[one["skill"] for one in card(name)["skill"][split].values()] for split in ("random", "time", "object")]
    times = [float(_timed(name, count)["cpu_ms"]) for count in (1, 100)]
    return [
        words,
        *(f"{np.mean(four) + 0.0:.2f}".replace("-0.00", "0.00") for four in skills),
        *(f"{one:.1f}" if one < 10.0 else f"{one:.0f}" for one in times),
    ]


def _timed(variant: str, request: int) -> dict[str, str]:
    """The row of a model and a number of grasps in the committed comparison of models."""
    with (ROOT / "docs/results/tradeoff/model/tradeoff.csv").open(encoding="utf-8") as file:
        (found,) = (row for row in csv.DictReader(file) if (row["variant"], row["request"]) == (variant, str(request)))
    return found


def _campaign(folder: str, method: str) -> str:
    return " | ".join(prequential(label, method, folder, "training_mean") for label in ("none", "first 3", "all"))


def _versus_memory(folder: str) -> dict[str, str]:
    return verdicts(folder, "memory", sight="training_mean", method="tracker", bin="first 3")


def _by_object(sight: str, label: str) -> list[float]:
    return [
        float(row["coverage"])
        for row in rows("prequential", sight=sight, method="tracker", bin=label, object=...)
        if row["object"] != "all"
    ]


def _over_mean(folder: str, predictor: str) -> list[float]:
    errors, means = (numbers(folder, column, predictor=predictor) for column in ("rmse", "rmse_of_mean"))
    return [error / mean for error, mean in zip(errors, means, strict=True)]


def _published_over_mean() -> list[float]:
    published = [row for row in rows("cross_type", predictor="P1 (published)") if row["modality"] in MODALITIES]
    return [
        float(row["rmse"])
        / numbers(
            "cross_type", "rmse_of_mean", table=row["table"], predictor="training_mean", modality=row["modality"]
        )[0]
        for row in published
    ]


def _with_ends(folder: str, column: str, name: str) -> str:
    """Of each modality a value with its interval."""
    values, low, high = (numbers(folder, column + end, name=name) for end in ("", "_low", "_high"))
    return " | ".join(f"{_two(v)} ({_two(a)} to {_two(b)})" for v, a, b in zip(values, low, high, strict=True))


def _two(value: float) -> str:
    return f"{value:.2f}".replace("0.", ".", 1)


def _lost(variant: str, ground: str) -> tuple[float, str]:
    """Difference of the mean skill from the full model, and its verdict, in the first table of that ground."""
    found = next(
        row for row in rows("ablation", predictor=variant, modality=MEAN) if ground in row["table"] and row["vs_full"]
    )
    return float(found["vs_full"]), found["vs_full_verdict"]


def _curve(ground: str) -> str:
    sizes = dict.fromkeys(int(row["size"]) for row in rows("learning_curve", ground=ground))
    return ", ".join(
        short(skill_of_mean("learning_curve", ground=ground, size=size, predictor="contact")) for size in sizes
    )


def flat(text: str) -> str:
    return " ".join(text.split())


def quoted(phrase: str, holds: Callable[[], Sequence[str] | bool]) -> str:
    """The phrase with its gaps filled from the tables; an error if a condition does not hold."""
    found = holds()
    if isinstance(found, bool | np.bool_):
        assert found, f"the tables do not bear this out: {phrase}"
        return phrase
    assert found, f"the tables do not bear this out: {phrase}"
    return phrase.format(*found)


@pytest.mark.parametrize(("file", "phrase", "holds"), CLAIMS, ids=[phrase[:50] for _, phrase, _ in CLAIMS])
def test_a_statement_is_that_of_the_tables(file: str, phrase: str, holds: Callable[[], Sequence[str] | bool]) -> None:
    assert flat(quoted(phrase, holds)) in flat((ROOT / file).read_text(encoding="utf-8"))


def sentences(text: str) -> list[str]:
    """Sentences and table rows, without code blocks."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    found = []
    for block in re.split(r"\n\s*\n|\n(?=[-|#] ?)", text):
        parts = re.split(r"(?<=[.:?]) (?=[A-Z`*\[])", flat(block))
        found += parts
    return found


@pytest.mark.parametrize("file", ["README.md", RESULTS])
def test_each_sentence_with_a_skill_or_a_comparison_is_held(file: str) -> None:
    held = [flat(quoted(phrase, holds)) for name, phrase, holds in CLAIMS if name == file] + DEFINED
    text = flat((ROOT / file).read_text(encoding="utf-8"))
    spans = [(text.index(phrase), text.index(phrase) + len(phrase)) for phrase in held if phrase in text]
    missing: list[str] = []
    for sentence in sentences((ROOT / file).read_text(encoding="utf-8")):
        if STATED.search(sentence) and sentence in text:
            start = text.index(sentence)
            end = start + len(sentence)
            missing += [] if any(low < end and start < high for low, high in spans) else [sentence]
    assert not missing, "no row of CLAIMS holds: " + " ## ".join(missing)


@pytest.mark.parametrize("name", ["contact-v1", "contact-v2", "touchnet-v1"])
def test_limits_of_a_card_are_those_of_its_scores(name: str) -> None:
    found = card(name)
    for split, scores in found["skill"].items():
        baselines = {key: by[split] for key, by in found["baselines"].items() if split in by}
        others = {key: np.mean([one["skill"] for one in by.values()]) for key, by in baselines.items()}
        best = max(others, key=lambda key: others[key])
        mean = np.mean([one["skill"] for one in scores.values()])
        text = f"Split {split}: mean skill {mean:.2f}; that of the best baseline, {best}, is {others[best]:.2f}."
        assert text in found["limits"]


@pytest.mark.parametrize("name", ["unseen_object", "prequential"])
def test_new_objects_are_compared_with_the_clock(name: str) -> None:
    experiment = find_experiment(name)
    if name == "prequential":
        assert any(row["method"] == "clock" for row in table(name))
    else:
        assert {"clock", "clock_past"} <= set(experiment.resolve("full", {}).predictors)
        for folder in ("unseen_object_v2", "unseen_object_both"):
            assert {"clock", "clock_past"} <= {row["predictor"] for row in table(folder)}
