# SPDX-License-Identifier: Apache-2.0
"""The progress bar: shown on a terminal only, and erased where an error is reported."""

from __future__ import annotations

from contextlib import suppress

import pytest

from foretouch.cli.output import progress_bar
from foretouch.errors import ForetouchError

ERASE = "\x1b[2K"


@pytest.fixture
def terminal(monkeypatch) -> None:
    """Let rich treat stderr as a terminal."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")


def test_nothing_is_shown_without_a_terminal(capsys) -> None:
    with progress_bar("simulating", 3) as update:
        update()
    assert capsys.readouterr() == ("", "")


@pytest.mark.usefixtures("terminal")
def test_updates_advance_or_set_the_bar_unless_it_is_hidden(capsys) -> None:
    with progress_bar("reading the data") as update:
        update(7, 9, "ablation seed=1")
        update()
    out, err = capsys.readouterr()
    assert (out, "8/9" in err, "ablation seed=1" in err, err.endswith(ERASE)) == ("", True, True, False)
    with progress_bar("simulating", 3, hidden=True) as update:
        update()
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("terminal")
def test_the_bar_is_erased_if_transient_without_progress_or_after_an_error(capsys) -> None:
    with progress_bar("importing", transient=True) as update:
        update()
    assert capsys.readouterr().err.endswith(ERASE)
    with progress_bar("epoch"):
        pass
    assert capsys.readouterr().err.endswith(ERASE)
    with suppress(ForetouchError), progress_bar("epoch", 3) as update:
        update()
        raise ForetouchError("disk full")
    assert capsys.readouterr().err.endswith(ERASE)
