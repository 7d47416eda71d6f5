# SPDX-License-Identifier: Apache-2.0
"""What does another lab get from its first recorded grasps? See README.md."""

from argparse import ArgumentParser
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy import stats

import foretouch as ft
from benchmarks.common import ROOT, read_csv, write_csv
from foretouch.config import load_yaml
from foretouch.models.touch_model import History, TouchModel
from foretouch.report.panels import FINGER_COLOURS, INK, PAGE_INCH, SMALL_PT, TEXT_PT, new_figure, save_small
from foretouch.types import Float64, Sample, Touch
from foretouch.types.channels import Channels
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.simulate import Simulation

FOLDER: Final = Path(__file__).parent
SCENES: Final = {"BioTac SP": "fifty_touches", "uSkin": "fifty_touches_uskin"}
COUNTS: Final = (0, 5, 10, 20, 30, 100)
RECORDED, TESTED, RUN = max(COUNTS), 60, 5
WAYS: Final = ("tracker", "where", "fitted")
STYLES: Final = {
    "tracker": {"label": "released model, adapted by readings", "color": INK, "marker": "s", "linestyle": "--"},
    "where": {"label": "same, like grasps count more", "color": FINGER_COLOURS[3], "marker": "^", "linestyle": "-."},
    "fitted": {"label": "model fitted to these grasps", "color": FINGER_COLOURS[1], "marker": "o", "linestyle": "-"},
}  # fmt: skip
MINUTE_NS: Final = 60 * 10**9
OFFSET: Final = {"BioTac SP": 150.0, "uSkin": 1000.0}  # standard deviation of the rest level of each value [counts]
GAINS: Final = (0.6, 1.6)  # of each finger and kind of value


@dataclass(frozen=True)
class Scored:
    """Mean over the modalities of a sensor."""

    skill: float
    coverage: float  # NaN without intervals


def simulated(scene: str, seed: int, count: int) -> list[Sample]:
    """Return grasps of eight objects of a scene in runs of five; the order of the objects is drawn anew in each round."""
    content = load_yaml(ROOT / f"config/scenes/{scene}.yaml")
    content["seed"] = seed
    for family in content["families"]:
        family["seed"] = seed  # other objects for each hand
    rng, by_object = np.random.default_rng(seed), defaultdict[str, list[Sample]](list)
    for sample in Simulation(SceneConfig.from_mapping(content, scene)).samples(count):
        by_object[sample.object].append(sample)
    rounds = range(0, count // len(by_object), RUN)
    ordered = [
        sample for start in rounds for name in rng.permutation(sorted(by_object))
        for sample in by_object[name][start : start + RUN]
    ]  # fmt: skip
    return [replace(sample, stamp_ns=(number + 1) * 2 * MINUTE_NS) for number, sample in enumerate(ordered)]


def on_another_hand(samples: Sequence[Sample], offset: float, seed: int) -> list[Sample]:
    """Give every value another rest level, and the change in contact of each finger and kind of value another gain."""
    rng, channels = np.random.default_rng([seed, 1]), samples[0].touch.channels
    rests = np.mean([sample.tare.values for sample in samples], axis=0)
    shift, gain = rng.normal(0.0, offset, len(rests)), np.ones(len(rests))
    for columns in channels.modality_columns.values():
        gain[columns] = np.exp(rng.uniform(*np.log(GAINS)))
    ends = [(channel.low, channel.high) for channel in channels.channel_of.values()]
    low, high = np.array(ends)[channels.modality_of_value].T

    def changed(touch: Touch) -> Touch:
        return replace(touch, values=np.clip(np.round(rests + shift + gain * (touch.values - rests)), low, high))

    return [replace(sample, touch=changed(sample.touch), tare=changed(sample.tare)) for sample in samples]


def estimates(model: TouchModel, samples: Sequence[Sample]) -> list:
    """Return what the model says of each grasp by vision."""
    return [model.estimate_executed(sample.cloud, [sample.grasp]) for sample in samples]


def predicted(model: TouchModel, seen: Sequence, samples: Sequence[Sample], first: int, count: int) -> Float64:
    """Return (2, T, D) predictions of the tested grasps and half widths, each from the `count` grasps before it, from `first` on.

    `seen` are the estimates of all grasps. A reading of the open hand is taken before each grasp, as the nodes do.
    """
    results = []
    for number in range(RECORDED, RECORDED + TESTED):
        history, last = History(model), samples[number]
        before = range(max(first, number - count), number)
        for earlier in before:
            sample = samples[earlier]
            changes = earlier == before[0] or samples[earlier - 1].object != sample.object
            history.tare(sample.tare, stamp_ns=sample.stamp_ns - MINUTE_NS)
            history.touched(
                sample.cloud,
                sample.grasp,
                sample.touch,
                stamp_ns=sample.stamp_ns,
                same_object=not changes,
                estimate=seen[earlier],
            )
        history.tare(last.tare, stamp_ns=last.stamp_ns - MINUTE_NS)
        same = bool(before) and samples[number - 1].object == last.object
        results.append(history.at(last.stamp_ns, same_object=same, tared=True).adapt(seen[number]))
    return np.array(results)[:, :, 0].swapaxes(0, 1)


def scored(counts: Float64, half: Float64, readings: Float64, channels: Channels) -> Scored:
    """Return the skill against the mean of the tested readings themselves, and coverage of the intervals of 90 %."""
    off, spread = counts - readings, readings - readings.mean(axis=0)
    inside = np.where(np.isnan(half), np.nan, np.abs(off) <= half)
    columns = channels.modality_columns.values()
    return Scored(
        float(np.mean([1.0 - (off[:, own] ** 2).sum() / (spread[:, own] ** 2).sum() for own in columns])),
        float(np.mean([inside[:, own].mean() for own in columns])),
    )


def of_one_hand(name: str, seed: int) -> list[dict[str, object]]:
    """Return rows of one simulated hand."""
    samples = on_another_hand(simulated(SCENES[name], seed, RECORDED + TESTED), OFFSET[name], seed)
    if name == "BioTac SP":
        start = ft.load_model("contact-v3")
    else:  # the shipped model is of another sensor: that of another lab with the same one, with other objects
        start = ft.fit(simulated(SCENES[name], 1000 + seed, RECORDED + TESTED))
    channels, readings = samples[0].touch.channels, np.array([sample.touch.values for sample in samples[RECORDED:]])
    seen, rows = estimates(start, samples), []
    for count in COUNTS:
        answers = {
            "tracker": predicted(start, [replace(own, where=None) for own in seen], samples, 0, count),
            "where": predicted(start, seen, samples, 0, count),
        }
        note = ""
        try:
            fitted = ft.fit(samples[RECORDED - count : RECORDED])
            own = estimates(fitted, samples)
            if fitted.calibration is None:
                note, alone = "no intervals", np.array([estimate.counts[0] for estimate in own[RECORDED:]])
                answers["fitted"] = np.array([alone, np.full_like(alone, np.nan)])
            else:
                answers["fitted"] = predicted(fitted, own, samples, RECORDED, count)
        except (ft.ForetouchError, ValueError) as error:
            note = f"no fit: {type(error).__name__}"
            print(name, seed, count, error, flush=True)
        for way in WAYS:
            row: dict[str, object] = {
                "hand": name,
                "seed": seed,
                "grasps": count,
                "way": way,
                "skill": "",
                "coverage": "",
            }
            if way in answers:
                score = scored(*answers[way], readings, channels)
                row |= {"skill": f"{score.skill:.3f}"}
                row |= {} if np.isnan(score.coverage) else {"coverage": f"{score.coverage:.3f}"}
            rows.append(row | {"note": note if way == "fitted" else ""})
            print(*rows[-1].values(), flush=True)
    return rows


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the mean over the hands, and half the width of its interval of 95 % by Student's t."""
    mean, count = float(np.mean(values)), len(values)
    if count < 2:
        return mean, float("nan")
    return mean, float(stats.t.ppf(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count))


def draw(path: Path) -> None:
    """Draw skill and coverage over the number of recorded grasps, from `results.csv`."""
    table = read_csv(FOLDER / "results.csv")
    figure = new_figure(PAGE_INCH, 4.8)
    panels = figure.subplots(2, len(SCENES), sharex=True, sharey="row")
    for column, hand in enumerate(SCENES):
        for what, axes in zip(("skill", "coverage"), panels[:, column], strict=True):
            for shift, (way, style) in enumerate(STYLES.items()):
                points = []
                for place, count in enumerate(COUNTS):
                    values = [
                        float(row[what]) for row in table
                        if (row["hand"], row["way"], int(row["grasps"])) == (hand, way, count) and row[what]
                    ]  # fmt: skip
                    if values:
                        points.append((place + 0.1 * (shift - 1), *interval(values)))
                axes.errorbar(*np.transpose(points), capsize=3, markersize=5, **style)
            axes.set_xticks(range(len(COUNTS)), [str(count) for count in COUNTS])
            axes.tick_params(labelsize=SMALL_PT)
            axes.axhline({"skill": 0.0, "coverage": 0.9}[what], color=INK, linestyle=":", linewidth=1.0, zorder=0)
        panels[0, column].set_title(f"a new hand with {hand}", fontsize=TEXT_PT)
        panels[1, column].set_xlabel("recorded grasps of this hand (bars: 95 % over three hands)", fontsize=SMALL_PT)
    panels[0, 0].set_ylabel("skill (1: perfect, 0: the mean;\ncompressed below −1)", fontsize=SMALL_PT)
    panels[0, 0].set_yscale("symlog", linthresh=1.0)
    panels[0, 0].set_yticks([-10.0, -3.0, -1.0, 0.0, 1.0], ["−10", "−3", "−1", "0", "1"])
    panels[0, 0].set_ylim(-30.0, 1.1)  # the bars of three hands end beyond what a skill or a share can be
    panels[1, 0].set_ylim(0.4, 1.02)
    panels[1, 0].set_ylabel("share read inside 90 % intervals", fontsize=SMALL_PT)
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=SMALL_PT, frameon=False
    )
    save_small(figure, path)


def main() -> None:
    """Write results.csv and docs/own_hand.png."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="hands of each sensor (default: %(default)s)")
    parser.add_argument("--draw", action="store_true", help="only draw results.csv")
    arguments = parser.parse_args()
    if not arguments.draw:
        rows = [row for name in SCENES for seed in range(arguments.seeds) for row in of_one_hand(name, seed)]
        write_csv(FOLDER / "results.csv", rows)
    draw(ROOT / "docs/own_hand.png")
    table = read_csv(FOLDER / "results.csv")
    for hand in SCENES:
        for way in WAYS:
            print(hand, way, end=":")
            for count in COUNTS:
                own = [row for row in table if (row["hand"], row["way"], row["grasps"]) == (hand, way, str(count))]
                for what in ("skill", "coverage"):
                    values = [float(row[what]) for row in own if row[what]]
                    print(" –" if not values else " {:.2f}±{:.2f}".format(*interval(values)), end="")
                print(end=" |")
            print()


if __name__ == "__main__":
    main()
