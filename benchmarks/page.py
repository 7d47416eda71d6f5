# SPDX-License-Identifier: Apache-2.0
"""Write the times on docs/accuracy_vs_time.md from the committed tables of models and of the graph: `python -m benchmarks.page`."""

from benchmarks.common import BEGIN, END, ROOT, replace_marked

SUMMARY = (ROOT / "docs/results/tradeoff/model/summary.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    """A section of the summary of the models."""
    return SUMMARY.split(f"## {title}\n")[1].split("\n## ")[0].strip().removeprefix("- ")


def main() -> None:
    text = [
        section("In short"),
        "![Skill against the time of a prediction](results/tradeoff/model/tradeoff.png)",
        section("Models"),
        (ROOT / "benchmarks/transport/README.md").read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0].strip(),
        "![Latency and losses against the rate of the clouds](stamp_to_touch.png)",
    ]
    replace_marked(ROOT / "docs/accuracy_vs_time.md", "\n\n".join(text))


if __name__ == "__main__":
    main()
