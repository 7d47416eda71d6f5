# SPDX-License-Identifier: Apache-2.0
"""The few numbers on hand-written pages, held against the committed tables; pages of results are written from theirs."""

import csv
import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case

from foretouch.models import available_models
from foretouch.tactile import MODALITIES

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"
WITHOUT, WITH = "network, no eval(), as in the public code", "network, eval()"
PUBLISHED, MEAN = "P1 (published)", "mean of the training labels"

pytestmark = pytest.mark.committed_numbers


def rows(table: str, **wanted: Any) -> list[dict[str, str]]:
    """Rows of a committed table, of all objects together where it has rows of single ones."""
    with (RESULTS / table).open(encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    wanted |= {"object": "all"} if any(row.get("object") == "all" for row in found) else {}
    found = [row for row in found if all(row[name] == str(value) for name, value in wanted.items())]
    assert found, (table, wanted)
    return found


def short(value: float) -> str:
    """Format a number as the pages do: 0.05, -0.23, 1.03, 0."""
    return "0" if value == 0.0 else f"{value:.2f}"


def skills(table: str, modalities: Sequence[str] = MODALITIES, **wanted: Any) -> list[str]:
    return [short(float(row["skill"])) for row in rows(table, **wanted) if row["modality"] in modalities]


def ends(values: Iterable[float], decimals: int = 1) -> str:
    values = list(values)
    return f"{min(values):.{decimals}f} to {max(values):.{decimals}f}"


def card(name: str) -> dict[str, Any]:
    return json.loads((ROOT / f"src/foretouch/models/weights/{name}.json").read_text())


def card_skills(name: str) -> list[str]:
    """Mean skill of the modalities by split."""
    found = [
        np.mean([one["skill"] for one in card(name)["skill"][split].values()]) for split in ("random", "time", "object")
    ]
    return [f"{one:.2f}".replace("-0.00", "0.00") for one in found]


def p1(modalities: Sequence[str], *ways: str, to: str = PUBLISHED, tables: str = "") -> list[float]:
    """Errors in P1's way of scoring over those of another predictor."""
    table = rows("p1_as_published/results.csv")
    score = {(row["table"], row["modality"], row["predictor"]): float(row["as_published_counts"]) for row in table}
    chosen = [key for key in score if key[1] in modalities and key[2] in ways and tables in key[0]]
    return [score[key] / score[(*key[:2], to)] for key in chosen]


def no_model_is_better_than_the_mean() -> bool:
    verdicts = [
        row["vs_training_mean_verdict"]
        for name in ("contact", "touchnet_v1")
        for row in rows("unseen_object/results.csv", touches=0, predictor=name)
    ]
    return set(verdicts) == {"tie"}


KNOWN = {
    "nothing: the mean of earlier readings": ("nothing", "training_mean"),
    "\\*\\*vision": ("nothing", "contact"),
    "temperature of the fingers": ("temperature", "training_mean"),
    "readings on other objects": ("history", "training_mean"),
    "history and temperature": ("history + temperature", "training_mean"),
    "touches of this object": ("touches", "training_mean"),
    "history, temperature and touches": ("history + touches + temperature", "training_mean"),
    "the same with vision": ("history + touches + temperature", "contact"),
}
"""Rows of the table of what each source buys, with what is known besides vision and the predictor."""

WITH_VISION = {
    "nothing": "nothing",
    "the time": "time",
    "history of the hand and temperature": "history + temperature",
    "touches of this object": "touches",
    "history, temperature and touches": "history + touches + temperature",
    "history, touches and the temperature of the grasp before": "history + touches + last temperature",
}
"""Rows of the table of the first three grasps, with what is known besides vision."""


def known(sources: str, vision: str, *regimes: str) -> list[str]:
    """Skills of the electrodes by regime."""
    wanted = {"sources": sources, "vision": vision}
    return [
        skill
        for regime in regimes
        for skill in skills("prequential/results.csv", ("E_TH", "E_MF"), regime=regime, **wanted)
    ]


def with_vision(sources: str) -> list[str]:
    """Skills of the electrodes in the first three grasps, without and with vision, and whether they differ."""
    table = rows("prequential/results.csv", sources=sources, vision="contact", regime="first three")
    verdicts = {row["modality"]: row["vs_constant_verdict"] for row in table}
    words = {"tie": "no", "better": "better by less than 0.01"}
    thumb, middle = (words[verdicts[name]] for name in ("E_TH", "E_MF"))
    skills = [one for vision in ("training_mean", "contact") for one in known(sources, vision, "first three")]
    return [*skills, thumb if thumb == middle else f"{thumb} / {middle}"]


def where(regime: str, modalities: Sequence[str] = ("E_TH", "E_MF"), experiment: str = "where_on_object") -> list[str]:
    """Skills without where on the object and with it."""
    names = ("level", "where")
    table = f"{experiment}/results.csv"
    return [skill for name in names for skill in skills(table, modalities, variant=name, regime=regime)]


def gains(*modalities: str, experiment: str = "where_on_object", **wanted: Any) -> list[str]:
    """Gain by where on the object and its interval, from the fourth grasp on."""
    wanted = {"variant": "where", "regime": "later"} | wanted
    found = [row for row in rows(f"{experiment}/results.csv", **wanted) if row["modality"] in modalities]
    return [f"{float(row[key]):.3f}" for row in found for key in ("gain", "gain_low", "gain_high")]


def pooled(experiment: str, predictor: str, **wanted: Any) -> dict[str, str]:
    """The row of the mean of all modalities."""
    (row,) = rows(f"{experiment}/results.csv", predictor=predictor, modality="mean", **wanted)
    return row


def against_trees(experiment: str) -> list[str]:
    """Mean skills of the default model and of the trees, which are the best baseline and do not differ from it."""
    table = rows(f"{experiment}/results.csv", modality="mean")
    baselines = [row for row in table if row["predictor"] not in {"contact", "touchnet_v1"}]
    assert max(baselines, key=lambda row: float(row["skill"]))["predictor"] == "geometry_trees"
    model = pooled(experiment, "contact")
    assert model["vs_geometry_trees_verdict"] == "tie"
    return [short(float(row["skill"])) for row in (model, pooled(experiment, "geometry_trees"))]


def against_the_clock() -> list[str]:
    """Mean skills on objects that were never touched; the clock is better than the mean and the model is not."""
    clock, model = (pooled("unseen_object", name, touches=0) for name in ("clock", "contact"))
    assert (clock["vs_training_mean_verdict"], model["vs_training_mean_verdict"]) == ("better", "tie")
    return [short(float(row["skill"])) for row in (model, clock)]


def verdicts_of_vision() -> list[str]:
    found = [row["vs_constant_verdict"] for row in rows("prequential/results.csv", vision="contact")]
    compared = [one for one in found if one]
    assert len(compared) == 160
    return [str(compared.count(one)) for one in ("better", "worse")]


CLAIMS: dict[str, list[tuple[str, Callable[[], Sequence[str] | bool]]]] = {
    "README.md": [
        ("explain {} of the variance of the thumb's electrodes", lambda: known("history + touches + last temperature", "contact", "first three")[:1]),
        ("From the fourth grasp of an object, adding the camera raises this by 0.03", lambda: [f"{float(gains('mean')[0]):.2f}"] == ["0.03"]),
    ],
    "docs/models.md": [
        *(
            (rf"\| `{name}`[^|]* \| {{}} \| {{}} \| {{}} \|", lambda name=name: card_skills(name))
            for name in ("contact-v3",)
        ),
        ("without a touch, no model differs significantly from the mean of the training readings", no_model_is_better_than_the_mean),
        (
            "a clock alone has {} {} {} {} \\(PDC_TH",
            lambda: skills("unseen_object/results.csv", touches=0, predictor="clock"),
        ),
    ],
    "docs/results/README.md": [
        *((rf"\| {text}[^|]* \| {{}} / {{}} \| {{}} / {{}} \| {{}} \|", lambda sources=sources: with_vision(sources)) for text, sources in WITH_VISION.items()),
        (
            r"\| 3 or more \| {} / {} \| {} / {} \| {} \[{}, {}\] / {} \[{}, {}\] \| {} \[{}, {}\] \|",
            lambda: [*where("later"), *gains("E_TH", "E_MF"), *gains("mean")],
        ),
        (r"\| `contact-v3` \| {} \|.*`geometry_trees`: [^|]*\| {} \|", lambda: against_trees("cross_validation")),
        (r"\| `contact-v3` \| [^|]* \| {} \|.*`geometry_trees`: [^|]*\| [^|]* \| {} \|", lambda: against_trees("time_blocked")),
        (r"\| `contact-v3` \| [^|]* \| [^|]* \| {} \|.*only a clock is better than the mean: it has a mean skill of {}\.", against_the_clock),
        *(
            (rf"\| [^|]*{text}[^|]* \| {{}} / {{}} \| {{}} / {{}} \| {{}} / {{}} \|", lambda key=key: known(*key, "never touched", "first three", "later"))
            for text, key in KNOWN.items()
        ),
        (
            r"\| \*\*gain\*\* \| \*\*{}\*\* \[{}, {}\] \| {} \[{}, {}\] \| \*\*{}\*\* \[{}, {}\] \| \*\*{}\*\* \[{}, {}\] \| \*\*{}\*\* \[{}, {}\] \|",
            lambda: gains(*MODALITIES, "mean"),
        ),
        (
            r"without where \| 0.18 \| 0.17 \| \| gain \| {} \[{}, {}\] \|",
            lambda: gains("mean", experiment="where_on_object_simulated"),
        ),
        (r"\| gain \| [^|]* \| {} \[{}, {}\] \|", lambda: gains("mean", experiment="where_on_object_uskin")),
        (r"shuffled within the object \| 0.000 \| 0.000 \| -0.002 \| 0.000 \| {} \[{}, {}\] \|", lambda: gains("mean", variant="shuffled")),
        ("significantly better in {} of 160 comparisons, by less than 0.01, and worse in {}", verdicts_of_vision),
    ],
    "docs/papers.md": [
        (
            "within boxes and across types they are {} % lower",
            lambda: [
                ends([100.0 * (1.0 - one) for tables in ("boxes", "across") for one in p1(("E_TH", "E_MF"), WITHOUT, tables=tables)], 0)
            ],
        ),
        ("with `eval\\(\\)` they are {} times the published ones", lambda: [ends(p1(("E_TH", "E_MF"), WITH))]),
        ("which are {} times the published ones either way", lambda: [ends(p1(("PDC_TH", "PDC_MF"), WITHOUT, WITH))]),
        (
            "In every table and modality the network is worse than the mean of the training labels",
            lambda: min(p1(MODALITIES, WITHOUT, WITH, PUBLISHED, to=MEAN)) > 1.0,
        ),
    ],
}  # fmt: skip
"""By page, phrases as patterns with gaps, and what fills the gaps by the tables, or whether the phrase holds."""


@pytest.mark.parametrize("page", CLAIMS)
def test_a_statement_is_that_of_the_tables(page) -> None:
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())

    def check(phrase: str, holds: Callable[[], Sequence[str] | bool]) -> None:
        found = holds()
        assert isinstance(found, Sequence) or found, "the tables do not bear this out"
        pattern = phrase.format(*map(re.escape, found)) if isinstance(found, Sequence) else phrase
        assert re.search(pattern, text), f"is not on the page with {found}"

    every_case(CLAIMS[page], check)


def test_limits_of_a_card_are_those_of_its_scores() -> None:
    def check(name: str) -> None:
        found = card(name)
        for split, scores in found["skill"].items():
            baselines = {key: by[split] for key, by in found["baselines"].items() if split in by}
            others = {key: np.mean([one["skill"] for one in by.values()]) for key, by in baselines.items()}
            best = max(others, key=lambda key: others[key])
            mean = np.mean([score["skill"] for score in scores.values()])
            text = f"Split {split}: mean skill {mean:.2f}; that of the best baseline, {best}, is {others[best]:.2f}."
            assert text in found["limits"]

    every_case(sorted(available_models()), check)
