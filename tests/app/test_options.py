"""A command from a signature: names, ranges, lists, what is required, what its help shows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import click
import pytest
from click.testing import CliRunner, Result

from app.cli.options import Argument, CommandGroup, Option, command_of

CALLED: dict[str, Any] = {}


def sample(
    name: Annotated[str, Argument(help="The name.")],
    more: Annotated[list[int] | None, Argument(help="Numbers.", metavar="N…")] = None,
    out: Annotated[Path | None, Option(help="A file.")] = None,
    unit: Annotated[int, Option(min=1, max=255, help="The unit.")] = 1,
    wait_s: Annotated[float, Option(max=5, help="Seconds.")] = 2.0,
    each: Annotated[list[str] | None, Option(help="Repeatable.")] = None,
    script: Annotated[bool, Option(help="On by default.")] = True,
    yes: Annotated[bool, Option("--yes", help="A flag.")] = False,
) -> None:
    """Do it."""
    CALLED.update(locals())


def run(command: click.Command, *words: str) -> Result:
    CALLED.clear()
    return CliRunner().invoke(command, words)


def test_defaults_reach_the_function() -> None:
    assert run(command_of(sample), "ann").exit_code == 0
    assert CALLED == {
        "name": "ann",
        "more": [],
        "out": None,
        "unit": 1,
        "wait_s": 2.0,
        "each": [],
        "script": True,
        "yes": False,
    }


def test_values_have_their_types() -> None:
    words = ("ann", "1", "2", "--out", "a/b", "--unit", "7", "--wait-s", "0.5", "--each", "x", "--each", "y")
    assert run(command_of(sample), *words, "--no-script", "--yes").exit_code == 0
    assert CALLED["more"] == [1, 2]
    assert CALLED["out"] == Path("a/b")
    assert (CALLED["unit"], CALLED["wait_s"], CALLED["each"]) == (7, 0.5, ["x", "y"])
    assert (CALLED["script"], CALLED["yes"]) == (False, True)


@pytest.mark.parametrize("words", [(), ("ann", "--unit", "0"), ("ann", "--wait-s", "6"), ("ann", "x")])
def test_wrong_use_is_2(words: tuple[str, ...]) -> None:
    assert run(command_of(sample), *words).exit_code == 2
    assert CALLED == {}


def test_its_help_has_every_text() -> None:
    shown = run(command_of(sample, "try"), "-h").stdout
    for text in ("Usage: try [OPTIONS] NAME N…", "Do it.", "The name.", "The unit.", "1<=x<=255", "A flag."):
        assert text in shown


def test_a_required_option_and_a_group() -> None:
    def alone(as_json: Annotated[bool, Option("--json", help="JSON.")] = False) -> None:
        CALLED["alone"] = as_json

    group = CommandGroup("Do things.", alone=alone)

    @group.add("take")
    def taken(reason: Annotated[str, Option(help="Why.")]) -> None:
        CALLED["reason"] = reason

    assert (run(group, "--json").exit_code, CALLED) == (0, {"alone": True})
    assert run(group, "take").exit_code == 2
    assert (run(group, "take", "--reason", "x").exit_code, CALLED) == (0, {"reason": "x"})
    assert run(CommandGroup("Nothing alone.")).exit_code == 2
