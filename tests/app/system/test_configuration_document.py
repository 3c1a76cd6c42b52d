"""Changes of the text of a configuration: what is not changed stays, byte for byte."""

from __future__ import annotations

import tomllib

import pytest

from app.system.configuration.document import WrittenOtherwiseError, at, moved_up, with_values, without
from tests.for_each import for_each

TEXT = """\
# The plant.
[site]
name = "Mill 7"   # on every page

[[bus]]
name = "dry-end"
port = "/dev/null"
# turnaround_ms = 50

# Of the unwinder.
[[bus.unit]]
id = 1            # the address
name = "Unwind #1"  # as people # call it
[bus.unit.labels]
output.1 = "Brake"

# Of the nip.
[[bus.unit]]
id = 2
name = "Nip"
# group = "Calender"

# [[bus.unit]]
# id = 3
[notify]
flood = 5
"""
UNWIND, NIP = ("bus", 0, "unit", 0), ("bus", 0, "unit", 1)


def test_a_value_is_exchanged_and_its_comment_stays() -> None:
    assert with_values(TEXT, UNWIND, {"name": 'Unwind "A"'}) == TEXT.replace(
        '"Unwind #1"  # as people', r'"Unwind \"A\""  # as people'
    )


def test_a_new_key_is_the_last_of_its_table() -> None:
    assert with_values(TEXT, NIP, {"group": "Calender"}) == TEXT.replace(
        'name = "Nip"\n', 'name = "Nip"\ngroup = "Calender"\n'
    )


def test_a_new_key_of_an_inner_table_goes_where_the_others_are() -> None:
    added = with_values(TEXT, UNWIND, {"labels.output.2": "Fan", "labels.unit": "m/min"})
    assert 'output.1 = "Brake"\noutput.2 = "Fan"\nunit = "m/min"\n\n# Of the nip.' in added
    assert 'name = "Nip"\nlabels.unit = "m/min"\n# group' in with_values(TEXT, NIP, {"labels.unit": "m/min"})


def test_a_key_is_removed_with_its_line_if_it_is_there() -> None:
    assert with_values(TEXT, UNWIND, {"labels.output.1": None}) == TEXT.replace('output.1 = "Brake"\n', "")
    assert with_values(TEXT, NIP, {"group": None}) == TEXT


def test_a_table_that_is_not_there_comes_to_the_end() -> None:
    added = with_values(TEXT, ("notify", "smtp"), {"host": "mail", "to": ["a@b", "c@d"]})
    assert added == f'{TEXT}\n[notify.smtp]\nhost = "mail"\nto = ["a@b", "c@d"]\n'


def test_an_element_goes_behind_the_last_one() -> None:
    one = with_values(TEXT, ("alarm", 0), {"name": "A", "above": 3, "latch": True})
    assert one == f'{TEXT}\n[[alarm]]\nname = "A"\nabove = 3\nlatch = true\n'
    two = with_values(f"{one}\n# The end.\n", ("alarm", 1), {"name": "B"})
    assert two == f'{one}\n[[alarm]]\nname = "B"\n\n# The end.\n'


def test_an_element_of_an_element() -> None:
    first, second = '[[notify.group]]\nname = "a"\n', '\n[[notify.group]]\nname = "b"\n'
    duty = '\n[[notify.group.duty]]\nto = ["x@y"]\n'
    table = ("notify", "group", 0, "duty", 0)
    assert with_values(first + second, table, {"to": ["x@y"]}) == first + duty + second


def test_an_element_is_removed_with_the_comment_above_it() -> None:
    removed = without(TEXT, UNWIND)
    assert "Of the unwinder" not in removed
    assert removed == TEXT[: TEXT.index("# Of the unw")] + TEXT[TEXT.index("# Of the nip") :]


def test_the_last_element_is_removed_and_comments_behind_it_stay() -> None:
    removed = without(TEXT, NIP)
    assert "# [[bus.unit]]\n# id = 3\n[notify]" in removed
    assert "Nip" not in removed


def test_units_change_places_with_their_comments() -> None:
    moved = moved_up(TEXT, NIP)
    assert [unit["id"] for unit in at(tomllib.loads(moved), ("bus", 0, "unit"))] == [2, 1]
    assert sorted(moved.splitlines()) == sorted(TEXT.splitlines())
    assert '# Of the nip.\n[[bus.unit]]\nid = 2\nname = "Nip"\n# group = "Calender"\n\n# Of the unw' in moved
    assert moved_up(moved, NIP) == TEXT
    with pytest.raises(WrittenOtherwiseError):
        moved_up(TEXT, UNWIND)


def test_line_ends_stay() -> None:
    text = '[site]\r\nname = "a"\r\n'
    assert with_values(text, ("site",), {"name": "b", "language": "de"}) == (
        '[site]\r\nname = "b"\r\nlanguage = "de"\r\n'
    )


def test_a_file_without_a_last_line_end() -> None:
    assert with_values('[site]\nname = "a"', ("site",), {"language": "de"}) == (
        '[site]\nname = "a"\nlanguage = "de"\n'
    )


@for_each(
    ("text", "table", "change"),
    [
        ('[[bus]]\nunit = [{ id = 1, name = "a" }]\n', ("bus", 0, "unit", 0), {"name": "b"}),
        ('[[bus.unit]]\nlabels = { unit = "m" }\n', ("bus", "unit", 0), {"labels.analog": "b"}),
        ('[notify.smtp]\nto = [\n  "a@b", # Ann\n]\n', ("notify", "smtp"), {"to": ["c@d"]}),
        ("notify = { flood = 3 }\n", ("notify",), {"digest_s": 9}),
    ],
)
def test_a_table_that_is_written_otherwise_is_refused(
    text: str, table: tuple[str | int, ...], change: dict[str, str | int | list[str]]
) -> None:
    """Such a file is changed by hand: no comment and no key is lost."""
    with pytest.raises(WrittenOtherwiseError):
        with_values(text, table, change)


def test_a_list_of_several_lines_without_comments() -> None:
    text = '[notify.smtp]\nto = [\n  "a@b",\n]  # all\nport = 25\n'
    assert with_values(text, ("notify", "smtp"), {"to": ["c@d"]}) == (
        '[notify.smtp]\nto = ["c@d"]  # all\nport = 25\n'
    )
