# SPDX-License-Identifier: Apache-2.0
"""Builds a training store out of recorded samples: memory-mapped, hashed, with its splits inside.

The store appears at its place as a whole or not at all. Its content hash depends on the samples and their order
alone, so that the same recordings give the same hash anywhere.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from foretouch import __version__
from foretouch.dataset.samples import DISCARDED, only_finite, open_samples
from foretouch.dataset.store_writer import StoreWriter

__all__ = ["BuildResult", "SampleFacts", "build_store"]


@dataclass(frozen=True)
class SampleFacts:
    """What a split needs to know of one sample."""

    id: str
    object: str
    stamp_ns: int
    labelled: bool


@dataclass(kw_only=True)
class BuildResult:
    """What was built.

    Attributes:
        sha256: Content hash.
        samples: The samples in their order.
        left_out: Samples that were not taken, by reason.
    """

    sha256: str = ""
    samples: list[SampleFacts] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)


def build_store(
    sources: Sequence[str | Path],
    out: str | Path,
    *,
    attach: Callable[[Sequence[SampleFacts]], Mapping[str, str]] | None = None,
    progress: Callable[[], None] = lambda: None,
) -> BuildResult:
    """Write all samples of some sources into one store.

    Args:
        sources: Recorded datasets, recordings, stores or vision2tactile folders (see `open_samples`).
        out: Where to; must not exist.
        attach: Given the samples, returns texts by the name of the file that holds them in the store, such as splits.
        progress: Called once a sample.

    Returns:
        What was built. Samples that the operator discarded are left out.

    Raises:
        FileError: If `out` exists, or a source is damaged or no source.
        DatasetError: If two samples have one id, or a number is not finite.
    """
    result = BuildResult()
    origins: list[dict[str, Any]] = []
    about: dict[str, Any] = {"made_by": f"foretouch {__version__} dataset build", "sources": origins}
    with StoreWriter(out, about) as writer:
        for source in sources:
            with open_samples(source) as samples:
                identity = {"hand": dict(samples.identity.hand), "camera": dict(samples.identity.camera)}
                origins.append({"name": samples.path.name, "kind": samples.kind, "samples": len(samples), **identity})
                for record in samples.records(discarded=True):
                    progress()
                    if DISCARDED in record.flags:
                        result.left_out[DISCARDED] += 1
                        continue
                    sample = only_finite(record.sample)
                    writer.write(sample)
                    labelled = sample.touch is not None
                    result.samples.append(SampleFacts(sample.id, sample.object, sample.stamp_ns, labelled))
        writer.about |= _shared_identity(origins)
        for name, text in (attach(result.samples) if attach else {}).items():
            writer.attach(name, text)
        result.sha256 = writer.sha256
    return result


def _shared_identity(origins: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Hand and camera, where all sources agree on them."""
    return {
        name: origins[0][name]
        for name in ("hand", "camera")
        if origins and all(origin[name] == origins[0][name] for origin in origins)
    }
