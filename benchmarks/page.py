# SPDX-License-Identifier: Apache-2.0
"""Write the times on docs/accuracy_vs_time.md from the committed tables of models and of the graph: `python -m benchmarks.page`."""

from benchmarks.common import ROOT, markdown, read_csv, replace_marked
from benchmarks.transport.bench import PERCENTILES, RESULTS, state

SUMMARY = (ROOT / "docs/results/tradeoff/model/summary.md").read_text(encoding="utf-8")
MODELS = ("mean of labels", "mean of the object", "mean of labels + readings", "touchnet-v1", "contact-v2",
          "contact-v2 + readings", "papers' four networks")  # fmt: skip
COLUMNS = {"": "", "time": "skill, blocks of time", "object": "skill, objects left out", "1 [ms]": "1 grasp [ms]",
           "100 [ms]": "100 grasps [ms]", "1000 [ms]": "1000 grasps [ms]"}  # fmt: skip
RATES = ("10", "30", "60", "90")  # clouds a second


def section(title: str) -> str:
    """A section of the summary of the models."""
    return SUMMARY.split(f"## {title}\n")[1].split("\n## ")[0].strip().removeprefix("- ")


def models() -> str:
    """The rows and columns of the summary's table that answer most questions."""
    rows = [
        [cell.strip("• *") for cell in line.strip("|").split("|")]
        for line in section("Variants").splitlines()
        if line.startswith("|")
    ]
    kept = [rows[0].index(name) for name in COLUMNS]
    named = {row[0]: [row[k] for k in kept] for row in rows}
    return markdown(list(COLUMNS.values()), [named[name] for name in MODELS]).strip()


def graph() -> str:
    """Latency of the graph in one process, in a sentence."""
    rows = {row["rate_hz"]: row for row in read_csv(RESULTS) if row["processes"] == "one"}
    times = "; ".join(
        f"{', '.join(f'{float(rows[rate][key]):.0f}' for key in PERCENTILES)} ms at {rate} clouds a second"
        for rate in RATES
    )
    lost, sent = (sum(int(row[key]) for row in rows.values()) for key in ("lost", "sent"))
    return (
        f"The whole graph in one process, from the stamp of an 848x480 cloud to its received prediction (p50, p95, p99; "
        f"{state(list(rows.values()))} machine): {times}. Of {sent:,} clouds at {next(iter(rows))} to {list(rows)[-1]} a second {lost or 'none'} "
        f"{'was' if lost < 2 else 'were'} lost."
    )


def main() -> None:
    text = [
        section("In short"),
        "![Skill against the time of a prediction](results/tradeoff/model/tradeoff.png)",
        models(),
        "- Times: p50, p95, p99 of the wall time.",
        graph(),
        "![Latency and losses against the rate of the clouds](stamp_to_touch.png)",
    ]
    replace_marked(ROOT / "docs/accuracy_vs_time.md", "\n\n".join(text))


if __name__ == "__main__":
    main()
